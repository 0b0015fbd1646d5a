"""The robot with slipping wheels, integrated one control period at a time (theory, 'Full model').

The slip velocity σ is a state of its own: taken as Jr ν − r φ̇ it would be a small difference of large speeds. In place
of the body twist stands

    v = ν − K σ,   K = Mv⁻¹ Jrᵀ Iw/r²,   with   Mv v̇ = Jᵀ τ − Mo (ω×ν)   and   σ̇ = G λ − Jr (ω×ν) − (r/Iw) τ,

G = Jr Mo⁻¹ Jrᵀ + (r²/Iw) I. The wheel forces are gone from v̇, so that all that is stiff are the three equations of σ,
with rates G F'(s)/(V + δ); v, pose and wheel angles are quadratures beside them.

Method: Radau IIA of five stages, order 9, L-stable (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.8),
one step a period or more, their length by the error that the embedded formula of order 5 shows in σ. Four things are
not in the book:

- simplified Newton for σ, whose residual is scaled stage by stage with the rate found there, because V + δ and F' may
  change several times within a step; v follows by fixed point in the same iterations;
- in a calm step (`_is_calm`) the boundary layer that a new torque sets off is taken out as exp(−k t), k being the rate
  G F'/(V + δ) of each wheel at the start. The stages carry the small rest: fewer steps, and mostly one iteration;
- an error in σ that the boundary layer forgets before the period ends may be larger than one that stays;
- a layer in which the contact points move less than `_LAYER_M` is not resolved: σ is put where the layer ends, if it is
  certain that it ends on the rising branch of the traction curve (`_skip_layer`).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from host_sim.errors import OmnibotError
from host_sim.robot import Array, Robot
from host_sim.traction import Traction, compiled, curve

Complex = NDArray[np.complex128]
Counts = NDArray[np.int64]

# The error of order 5 that a step may show in σ, relative to |σ| + ε (V + δ) · 1 N. That of order 9 is much smaller:
# σ is right to 2e-6 on that scale. Near or past the peak of the curve, where wheels break away or are caught, errors
# grow instead of fading.
_TOLERANCE = 2e-5
_TOLERANCE_NEAR_PEAK = 1e-7
_NEAR_PEAK = 0.5  # of the slip ratio at the peak
_RELAXED = 3.4  # logarithm of the largest factor on _TOLERANCE for errors that are forgotten before the period ends
_NEWTON_TOLERANCE = 1e-8  # relative as above
_NEWTON_LIMIT = 12  # iterations
_NEWTON_CALM = 1e-5  # a first correction that is the last one in a calm step: the next would be a thousandth of it
_ATTEMPT_LIMIT = 2000  # steps, the rejected ones too; catching a wheel at ε = 4e-11 takes about 600
_SHORTEST = 1e-22  # step, of a period; at rest the boundary layer of ε = 4e-11 lasts 5e-13 of one
# A skipped layer moves contact points by no more than this against the floor, of which the body turns by a tenth, in
# rad, and wheel angles take the whole, over r; the moves of successive layers do not add up, their σ being one curve.
_LAYER_M = 1e-8
_SLOW_ENOUGH = 0.5  # time constants in a step up to which the stages carry a layer as well as without the exponential
_COUPLING_LEFT = 0.03  # share of a layer that is not of the wheel's own making
_LAYER_RATE = 100.0  # time constants that a period must have at least for a layer in it to be skipped

_STAGES = 5
_PAIRS = 3  # one real eigenvalue, two pairs

# The method's nodes, and A⁻¹ = T diag(µ) T⁻¹ with one of each conjugate pair (T carries the factor 2 for the other).
_NODES = (0.05710419611451768, 0.2768430136381238, 0.5835904323689168, 0.8602401356562195, 1.0)
_MU = np.array([6.2867047517292765, 5.70095329867179 + 3.2102656003085497j, 3.655694325463572 + 6.543736899360077j])
_T = np.array(
    [
        [
            0.013576867344947943,
            -0.02295703051045903 + 0.02803971778575082j,
            -0.020484095635817653 - 0.09534775458059144j,
        ],
        [
            0.0016179004017190875,
            -0.015337661498360326 - 0.049417156853037054j,
            0.10034572903474212 + 0.18866363836322286j,
        ],
        [0.07915785334744721, 0.0387969279976579 - 0.16360070740750235j, -0.4610790680868359 - 0.2054060907602518j],
        [0.41225608268046143, 0.8152023425603981 - 0.39936485577360503j, 0.7557878044977225 - 0.9334882606649887j],
        [1.0, 2.0, 2.0],
    ]
)
_T_INVERSE = np.array(
    [
        [27.697693775684087, 12.783337911304406, 3.20848938671343, -0.9514904122489162, 0.7415504960259897],
        [
            -16.5209401067595 - 4.305721989937646j,
            -8.688476739531783 + 4.849995704764404j,
            -0.08606453162700278 + 0.9573643198484372j,
            -0.04958488899127132 + 1.20934600304247j,
            0.2656140579191533 - 0.5237317439676688j,
        ],
        [
            2.672093218917456 + 1.8740299037199024j,
            2.2968077838795806 - 1.9924828681719424j,
            -1.5181801617297122 - 0.5222078208040094j,
            0.5253300951157295 + 0.5920492840689743j,
            -0.13638930593214812 - 0.22495888507839018j,
        ],
    ]
)


def _lagrange(nodes: tuple[float, ...], j: int, x: float) -> float:
    """Value at x of the polynomial that is 1 at node j and 0 at the others."""
    return math.prod((x - c) / (nodes[j] - c) for m, c in enumerate(nodes) if m != j)


def _integral(j: int, x: float) -> float:
    """Integral of Lagrange's polynomial j of the nodes from 0 to x, by Gauss' formula of three points (exact)."""
    gauss = ((0.5 - math.sqrt(0.15), 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.5 + math.sqrt(0.15), 5.0 / 18.0))
    return x * sum(weight * _lagrange(_NODES, j, x * place) for place, weight in gauss)


def _derivative(i: int, j: int) -> float:
    """Slope at node i of the polynomial that is 1 at node j, 0 at the others and at the origin: A⁻¹."""
    nodes = (0.0, *_NODES)
    i, j = i + 1, j + 1
    if i == j:
        return sum(1.0 / (nodes[i] - c) for m, c in enumerate(nodes) if m != i)
    rest = math.prod((nodes[i] - c) / (nodes[j] - c) for m, c in enumerate(nodes) if m not in (i, j))
    return rest / (nodes[j] - nodes[i])


_A = np.array([[_integral(j, c) for j in range(_STAGES)] for c in _NODES])
_A_INVERSE = np.array([[_derivative(i, j) for j in range(_STAGES)] for i in range(_STAGES)])
_WEIGHTS = _A[-1].copy()
_GAMMA = 1.0 / float(_MU[0].real)
# Embedded formula: γ h f(start) beside the stages makes it of order 5; the difference in terms of Z.
_ERROR = np.array(
    [-_GAMMA * sum(_lagrange(_NODES, i, 0.0) * float(_A_INVERSE[i, j]) for i in range(_STAGES)) for j in range(_STAGES)]
)

# Rows of three numbers each. State:
_POSE, _SLOW, _SLIP, _ANGLE = range(4)
# What `observe` gives:
_SEEN_POSE, _SEEN_TWIST, _SEEN_WHEEL_SPEED, _SEEN_SLIP_RATIO, _SEEN_FORCE, _SEEN_ROWS = range(6)
# Constants: matrices first.
_G, _K, _JR, _PUSH, _DRIVE = 0, 3, 6, 9, 12
_COUPLING = 15  # Mv⁻¹ Mo
_TORQUE = 18  # r/Iw, slip ratio at the peak times the largest V̇ (0: no peak)
_SPEED = 19  # ℓ², δ, ε/G0
_CURVE = 20  # slip ratio at the peak, friction limit in N, largest slope in N
_WHEEL = 21  # 1/r
_CONSTANT_ROWS = 22
# Work space: of the period, of the step, of its stages.
_SLOW_DRIVE, _SLIP_DRIVE = 0, 1
_SLOW_RATE, _SLIP_RATE, _STIFFNESS, _SCALE, _LIMITS, _SCRATCH, _ERR, _JACOBIAN = 2, 3, 4, 5, 6, 7, 8, 9
_V = 12
_Z = _V + _STAGES
_SLOW_RATES = _Z + _STAGES
_RESIDUAL = _SLOW_RATES + _STAGES
_FADED = _RESIDUAL + _STAGES
_FADING = _FADED + _STAGES
_DRIFT = _FADING + _STAGES
_SLOPE = _DRIFT + 1
_WORK_ROWS = _SLOPE + 1
# Counters:
_STEPS, _REJECTED, _NEWTON, _RATES, _JACOBIANS, _LU, _SKIPPED, _COUNTERS = range(8)


# ------------------------------------------------------------------------------------------------------ Equations


@compiled
def _twist(c: Array, v: Array, s: Array) -> tuple[float, float, float, float]:
    """Body twist ν = v + K σ and the speed V of (14)."""
    x = v[0] + (c[_K, 0] * s[0] + c[_K, 1] * s[1] + c[_K, 2] * s[2])
    y = v[1] + (c[_K + 1, 0] * s[0] + c[_K + 1, 1] * s[1] + c[_K + 1, 2] * s[2])
    turn = v[2] + (c[_K + 2, 0] * s[0] + c[_K + 2, 1] * s[1] + c[_K + 2, 2] * s[2])
    return x, y, turn, math.sqrt(x * x + y * y + c[_SPEED, 0] * turn * turn)


@compiled
def _drive(c: Array, w: Array, torque: Array) -> None:
    """Write what the torques add to v̇ and σ̇."""
    for i in range(3):
        w[_SLOW_DRIVE, i] = c[_DRIVE + i, 0] * torque[0] + c[_DRIVE + i, 1] * torque[1] + c[_DRIVE + i, 2] * torque[2]
        w[_SLIP_DRIVE, i] = -c[_TORQUE, 0] * torque[i]


@compiled
def _rates(
    c: Array, law: Array, w: Array, v0: float, v1: float, v2: float, s0: float, s1: float, s2: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return v̇, σ̇ and, for each wheel, F'/(V + δ)."""
    x = v0 + (c[_K, 0] * s0 + c[_K, 1] * s1 + c[_K, 2] * s2)
    y = v1 + (c[_K + 1, 0] * s0 + c[_K + 1, 1] * s1 + c[_K + 1, 2] * s2)
    turn = v2 + (c[_K + 2, 0] * s0 + c[_K + 2, 1] * s1 + c[_K + 2, 2] * s2)
    scale = 1.0 / (math.sqrt(x * x + y * y + c[_SPEED, 0] * turn * turn) + c[_SPEED, 1])
    f0, d0 = curve(law, s0 * scale)
    f1, d1 = curve(law, s1 * scale)
    f2, d2 = curve(law, s2 * scale)
    a0, a1 = -turn * y, turn * x  # ω×ν
    force0 = c[_G, 0] * f0 + c[_G, 1] * f1 + c[_G, 2] * f2
    force1 = c[_G + 1, 0] * f0 + c[_G + 1, 1] * f1 + c[_G + 1, 2] * f2
    force2 = c[_G + 2, 0] * f0 + c[_G + 2, 1] * f1 + c[_G + 2, 2] * f2
    return (
        w[_SLOW_DRIVE, 0] - (c[_COUPLING, 0] * a0 + c[_COUPLING, 1] * a1),
        w[_SLOW_DRIVE, 1] - (c[_COUPLING + 1, 0] * a0 + c[_COUPLING + 1, 1] * a1),
        w[_SLOW_DRIVE, 2] - (c[_COUPLING + 2, 0] * a0 + c[_COUPLING + 2, 1] * a1),
        w[_SLIP_DRIVE, 0] - force0 - (c[_PUSH, 0] * a0 + c[_PUSH, 1] * a1),
        w[_SLIP_DRIVE, 1] - force1 - (c[_PUSH + 1, 0] * a0 + c[_PUSH + 1, 1] * a1),
        w[_SLIP_DRIVE, 2] - force2 - (c[_PUSH + 2, 0] * a0 + c[_PUSH + 2, 1] * a1),
        scale * d0,
        scale * d1,
        scale * d2,
    )


@compiled
def _rates_at(c: Array, law: Array, w: Array, v: Array, s: Array) -> None:
    """Write the rates at (v, σ) into `_SLOW_RATE`, `_SLIP_RATE`, `_SLOPE`."""
    f = _rates(c, law, w, v[0], v[1], v[2], s[0], s[1], s[2])
    w[_SLOW_RATE, 0], w[_SLOW_RATE, 1], w[_SLOW_RATE, 2] = f[0], f[1], f[2]
    w[_SLIP_RATE, 0], w[_SLIP_RATE, 1], w[_SLIP_RATE, 2] = f[3], f[4], f[5]
    w[_SLOPE, 0], w[_SLOPE, 1], w[_SLOPE, 2] = f[6], f[7], f[8]


@compiled
def _jacobian(c: Array, slope: Array, v: Array, s: Array, out: Array) -> None:
    """Write ∂σ̇/∂σ at constant v, 1/s, of the slopes F'/(V + δ); V and ω×ν depend on σ too, through ν = v + K σ."""
    x, y, turn, speed = _twist(c, v, s)
    scale = 1.0 / (speed + c[_SPEED, 1])
    direction = 1.0 / speed if speed > 0.0 else 0.0  # at rest V has a kink: its one-sided slopes average to 0
    for j in range(3):
        k0, k1, k2 = c[_K, j], c[_K + 1, j], c[_K + 2, j]
        speed_j = direction * (x * k0 + y * k1 + c[_SPEED, 0] * turn * k2)
        a0 = -(turn * k1 + k2 * y)
        a1 = turn * k0 + k2 * x
        for i in range(3):
            out[i, j] = -(c[_PUSH + i, 0] * a0 + c[_PUSH + i, 1] * a1)
        for m in range(3):
            force_j = slope[m] * ((1.0 if m == j else 0.0) - s[m] * scale * speed_j)
            for i in range(3):
                out[i, j] -= c[_G + i, m] * force_j


# -------------------------------------------------------------------------------------------------- Boundary layer


@compiled
def _certain_to_stick(c: Array, w: Array, y: Array) -> bool:
    """Whether every wheel ends on the rising branch of the curve.

    No wheel is past the peak, and none can get there: at the peak its own friction exceeds all else that acts on its
    slip ratio, whatever the other wheels and V do. Within these bounds σ̇ = G (λ(σ) − λ*) falls towards its only rest.
    """
    n0, n1, turn, speed = _twist(c, y[_SLOW], y[_SLIP])
    scale = 1.0 / (speed + c[_SPEED, 1])
    for i in range(3):
        load = w[_SLIP_DRIVE, i] + c[_PUSH + i, 0] * turn * n1 - c[_PUSH + i, 1] * turn * n0
        others = abs(c[_G + i, 0]) + abs(c[_G + i, 1]) + abs(c[_G + i, 2]) - c[_G + i, i]
        if not abs(load) + others * c[_CURVE, 1] + c[_TORQUE, 1] < c[_G + i, i] * c[_CURVE, 1]:
            return False
        if not abs(y[_SLIP, i]) * scale <= c[_CURVE, 0]:
            return False
        w[_SCRATCH, i] = load / c[_G + i, i] * c[_SPEED, 2] / scale  # left of the rest, because F(s) ≤ G0 s/ε
    return True


@compiled
def _solve_rest(c: Array, law: Array, w: Array, y: Array, n: Counts) -> bool:
    """Newton's method for σ̇ = 0 at constant v, in `_SCRATCH`."""
    unit = c[_SPEED, 2] * (_twist(c, y[_SLOW], y[_SLIP])[3] + c[_SPEED, 1])
    j = w[_JACOBIAN : _JACOBIAN + 3]
    x, f = w[_SCRATCH], w[_SLIP_RATE]
    for _ in range(_NEWTON_LIMIT):
        n[_RATES] += 1
        n[_JACOBIANS] += 1
        n[_LU] += 1
        _rates_at(c, law, w, y[_SLOW], x)
        _jacobian(c, w[_SLOPE], y[_SLOW], x, j)
        c0 = j[1, 1] * j[2, 2] - j[1, 2] * j[2, 1]
        c1 = j[1, 2] * j[2, 0] - j[1, 0] * j[2, 2]
        c2 = j[1, 0] * j[2, 1] - j[1, 1] * j[2, 0]
        d = -1.0 / (j[0, 0] * c0 + j[0, 1] * c1 + j[0, 2] * c2)
        e1 = j[0, 2] * j[2, 1] - j[0, 1] * j[2, 2]
        e2 = j[0, 1] * j[1, 2] - j[0, 2] * j[1, 1]
        x0 = d * (c0 * f[0] + e1 * f[1] + e2 * f[2])
        e1 = j[0, 0] * j[2, 2] - j[0, 2] * j[2, 0]
        e2 = j[0, 2] * j[1, 0] - j[0, 0] * j[1, 2]
        x1 = d * (c1 * f[0] + e1 * f[1] + e2 * f[2])
        e1 = j[0, 1] * j[2, 0] - j[0, 0] * j[2, 1]
        e2 = j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]
        x2 = d * (c2 * f[0] + e1 * f[1] + e2 * f[2])
        x[0] += x0
        x[1] += x1
        x[2] += x2
        if max(abs(x0), abs(x1), abs(x2)) < 1e-5 * unit:  # it converges with the square
            return True
    return False


@compiled
def _skip_layer(c: Array, law: Array, w: Array, y: Array, period: float, n: Counts) -> None:
    """Put σ where the boundary layer ends, if that is certain and the layer too short to matter.

    v is constant over the layer but for ω×ν, and that by less than ω K `_LAYER_M`.
    """
    speed = _twist(c, y[_SLOW], y[_SLIP])[3]
    scale = 1.0 / (speed + c[_SPEED, 1])
    if c[_G, 0] * c[_CURVE, 2] * scale * period < _LAYER_RATE:
        return
    if not (_certain_to_stick(c, w, y) and _solve_rest(c, law, w, y, n)):
        return
    for i in range(3):
        end = w[_SCRATCH, i]
        rate = c[_G + i, i] * curve(law, end * scale)[1] * scale
        if not (abs(end) * scale <= c[_CURVE, 0] and rate * period >= _LAYER_RATE):
            return
        if not abs(end - y[_SLIP, i]) <= _LAYER_M * rate:
            return
    for i in range(3):
        y[_SLIP, i] = w[_SCRATCH, i]
    n[_SKIPPED] += 1


# ------------------------------------------------------------------------------------------------------------ Step


@compiled
def _invert(shift: complex, j: Array, out: Complex) -> None:
    """Write (shift I − j)⁻¹ by cofactors, shape (3, 3)."""
    a, b, c = shift - j[0, 0], shift - j[1, 1], shift - j[2, 2]
    c0 = b * c - j[1, 2] * j[2, 1]
    c1 = j[1, 2] * j[2, 0] + j[1, 0] * c
    c2 = j[1, 0] * j[2, 1] + j[2, 0] * b
    d = a * c0 - j[0, 1] * c1 - j[0, 2] * c2
    d = d.conjugate() / (d.real * d.real + d.imag * d.imag)
    out[0, 0] = c0 * d
    out[0, 1] = (j[0, 2] * j[2, 1] + j[0, 1] * c) * d
    out[0, 2] = (j[0, 1] * j[1, 2] + j[0, 2] * b) * d
    out[1, 0] = c1 * d
    out[1, 1] = (a * c - j[0, 2] * j[2, 0]) * d
    out[1, 2] = (j[0, 2] * j[1, 0] + j[1, 2] * a) * d
    out[2, 0] = c2 * d
    out[2, 1] = (j[0, 1] * j[2, 0] + j[2, 1] * a) * d
    out[2, 2] = (a * b - j[0, 1] * j[1, 0]) * d


@compiled
def _begin(c: Array, law: Array, w: Array, y: Array, n: Counts) -> bool:
    """Prepare what all attempts at a step from this state share; False for a state that is not finite."""
    speed = _twist(c, y[_SLOW], y[_SLIP])[3]
    unit = c[_SPEED, 2] * (speed + c[_SPEED, 1])
    w[_LIMITS, 0] = _TOLERANCE
    w[_LIMITS, 1] = speed + c[_SPEED, 1]
    for i in range(3):
        slip = abs(y[_SLIP, i])
        w[_SCALE, i] = unit + slip
        if slip * c[_SPEED, 2] > _NEAR_PEAK * c[_CURVE, 0] * unit:
            w[_LIMITS, 0] = _TOLERANCE_NEAR_PEAK
    n[_RATES] += 1
    n[_JACOBIANS] += 1
    _rates_at(c, law, w, y[_SLOW], y[_SLIP])
    _jacobian(c, w[_SLOPE], y[_SLOW], y[_SLIP], w[_JACOBIAN : _JACOBIAN + 3])
    total = unit
    for i in range(3):
        w[_STIFFNESS, i] = max(0.0, c[_G + i, i] * w[_SLOPE, i])
        total += abs(w[_SLOW_RATE, i]) + abs(w[_SLIP_RATE, i]) + w[_SCALE, i]
    return bool(total < math.inf)


@compiled
def _is_calm(c: Array, w: Array, period: float) -> bool:
    """Whether the rates of the wheels hold over the period: none is near the peak, V + δ stays within a tenth."""
    a = w[_SLOW_RATE]
    change = period * math.sqrt(a[0] * a[0] + a[1] * a[1] + c[_SPEED, 0] * a[2] * a[2])
    return bool(w[_LIMITS, 0] == _TOLERANCE and change < 0.1 * w[_LIMITS, 1])


@compiled
def _first_step(w: Array, calm: bool, period: float) -> float:
    """Length of the first step, s: by the way that the stages have to carry σ in the boundary layer."""
    h = period
    for i in range(3):
        rate = w[_STIFFNESS, i]
        if rate * period > 1.0:
            way = abs(w[_SLIP_RATE, i]) / (rate * w[_SCALE, i])
            # Taken out, it leaves what the other wheels and the bend of the curve add to it.
            way *= (_COUPLING_LEFT + way if calm else 1.0) / w[_LIMITS, 0]
            if way > 1.0:
                h = min(h, 2.5 / rate * way ** (-1.0 / (_STAGES + 1)))
    return h


@compiled
def _residual(c: Array, law: Array, w: Array, y: Array, h: float, n: Counts) -> float:
    """Write the scaled residuals of σ, update v; return how far v moved, relative to V + δ."""
    inverse = 1.0 / h
    n[_RATES] += _STAGES
    s0, s1, s2 = y[_SLIP, 0], y[_SLIP, 1], y[_SLIP, 2]
    # 6/h: about the size of the eigenvalues of A⁻¹/h, so that stiff stages are scaled and others are not.
    shift = 6.0 * inverse
    k0, k1, k2 = shift + w[_STIFFNESS, 0], shift + w[_STIFFNESS, 1], shift + w[_STIFFNESS, 2]
    for j in range(_STAGES):
        f = _rates(
            c,
            law,
            w,
            w[_V + j, 0],
            w[_V + j, 1],
            w[_V + j, 2],
            s0 + w[_FADED + j, 0] + w[_Z + j, 0],
            s1 + w[_FADED + j, 1] + w[_Z + j, 1],
            s2 + w[_FADED + j, 2] + w[_Z + j, 2],
        )
        w[_SLOW_RATES + j, 0], w[_SLOW_RATES + j, 1], w[_SLOW_RATES + j, 2] = f[0], f[1], f[2]
        z0, z1, z2 = 0.0, 0.0, 0.0
        for m in range(_STAGES):
            z0 += _A_INVERSE[j, m] * w[_Z + m, 0]
            z1 += _A_INVERSE[j, m] * w[_Z + m, 1]
            z2 += _A_INVERSE[j, m] * w[_Z + m, 2]
        w[_RESIDUAL + j, 0] = (f[3] - w[_FADING + j, 0] - z0 * inverse) * (k0 / (shift + max(0.0, c[_G, 0] * f[6])))
        w[_RESIDUAL + j, 1] = (f[4] - w[_FADING + j, 1] - z1 * inverse) * (k1 / (shift + max(0.0, c[_G + 1, 1] * f[7])))
        w[_RESIDUAL + j, 2] = (f[5] - w[_FADING + j, 2] - z2 * inverse) * (k2 / (shift + max(0.0, c[_G + 2, 2] * f[8])))
    moved = 0.0
    for j in range(_STAGES):
        for i in range(3):
            v = 0.0
            for m in range(_STAGES):
                v += _A[j, m] * w[_SLOW_RATES + m, i]
            v = y[_SLOW, i] + h * v
            moved = max(moved, abs(v - w[_V + j, i]))
            w[_V + j, i] = v
    return float(moved / w[_LIMITS, 1])


@compiled
def _correct(w: Array, z: Complex) -> float:
    """Solve for the Newton correction of Z and add it; return its size relative to the scale of σ."""
    x = z[3 * _PAIRS :]
    for p in range(_PAIRS):
        for i in range(3):
            r = 0.0j
            for m in range(_STAGES):
                r += _T_INVERSE[p, m] * w[_RESIDUAL + m, i]
            x[p, i] = r
        r0, r1, r2 = x[p, 0], x[p, 1], x[p, 2]
        for i in range(3):
            x[p, i] = z[3 * p + i, 0] * r0 + z[3 * p + i, 1] * r1 + z[3 * p + i, 2] * r2
    size = 0.0
    for j in range(_STAGES):
        for i in range(3):
            d = 0.0
            for p in range(_PAIRS):
                d += _T[j, p].real * x[p, i].real - _T[j, p].imag * x[p, i].imag
            w[_Z + j, i] += d
            size = max(size, abs(d) / w[_SCALE, i])
    return size


@compiled
def _solve_stages(c: Array, law: Array, w: Array, z: Complex, y: Array, h: float, calm: bool, n: Counts) -> bool:
    """Solve the stage equations of a step; False if Newton's method does not converge."""
    last = math.inf
    for iteration in range(_NEWTON_LIMIT):
        n[_NEWTON] += 1
        moved = _residual(c, law, w, y, h, n)
        size = max(_correct(w, z) / w[_LIMITS, 2], moved)  # v forgets nothing
        if not size < math.inf:
            return False
        if iteration == 0:
            if size < (_NEWTON_CALM if calm else 1e-3 * _NEWTON_TOLERANCE):
                return True
        elif size >= 0.95 * last:
            return bool(size < _NEWTON_TOLERANCE)
        elif size * size < _NEWTON_TOLERANCE * (last - size):  # the geometric series of what is left
            return True
        last = size
    return False


@compiled
def _filtered(w: Array, z: Complex, h: float, f0: float, f1: float, f2: float) -> float:
    """Error estimate of σ of a solved step, for this σ̇ at its start, into `_ERR`; returns its relative size."""
    inverse = 1.0 / (_GAMMA * h)
    f0 += w[_SCRATCH, 0] * inverse
    f1 += w[_SCRATCH, 1] * inverse
    f2 += w[_SCRATCH, 2] * inverse
    size = 0.0
    for i in range(3):
        x = z[i, 0].real * f0 + z[i, 1].real * f1 + z[i, 2].real * f2
        w[_ERR, i] = x
        size = max(size, abs(x) / w[_SCALE, i])
    return size


@compiled
def _error(c: Array, law: Array, w: Array, z: Complex, y: Array, h: float, first: bool, n: Counts) -> float:
    """Size of the error of a solved step, relative to the scale of σ."""
    for i in range(3):
        x = 0.0
        for j in range(_STAGES):
            x += _ERROR[j] * w[_Z + j, i]
        w[_SCRATCH, i] = x
    d = w[_DRIFT]
    size = _filtered(w, z, h, d[0], d[1], d[2])
    if first and size > w[_LIMITS, 0]:  # σ̇ of a boundary layer says little about a step beyond it: filter once more
        n[_RATES] += 1
        v, s, e = y[_SLOW], y[_SLIP], w[_ERR]
        f = _rates(c, law, w, v[0], v[1], v[2], s[0] + e[0], s[1] + e[1], s[2] + e[2])
        r = w[_SLIP_RATE]  # less the layer
        size = _filtered(w, z, h, f[3] - r[0] + d[0], f[4] - r[1] + d[1], f[5] - r[2] + d[2])
    return size


@compiled
def _start_plainly(w: Array, i: int, guess: float, h: float) -> None:
    """Leave all of a wheel's σ̇ to the stages; guess Z by a steady rate."""
    w[_DRIFT, i] = w[_SLIP_RATE, i]
    for j in range(_STAGES):
        w[_FADING + j, i] = 0.0
        w[_FADED + j, i] = 0.0
        w[_Z + j, i] = _NODES[j] * h * guess


@compiled
def _take_out_layer(c: Array, law: Array, w: Array, y: Array, h: float, n: Counts) -> None:
    """Split σ̇ at the start of a calm step into a layer that fades at the wheel's own rate and the drift that is left.

    The drift is that of the slow manifold, which moves with v: it undoes what v̇ makes of σ̇ until the end.
    """
    n[_RATES] += 1
    v, s, a = y[_SLOW], y[_SLIP], w[_SLOW_RATE]
    f = _rates(c, law, w, v[0] + h * a[0], v[1] + h * a[1], v[2] + h * a[2], s[0], s[1], s[2])
    w[_SCRATCH, 0], w[_SCRATCH, 1], w[_SCRATCH, 2] = f[0] - a[0], f[1] - a[1], f[2] - a[2]
    w[_DRIFT, 0], w[_DRIFT, 1], w[_DRIFT, 2] = f[3], f[4], f[5]
    for i in range(3):
        for j in range(_STAGES):
            w[_V + j, i] = v[i] + _NODES[j] * h * (a[i] + 0.5 * _NODES[j] * w[_SCRATCH, i])
        k, rate = w[_STIFFNESS, i], w[_SLIP_RATE, i]
        if k * h < _SLOW_ENOUGH:
            _start_plainly(w, i, rate, h)
            continue
        drift = (w[_DRIFT, i] - rate) / (h * k)
        w[_DRIFT, i] = drift
        for j in range(_STAGES):
            left = math.exp(-k * h * _NODES[j])
            w[_FADING + j, i] = (rate - drift) * left
            w[_FADED + j, i] = (rate - drift) * (1.0 - left) / k
            w[_Z + j, i] = _NODES[j] * h * drift


@compiled
def _attempt(
    c: Array, law: Array, w: Array, z: Complex, y: Array, h: float, calm: bool, first: bool, n: Counts
) -> float:
    """Solve a step of length h; return its error, infinite without a solution."""
    n[_LU] += _PAIRS
    for p in range(_PAIRS):
        _invert(_MU[p] / h, w[_JACOBIAN : _JACOBIAN + 3], z[3 * p : 3 * p + 3])
    if calm:
        _take_out_layer(c, law, w, y, h, n)
    else:
        for i in range(3):
            _start_plainly(w, i, 0.0, h)
            for j in range(_STAGES):
                w[_V + j, i] = y[_SLOW, i] + _NODES[j] * h * w[_SLOW_RATE, i]
    if not _solve_stages(c, law, w, z, y, h, calm, n):
        return math.inf
    return _error(c, law, w, z, y, h, first, n)


@compiled
def _accept(c: Array, w: Array, y: Array, h: float) -> None:
    """Move to the end of a solved step: pose and wheel angles by the method's quadrature, v and σ of the last stage."""
    for j in range(_STAGES):
        for i in range(3):
            w[_ERR, i] = y[_SLIP, i] + w[_FADED + j, i] + w[_Z + j, i]
        x0, x1, x2, _ = _twist(c, w[_V + j], w[_ERR])
        w[_SLOW_RATES + j, 0], w[_SLOW_RATES + j, 1], w[_SLOW_RATES + j, 2] = x0, x1, x2
        for i in range(3):
            rim = c[_JR + i, 0] * x0 + c[_JR + i, 1] * x1 + c[_JR + i, 2] * x2 - w[_ERR, i]  # r φ̇
            y[_ANGLE, i] += h * _WEIGHTS[j] * c[_WHEEL, 0] * rim
    heading = y[_POSE, 2]
    for j in range(_STAGES):
        turn = 0.0
        for m in range(_STAGES):
            turn += _A[j, m] * w[_SLOW_RATES + m, 2]
        turn = heading + h * turn
        x0, x1 = w[_SLOW_RATES + j, 0], w[_SLOW_RATES + j, 1]
        y[_POSE, 0] += h * _WEIGHTS[j] * (math.cos(turn) * x0 - math.sin(turn) * x1)
        y[_POSE, 1] += h * _WEIGHTS[j] * (math.sin(turn) * x0 + math.cos(turn) * x1)
        y[_POSE, 2] = turn  # the last node is the end of the step
    for i in range(3):
        y[_SLOW, i] = w[_V + _STAGES - 1, i]
        y[_SLIP, i] += w[_FADED + _STAGES - 1, i] + w[_Z + _STAGES - 1, i]


@compiled
def _relaxation(w: Array, rest: float) -> float:
    """Factor on the error of σ that a step may have whose end is `rest` seconds before that of the period."""
    if w[_LIMITS, 0] < _TOLERANCE:
        return 1.0
    slowest = min(w[_STIFFNESS, 0], w[_STIFFNESS, 1], w[_STIFFNESS, 2])
    return math.exp(min(0.5 * slowest * rest, _RELAXED))


@compiled
def advance(c: Array, law: Array, y: Array, torque: Array, period: float, w: Array, z: Complex, n: Counts) -> bool:
    """Integrate one period with the torque held; False if that failed, y being the state that was reached."""
    _drive(c, w, torque)
    _skip_layer(c, law, w, y, period, n)
    if not _begin(c, law, w, y, n):
        return False
    calm = _is_calm(c, w, period)
    rest, first = period, True
    h = _first_step(w, calm, period)
    for _ in range(_ATTEMPT_LIMIT):
        h = min(h, period if calm else 0.5 * period)
        if 1.2 * h >= rest:
            h = rest
        w[_LIMITS, 2] = _relaxation(w, rest - h)
        error = _attempt(c, law, w, z, y, h, calm, first, n) / (w[_LIMITS, 0] * w[_LIMITS, 2])
        if error < 1.0:
            _accept(c, w, y, h)
            n[_STEPS] += 1
            rest -= h
            if rest <= 0.0:
                return True
            if not _begin(c, law, w, y, n):
                return False
            calm = _is_calm(c, w, period)
            first = False
            h *= min(10.0, 1.1 * (error + 1e-30) ** (-1.0 / (_STAGES + 1)))
        else:
            n[_REJECTED] += 1
            first = True
            h *= max(0.1, 0.8 * error ** (-1.0 / (_STAGES + 1)))
            if not h > _SHORTEST * period:
                return False
    return False


@compiled
def observe(c: Array, law: Array, y: Array, out: Array) -> None:
    """Write what can be seen of a state: pose, body twist, wheel speeds, slip ratios and wheel forces, 15 numbers."""
    x, y_, turn, speed = _twist(c, y[_SLOW], y[_SLIP])
    scale = 1.0 / (speed + c[_SPEED, 1])
    for i in range(3):
        out[3 * _SEEN_POSE + i] = y[_POSE, i]
        slip = y[_SLIP, i]
        rim = c[_JR + i, 0] * x + c[_JR + i, 1] * y_ + c[_JR + i, 2] * turn - slip  # r φ̇
        out[3 * _SEEN_WHEEL_SPEED + i] = c[_WHEEL, 0] * rim
        out[3 * _SEEN_SLIP_RATIO + i] = slip * scale
        out[3 * _SEEN_FORCE + i] = -curve(law, slip * scale)[0]
    out[3 * _SEEN_TWIST], out[3 * _SEEN_TWIST + 1], out[3 * _SEEN_TWIST + 2] = x, y_, turn


# ----------------------------------------------------------------------------------------------------------- Plant


class Observation(NamedTuple):
    """What can be seen of a plant, arrays of shape (3,); units and frames as those of its properties."""

    pose: Array
    body_twist: Array
    wheel_speed: Array
    slip_ratio: Array
    wheel_force: Array


class Plant:
    """The robot on the floor: torque in, motion out, float64, one control period a step.

    Same state and torque, same bits: nothing is remembered from one step to the next but the state.

    Parameters
    ----------
    robot : Robot
    traction : Traction
        Of a robot with ε = 0 the wheels do not slip at all.
    speed_length_m : float
        ℓ of the speed V = (νx² + νy² + (ℓ ω)²)^½ that slip ratios refer to (14).
    delta_m_per_s : float
        δ, added to V.

    Attributes
    ----------
    diverged : bool
        Whether a step came upon a number that is not finite, or found no solution; it stays so until `reset`.
    """

    def __init__(
        self, robot: Robot, traction: Traction, speed_length_m: float = 1.0, delta_m_per_s: float = 1e-3
    ) -> None:
        if not (0.0 <= speed_length_m < math.inf and 0.0 < delta_m_per_s < math.inf):
            raise OmnibotError(
                f"the plant needs a speed length from 0 m up and a delta above 0 m/s, not {speed_length_m:g}, "
                f"{delta_m_per_s:g}"
            )
        self.robot = robot
        self.traction = traction
        self.speed_length_m = speed_length_m
        self.delta_m_per_s = delta_m_per_s
        self.diverged = False
        self._law = traction.law
        self._constants = _constants(robot, traction, speed_length_m, delta_m_per_s)
        self._state = np.zeros((4, 3))
        self._torque = np.zeros(3)
        self._observation: Observation | None = None
        self._work = np.zeros((_WORK_ROWS, 3))
        self._inverses = np.zeros((4 * _PAIRS, 3), dtype=np.complex128)
        self._count = np.zeros(_COUNTERS, dtype=np.int64)

    def reset(self, pose: ArrayLike, twist: ArrayLike, slip_velocity: ArrayLike = 0.0) -> None:
        """Put the robot at a pose (m, m, rad) with a body twist (m/s, m/s, rad/s) and slip velocities (m/s).

        Torque and wheel angles become 0; the counters go on.
        """
        self._state[_POSE] = pose
        self._state[_SLIP] = 0.0 if self.traction.rigid else slip_velocity
        self._state[_SLOW] = np.asarray(twist, dtype=np.float64) - self._constants[_K : _K + 3] @ self._state[_SLIP]
        self._state[_ANGLE] = 0.0
        self._torque[:] = 0.0
        self._observation = None
        self.diverged = False

    def step(self, torque_Nm: ArrayLike, period_s: float) -> None:
        """Integrate one period with the torques of the motors, shape (3,), held."""
        if not period_s > 0.0:
            raise OmnibotError(f"a period of {period_s:g} s: it must be above 0")
        self._torque[:] = torque_Nm
        if not advance(*self.arrays[:3], self._torque, period_s, *self.arrays[3:]):
            self.diverged = True

    def accelerations(self, torque_Nm: ArrayLike) -> tuple[Array, Array]:
        """ν̇ (m/s², m/s², rad/s²) and φ̈ (rad/s²) that these torques cause now, shapes (3,) and (3,)."""
        w = np.zeros((_WORK_ROWS, 3))
        _drive(self._constants, w, np.asarray(torque_Nm, dtype=np.float64))
        _rates_at(self._constants, self._law, w, self._state[_SLOW], self._state[_SLIP])
        body = w[_SLOW_RATE] + self._constants[_K : _K + 3] @ w[_SLIP_RATE]
        return body, (self.robot.Jr @ body - w[_SLIP_RATE]) / self.robot.wheel_radius_m

    # ------------------------------------------------------------------------------------------------------- State

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Complex, Counts]:
        """What `advance` and `observe` work on: constants, traction law, state; work space, inverses, counters.

        Whoever takes them may move the state: what was seen before is forgotten.
        """
        self._observation = None
        return self._constants, self._law, self._state, self._work, self._inverses, self._count

    def observe(self) -> Observation:
        """Everything that can be seen, at once; read-only, and computed once a state."""
        if self._observation is None:
            self._observation = self._observe()
        return self._observation

    def _observe(self) -> Observation:
        seen = np.empty(3 * _SEEN_ROWS)
        observe(self._constants, self._law, self._state, seen)
        if self.traction.rigid:
            _, acceleration = self.accelerations(self._torque)
            force = (self._torque - self.robot.wheel_inertia_kg_m2 * acceleration) / self.robot.wheel_radius_m
            seen[3 * _SEEN_FORCE :] = force
        seen.setflags(write=False)
        return Observation(*seen.reshape(_SEEN_ROWS, 3))

    @property
    def pose(self) -> Array:
        """Position of the body frame in m and heading in rad, in the world frame, shape (3,)."""
        return self.observe().pose

    @property
    def body_twist(self) -> Array:
        """ν: velocity of the body in its own frame, m/s, m/s, rad/s, shape (3,)."""
        return self.observe().body_twist

    @property
    def slip_velocity(self) -> Array:
        """σ: speed of the contact points over the floor along the drive directions, m/s, shape (3,)."""
        return np.array(self._state[_SLIP])

    @property
    def speed(self) -> float:
        """V of (14), m/s."""
        return float(_twist(self._constants, self._state[_SLOW], self._state[_SLIP])[3])

    @property
    def slip_ratio(self) -> Array:
        """Slip ratios s = σ / (V + δ), shape (3,)."""
        return self.observe().slip_ratio

    @property
    def wheel_speed(self) -> Array:
        """φ̇, rad/s, shape (3,)."""
        return self.observe().wheel_speed

    @property
    def wheel_angle(self) -> Array:
        """φ since the reset, rad, shape (3,)."""
        return np.array(self._state[_ANGLE])

    @property
    def wheel_force(self) -> Array:
        """λ: force of the floor on each wheel along its drive direction, N, shape (3,).

        Of a rigid robot it is the one that keeps the wheels from slipping under the torque of the last step.
        """
        return self.observe().wheel_force

    # ---------------------------------------------------------------------------------------------------- Counters

    @property
    def steps(self) -> int:
        """Steps of the integrator that were accepted."""
        return int(self._count[_STEPS])

    @property
    def rejected(self) -> int:
        """Steps that were tried again, shorter."""
        return int(self._count[_REJECTED])

    @property
    def layers_skipped(self) -> int:
        """Periods whose boundary layer was not resolved."""
        return int(self._count[_SKIPPED])

    @property
    def newton_iterations(self) -> int:
        """Newton iterations of the stage equations."""
        return int(self._count[_NEWTON])

    @property
    def nfev(self) -> int:
        """Evaluations of the right-hand side."""
        return int(self._count[_RATES])

    @property
    def njev(self) -> int:
        """Evaluations of the Jacobian."""
        return int(self._count[_JACOBIANS])

    @property
    def nlu(self) -> int:
        """Matrices of three rows that were inverted."""
        return int(self._count[_LU])


def _constants(robot: Robot, traction: Traction, speed_length_m: float, delta_m_per_s: float) -> Array:
    """Lay the constants out in rows, as the compiled functions read them."""
    jr, mo, r, iw = robot.Jr, robot.Mo, robot.wheel_radius_m, robot.wheel_inertia_kg_m2
    mv = np.diag(mo) + iw / r**2 * jr.T @ jr  # Mo + Iw JᵀJ
    c = np.zeros((_CONSTANT_ROWS, 3))
    c[_JR : _JR + 3] = jr
    c[_K : _K + 3] = np.linalg.solve(mv, jr.T * (iw / r**2))
    c[_DRIVE : _DRIVE + 3] = np.linalg.solve(mv, jr.T / r)
    c[_COUPLING : _COUPLING + 3] = np.linalg.solve(mv, np.diag(mo))
    c[_SPEED] = speed_length_m**2, delta_m_per_s, 1.0
    c[_CURVE] = math.inf, math.inf, 0.0
    c[_WHEEL, 0] = 1.0 / r
    if traction.rigid:  # no force and no drive reach σ, which stays 0
        return c
    c[_G : _G + 3] = jr / mo @ jr.T + r**2 / iw * np.eye(3)
    c[_PUSH : _PUSH + 3] = jr
    c[_TORQUE, 0] = r / iw
    stiffness = traction.stiffness_N
    c[_SPEED, 2] = 1.0 / stiffness
    c[_CURVE] = traction.peak_slip, traction.friction_limit_N, stiffness
    if math.isfinite(traction.peak_slip):
        push = jr / mo * [1.0, 1.0, speed_length_m]
        c[_TORQUE, 1] = traction.peak_slip * traction.friction_limit_N * float(np.sum(np.linalg.norm(push, axis=1)))
    return c
