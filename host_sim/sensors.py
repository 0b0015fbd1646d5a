"""What the firmware gets to see of the plant: pose at a rate and with a delay, wheel speeds from counting encoders."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from host_sim.errors import OmnibotError
from host_sim.robot import Array

Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Sensors:
    """A set of sensors; the defaults see everything at every tick.

    Attributes
    ----------
    pose_rate_hz
        Poses a second, rounded to whole ticks between two; None: one every tick; 0: one at the first tick and no more.
    pose_delay_s
        How old a pose is when it is sent.
    encoder_counts
        Counts a turn of the wheel encoders; 0: the speed itself.
    """

    pose_rate_hz: float | None = None
    pose_delay_s: float = 0.0
    encoder_counts: int = 0

    def __post_init__(self) -> None:
        rate = self.pose_rate_hz
        if rate is not None and rate != 0.0 and not 1e-3 <= rate < math.inf:
            raise OmnibotError(f"pose_rate_hz = {rate:g} must be 0, or 0.001 or above")
        if not 0.0 <= self.pose_delay_s <= 1.0:
            raise OmnibotError(f"pose_delay_s = {self.pose_delay_s:g} must be 0 … 1 s")
        if not 0 <= self.encoder_counts <= 1 << 24:
            raise OmnibotError(f"encoder_counts = {self.encoder_counts} must be 0 … {1 << 24}")


IDEAL_SENSORS = Sensors()


class Wheels(Protocol):
    """The wheels of a plant: angles in rad and speeds in rad/s, shapes (3,)."""

    @property
    def wheel_angle(self) -> Array: ...  # noqa: D102

    @property
    def wheel_speed(self) -> Array: ...  # noqa: D102


class Encoders:
    """Speed as a timer measures it: whole counts over the time between the last edges seen.

    The edge's time is told to a timer clock; without an edge in a period, the speed can be at most one count over the
    time since the last edge.
    """

    TIMER_HZ = 84e6

    def __init__(self, counts: int, period_s: float) -> None:
        self._step_rad = math.tau / counts
        self._period_s = period_s
        self._count: Array | None = None
        self._edge_s = np.zeros(3)
        self._speed = np.zeros(3)

    def speed(self, tick: int, angle: Array, speed: Array) -> Array:
        """Return the wheel speeds measured at a tick, rad/s, shape (3,)."""
        now_s = tick * self._period_s
        count = np.floor(angle / self._step_rad)
        # Where between two edges the wheel is tells how long ago it passed the last one: forwards the lower, backwards
        # the upper edge.
        edge = np.where(speed >= 0.0, count, count + 1.0) * self._step_rad
        with np.errstate(divide="ignore", invalid="ignore"):
            ago_s = np.where(speed != 0.0, (angle - edge) / speed, math.inf)
        edge_s = now_s - np.round(ago_s * self.TIMER_HZ) / self.TIMER_HZ
        if self._count is None:
            known = np.isfinite(edge_s)
            self._count, self._edge_s, self._speed = count, np.where(known, edge_s, now_s), speed.copy()
            return self._speed
        moved = count - self._count
        between_s = np.maximum(edge_s - self._edge_s, 0.1 * self._period_s)
        seen = moved != 0.0
        idle_s = np.maximum(now_s - self._edge_s, self._period_s)
        slowest = np.minimum(np.abs(self._speed), self._step_rad / idle_s)
        measured = np.where(seen, moved * self._step_rad / between_s, np.copysign(slowest, self._speed))
        self._edge_s = np.where(seen, edge_s, self._edge_s)
        self._count, self._speed = count, measured
        return measured


class Readings:
    """What a set of sensors reads in one run."""

    def __init__(self, sensors: Sensors, period_s: float) -> None:
        rate = sensors.pose_rate_hz
        self._every = 1 if rate is None else max(1, round(1.0 / (rate * period_s))) if rate > 0.0 else 0
        self._past: deque[Pose] = deque(maxlen=1 + round(sensors.pose_delay_s / period_s))
        self._encoders = Encoders(sensors.encoder_counts, period_s) if sensors.encoder_counts else None

    def pose(self, tick: int, pose: Pose) -> Pose | None:
        """Return the pose that is sent at a tick, if one is; the first one is as old as there is."""
        self._past.append(pose)
        sent = tick == 0 if self._every == 0 else tick % self._every == 0
        return self._past[0] if sent else None

    def wheel_speed(self, tick: int, wheels: Wheels) -> list[float]:
        """Return the wheel speeds that are sent at a tick, rad/s."""
        speed = wheels.wheel_speed
        if self._encoders is not None:
            speed = self._encoders.speed(tick, wheels.wheel_angle, speed)
        values: list[float] = speed.tolist()
        return values
