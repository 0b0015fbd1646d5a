"""The report of a run: figures as PNG files, and one page that carries them and needs nothing else.

`draw_figures` makes the figures, `write_report` the files. Numbers that are not finite leave gaps, those far outside
are beyond the axes; both are said in the figure.
"""

import base64
import html
import io
import math
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from host_sim.metrics import heading_error, tracking_error, wrap_angle
from host_sim.robot import Array, Robot, load_robot
from host_sim.trace import Trace, write_atomically

PAGE_NAME = "report.html"
DOTS_PER_INCH = 160
LINEAR_SLIP = 0.1  # Assumption 1 of the paper: the traction curve is a line up to here
SPINNING = 100.0  # slip ratio of a wheel that spins on the spot; the axis ends here
LOST_m = 2.0  # an error above it is called diverged
OVERFLOW = 1e9  # numbers beyond are drawn as gaps: the drawing library squares them
TURN_WINDOW = 0.025  # of the path's length: a corner turns within it by ...
TURN_LEAST_rad = math.radians(25.0)  # ... at least this; a circle turns by 9 degrees, a lemniscate by 23

# Okabe and Ito's colours, told apart with any colour vision; the line styles do so in black and white.
WHEEL_STYLES = (("#0072B2", "-"), ("#D55E00", "--"), ("#009E73", "-."))
ACTUAL, REFERENCE, LIMIT, SHADE = "#0072B2", "#E69F00", "#555555", "#E8EEF2"
PALE_BOX = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 11.0,
    "axes.titlesize": 11.5,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "text.usetex": False,
    "figure.constrained_layout.use": True,
}

CAPTIONS = {
    "path": "Path of the tracked point p and its reference, seen from above; the robot to scale, p on its rim.",
    "error": "Distance of the tracked point from its reference, and heading minus its reference.",
    "slip": "Slip ratio of each wheel; shaded: where traction is linear, |s| up to 0.1.",
    "force": "Longitudinal force of the floor on each wheel, and what the floor can give.",
    "torque": "Torque of each motor, and its limit.",
    "timing": "How often each time was measured; whatever is beyond the axis is in its last class.",
}

CSS = """
:root { color-scheme: light; }
body { font: 16px/1.45 system-ui, sans-serif; color: #222; background: #fff; max-width: 1100px; margin: 0 auto;
       padding: 1rem; }
h1 { font-size: 1.5rem; margin: 0.5rem 0; }
h2 { font-size: 1.15rem; margin: 1.8rem 0 0.5rem; border-bottom: 1px solid #ccc;
     break-after: avoid; }
.status { display: inline-block; padding: 0.1rem 0.6rem; border-radius: 0.3rem; color: #fff; background: #9e3d00; }
.status.completed { background: #00664b; }
.columns { columns: 2 22rem; column-gap: 2rem; }
figure { margin: 0 0 1rem; break-inside: avoid; }
img { width: 100%; height: auto; }
figcaption { font-size: 0.875rem; color: #444; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; margin-bottom: 0.7rem; }
.columns table { break-inside: avoid; }
th, td { text-align: left; vertical-align: top; padding: 0.2rem 0.5rem 0.2rem 0; border-bottom: 1px solid #e4e4e4;
         overflow-wrap: anywhere; }
th { font-weight: 400; color: #444; width: 60%; }
td { font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; background: #f4f4f4; padding: 0.6rem; border-radius: 0.3rem; }
pre span { display: inline-block; }
@media print { body { font-size: 10pt; max-width: none; padding: 0; } pre { border: 1px solid #ccc; } }
"""


def write_report(
    folder: Path, trace: Trace, result: Mapping[str, Any], path_polyline: Array, robot: Robot | None = None
) -> Path:
    """Write the figures and the page of a run into its folder.

    Parameters
    ----------
    folder
        The folder of the run; made if need be.
    trace
        What happened; may be empty or diverged.
    result
        What ``result.json`` holds; ``result["scenario"]["command"]``, if there, is the command that repeats the run.
    path_polyline
        The path as points in {G}, shape (m, 2) in m.
    robot
        The robot driven; the one of the robot file by default.

    Returns
    -------
    Path
        The page, ``report.html``.
    """
    figures = draw_figures(trace, path_polyline, robot or load_robot())
    if result.get("histograms"):
        figures["timing"] = draw_histograms(result["histograms"])
    pictures = {name: render_png(figure) for name, figure in figures.items()}
    for name, picture in pictures.items():
        write_atomically(folder / f"{name}.png", picture)
    page = folder / PAGE_NAME
    write_atomically(page, _page(result, pictures).encode("utf-8"))
    return page


def draw_figures(trace: Trace, path_polyline: Array, robot: Robot) -> dict[str, Figure]:
    """Draw every figure of a run; the names are those of the files. ``path_polyline``: shape (m, 2) in m."""
    with rc_context(STYLE):
        return {
            "path": _draw_path(trace, path_polyline, robot),
            "error": _draw_error(trace),
            "slip": _draw_slip(trace),
            "force": _draw_force(trace, robot.friction_limit_N),
            "torque": _draw_torque(trace, robot.torque_limit_Nm),
        }


def draw_histograms(histograms: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw counts of measured times, a panel a name; see ``realtime.histogram`` for what a histogram holds."""
    with rc_context(STYLE):
        figure = Figure(figsize=(5.6, 1.9 * len(histograms)))
        panels = np.atleast_1d(figure.subplots(len(histograms), 1))
        for axes, (name, values) in zip(panels, histograms.items(), strict=True):
            counts = np.asarray(values["counts"], dtype=float)
            edges_us = values["class_us"] * np.arange(len(counts) + 1)
            axes.stairs(counts, edges_us, fill=True, color=ACTUAL)
            if counts.any():
                axes.set_yscale("log")
                axes.set_ylim(bottom=0.5)
            axes.set_title(f"{name.removesuffix('_us').replace('_', ' ').capitalize()}: ticks over time (µs)")
        return figure


# Figures over time --------------------------------------------------------------------------------------------------


def _draw_error(trace: Trace) -> Figure:
    """Draw tracking error and heading error over time."""
    figure = Figure(figsize=(5.6, 4.4))
    upper, lower = figure.subplots(2, 1, sharex=True)
    error = tracking_error(trace)
    scale, unit = _length_unit(_largest(error, LOST_m))
    upper.set_title(f"Tracking error ({unit})")
    _plot(upper, trace, error * scale, ACTUAL)
    _limit_view(upper, error * scale, ceiling=1.5 * LOST_m * scale, lowest=0.0)
    turn = heading_error(trace)
    scale, unit = (1e3, "mrad") if _largest(turn, math.pi) < 0.1 else (1.0, "rad")
    lower.set_title(f"Heading error ({unit})")
    _plot(lower, trace, turn * scale, ACTUAL)
    _limit_view(lower, turn * scale, ceiling=1.05 * math.pi * scale)
    lower.set_xlabel("time (s)")
    return figure


def _draw_slip(trace: Trace) -> Figure:
    """Draw the slip ratios; logarithmic outside of the linear region once a wheel spins."""
    figure, axes = _time_figure("Slip ratio of each wheel (1), linear region shaded")
    axes.axhspan(-LINEAR_SLIP, LINEAR_SLIP, color=SHADE, zorder=0)
    _plot_wheels(axes, trace, trace.slip_ratio)
    largest = _largest(trace.slip_ratio, SPINNING)
    if largest > 10.0 * LINEAR_SLIP:
        axes.set_yscale("symlog", linthresh=LINEAR_SLIP)
        axes.set_title("Slip ratio of each wheel (1), logarithmic beyond the shade")
    _limit_view(axes, trace.slip_ratio, ceiling=SPINNING, least=1.5 * LINEAR_SLIP)
    return figure


def _draw_force(trace: Trace, limit_N: float) -> Figure:
    """Draw the wheel forces between the friction limits."""
    figure, axes = _time_figure("Force of the floor on each wheel (N)")
    _plot_between_limits(axes, trace, trace.wheel_force, limit_N, f"friction limit {limit_N:g} N")
    return figure


def _draw_torque(trace: Trace, limit_Nm: float) -> Figure:
    """Draw the motor torques between their limits."""
    figure, axes = _time_figure("Torque of each motor (N·m)")
    _plot_between_limits(axes, trace, trace.torque, limit_Nm, f"torque limit {limit_Nm:g} N·m")
    return figure


def _time_figure(title: str) -> tuple[Figure, Axes]:
    """Make a figure of one panel over time."""
    figure = Figure(figsize=(5.6, 3.4))
    axes = figure.subplots()
    axes.set_title(title)
    axes.set_xlabel("time (s)")
    return figure, axes


def _plot_between_limits(axes: Axes, trace: Trace, values: Array, limit: float, label: str) -> None:
    """Draw a line for each wheel, values of shape (n, 3), and plus and minus the limit."""
    for level in (-limit, limit):
        axes.axhline(level, color=LIMIT, linewidth=1.0, linestyle=(0, (1, 1.5)))
    _plot_wheels(axes, trace, values)
    _limit_view(axes, values, ceiling=4.0 * limit, least=1.2 * limit)
    _label_line(axes, limit, label)


def _plot_wheels(axes: Axes, trace: Trace, values: Array) -> None:
    """Draw a line for each wheel, values of shape (n, 3), and their legend below the axes."""
    for wheel, (colour, style) in enumerate(WHEEL_STYLES):
        _plot(axes, trace, values[:, wheel], colour, style, label=f"wheel {wheel + 1}")
    axes.get_figure().legend(loc="outside lower center", ncols=3)  # type: ignore[union-attr]


def _plot(axes: Axes, trace: Trace, values: Array, colour: str, style: str = "-", label: str | None = None) -> None:
    """Draw values of shape (n,) over time, with gaps where they cannot be drawn."""
    axes.plot(_drawable(trace.time_s), _drawable(values), color=colour, linestyle=style, label=label)
    if len(trace) > 1:
        axes.set_xlim(trace.time_s[0], trace.time_s[-1])


def _label_line(axes: Axes, level: float, text: str) -> None:
    """Write the name of a horizontal line above its right end."""
    axes.annotate(
        text,
        (1.0, level),
        xycoords=axes.get_yaxis_transform(),
        xytext=(-3, 3),
        textcoords="offset points",
        horizontalalignment="right",
        fontsize=10.0,
        color=LIMIT,
        bbox=PALE_BOX,
    )


def _limit_view(axes: Axes, values: Array, ceiling: float, least: float = 0.0, lowest: float | None = None) -> None:
    """Fit the vertical axis to the finite values, and say in the figure what it leaves out.

    Parameters
    ----------
    values
        What is drawn, in the unit of the axis.
    ceiling
        The axis ends here, however large the values.
    least
        The axis reaches at least as far.
    lowest
        Lower end of the axis; minus the upper end by default.
    """
    top = max(1.08 * _largest(values, ceiling), least) or 1.0
    top = min(top, ceiling)
    axes.set_ylim(-top if lowest is None else lowest, top)
    _note_omissions(axes, values, top)


def _note_omissions(axes: Axes, values: Array, top: float) -> None:
    """Say how many values are not finite or outside of the axis, if any, or that there are none at all."""
    if values.size == 0:
        _note(axes, "nothing was recorded")
        return
    strange = int(np.count_nonzero(~np.isfinite(values)))
    outside = int(np.count_nonzero(np.abs(values) > top)) - int(np.count_nonzero(np.isinf(values)))
    parts = [f"{outside} off the axis"] if outside else []
    parts += [f"{strange} not finite"] if strange else []
    if parts:
        _note(axes, f"not shown: {', '.join(parts)} (of {values.size})")


def _note(axes: Axes, text: str) -> None:
    """Write a remark below the title, where it hides no data."""
    axes.set_title(f"{axes.get_title(loc='left')}\n{text}")


# Figure of the path -------------------------------------------------------------------------------------------------


def _draw_path(trace: Trace, polyline: Array, robot: Robot) -> Figure:
    """Draw the path from above, and below it the first corner driven, enlarged."""
    corner = _first_corner(trace, polyline)
    figure = Figure(figsize=(5.6, 5.0 if corner is None else 7.4))
    heights = [1.0] if corner is None else [1.6, 1.0]
    panels = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)
    axes = panels[0, 0]
    axes.set_title("Path from above (m)")
    points = _drawable_points(trace)
    reference = np.where(_sane_rows(trace)[:, np.newaxis], trace.reference_point, np.nan)
    _plot_paths(axes, polyline, reference, points)
    for row in _robot_rows(trace, robot):
        _draw_robot(axes, robot, trace.pose[row], f"{trace.time_s[row]:.3g} s")
    if corner is not None:
        half = _zoom_size(polyline, points, corner)
        corners = corner + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
        axes.plot(*corners.T, color="black", linewidth=0.8, zorder=6.0, label="enlarged below")
        _draw_corner(panels[1, 0], polyline, reference, points, corner, half)
    _view_path(axes, trace, robot)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _plot_paths(axes: Axes, polyline: Array, reference: Array, points: Array) -> None:
    """Draw the path (m, 2), the reference and the tracked point on it, both (n, 2), to one scale along both axes."""
    axes.plot(polyline[:, 0], polyline[:, 1], color="#bbbbbb", linewidth=1.0, label="path")
    axes.plot(reference[:, 0], reference[:, 1], color=REFERENCE, linewidth=3.5, label="reference")
    axes.plot(points[:, 0], points[:, 1], color=ACTUAL, label="tracked point p")
    axes.set_aspect("equal", adjustable="datalim")


def _drawable_points(trace: Trace) -> Array:
    """Return the tracked points, shape (n, 2) in m, with gaps where they are lost."""
    return np.where(_sane_rows(trace)[:, np.newaxis], trace.point, np.nan)


def _sane_rows(trace: Trace) -> NDArray[np.bool_]:
    """Tell which rows have a tracked point near enough to its reference to be drawn, shape (n,) of bool."""
    pose_known = np.isfinite(trace.pose).all(axis=1)
    return np.asarray(pose_known & (np.nan_to_num(tracking_error(trace), nan=np.inf) <= 1.5 * LOST_m))


def _view_path(axes: Axes, trace: Trace, robot: Robot) -> None:
    """Fit the axes to the way driven and the robot on it, and say what they leave out."""
    seen = _sane_rows(trace)
    centres = trace.pose[seen, :2]
    points = np.concatenate([centres, trace.point[seen], trace.reference_point[seen]])
    if len(points) == 0:
        _note(axes, "no position was recorded that can be shown")
        return
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.6 * robot.wheel_distance_m, 0.07 * float((high - low).max()))
    low, high = low - robot.wheel_distance_m - margin, high + robot.wheel_distance_m + margin
    _view_at_least(axes, low, high)
    hidden = len(trace) - int(np.count_nonzero(seen))
    if hidden:
        _note(axes, f"not shown: {hidden} of {len(trace)} positions, lost or not finite")


def _view_at_least(axes: Axes, low: Array, high: Array) -> None:
    """Show at least the rectangle between two corners, shape (2,) each; equal scales may ask for more."""
    axes.set_xlim(low[0], high[0], auto=True)
    axes.set_ylim(low[1], high[1], auto=True)


def _robot_rows(trace: Trace, robot: Robot) -> list[int]:
    """Choose rows at which to draw the robot: evenly along the way, far enough apart not to overlap."""
    rows = np.flatnonzero(_sane_rows(trace))
    if len(rows) == 0:
        return []
    steps = np.linalg.norm(np.diff(trace.pose[rows, :2], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    count = min(1 + int(way[-1] / (3.0 * robot.wheel_distance_m)), 6)
    gap = trace.pose[rows[-1], :2] - trace.pose[rows[0], :2]
    wanted = np.linspace(0.0, way[-1], count, endpoint=math.hypot(*gap) > 2.4 * robot.wheel_distance_m)
    return [int(rows[np.searchsorted(way, place)]) for place in wanted]


def _draw_robot(axes: Axes, robot: Robot, pose: Array, label: str) -> None:
    """Draw body, wheels and tracked point at a pose, shape (3,) in m, m, rad, with a label beside it."""
    heading = pose[2]
    turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
    style: dict[str, Any] = {"color": "#333333", "zorder": 3.0}
    body = Circle((pose[0], pose[1]), robot.wheel_distance_m, facecolor="#99999933", edgecolor="#333333", linewidth=0.8)
    axes.add_patch(body)
    drive = robot.Jr[:, :2]
    for direction in drive:
        hub = robot.wheel_distance_m * np.array([direction[1], -direction[0]])
        ends = np.stack([hub - robot.wheel_radius_m * direction, hub + robot.wheel_radius_m * direction])
        wheel = pose[:2] + ends @ turn.T
        axes.plot(wheel[:, 0], wheel[:, 1], linewidth=3.0, solid_capstyle="butt", **style)
    point = robot.tracked_point(pose)
    axes.plot([pose[0], point[0]], [pose[1], point[1]], linewidth=0.8, **style)
    axes.plot(point[0], point[1], marker="o", markersize=4.0, color=ACTUAL, zorder=4.0)
    place = np.array([pose[0], pose[1] - robot.wheel_distance_m])
    _annotate_below(axes, place, label)


def _annotate_below(axes: Axes, place: Array, text: str) -> None:
    """Write a text below a place, shape (2,) in m."""
    axes.annotate(
        text,
        (place[0], place[1]),
        xytext=(0, -3),
        textcoords="offset points",
        horizontalalignment="center",
        verticalalignment="top",
        fontsize=9.5,
        zorder=5.0,
        bbox=PALE_BOX,
    )


def _draw_corner(axes: Axes, polyline: Array, reference: Array, points: Array, corner: Array, half: float) -> None:
    """Draw path (m, 2), reference and tracked points (n, 2) within ``half`` of a corner, shape (2,), all in m."""
    scale, unit = _length_unit(half)
    _plot_paths(axes, *((points_m - corner) * scale for points_m in (polyline, reference, points)))
    _view_at_least(axes, np.full(2, -half * scale), np.full(2, half * scale))
    axes.set_title(f"The first corner, enlarged ({unit} from {corner[0]:.3f} m, {corner[1]:.3f} m)")


def _zoom_size(polyline: Array, points: Array, corner: Array) -> float:
    """Return how far to look around a corner, in m, so as to see the largest deviation from the path near it."""
    reach = 2.0 * TURN_WINDOW * _length(polyline)
    distance = np.linalg.norm(points - corner, axis=1)
    near = np.flatnonzero(distance < reach)
    if len(near) == 0:
        return reach
    near = near[:: 1 + len(near) // 300]
    deviation = _distance_to_polyline(points[near], polyline)
    worst = int(deviation.argmax())
    return float(np.clip(max(4.0 * deviation[worst], 1.2 * distance[near[worst]]), 1e-3, reach))


def _first_corner(trace: Trace, polyline: Array) -> Array | None:
    """Return the corner of the path, shape (2,) in m, that the reference passes first, if any."""
    passed = []
    for corner in _corners(polyline):
        distance = np.linalg.norm(trace.reference_point - corner, axis=1)
        near = np.flatnonzero(distance < 0.002 * _length(polyline))
        if len(near):
            passed.append((near[0], corner))
    return min(passed, key=lambda item: item[0])[1] if passed else None


def _corners(polyline: Array) -> list[Array]:
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


def _distance_to_polyline(points: Array, polyline: Array) -> Array:
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


# Numbers that can be drawn ------------------------------------------------------------------------------------------


def _drawable(values: Array) -> Array:
    """Return a copy with gaps for numbers that the drawing library cannot take."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) < OVERFLOW, values, np.nan)


def _largest(values: Array, ceiling: float) -> float:
    """Return the largest finite magnitude, at most the ceiling; 0 if there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(min(finite.max(initial=0.0), ceiling))


def _length_unit(largest_m: float) -> tuple[float, str]:
    """Choose a readable unit for lengths up to this one: its number in a metre, and its name."""
    for limit, scale, unit in ((2e-4, 1e6, "µm"), (0.05, 1e3, "mm"), (0.5, 1e2, "cm")):
        if 0.0 < largest_m < limit:
            return scale, unit
    return 1.0, "m"


# The page -----------------------------------------------------------------------------------------------------------


def render_png(figure: Figure) -> bytes:
    """Render a figure; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def _page(result: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Compose the page from the result and the rendered figures."""
    scenario = dict(result.get("scenario") or {})
    command = scenario.pop("command", None)
    status = str(result.get("status", "unknown"))
    title = html.escape(_title(scenario))
    figures = "\n".join(_figure(name, picture) for name, picture in pictures.items())
    numbers = {
        key: value for key, value in result.items() if key not in ("scenario", "status", "histograms") and value != ""
    }
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{CSS}</style>
</head>
<body>
<h1>{title}</h1>
<p>Status: <span class="status {html.escape(status)}">{html.escape(status)}</span></p>
{_command(command)}
<h2>Results</h2>
<div class="columns">
{_tables(numbers)}
</div>
<h2>Figures</h2>
<div class="columns">
{figures}
</div>
<h2>Scenario</h2>
{_table("", scenario)}
</body>
</html>
"""


def _title(scenario: Mapping[str, Any]) -> str:
    """Name the run in a line."""
    parts = ["omnibot run"]
    if "path" in scenario:
        parts.append(f"{scenario['path']} path")
    if "speed_m_per_s" in scenario:
        parts.append(f"{_text(scenario['speed_m_per_s'])} m/s")
    return ", ".join(parts)


def _command(command: object) -> str:
    """Show the command that repeats the run, where it is known; its lines break between words only."""
    if command is None:
        return ""
    line = shlex.join(map(str, command)) if isinstance(command, list | tuple) else str(command)
    words = " ".join(f"<span>{html.escape(word)}</span>" for word in line.split(" "))
    return f"<p>To repeat it:</p>\n<pre>{words}</pre>"


def _figure(name: str, picture: bytes) -> str:
    """Put a rendered figure and its caption on the page."""
    data = base64.b64encode(picture).decode("ascii")
    caption = html.escape(CAPTIONS[name])
    image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _tables(numbers: Mapping[str, Any]) -> str:
    """Make a table of each section of the result, and one of what is in none."""
    sections = {key: value for key, value in numbers.items() if isinstance(value, Mapping)}
    single = {key: value for key, value in numbers.items() if key not in sections}
    tables = [_table(key, value) for key, value in sections.items()]
    return "\n".join([*tables, *([_table("", single)] if single else [])])


def _table(caption: str, values: Mapping[str, Any]) -> str:
    """Make a table of names and values; nested names are joined by dots."""
    head = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    rows = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(_text(value))}</td></tr>\n'
        for name, value in _flat(values)
    )
    return f"<table>{head}\n{rows}</table>"


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Walk through nested values, with dotted names."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _text(value: object) -> str:
    """Write a value for a reader: four digits; null is a figure that has no finite value."""
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    return str(value)
