"""As fast along a course as limits allow: speed, acceleration, jerk, wheel speed, wheel force and wheel torque.

Along a section of the course, whose parameter is u, let x(u) = u̇². With q(u) = (p1, p2, heading) and ' for d/du

    q̇ = q' √x        q̈ = q'' x + q' x'/2        q⃛ = (q''' x + 3/2 q'' x' + q' x''/2) √x

so limits of speed, acceleration, force and torque are linear or second-order cones in (x, x'), and the time, the
integral of x^(-1/2), is convex: a cone program with one optimum (Verscheure et al., "Time-optimal path tracking for
robots: a convex optimization approach", IEEE TAC 2009), solved by Clarabel. x is a cubic spline, so that the jerk is
continuous. In the jerk's limit √x is that of the round before, times a margin within which x must stay: each round is a
cone program again, and what it finds keeps the limit.

x of a start from rest goes like u^(4/3), which no polynomial does. So a section starts and ends by a short ramp that is
a polynomial of the time, and x spans what is between.

The result is cut into polynomials of degree 7 through position and three derivatives at the spline's knots. They are
then looked at as they will be sent, and the time is stretched by the little that the limits ask for. So the limits hold
for the reference itself, at every instant looked at; that nothing is faster holds to within a few percent.
"""

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import clarabel
import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline

from host_sim.course import Course, Section
from host_sim.errors import OmnibotError
from host_sim.limits import Limits, motion_of, wheel_demand
from host_sim.robot import Robot
from host_sim.trajectory import MAX_SEGMENTS, MAX_TOTAL_US, Array, Segment, Trajectory, hermite

FIT_TOLERANCE_M = 1e-4  # by which the polynomials may miss course and speed, heading times the wheel distance likewise

_PER_INTERVAL = 4  # points of an interval between knots at which the limits are set
_ROUNDS = 8
_SLOWEST = 0.02  # |dq/du| that is taken for no less: at a turning point of the path it is 0
_UNLIMITED = 1e-9  # 1/s, of a speed of u that nothing limits
_MARGIN = 1.2  # by which x may grow from one round to the next
_ENOUGH = 2e-3  # a round that saves less of the time is the last one
_RAMP_SHARE = 0.5  # of the largest acceleration at rest, at the end of the first ramp
_RAMP_JERK_SHARE = 0.9 / 1.875  # mean of the ramp's jerk to the limit; its peak is 1.875 times the mean
_RAMP_REACH = 0.03  # of a section that a ramp takes at most
_FEWEST_INTERVALS = 16
_ROUGH_INTERVALS = (24, 48, 96)  # tried in turn
_PIECE_S = 0.05  # a piece is about as long, if there are enough of them
_QUADRATURE = np.polynomial.legendre.leggauss(10)


# ------------------------------------------------------------------------------------------------- the demand on x


@dataclass(frozen=True, eq=False)
class _Demand:
    """What is asked at values of u, as coefficients of x, x' and x'': acceleration a0 x + a1 x', and so on."""

    first: Array  # q', shape (n, 3), heading times the wheel distance
    second: Array  # q''
    third: Array  # q'''
    wheel_speed: Array  # shape (n, 3), of √x
    force: tuple[Array, Array]  # of x and of x', each of shape (n, 3)
    torque: tuple[Array, Array]

    @classmethod
    def of(cls, section: Section, robot: Robot, u: Array) -> "_Demand":
        """Look at a section."""
        q = section.derivatives(u)
        speed, force_x, torque_x = wheel_demand(robot, q[:, 0, 2], q[:, 1], q[:, 2])
        _, force_dx, torque_dx = wheel_demand(robot, q[:, 0, 2], np.zeros_like(q[:, 1]), 0.5 * q[:, 1])
        scaled = q * np.array([1.0, 1.0, robot.wheel_distance_m])
        return cls(scaled[:, 1], scaled[:, 2], scaled[:, 3], speed, (force_x, force_dx), (torque_x, torque_dx))

    def ceiling(self, limits: Limits) -> Array:
        """Largest x that speed and wheel speed allow, shape (n,)."""
        per_speed = np.maximum(_size(self.first), _SLOWEST) / limits.of("speed_m_per_s")
        per_wheel = np.max(np.abs(self.wheel_speed), axis=1) / limits.of("wheel_speed_rad_per_s")
        return np.asarray(np.maximum(np.maximum(per_speed, per_wheel), _UNLIMITED) ** -2.0)

    def excess(self, limits: Limits, u_dot: Array, u_ddot: Array, u_dddot: Array) -> float:
        """Largest share of a limit that is used, all of shape (n,)."""
        x, dx = u_dot**2, 2.0 * u_ddot
        accel = self.second * x[:, None] + 0.5 * self.first * dx[:, None]
        jerk = self.third * (u_dot**3)[:, None] + 3.0 * self.second * (u_dot * u_ddot)[:, None]
        jerk = jerk + self.first * u_dddot[:, None]
        force = self.force[0] * x[:, None] + self.force[1] * dx[:, None]
        torque = self.torque[0] * x[:, None] + self.torque[1] * dx[:, None]
        return max(
            float(np.sqrt(np.max(x / self.ceiling(limits)))),
            float(np.max(_size(accel))) / limits.of("accel_m_per_s2"),
            float(np.max(_size(jerk))) / limits.of("jerk_m_per_s3"),
            float(np.max(np.abs(force))) / limits.of("wheel_force_N"),
            float(np.max(np.abs(torque))) / limits.of("wheel_torque_Nm"),
        )


def _size(vectors: Array) -> Array:
    return np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), np.abs(vectors[:, 2]))


# ----------------------------------------------------------------------------------------------------------- ramps


@dataclass(frozen=True)
class _Ramp:
    """From rest to an acceleration, the jerk rising and falling as 30 s² (1 - s)² times its mean; s = t / duration."""

    jerk: float  # mean, of u
    duration_s: float

    @property
    def reach(self) -> float:
        """How far u gets."""
        return self.jerk * self.duration_s**3 / 7.0

    @property
    def end(self) -> tuple[float, float]:
        """u̇ and ü at the end, where the jerk is 0."""
        return 0.5 * self.jerk * self.duration_s**2, self.jerk * self.duration_s

    def states(self, time_s: Array) -> Array:
        """Return u and three time derivatives, shape (n, 4), at times of shape (n,)."""
        s, unit = time_s / self.duration_s, self.jerk * self.duration_s ** np.arange(3, -1, -1)
        shape = [_polynomial(_RAMP, s, order) for order in (3, 2, 1, 0)]
        return np.stack(shape, axis=1) * unit


_RAMP = np.array([0.0, 0.0, 30.0, -60.0, 30.0])


def _polynomial(coefficients: Array, s: Array, integrals: int) -> Array:
    polynomial = np.polynomial.polynomial
    return np.asarray(polynomial.polyval(s, polynomial.polyint(coefficients, integrals)))


def _ramp(section: Section, robot: Robot, limits: Limits, *, at_end: bool) -> _Ramp:
    """Return a ramp up, or the mirror image of a ramp down, that keeps all limits."""

    def demand(u: Array) -> _Demand:
        return _Demand.of(section, robot, section.length - u if at_end else u)

    still, one = np.zeros(1), np.ones(1)
    unlimited = replace(limits, jerk_m_per_s3=None)
    acceleration = _RAMP_SHARE / demand(still).excess(unlimited, still, one, still)
    only_jerk = Limits(jerk_m_per_s3=limits.jerk_m_per_s3)
    jerk = _RAMP_JERK_SHARE / demand(still).excess(only_jerk, still, still, one)
    by_speed = math.sqrt(jerk * math.sqrt(float(demand(still).ceiling(limits)[0])))
    by_reach = (7.0 * jerk**2 * _RAMP_REACH * section.length) ** (1.0 / 3.0)
    acceleration = min(acceleration, by_speed, by_reach)
    while True:
        ramp = _Ramp(jerk, acceleration / jerk)
        states = ramp.states(np.linspace(0.0, ramp.duration_s, 50))
        if demand(states[:, 0]).excess(limits, *states[:, 1:].T) < 0.95:
            return ramp
        jerk, acceleration = 0.8 * jerk, 0.8 * acceleration


# --------------------------------------------------------------------------------------------------- speed profile


@dataclass(frozen=True, eq=False)
class _Profile:
    """Speed along a section: a ramp, a cubic spline of x = u̇² over u, a ramp mirrored."""

    section: Section
    up: _Ramp
    down: _Ramp
    x: BSpline
    knots: Array  # of the spline, without repetition

    def time_between(self) -> Array:
        """Time from each knot to the next, shape (knots - 1,) in s."""
        nodes, weights = _QUADRATURE
        half = 0.5 * np.diff(self.knots)
        u = self.knots[:-1, None] + half[:, None] * (1.0 + nodes)
        return np.asarray(half * (np.maximum(self.x(u), 1e-12) ** -0.5 @ weights))

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.up.duration_s + float(np.sum(self.time_between())) + self.down.duration_s

    def states(self, u: Array) -> Array:
        """Return u and three time derivatives between the ramps, shape (n, 4), at u of shape (n,)."""
        speed = np.sqrt(np.maximum(self.x(u), 0.0))
        return np.stack([u, speed, 0.5 * self.x(u, 1), 0.5 * self.x(u, 2) * speed], axis=1)


def _spread(u: Array, speed: Array, busy: Array, intervals: int) -> Array:
    """Return knots, shape (intervals + 1,), half of them even in time, half even over the busy part of it.

    Parameters
    ----------
    u, speed, busy
        Shape (n,), rising; u̇; how busy it is there, 0 … 1.
    """
    rate = 1.0 / np.maximum(speed, 1e-9)
    wanted = _share(u, rate)
    if np.any(busy > 0.0):
        wanted = 0.5 * (wanted + _share(u, rate * busy))
    return np.asarray(np.interp(np.linspace(0.0, 1.0, intervals + 1), wanted, u))


def _share(u: Array, weight: Array) -> Array:
    """Integral of a weight up to each u, of the whole."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(u))])
    return np.asarray(integral / integral[-1])


def _first_knots(section: Section, robot: Robot, limits: Limits, ramps: tuple[_Ramp, _Ramp], intervals: int) -> Array:
    """Knots by a guess: the speed that bends allow, passed forwards and backwards with the acceleration at rest."""
    reach, ends = [ramp.reach for ramp in ramps], [ramp.end for ramp in ramps]
    within = section.length - sum(reach)
    # Dense at both ends: a crawl gets to its speed within a thousandth of the way.
    part = np.concatenate([np.geomspace(1e-10, 0.01, 200), np.linspace(0.01, 0.99, 2001)[1:-1]])
    part = np.concatenate([[0.0], part, 1.0 - part[199::-1], [1.0]])
    u = reach[0] + within * part
    demand = _Demand.of(section, robot, u)
    bend = np.maximum(_size(demand.second), 1e-9)
    x = np.minimum(demand.ceiling(limits), limits.of("accel_m_per_s2") / bend)
    x[0], x[-1] = ends[0][0] ** 2, ends[1][0] ** 2
    ceiling, steps = x.copy(), np.diff(u)
    for k, step in enumerate(steps):
        x[k + 1] = min(x[k + 1], x[k] + 4.0 * ends[0][1] * step)
    for k, step in reversed(list(enumerate(steps))):
        x[k] = min(x[k], x[k + 1] + 4.0 * ends[1][1] * step)
    return _spread(u, np.sqrt(x), (x < 0.98 * ceiling).astype(np.float64), intervals)


def _next_knots(profile: _Profile, robot: Robot, limits: Limits, intervals: int) -> Array:
    """Knots where the jerk of a first solution is near its limit."""
    u = np.concatenate([np.linspace(a, b, 9)[:-1] for a, b in pairwise(profile.knots)] + [profile.knots[-1:]])
    states = profile.states(u)
    along = np.abs(states[:, 3]) * _size(_Demand.of(profile.section, robot, u).first)
    return _spread(u, states[:, 1], np.clip(along / limits.of("jerk_m_per_s3"), 0.0, 1.0), intervals)


@dataclass(frozen=True, eq=False)
class _Block:
    """Rows of a cone program: bound - matrix z lies in the cones."""

    matrix: sparse.csr_matrix
    bound: Array
    cones: Sequence[object]


class _Program:
    """The cone program for x on given knots.

    Its unknowns z: the spline's coefficients; s ≤ √x; t ≥ 1/s. All are taken in units of a guess of x, and each row in
    units of its limit, so that a crawl is solved as well as a dash.
    """

    def __init__(
        self,
        section: Section,
        robot: Robot,
        limits: Limits,
        ramps: tuple[_Ramp, _Ramp],
        knots: Array,
    ) -> None:
        self.section, self.limits, self.ramps, self.knots = section, limits, ramps, knots
        steps = np.arange(_PER_INTERVAL) / _PER_INTERVAL
        self.u = np.concatenate([(knots[:-1, None] + np.diff(knots)[:, None] * steps).ravel(), knots[-1:]])
        self.demand = _Demand.of(section, robot, self.u)
        self.ceiling = self.demand.ceiling(limits)
        clamped = np.concatenate([knots[:1].repeat(3), knots, knots[-1:].repeat(3)])
        self.basis = BSpline(clamped, np.eye(len(knots) + 2), 3)

    def solve(self, allowed: Array | None, *, with_jerk: bool) -> _Profile | None:
        """Return the fastest profile, None if there is none; ``allowed``: the most that x may be at ``self.u``."""
        ceiling = self.ceiling if allowed is None else np.minimum(self.ceiling, allowed)
        guess = np.minimum(ceiling, self._reachable())
        averages = np.lib.stride_tricks.sliding_window_view(self.basis.t[1:-1], 3).mean(axis=1)
        unit = np.interp(averages, self.u, guess)
        x = [sparse.csr_matrix(self.basis(self.u, order) * unit) for order in range(3)]
        blocks = [self._ends(x), self._below(x[0], ceiling), *self._wheels(x), *self._acceleration(x)]
        if with_jerk:
            blocks += self._jerk(x, self.limits.of("jerk_m_per_s3") / np.sqrt(ceiling))
        # What all these rows say is of x alone.
        points = len(self.u)
        alone = sparse.vstack([block.matrix for block in blocks])
        padded = sparse.hstack([alone, sparse.csr_matrix((alone.shape[0], 2 * points))])
        time = _time_block(x[0], guess)
        cones = [cone for block in [*blocks, time] for cone in block.cones]
        bound = np.concatenate([block.bound for block in [*blocks, time]])
        cost = np.concatenate([np.zeros(len(unit) + points), np.gradient(self.u) / np.sqrt(guess)])
        found = _solution(cost, sparse.vstack([padded, time.matrix], format="csc"), bound, cones)
        if found is None:
            return None
        return _Profile(self.section, *self.ramps, BSpline(self.basis.t, found[: len(unit)] * unit, 3), self.knots)

    def _reachable(self) -> Array:
        """Guess x between the ramps."""
        (speed0, accel0), (speed1, accel1) = (ramp.end for ramp in self.ramps)
        behind, ahead = self.u - self.u[0], self.u[-1] - self.u
        return np.asarray(np.minimum(speed0**2 + 4.0 * accel0 * behind, speed1**2 + 4.0 * accel1 * ahead))

    def _ends(self, x: Sequence[sparse.csr_matrix]) -> _Block:
        """Start and end as the ramps do."""
        bound, rows = [], []
        for at, ramp, sign in ((0, self.ramps[0], 1.0), (-1, self.ramps[1], -1.0)):
            speed, accel = ramp.end
            rows += [x[0][[at]] / speed**2, x[1][[at]] / accel, x[2][[at]] * (speed / accel) ** 2]
            bound += [1.0, 2.0 * sign, 0.0]
        return _Block(sparse.vstack(rows), np.array(bound), [clarabel.ZeroConeT(6)])

    def _below(self, x: sparse.csr_matrix, ceiling: Array) -> _Block:
        """Keep below the ceiling; the ends are given."""
        rows = _scaled(x, 1.0 / ceiling)[1:-1]
        return _Block(rows, np.ones(len(ceiling) - 2), [clarabel.NonnegativeConeT(len(ceiling) - 2)])

    def _wheels(self, x: Sequence[sparse.csr_matrix]) -> list[_Block]:
        blocks = []
        for name, (of_x, of_dx) in (("wheel_force_N", self.demand.force), ("wheel_torque_Nm", self.demand.torque)):
            for wheel in range(3):
                used = _scaled(x[0], of_x[:, wheel]) + _scaled(x[1], of_dx[:, wheel])
                blocks += _within(used / self.limits.of(name))
        return blocks

    def _acceleration(self, x: Sequence[sparse.csr_matrix]) -> list[_Block]:
        of_x, of_dx = self.demand.second, 0.5 * self.demand.first
        limit = self.limits.of("accel_m_per_s2")
        used = [(_scaled(x[0], of_x[:, k]) + _scaled(x[1], of_dx[:, k])) / limit for k in range(3)]
        return [*_within(used[2]), _disc(used[0], used[1])]

    def _jerk(self, x: Sequence[sparse.csr_matrix], most: Array) -> list[_Block]:
        """Keep the jerk over √x below ``most``."""
        factors = (self.demand.third, 1.5 * self.demand.second, 0.5 * self.demand.first)
        used = [sum(_scaled(row, of[:, k] / most) for row, of in zip(x, factors, strict=True)) for k in range(3)]
        return [*_within(used[2]), _disc(used[0], used[1])]


def _time_block(x: sparse.csr_matrix, guess: Array) -> _Block:
    """Say that s ≤ √x and t ≥ 1/s, all in units of the guess.

    As cones: 4 s² + (x - 1)² ≤ (x + 1)², 4 + (t - s)² ≤ (t + s)².
    """
    points, unknowns = x.shape
    one, nothing = np.ones(points), sparse.csr_matrix((points, points))
    eye = sparse.eye_array(points, format="csr")
    x = sparse.hstack([_scaled(x, 1.0 / guess), nothing, nothing], format="csr")
    s = sparse.hstack([sparse.csr_matrix((points, unknowns)), eye, nothing], format="csr")
    t = sparse.hstack([sparse.csr_matrix((points, unknowns)), nothing, eye], format="csr")
    root = _cone([x, x, 2.0 * s], [one, -one, 0.0 * one])
    inverse = _cone([t + s, t - s, 0.0 * s], [0.0 * one, 0.0 * one, 2.0 * one])
    matrix = sparse.vstack([root.matrix, inverse.matrix])
    return _Block(matrix, np.concatenate([root.bound, inverse.bound]), [*root.cones, *inverse.cones])


def _solution(cost: Array, matrix: sparse.csc_matrix, bound: Array, cones: Sequence[object]) -> Array | None:
    """Solve: least cost z with bound - matrix z in the cones; None if there is none."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    none = sparse.csc_matrix((len(cost), len(cost)))
    solution = clarabel.DefaultSolver(none, cost, matrix, bound, list(cones), settings).solve()
    return np.array(solution.x) if str(solution.status) in {"Solved", "AlmostSolved"} else None


def _scaled(rows: sparse.csr_matrix, factor: Array) -> sparse.csr_matrix:
    return sparse.diags_array(factor).tocsr() @ rows


def _within(used: sparse.csr_matrix) -> list[_Block]:
    """-1 ≤ used ≤ 1."""
    bound, cones = np.ones(used.shape[0]), [clarabel.NonnegativeConeT(used.shape[0])]
    return [_Block(used, bound, cones), _Block(-used, bound, cones)]


def _disc(first: sparse.csr_matrix, second: sparse.csr_matrix) -> _Block:
    """first² + second² ≤ 1."""
    one = np.ones(first.shape[0])
    return _cone([0.0 * first, first, second], [one, 0.0 * one, 0.0 * one])


def _cone(rows: Sequence[sparse.csr_matrix], constants: Sequence[Array]) -> _Block:
    """Say that second and third row, with their constants, are together no larger than the first, point by point."""
    points = len(constants[0])
    order = np.arange(3 * points).reshape(3, points).T.ravel()
    matrix = -sparse.vstack(rows, format="csr")[order]
    bound = np.concatenate(constants)[order]
    return _Block(matrix, bound, [clarabel.SecondOrderConeT(3)] * points)


def _without_jerk(
    section: Section, robot: Robot, limits: Limits, ramps: tuple[_Ramp, _Ramp], intervals: int
) -> _Profile:
    """Return the fastest profile of a section without a limit of jerk."""
    knots = _first_knots(section, robot, limits, ramps, intervals)
    profile = _Program(section, robot, limits, ramps, knots).solve(None, with_jerk=False)
    if profile is None:
        stores = f"{MAX_SEGMENTS} segments, as many as the firmware stores"
        raise OmnibotError(f"the path bends too sharply or too often for {stores}; make it smoother or shorter")
    return profile


def _wanted(section: Section, robot: Robot, limits: Limits, ramps: tuple[_Ramp, _Ramp]) -> int:
    """How many intervals a section should have: enough to bend as it must, and by the time it takes."""
    for intervals in _ROUGH_INTERVALS:
        with contextlib.suppress(OmnibotError):
            rough = _without_jerk(section, robot, limits, ramps, intervals)
            enough = _FEWEST_INTERVALS if intervals == _ROUGH_INTERVALS[0] else intervals
            return max(enough, min(MAX_SEGMENTS, math.ceil(rough.duration_s / _PIECE_S)))
    return MAX_SEGMENTS


def _shared_out(wanted: Array) -> list[int]:
    """How many intervals each section gets, two pieces besides being its ramps'."""
    most = MAX_SEGMENTS - 2 * len(wanted)
    return [int(n) for n in np.floor(wanted * min(1.0, most / np.sum(wanted)))]


def _profile(section: Section, robot: Robot, limits: Limits, ramps: tuple[_Ramp, _Ramp], intervals: int) -> _Profile:
    """Return the fastest profile of a section with so many intervals between knots."""
    best = _without_jerk(section, robot, limits, ramps, intervals)
    coarse = _Program(section, robot, limits, ramps, best.knots)
    first = coarse.solve(1.02 * best.x(coarse.u), with_jerk=True)
    if first is None:
        return best
    knots = _next_knots(first, robot, limits, intervals)
    fine = _Program(section, robot, limits, ramps, knots)
    best, found = first, False
    for _ in range(_ROUNDS):
        following = fine.solve(_MARGIN * best.x(fine.u), with_jerk=True)
        if following is None:
            break
        saved = 1.0 - following.duration_s / best.duration_s
        best = following
        if found and saved < _ENOUGH:
            break
        found = True
    return best


# ---------------------------------------------------------------------------------------------------------- pieces


@dataclass(frozen=True, eq=False)
class _Timed:
    """A profile with its time stretched by a factor."""

    profile: _Profile
    stretch: float

    def pieces(self) -> list[Segment]:
        """Polynomials through the states at the knots, moved to whole microseconds; at rest at both ends."""
        time_s, states = self._nodes()
        time_us = np.round(time_s * 1e6)
        time_us[-1] = math.ceil(time_s[-1] * 1e6 - 1e-3)
        states[1:-1] = _moved(states[1:-1], (time_us - time_s * 1e6)[1:-1] * 1e-6)
        return hermite([int(us) for us in time_us], _chained(self.profile.section, states))

    def _nodes(self) -> tuple[Array, Array]:
        """Return times, shape (n,) in s, and u with three time derivatives, shape (n, 4)."""
        profile, length = self.profile, self.profile.section.length
        inner = profile.states(profile.knots)
        states = np.vstack([np.zeros(4), inner, [length, 0.0, 0.0, 0.0]])
        times = np.concatenate([[profile.up.duration_s], profile.time_between(), [profile.down.duration_s]])
        time_s = np.concatenate([[0.0], np.cumsum(times)]) * self.stretch
        return time_s, states * self.stretch ** -np.arange(4.0)

    def misfit(self, pieces: Sequence[Segment], wheel_distance_m: float) -> float:
        """Largest distance between polynomials and course at the same time, between the knots."""
        profile = self.profile
        knots, share = profile.knots, np.linspace(0.0, 1.0, 6)[1:-1]
        nodes, weights = _QUADRATURE
        width = np.diff(knots)[:, None] * share
        inner = knots[:-1, None, None] + 0.5 * width[:, :, None] * (1.0 + nodes)
        since = 0.5 * width * (np.maximum(profile.x(inner), 1e-12) ** -0.5 @ weights)
        begin_s = self._nodes()[0][1:-2]
        time_s = (begin_s[:, None] + since * self.stretch).ravel()
        exact = profile.section.derivatives((knots[:-1, None] + width).ravel())[:, 0]
        gap = Trajectory(pieces, _NO_PATH).evaluate(time_s, derivatives=0)[:, 0] - exact
        return float(np.max(_size(gap * np.array([1.0, 1.0, wheel_distance_m]))))


class _NoPath:
    """Stands for a path that nobody asks for."""

    def distance(self, points: Array) -> Array:
        return np.zeros(len(points))

    def outline(self) -> Array:
        return np.zeros((2, 2))


_NO_PATH = _NoPath()


def _moved(states: Array, by_s: Array) -> Array:
    """States a little later: Taylor's series."""
    moved = states.copy()
    for order in range(3):
        for step in range(1, 4 - order):
            moved[:, order] += states[:, order + step] * by_s**step / math.factorial(step)
    return moved


def _chained(section: Section, states: Array) -> Array:
    """(p1, p2, heading) and three time derivatives, shape (n, 4, 3), of those of u, shape (n, 4): chain rule."""
    q0, q1, q2, q3 = np.moveaxis(section.derivatives(states[:, 0]), 1, 0)
    d1, d2, d3 = (states[:, order, None] for order in (1, 2, 3))
    return np.stack([q0, q1 * d1, q2 * d1**2 + q1 * d2, q3 * d1**3 + 3.0 * q2 * d1 * d2 + q1 * d3], axis=1)


@dataclass(frozen=True, eq=False)
class FastDrive:
    """The fastest drive along a course: a trajectory, and by how much its polynomials miss course and speed."""

    course: Course
    robot: Robot
    profiles: Sequence[_Profile]
    stretch: float = 1.0

    @classmethod
    def along(cls, course: Course, robot: Robot, limits: Limits) -> "FastDrive":
        """Find it; speed, acceleration and jerk must be limited."""
        ramps = [(_ramp(s, robot, limits, at_end=False), _ramp(s, robot, limits, at_end=True)) for s in course.sections]
        wanted = [_wanted(section, robot, limits, r) for section, r in zip(course.sections, ramps, strict=True)]
        counts = _shared_out(np.array(wanted, dtype=np.float64))
        profiles = [_profile(s, robot, limits, r, n) for s, r, n in zip(course.sections, ramps, counts, strict=True)]
        drive = cls(course, robot, profiles)
        if drive.duration_s > MAX_TOTAL_US * 1e-6:
            lasts, most = f"{drive.duration_s:.1f} s within its limits", f"{MAX_TOTAL_US / 1e6:g} s"
            raise OmnibotError(f"the path takes {lasts}; the firmware stores at most {most}")
        for _ in range(2):
            slower = motion_of(drive.trajectory(), robot).slowdown(limits)
            drive = replace(drive, stretch=drive.stretch * max(1.0, slower))
        return drive

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.stretch * sum(profile.duration_s for profile in self.profiles)

    def trajectory(self) -> Trajectory:
        """Return it as the firmware will have it."""
        pieces = [piece for profile in self.profiles for piece in _Timed(profile, self.stretch).pieces()]
        return Trajectory(pieces, self.course.path).rounded()

    def misfit(self) -> float:
        """Largest distance between the polynomials and where they should be, m."""
        timed = [_Timed(profile, self.stretch) for profile in self.profiles]
        return max(one.misfit(one.pieces(), self.robot.wheel_distance_m) for one in timed)
