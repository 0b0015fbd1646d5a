"""The result as files: cost.json, and one page that needs nothing else."""

import json
from pathlib import Path
from typing import Any

from host_sim.report import PAGE_NAME, page
from host_sim.report.figure import ACTUAL, Axis, Figure, Panel, Style, bars, points
from host_sim.trace import write_atomically
from step_cost.tables import tables

TITLE = "What a control step costs on the target"


def _figure(result: dict[str, Any], limits: dict[str, int]) -> Figure:
    """Draw the worst cycles of each step and of the tick, with their limits."""
    steps = result["steps"]
    worst = [figures["cycles_max"] for figures in steps.values()]
    places = [float(place) for place in range(len(steps))]
    above = [figures["cycles_max_high"] - figures["cycles_max"] for figures in steps.values()]
    below = [figures["cycles_max"] - figures["cycles_max_low"] for figures in steps.values()]
    reach = {
        "type": "data",
        "symmetric": False,
        "array": above,
        "arrayminus": below,
        "color": "--ink",
        "thickness": 1.2,
    }
    drawn = [bars(worst, places, "worst case, its range", ACTUAL.colour, orientation="h", error_x=reach)]
    limited = [(limits[name], place) for name, place in zip(steps, places, strict=True) if name in limits]
    if limited:
        values, where = zip(*limited, strict=True)
        drawn.append(points(values, where, "limit", Style("--vermilion", width_px=0.0), "line-ns-open"))
        drawn[-1]["marker"] |= {"size": 22, "line": {"width": 3}}
    names = dict(zip(places, steps, strict=True))
    panel = Panel(
        "Cycles, estimated",
        [trace | {"hovertemplate": f"{trace['name']}: %{{x}}<extra></extra>"} for trace in drawn],
        Axis("cycles", zero=True),
        Axis(view=(len(steps) - 0.5, -0.5), ticks=names),
        height_px=60 + 38 * len(steps),
    )
    caption = "The costliest control step of each order, and the costliest whole tick."
    return Figure("cycles", caption, [panel], wide=True)


def _tiles(result: dict[str, Any]) -> list[page.Tile]:
    """Return the figures that matter."""
    tick, period_us, flash_bytes = result["steps"]["tick"], result["period_us"], result["flash_bytes"]
    steps = [figures for name, figures in result["steps"].items() if name != "tick"]
    worst = max(steps, key=lambda figures: int(figures["cycles_max"]))
    return [
        page.Tile("Whole tick, at most", f"{tick['microseconds_max']:.4g} µs", f"of {period_us:g} µs", "tick"),
        page.Tile(
            "Control step, at most", f"{worst['microseconds_max']:.4g} µs", f"{worst['cycles_max']} cycles", "step"
        ),
        page.Tile("Stack", f"{result['stack_bytes']} B", "deepest chain of calls", "stack_bytes"),
        page.Tile("Flash", f"{flash_bytes} B", f"RAM {result['ram_bytes']} B beside the store", "flash_bytes"),
    ]


def write(folder: Path, result: dict[str, Any], limits: dict[str, int], command: str) -> Path:
    """Write cost.json and report.html into a folder; returns the page. The command is what repeats it."""
    blocks = [page.paragraph(f"{result[what]}.") for what in ("counted", "estimated")]
    blocks += [
        page.paragraph(f"{result['compiler']}, {result['core_MHz']:g} MHz."),
        page.tiles(_tiles(result)),
        page.figures([_figure(result, limits)]),
        page.heading("To repeat it"),
        page.command(command),
        page.heading("All figures"),
        *(page.table(page.Table(*table)) for table in tables(result)),
    ]
    write_atomically(folder / "cost.json", (json.dumps(result, indent=2) + "\n").encode())
    write_atomically(folder / PAGE_NAME, page.compose(TITLE, "omnibot cost", blocks).encode())
    return folder / PAGE_NAME
