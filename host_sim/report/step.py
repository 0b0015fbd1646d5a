"""The page of a step: the way back of each output beside what the gains promise."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from host_sim.report import page
from host_sim.report.figure import (
    ACTUAL,
    REFERENCE,
    STYLES,
    Axis,
    Figure,
    Panel,
    angle_unit,
    curve,
    largest,
    length_unit,
)
from host_sim.report.run import percent_text
from host_sim.run import STEP_FILE
from host_sim.step import Decay, StepRun, table_rows
from host_sim.trace import write_atomically

TIME = Axis("time (s)")
CAPTION = (
    "The error over time, as measured on the plant and as K1 and K2 promise it (33), and how far the two are apart. "
    "That the torque is held for a period of 1 ms makes the fast pole of the paper's gains one per cent faster."
)


def write_step(folder: Path, run: StepRun, command: str) -> Path:
    """Write ``trace.npz``, ``report.html`` and, last, ``step.json`` into a folder; return the page."""
    run.driven.trace.save(folder)
    file = folder / page.PAGE_NAME
    write_atomically(file, step_page(run, command).encode())
    write_atomically(folder / STEP_FILE, (json.dumps(run.result, indent=2, allow_nan=False) + "\n").encode())
    return file


def step_page(run: StepRun, command: str) -> str:
    """Compose the page; the command is the one that makes it again."""
    result = run.result
    head, *rows = table_rows(result["outputs"])
    blocks = [
        page.status(result["status"], result["reason"]),
        page.tiles(_tiles(result)),
        page.figures([Figure("step", CAPTION, [panel for decay in run.decays for panel in _panels(decay)], wide=True)]),
        page.table(page.Table("Promised by the gains, and measured", head, rows)),
        page.heading("To repeat it"),
        page.command(command),
        page.heading("Results"),
        page.tables({name: result[name] for name in ("step", "bounds", "scenario", "parameters")}),
    ]
    return page.compose(f"Step response, order {result['parameters']['order']}", "omnibot step", blocks)


def _tiles(result: Mapping[str, Any]) -> list[page.Tile]:
    tiles = [
        page.Tile(
            f"RMS difference of {output['name']}",
            percent_text(output["rms_difference"] / abs(output["offset"])),
            "of the offset",
            f"outputs.{place}.rms_difference",
        )
        for place, output in enumerate(result["outputs"])
    ]
    share = result["bounds"]["fraction_at_bound"]
    return [*tiles, page.Tile("At a bound", percent_text(share), "of the ticks", "bounds.fraction_at_bound")]


def _panels(decay: Decay) -> list[Panel]:
    """Draw one output: both curves, and their difference."""
    unit_of = angle_unit if decay.unit == "rad" else length_unit
    scale, unit = unit_of(largest(decay.error))
    traces = [
        curve(decay.time_s, scale * decay.promise, "promised", REFERENCE),
        curve(decay.time_s, scale * decay.error, "measured", ACTUAL),
    ]
    gap = decay.error - decay.promise
    fine, fine_unit = unit_of(largest(gap))
    difference = [curve(decay.time_s, fine * gap, "measured less promised", STYLES[1])]
    return [
        Panel(f"Error of {decay.name} ({unit})", traces, TIME, Axis(unit=unit), group="time"),
        Panel(f"Difference in {decay.name} ({fine_unit})", difference, TIME, Axis(unit=fine_unit), group="time"),
    ]
