"""What one item of the paper gives: words, tables, pictures, and numbers for machines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from host_sim.report.figure import Figure
from host_sim.report.page import Table

__all__ = ["Section", "Table", "figure_text", "length_text"]


@dataclass(frozen=True)
class Section:
    """An item of the paper beside ours.

    Attributes
    ----------
    title
        Heading of the section.
    paper, ours
        What either shows, in a line of the page's first table.
    remarks
        Paragraphs: what is shown, what could not be reproduced and why.
    tables
        The numbers.
    figures
        Drawn in this order.
    numbers
        Its entries of ``paper.json``.
    """

    title: str
    paper: str
    ours: str
    remarks: Sequence[str]
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)


def figure_text(value: float) -> str:
    """Write a number with three digits, in powers of ten where it is small or large: 0.0342, 5·10⁻⁵."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        return f"{float(f'{value:.3g}'):g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{float(mantissa):g}·10{raised}"


def length_text(value_m: float) -> str:
    """Write a length in a readable unit."""
    for limit, scale, unit in ((1e-4, 1e6, "µm"), (0.1, 1e3, "mm"), (0.5, 1e2, "cm")):
        if value_m < limit:
            return f"{scale * value_m:.3g} {unit}"
    return f"{value_m:.3g} m"
