"""Traction laws of a wheel: force against slip ratio, λ = −F(s) (theory, 'Traction (4)-(7)')."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeVar, cast, get_args

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from host_sim.errors import OmnibotError
from host_sim.robot import Robot

Array = NDArray[np.float64]
TractionKind = Literal["linear", "magic"]

_Function = TypeVar("_Function", bound=Callable[..., Any])

# Places in the array `law` that the compiled functions read: the coefficients of the magic curve begin at _TABLE.
_KIND, _STIFFNESS, _STRETCH, _SLOPE, _TABLE = range(5)
_LINEAR, _MAGIC = 0.0, 1.0

# The magic curve is tabulated: two arctangents, a sine and a cosine took two thirds of the plant's time, and differ in
# their last bits from one C library to the next. Over u = x/(1 + x), which takes the whole axis to 0 … 1, pieces of
# degree 5 that meet value, slope and curvature at their ends are within 1e-14 of the peak of the formula.
_PIECES = 256
_COEFFICIENTS = 6
_FAR = 1e300  # so that an infinite slip has its finite force


def compiled(function: _Function) -> _Function:
    """Compile with numba: IEEE arithmetic in the order written, and dividing by zero gives what the hardware gives."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


@compiled
def curve(law: Array, slip: float) -> tuple[float, float]:
    """F(s) and dF/ds, in N, of one slip ratio; the constants of the curve are those of `Traction.law`."""
    if law[_KIND] == _LINEAR:
        return law[_STIFFNESS] * slip, law[_STIFFNESS]
    x = abs(slip) * law[_STRETCH]
    if x > _FAR:
        x = _FAR
    rest = 1.0 / (1.0 + x)  # 1 − u
    u = x * rest
    if not u <= 1.0:
        return math.nan, math.nan
    place = u * _PIECES
    piece = min(int(place), _PIECES - 1)
    t = place - piece
    k = _TABLE + _COEFFICIENTS * piece
    c1, c2, c3, c4, c5 = law[k + 1], law[k + 2], law[k + 3], law[k + 4], law[k + 5]
    force = law[k] + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
    slope = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5))))
    return math.copysign(force, slip), slope * law[_SLOPE] * rest * rest


@compiled
def _force_each(law: Array, slip: Array, out: Array) -> None:
    for i in range(slip.size):
        out[i] = curve(law, slip[i])[0]


@compiled
def _slope_each(law: Array, slip: Array, out: Array) -> None:
    for i in range(slip.size):
        out[i] = curve(law, slip[i])[1]


def _magic_table(shape: float, curvature: float) -> Array:
    """Coefficients of the pieces of sin(C atan(x − E (x − atan x))) over u, shape (pieces, 6), ascending powers."""
    u = np.linspace(0.0, 1.0, _PIECES + 1)
    rest = 1.0 - u  # x = u / rest is infinite at the end: hence angles of the two
    norm = u * u + rest * rest
    inner, inner_1, inner_2 = np.arctan2(u, rest), 1.0 / norm, 2.0 * (rest - u) / norm**2  # atan x, derivatives by u
    bend = 1.0 - curvature
    # atan y with y = p / rest
    p = bend * u + curvature * inner * rest
    p_1 = bend + curvature * (inner_1 * rest - inner)
    p_2 = curvature * (inner_2 * rest - 2.0 * inner_1)
    q = p * p + rest * rest
    outer, outer_1 = shape * np.arctan2(p, rest), shape * (p_1 * rest + p) / q
    outer_2 = (shape * p_2 * rest - 2.0 * outer_1 * (p * p_1 - rest)) / q
    value, slope = np.sin(outer), np.cos(outer) * outer_1 / _PIECES
    bow = (np.cos(outer) * outer_2 - np.sin(outer) * outer_1**2) / _PIECES**2
    return _hermite(value, slope, bow)


def _hermite(value: Array, slope: Array, bow: Array) -> Array:
    """Polynomials over 0 … 1 between neighbours of value, slope and second derivative, shape (n − 1, 6)."""
    start, rise = value[:-1], np.diff(value)
    s0, s1, b0, b1 = slope[:-1], slope[1:], bow[:-1], bow[1:]
    return np.stack(
        [
            start,
            s0,
            0.5 * b0,
            10.0 * rise - 6.0 * s0 - 4.0 * s1 - 1.5 * b0 + 0.5 * b1,
            -15.0 * rise + 8.0 * s0 + 7.0 * s1 + 1.5 * b0 - b1,
            6.0 * rise - 3.0 * (s0 + s1) + 0.5 * (b1 - b0),
        ],
        axis=1,
    )


@dataclass(frozen=True)
class Traction:
    """One traction law. Both kinds have the slope G0/ε at zero slip; ``magic`` saturates at the friction limit.

    ``epsilon`` = 0 is the rigid robot: no slip whatever the force, so that there is no curve to evaluate.
    """

    kind: TractionKind
    epsilon: float  # 1/N: G0 over the longitudinal stiffness
    normalised_stiffness_N: float = 1.0  # G0
    friction_limit_N: float = 5.0  # Dp
    shape: float = 1.65  # C
    curvature: float = 0.432  # E

    def __post_init__(self) -> None:
        if self.kind not in get_args(TractionKind):
            raise OmnibotError(f"no traction law {self.kind!r}; there are: {', '.join(get_args(TractionKind))}")
        if not 0.0 <= self.epsilon <= 1.0:
            raise OmnibotError(f"epsilon = {self.epsilon:g} is outside 0 … 1; 0 is the rigid robot")
        if not (self.normalised_stiffness_N > 0.0 and self.friction_limit_N > 0.0):
            raise OmnibotError("normalised stiffness and friction limit must be above 0 N")
        if not (1.0 <= self.shape < 2.0 and 0.0 <= self.curvature < 1.0):
            raise OmnibotError(
                "the magic formula needs a shape in [1, 2) and a curvature in [0, 1), not "
                f"{self.shape:g}, {self.curvature:g}"
            )

    @classmethod
    def of(cls, robot: Robot, kind: TractionKind, epsilon: float) -> "Traction":
        """Take the constants of the curve from a robot."""
        return cls(
            kind=kind,
            epsilon=epsilon,
            normalised_stiffness_N=robot.normalised_stiffness_N,
            friction_limit_N=robot.friction_limit_N,
            shape=robot.magic_shape,
            curvature=robot.magic_curvature,
        )

    @property
    def rigid(self) -> bool:
        """Whether there is no slip at all."""
        return self.epsilon == 0.0

    @property
    def stiffness_N(self) -> float:
        """dF/ds at zero slip, G0/ε, N; infinite for the rigid robot."""
        return math.inf if self.rigid else self.normalised_stiffness_N / self.epsilon

    @cached_property
    def law(self) -> Array:
        """The constants as the compiled functions read them: four, and the table of the magic curve."""
        if self.kind == "linear" or self.rigid:
            return np.array([_LINEAR, 0.0 if self.rigid else self.stiffness_N, 0.0, 0.0])
        stretch = self.stiffness_N / (self.shape * self.friction_limit_N)  # B: x = B s
        table = self.friction_limit_N * _magic_table(self.shape, self.curvature)
        return np.concatenate([[_MAGIC, self.stiffness_N, stretch, stretch * _PIECES], table.ravel()])

    @cached_property
    def peak_slip(self) -> float:
        """Slip ratio up to which the force rises; infinite for a curve without a peak."""
        if self.kind == "linear" or self.shape <= 1.0:
            return math.inf
        y = math.tan(math.pi / (2.0 * self.shape))
        x = y
        for _ in range(60):  # y = (1 − E) x + E atan x: concave in x, so that Newton from the left rises to the root
            rest = y - (1.0 - self.curvature) * x - self.curvature * math.atan(x)
            x += rest / ((1.0 - self.curvature) + self.curvature / (1.0 + x * x))
        return x * self.shape * self.friction_limit_N / self.stiffness_N

    def force(self, slip: ArrayLike) -> Array:
        """F(s), N, of slip ratios of any shape."""
        return self._each(_force_each, slip)

    def slope(self, slip: ArrayLike) -> Array:
        """dF/ds, N, of slip ratios of any shape."""
        return self._each(_slope_each, slip)

    def _each(self, function: Callable[[Array, Array, Array], None], slip: ArrayLike) -> Array:
        values = np.array(slip, dtype=np.float64, order="C")
        out = np.empty_like(values)
        function(self.law, values.reshape(-1), out.reshape(-1))
        return out
