"""Runs side by side, on one page."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from host_sim.errors import OmnibotError
from host_sim.metrics import heading_error, tracking_error
from host_sim.report import page
from host_sim.report.figure import (
    REFERENCE,
    STYLES,
    Axis,
    Figure,
    Panel,
    Shape,
    Style,
    angle_unit,
    band,
    curve,
    largest,
    length_unit,
    level,
    line,
)
from host_sim.report.page import Table
from host_sim.report.path import HEIGHT_px, LOST_m, corner_view, enlarged_title, sane_rows, shown
from host_sim.report.run import LINEAR_SLIP, TIME, figure_texts, find
from host_sim.robot import Array, Robot
from host_sim.trace import Trace, write_atomically

FAR_APART = 20.0  # errors so many times larger than others are drawn on a logarithmic axis
RESULT_FILE = "result.json"


@dataclass(frozen=True)
class Run:
    """One of the runs: a name that no other has, what was recorded, and what ``result.json`` holds."""

    name: str
    trace: Trace
    result: Mapping[str, Any]


def load_runs(folders: Sequence[Path]) -> list[Run]:
    """Read the folders of runs; a trace without a result beside it is taken too."""
    names = names_of(folders)
    return [Run(name, Trace.load(folder), _result(folder)) for name, folder in zip(names, folders, strict=True)]


def names_of(folders: Sequence[Path]) -> list[str]:
    """Return the last parts of paths, as few of them as tell all apart."""
    whole = [folder.resolve().parts for folder in folders]
    for count in range(1, max(map(len, whole), default=0) + 1):
        names = ["/".join(parts[-count:]) for parts in whole]
        if len(set(names)) == len(names):
            return names
    return [f"{folder} ({place})" for place, folder in enumerate(folders, start=1)]


def _result(folder: Path) -> dict[str, Any]:
    """Return what the run's ``result.json`` holds, nothing where there is none."""
    file = folder / RESULT_FILE
    if not file.exists():
        return {}
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OmnibotError(f"the result {file} is damaged: {error}; record the run again") from error
    if not isinstance(result, dict):
        raise OmnibotError(f"the result {file} is damaged: no JSON object; record the run again")
    return result


def write_comparison(
    folder: Path, runs: Sequence[Run], differences: Mapping[str, Sequence[str]], robot: Robot, command: str
) -> Path:
    """Write the page of runs side by side.

    Parameters
    ----------
    folder
        Where; made if need be.
    runs
        Two or more.
    differences
        Where each run's trace differs from the first one's, by name; nothing where it is the same to the byte.
    robot
        Whose limits are drawn.
    command
        What repeats it.

    Returns
    -------
    Path
        The page, ``report.html``.
    """
    blocks = [
        page.table(_results_table(runs)),
        page.figures(_figures(runs, robot)),
        page.heading("What was different"),
        page.table(_scenario_table(runs)),
        page.heading("Byte for byte"),
        page.table(_differences_table(runs[0].name, differences)),
        page.heading("To repeat it"),
        page.command(command),
        *(page.command(str(told)) for run in runs if (told := find(run.result, "scenario.command")) is not None),
    ]
    file = folder / page.PAGE_NAME
    write_atomically(file, page.compose(f"{len(runs)} runs side by side", "omnibot compare", blocks).encode())
    return file


# Tables -------------------------------------------------------------------------------------------------------------


def _results_table(runs: Sequence[Run]) -> Table:
    """One line a figure, one column a run."""
    columns = [figure_texts(run.result) for run in runs]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [[name, *(column.get(name, "–") for column in columns)] for name in names]
    return Table("Results", ["", *(run.name for run in runs)], rows)


def _scenario_table(runs: Sequence[Run]) -> Table:
    """Return the inputs that are not the same in all runs."""
    columns = []
    for run in runs:
        scenario = {key: value for key, value in (run.result.get("scenario") or {}).items() if key != "command"}
        versions = {"versions": run.result.get("versions") or {}}
        columns.append({name: page.value_text(value) for name, value in page.flat(scenario | versions)})
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [[name, *(column.get(name, "–") for column in columns)] for name in names]
    rows = [row for row in rows if len(set(row[1:])) > 1] or [["nothing that is known", *("" for _ in runs)]]
    return Table("Inputs and versions that are not the same", ["", *(run.name for run in runs)], rows)


def _differences_table(first: str, differences: Mapping[str, Sequence[str]]) -> Table:
    rows = [[name, "; ".join(lines) or "identical in every array"] for name, lines in differences.items()]
    return Table(f"Traces against that of {first}", ["", "differs in"], rows)


# Figures ------------------------------------------------------------------------------------------------------------


def style_of(place: int) -> Style:
    """Return the style of the run at a place; after the last one the dashes change."""
    style, lap = STYLES[place % len(STYLES)], place // len(STYLES)
    return style if lap == 0 else style._replace(dash=STYLES[(place + lap) % len(STYLES)].dash)


def _figures(runs: Sequence[Run], robot: Robot) -> Iterator[Figure]:
    yield Figure("path", "The tracked points, seen from above, and the reference of the first run.", _paths(runs), True)
    yield Figure(
        "error", "Distance of the tracked point from its reference, and heading minus its.", _errors(runs), True
    )
    caption = "The largest magnitude of the three wheels. Shaded: where traction is linear."
    yield Figure("wheels", caption, list(_wheels(runs, robot)), True)


def _paths(runs: Sequence[Run]) -> list[Panel]:
    """Draw all tracked points, and those around the first corner of the first run."""
    first = runs[0].trace
    (reference,) = shown(sane_rows(first), first.reference_point)
    panels = [_path_panel("Path from above (m)", runs, (Axis("x1 (m)"), Axis("x2 (m)")))]
    view = corner_view(first, reference)
    if view is not None:
        corner, half_m = view
        scale, unit = length_unit(half_m)
        ends = (-half_m * scale, half_m * scale)
        axes = Axis(f"x1 ({unit})", ends), Axis(f"x2 ({unit})", ends)
        panels.append(_path_panel(enlarged_title(corner, unit), runs, axes, corner, scale, 3.0 * half_m))
    return panels


def _path_panel(
    title: str, runs: Sequence[Run], axes: tuple[Axis, Axis], origin: Array | None = None, scale: float = 1.0,
    reach_m: float = np.inf,
) -> Panel:  # fmt: skip
    """Draw the first reference and all tracked points within reach of an origin, shape (2,) in m, in 1/scale m."""
    centre = np.zeros(2) if origin is None else origin

    def place(points: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        near = kept & (np.linalg.norm(points - centre, axis=1) < reach_m)
        (seen,) = shown(near, (points - centre) * scale)
        return seen[:, 0], seen[:, 1]

    first = runs[0].trace
    drawn = [line(*place(first.reference_point, sane_rows(first)), name="reference", style=REFERENCE)]
    for number, run in enumerate(runs):
        x, y = place(run.trace.point, sane_rows(run.trace))
        drawn.append(line(x, y, run.name, style_of(number)))
    return Panel(title, drawn, *axes, equal=True, height_px=HEIGHT_px)


def _errors(runs: Sequence[Run]) -> list[Panel]:
    """Draw both errors, those of position on a logarithmic axis where they are far apart."""
    errors, turns = [tracking_error(run.trace) for run in runs], [heading_error(run.trace) for run in runs]
    most = [largest(error, LOST_m) for error in errors]
    scale, unit = length_unit(max(most))
    angle_scale, angle = angle_unit(max(largest(turn, np.pi) for turn in turns))
    log = max(most) > FAR_APART * min(most) > 0.0
    low = 1e-3 * min(most) * scale
    axis = Axis(log=log, unit=unit, view=(low, 2.0 * max(most) * scale) if log else None, zero=True)
    return [
        _over_time(f"Tracking error ({unit})", runs, [scale * error for error in errors], axis),
        _over_time(f"Heading error ({angle})", runs, [angle_scale * turn for turn in turns], Axis(unit=angle)),
    ]


def _wheels(runs: Sequence[Run], robot: Robot) -> Iterator[Panel]:
    """Draw what the hardest working wheel of each run does, beside the limits."""
    force, torque = robot.friction_limit_N, robot.torque_limit_Nm
    for title, column, unit, shape in (
        ("Largest slip ratio (1)", "slip_ratio", "", band(0.0, LINEAR_SLIP)),
        ("Largest force of the floor on a wheel (N)", "wheel_force", "N", level(force, f"friction limit {force:g} N")),
        ("Largest torque of a motor (N·m)", "torque", "N·m", level(torque, f"limit {torque:g} N·m")),
    ):
        values = [np.abs(np.asarray(run.trace.column(column), dtype=float)).max(axis=1, initial=0.0) for run in runs]
        yield _over_time(title, runs, values, Axis(unit=unit, zero=True), [shape])


def _over_time(
    title: str, runs: Sequence[Run], values: Sequence[Array], axis: Axis, shapes: Sequence[Shape] = ()
) -> Panel:
    """Draw one line of shape (n,) a run."""
    drawn = [
        curve(run.trace.time_s, y, run.name, style_of(place))
        for place, (run, y) in enumerate(zip(runs, values, strict=True))
    ]
    return Panel(title, drawn, TIME, axis, shapes, group="time")
