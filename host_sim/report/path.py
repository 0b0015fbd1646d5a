"""The path from above: reference, tracked point, the robot to scale, and the first corner enlarged."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from host_sim.metrics import tracking_error, wrap_angle
from host_sim.report.figure import (
    ACTUAL,
    REFERENCE,
    Axis,
    Drawn,
    Figure,
    Panel,
    Range,
    Style,
    length_unit,
    line,
    numbers,
)
from host_sim.robot import Array, Robot
from host_sim.trace import Trace

LOST_m = 2.0  # an error above it is called diverged
TURN_WINDOW = 0.025  # of the path's length: a corner turns within it by ...
TURN_LEAST_rad = math.radians(25.0)  # ... at least this; a circle turns by 9 degrees, a lemniscate by 23
POINTS = 3000  # of a path
FRAMES = 1500  # of the robot's film
HEIGHT_px = 460
INSTANTS = 6  # at which the robot is drawn, at most

PATH, ROBOT = Style("--path", width_px=1.2), Style("--ink", width_px=1.0)


def path_figure(trace: Trace, polyline: Array, robot: Robot) -> Figure:
    """Draw the path from above, and beside it the first corner driven, enlarged.

    Parameters
    ----------
    trace
        What happened; may be empty or diverged.
    polyline
        The path as points in {G}, shape (m, 2) in m.
    robot
        Whose wheels and body are drawn.
    """
    view = corner_view(trace, polyline)
    panels = [_whole(trace, polyline, robot)]
    if view is not None:
        panels.append(_enlarged(trace, polyline, *view, robot))
    caption = (
        "The tracked point p and its reference, seen from above. The robot is drawn to scale, with its wheels "
        "and an arm from its centre to p."
    )
    return Figure("path", caption, panels, wide=True)


def _whole(trace: Trace, polyline: Array, robot: Robot) -> Panel:
    """Draw all of the path."""
    seen = sane_rows(trace)
    instants = robot_rows(trace, robot)
    reference, point, time_s = shown(seen, trace.reference_point, trace.point, trace.time_s)
    traces = [
        *_paths(polyline, reference, point, time_s),
        *robots_at(robot, trace.pose[instants], "robot at instants"),
        written_times(robot, trace.pose[instants], trace.time_s[instants]),
        *_film_parts(robot, seen),
    ]
    hidden = len(trace) - int(np.count_nonzero(seen))
    note = f"not shown: {hidden} of {len(trace)} positions, lost or not finite" if hidden else ""
    note = note if len(trace) else "nothing was recorded"
    axes = Axis("x1 (m)"), Axis("x2 (m)")
    film = _film(trace, seen)
    return Panel("Path from above (m)", traces, *axes, note=note, equal=True, height_px=HEIGHT_px, extra=film)


def _enlarged(trace: Trace, polyline: Array, corner: Array, half_m: float, robot: Robot) -> Panel:
    """Draw what lies around a corner, shape (2,) in m, as far as ``half_m``."""
    scale, unit = length_unit(half_m)
    seen = sane_rows(trace)
    distance = np.linalg.norm(trace.reference_point - corner, axis=1)
    nearest = distance.argmin(keepdims=True)
    posed = nearest if seen[nearest].all() and half_m > 0.3 * robot.wheel_distance_m else nearest[:0]
    reference, point, time_s = shown(seen & (distance < 3.0 * half_m), trace.reference_point, trace.point, trace.time_s)
    path, reference, point = ((xy - corner) * scale for xy in (polyline, reference, point))
    x, y = (Axis(f"x{axis + 1} ({unit})", view) for axis, view in enumerate(_view(reference, half_m * scale)))
    traces = [
        *robots_at(robot, trace.pose[posed], "robot at instants", corner, scale),
        *_paths(path, reference, point, time_s, unit),
    ]
    return Panel(enlarged_title(corner, unit), traces, x, y, equal=True, height_px=HEIGHT_px)


def enlarged_title(corner: Array, unit: str) -> str:
    """Say where a corner, shape (2,) in m, is, and in what unit it is drawn."""
    x, y = (f"{round(float(place), 3) + 0.0:.3f} m" for place in corner)
    return f"The first corner, enlarged ({unit} from {x}, {y})"


def _view(reference: Array, half: float) -> list[Range]:
    """Return along x and y what holds the corner, at the origin, and the reference (n, 2) within ``half`` of it."""
    seen = np.vstack([reference[np.linalg.norm(reference, axis=1) <= half], np.zeros((1, 2))])  # not the gaps
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.15 * half
    return [(float(a - margin), float(b + margin)) for a, b in zip(low, high, strict=True)]


def shown(kept: NDArray[np.bool_], *columns: Array) -> list[Array]:
    """Return the kept rows of columns, shape (n, ...): as many as can be seen, gaps where rows are left out."""
    known = np.flatnonzero(kept)
    rows = known[evenly(len(known), POINTS)]
    left_out = np.cumsum(~kept)[rows]
    gaps = np.flatnonzero(np.diff(left_out)) + 1
    return [np.insert(column[rows], gaps, np.nan, axis=0) for column in columns]


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Choose rows, first and last among them, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp)) if count else np.arange(0)


def _paths(polyline: Array, reference: Array, points: Array, time_s: Array, unit: str = "m") -> list[Drawn]:
    """Draw the path (m, 2), reference and tracked point (n, 2) at times (n,)."""
    told: Any = {
        "hovertemplate": f"%{{fullData.name}} at %{{customdata:.3f}} s: %{{x:.5g}}, %{{y:.5g}} {unit}<extra></extra>"
    }
    told["customdata"] = numbers(time_s)
    return [
        line(polyline[:, 0], polyline[:, 1], "path", PATH, hoverinfo="skip"),
        line(reference[:, 0], reference[:, 1], "reference", REFERENCE, **told),
        line(points[:, 0], points[:, 1], "tracked point p", ACTUAL, **told),
    ]


# The robot ----------------------------------------------------------------------------------------------------------


def outline(robot: Robot) -> dict[str, Array]:
    """Return body, wheels, and the arm to the tracked point, in {L}: shape (k, 2) in m each, gaps between wheels."""
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    body = robot.wheel_distance_m * np.column_stack([np.cos(angle), np.sin(angle)])
    wheels = []
    for hub, direction in zip(robot.wheel_positions, robot.drive_directions, strict=True):
        wheels += [hub - robot.wheel_radius_m * direction, hub + robot.wheel_radius_m * direction, [np.nan, np.nan]]
    arm = np.array([[0.0, 0.0], [0.0, robot.tracked_point_offset_m]])
    return {"body": body, "wheels": np.array(wheels), "arm": arm}


def robots_at(
    robot: Robot, poses: Array, name: str, origin: Array | Sequence[float] = (0.0, 0.0), scale: float = 1.0, **more: Any
) -> list[Drawn]:
    """Draw the robot at poses, shape (k, 3); seen from an origin, shape (2,) in m, in units of 1/scale m."""
    parts = {part: (_placed(shape, poses) - origin) * scale for part, shape in outline(robot).items()}
    quiet: dict[str, Any] = {"hoverinfo": "skip", **more}
    return [
        _outline(parts["body"], name, 1.0, fill="toself", fillcolor="--body", **quiet),
        _outline(parts["wheels"], name, 4.0, **quiet),
        _outline(parts["arm"], name, 1.5, **quiet),
    ]


def _outline(shape: Array, name: str, width_px: float, **more: Any) -> Drawn:
    """Draw a part of the robot, shape (k, 2)."""
    return line(shape[:, 0], shape[:, 1], name, ROBOT._replace(width_px=width_px), **more)


def written_times(robot: Robot, poses: Array, time_s: Array) -> Drawn:
    """Write the time below the robot at poses of shape (k, 3)."""
    texts = [f"{instant:.3g} s" for instant in time_s]
    written = line(poses[:, 0], poses[:, 1] - robot.wheel_distance_m, "robot at instants", ROBOT, hoverinfo="skip")
    return written | {"mode": "text", "text": texts, "textposition": "bottom center"}


def _placed(shape: Array, poses: Array) -> Array:
    """Put a shape (k, 2) of {L} at poses (n, 3) of {G}: one line with gaps, shape (n (k + 1), 2)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    placed = poses[:, np.newaxis, :2] + np.einsum("nij,kj->nki", turn, shape)
    gap = np.full((len(poses), 1, 2), np.nan)
    return np.concatenate([placed, gap], axis=1).reshape(-1, 2)


def _film_parts(robot: Robot, seen: NDArray[np.bool_]) -> list[Drawn]:
    """Draw the robot in {L}: the page's script moves it; nothing if no pose is known."""
    parts = robots_at(robot, np.zeros((1, 3)), "robot, moved by the slider", meta="film") if seen.any() else []
    for part in parts:
        part["line"] = {**part["line"], "color": "--vermilion"}
    return parts


def _film(trace: Trace, seen: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the poses over time by which the script moves the robot."""
    if not seen.any():
        return {}
    rows = np.flatnonzero(seen)
    rows = rows[evenly(len(rows), FRAMES)]
    columns = {"time": trace.time_s[rows], "x": trace.pose[rows, 0], "y": trace.pose[rows, 1]}
    columns["heading"] = wrap_angle(trace.pose[rows, 2])
    return {"film": {name: numbers(values) for name, values in columns.items()}}


def drawable_points(trace: Trace) -> Array:
    """Return the tracked points, shape (n, 2) in m, with gaps where they are lost."""
    return np.where(sane_rows(trace)[:, np.newaxis], trace.point, np.nan)


def sane_rows(trace: Trace) -> NDArray[np.bool_]:
    """Tell which rows have a tracked point near enough to its reference to be drawn, shape (n,) of bool."""
    pose_known = np.isfinite(trace.pose).all(axis=1)
    return np.asarray(pose_known & (np.nan_to_num(tracking_error(trace), nan=np.inf) <= 1.5 * LOST_m))


def robot_rows(trace: Trace, robot: Robot) -> list[int]:
    """Choose rows at which to draw the robot: evenly along the way, far enough apart not to overlap."""
    rows = np.flatnonzero(sane_rows(trace))
    if len(rows) == 0:
        return []
    steps = np.linalg.norm(np.diff(trace.pose[rows, :2], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    count = min(1 + int(way[-1] / (3.0 * robot.wheel_distance_m)), INSTANTS)
    gap = trace.pose[rows[-1], :2] - trace.pose[rows[0], :2]
    wanted = np.linspace(0.0, way[-1], count, endpoint=math.hypot(*gap) > 2.4 * robot.wheel_distance_m)
    return [int(rows[np.searchsorted(way, place)]) for place in wanted]


# Corners ------------------------------------------------------------------------------------------------------------


def corner_view(trace: Trace, polyline: Array) -> tuple[Array, float] | None:
    """Return the first corner driven, shape (2,) in m, and how far to look around it, in m; None without one."""
    corner = first_corner(trace, polyline)
    return None if corner is None else (corner, zoom_size(polyline, drawable_points(trace), corner))


def zoom_size(polyline: Array, points: Array, corner: Array) -> float:
    """Return how far to look around a corner, in m, so as to see the largest deviation from the path near it."""
    reach = 2.0 * TURN_WINDOW * _length(polyline)
    distance = np.linalg.norm(points - corner, axis=1)
    near = np.flatnonzero(distance < reach)
    if len(near) == 0:
        return reach
    near = near[:: 1 + len(near) // 300]
    deviation = distance_to_polyline(points[near], polyline)
    worst = int(deviation.argmax())
    return float(np.clip(max(4.0 * deviation[worst], 1.2 * distance[near[worst]]), 1e-3, reach))


def first_corner(trace: Trace, polyline: Array) -> Array | None:
    """Return the corner of the path, shape (2,) in m, that the reference passes first, if any."""
    passed = []
    for corner in corners(polyline):
        distance = np.linalg.norm(trace.reference_point - corner, axis=1)
        near = np.flatnonzero(distance < 0.002 * _length(polyline))
        if len(near):
            passed.append((near[0], corner))
    return min(passed, key=lambda item: item[0])[1] if passed else None


def corners(polyline: Array) -> list[Array]:
    """Find where a path, shape (m, 2) in m, turns within a small part of its length: points of shape (2,)."""
    steps = np.diff(polyline, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    steps, place = steps[lengths > 0.0], np.cumsum(lengths[lengths > 0.0])
    if len(steps) < 2:
        return []
    turns = wrap_angle(np.diff(np.arctan2(steps[:, 1], steps[:, 0])))
    place, half = place[:-1], 0.5 * TURN_WINDOW * place[-1]
    turned = np.concatenate([[0.0], np.cumsum(turns)])
    within = turned[np.searchsorted(place, place + half, "right")] - turned[np.searchsorted(place, place - half)]
    sharp = np.flatnonzero(np.abs(within) >= TURN_LEAST_rad)
    apart = (np.diff(sharp) > 1) | (np.diff(place[sharp]) > 2.0 * half)
    groups = np.split(sharp, np.flatnonzero(apart) + 1) if len(sharp) else []
    centres = [np.average(place[group], weights=np.abs(turns[group]) + 1e-12) for group in groups]
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    return [np.array([np.interp(centre, way, polyline[:, axis]) for axis in (0, 1)]) for centre in centres]


def distance_to_polyline(points: Array, polyline: Array) -> Array:
    """Return the distance of points (k, 2) from a polyline (m, 2): shape (k,), in m."""
    start, step = polyline[:-1], np.diff(polyline, axis=0)
    square = np.maximum((step**2).sum(axis=1), np.finfo(np.float64).tiny)
    offset = points[:, np.newaxis] - start
    along = np.clip((offset * step).sum(axis=2) / square, 0.0, 1.0)
    gap = offset - along[..., np.newaxis] * step
    return np.asarray(np.hypot(gap[..., 0], gap[..., 1]).min(axis=1))


def _length(polyline: Array) -> float:
    """Return the length of a polyline (m, 2), in m."""
    return float(np.linalg.norm(np.diff(polyline, axis=0), axis=1).sum())
