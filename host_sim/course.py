"""Where a drive leads: smooth sections of path and heading, from one standstill to the next.

A section is a curve of (p1, p2, heading) over a parameter u, thrice continuously differentiable, whose speed
|dp/du| need not be 1. How fast it is driven is another matter (``host_sim/fastest.py``).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial import cKDTree

from host_sim.curves import Curve
from host_sim.errors import OmnibotError
from host_sim.trajectory import Array, Path, Polyline

_CORNER_SHIFT = 10.0 / 128.0  # ∫ of the quintic smoothstep from 0 to 1/2
_HEADING_SHARE = 0.8  # of a straight, over which the heading changes: the corners are driven with it still
_SPLINE_DEGREE = 5
_OUTLINE_POINTS = 60  # of a spline, from one waypoint to the next


@dataclass(frozen=True, eq=False)
class Section:
    """A smooth curve from one standstill to the next.

    Attributes
    ----------
    length
        u runs from 0 to it.
    derivatives
        Of u of shape (n,): (p1, p2, heading) and three derivatives by u, shape (n, 4, 3).
    """

    length: float
    derivatives: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Course:
    """Sections driven one after the other, and the path that they are meant to follow."""

    sections: Sequence[Section]
    path: Path


def curve_course(curve: Curve, path: Path) -> Course:
    """Drive a curve once, heading 0."""

    def derivatives(u: Array) -> Array:
        return np.concatenate([curve.derivatives(u), np.zeros((len(u), 4, 1))], axis=2)

    return Course([Section(curve.length_m, derivatives)], path)


# ------------------------------------------------------------------------------------------------------- polygons


def stopping_polygon(vertices: Array, headings: Array) -> Course:
    """Drive round a polygon, of vertices of shape (m, 2) in m, and stop at each.

    ``headings`` of shape (m + 1,) in rad: at the vertices, and back at the first one; they change on the sides.
    """
    closed = np.vstack([vertices, vertices[:1]])
    sides = zip(pairwise(closed), pairwise(headings), strict=True)
    return Course([_joined([_straight(*ends, *turn)]) for ends, turn in sides], Polyline(vertices))


def rounded_polygon(vertices: Array, headings: Array, cut_m: float) -> Course:
    """Drive round a polygon without a stop; corners are cut, at most so many metres from the vertex.

    Around a vertex the direction changes from one side's to the next's by a quintic smoothstep in u.
    """
    closed = np.vstack([vertices, vertices[:1]])
    sides = np.diff(closed, axis=0)
    length = np.linalg.norm(sides, axis=1)
    along = sides / length[:, None]
    reach = [cut_m / (2.0 * _CORNER_SHIFT * float(np.linalg.norm(b - a))) for a, b in pairwise(along)]
    longest = min(*(length[:-1] - reach), *(length[1:] - reach), *(length[1:-1] - reach[:-1] - reach[1:]))
    if longest < 0.0:
        most = cut_m * float(np.min(length)) / (2.0 * max(reach))
        raise OmnibotError(
            f"corner_cut_m = {cut_m:g} leaves nothing of a side of {min(length):.4g} m: at most {most:.4g}"
        )
    parts: list[_Part] = []
    for k, (start, end) in enumerate(pairwise(closed)):
        begin = start + along[k] * (reach[k - 1] if k else 0.0)
        stop = end - along[k] * (reach[k] if k < len(reach) else 0.0)
        parts.append(_straight(begin, stop, headings[k], headings[k + 1]))
        if k < len(reach):
            parts.append(_corner(stop, along[k], along[k + 1], 2.0 * reach[k], headings[k + 1]))
    return Course([_joined(parts)], Polyline(vertices))


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a section, u counted from its own start."""

    length: float
    derivatives: Callable[[Array], Array]


def _straight(start: Array, end: Array, heading: float, heading_after: float) -> _Part:
    """Go straight; the heading changes over the middle by a septic smoothstep."""
    length = float(np.linalg.norm(end - start))
    direction = (end - start) / length
    turning = _HEADING_SHARE * length

    def derivatives(u: Array) -> Array:
        result = np.zeros((len(u), 4, 3))
        result[:, 0, :2] = start + np.multiply.outer(u, direction)
        result[:, 1, :2] = direction
        s = np.clip((u - 0.5 * (length - turning)) / turning, 0.0, 1.0)
        shape = np.stack(
            [np.polynomial.polynomial.polyval(s, np.polynomial.polynomial.polyder(_SEPTIC, d)) for d in range(4)]
        )
        result[:, :, 2] = (heading_after - heading) * shape.T / turning ** np.arange(4)
        result[:, 0, 2] += heading
        return result

    return _Part(length, derivatives)


_QUINTIC = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
_SEPTIC = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])


def _corner(start: Array, before: Array, after: Array, length: float, heading: float) -> _Part:
    """Turn from one direction to another, both of shape (2,) and size 1."""
    polynomial = np.polynomial.polynomial
    shape = [polynomial.polyint(_QUINTIC), _QUINTIC, polynomial.polyder(_QUINTIC), polynomial.polyder(_QUINTIC, 2)]

    def derivatives(u: Array) -> Array:
        result = np.zeros((len(u), 4, 3))
        s = u / length
        for order, coefficients in enumerate(shape):
            turned = polynomial.polyval(s, coefficients) * length ** (1 - order)
            result[:, order, :2] = np.multiply.outer(turned, after - before)
        result[:, 0, :2] += start + np.multiply.outer(u, before)
        result[:, 1, :2] += before
        result[:, 0, 2] = heading
        return result

    return _Part(length, derivatives)


def _joined(parts: Sequence[_Part]) -> Section:
    """Make one section of parts that follow each other smoothly."""
    begins = np.concatenate([[0.0], np.cumsum([part.length for part in parts])])

    def derivatives(u: Array) -> Array:
        index = np.clip(np.searchsorted(begins, u, side="right") - 1, 0, len(parts) - 1)
        result = np.empty((len(u), 4, 3))
        for k in np.unique(index):
            here = index == k
            result[here] = parts[k].derivatives(u[here] - begins[k])
        return result

    return Section(float(begins[-1]), derivatives)


# -------------------------------------------------------------------------------------------------------- splines


def spline_course(waypoints: Array, heading_length_m: float) -> Course:
    """Drive through waypoints of shape (m, 3): x1 and x2 in m, heading in rad, not wrapped.

    The natural spline of degree 5 over the distance between waypoints, a turn on the spot counted as so many metres a
    radian. No two waypoints that follow each other may be the same.
    """
    steps = np.diff(waypoints, axis=0) * np.array([1.0, 1.0, heading_length_m])
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    spline = natural_spline(at, waypoints)
    orders = [spline.derivative(order) if order else spline for order in range(4)]

    def derivatives(u: Array) -> Array:
        return np.stack([order(u) for order in orders], axis=1)

    return Course([Section(float(at[-1]), derivatives)], SplinePath(spline, float(at[-1]), len(at)))


def natural_spline(at: Array, waypoints: Array) -> BSpline:
    """Return the smoothest spline of degree 5 through waypoints: third and fourth derivative 0 at its ends.

    Two waypoints leave it open; they get a third in the middle.
    """
    if len(at) == 2:
        at = np.array([at[0], 0.5 * (at[0] + at[1]), at[1]])
        waypoints = np.stack([waypoints[0], 0.5 * (waypoints[0] + waypoints[1]), waypoints[1]])
    zero = np.zeros(waypoints.shape[1])
    ends = [(3, zero), (4, zero)]
    return make_interp_spline(at, waypoints, k=_SPLINE_DEGREE, bc_type=(ends, ends))


def resting_spline(time_s: Array, waypoints: Array) -> BSpline:
    """Return the spline of degree 5 over time that starts and ends at rest without acceleration."""
    zero = np.zeros(waypoints.shape[1])
    ends = [(1, zero), (2, zero)]
    return make_interp_spline(time_s, waypoints, k=_SPLINE_DEGREE, bc_type=(ends, ends))


class SplinePath:
    """The path of a spline's first two axes over a parameter from 0 to ``length``."""

    def __init__(self, spline: BSpline, length: float, waypoints: int) -> None:
        self._derivatives = [spline, spline.derivative(), spline.derivative(2)]
        self._length = length
        self._grid = np.linspace(0.0, length, _OUTLINE_POINTS * (waypoints - 1) + 1)
        self._tree = cKDTree(self.outline())

    def outline(self) -> Array:
        """Vertices to draw the spline with, shape (m, 2) in m."""
        return np.asarray(self._derivatives[0](self._grid)[:, :2])

    def distance(self, points: Array) -> Array:
        """Distance of points to the spline, shape (n,) in m, of points of shape (n, 2) in m.

        The nearest of a grid is improved by Newton's method, kept near it.
        """
        nearest, index = self._tree.query(points)
        step = self._grid[1]
        u = self._grid[index]
        for _ in range(4):
            place, slope, bend = (order(u)[:, :2] for order in self._derivatives)
            offset = place - points
            gradient = np.sum(slope * offset, axis=1)
            stiffness = np.maximum(np.sum(slope**2, axis=1) + np.sum(bend * offset, axis=1), 1e-9)
            u = np.clip(u - np.clip(gradient / stiffness, -step, step), 0.0, self._length)
        found = np.linalg.norm(self._derivatives[0](u)[:, :2] - points, axis=1)
        return np.asarray(np.minimum(nearest, found))
