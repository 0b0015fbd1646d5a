"""The result as files: cost.json, and one page that needs nothing else."""

import base64
import html
import io
import json
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from host_sim.report import ACTUAL, CSS, DOTS_PER_INCH, LIMIT, STYLE
from host_sim.trace import write_atomically
from step_cost.tables import Table, tables

TITLE = "What a control step costs on the target"
MORE_CSS = (
    "th, td { width: auto; padding-right: 0.8rem; } caption { padding-top: 0.8rem; } figure { max-width: 44rem; }"
)


def _bars(result: dict[str, Any], limits: dict[str, int]) -> Figure:
    """Draw the worst cycles of each step and of the tick, with their limits."""
    steps = result["steps"]
    with rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.2))
        axes = figure.subplots()
        for place, (name, measured) in enumerate(steps.items()):
            reach = [
                [measured["cycles_max"] - measured["cycles_max_low"]],
                [measured["cycles_max_high"] - measured["cycles_max"]],
            ]
            axes.barh(place, measured["cycles_max"], color=ACTUAL, xerr=reach, ecolor=LIMIT)
            if name in limits:
                axes.plot([limits[name]] * 2, [place - 0.45, place + 0.45], color="black", linewidth=2.0)
        axes.set_yticks(range(len(steps)), list(steps))
        axes.invert_yaxis()
        axes.set_title("Worst case: estimated cycles, their range; black: limit")
        return figure


def _picture(figure: Figure) -> str:
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=DOTS_PER_INCH)
    data = base64.b64encode(memory.getvalue()).decode("ascii")
    return f'<figure><img alt="Worst-case cycles" src="data:image/png;base64,{data}"></figure>'


def _table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(text)}</th>" for text in table.head)
    rows = "\n".join("<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in row) + "</tr>" for row in table.rows)
    caption = f"<caption>{html.escape(table.title)}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def write(folder: Path, result: dict[str, Any], limits: dict[str, int]) -> Path:
    """Write cost.json and report.html into a folder; returns the page."""
    body = "\n".join(_table(table) for table in tables(result))
    remarks = "".join(f"<p>{html.escape(result[what])}.</p>" for what in ("counted", "estimated"))
    page = f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{TITLE}</title><style>{CSS}{MORE_CSS}</style></head>
<body>
<h1>{TITLE}</h1>
{remarks}<p>{html.escape(result["compiler"])}, {result["core_MHz"]:g} MHz</p>
{_picture(_bars(result, limits))}
{body}
</body>
</html>
"""
    write_atomically(folder / "cost.json", (json.dumps(result, indent=2) + "\n").encode())
    write_atomically(folder / "report.html", page.encode())
    return folder / "report.html"
