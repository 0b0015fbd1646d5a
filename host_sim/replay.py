"""Replay: a recorded session's frames once more, to a firmware that must give the recorded answers, byte for byte.

In lockstep the robot's time is the tick, so its frames depend on nothing but those that it gets. What the host sent is
sent again in the order of the log, and where the log has a frame of the robot, one is taken from it: its outbox is as
full as it was, and the frames come in the same order. A difference is named by tick, signal and size.

A robot that had done other things before the session tells so: how many frames it has dropped in its life, what its
parameters were until the session set them, another key for START (which is then sent in place of the recorded one).
Where the keys differ, such signals are told apart.
"""

import contextlib
import math
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import can

from host_sim.canlog import Recording
from host_sim.codec import DBC_FILE, Codec, MessageCodec, WireError
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link, SilentError
from host_sim.signals import choose_node, is_of_wire, messages_of_nodes

# What a board measures of itself is another thing each time.
NOT_REPLAYED = frozenset(("TIMING", "HEALTH", "CRASH"))

# What comes of the robot's life before the session: messages, or signals of one.
BEFORE_START = "STATUS before START"
BEFORE_SET = "PARAMETER_VALUE before PARAMETER_SET"
OF_ITS_LIFE = frozenset(
    (
        *("CHALLENGE", "DROPS", "PARAMETER_STORE", BEFORE_START, BEFORE_SET),
        *("STATUS.dropped_frames", "FAULT_RECORD.count", "IDENTITY.drive"),
    )
)

COUNTED = frozenset(("TORQUE", "SLIP"))  # their counter tells the tick that they answer

Frame = tuple[MessageCodec, bytes]


class Session(NamedTuple):
    """What is known of a log before it is replayed; ``skipped`` HELLOs at its beginning nobody heard."""

    recording: Recording
    codec: Codec
    skipped: int


def inspect(source: Path, node: int | None = None, dbc: Path = DBC_FILE) -> Session:
    """Read a log to its end, and make sure that it holds what can be replayed.

    Raises
    ------
    OmnibotError
        It is damaged or empty, does not begin with a session, is of another protocol, or was paced by a timer.
    """
    recording = Recording(source)
    codec = Codec(dbc, choose_node(recording, messages_of_nodes(recording, dbc), node))
    judge = _Judge(recording.path, codec)
    for message in filter(is_of_wire, recording):
        spoken = codec.of_id(message.arbitration_id)
        if spoken is not None:
            judge.look_at(spoken, bytes(message.data))
    if not judge.begun:
        raise OmnibotError(f"{recording.path} holds no HELLO: {_RECORD_WHOLE}")
    return Session(recording, codec, max(judge.hellos - judge.identities, 0))


_RECORD_WHOLE = "a replay needs the session from its beginning; start recording before 'omnibot run'"


class _Judge:
    """Looks at the frames of a log in their order."""

    def __init__(self, path: Path, codec: Codec) -> None:
        self._path = path
        self._codec = codec
        self._drive = "LOCKSTEP"
        self._greeting = True  # nothing but HELLOs so far
        self.begun = False
        self.hellos = 0
        self.identities = 0

    def look_at(self, message: MessageCodec, data: bytes) -> None:
        try:
            values = message.named(data)
        except WireError:
            return  # the firmware will drop it, too
        if message.name == "HELLO":
            self._note_hello(int(values["protocol_hash"]))
        elif message.name == "IDENTITY":
            self.identities += self._greeting
            self._drive = message.label("drive", values["drive"])
        elif not message.from_robot:
            self._greeting = False
            self._note_request(message, values)

    def _note_hello(self, protocol_hash: int) -> None:
        if protocol_hash != self._codec.protocol_hash:
            raise OmnibotError(
                f"{self._path} is of protocol {protocol_hash:08X}, this is {self._codec.protocol_hash:08X}: "
                "replay it with the version that recorded it"
            )
        self.begun = True
        self.hellos += self._greeting

    def _note_request(self, message: MessageCodec, values: dict[str, float]) -> None:
        if not self.begun and message.name == "SYNC":
            raise OmnibotError(f"{self._path} begins without HELLO: {_RECORD_WHOLE}")
        operation = message.label("operation", values["operation"]) if message.name == "COMMAND" else ""
        if operation.startswith("USE_"):
            self._drive = operation.removeprefix("USE_")
        if self._drive != "LOCKSTEP" and (operation == "START" or message.name == "SYNC"):
            raise OmnibotError(
                f"{self._path} was recorded in {self._drive.lower()}, where the robot's own timer says when it steps; "
                "that is not in the log: record a run with --time lockstep"
            )


@dataclass
class Difference:
    """One signal, or message, that is not as recorded; ticks are None before the first SYNC."""

    name: str
    unit: str
    first_tick: int | None
    recorded: float | str
    replayed: float | str
    frames: int = 0
    largest: float = 0.0
    largest_tick: int | None = None

    def note(self, tick: int | None, size: float) -> None:
        """Count one more frame with it."""
        self.frames += 1
        if size > self.largest or self.frames == 1:
            self.largest, self.largest_tick = size, tick

    def __str__(self) -> str:
        """Say where it is and how large."""
        frames = f"in {self.frames} frame{'s' if self.frames > 1 else ''}"
        text = f"{at(self.first_tick)}: {self.name} {_value(self.recorded)} recorded, {_value(self.replayed)} replayed"
        if isinstance(self.recorded, str) or isinstance(self.replayed, str):
            return f"{text}; {frames}"
        unit = f" {self.unit}" if self.unit else ""
        size = f"off by {self.replayed - self.recorded:+.6g}{unit}"
        return f"{text}: {size}; {frames}, at most {self.largest:.6g}{unit} ({at(self.largest_tick)})"


def at(tick: int | None) -> str:
    """Name a tick."""
    return "before the first tick" if tick is None else f"tick {tick}"


def _value(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


A_FRAME, NO_FRAME = "a frame", "no frame"


@dataclass
class Outcome:
    """What a replay gave; ``excused`` are differences that the robot's life before the session explains."""

    ticks: int = 0
    frames: int = 0
    other_life: bool = False
    beyond: int = 0  # frames of the robot after the end of the log
    gave_up: str = ""  # why it did not come to that end
    found: dict[tuple[str, bool], Difference] = field(default_factory=dict)

    @property
    def differences(self) -> list[Difference]:
        """All that fail the replay."""
        return [item for item in self.found.values() if not self._is_excused(item)]

    @property
    def excused(self) -> list[Difference]:
        """All that another life of the robot explains."""
        return [item for item in self.found.values() if self._is_excused(item)]

    def _is_excused(self, item: Difference) -> bool:
        of_its_life = not OF_ITS_LIFE.isdisjoint((item.name, item.name.partition(".")[0]))
        return self.other_life and of_its_life and item.recorded not in (A_FRAME, NO_FRAME)

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        return {
            "status": "different" if self.differences else "identical",
            "ticks": self.ticks,
            "frames": self.frames,
            "differences": [vars(item) for item in self.differences],
            "excused": [vars(item) for item in self.excused],
            "frames_beyond_the_log": self.beyond,
            "gave_up": self.gave_up,
        }

    def note(self, message: MessageCodec, name: str, tick: int | None, recorded: bytes, replayed: bytes) -> None:
        """Add how two frames of a message differ, under a name."""
        if len(recorded) != len(replayed):
            self._note(f"{name}.length", "B", tick, len(recorded), len(replayed))
            return
        pairs = zip(message.fields, message.decode(recorded), message.decode(replayed), strict=True)
        differing = [(item, a, b) for item, a, b in pairs if a != b and not (math.isnan(a) and math.isnan(b))]
        for item, a, b in differing:
            said = (_said(message, item.name, value) for value in (a, b))
            self._note(f"{name}.{item.name}", item.unit, tick, *said)
        if not differing:  # in what is no signal
            self._note(f"{name}'s CRC, or a bit of no signal:", "", tick, recorded.hex(), replayed.hex())

    def note_absent(self, message: MessageCodec, tick: int | None, recorded: bool) -> None:
        """Add a frame that only the log or only the replay has."""
        sides = (A_FRAME, NO_FRAME) if recorded else (NO_FRAME, A_FRAME)
        self._note(message.name, "", tick, *sides)

    def _note(self, name: str, unit: str, tick: int | None, recorded: float | str, replayed: float | str) -> None:
        item = self.found.setdefault((name, recorded == NO_FRAME), Difference(name, unit, tick, recorded, replayed))
        numbers = not isinstance(recorded, str) and not isinstance(replayed, str)
        size = abs(float(replayed) - float(recorded)) if numbers else 0.0
        item.note(tick, size)


def _said(message: MessageCodec, signal: str, value: float) -> float | str:
    """Return a value's name if it has one, and else the value without the noise of its steps."""
    if math.isnan(value):
        return "not available"
    return message.label(signal, value) if message.labels(signal) else float(f"{value:.10g}")


def replay(session: Session, bus: can.BusABC, timeout_s: float = 2.0) -> Outcome:
    """Send a session's frames to the robot on a bus, and compare what it answers.

    Parameters
    ----------
    session
        What ``inspect`` found fit.
    bus
        With the robot of the session's node on it, at rest; in-process, one that nobody has spoken to.
    timeout_s
        How long, by the wall clock, that robot may be silent where the log has a frame of it.
    """
    link = Link(bus, session.codec, timeout_s)
    if isinstance(bus, InprocBus):
        return _Replay(link, 0.0).run(session)
    link.hello()  # a robot is there, at rest, and whatever it moves is off
    try:
        return _Replay(link, timeout_s).run(session)
    finally:
        with contextlib.suppress(OmnibotError):
            link.command("STOP")


class _Replay:
    """A replay under way."""

    def __init__(self, link: Link, wait_s: float) -> None:
        self._link = link
        self._codec = link.codec
        self._wait_s = wait_s
        self._begun = False
        self._greeted = False  # the robot has answered HELLO
        self._started = False
        self._set: set[float] = set()  # indices of the parameters that the session has set
        self._tick: int | None = None  # of the SYNC sent last
        self._ahead: deque[Frame] = deque()  # frames of the robot that are not compared yet
        self._keys: tuple[int, int] | None = None  # of the last CHALLENGE: recorded, replayed
        self._outcome = Outcome()

    def run(self, session: Session) -> Outcome:
        """Go through the log."""
        unheard = session.skipped
        try:
            for message in filter(is_of_wire, session.recording):
                spoken = self._codec.of_id(message.arbitration_id)
                if spoken is None:
                    continue
                if spoken.name == "HELLO" and unheard > 0:
                    unheard -= 1
                else:
                    self._go_on(spoken, bytes(message.data))
            self._outcome.beyond = sum(1 for _ in iter(self._next_at_once, None))
        except SilentError as error:
            self._outcome.gave_up = str(error)
        return self._outcome

    def _go_on(self, message: MessageCodec, data: bytes) -> None:
        """Send, or compare, one frame of the log; what was before the session does not matter."""
        if message.name == "HELLO" and not self._begun:
            self._begun = True
            while self._next_at_once() is not None:
                pass
        if not self._begun:
            return
        if message.from_robot:
            if self._is_compared(message):
                self._expect(message, data)
        else:
            self._send(message, data)

    def _is_compared(self, message: MessageCodec) -> bool:
        """Tell what depends on the session alone: a robot that still drove for another host tells that it lets go."""
        return message.name not in NOT_REPLAYED and (self._greeted or message.name != "STATUS")

    def _send(self, message: MessageCodec, data: bytes) -> None:
        """Send a frame of the host; START with the key that this robot gave."""
        if message.name == "COMMAND":
            data = self._with_key(message, data)
        self._greeted &= message.name != "HELLO"
        self._link.send_frame(message.arbitration_id, data)
        if message.name == "PARAMETER_SET" and len(data) == message.length:
            self._set.add(message.decode(data)[0])
        if message.name == "SYNC" and len(data) == message.length:
            tick = int(message.decode(data)[0])
            self._outcome.ticks += tick != self._tick
            self._tick = tick

    def _with_key(self, message: MessageCodec, data: bytes) -> bytes:
        try:
            operation, counter, key = message.unpack(data)
        except WireError:
            return data
        asked = message.label("operation", operation)
        self._started |= asked == "START"
        if self._keys is None or asked != "START" or key != self._keys[0]:
            return data
        self._outcome.other_life |= self._keys[0] != self._keys[1]
        return message.pack(operation, counter, self._keys[1])

    def _expect(self, message: MessageCodec, data: bytes) -> None:
        """Take the frame from the robot that the log has here, and compare."""
        tick = self._tick_of(message, data)
        passed: list[Frame] = []
        while (frame := self._next(self._wait_s)) is not None and not self._is_counterpart(message, data, *frame):
            passed.append(frame)
        self._greeted |= message.name == "IDENTITY"
        if frame is None:
            self._ahead.extendleft(reversed(passed))
            self._outcome.note_absent(message, tick, recorded=True)
            self._complain(message, tick)
            return
        for other, content in passed:
            self._outcome.note_absent(other, self._tick_of(other, content), recorded=False)
        self._outcome.frames += 1
        if frame[1] != data:
            self._outcome.note(message, self._name_of(message, data), tick, data, frame[1])
        if message.name == "CHALLENGE" and len(data) == len(frame[1]):
            self._keys = int(message.decode(data)[0]), int(message.decode(frame[1])[0])

    def _name_of(self, message: MessageCodec, data: bytes) -> str:
        """Name a message; what the robot's life before the session is told by has a name of its own."""
        if message.name == "STATUS" and not self._started:
            return BEFORE_START
        if message.name == "PARAMETER_VALUE" and len(data) == message.length:
            return message.name if message.decode(data)[0] in self._set else BEFORE_SET
        return message.name

    def _is_counterpart(self, message: MessageCodec, data: bytes, other: MessageCodec, content: bytes) -> bool:
        """Tell whether a frame is the recorded one, or stands in its place: the same message, of the same tick."""
        if other is not message:
            return False
        return (
            message.name not in COUNTED
            or content == data
            or self._counter(message, content) == self._counter(message, data)
        )

    def _complain(self, message: MessageCodec, tick: int | None) -> None:
        """Give up on a robot that could still answer, but does not."""
        if self._wait_s > 0.0:
            raise SilentError(
                f"{at(tick)}: no {message.name} from node {self._codec.node} on {self._link.bus.channel_info} within "
                f"{self._wait_s:g} s, where the log has one"
            )

    def _next_at_once(self) -> Frame | None:
        return self._next(0.0)

    def _next(self, wait_s: float) -> Frame | None:
        """Return the robot's next frame that has not been compared."""
        if self._ahead:
            return self._ahead.popleft()
        while (received := self._link.receive_frame(wait_s)) is not None:
            message = self._codec.of_id(received[0])
            if message is not None and message.from_robot and self._is_compared(message):
                return message, received[1]
        return None

    def _counter(self, message: MessageCodec, data: bytes) -> int:
        return int(message.decode(data)[[item.name for item in message.fields].index("counter")])

    def _tick_of(self, message: MessageCodec, data: bytes) -> int | None:
        """Return the tick that a frame answers: by its counter, near that of the last SYNC."""
        if self._tick is None or message.name not in COUNTED:
            return self._tick
        return self._tick + ((self._counter(message, data) - self._tick + 8) & 0xF) - 8
