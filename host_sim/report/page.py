"""One HTML page that needs nothing else: words, tables and figures; styled by ``page.css``, drawn by ``page.js``."""

import base64
import gzip
import html
import json
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

from host_sim.report.figure import Drawn, Figure, Panel

PAGE_NAME = "report.html"
FOOTER = (
    "Written by omnibot; figures drawn by plotly.js (MIT licence), which this page carries. Drag in a figure to "
    "enlarge, double-click to see all of it, click a name in a legend to hide it."
)
DASHES = {"solid": "", "dash": "7 4", "dot": "2 3", "dashdot": "7 3 2 3", "longdash": "11 4", "longdashdot": "11 3 2 3"}


class Table(NamedTuple):
    """A table of texts; the first entry of a row names it."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


class Tile(NamedTuple):
    """A number that matters: its name, its text, what to hold it against, and its place in ``result.json``."""

    name: str
    text: str
    of: str = ""
    key: str = ""


def compose(title: str, kind: str, blocks: Iterable[str]) -> str:
    """Compose the page of blocks of HTML; all other functions here make such blocks.

    Parameters
    ----------
    title
        Of the page.
    kind
        What sort of page it is, in a few words above the title.
    blocks
        Everything below the title. The drawing library is put into the page only if one of them is a figure.
    """
    body = "\n".join(blocks)
    drawing = _library() if '<div class="plot"' in body else ""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{html.escape(title)}</title>
<style>
{_own("page.css")}</style>
</head>
<body>
<header>
<p class="kind">{html.escape(kind)}</p>
<h1>{html.escape(title)}</h1>
</header>
<main>
{body}
</main>
<footer>{FOOTER}</footer>
{drawing}
</body>
</html>
"""


def _library() -> str:
    """Return the scripts; the library is compressed to a third, in a moment, and a browser opens it as fast."""
    source = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    packed = base64.b64encode(gzip.compress(source, 4, mtime=0)).decode("ascii")
    return (
        '<noscript><p class="note">The figures need a browser that runs scripts.</p></noscript>\n'
        f'<script type="text/plain" id="library">{packed}</script>\n<script>\n{_own("page.js")}</script>'
    )


def _own(name: str) -> str:
    """Return a file of this package."""
    return files("host_sim.report").joinpath(name).read_text(encoding="utf-8")


# Words --------------------------------------------------------------------------------------------------------------


def heading(text: str, name: str = "") -> str:
    """Begin a section; its name is what a link of `contents` leads to."""
    place = f' id="{html.escape(name)}"' if name else ""
    return f"<h2{place}>{html.escape(text)}</h2>"


def paragraph(text: str) -> str:
    """Say something."""
    return f"<p>{html.escape(text)}</p>"


def status(text: str, reason: str = "") -> str:
    """Show how it ended, and why."""
    why = f" {html.escape(reason)}" if reason else ""
    return f'<p><span class="status {html.escape(text)}">{html.escape(text)}</span>{why}</p>'


def command(text: str) -> str:
    """Show a command that can be copied."""
    return f'<pre>{html.escape(text)}</pre><button type="button" class="plain copy" hidden>Copy</button>'


def contents(sections: Mapping[str, str]) -> str:
    """Link to sections: their titles by their names."""
    links = "\n".join(f'<a href="#{html.escape(n)}">{html.escape(title)}</a>' for n, title in sections.items())
    return f'<nav aria-label="Contents">{links}</nav>'


def tiles(numbers: Iterable[Tile]) -> str:
    """Show the numbers that matter."""
    parts = [
        f"<div><dt>{html.escape(tile.name)}</dt>"
        f'<dd data-key="{html.escape(tile.key)}">{html.escape(tile.text)}</dd>'
        + (f'<dd class="of">{html.escape(tile.of)}</dd>' if tile.of else "")
        + "</div>"
        for tile in numbers
    ]
    return '<dl class="tiles">' + "\n".join(parts) + "</dl>"


# Tables -------------------------------------------------------------------------------------------------------------


def table(content: Table) -> str:
    """Write a table; the first cell of a row is its head."""
    head = "".join(f'<th scope="col">{html.escape(text)}</th>' for text in content.head)
    rows = "\n".join(
        f'<tr><th scope="row">{html.escape(row[0])}</th>'
        + "".join(f"<td>{html.escape(text)}</td>" for text in row[1:])
        + "</tr>"
        for row in content.rows
    )
    caption = f"<caption>{html.escape(content.caption)}</caption>" if content.caption else ""
    label = html.escape(content.caption or "table")
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{label}"><table>{caption}\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>"
    )


def tables(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """Write names and values in columns, a table for each section."""
    return '<div class="tables">' + "\n".join(_pairs(name, values) for name, values in sections.items()) + "</div>"


def _pairs(caption: str, values: Mapping[str, Any]) -> str:
    rows = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(value_text(value))}</td></tr>\n'
        for name, value in flat(values)
    )
    return f'<table class="listing"><caption>{html.escape(caption)}</caption>\n{rows}</table>'


def flat(values: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, object]]:
    """Walk through nested values, with dotted names."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def value_text(value: object) -> str:
    """Write a value for a reader: four digits; null is a figure that has no finite value."""
    if value is None:
        return "none"
    if isinstance(value, Mapping) and not value:
        return "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(value_text, value))
    return str(value)


# Figures ------------------------------------------------------------------------------------------------------------


def figures(drawn: Iterable[Figure]) -> str:
    """Put figures side by side where there is room."""
    return '<div class="figures">' + "\n".join(map(_figure, drawn)) + "</div>"


def _figure(figure: Figure) -> str:
    """Put a figure on the page: legend, panels, caption."""
    wide = ' class="wide"' if figure.wide else ""
    panels = "\n".join(_panel(panel, figure.caption) for panel in figure.panels)
    pairs = " pairs" if len(figure.panels) % 2 == 0 else ""  # never three and one
    entries = figure.legend()
    several = any(len({trace["name"] for trace in panel.traces}) > 1 for panel in figure.panels)
    legend = "".join(map(_legend_entry, entries)) if several else ""
    return (
        f'<figure id="{html.escape(figure.name)}"{wide}>\n<div class="legend">{legend}</div>\n'
        f'<div class="panels{pairs}">{panels}</div>\n<figcaption>{html.escape(figure.caption)}</figcaption></figure>'
    )


def _panel(panel: Panel, caption: str) -> str:
    """Put a panel on the page: its title, what it leaves out, the place to draw it and what to draw."""
    note = f'<p class="note">{html.escape(panel.note)}</p>' if panel.note else ""
    film = ""
    if "film" in panel.extra:
        film = (
            '<label class="film">time <input type="range" min="0" value="0" aria-label="time of the robot shown">'
            "<output></output><small>Moves the robot, as the cursor does in every figure over time.</small></label>"
        )
    label = html.escape(f"{panel.title}. {caption}")
    data = json.dumps(panel.as_dict(), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<div class="panel"><div><h3>{html.escape(panel.title)}</h3>{note}</div>'
        f'<div class="plot" role="img" aria-label="{label}" style="--height: {panel.height_px}px"></div>'
        f'<script type="application/json">{data}</script>{film}</div>'
    )


def _legend_entry(trace: Drawn) -> str:
    """Make a button that shows how a trace looks, and hides and shows it."""
    name = html.escape(trace["name"])
    film = " data-film" if trace.get("meta") == "film" else ""
    return f'<button type="button" aria-pressed="true" data-name="{name}"{film}>{_swatch(trace)}{name}</button>'


def _swatch(trace: Drawn) -> str:
    """Draw a sample of a trace."""
    line, marker = trace.get("line", {}), trace.get("marker", {})
    parts = []
    if line.get("width"):
        parts.append(
            f'<path d="M0 6h28" style="stroke: var({line["color"]})" stroke-width="{line["width"] + 0.5:g}" '
            f'stroke-dasharray="{DASHES[line["dash"]]}"/>'
        )
    if marker:
        parts.append(f'<circle cx="14" cy="6" r="4" style="fill: var({marker["color"]})"/>')
    return f'<svg width="28" height="12" aria-hidden="true">{"".join(parts)}</svg>'
