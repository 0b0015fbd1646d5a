"""The decay of an offset in a linear loop of second order: what gains promise, and what gains a decay shows.

The law (C1) makes the error e of each output obey e'' + K2 e' + K1 e = 0 (firmware/control/THEORY.md).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from host_sim.robot import Array

RISE = (0.1, 0.9)  # of the way: what the rise time is between
SETTLED = 0.02  # of the offset
# Poles closer than this part of their size count as so far apart: the formula divides by their distance.
DISTINCT = 1e-4


@dataclass(frozen=True)
class Gains:
    """K1 and K2 of one output."""

    stiffness_per_s2: float
    damping_per_s: float

    @property
    def natural_frequency_rad_per_s(self) -> float:
        """Return the frequency of the loop without damping."""
        return math.sqrt(self.stiffness_per_s2)

    @property
    def damping_ratio(self) -> float:
        """Return the damping beside the critical one: below 1 the loop overshoots."""
        return self.damping_per_s / (2.0 * self.natural_frequency_rad_per_s)

    @property
    def poles_per_s(self) -> tuple[complex, complex]:
        """Return the poles, the slower one first."""
        middle = -0.5 * self.damping_per_s
        half = np.emath.sqrt(middle**2 - self.stiffness_per_s2)
        return complex(middle + half), complex(middle - half)

    def response(self, time_s: Array) -> Array:
        """Return the error over the offset, shape (n,), at times (n,) after a start at rest relative to the reference.

        With poles s and s' it is (s exp(s' t) - s' exp(s t)) / (s - s').
        """
        middle = -0.5 * self.damping_per_s
        half = complex(np.emath.sqrt(middle**2 - self.stiffness_per_s2))
        least = DISTINCT * self.natural_frequency_rad_per_s
        half = half if abs(half) > least else complex(least)
        slow, fast = middle + half, middle - half
        return np.asarray(np.real((slow * np.exp(fast * time_s) - fast * np.exp(slow * time_s)) / (slow - fast)))


@dataclass(frozen=True)
class Traits:
    """What an engineer reads off a step response; None where it did not get that far."""

    rise_s: float | None
    overshoot: float
    settling_s: float | None


def traits(time_s: Array, response: Array) -> Traits:
    """Read off a response: the error over the offset, shape (n,), 1 at the start."""
    way = 1.0 - response
    begin_s, end_s = (_first(time_s, way, share) for share in RISE)
    outside = np.flatnonzero(np.abs(response) > SETTLED)
    settled = bool(len(outside)) and outside[-1] + 1 < len(time_s)
    return Traits(
        rise_s=None if begin_s is None or end_s is None else end_s - begin_s,
        overshoot=max(0.0, float(way.max()) - 1.0),
        settling_s=float(time_s[outside[-1] + 1]) if settled else None,
    )


def _first(time_s: Array, way: Array, share: float) -> float | None:
    """Return when a share of the way is reached, between two samples by their line."""
    beyond = np.flatnonzero(way >= share)
    if not len(beyond):
        return None
    after = max(int(beyond[0]), 1)
    return float(np.interp(share, way[after - 1 : after + 1], time_s[after - 1 : after + 1]))


def fit(time_s: Array, response: Array, start: Gains) -> Gains:
    """Return the gains whose response is nearest in the least squares; the search begins at ``start``."""
    scale = start.natural_frequency_rad_per_s

    def gains_of(point: Array) -> Gains:
        return Gains(float(np.exp(2.0 * point[0])) * scale**2, float(point[1]) * scale)

    def residual(point: Array) -> Array:
        return gains_of(point).response(time_s) - response

    bounds = ([-5.0, 0.0], [5.0, 100.0])
    begin = [0.0, min(start.damping_per_s / scale, 99.0)]
    return gains_of(least_squares(residual, begin, bounds=bounds, x_scale=0.1).x)
