"""The page: every item of the paper beside ours, self-contained."""

import base64
import html
from collections.abc import Mapping

from host_sim.paper.section import Section, Table
from host_sim.report import CSS

PAGE_NAME = "paper.html"
TITLE = "The paper's figures and tables beside ours"
CITATION = (
    "C. A. Peña Fernández, J. J. F. Cerqueira, A. M. N. Lima: Trajectory tracking control of an omnidirectional "
    "wheeled mobile robot with slip and deformation: a singular perturbation approach. Anais do XX Congresso "
    "Brasileiro de Automática, 2014, p. 32 ff."
)
MORE_CSS = """
p { max-width: 52rem; }
.cells th, .cells td { width: auto; padding-right: 0.8rem; }
.cells thead th { vertical-align: bottom; border-bottom: 1px solid #999; color: #222; }
.cells caption { padding-top: 0.8rem; }
.scroll { overflow-x: auto; }
figure { max-width: 60rem; margin-top: 1rem; }
nav a { display: inline-block; margin-right: 1rem; }
.cells th[scope=row] { white-space: nowrap; }
.summary th[scope=row] { white-space: normal; min-width: 10rem; }
"""
HOW = (
    "Every run is the firmware itself, in-process behind a CAN bus, at 1 kHz in lockstep with the simulated robot: "
    "encoder speeds and exact pose in, motor torques out, all of it quantised as on the wire. The robot, the gains "
    "and ε are the paper's; what could not be reproduced is said where it belongs, with the reason where it is known."
)


def compose(sections: Mapping[str, Section], pictures: Mapping[str, bytes], command: str) -> str:
    """Compose the page of the sections and their rendered figures, both by name."""
    rows = [[section.title, section.paper, section.ours] for section in sections.values()]
    summary = f'<div class="summary">{_table(Table("In short", ["", "paper", "ours"], rows))}</div>'
    body = "\n".join(_section(name, section, pictures) for name, section in sections.items())
    links = "\n".join(f'<a href="#{name}">{html.escape(section.title)}</a>' for name, section in sections.items())
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{TITLE}</title>
<style>{CSS}{MORE_CSS}</style>
</head>
<body>
<h1>{TITLE}</h1>
<p>{html.escape(CITATION)}</p>
<p>{html.escape(HOW)}</p>
<p>To repeat it:</p>
<pre>{html.escape(command)}</pre>
<nav>{links}</nav>
{summary}
{body}
</body>
</html>
"""


def _section(name: str, section: Section, pictures: Mapping[str, bytes]) -> str:
    """Put an item on the page: figures, tables, remarks."""
    figures = "\n".join(_figure(pictures[picture], caption) for picture, (_, caption) in section.figures.items())
    tables = "\n".join(_table(table) for table in section.tables)
    remarks = "\n".join(f"<p>{html.escape(remark)}</p>" for remark in section.remarks)
    return f'<h2 id="{name}">{html.escape(section.title)}</h2>\n{figures}\n{tables}\n{remarks}'


def _figure(picture: bytes, caption: str) -> str:
    """Embed a rendered figure."""
    text = html.escape(caption)
    data = base64.b64encode(picture).decode("ascii")
    return f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'


def _table(table: Table) -> str:
    """Write a table; the first cell of a row is its head."""
    head = "".join(f'<th scope="col">{html.escape(text)}</th>' for text in table.head)
    rows = "\n".join(
        f'<tr><th scope="row">{html.escape(row[0])}</th>'
        + "".join(f"<td>{html.escape(text)}</td>" for text in row[1:])
        + "</tr>"
        for row in table.rows
    )
    caption = html.escape(table.caption)
    return (
        f'<div class="scroll"><table class="cells"><caption>{caption}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>"
    )
