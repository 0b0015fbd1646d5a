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

# Places in the array `law` that the compiled functions read.
_KIND, _STIFFNESS, _SHAPE, _CURVATURE, _PEAK = range(5)
_LINEAR, _MAGIC = 0.0, 1.0


def compiled(function: _Function) -> _Function:
    """Compile with numba: IEEE arithmetic in the order written, and dividing by zero gives what the hardware gives."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


@compiled
def curve(law: Array, slip: float) -> tuple[float, float]:
    """F(s) and dF/ds, in N, of one slip ratio; the constants of the curve are those of `Traction.law`."""
    if law[_KIND] == _LINEAR:
        return law[_STIFFNESS] * slip, law[_STIFFNESS]
    x = law[_STIFFNESS] / (law[_SHAPE] * law[_PEAK]) * slip
    bend = 1.0 - law[_CURVATURE]
    y = bend * x + law[_CURVATURE] * math.atan(x)  # Bs − E (Bs − atan Bs), without the cancellation at small Bs
    dy = bend + law[_CURVATURE] / (1.0 + x * x)
    angle = law[_SHAPE] * math.atan(y)
    return law[_PEAK] * math.sin(angle), law[_STIFFNESS] * dy * math.cos(angle) / (1.0 + y * y)


@compiled
def _force_each(law: Array, slip: Array, out: Array) -> None:
    for i in range(slip.size):
        out[i] = curve(law, slip[i])[0]


@compiled
def _slope_each(law: Array, slip: Array, out: Array) -> None:
    for i in range(slip.size):
        out[i] = curve(law, slip[i])[1]


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
        """The constants as the compiled functions read them, shape (5,)."""
        kind = _MAGIC if self.kind == "magic" and not self.rigid else _LINEAR
        stiffness = 0.0 if self.rigid else self.stiffness_N
        return np.array([kind, stiffness, self.shape, self.curvature, self.friction_limit_N])

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
