"""Speed and slip by what the sensors say on the wire: how far the body went, and how far the wheels rolled.

Over a span of time the contact point of wheel i moved by row i of Jr times the body's displacement in its own frame,
and rolled by r times the wheel's turn; the difference is the slip (THEORY.md, K2). The span averages out the
resolution of the wire: a pose of 10 µm and 0.1 mrad is a speed of 0.4 mm/s over 50 ms.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from host_sim.robot import Array, Robot

SPAN_S = 0.05
LONGEST_S = 0.5  # poses further apart say nothing of now
SLOWEST_M_PER_S = 0.05  # below it the ratio would be the wire's resolution


@dataclass(frozen=True)
class Motion:
    """Means over the span before the newest pose.

    Attributes
    ----------
    twist
        Velocity of the body in its own frame, shape (3,): m/s, m/s, rad/s.
    slip_m_per_s
        Slip velocity of each contact point, shape (n,); None where no wheel speeds are on the wire.
    """

    twist: Array
    slip_m_per_s: Array | None

    @property
    def speed_m_per_s(self) -> float:
        """Speed of the body's centre."""
        return math.hypot(self.twist[0], self.twist[1])

    def slip_ratio(self, delta_m_per_s: float, speed_length_m: float) -> Array | None:
        """Return the slip ratio of each wheel, sigma / (V + delta) V of (14); None where it is too slow to tell."""
        speed = math.hypot(self.speed_m_per_s, speed_length_m * self.twist[2])
        if self.slip_m_per_s is None or speed < SLOWEST_M_PER_S:
            return None
        return np.asarray(self.slip_m_per_s / (speed + delta_m_per_s))


class MotionWindow:
    """The poses of the last span, each with how far the wheels had turned by then."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._poses: deque[tuple[float, Sequence[float], tuple[float, ...] | None]] = deque()
        self.clear()

    def clear(self) -> None:
        """Forget all: what comes next does not follow from it."""
        self._poses.clear()
        self._turned_rad: tuple[float, ...] | None = None
        self._speed: Sequence[float] | None = None
        self._speed_s = math.nan

    def add_wheel_speed(self, clock_s: float, speed_rad_per_s: Sequence[float]) -> None:
        """Take the wheel speeds of an instant; between two of them a speed changes steadily."""
        if self._speed is None or self._turned_rad is None or clock_s - self._speed_s > SPAN_S:
            self._turned_rad = (0.0,) * len(speed_rad_per_s)
            self._poses.clear()
        else:
            half_s = 0.5 * (clock_s - self._speed_s)
            self._turned_rad = tuple(
                turned + half_s * (a + b)
                for turned, a, b in zip(self._turned_rad, self._speed, speed_rad_per_s, strict=True)
            )
        self._speed, self._speed_s = speed_rad_per_s, clock_s

    def add_pose(self, clock_s: float, pose: Sequence[float]) -> None:
        """Take the pose of an instant, after its wheel speeds."""
        turned = self._turned_rad if self._speed_s == clock_s else None
        self._poses.append((clock_s, pose, turned))
        while len(self._poses) > 2 and self._poses[1][0] <= clock_s - SPAN_S:
            self._poses.popleft()

    def motion(self) -> Motion | None:
        """Return the means over the span; None while there are not two poses close enough."""
        if len(self._poses) < 2:
            return None
        (begin_s, begin, turned_before), (end_s, end, turned) = self._poses[0], self._poses[-1]
        span_s = end_s - begin_s
        if not 0.0 < span_s <= LONGEST_S:
            return None
        moved = np.array([end[0] - begin[0], end[1] - begin[1], math.remainder(end[2] - begin[2], math.tau)])
        heading = begin[2] + 0.5 * moved[2]
        cosine, sine = math.cos(heading), math.sin(heading)
        twist = np.array([cosine * moved[0] + sine * moved[1], cosine * moved[1] - sine * moved[0], moved[2]]) / span_s
        if turned is None or turned_before is None:
            return Motion(twist, None)
        rolled = self._robot.wheel_radius_m * (np.array(turned) - np.array(turned_before)) / span_s
        return Motion(twist, self._robot.Jr @ twist - rolled)
