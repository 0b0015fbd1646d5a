"""Signals of a log and of a run: cantools decodes what tables and MCAP file must hold, scipy turns the poses."""

import csv
import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import can
import cantools
import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from host_sim.canlog import write_log
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.mcap_file import write_mcap
from host_sim.robot import ROOT
from host_sim.signals import open_signals, write_csv, write_npz
from host_sim.trace import Trace

LAYOUTS = ROOT / "host_sim" / "layouts"

Decoded = dict[str, list[tuple[str, dict[str, Any]]]]


def frames_of(log: Path) -> list[can.Message]:
    with can.CanutilsLogReader(log) as reader:
        return list(reader)


def decoded(log: Path, choices: bool = False) -> Decoded:
    """Return what cantools makes of a log: for each message its times, as text, and signals, without the checksum."""
    database = cantools.database.load_file(ROOT / "protocol" / "omnibot.dbc")
    found: Decoded = defaultdict(list)
    for line in log.read_text().splitlines():
        stamp, _, frame, *_ = line.split()
        identifier, data = frame.split("#")
        message = database.get_message_by_frame_id(int(identifier, 16))
        signals = message.decode(bytes.fromhex(data), decode_choices=choices)
        signals.pop("crc", None)
        found[message.name].append((stamp.strip("()"), signals))
    return found


def test_csv_holds_every_signal_that_cantools_decodes(tmp_path: Path, recorded_run: Path) -> None:
    log, out = recorded_run / "bus.log", tmp_path / "run.csv"

    write_csv(open_signals(log), out)

    expected = decoded(log)
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert set(rows[0]) == {"time_s"} | {f"{name}.{s}" for name, all_of in expected.items() for s in all_of[0][1]}
    for name, all_of in expected.items():
        first = next(iter(all_of[0][1]))
        there = [row for row in rows if row[f"{name}.{first}"]]
        assert [float(row["time_s"]) for row in there] == [float(stamp) for stamp, _ in all_of]
        for signal in all_of[0][1]:
            values = [float(row[f"{name}.{signal}"]) for row in there]
            assert values == pytest.approx([float(signals[signal]) for _, signals in all_of], rel=1e-9, abs=1e-12)


def test_csv_of_a_run_has_a_row_a_tick_with_wire_and_plant(tmp_path: Path, recorded_run: Path) -> None:
    write_csv(open_signals(recorded_run), tmp_path / "run.csv")

    trace = Trace.load(recorded_run)
    with (tmp_path / "run.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["SYNC.tick"] and row["plant.slip_ratio.wheel1"]]
    assert [int(row["SYNC.tick"]) for row in rows[:-1]] == trace.tick[: len(rows) - 1].tolist()
    assert len(rows) >= len(trace) - 1  # STOP makes another row of the last instant
    slip = [[float(row[f"plant.slip_ratio.wheel{wheel}"]) for wheel in (1, 2, 3)] for row in rows]
    assert np.array_equal(slip, trace.slip_ratio[: len(rows)])


def test_npz_holds_signals_of_the_wire_and_the_trace(tmp_path: Path, recorded_run: Path) -> None:
    write_npz(open_signals(recorded_run), tmp_path / "run.npz")

    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    for name, all_of in decoded(recorded_run / "bus.log").items():
        assert arrays[f"{name}.time_s"].tolist() == [float(stamp) for stamp, _ in all_of]
        for signal in all_of[0][1]:
            values = [float(signals[signal]) for _, signals in all_of]
            assert arrays[f"{name}.{signal}"] == pytest.approx(values, rel=1e-9, abs=1e-12)
    with np.load(recorded_run / "trace.npz") as trace:
        assert np.array_equal(arrays["plant.wheel_force.wheel3_N"], trace["wheel_force"][:, 2])
        assert np.array_equal(arrays["plant.reference_heading.heading_rad"], trace["reference_heading"])
        error = np.linalg.norm(trace["point"] - trace["reference_point"], axis=1)
        assert arrays["plant.error.tracking_m"] == pytest.approx(error, rel=1e-12)


def channels_of(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Read an MCAP file with mcap's own reader: for each channel, times in ns and messages."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            assert content.keys() <= json.loads(schema.data)["properties"].keys()
            found[channel.topic].append((message.log_time, content))
    return found


def test_mcap_holds_every_signal_that_cantools_decodes(tmp_path: Path, recorded_run: Path) -> None:
    write_mcap(open_signals(recorded_run / "bus.log"), tmp_path / "run.mcap")

    found, names = channels_of(tmp_path / "run.mcap"), decoded(recorded_run / "bus.log", choices=True)
    for name, all_of in decoded(recorded_run / "bus.log").items():
        messages = found.pop(f"/{name}")
        assert len(messages) == len(all_of)
        for (stamp, signals), (_, named), (time_ns, content) in zip(all_of, names[name], messages, strict=True):
            assert time_ns == int(stamp.replace(".", "")) * 1000
            for signal, value in signals.items():
                assert content[signal] == pytest.approx(float(value), rel=1e-9, abs=1e-12)
                if not isinstance(named[signal], int | float):
                    assert content[f"{signal}_name"] == str(named[signal])
    assert found.keys() == {"/robot/transform", "/robot/pose"}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory, recorded_run: Path) -> Path:
    """Return the MCAP file of a run."""
    path = tmp_path_factory.mktemp("exported") / "run.mcap"
    write_mcap(open_signals(recorded_run), path)
    return path


def test_mcap_of_a_run_draws_the_robot_where_the_plant_is(exported: Path, recorded_run: Path) -> None:
    found, trace = channels_of(exported), Trace.load(recorded_run)
    transforms = [content for _, content in found["/robot/transform"]]
    assert [[t["translation"][axis] for axis in "xy"] for t in transforms] == trace.pose[:, :2].tolist()
    turned = Rotation.from_quat([[t["rotation"][axis] for axis in "xyzw"] for t in transforms])
    assert turned.as_euler("xyz")[:, 2] == pytest.approx(trace.pose[:, 2], abs=1e-12)
    assert {t["parent_frame_id"] for t in transforms} == {"world"}
    assert transforms[-1]["timestamp"] == {"sec": 0, "nsec": 760_000_000}
    ((_, path),) = found["/robot/reference_path"]
    assert path["poses"][0]["position"]["x"] == trace.reference_point[0, 0]
    assert found["/plant/slip_ratio"][237][1]["wheel2"] == trace.slip_ratio[237, 1]


def test_foxglove_knows_the_schemas_by_name(exported: Path) -> None:
    with exported.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    names = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert names["/robot/transform"] == "foxglove.FrameTransform"
    assert names["/robot/pose"] == "foxglove.PoseInFrame"
    assert names["/robot/reference_path"] == "foxglove.PosesInFrame"


# ---- layouts


@pytest.fixture(scope="module")
def fields(exported: Path) -> dict[str, set[str]]:
    """Return the channels that an exported run has, each with its fields."""
    found = channels_of(exported)
    return {topic: {key for _, content in messages for key in content} for topic, messages in found.items()}


def test_foxglove_layout_names_what_an_export_has(fields: dict[str, set[str]]) -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]

    assert len(paths) > 15
    for path in paths:
        topic, _, name = path.partition(".")
        assert name in fields[topic], path
    for panel in panels.values():
        assert panel.get("topics", {}).keys() <= fields.keys()
    assert shown(layout["layout"]) == set(panels)


def shown(layout: Any) -> set[str]:
    """Return the panels that a layout of Foxglove shows."""
    return {layout} if isinstance(layout, str) else shown(layout["first"]) | shown(layout["second"])


def test_plotjuggler_layout_names_what_an_export_has(fields: dict[str, set[str]]) -> None:
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    curves = list(root.iter("curve"))
    names = [curve.get("curve_x") or curve.get("name") for curve in curves]
    names += [curve.get("curve_y") for curve in curves if curve.get("curve_y")]

    assert len(names) > 15
    for name in names:
        assert name is not None
        topic, _, signal = name.rpartition("/")
        assert signal in fields[topic], name
    for splitter in root.iter("DockSplitter"):
        assert splitter.get("count") == str(len(splitter)) == str(len((splitter.get("sizes") or "").split(";")))


# ---- what is not all well


def test_value_that_is_not_available_is_nan_and_left_out_of_json(tmp_path: Path) -> None:
    pose, log = Codec()["POSE"], tmp_path / "bus.log"
    frames = [
        can.Message(0.001 * k, pose.arbitration_id, is_extended_id=False, data=pose.pack(x1_m, 2.0, 0.5, k))
        for k, x1_m in enumerate([1.5, math.nan])
    ]
    write_log(frames, log, ".log")

    write_csv(open_signals(log), tmp_path / "bus.csv")
    write_mcap(open_signals(log), tmp_path / "bus.mcap")

    assert (tmp_path / "bus.csv").read_text().splitlines()[1:] == ["0.0,1.5,2.0,0.5,0", "0.001,nan,2.0,0.5,1"]
    found = channels_of(tmp_path / "bus.mcap")
    assert found["/POSE"][1][1] == {"x2_m": 2.0, "heading_rad": 0.5, "counter": 1}
    assert len(found["/robot/pose"]) == 1


def test_damaged_frames_are_left_out_and_counted(tmp_path: Path, recorded_run: Path) -> None:
    frames = frames_of(recorded_run / "bus.log")
    torque = [frame for frame in frames if frame.arbitration_id == 0x050]
    torque[10].data[0] ^= 1
    torque[11].data = torque[11].data[:7]
    write_log(frames, tmp_path / "bus.log", ".log")

    signals = open_signals(tmp_path / "bus.log")
    samples = [sample for sample in signals if sample.topic == "TORQUE"]

    assert signals.wire.damaged == 2
    assert len(samples) == len(torque) - 2


def test_log_of_two_robots_asks_which(tmp_path: Path) -> None:
    log = tmp_path / "bus.log"
    frames = []
    for node in (2, 5):
        sync = Codec(node=node)["SYNC"]
        frames.append(can.Message(0.0, sync.arbitration_id, is_extended_id=False, data=sync.pack(node, 0, 0)))
    write_log(frames, log, ".log")

    with pytest.raises(OmnibotError, match=r"node 2, 5.*--node"):
        open_signals(log)
    with pytest.raises(OmnibotError, match=r"node 2, 5.*--node"):
        open_signals(log, node=3)
    assert [sample.values[0] for sample in open_signals(log, node=5)] == [5]


def test_log_of_another_bus_is_refused(tmp_path: Path) -> None:
    write_log([can.Message(0.0, 0x7FF, is_extended_id=False, data=b"1")], tmp_path / "bus.log", ".log")
    with pytest.raises(OmnibotError, match="another bus"):
        open_signals(tmp_path / "bus.log")
