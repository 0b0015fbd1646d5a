"""The figures of merit of a run, from its trace; the names are those of ``result.json``.

A figure without a value, because the trace is empty or holds a number that is not finite, is None: ``null`` in JSON.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from host_sim.robot import Array
from host_sim.trace import Trace

# A torque this close to the limit is at the limit: one step of the wire's resolution.
TORQUE_RESOLUTION_Nm = 1e-5

# Distance of points, shape (n, 2) in m, to the path: shape (n,) in m.
DistanceToPath = Callable[[Array], Array]


@dataclass(frozen=True)
class Tracking:
    """How far the tracked point was from where it should be; the path deviation leaves out being early or late."""

    max_error_m: float | None
    rms_error_m: float | None
    max_path_deviation_m: float | None
    max_heading_error_rad: float | None


@dataclass(frozen=True)
class Slip:
    """How much the wheels slipped: the largest magnitude of any wheel's slip ratio."""

    max_ratio: float | None


@dataclass(frozen=True)
class Torque:
    """How hard the motors worked; the fraction is that of ticks with at least one motor at its limit."""

    max_Nm: float | None
    saturated_fraction: float | None


@dataclass(frozen=True)
class Metrics:
    """All of them; the fields are sections of ``result.json``."""

    tracking: Tracking
    slip: Slip
    torque: Torque

    def as_dict(self) -> dict[str, dict[str, float | None]]:
        """Return plain nested dictionaries, valid as JSON."""
        return asdict(self)


def measure(trace: Trace, distance_to_path: DistanceToPath, torque_limit_Nm: float) -> Metrics:
    """Compute every figure of merit of a run."""
    return Metrics(
        tracking=measure_tracking(trace, distance_to_path),
        slip=Slip(max_ratio=_largest(trace.slip_ratio)),
        torque=measure_torque(trace, torque_limit_Nm),
    )


def measure_tracking(trace: Trace, distance_to_path: DistanceToPath) -> Tracking:
    """Compute the tracking errors; the path is asked about finite points only."""
    error = tracking_error(trace)
    known = len(trace) > 0 and bool(np.isfinite(trace.point).all())
    return Tracking(
        max_error_m=_largest(error),
        rms_error_m=_rms(error),
        max_path_deviation_m=_largest(distance_to_path(trace.point)) if known else None,
        max_heading_error_rad=_largest(heading_error(trace)),
    )


def measure_torque(trace: Trace, torque_limit_Nm: float) -> Torque:
    """Compute the largest torque and how often it was at the limit."""
    largest = _largest(trace.torque)
    if largest is None:
        return Torque(max_Nm=None, saturated_fraction=None)
    saturated = np.abs(trace.torque).max(axis=1) >= torque_limit_Nm - TORQUE_RESOLUTION_Nm
    return Torque(max_Nm=largest, saturated_fraction=float(saturated.mean()))


def tracking_error(trace: Trace) -> Array:
    """Distance of the tracked point from its reference, shape (n,) in m."""
    with np.errstate(invalid="ignore", over="ignore"):
        gap = trace.point - trace.reference_point
        return np.asarray(np.hypot(gap[:, 0], gap[:, 1]))


def heading_error(trace: Trace) -> Array:
    """Heading minus its reference, shape (n,) in rad, within (-pi, pi]."""
    with np.errstate(invalid="ignore"):
        return wrap_angle(trace.pose[:, 2] - trace.reference_heading)


def wrap_angle(angle: Array) -> Array:
    """Return the same directions, in rad, within (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle, 2.0 * np.pi))


def _largest(values: Array) -> float | None:
    """Return the largest magnitude, None if there are no values or one is not finite."""
    if values.size == 0 or not np.isfinite(values).all():
        return None
    return float(np.abs(values).max())


def _rms(values: Array) -> float | None:
    """Return the root mean square, scaled against overflow; None if there are no values or one is not finite."""
    largest = _largest(values)
    if not largest:
        return largest
    return largest * float(np.sqrt(np.mean((values / largest) ** 2)))
