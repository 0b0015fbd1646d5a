"""The report of a run: what happened, on one page.

Numbers that are not finite leave gaps, those far outside are beyond the axes; both are said above the figure.
"""

import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from host_sim.metrics import heading_error, tracking_error
from host_sim.report import page
from host_sim.report.figure import (
    ACTUAL,
    STYLES,
    Axis,
    Figure,
    Panel,
    Range,
    angle_unit,
    band,
    bars,
    curve,
    largest,
    length_unit,
    level,
)
from host_sim.report.page import Tile
from host_sim.report.path import LOST_m, path_figure
from host_sim.robot import Array, Robot, load_robot
from host_sim.trace import Trace, write_atomically

LINEAR_SLIP = 0.1  # Assumption 1 of the paper: the traction curve is a line up to here
SPINNING = 100.0  # slip ratio of a wheel that spins on the spot; the axis ends here
TIME = Axis("time (s)")
WHEELS_CAPTION = (
    f"What each wheel does. Shaded: where traction is linear, |s| up to {LINEAR_SLIP:g}. The floor gives a wheel no "
    "more than the friction limit; the firmware asks for no more than its bound."
)


def write_report(
    folder: Path, trace: Trace, result: Mapping[str, Any], path_polyline: Array, robot: Robot | None = None
) -> Path:
    """Write the page of a run into its folder.

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
    file = folder / page.PAGE_NAME
    text = run_page(trace, result, path_polyline, robot or load_robot())
    write_atomically(file, text.encode("utf-8"))
    return file


def run_page(trace: Trace, result: Mapping[str, Any], polyline: Array, robot: Robot) -> str:
    """Compose the page."""
    scenario = dict(result.get("scenario") or {})
    command = scenario.pop("command", None)
    blocks = [
        page.status(str(result.get("status", "unknown")), str(result.get("reason", ""))),
        page.tiles(tiles(result, robot)),
        page.figures(figures(trace, polyline, robot, result)),
    ]
    if command is not None:
        line = shlex.join(map(str, command)) if isinstance(command, list | tuple) else str(command)
        blocks += [page.heading("To repeat it"), page.command(line)]
    blocks += [
        page.heading("Results"),
        page.tables(_grouped(_numbers(result), "results")),
        page.heading("Scenario"),
        page.tables(_grouped(scenario, "inputs")),
    ]
    return page.compose(title_of(scenario), "omnibot run", blocks)


def title_of(scenario: Mapping[str, Any]) -> str:
    """Name the run in a line."""
    path, speed, order = (scenario.get(name) for name in ("path", "speed_m_per_s", "order"))
    parts = [f"{path} path" if path is not None else "Run"]
    parts += [f"at {page.value_text(speed)} m/s"] if speed is not None else []
    if order is not None:
        parts.append(f"with {'order ' if str(order).isdigit() else 'the '}{order}")
    text = " ".join(parts)
    return text[:1].upper() + text[1:]


def _numbers(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what no other part of the page shows."""
    shown = ("scenario", "status", "reason", "histograms")
    numbers = {key: value for key, value in result.items() if key not in shown}
    return dict(sorted(numbers.items(), key=lambda item: item[0] == "versions"))  # those last


def _grouped(values: Mapping[str, Any], rest: str) -> dict[str, Mapping[str, Any]]:
    """Make a section of each nested value, and one of what is in none."""
    single = {key: value for key, value in values.items() if not isinstance(value, Mapping)}
    nested = {key: value for key, value in values.items() if isinstance(value, Mapping) and value}
    return ({rest: single} if single else {}) | nested


# Numbers that matter ------------------------------------------------------------------------------------------------


def tiles(result: Mapping[str, Any], robot: Robot) -> Iterator[Tile]:
    """Yield the numbers that matter, of those that the result holds."""
    beside = {
        "tracking.max_path_deviation_m": "rounding of corners included",
        "slip.max_ratio": f"traction is linear up to {LINEAR_SLIP:g}",
        "torque.max_Nm": f"limit {robot.torque_limit_Nm:g} N·m{_saturated(result)}",
        "timing.step_time_us.p99": f"on this machine{_missed(result)}",
        "bus.load_fraction_at_1Mbps": f"of 1 Mbit/s{_frames(result)}",
    }
    for name, key, text in FIGURES:
        value = find(result, key)
        if value is not None:
            yield Tile(name, text(value), beside.get(key, "from the reference"), key)


def figure_texts(result: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of merit of a result with readable units, by name."""
    texts = {"Status": page.value_text(result.get("status", "unknown"))}
    for name, key, text in FIGURES:
        value = find(result, key)
        if value is not None:
            texts[name] = text(value)
    return texts


def find(values: Any, key: str) -> Any:
    """Return the value at a dotted key, None if there is none."""
    for part in key.split("."):
        values = values.get(part) if isinstance(values, Mapping) else None
    return values


def _with(unit: str) -> Callable[[Any], str]:
    return lambda value: f"{page.value_text(value)} {unit}"


def _saturated(result: Mapping[str, Any]) -> str:
    fraction = find(result, "torque.saturated_fraction")
    return "" if fraction is None else f", reached in {percent_text(fraction)} of ticks"


def _missed(result: Mapping[str, Any]) -> str:
    missed = find(result, "timing.deadline_misses")
    return "" if missed is None else f"; {missed} deadlines missed"


def _frames(result: Mapping[str, Any]) -> str:
    frames, dropped = find(result, "bus.frames"), find(result, "bus.dropped")
    return "" if frames is None else f"; {frames} frames, {dropped} dropped"


def length_text(value_m: float) -> str:
    """Write a length in a readable unit, four digits."""
    scale, unit = length_unit(abs(value_m))
    return f"{scale * value_m:.4g} {unit}"


def angle_text(value_rad: float) -> str:
    """Write an angle in a readable unit, four digits."""
    scale, unit = angle_unit(abs(value_rad))
    return f"{scale * value_rad:.4g} {unit}"


def percent_text(fraction: float) -> str:
    """Write a fraction in per cent, four digits."""
    return f"{100.0 * fraction:.4g} %"


# Names of the numbers that matter, their places in ``result.json``, and how they are written.
FIGURES: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("Largest tracking error", "tracking.max_error_m", length_text),
    ("Tracking error, rms", "tracking.rms_error_m", length_text),
    ("Largest path deviation", "tracking.max_path_deviation_m", length_text),
    ("Largest heading error", "tracking.max_heading_error_rad", angle_text),
    ("Largest slip ratio", "slip.max_ratio", page.value_text),
    ("Largest torque", "torque.max_Nm", _with("N·m")),
    ("Step time, p99", "timing.step_time_us.p99", _with("µs")),
    ("Bus load", "bus.load_fraction_at_1Mbps", percent_text),
)


# Figures ------------------------------------------------------------------------------------------------------------


def figures(trace: Trace, polyline: Array, robot: Robot, result: Mapping[str, Any]) -> Iterator[Figure]:
    """Yield every figure of a run; shape (m, 2) in m of the path."""
    told = find(result, "scenario.parameters") or {}

    def bound(name: str) -> float:
        """Return what the firmware was told, or its default."""
        return float(told.get(name, robot.parameter(name).default))

    yield path_figure(trace, polyline, robot)
    yield error_figure(trace)
    limits_N = {"friction limit": robot.friction_limit_N, "firmware's bound": bound("force_bound_N")}
    limits_Nm = {"limit": robot.torque_limit_Nm, "firmware's bound": bound("torque_bound_Nm")}
    panels = [
        slip_panel(trace),
        between_limits("Force of the floor on each wheel", "N", trace, trace.wheel_force, limits_N),
        between_limits("Torque of each motor", "N·m", trace, trace.torque, limits_Nm),
    ]
    yield Figure("wheels", WHEELS_CAPTION, panels, wide=True)
    if result.get("histograms"):
        yield timing_figure(result["histograms"])


def error_figure(trace: Trace) -> Figure:
    """Draw tracking error and heading error over time."""
    error, turn = tracking_error(trace), heading_error(trace)
    scale, unit = length_unit(largest(error, LOST_m))
    angle_scale, angle = angle_unit(largest(turn, np.pi))
    top = _top(error * scale, 1.5 * LOST_m * scale)
    turn_top = _top(turn * angle_scale, 1.05 * np.pi * angle_scale)
    panels = [
        _over_time(f"Tracking error ({unit})", trace, {"error": error * scale}, (0.0, top), unit),
        _over_time(f"Heading error ({angle})", trace, {"error": turn * angle_scale}, (-turn_top, turn_top), angle),
    ]
    caption = "Distance of the tracked point from its reference, and heading minus its reference."
    return Figure("error", caption, panels, wide=True)


def slip_panel(trace: Trace) -> Panel:
    """Draw the slip ratios; their magnitudes, logarithmic, once a wheel spins."""
    linear = band(-LINEAR_SLIP, LINEAR_SLIP)
    if largest(trace.slip_ratio, SPINNING) > 10.0 * LINEAR_SLIP:
        magnitudes = _by_wheel(np.abs(trace.slip_ratio))
        linear = band(1e-9, LINEAR_SLIP)
        return _over_time(
            "Magnitude of the slip ratio (1)", trace, magnitudes, (1e-4, SPINNING), "", [linear], log=True
        )
    top = max(_top(trace.slip_ratio, SPINNING), 1.2 * LINEAR_SLIP)
    return _over_time("Slip ratio (1)", trace, _by_wheel(trace.slip_ratio), (-top, top), "", [linear])


def between_limits(title: str, unit: str, trace: Trace, values: Array, limits: Mapping[str, float]) -> Panel:
    """Draw what each wheel has, shape (n, 3), between plus and minus limits of the same unit."""
    drawable = {name: limit for name, limit in limits.items() if limit <= 4.0 * min(limits.values())}
    most = max(drawable.values())
    top = max(_top(values, 4.0 * most), 1.25 * most)
    names: dict[float, str] = {}
    for name, limit in drawable.items():
        names[limit] = f"{names[limit]}, {name}" if limit in names else name
    shapes = [level(limit, f"{name} {limit:g} {unit}") for limit, name in names.items()]
    shapes += [level(-limit) for limit in names]
    return _over_time(f"{title} ({unit})", trace, _by_wheel(values), (-top, top), unit, shapes)


def timing_figure(histograms: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw counts of measured times, a panel a name; see ``realtime.histogram`` for what a histogram holds."""
    panels = []
    for name, values in histograms.items():
        counts = np.asarray(values["counts"], dtype=float)
        middles_us = values["class_us"] * (np.arange(len(counts)) + 0.5)
        drawn = bars(middles_us, counts, "ticks", ACTUAL.colour, width=values["class_us"])
        title = f"{name.removesuffix('_us').replace('_', ' ').capitalize()} (ticks)"
        top = max(counts.max(initial=1.0), 1.0)
        panels.append(Panel(title, [drawn], Axis("time (µs)"), Axis(view=(0.5, 2.0 * top), log=True), height_px=200))
    caption = "How often each time was measured; whatever is beyond the axis is in its last class."
    return Figure("timing", caption, panels, wide=True)


def _by_wheel(values: Array) -> dict[str, Array]:
    """Name the columns of values of shape (n, 3)."""
    return {f"wheel {wheel + 1}": values[:, wheel] for wheel in range(3)}


def _over_time(
    title: str, trace: Trace, lines: Mapping[str, Array], view: Range, unit: str, shapes: Any = (), *, log: bool = False
) -> Panel:
    """Draw lines of shape (n,) each over the time of a run."""
    drawn = [curve(trace.time_s, y, name, style) for (name, y), style in zip(lines.items(), STYLES, strict=False)]
    note = omissions(np.stack(list(lines.values())), view)
    return Panel(title, drawn, TIME, Axis(view=view, log=log, unit=unit), shapes, note, group="time")


def _top(values: Array, ceiling: float) -> float:
    """Return where an axis ends that shows the finite values, up to a ceiling."""
    return min(1.08 * largest(values, ceiling) or 1.0, ceiling)


def omissions(values: Array, view: Range) -> str:
    """Say how many values are not finite or outside of the view, if any, or that there are none at all."""
    if values.size == 0:
        return "nothing was recorded"
    strange = int(np.count_nonzero(~np.isfinite(values)))
    outside = int(np.count_nonzero(np.abs(values) > view[1])) - int(np.count_nonzero(np.isinf(values)))
    parts = [f"{outside} off the axis"] if outside else []
    parts += [f"{strange} not finite"] if strange else []
    return f"not shown: {', '.join(parts)} (of {values.size})" if parts else ""
