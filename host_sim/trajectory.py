"""The reference as piecewise polynomials, the form in which it is sent to the firmware."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from host_sim.errors import OmnibotError

Array = NDArray[np.float64]

AXES = 3  # p1, p2, heading
COEFFICIENTS = 8  # of each axis: degree 7
MAX_SEGMENTS = 128  # what the firmware stores
MAX_DURATION_US = 600_000_000  # of one segment
MAX_TOTAL_US = 3_600_000_000  # of all together

_WIRE = np.dtype([("duration_us", "<u4"), ("coefficients", "<f4", (AXES, COEFFICIENTS))])
SEGMENT_BYTES = _WIRE.itemsize

_SNAP_US = 1e-3  # a time this close to a whole microsecond is that microsecond: k * 0.001 s is tick k exactly


class Path(Protocol):
    """The geometric path behind a trajectory, corners sharp."""

    def distance(self, points: Array) -> Array:
        """Distance of points to the path, shape (n,) in m, of points of shape (n, 2) in m."""

    def outline(self) -> Array:
        """Vertices to draw the path with, shape (m, 2) in m; a closed path ends where it starts."""


@dataclass(frozen=True, eq=False)
class Polyline:
    """Straight sides between vertices of shape (m, 2) in m; a closed one has a side from the last to the first."""

    vertices: Array
    closed: bool = True

    def distance(self, points: Array) -> Array:
        """Distance of points to the nearest side, shape (n,) in m, of points of shape (n, 2) in m."""
        sides = [_distance_to_side(points, start, end) for start, end in pairwise(self.outline())]
        return np.asarray(np.min(sides, axis=0))

    def outline(self) -> Array:
        """Vertices, shape (m, 2) in m, with the first one repeated at the end of a closed line."""
        return np.vstack([self.vertices, self.vertices[:1]]) if self.closed else self.vertices


def _distance_to_side(points: Array, start: Array, end: Array) -> Array:
    """Distance, shape (n,), of points of shape (n, 2) to the side from ``start`` to ``end``."""
    side = end - start
    length = float(np.hypot(*side))
    direction = side / length if length > 0.0 else side
    along = np.clip((points - start) @ direction, 0.0, length)
    return np.asarray(np.linalg.norm(points - start - along[:, None] * direction, axis=1))


@dataclass(frozen=True, eq=False)
class Segment:
    """One polynomial piece of the reference.

    Attributes
    ----------
    duration_us
        How long it lasts, a whole number of microseconds, 1 … 600 000 000.
    coefficients
        Shape (3, 8): the axes p1 (m), p2 (m) and heading (rad, not wrapped), ascending powers of the
        normalised time s = t / duration in [0, 1].
    """

    duration_us: int
    coefficients: Array

    def __post_init__(self) -> None:
        coefficients = np.array(self.coefficients, dtype=np.float64)
        if not 0 < self.duration_us <= MAX_DURATION_US:
            raise OmnibotError(f"a segment of {self.duration_us} µs; it must last 1 … {MAX_DURATION_US} µs")
        if coefficients.shape != (AXES, COEFFICIENTS):
            raise OmnibotError(f"segment coefficients of shape {coefficients.shape}; it must be (3, 8)")
        if not np.all(np.isfinite(coefficients)):
            raise OmnibotError("segment coefficients must be finite numbers")
        coefficients.setflags(write=False)
        object.__setattr__(self, "coefficients", coefficients)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The reference over time, one segment after the other, and the path that it is meant to follow."""

    segments: Sequence[Segment]
    path: Path

    def __post_init__(self) -> None:
        if not self.segments:
            raise OmnibotError("a trajectory needs at least one segment")
        object.__setattr__(self, "segments", tuple(self.segments))

    @cached_property
    def joints_us(self) -> NDArray[np.int64]:
        """Times at which segments start, and the end of the last one, shape (segments + 1,) in µs."""
        return np.cumsum([0, *(segment.duration_us for segment in self.segments)], dtype=np.int64)

    @property
    def duration_us(self) -> int:
        """Time from start to end, µs."""
        return int(self.joints_us[-1])

    def evaluate(self, time_s: ArrayLike, derivatives: int = 3) -> Array:
        """Return the reference and its time derivatives.

        A joint belongs to the segment that it starts. Before 0 the reference rests at its first point, from the end
        on at its last.

        Parameters
        ----------
        time_s
            Times, shape (n,) in s. A time within 1 ns of a whole microsecond counts as that microsecond.
        derivatives
            Highest order of derivative.

        Returns
        -------
        Shape (n, derivatives + 1, 3): p1 (m), p2 (m), heading (rad) and their derivatives by s.
        """
        time_us = _snapped(np.asarray(time_s, dtype=np.float64) * 1e6)
        index = np.clip(np.searchsorted(self.joints_us, time_us, side="right") - 1, 0, len(self.segments) - 1)
        duration_us = np.diff(self.joints_us)[index]
        phase = np.clip((time_us - self.joints_us[index]) / duration_us, 0.0, 1.0)
        coefficients = np.array([segment.coefficients for segment in self.segments])
        result = np.empty((len(time_us), derivatives + 1, AXES))
        for order in range(derivatives + 1):
            result[:, order] = _horner(coefficients[index], phase) * (1e6 / duration_us[:, None]) ** order
            coefficients = _differentiated(coefficients)
        result[(time_us < 0.0) | (time_us >= self.duration_us), 1:] = 0.0
        return result

    def to_bytes(self) -> bytes:
        """Lay the segments out as in the firmware's store: 100 bytes each, little-endian, coefficients as float32."""
        wire = np.zeros(len(self.segments), dtype=_WIRE)
        wire["duration_us"] = [segment.duration_us for segment in self.segments]
        wire["coefficients"] = [segment.coefficients for segment in self.segments]
        return wire.tobytes()

    @classmethod
    def from_bytes(cls, data: bytes, path: Path) -> Self:
        """Read segments from the layout of ``to_bytes``."""
        if not data or len(data) % SEGMENT_BYTES:
            raise OmnibotError(f"{len(data)} bytes of trajectory; it must be a multiple of {SEGMENT_BYTES}, not 0")
        wire = np.frombuffer(data, dtype=_WIRE)
        return cls([Segment(int(row["duration_us"]), row["coefficients"]) for row in wire], path)

    def rounded(self) -> Self:
        """Return the trajectory as the firmware has it, coefficients rounded to float32."""
        return self.from_bytes(self.to_bytes(), self.path)


def hermite(nodes_us: list[int], states: Array) -> list[Segment]:
    """Return polynomials of degree 7 through position and three time derivatives at n nodes in µs.

    Parameters
    ----------
    nodes_us
        Whole microseconds, rising.
    states
        Shape (n, 4, 2) or (n, 4, 3): p1, p2, and the heading if it is not 0, and their derivatives by s.
    """
    durations_us = [end - begin for begin, end in pairwise(nodes_us)]
    scale = (np.array(durations_us) * 1e-6)[:, None] ** np.arange(4)
    left, right = states[:-1] * scale[:, :, None], states[1:] * scale[:, :, None]
    low = left / np.array([1.0, 1.0, 2.0, 6.0])[:, None]
    falling = np.array([[math.perm(power, order) for power in range(8)] for order in range(4)], dtype=np.float64)
    high = np.linalg.solve(falling[:, 4:], right - falling[:, :4] @ low)
    coefficients = np.zeros((len(low), AXES, COEFFICIENTS))
    coefficients[:, : states.shape[2]] = np.concatenate([low, high], axis=1).transpose(0, 2, 1)
    return [Segment(us, piece) for us, piece in zip(durations_us, coefficients, strict=True)]


def _snapped(time_us: Array) -> Array:
    """Move times that are almost a whole microsecond onto it; shape kept."""
    whole = np.round(time_us)
    return np.where(np.abs(time_us - whole) < _SNAP_US, whole, time_us)


def _horner(coefficients: Array, phase: Array) -> Array:
    """Value of polynomials, shape (n, 3), of coefficients of shape (n, 3, k) at phases of shape (n,)."""
    value = np.zeros(coefficients.shape[:2])
    for power in reversed(range(coefficients.shape[2])):
        value = value * phase[:, None] + coefficients[:, :, power]
    return value


def _differentiated(coefficients: Array) -> Array:
    """Coefficients of the derivative by the normalised time, shape (..., k), of those of shape (..., k)."""
    derivative = np.zeros_like(coefficients)
    derivative[..., :-1] = coefficients[..., 1:] * np.arange(1, coefficients.shape[-1])
    return derivative
