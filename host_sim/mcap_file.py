"""Signals as an MCAP file with JSON messages: Foxglove and PlotJuggler open it as it is.

A topic of `signals` is a channel: ``TORQUE`` is ``/TORQUE``, ``plant.slip_ratio`` is ``/plant/slip_ratio``. Numbers are
numbers; beside one with named values stands its name as text, ``mode`` and ``mode_name``. What is not available is left
out, for JSON knows no NaN. Foxglove's 3D panel gets its own schemas (docs.foxglove.dev): ``/robot/transform`` from the
ground to the robot, ``/robot/pose`` as the firmware was told it, ``/robot/reference_path`` where it should go.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import Writer

from host_sim.signals import PlantSignals, RunSignals, Sample, Topic

WORLD, ROBOT = "world", "robot"
PATH_POSES = 1000  # of the reference; more would be drawn on each other

_NUMBER: dict[str, Any] = {"type": "number"}
_TEXT: dict[str, Any] = {"type": "string"}
_TIME: dict[str, Any] = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)

# Foxglove knows them by these names.
FOXGLOVE_SCHEMAS = {
    "foxglove.FrameTransform": _object(
        timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_VECTOR, rotation=_QUATERNION
    ),
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.PosesInFrame": _object(timestamp=_TIME, frame_id=_TEXT, poses={"type": "array", "items": _POSE}),
}
TRANSFORM, POSE, REFERENCE_PATH = "/robot/transform", "/robot/pose", "/robot/reference_path"
FOXGLOVE_CHANNELS = {
    TRANSFORM: "foxglove.FrameTransform",
    POSE: "foxglove.PoseInFrame",
    REFERENCE_PATH: "foxglove.PosesInFrame",
}


class Entry(NamedTuple):
    """A message for a channel."""

    channel: str
    time_s: float
    content: dict[str, Any]


def write_mcap(signals: RunSignals, path: Path) -> None:
    """Write all signals of a log, and of the plant where there is a trace."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="omnibot")
        ids = {
            channel: writer.register_channel(
                channel, "json", writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            )
            for channel, (name, schema) in schemas(signals).items()
        }
        for entry in entries(signals):
            data = json.dumps(entry.content, allow_nan=False).encode()
            time_ns = nanoseconds(entry.time_s)
            writer.add_message(ids[entry.channel], log_time=time_ns, data=data, publish_time=time_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # it says no return type


def nanoseconds(time_s: float) -> int:
    """Return a time in ns; those of the clock have no more than microseconds."""
    return round(time_s * 1e6) * 1000


def channel_of(topic: str) -> str:
    """Return the channel of a topic."""
    return "/" + topic.replace(".", "/")


def schemas(signals: RunSignals) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return name and definition of each channel's schema."""
    ours = {channel_of(topic.name): (f"omnibot.{topic.name}", schema_of(topic)) for topic in signals.topics}
    return ours | {channel: (name, FOXGLOVE_SCHEMAS[name]) for channel, name in FOXGLOVE_CHANNELS.items()}


def schema_of(topic: Topic) -> dict[str, Any]:
    """Return the JSON schema of a topic's messages; a signal's description is its unit."""
    properties: dict[str, dict[str, Any]] = {}
    for signal in topic.signals:
        properties[signal.name] = {"type": "number"} | ({"description": signal.unit} if signal.unit else {})
        if signal.labels:
            properties[f"{signal.name}_name"] = {"type": "string", "enum": sorted(signal.labels.values())}
    return {"title": topic.name, "description": topic.purpose, "type": "object", "properties": properties}


def entries(signals: RunSignals) -> Iterator[Entry]:
    """Yield every message of the file in the order of time."""
    topics = {topic.name: topic for topic in signals.topics}
    # The robot is drawn where it is, if that is known, and else where the firmware was told that it is.
    truth = "POSE" if signals.plant is None else "plant.pose"
    reference = None if signals.plant is None else _reference_path(signals.plant)
    for sample in signals:
        yield Entry(channel_of(sample.topic), sample.time_s, _content(topics[sample.topic], sample))
        if sample.topic not in (truth, "POSE") or not all(map(math.isfinite, sample.values)):
            continue
        if sample.topic == truth:
            yield Entry(TRANSFORM, sample.time_s, _transform(sample))
        if sample.topic == "POSE":
            yield Entry(POSE, sample.time_s, _in_world(sample.time_s) | {"pose": _pose(*sample.values[:3])})
        if sample.topic == truth and reference is not None:
            yield Entry(REFERENCE_PATH, sample.time_s, _in_world(sample.time_s) | {"poses": reference})
            reference = None


def _content(topic: Topic, sample: Sample) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for signal, value in zip(topic.signals, sample.values, strict=True):
        if not math.isfinite(value):
            continue
        content[signal.name] = value
        if signal.labels:
            content[f"{signal.name}_name"] = signal.labels.get(int(value), f"{value:g}")
    return content


def _reference_path(plant: PlantSignals) -> list[dict[str, Any]]:
    """Return poses along the reference of a run."""
    trace = plant.trace
    every = -(-len(trace) // PATH_POSES)
    rows = np.column_stack([trace.reference_point, trace.reference_heading])[:: max(every, 1)]
    return [_pose(*row) for row in rows.tolist() if all(map(math.isfinite, row))]


def _transform(sample: Sample) -> dict[str, Any]:
    pose = _pose(*sample.values[:3])
    return {
        "timestamp": _time(sample.time_s),
        "parent_frame_id": WORLD,
        "child_frame_id": ROBOT,
        "translation": pose["position"],
        "rotation": pose["orientation"],
    }


def _in_world(time_s: float) -> dict[str, Any]:
    return {"timestamp": _time(time_s), "frame_id": WORLD}


def _time(time_s: float) -> dict[str, int]:
    seconds, rest_ns = divmod(nanoseconds(time_s), 1_000_000_000)
    return {"sec": seconds, "nsec": rest_ns}


def _pose(x1_m: float, x2_m: float, heading_rad: float) -> dict[str, Any]:
    """Return a pose on the ground; a quaternion turns by twice its angle."""
    half = 0.5 * heading_rad
    return {
        "position": {"x": x1_m, "y": x2_m, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
    }
