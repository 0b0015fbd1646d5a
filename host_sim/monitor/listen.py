"""Hearing a bus: a thread that feeds a `MonitorState`, outlives what goes wrong with the bus, and never sends."""

import contextlib
import math
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Self

import can

from host_sim.bus_choice import CONFIGURED, BusChoice, choose_bus
from host_sim.errors import OmnibotError
from host_sim.link import open_bus
from host_sim.monitor.driving import Sample
from host_sim.monitor.snapshot import Snapshot
from host_sim.monitor.state import Event, MonitorState
from host_sim.serial_bus import open_serial

WAIT_S = 0.1
RETRY_S = 1.0
QUEUE_BYTES = 1 << 20  # the kernel gives what it may; its default holds a twentieth of a second
SO_MEMINFO = 55  # of Linux; the word of a socket's memory that counts what found no room in its queue
MEMINFO_WORDS, MEMINFO_DROPS = 9, 8
OF_ONE_ROBOT = ("inproc", "pil", "omnibot")


def choose_listening(name: str, interface: str | None, channel: str | None, bitrate: int | None) -> BusChoice:
    """Return the bus to listen to, by the options of `choose_bus`; a SocketCAN interface may have a bit rate."""
    configured = interface is not None or name == CONFIGURED
    choice = choose_bus(name, interface, channel, bitrate if configured else None)
    if (choice.interface or choice.name) in OF_ONE_ROBOT:
        raise OmnibotError(
            f"{choice.interface or choice.name} is a bus within a run, which writes its own bus.log, and nobody else "
            "can hear it: drive on a SocketCAN interface (omnibot run --bus vcan0) and give it with --bus"
        )
    return choice


def open_listening(choice: BusChoice, node: int) -> can.BusABC:
    """Open a bus to listen only."""
    if choice.interface == "slcan":
        return open_serial(choice.channel, choice.bitrate, **{**choice.others, "listen_only": True})
    channel = None if choice.channel is None else str(choice.channel)
    bus = open_bus(choice.name, node, choice.interface, channel, choice.bitrate)
    heard = getattr(bus, "socket", None)
    if isinstance(heard, socket.socket):
        with contextlib.suppress(OSError):
            heard.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE_BYTES)
    return bus


def overflowed(bus: can.BusABC) -> int:
    """Return how many frames found no room in the queue of a SocketCAN bus since it was opened; 0 for another bus."""
    heard = getattr(bus, "socket", None)
    if not isinstance(heard, socket.socket):
        return 0
    try:
        words = heard.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * MEMINFO_WORDS)
        return int(struct.unpack(f"{MEMINFO_WORDS}I", words)[MEMINFO_DROPS])
    except (OSError, struct.error):
        return 0  # an older kernel does not tell


class News(NamedTuple):
    """What came since somebody looked last."""

    snapshot: Snapshot
    samples: list[Sample]
    events: list[Event]
    event_count: int


class Listener:
    """Feeds a state from a bus while it is entered; a bus that is lost is opened again every second.

    Parameters
    ----------
    state
        Nobody else may touch it meanwhile; ask here.
    open_it
        Opens the bus.
    """

    def __init__(self, state: MonitorState, open_it: Callable[[], can.BusABC], retry_s: float = RETRY_S) -> None:
        self._state = state
        self._open, self._retry_s = open_it, retry_s
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="monitor", daemon=True)
        self._stamp_s = 0.0  # of the newest frame, by the bus' clock
        self._came_s = time.monotonic()  # and when it came; before the first, when listening began
        self._overflowed = 0

    def __enter__(self) -> Self:
        self._bus: can.BusABC | None = self._open()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def news(self, after_sample: int = 0, after_event: int = 0) -> News:
        """Return what is known now, and the samples and events after those of some numbers."""
        with self._lock:
            state = self._state
            samples = [sample for sample in state.driving.samples if sample.number > after_sample]
            new = min(state.event_count - after_event, len(state.events))
            events = list(state.events)[len(state.events) - new :]
            now_s = self._stamp_s + time.monotonic() - self._came_s
            return News(state.snapshot(now_s), samples, events, state.event_count)

    def snapshot(self) -> Snapshot:
        """Return what is known now."""
        return self.news(after_sample=1 << 62).snapshot

    def outline(self) -> list[list[float]]:
        """Return the way of the trajectory as points in m; empty where it is not known."""
        with self._lock:
            reference = self._state.overheard.reference
            return [] if reference is None else reference.outline.tolist()

    # ---- the thread

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                self._hear()
            except (can.CanError, OSError, ValueError, OmnibotError) as error:
                self._lose(str(error) or type(error).__name__)
                self._ended.wait(self._retry_s)
        self._close()

    def _hear(self) -> None:
        """Listen until the end is asked for; raises what the bus does."""
        if self._bus is None:
            self._bus, self._overflowed = self._open(), 0
        checked_s = -math.inf
        while not self._ended.is_set():
            frame = self._bus.recv(WAIT_S)
            now_s = time.monotonic()
            with self._lock:
                if self._state.trouble:
                    self._state.lose("")
                if frame is not None:
                    self._stamp_s, self._came_s = frame.timestamp or time.time(), now_s
                    self._state.feed(self._stamp_s, frame)
            if now_s - checked_s >= WAIT_S:
                self._note_overflow(self._bus)
                checked_s = now_s

    def _note_overflow(self, bus: can.BusABC) -> None:
        lost = overflowed(bus) - self._overflowed
        if lost > 0:
            self._overflowed += lost
            with self._lock:
                self._state.miss(lost)

    def _lose(self, trouble: str) -> None:
        with self._lock:
            self._state.lose(trouble)
        self._close()

    def _close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(can.CanError, OSError):
                bus.shutdown()
