"""The trajectory, overheard on its way to the robot, and where it has the robot be."""

import zlib
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from host_sim.errors import OmnibotError
from host_sim.robot import Array
from host_sim.trajectory import Polyline, Trajectory

BLOCK_TICKS = 256  # are evaluated at a time: a call for each tick would take a tenth of a processor
OUTLINE_POINTS = 600


class Reference:
    """Where the robot should be at each tick of its drive."""

    def __init__(self, data: bytes, period_s: float) -> None:
        self._trajectory = Trajectory.from_bytes(data, Polyline(np.zeros((1, 2))))  # how sharp it was, no wire tells
        self._period_s = period_s
        self._block = -1
        self._points: list[list[float]] = []

    def at(self, tick: int) -> Sequence[float]:
        """Return tracked point (m, m) and heading (rad, not wrapped) of a tick counted from START."""
        block, place = divmod(tick, BLOCK_TICKS)
        if block != self._block:
            ticks = block * BLOCK_TICKS + np.arange(BLOCK_TICKS)
            self._points = self._trajectory.evaluate(ticks * self._period_s, derivatives=0)[:, 0].tolist()
            self._block = block
        return self._points[place]

    @property
    def duration_s(self) -> float:
        """Time from START to the end."""
        return self._trajectory.duration_us * 1e-6

    @cached_property
    def outline(self) -> Array:
        """Points to draw the way of the tracked point with, shape (n, 2) in m."""
        times = np.linspace(0.0, self.duration_s, OUTLINE_POINTS)
        return self._trajectory.evaluate(times, derivatives=0)[:, 0, :2]


class Overheard:
    """An upload as the monitor hears it; `reference` is None until the robot holds one that was heard as a whole."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.reference: Reference | None = None
        self.forget()

    def forget(self) -> None:
        """Something was not heard: nobody knows what the robot holds."""
        self.reference = None
        self._expected: tuple[int, int] | None = None  # length and CRC-32
        self._data = bytearray()

    def begin(self, length_bytes: int, crc32: int) -> None:
        """Take a TRAJECTORY_BEGIN."""
        self._expected, self._data = (length_bytes, crc32), bytearray()

    def take(self, offset_bytes: int, data: bytes) -> None:
        """Take a TRAJECTORY_DATA; it may repeat what came. Where one was not heard, the CRC will tell."""
        del self._data[offset_bytes:]
        self._data += data

    def acknowledge(self, result: str) -> None:
        """Take a TRAJECTORY_ACK."""
        if result in ("WRONG_LENGTH", "IN_MOTION"):
            self._expected = None  # it keeps what it had
        elif result == "COMPLETE":
            self.reference = None if self._expected is None else self._complete(*self._expected)
            self._expected = None
        elif result != "WRONG_OFFSET":  # it goes on from the offset that it names
            self.reference = None

    def _complete(self, length_bytes: int, crc32: int) -> Reference | None:
        """Return what was heard, if it is all of what was sent."""
        data = bytes(self._data[:length_bytes])
        if len(data) != length_bytes or zlib.crc32(data) != crc32:
            return None
        try:
            return Reference(data, self._period_s)
        except OmnibotError:
            return None
