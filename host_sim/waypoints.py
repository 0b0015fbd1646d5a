"""Waypoints of a path in a file of the user's: FILE.csv or FILE.toml.

A CSV file has a header row that names columns with their units, in any order: x1_m and x2_m, of the tracked point, and
if wanted heading_rad (not wrapped: a whole turn is 6.28…) and time_s, at which the robot is to be there, from 0 on.
Empty lines and those that start with # are passed over.

    x1_m,x2_m,heading_rad
    0,0,0
    1,0.5,1.57

A TOML file has the same names in its [[waypoint]] tables, and may have limits, which the command line overrides:

    [limits]
    speed_m_per_s = 0.8
    jerk_m_per_s3 = 20

    [[waypoint]]
    x1_m = 0
    x2_m = 0
"""

import csv
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from host_sim.errors import OmnibotError
from host_sim.limits import LIMIT_NAMES, Limits
from host_sim.trajectory import Array

SUFFIXES = (".csv", ".toml")
FEWEST, MOST = 2, 1000
LARGEST_M, LARGEST_rad, LARGEST_s = 20.0, 1000.0, 3600.0

_NEEDED = ("x1_m", "x2_m")
_LARGEST = {"x1_m": LARGEST_M, "x2_m": LARGEST_M, "heading_rad": LARGEST_rad, "time_s": LARGEST_s}


@dataclass(frozen=True, eq=False)
class Waypoints:
    """What a file holds.

    Attributes
    ----------
    places
        x1 and x2 in m, heading in rad (0 where the file has none), shape (n, 3).
    time_s
        Shape (n,), from 0 on; None: as fast as the limits allow.
    limits
        What the file allows.
    """

    places: Array
    time_s: Array | None
    limits: Limits


def is_file(path: str) -> bool:
    """Tell whether a path is the name of a file of waypoints."""
    return Path(path).suffix.lower() in SUFFIXES


def read_waypoints(path: str) -> Waypoints:
    """Read a file, or say which line of it is wrong and what would be right."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OmnibotError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise OmnibotError(f"{path} is no text in UTF-8: {error.reason} at byte {error.start}") from error
    rows, limits = _csv_rows(path, text) if Path(path).suffix.lower() == ".csv" else _toml_rows(path, text)
    return _checked(path, rows, limits)


@dataclass(frozen=True)
class _Row:
    """One waypoint, and how an error names it."""

    place: str
    values: Mapping[str, float]


def _csv_rows(path: str, text: str) -> tuple[list[_Row], Limits]:
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if _says_something(line)]
    if not lines:
        raise OmnibotError(f"{path} is empty; it must have a header line and waypoints (x1_m,x2_m then 0,0 and so on)")
    names = [name.strip() for name in _cells(lines[0][1])]
    _check_names(f"{path}, line {lines[0][0]}", names, "column")
    rows = []
    for number, line in lines[1:]:
        place, cells = f"{path}, line {number}", _cells(line)
        if len(cells) != len(names):
            raise OmnibotError(f"{place} has {len(cells)} cells; it must have {len(names)}: {', '.join(names)}")
        values = {name: _number(place, name, cell.strip()) for name, cell in zip(names, cells, strict=True)}
        rows.append(_Row(place, values))
    return rows, Limits()


def _says_something(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]))


def _toml_rows(path: str, text: str) -> tuple[list[_Row], Limits]:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise OmnibotError(f"{path}: {error}") from error
    for name in data:
        if name not in {"limits", "waypoint"}:
            raise OmnibotError(f"{path}: {name} is not known; there are: [limits], [[waypoint]]")
    entries = data.get("waypoint", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise OmnibotError(f"{path}: waypoints must be tables [[waypoint]]")
    rows = []
    for number, entry in enumerate(entries, 1):
        place = f"{path}, waypoint {number}"
        _check_names(place, list(entry), "entry")
        rows.append(_Row(place, {name: _number(place, name, value) for name, value in entry.items()}))
    return rows, _toml_limits(path, data.get("limits", {}))


def _toml_limits(path: str, entries: object) -> Limits:
    place = f"{path}, [limits]"
    if not isinstance(entries, dict):
        raise OmnibotError(f"{path}: limits must be a table [limits]")
    for name in entries:
        if name not in LIMIT_NAMES:
            raise OmnibotError(f"{place}: {name} is not known; there are: {', '.join(LIMIT_NAMES)}")
    try:
        return Limits(**{name: _number(place, name, value) for name, value in entries.items()})
    except OmnibotError as error:
        raise OmnibotError(str(error) if str(error).startswith(path) else f"{place}: {error}") from None


def _check_names(place: str, names: Iterable[str], what: str) -> None:
    """Refuse names that are unknown, twice there or missing."""
    known = ", ".join(_LARGEST)
    names = list(names)
    for name in names:
        if name not in _LARGEST:
            raise OmnibotError(f"{place}: no {what} {name!r} is known; there are: {known}, separated by commas")
        if names.count(name) > 1:
            raise OmnibotError(f"{place}: {what} {name} is there twice")
    for name in _NEEDED:
        if name not in names:
            raise OmnibotError(f"{place}: {what} {name} is missing; there must be x1_m and x2_m")


def _number(place: str, name: str, value: object) -> float:
    """Return the number that a cell or entry holds."""
    try:
        number = math.nan if isinstance(value, bool) else float(str(value))
    except ValueError:
        number = math.nan
    largest = _LARGEST.get(name, math.inf)
    if not math.isfinite(number) or abs(number) > largest:
        within = f"a number from -{largest:g} to {largest:g}" if math.isfinite(largest) else "a number"
        raise OmnibotError(f"{place}: {name} = {value} must be {within}")
    return number


def _checked(path: str, rows: list[_Row], limits: Limits) -> Waypoints:
    if not FEWEST <= len(rows) <= MOST:
        raise OmnibotError(f"{path} has {len(rows)} waypoints; there must be {FEWEST} to {MOST}")
    timed = {"time_s" in row.values for row in rows}
    if len(timed) > 1:
        raise OmnibotError(f"{path}: all waypoints must have a time_s, or none")
    places = np.array([[row.values.get(name, 0.0) for name in ("x1_m", "x2_m", "heading_rad")] for row in rows])
    if timed == {True}:
        return Waypoints(places, _times(rows), limits)
    for row, step in zip(rows[1:], np.diff(places, axis=0), strict=True):
        if not np.any(np.abs(step) > 1e-6):
            raise OmnibotError(f"{row.place} is the waypoint before it again; leave one of the two out")
    return Waypoints(places, None, limits)


def _times(rows: list[_Row]) -> Array:
    time_s = np.array([row.values["time_s"] for row in rows])
    if time_s[0] != 0.0:
        raise OmnibotError(f"{rows[0].place}: time_s = {time_s[0]:g} must be 0 at the first waypoint")
    for row, before_s, now_s in zip(rows[1:], time_s, time_s[1:], strict=False):
        if now_s - before_s < 1e-3:
            raise OmnibotError(f"{row.place}: time_s = {now_s:g} must be later than {before_s:g}, by 0.001 s at least")
    return time_s
