"""Signals over time, from a bus log and from the trace of a run, and as tables: ``.csv`` and ``.npz``.

A topic is a message of the wire, such as ``TORQUE``, or what the plant did, such as ``plant.slip_ratio``. A signal is
named by both: ``TORQUE.wheel1_Nm``, ``plant.slip_ratio.wheel1``. Names, units and meaning of the wire's are those of
``protocol/omnibot.dbc``; 'not available' is NaN, damaged frames are left out and counted.
"""

import csv
import heapq
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import can
import numpy as np

from host_sim.canlog import Recording
from host_sim.codec import DBC_FILE, NODES, Codec, WireError
from host_sim.errors import OmnibotError
from host_sim.metrics import heading_error, tracking_error
from host_sim.robot import Array
from host_sim.trace import COLUMNS, Trace

WHEELS = ("wheel1", "wheel2", "wheel3")

# What the trace's columns hold, by field; those that are not here are of no use beside the wire, or are on it.
PLANT_FIELDS = {
    "pose": ("x1_m", "x2_m", "heading_rad"),
    "body_twist": ("nu_x_m_per_s", "nu_y_m_per_s", "omega_rad_per_s"),
    "wheel_speed": tuple(f"{wheel}_rad_per_s" for wheel in WHEELS),
    "slip_ratio": WHEELS,
    "wheel_force": tuple(f"{wheel}_N" for wheel in WHEELS),
    "torque": tuple(f"{wheel}_Nm" for wheel in WHEELS),
    "point": ("x1_m", "x2_m"),
    "reference_point": ("x1_m", "x2_m"),
    "reference_heading": ("heading_rad",),
}
ERROR_TOPIC, ERROR_FIELDS = "plant.error", ("tracking_m", "heading_rad")
PURPOSE_OF_PLANT = "The plant's, at the instant of SYNC; see host_sim/trace.py."


class Signal(NamedTuple):
    """A field of a topic; ``labels`` are the names of its values, if they have some."""

    name: str
    unit: str
    labels: dict[int, str]


class Topic(NamedTuple):
    """What is told of together."""

    name: str
    purpose: str
    signals: tuple[Signal, ...]


class Sample(NamedTuple):
    """The values of a topic at an instant, in the order of its signals."""

    time_s: float
    topic: str
    values: tuple[float, ...]


def is_of_wire(message: can.Message) -> bool:
    """Tell classic data frames with 11-bit identifiers, our wire's, from what else may be in a log."""
    special = message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd
    return not special


def messages_of_nodes(recording: Recording, dbc: Path = DBC_FILE) -> dict[int, set[str]]:
    """Return which messages of the wire a log holds, by node."""
    wire = Codec(dbc)
    found: dict[int, set[str]] = defaultdict(set)
    for message in filter(is_of_wire, recording):
        codec = wire.of_id(message.arbitration_id & ~(NODES - 1))
        if codec is not None:
            found[message.arbitration_id & (NODES - 1)].add(codec.name)
    return found


def choose_node(recording: Recording, found: dict[int, set[str]], node: int | None) -> int:
    """Return the node to look at: the one asked for, or the only one there is."""
    if not found:
        raise OmnibotError(f"{recording.path} holds no frame that protocol/omnibot.dbc knows: is it of another bus?")
    if node in found:
        return node
    if node is None and len(found) == 1:
        return next(iter(found))
    nodes = ", ".join(map(str, sorted(found)))
    raise OmnibotError(f"{recording.path} holds frames of node {nodes}: choose one with --node")


class WireSignals:
    """The signals of one node in a bus log.

    Parameters
    ----------
    recording
        The log.
    codec
        Wire and node.
    names
        The messages that occur.
    """

    def __init__(self, recording: Recording, codec: Codec, names: set[str]) -> None:
        self._recording = recording
        self._codec = codec
        self.damaged = 0  # frames that were left out, as known after one pass
        self.topics = tuple(
            Topic(
                message.name,
                message.purpose,
                tuple(Signal(field.name, field.unit, message.labels(field.name)) for field in message.fields),
            )
            for message in codec
            if message.name in names
        )

    def __iter__(self) -> Iterator[Sample]:
        """Yield the values of every whole frame in the order of the log."""
        self.damaged = 0
        for message in filter(is_of_wire, self._recording):
            codec = self._codec.of_id(message.arbitration_id)
            if codec is None:
                continue
            try:
                values = codec.unpack(bytes(message.data))
            except WireError:
                self.damaged += 1
            else:
                yield Sample(round(message.timestamp, 9), codec.name, tuple(map(_without_noise, values)))


def _without_noise(value: float) -> float:
    """Return a value without the noise of steps times step size: the wire has ten digits at most."""
    return float(f"{value:.10g}") if isinstance(value, float) else value


class PlantSignals:
    """The signals of the plant in the trace of a run."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        units = {column.name: column.unit.split(", ") for column in COLUMNS}
        self.topics = (
            *(
                Topic(f"plant.{name}", PURPOSE_OF_PLANT, _signals(fields, units[name]))
                for name, fields in PLANT_FIELDS.items()
            ),
            Topic(
                ERROR_TOPIC, "How far the tracked point and the heading are off.", _signals(ERROR_FIELDS, ["m", "rad"])
            ),
        )

    def __iter__(self) -> Iterator[Sample]:
        """Yield the values of every tick."""
        columns = [*(self._rows(f"plant.{name}", self.trace.column(name)) for name in PLANT_FIELDS), self._errors()]
        times = np.round(self.trace.time_s, 9).tolist()
        for row, time_s in enumerate(times):
            for name, values in columns:
                yield Sample(time_s, name, tuple(values[row]))

    def _rows(
        self, name: str, column: np.ndarray[tuple[int, ...], np.dtype[np.generic]]
    ) -> tuple[str, list[list[float]]]:
        return name, column.reshape(len(self.trace), -1).tolist()

    def _errors(self) -> tuple[str, list[list[float]]]:
        errors: Array = np.column_stack([tracking_error(self.trace), heading_error(self.trace)])
        return ERROR_TOPIC, errors.tolist()


def _signals(names: tuple[str, ...], units: list[str]) -> tuple[Signal, ...]:
    """Return signals without labels; one unit is of them all."""
    each = units * len(names) if len(units) == 1 else units
    return tuple(Signal(name, "" if unit == "1" else unit, {}) for name, unit in zip(names, each, strict=True))


class RunSignals:
    """The signals of a bus log, and of the plant where there is a trace, in the order of time."""

    def __init__(self, wire: WireSignals, plant: PlantSignals | None) -> None:
        self.wire, self.plant = wire, plant
        self.topics = (*wire.topics, *(plant.topics if plant is not None else ()))

    def __iter__(self) -> Iterator[Sample]:
        """Yield all samples; of one instant, those of the wire come first."""
        plant: Iterable[Sample] = self.plant if self.plant is not None else ()
        return heapq.merge(self.wire, plant, key=lambda sample: sample.time_s)


def open_signals(source: Path, node: int | None = None, dbc: Path = DBC_FILE) -> RunSignals:
    """Open a bus log, or the folder of a run: then what the plant did is among the signals."""
    recording = Recording(source)
    found = messages_of_nodes(recording, dbc)
    node = choose_node(recording, found, node)
    wire = WireSignals(recording, Codec(dbc, node), found[node])
    return RunSignals(wire, PlantSignals(Trace.load(source)) if source.is_dir() else None)


def write_csv(signals: RunSignals, path: Path) -> None:
    """Write a table: a row for each instant, and one more where a message comes twice in it; empty where none came."""
    columns = {"time_s": 0}
    for topic in signals.topics:
        for signal in topic.signals:
            columns[f"{topic.name}.{signal.name}"] = len(columns)
    first = {topic.name: columns[f"{topic.name}.{topic.signals[0].name}"] for topic in signals.topics}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for instant in _instants(signals):
            row: list[float | str] = [""] * len(columns)
            row[0] = instant[0].time_s
            for sample in instant:
                row[first[sample.topic] : first[sample.topic] + len(sample.values)] = sample.values
            writer.writerow(row)


def _instants(samples: Iterable[Sample]) -> Iterator[list[Sample]]:
    """Yield the samples of an instant together, no topic twice."""
    instant: dict[str, Sample] = {}
    time_s = 0.0
    for sample in samples:
        if instant and (sample.time_s != time_s or sample.topic in instant):
            yield list(instant.values())
            instant = {}
        instant[sample.topic] = sample
        time_s = sample.time_s
    if instant:
        yield list(instant.values())


def write_npz(signals: RunSignals, path: Path) -> None:
    """Write arrays, one for each signal, and for each topic its times: ``TORQUE.time_s``, ``TORQUE.wheel1_Nm``."""
    times: dict[str, list[float]] = defaultdict(list)
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    for sample in signals:
        times[sample.topic].append(sample.time_s)
        rows[sample.topic].append(sample.values)
    arrays: dict[str, Array] = {}
    for topic in signals.topics:
        table = np.array(rows[topic.name], dtype=float).reshape(-1, len(topic.signals))
        arrays[f"{topic.name}.time_s"] = np.array(times[topic.name])
        for signal, column in zip(topic.signals, table.T, strict=True):
            arrays[f"{topic.name}.{signal.name}"] = column
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
