"""How the verbs lay out what they print."""

from collections.abc import Sequence


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Lay rows out, the first one the heading, in columns as wide as they must be."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
