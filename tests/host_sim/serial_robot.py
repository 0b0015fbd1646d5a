"""A robot on a serial line: the firmware in C behind the SLCAN in C, at the end of a pseudo-terminal.

What a board does with its UART, this does with the terminal: bytes to ``slcan_feed``, frames to the firmware, the
firmware's frames to ``slcan_put``, bytes from ``slcan_next``.
"""

import contextlib
import ctypes
import os
import select
import threading
import tty
from collections.abc import Iterator
from types import TracebackType
from typing import Self

from host_sim.inproc import Frame, load_firmware
from host_sim.robot import ROOT

LIBRARY_FILE = ROOT / "build" / "host" / "libprotocol-visible.so"


class SlcanInC:
    """``slcan_t`` and its functions."""

    def __init__(self) -> None:
        library = ctypes.CDLL(str(LIBRARY_FILE))
        for name in ("feed", "next", "has_room", "put"):
            library[f"slcan_{name}"].restype = ctypes.c_bool
        library.slcan_feed.argtypes = (ctypes.c_void_p, ctypes.c_uint8, ctypes.c_void_p)
        self._library = library
        self._state = (ctypes.c_uint64 * 128)()  # more than it takes
        library.slcan_init(self._state)

    def feed(self, byte: int) -> Frame | None:
        frame = Frame()
        return frame if self._library.slcan_feed(self._state, byte, ctypes.byref(frame)) else None

    def has_room(self) -> bool:
        return bool(self._library.slcan_has_room(self._state))

    def put(self, frame: Frame) -> bool:
        return bool(self._library.slcan_put(self._state, ctypes.byref(frame)))

    def take(self) -> bytes:
        """Everything that waits for the line."""
        taken, byte = bytearray(), ctypes.c_uint8()
        while self._library.slcan_next(self._state, ctypes.byref(byte)):
            taken.append(byte.value)
        return bytes(taken)


class SerialRobot:
    """A robot that answers on ``port`` as long as the context lasts; ``heard`` and ``said`` keep every byte."""

    def __init__(self, node: int = 0, *, mute: bool = False) -> None:
        self.heard, self.said = bytearray(), bytearray()
        self._mute = mute
        self._slcan = SlcanInC()
        self._firmware = load_firmware()
        self._instance = (ctypes.c_uint64 * (self._firmware.omnibot_size() // 8 + 1))()
        self._firmware.omnibot_init(self._instance, node)
        self._line, self._port = os.openpty()
        tty.setraw(self._port)
        self.port = os.ttyname(self._port)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join()
        for handle in (self._line, self._port, self._stop_read, self._stop_write):
            os.close(handle)

    def _serve(self) -> None:
        while self._stop_read not in select.select([self._line, self._stop_read], [], [])[0]:
            for byte in os.read(self._line, 4096):
                self.heard.append(byte)
                self._act_on(byte)

    def _act_on(self, byte: int) -> None:
        frame = self._slcan.feed(byte)
        if frame is not None:
            self._firmware.omnibot_receive(self._instance, ctypes.byref(frame))
        self.say(self._slcan.take())
        for answer in self._answers():
            self._slcan.put(answer)
            self.say(self._slcan.take())

    def _answers(self) -> Iterator[Frame]:
        frame = Frame()
        while self._slcan.has_room() and self._firmware.omnibot_transmit(self._instance, ctypes.byref(frame)):
            yield frame

    def say(self, text: bytes) -> None:
        if self._mute or not text:
            return
        self.said += text
        with contextlib.suppress(BlockingIOError):
            os.write(self._line, text)
