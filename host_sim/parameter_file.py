"""Parameter values in a file: TOML, or JSON; what ``omnibot param list --out`` writes, and the results of a run."""

import json
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from host_sim.errors import OmnibotError
from host_sim.parameters import Held, plain
from host_sim.trace import write_atomically


def write_values(file: Path, held: Iterable[Held]) -> None:
    """Write the values in force, each with its unit and range; a name in .json makes it JSON."""
    values = {parameter.name: plain(parameter, value) for parameter, value in held}
    if file.suffix == ".json":
        text = json.dumps({"parameters": values}, indent=2) + "\n"
    else:
        notes = (f"{p.name} = {json.dumps(values[p.name])} # {p.range_text()}\n" for p, _ in held)
        text = "[parameters]\n" + "".join(notes)
    write_atomically(file, text.encode())


def read_values(file: Path) -> dict[str, str]:
    """Read names and values, as they would be typed."""
    try:
        text = file.read_text(encoding="utf-8")
        data = json.loads(text) if file.suffix == ".json" else tomllib.loads(text)
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise OmnibotError(f"cannot read parameters from {file}: {reason}") from error
    table = data.get("parameters", data) if isinstance(data, dict) else data
    rows = _rows(table)
    if not rows or not all(_is_value(name, value) for name, value in rows):
        raise OmnibotError(f"{file} has no parameters: it must have NAME = VALUE lines below [parameters]")
    return {name: str(value) for name, value in rows}


def _rows(table: Any) -> list[tuple[Any, Any]]:
    """Return names and values of a table, or of the list that ``param list --json`` prints."""
    if isinstance(table, dict):
        return list(table.items())
    if isinstance(table, list) and all(isinstance(row, dict) for row in table):
        return [(row.get("name"), row.get("value")) for row in table]
    return []


def _is_value(name: Any, value: Any) -> bool:
    return isinstance(name, str) and isinstance(value, int | float | str) and not isinstance(value, bool)
