"""Trajectories along the known paths and through waypoints, at a steady speed or as fast as limits allow.

Steady drives have ramps from and to rest, and sharp or rounded corners. Joints of a trajectory fall on whole
microseconds. So that positions stay exact, the speed is changed by a hair (half a microsecond in the time of a side or
lap) to make a side of the polygon, a lap of a curve, last whole microseconds, and ramps and corner blends are rounded
up to an even number of them: the acceleration asked for is never exceeded.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np

from host_sim import waypoints
from host_sim.course import (
    Course,
    SplinePath,
    curve_course,
    resting_spline,
    rounded_polygon,
    spline_course,
    stopping_polygon,
)
from host_sim.curves import Circle, Curve, Lemniscate, Line
from host_sim.errors import OmnibotError
from host_sim.fastest import FIT_TOLERANCE_M, FastDrive
from host_sim.limits import NO_LIMITS, Limits, motion_of, robot_limits
from host_sim.robot import Robot, load_robot
from host_sim.trajectory import (
    AXES,
    COEFFICIENTS,
    MAX_DURATION_US,
    MAX_SEGMENTS,
    MAX_TOTAL_US,
    Array,
    Path,
    Polyline,
    Segment,
    Trajectory,
    hermite,
)

RHOMBUS_DIAGONAL_M = 6.28
CIRCLE_RADIUS_M = 1.0
LEMNISCATE_HALF_WIDTH_M = 1.5
LINE_LENGTH_M = 4.0  # of a line without a duration

SQUARE_SIDE_M = 2.0

PATHS = ("rhombus", "line", "circle", "lemniscate")  # that can be driven steadily
NAMED_PATHS = (*PATHS, "square")
CORNERS = ("sharp", "rounded")
PROFILES = ("steady", "fastest")

SPEED_M_PER_S = 0.5  # if nothing else is said
JERK_M_PER_S3 = 40.0  # of fastest drives, if nothing else is said: 2 m/s² within 50 ms
WIRE_REACH_M = 20.97  # of positions

_HALF_M, _CORNER_M = RHOMBUS_DIAGONAL_M / 2.0, SQUARE_SIDE_M / 2.0
# Vertices and, back at the first one too, headings.
_RHOMBUS: tuple[Array, Array] = (
    np.array([[_HALF_M, 0.0], [0.0, _HALF_M], [-_HALF_M, 0.0], [0.0, -_HALF_M]]),
    np.zeros(5),
)
_SQUARE: tuple[Array, Array] = (
    np.array([[_CORNER_M, -_CORNER_M], [_CORNER_M, _CORNER_M], [-_CORNER_M, _CORNER_M], [-_CORNER_M, -_CORNER_M]]),
    np.arange(0.0, 5.0) * (math.pi / 2.0),
)

_CUBIC_PEAK = 1.5  # slope of the cubic smoothstep at its middle
_QUINTIC_PEAK = 1.875  # the same of the quintic one
_SHORTEST_UNIT_S = 0.1  # a side or a lap lasts at least this long, so that whole microseconds do not matter
_SPEED_MARGIN = 1e-4  # by which the speed must stay below the limit, for the same reason
_FIT_TOLERANCE_M = 1e-7


@dataclass(frozen=True)
class PathRequest:
    """What to drive.

    Attributes
    ----------
    path
        ``rhombus``: diagonals of 6.28 m, centred at the origin, from (3.14, 0) counter-clockwise; ``line``: from the
        origin along x1; ``circle``: radius 1 m, centred at the origin, from (1, 0) counter-clockwise; ``lemniscate``:
        Bernoulli's, half width 1.5 m, from (1.5, 0) upwards. The heading stays 0. ``square``: sides of 2 m, centred at
        the origin, from (1, -1) counter-clockwise; the heading turns by a quarter on each side. FILE.csv, FILE.toml:
        through waypoints (``host_sim/waypoints.py``).
    speed_m_per_s
        Speed along the path: constant between the ramps, or the limit that it stays below. Not used where the
        waypoints have times.
    corner
        Of steady drives, ``sharp``: the velocity jumps; ``rounded``: it blends from one side's to the next's around the
        corner's time. Of fastest ones, ``sharp``: stop; ``rounded``: cut.
    corner_accel_m_per_s2
        Peak acceleration of ramps and corner blends. Along a curve the centripetal one comes on top. Of fastest drives
        the limit of acceleration, if ``limits`` has none.
    duration_s
        Time to the end, at rest; None: one full lap, or 4 m of the line. An end that falls into a corner (from half a
        ramp before the vertex to where the ramp down fits behind the corner) stops short: at rest before the corner.
        A fastest drive is slowed down to it.
    start_before_corner_s
        None: start from rest; else start in motion this long before the time of the first corner.
    profile
        ``steady``: at the speed asked for, and refused if a limit that was asked for is broken; ``fastest``: as fast as
        the limits allow. None: steady for the paths that can be, else fastest.
    limits
        Over those of the file, and over the robot's wheels'.
    corner_cut_m
        How far a fastest drive stays away from a rounded corner's vertex.
    """

    path: str
    speed_m_per_s: float
    corner: str = "rounded"
    corner_accel_m_per_s2: float = 2.0
    duration_s: float | None = None
    start_before_corner_s: float | None = None
    profile: str | None = None
    limits: Limits = NO_LIMITS
    corner_cut_m: float = 0.05

    def __post_init__(self) -> None:
        _check_path(self.path)
        _check_choice("corner", self.corner, CORNERS)
        _check_range("speed_m_per_s", self.speed_m_per_s)
        _check_range("corner_accel_m_per_s2", self.corner_accel_m_per_s2)
        _check_range("corner_cut_m", self.corner_cut_m)
        if self.duration_s is not None:
            _check_range("duration_s", self.duration_s)
        if self.start_before_corner_s is not None:
            _check_range("start_before_corner_s", self.start_before_corner_s)
        if self.profile is not None:
            _check_choice("profile", self.profile, PROFILES)
        if self.profile == "steady" and self.path not in PATHS:
            raise OmnibotError(f"{self.path} can't be driven at a steady speed; leave the profile out, or say fastest")
        if self.start_before_corner_s is not None and (self.path != "rhombus" or self.is_fastest):
            why = "has none" if self.path != "rhombus" else "must be driven steadily for it"
            raise OmnibotError(f"start_before_corner_s needs a path with corners (rhombus); {self.path} {why}")

    @property
    def is_fastest(self) -> bool:
        """Tell whether limits make the speed."""
        return self.profile == "fastest" or self.path not in PATHS


@dataclass(frozen=True, eq=False)
class Plan:
    """A trajectory, the limits that it keeps, and how well its polynomials fit.

    Attributes
    ----------
    limits
        What was looked after; a steady drive's are those that were asked for.
    fit_error_m
        At most so far are the polynomials from where path and speed would have the robot.
    is_timed
        The waypoints' times make the speed.
    """

    trajectory: Trajectory
    limits: Limits
    fit_error_m: float
    is_timed: bool = False


def plan(request: PathRequest, robot: Robot | None = None) -> Trajectory:
    """Make the trajectory asked for, or say what is in the way."""
    return plan_with_limits(request, robot).trajectory


def plan_with_limits(request: PathRequest, robot: Robot | None = None) -> Plan:
    """Make the trajectory asked for, or say what is in the way; the robot is that of the robot file by default."""
    if not request.is_fastest and not request.limits:
        return Plan(_steady(request), request.limits, _FIT_TOLERANCE_M)
    robot = robot or load_robot()
    if not request.is_fastest:
        made = Plan(_steady(request), request.limits, _FIT_TOLERANCE_M)
        _check_limits(
            made, robot, f"{request.path} at a steady {request.speed_m_per_s:g} m/s", "; fastest would keep it"
        )
        return made
    if not waypoints.is_file(request.path):
        return _fastest(request, _named_course(request), request.limits, robot)
    file = waypoints.read_waypoints(request.path)
    limits = request.limits.over(file.limits)
    if file.time_s is None:
        made = _fastest(request, spline_course(file.places, robot.wheel_distance_m), limits, robot)
    else:
        made = _timed(request, file.places, file.time_s, limits, robot)
    _check_reach(made, request.path)
    return made


def _fastest(request: PathRequest, course: Course, limits: Limits, robot: Robot) -> Plan:
    """Drive a course as fast as the limits allow, or in the time asked for."""
    usual = Limits(accel_m_per_s2=request.corner_accel_m_per_s2, jerk_m_per_s3=JERK_M_PER_S3)
    speed = Limits(speed_m_per_s=request.speed_m_per_s)
    limits = speed.over(limits).over(usual).over(robot_limits(robot))
    drive = FastDrive.along(course, robot, limits)
    if request.duration_s is not None:
        drive = _lasting(drive, request.duration_s, limits)
    misfit_m = drive.misfit()
    if misfit_m > FIT_TOLERANCE_M:
        raise OmnibotError(
            f"{MAX_SEGMENTS} segments, as many as the firmware stores, miss {request.path} by {1e3 * misfit_m:.3g} mm, "
            f"more than {1e3 * FIT_TOLERANCE_M:g} mm; make it shorter or smoother"
        )
    return Plan(drive.trajectory(), limits, misfit_m)


def _lasting(drive: FastDrive, duration_s: float, limits: Limits) -> FastDrive:
    """Stretch a drive to a duration."""
    if duration_s > MAX_TOTAL_US * 1e-6:
        raise OmnibotError(
            f"duration_s = {duration_s:g} is too long: the firmware stores at most {_seconds(MAX_TOTAL_US)} s"
        )
    needed_s = drive.duration_s
    asked = replace(drive, stretch=drive.stretch * duration_s / needed_s)
    if duration_s < needed_s * (1.0 - 1e-6):
        broken = motion_of(asked.trajectory(), drive.robot).refusal(limits)
        raise OmnibotError(
            f"duration_s = {duration_s:g} is too short, {_rounded(needed_s, math.ceil)} s would do: {broken}"
        )
    return asked


def _timed(request: PathRequest, places: Array, time_s: Array, limits: Limits, robot: Robot) -> Plan:
    """Be at waypoints on time, by the spline of degree 5 over time, at rest without acceleration at both ends."""
    if request.duration_s is not None:
        raise OmnibotError(
            f"duration_s = {request.duration_s:g}: the waypoints of {request.path} have times of their own"
        )
    if len(places) > MAX_SEGMENTS + 1:
        most = f"at most {MAX_SEGMENTS + 1}, with times: the firmware stores {MAX_SEGMENTS} segments"
        raise OmnibotError(f"{request.path} has {len(places)} waypoints; {most}")
    nodes_us = [round(at_s * 1e6) for at_s in time_s]
    spline = resting_spline(np.array(nodes_us) * 1e-6, places)
    states = np.stack([spline(np.array(nodes_us) * 1e-6, order) for order in range(4)], axis=1)
    trajectory = Trajectory(hermite(nodes_us, states), SplinePath(spline, nodes_us[-1] * 1e-6, len(places))).rounded()
    made = Plan(trajectory, limits.over(robot_limits(robot)), _FIT_TOLERANCE_M, is_timed=True)
    _check_limits(made, robot, request.path, "; give it more time there")
    return made


def _check_limits(made: Plan, robot: Robot, what: str, cure: str) -> None:
    broken = motion_of(made.trajectory, robot).refusal(made.limits)
    if broken:
        raise OmnibotError(f"{what} is too much: {broken}{cure}")


def _check_reach(made: Plan, path: str) -> None:
    """Refuse what the wire can't say: the spline may lead further out than its waypoints."""
    outline = np.abs(made.trajectory.path.outline())
    if np.max(outline) > WIRE_REACH_M:
        raise OmnibotError(
            f"{path} leads to {np.max(outline):.4g} m from the origin's axes; at most {WIRE_REACH_M:g} m"
        )


def _named_course(request: PathRequest) -> Course:
    if request.path in ("rhombus", "square"):
        vertices, headings = _RHOMBUS if request.path == "rhombus" else _SQUARE
        if request.corner == "sharp":
            return stopping_polygon(vertices, headings)
        return rounded_polygon(vertices, headings, request.corner_cut_m)
    if request.path == "line":
        return curve_course(Line(LINE_LENGTH_M), Polyline(np.array([[0.0, 0.0], [LINE_LENGTH_M, 0.0]]), closed=False))
    curve = Circle(CIRCLE_RADIUS_M) if request.path == "circle" else Lemniscate(LEMNISCATE_HALF_WIDTH_M)
    return curve_course(curve, curve)


def _steady(request: PathRequest) -> Trajectory:
    """Drive at the speed asked for."""
    course = _polygon_course(request) if request.path == "rhombus" else _smooth_course(request)
    duration_us = course.default_us if request.duration_s is None else round(request.duration_s * 1e6)
    if duration_us < course.shortest_us:
        needed = f"to reach {request.speed_m_per_s:g} m/s and stop takes {_seconds(course.shortest_us)} s"
        raise OmnibotError(f"duration_s = {_seconds(duration_us)} is too short: {needed} or more")
    segments = _collected(course, duration_us)
    if segments is None:
        longest = _seconds(_longest_us(course, duration_us))
        stores = f"the firmware stores {MAX_SEGMENTS} segments and at most {_seconds(MAX_TOTAL_US)} s"
        raise OmnibotError(f"duration_s = {_seconds(duration_us)} is too long: {stores}, enough for {longest} s")
    return Trajectory(segments, course.path(duration_us))


def default_speed(path: str) -> float:
    """Return the speed of a drive, m/s, if nobody says another: that of the file, if it has one."""
    of_file = waypoints.read_waypoints(path).limits.speed_m_per_s if waypoints.is_file(path) else None
    return SPEED_M_PER_S if of_file is None else of_file


class _Course(Protocol):
    """A path with its speed and ramps fixed; only the duration is open."""

    @property
    def shortest_us(self) -> int:
        """Shortest duration that works."""

    @property
    def default_us(self) -> int:
        """Duration of a full lap."""

    def path(self, duration_us: int) -> Path:
        """Path that is driven."""

    def segments(self, duration_us: int) -> Iterator[Segment]:
        """Segments one by one: of a long duration only as many are made as are asked for."""


class _TooManySegmentsError(Exception):
    """A curve needs more pieces than the firmware stores."""


def _collected(course: _Course, duration_us: int) -> list[Segment] | None:
    """Return all segments, or None if they are more, or last longer, than the firmware stores."""
    if duration_us > MAX_TOTAL_US:
        return None
    try:
        segments = list(islice(course.segments(duration_us), MAX_SEGMENTS + 1))
    except _TooManySegmentsError:
        return None
    return segments if len(segments) <= MAX_SEGMENTS else None


def _longest_us(course: _Course, too_long_us: int) -> int:
    """Bisect for the longest duration that the firmware stores."""
    good, bad = course.shortest_us, too_long_us
    while bad - good > 1:
        middle = (good + bad) // 2
        if _collected(course, middle) is None:
            bad = middle
        else:
            good = middle
    return good


# ------------------------------------------------------------------------------------------------- checks and units


def _check_path(path: str) -> None:
    if path not in NAMED_PATHS and not waypoints.is_file(path):
        raise OmnibotError(f"unknown path {path!r}; there are: {', '.join(NAMED_PATHS)}, FILE.csv, FILE.toml")


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise OmnibotError(f"unknown {name} {value!r}; there are: {', '.join(choices)}")


def _check_range(name: str, value: float, lowest: float = 1e-6, highest: float = 1e6) -> None:
    """Refuse what no robot does, NaN included.

    So times in microseconds stay sensible whole numbers.
    """
    if not lowest <= value <= highest:
        raise OmnibotError(f"{name} = {value:g} must be a number above 0, from {lowest:g} to {highest:g}")


def _check_speed(request: PathRequest, what: str, length_m: float, stretch: float | None) -> None:
    """Check that ramps and blends fit into a length.

    ``stretch`` is the length they take in units of speed² / acceleration, None if there is time for them in any case.
    """
    speed, accel = request.speed_m_per_s, request.corner_accel_m_per_s2
    by_time = length_m / _SHORTEST_UNIT_S
    by_accel = math.sqrt(length_m * accel / stretch) if stretch else math.inf
    limit = min(by_time, by_accel) * (1.0 - _SPEED_MARGIN)
    if speed > limit:
        cure = f"at most {_rounded(limit, math.floor)} m/s"
        if speed <= by_time * (1.0 - _SPEED_MARGIN):
            least = accel * (speed / limit) ** 2
            cure += f", or corner_accel_m_per_s2 of at least {_rounded(least, math.ceil)}"
        raise OmnibotError(f"speed_m_per_s = {speed:g} is too high for {what} of {length_m:.4g} m: {cure}")


def _check_ramp(request: PathRequest, ramp_us: int) -> None:
    """Check that a ramp or blend, one segment each, lasts no longer than a segment may."""
    if ramp_us > MAX_DURATION_US:
        least = request.corner_accel_m_per_s2 * ramp_us / MAX_DURATION_US
        reason = f"a ramp or corner of {_seconds(ramp_us)} s, longer than a segment's {_seconds(MAX_DURATION_US)} s"
        cure = f"at least {_rounded(least * (1.0 + _SPEED_MARGIN), math.ceil)} at this speed"
        raise OmnibotError(f"corner_accel_m_per_s2 = {request.corner_accel_m_per_s2:g} makes {reason}: {cure}")


def _rounded(value: float, to_whole: Callable[[float], int]) -> str:
    """Four significant digits, rounded to the safe side by ``math.floor`` or ``math.ceil``."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{to_whole(value / unit) * unit:.4g}"


def _seconds(time_us: int) -> str:
    return f"{time_us // 1_000_000}.{time_us % 1_000_000:06d}".rstrip("0").rstrip(".")


def _even_us(seconds: float) -> int:
    """Round up to an even number of microseconds, so that half of it is a whole one."""
    return 2 * max(1, math.ceil(seconds * 0.5e6))


# ------------------------------------------------------------------------------------------------------- polygon


@dataclass(frozen=True, eq=False)
class _PolygonCourse:
    """Laps of a polygon with sides of equal length, at constant speed but for the ramps.

    Its clock is that of the sharp path: side k starts at ``corner_us(k)`` and is ``side_us`` long. A ramp covers half
    of what the full speed would, and a blend symmetric around the corner's time ends where the sharp path is then.
    """

    vertices: Array  # (m, 2), m
    speed_m_per_s: float
    side_us: int
    ramp_us: int
    blend_us: int  # 0: sharp
    first_corner_us: int
    starts_moving: bool

    @property
    def shortest_us(self) -> int:
        """Stop as soon as the full speed is reached, or, if there is no room, behind the first corner."""
        earliest = self.ramp_us if self.starts_moving else 2 * self.ramp_us
        at_vertex = self.first_corner_us + self.ramp_us // 2
        return earliest if at_vertex >= earliest else self.first_corner_us + self.blend_us // 2 + self.ramp_us

    @property
    def default_us(self) -> int:
        """One lap: ends where it started."""
        lap_us = len(self.vertices) * self.side_us
        return lap_us + (self.ramp_us // 2 if self.starts_moving else self.ramp_us)

    def path(self, duration_us: int) -> Path:  # noqa: ARG002
        """Whole polygon, whatever the duration."""
        return Polyline(self.vertices)

    def segments(self, duration_us: int) -> Iterator[Segment]:
        """Ramp up, sides and corners in turn, ramp down, rest."""
        corners, stop_us = self._stop(duration_us)
        rest, now_us = np.zeros(2), 0
        if not self.starts_moving:
            yield _blend(self.vertices[0], rest, self._velocity(0), self.ramp_us)
            now_us = self.ramp_us
        for corner in range(1, corners + 1):
            begin_us = self._corner_us(corner) - self.blend_us // 2
            yield from self._straight(corner - 1, now_us, begin_us)
            if self.blend_us:
                begin = self._position(corner - 1, begin_us)
                yield _blend(begin, self._velocity(corner - 1), self._velocity(corner), self.blend_us)
            now_us = begin_us + self.blend_us
        ramp_at_us = stop_us - self.ramp_us
        yield from self._straight(corners, now_us, ramp_at_us)
        yield _blend(self._position(corners, ramp_at_us), self._velocity(corners), rest, self.ramp_us)
        yield from _uniform(self._position(corners, stop_us - self.ramp_us // 2), rest, duration_us - stop_us)

    def _stop(self, duration_us: int) -> tuple[int, int]:
        """Return how many corners are passed, and when the ramp down ends: at the vertex that it would cut at latest.

        A corner is passed if the ramp down fits behind it.
        """
        behind_us = duration_us - self.ramp_us - self.blend_us // 2 - self.first_corner_us
        corners = max(0, behind_us // self.side_us + 1)
        return corners, min(duration_us, self._corner_us(corners + 1) + self.ramp_us // 2)

    def _corner_us(self, corner: int) -> int:
        return self.first_corner_us + (corner - 1) * self.side_us

    def _velocity(self, side: int) -> Array:
        """Velocity on a side, shape (2,) in m/s."""
        start, end = self.vertices[side % len(self.vertices)], self.vertices[(side + 1) % len(self.vertices)]
        return np.asarray(self.speed_m_per_s * (end - start) / np.hypot(*(end - start)))

    def _position(self, side: int, at_us: int) -> Array:
        """Position of the sharp path on a side, shape (2,) in m."""
        since_s = (at_us - self._corner_us(side)) * 1e-6
        return np.asarray(self.vertices[side % len(self.vertices)] + self._velocity(side) * since_s)

    def _straight(self, side: int, begin_us: int, end_us: int) -> Iterator[Segment]:
        return _uniform(self._position(side, begin_us), self._velocity(side), end_us - begin_us)


def _polygon_course(request: PathRequest) -> _PolygonCourse:
    half = RHOMBUS_DIAGONAL_M / 2.0
    vertices = np.array([[half, 0.0], [0.0, half], [-half, 0.0], [0.0, -half]])
    side_m, turn = math.sqrt(2.0) * half, math.sqrt(2.0)  # turn: velocity jump at a corner in units of the speed
    rounded = request.corner == "rounded"
    _check_speed(request, "a side", side_m, _CUBIC_PEAK * (turn if rounded else 1.0))
    side_us = round(side_m / request.speed_m_per_s * 1e6)
    speed = side_m / (side_us * 1e-6)
    ramp_s = _CUBIC_PEAK * speed / request.corner_accel_m_per_s2
    ramp_us = _even_us(ramp_s)
    blend_us = _even_us(ramp_s * turn) if rounded else 0
    _check_ramp(request, max(ramp_us, blend_us))
    first_us = _first_corner_us(request.start_before_corner_s, side_us, ramp_us, blend_us)
    moving = request.start_before_corner_s is not None
    return _PolygonCourse(vertices, speed, side_us, ramp_us, blend_us, first_us, moving)


def _first_corner_us(start_before_s: float | None, side_us: int, ramp_us: int, blend_us: int) -> int:
    """Time of the first corner on the sharp path."""
    if start_before_s is None:
        return ramp_us // 2 + side_us
    first_us = round(start_before_s * 1e6)
    if first_us > side_us:
        most = f"the side lasts {_seconds(side_us)} s; at most that"
        raise OmnibotError(f"start_before_corner_s = {start_before_s:g} is too long: {most}")
    if first_us < blend_us // 2:
        least = f"the rounded corner begins {_seconds(blend_us // 2)} s before its time; at least that"
        raise OmnibotError(f"start_before_corner_s = {start_before_s:g} is too short: {least}")
    return first_us


def _blend(start: Array, before: Array, after: Array, duration_us: int) -> Segment:
    """Change velocity from ``before`` to ``after``, shape (2,) in m/s, by a cubic smoothstep.

    Peak acceleration: 1.5 times the change over the duration.
    """
    duration_s = duration_us * 1e-6
    coefficients = np.zeros((AXES, COEFFICIENTS))
    coefficients[:2, 0] = start
    coefficients[:2, 1] = before * duration_s
    coefficients[:2, 3] = (after - before) * duration_s
    coefficients[:2, 4] = -0.5 * coefficients[:2, 3]
    return Segment(duration_us, coefficients)


def _uniform(start: Array, velocity: Array, duration_us: int) -> Iterator[Segment]:
    """Constant velocity, shape (2,) in m/s, in as many segments as the longest one allows; none for no time."""
    pieces = -(-duration_us // MAX_DURATION_US)
    for piece in range(pieces):
        begin_us, end_us = duration_us * piece // pieces, duration_us * (piece + 1) // pieces
        yield _blend(start + velocity * (begin_us * 1e-6), velocity, velocity, end_us - begin_us)


# -------------------------------------------------------------------------------------------------------- curves


@dataclass(frozen=True)
class _SmoothCourse:
    """A curve driven from rest to rest, thrice continuously differentiable: septic pieces between exact nodes."""

    curve: Curve
    speed_m_per_s: float
    lap_us: int
    ramp_us: int

    @property
    def shortest_us(self) -> int:
        """Stop as soon as the full speed is reached."""
        return 2 * self.ramp_us

    @property
    def default_us(self) -> int:
        """One lap: ends where it started."""
        return self.lap_us + self.ramp_us

    def path(self, duration_us: int) -> Path:
        """Whole curve; of the line as much as is driven."""
        if isinstance(self.curve, Circle | Lemniscate):
            return self.curve
        return Polyline(self._exact(np.array([0.0, duration_us]), duration_us)[:, 0], closed=False)

    def segments(self, duration_us: int) -> Iterator[Segment]:
        """Ramp up, constant speed, ramp down."""
        end_us = duration_us - self.ramp_us
        for begin, end in ((0, self.ramp_us), (self.ramp_us, end_us), (end_us, duration_us)):
            if end > begin:
                yield from self._fitted(begin, end, duration_us)

    def _fitted(self, begin_us: int, end_us: int, duration_us: int) -> list[Segment]:
        """As few equal pieces as keep the position within the tolerance."""
        span_us = end_us - begin_us
        by_reach = math.ceil(self.speed_m_per_s * span_us * 1e-6 / self.curve.reach_m * (1.0 - 1e-9))
        pieces = max(1, by_reach, -(-span_us // MAX_DURATION_US))
        while pieces <= MAX_SEGMENTS:
            nodes_us = [begin_us + span_us * piece // pieces for piece in range(pieces + 1)]
            segments = hermite(nodes_us, self._exact(np.array(nodes_us, dtype=np.float64), duration_us))
            if self._error_m(segments, begin_us, end_us, duration_us) < _FIT_TOLERANCE_M:
                return segments
            pieces += 1 + pieces // 4
        raise _TooManySegmentsError

    def _error_m(self, segments: list[Segment], begin_us: int, end_us: int, duration_us: int) -> float:
        """Largest distance between pieces and curve, over nine instants a piece."""
        time_us = np.linspace(begin_us, end_us, 10 * len(segments), endpoint=False)
        exact = self._exact(time_us, duration_us)[:, 0]
        fitted = Trajectory(segments, Polyline(exact)).evaluate((time_us - begin_us) * 1e-6, derivatives=0)
        return float(np.max(np.linalg.norm(fitted[:, 0, :2] - exact, axis=1)))

    def _exact(self, time_us: Array, duration_us: int) -> Array:
        """Position and three time derivatives, shape (n, 4, 2), at times of shape (n,): chain rule."""
        up = _eased(time_us * 1e-6, self.ramp_us * 1e-6)
        down = _eased((time_us - (duration_us - self.ramp_us)) * 1e-6, self.ramp_us * 1e-6)
        distance, d1, d2, d3 = self.speed_m_per_s * (up - down)[:, :, None]
        p0, p1, p2, p3 = np.moveaxis(self.curve.derivatives(distance[:, 0]), 1, 0)
        third = p3 * d1**3 + 3.0 * p2 * d1 * d2 + p1 * d3
        return np.stack([p0, p1 * d1, p2 * d1**2 + p1 * d2, third], axis=1)


def _smooth_course(request: PathRequest) -> _SmoothCourse:
    curves: dict[str, Line | Circle | Lemniscate] = {
        "line": Line(LINE_LENGTH_M),
        "circle": Circle(CIRCLE_RADIUS_M),
        "lemniscate": Lemniscate(LEMNISCATE_HALF_WIDTH_M),
    }
    curve = curves[request.path]
    what = "the line" if request.path == "line" else "a lap"
    _check_speed(request, what, curve.length_m, _QUINTIC_PEAK if request.duration_s is None else None)
    lap_us = round(curve.length_m / request.speed_m_per_s * 1e6)
    speed = curve.length_m / (lap_us * 1e-6)
    return _SmoothCourse(curve, speed, lap_us, _even_us(_QUINTIC_PEAK * speed / request.corner_accel_m_per_s2))


def _eased(time_s: Array, ramp_s: float) -> Array:
    """Distance at unit speed from rest, and three derivatives, shape (4, n), at times of shape (n,).

    The speed rises from 0 at time 0 to 1 at ``ramp_s`` as the quintic smoothstep 10 s³ - 15 s⁴ + 6 s⁵.
    """
    s = np.clip(time_s / ramp_s, 0.0, 1.0)
    distance = ramp_s * s**4 * (2.5 + s * (s - 3.0)) + np.maximum(time_s - ramp_s, 0.0)
    speed = s**3 * (10.0 + s * (6.0 * s - 15.0))
    return np.stack([distance, speed, 30.0 * (s * (1.0 - s)) ** 2 / ramp_s, _jerk(s) / ramp_s**2])


def _jerk(s: Array) -> Array:
    """Second derivative of the quintic smoothstep."""
    return np.asarray(60.0 * s * (1.0 - s) * (1.0 - 2.0 * s))
