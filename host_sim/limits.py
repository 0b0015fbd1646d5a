"""What a trajectory asks of the robot, and what it may: speed, acceleration, jerk, wheel speed, force and torque.

The wheels are taken to roll: slip adds a few percent of their speed, and the effort of tracking adds to force and
torque, so a limit on the reference should leave the controller some room.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import numpy as np

from host_sim.errors import OmnibotError
from host_sim.robot import Robot
from host_sim.trajectory import COEFFICIENTS, Array, Trajectory

# What is measured, in this order: a field of Limits, what it is called, its unit. Of speed, acceleration and jerk it is
# the tracked point's or, if that is more, the heading's times the wheel distance.
QUANTITIES = {
    "speed_m_per_s": ("speed", "m/s"),
    "accel_m_per_s2": ("acceleration", "m/s^2"),
    "jerk_m_per_s3": ("jerk", "m/s^3"),
    "wheel_speed_rad_per_s": ("wheel speed", "rad/s"),
    "wheel_force_N": ("wheel force", "N"),
    "wheel_torque_Nm": ("wheel torque", "N*m"),
}
# A drive that takes k times as long has so many powers of 1/k of each.
TIME_POWERS = dict(zip(QUANTITIES, (1, 2, 3, 1, 2, 2), strict=True))

LARGEST = 1e6  # a limit above it is no limit; so is None
_SAMPLES = 33  # a segment, both ends included
_ROUNDING = 1e-3  # by which a limit may be exceeded: less than the quantisation of sensors and torque


@dataclass(frozen=True)
class Limits:
    """The most that a reference may ask for; None: whatever it takes.

    Attributes
    ----------
    accel_m_per_s2, jerk_m_per_s3
        Of the tracked point, along and across the path together; of the heading, times the wheel distance, likewise.
    wheel_speed_rad_per_s
        Of each wheel.
    wheel_force_N
        Between each wheel and the floor, along its drive direction.
    wheel_torque_Nm
        Of each motor, at the wheel: the floor's force and the wheel's own inertia.
    speed_m_per_s
        Of the tracked point, and of the heading times the wheel distance.
    """

    accel_m_per_s2: float | None = None
    jerk_m_per_s3: float | None = None
    wheel_speed_rad_per_s: float | None = None
    wheel_force_N: float | None = None
    wheel_torque_Nm: float | None = None
    speed_m_per_s: float | None = None

    def __post_init__(self) -> None:
        for name, limit in asdict(self).items():
            if limit is not None and not 1e-6 <= limit <= LARGEST:
                raise OmnibotError(f"limit {name} = {limit:g} must be a number from 1e-06 to {LARGEST:g}")

    def __bool__(self) -> bool:
        """Tell whether anything is limited."""
        return any(limit is not None for limit in asdict(self).values())

    def over(self, below: "Limits") -> "Limits":
        """Return these limits, and where there is none that of ``below``."""
        mine = {name: limit for name, limit in asdict(self).items() if limit is not None}
        return Limits(**{**asdict(below), **mine})

    def of(self, name: str) -> float:
        """Return a limit, infinite if there is none."""
        limit = getattr(self, name)
        return math.inf if limit is None else float(limit)


NO_LIMITS = Limits()
LIMIT_NAMES = tuple(field.name for field in fields(Limits))


def free_speed(robot: Robot) -> float:
    """Speed of a wheel, rad/s, at which the motor takes no current any more at its nominal supply."""
    motor = robot.motor
    return motor.supply_nominal_V / (motor.torque_constant_Nm_per_A * motor.gear_ratio)


def robot_limits(robot: Robot) -> Limits:
    """Return what the robot's wheels can do: the motors' free speed and torque, and the firmware's bound of force."""
    return Limits(
        wheel_speed_rad_per_s=free_speed(robot),
        wheel_force_N=robot.parameter("force_bound_N").default,
        wheel_torque_Nm=robot.torque_limit_Nm,
    )


def wheel_demand(robot: Robot, heading: Array, first: Array, second: Array) -> tuple[Array, Array, Array]:
    """Return what rolling wheels must do: speed in rad/s, force in N and torque in N*m, each of shape (n, 3).

    Parameters
    ----------
    heading
        Shape (n,), rad.
    first, second
        Time derivatives of (p1, p2, heading), shape (n, 3). Force and torque are linear in ``second`` and quadratic in
        ``first``.
    """
    cosine, sine = np.cos(heading), np.sin(heading)

    def to_body(world: Array) -> Array:
        return np.stack(
            [cosine * world[:, 0] + sine * world[:, 1], cosine * world[:, 1] - sine * world[:, 0], world[:, 2]], axis=1
        )

    # The centre is the tracked point less L along the body's second axis (12).
    offset, turn = robot.tracked_point_offset_m, first[:, 2]
    zero = np.zeros_like(turn)
    twist = to_body(first) + offset * np.stack([turn, zero, zero], axis=1)
    specific_force = to_body(second) + offset * np.stack([second[:, 2], turn**2, zero], axis=1)
    twist_rate = specific_force + np.stack([turn * twist[:, 1], -turn * twist[:, 0], zero], axis=1)
    force = specific_force * robot.Mo @ np.linalg.inv(robot.Jr)  # (M2)
    wheel_acceleration = twist_rate @ robot.Jr.T / robot.wheel_radius_m
    torque = robot.wheel_radius_m * force + robot.wheel_inertia_kg_m2 * wheel_acceleration  # (M5)
    return twist @ robot.Jr.T / robot.wheel_radius_m, force, torque


@dataclass(frozen=True, eq=False)
class Motion:
    """A trajectory looked at closely: each array has one entry an instant, joints seen from both sides."""

    time_s: Array
    distance_m: Array  # along the path
    point: Array  # shape (n, 2) in m
    asked: Mapping[str, Array]  # of each of QUANTITIES

    def peak(self, name: str) -> float:
        """Return the most that is asked of a quantity."""
        return float(np.max(self.asked[name]))

    def where(self, name: str) -> str:
        """Say where the most is asked of a quantity."""
        k = int(np.argmax(self.asked[name]))
        x1, x2 = self.point[k]
        return f"{self.distance_m[k]:.3f} m along the path (x1 = {x1:.3f} m, x2 = {x2:.3f} m), {self.time_s[k]:.3f} s"

    def worst(self, limits: Limits) -> str | None:
        """Return the quantity that exceeds its limit by the largest factor, None if none does."""
        over = {name: self.peak(name) / limits.of(name) for name in QUANTITIES}
        name = max(over, key=over.__getitem__)
        return name if over[name] > 1.0 + _ROUNDING else None

    def slowdown(self, limits: Limits) -> float:
        """Return by what factor the time must be stretched, all else being the same, for every limit to hold."""
        return max(float((self.peak(name) / limits.of(name)) ** (1.0 / TIME_POWERS[name])) for name in QUANTITIES)

    def refusal(self, limits: Limits) -> str | None:
        """Say which limit is broken most, and where; None if none is."""
        name = self.worst(limits)
        if name is None:
            return None
        what, unit = QUANTITIES[name]
        most = f"{self.peak(name):.4g} {unit} is above the limit of {limits.of(name):.4g} {unit}"
        return f"{what} {most} at {self.where(name)}"


def motion_of(trajectory: Trajectory, robot: Robot) -> Motion:
    """Look at a trajectory at 33 instants a segment.

    A jump of velocity or acceleration from one segment to the next, or at the start and end, where the robot rests,
    counts as if it took one control period. A trajectory that starts in motion is not held against its start.
    """
    states = _states(trajectory)
    jumps = _jumps(states, robot.control_period_s, starts_moving=bool(np.any(np.abs(states[0, 0, 1]) > 1e-6)))
    flat = states.reshape(-1, 4, 3)
    spread = np.array([1.0, 1.0, robot.wheel_distance_m])
    asked = {name: _size(flat[:, k + 1] * spread) for k, name in enumerate(tuple(QUANTITIES)[:3])}
    for k, name in enumerate(("accel_m_per_s2", "jerk_m_per_s3")):
        asked[name] = np.maximum(asked[name], _size(jumps[:, k] * spread))
    wheels = wheel_demand(robot, flat[:, 0, 2], flat[:, 1], flat[:, 2])
    asked |= {name: np.max(np.abs(w), axis=1) for name, w in zip(tuple(QUANTITIES)[3:], wheels, strict=True)}
    steps = np.linalg.norm(np.diff(flat[:, 0, :2], axis=0), axis=1)
    begin_s, duration_s = trajectory.joints_us[:-1] * 1e-6, np.diff(trajectory.joints_us) * 1e-6
    time_s = begin_s[:, None] + duration_s[:, None] * np.linspace(0.0, 1.0, _SAMPLES)
    return Motion(time_s.ravel(), np.concatenate([[0.0], np.cumsum(steps)]), flat[:, 0, :2], asked)


def _size(vectors: Array) -> Array:
    """Size of the point's part or of the heading's, whichever is more, shape (n,), of vectors of shape (n, 3)."""
    return np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), np.abs(vectors[:, 2]))


def _states(trajectory: Trajectory) -> Array:
    """Output and three time derivatives, shape (segments, samples, 4, 3), each segment by its own polynomial."""
    s = np.linspace(0.0, 1.0, _SAMPLES)
    powers = np.array([[_falling(k, d) * s ** max(k - d, 0) for k in range(COEFFICIENTS)] for d in range(4)])
    coefficients = np.array([segment.coefficients for segment in trajectory.segments])
    rate = 1e6 / np.array([segment.duration_us for segment in trajectory.segments])
    states = np.einsum("dks,nak->nsda", powers, coefficients)
    return np.asarray(states * (rate[:, None] ** np.arange(4))[:, None, :, None])


def _falling(power: int, order: int) -> float:
    return float(math.perm(power, order))


def _jumps(states: Array, period_s: float, *, starts_moving: bool) -> Array:
    """Jumps of velocity and acceleration over a control period, shape (segments * samples, 2, 3), where they happen."""
    moving = states[:, :, 1:3]
    rest = np.zeros((1, 2, 3))
    before = np.concatenate([moving[:1, 0] if starts_moving else rest, moving[:-1, -1]])
    jumps = np.zeros_like(moving)
    jumps[:, 0] = (moving[:, 0] - before) / period_s
    jumps[-1, -1] = -moving[-1, -1] / period_s
    return jumps.reshape(-1, 2, 3)
