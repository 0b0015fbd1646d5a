"""The record of a run: one row a control tick, kept as ``trace.npz``.

SI units; plant truth at the instant of SYNC(k) unless said otherwise. {G} is the ground frame, {L} the body frame.
In lockstep runs ``step_time_us`` is 0: time is no result there, and the same run gives the same bytes.

================= ====== ============ ===== ===============================================================
column            shape  unit         frame meaning
================= ====== ============ ===== ===============================================================
tick              (n,)   1            -     control tick k, int64
time_s            (n,)   s            -     simulated time of tick k
pose              (n, 3) m, m, rad    {G}   position x1, x2 of the body frame, heading
body_twist        (n, 3) m/s, rad/s   {L}   velocity of the body: nu_x, nu_y, omega
wheel_speed       (n, 3) rad/s        wheel wheel rates
slip_ratio        (n, 3) 1            wheel sigma / (V + delta)
wheel_force       (n, 3) N            wheel longitudinal force of the floor on each wheel
torque            (n, 3) N*m          wheel motor torque, applied from tick k to k + 1
point             (n, 2) m            {G}   tracked point p
reference_point   (n, 2) m            {G}   where p should be
reference_heading (n,)   rad          {G}   what the heading should be
mu                (n, 3) m/s          wheel the firmware's fast variable
step_time_us      (n,)   us           -     wall time of the firmware's control step
================= ====== ============ ===== ===============================================================
"""

import contextlib
import io
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from host_sim.errors import OmnibotError
from host_sim.robot import Array

FILE_NAME = "trace.npz"

Vector = Array | Sequence[float]


class Column(NamedTuple):
    """A column of the trace; ``width`` 1 is stored with shape (n,), a wider one with shape (n, width).

    ``unit`` holds one unit for all entries of a row, or one for each.
    """

    name: str
    width: int
    unit: str


COLUMNS = (
    Column("tick", 1, "1"),
    Column("time_s", 1, "s"),
    Column("pose", 3, "m, m, rad"),
    Column("body_twist", 3, "m/s, m/s, rad/s"),
    Column("wheel_speed", 3, "rad/s"),
    Column("slip_ratio", 3, "1"),
    Column("wheel_force", 3, "N"),
    Column("torque", 3, "N*m"),
    Column("point", 2, "m"),
    Column("reference_point", 2, "m"),
    Column("reference_heading", 1, "rad"),
    Column("mu", 3, "m/s"),
    Column("step_time_us", 1, "us"),
)
ROW_WIDTH = sum(column.width for column in COLUMNS)


def _places() -> tuple[int | slice, ...]:
    """Where each column lies in a row of ROW_WIDTH numbers."""
    places: list[int | slice] = []
    start = 0
    for column in COLUMNS:
        places.append(start if column.width == 1 else slice(start, start + column.width))
        start += column.width
    return tuple(places)


PLACES = _places()
FIRST = {
    column.name: place if isinstance(place, int) else place.start for column, place in zip(COLUMNS, PLACES, strict=True)
}


@dataclass(frozen=True, eq=False)
class Trace:
    """A finished record; shapes, units and frames are in the table above. Compare two with `compare`."""

    tick: NDArray[np.int64]
    time_s: Array
    pose: Array
    body_twist: Array
    wheel_speed: Array
    slip_ratio: Array
    wheel_force: Array
    torque: Array
    point: Array
    reference_point: Array
    reference_heading: Array
    mu: Array
    step_time_us: Array

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together.

        Raises
        ------
        ValueError
            A column has not the shape or type of the table.
        """
        rows = len(self.tick) if self.tick.ndim else 0
        for column in COLUMNS:
            array = self.column(column.name)
            shape = (rows,) if column.width == 1 else (rows, column.width)
            kind = np.int64 if column.name == "tick" else np.float64
            if array.shape != shape or array.dtype != kind:
                found = f"{array.dtype} of shape {array.shape}"
                raise ValueError(f"column {column.name} is {found} instead of {np.dtype(kind)} of shape {shape}")

    @classmethod
    def of_rows(cls, rows: Array) -> "Trace":
        """Take copies of the columns of rows, shape (n, ROW_WIDTH)."""
        arrays = {column.name: rows[:, place].copy() for column, place in zip(COLUMNS, PLACES, strict=True)}
        tick = arrays.pop("tick").astype(np.int64)
        return cls(tick=tick, **arrays)

    def __len__(self) -> int:
        return len(self.tick)

    def column(self, name: str) -> NDArray[np.generic]:
        """Return the array of that name, shape (n,) or (n, width)."""
        array: NDArray[np.generic] = getattr(self, name)
        return array

    def save(self, folder: Path) -> Path:
        """Write ``trace.npz`` into a folder, made if need be: whole or not at all. The same trace gives the same bytes.

        Returns
        -------
        Path
            The file written.
        """
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **{column.name: self.column(column.name) for column in COLUMNS})
        path = folder / FILE_NAME
        write_atomically(path, buffer.getvalue())
        return path

    @classmethod
    def load(cls, path: Path) -> "Trace":
        """Read a trace from its file, or from the folder of its run."""
        if path.is_dir():
            path = path / FILE_NAME
        arrays = _read_arrays(path)
        missing = [column.name for column in COLUMNS if column.name not in arrays]
        if missing:
            raise OmnibotError(f"{path} has no column {', '.join(missing)}; record the run again with this version")
        try:
            return cls(**{column.name: arrays[column.name] for column in COLUMNS})
        except ValueError as error:
            raise OmnibotError(f"{path}: {error}; record the run again with this version") from error


class TraceRecorder:
    """Collects one row a control tick in a single array that doubles when it is full.

    Parameters
    ----------
    capacity
        Rows to make room for at once: the ticks of the run, where they are known.
    """

    def __init__(self, capacity: int = 4096) -> None:
        self._rows: Array = np.empty((max(capacity, 1), ROW_WIDTH))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(
        self,
        *,
        tick: int,
        time_s: float,
        pose: Vector,
        body_twist: Vector,
        wheel_speed: Vector,
        slip_ratio: Vector,
        wheel_force: Vector,
        torque: Vector,
        point: Vector,
        reference_point: Vector,
        reference_heading: float,
        mu: Vector,
        step_time_us: float = 0.0,
    ) -> None:
        """Add a copy of the values of one tick, in a few microseconds; units and frames as in the table above."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = [
            *(tick, time_s, *pose, *body_twist, *wheel_speed, *slip_ratio, *wheel_force, *torque),
            *(*point, *reference_point, reference_heading, *mu, step_time_us),
        ]
        self._count += 1

    def to_trace(self) -> Trace:
        """Return a copy of what was recorded so far."""
        return Trace.of_rows(self._rows[: self._count])


def compare(a: Trace, b: Trace) -> list[str]:
    """Say where two traces differ, a line for each array that does; empty if all bytes are equal.

    Where the lengths differ, that is the first line, and the rows that both have are compared.
    """
    lines = [f"length: {len(a)} rows against {len(b)}"] if len(a) != len(b) else []
    rows = min(len(a), len(b))
    for column in COLUMNS:
        line = _difference(column, a.column(column.name)[:rows], b.column(column.name)[:rows])
        if line:
            lines.append(line)
    return lines


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, making its folder if need be: temporary file, fsync, rename."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        cure = "free some space or choose another folder with --out"
        raise OmnibotError(f"cannot write {path.name} into {path.parent}: {error.strerror or error}; {cure}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _read_arrays(path: Path) -> dict[str, Any]:
    """Read all arrays of an npz file, its checksums verified before anything is parsed."""
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise OmnibotError(f"there is no trace {path}; 'omnibot run --out {path.parent}' makes one") from error
    except OSError as error:
        raise OmnibotError(f"cannot read the trace {path}: {error.strerror or error}") from error
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if archive.testzip() is not None:
                raise ValueError("a checksum is wrong")  # noqa: TRY301
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return dict(arrays.items())
    except Exception as error:  # zipfile and numpy raise a dozen types for damaged bytes
        raise OmnibotError(f"the trace {path} is damaged; record the run again") from error


def _difference(column: Column, a: NDArray[np.generic], b: NDArray[np.generic]) -> str:
    """Say in one line where two arrays of one column differ; empty if their bytes are equal."""
    if a.tobytes() == b.tobytes():
        return ""
    bits_a, bits_b = (np.ascontiguousarray(array).view(np.int64).reshape(len(a), -1) for array in (a, b))
    differs = bits_a != bits_b
    rows = np.flatnonzero(differs.any(axis=1))
    first = (rows[0], np.flatnonzero(differs[rows[0]])[0])
    values_a, values_b = (np.asarray(array, dtype=np.float64).reshape(len(a), -1) for array in (a, b))
    where = f"row {first[0]}" if column.width == 1 else f"row {first[0]}, entry {first[1]}"
    return (
        f"{column.name}: {len(rows)} of {len(a)} rows differ, first in {where}: "
        f"{values_a[first]:.17g} against {values_b[first]:.17g}; largest difference "
        + _largest_difference(column, values_a, values_b, differs)
    )


def _largest_difference(column: Column, a: Array, b: Array, differs: NDArray[np.bool_]) -> str:
    """Return the largest difference, shape (n, width) each; infinite where only one of the two is a number."""
    with np.errstate(invalid="ignore", over="ignore"):
        gaps = np.where(differs, np.abs(a - b), 0.0)
    gaps[np.isnan(gaps)] = np.inf
    entry = int(gaps.max(axis=0).argmax())
    units = column.unit.split(", ")
    unit = units[min(entry, len(units) - 1)]
    return f"{gaps.max():.3g}" if unit == "1" else f"{gaps.max():.3g} {unit}"
