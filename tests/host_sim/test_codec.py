"""The Python codec against golden frames, against cantools and against the firmware's idea of the definition."""

import json
import math
import re
from pathlib import Path
from typing import Any, cast

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database, Message

from host_sim.codec import DBC_FILE, NODES, Codec, WireError, crc8
from host_sim.errors import OmnibotError
from host_sim.robot import ROOT

GOLDEN = json.loads((ROOT / "tests" / "data" / "golden_frames.json").read_text(encoding="utf-8"))
DATABASE = cast(Database, cantools.database.load_file(DBC_FILE))
SEED = 20140
ROUND_TRIPS = 200  # a message

each_golden = pytest.mark.parametrize("row", GOLDEN, ids=lambda row: f"{row['message']}: {row['why']}")
each_message = pytest.mark.parametrize("message", DATABASE.messages, ids=lambda message: message.name)
each_guarded = pytest.mark.parametrize("name", ["COMMAND", "SYNC", "TORQUE", "PARAMETER_SET", "TRAJECTORY_BEGIN"])


def number(value: float | None) -> float:
    """JSON has no NaN: golden frames say null."""
    return math.nan if value is None else value


def scale_of(message: Message, signal: str) -> float:
    return float(message.get_signal_by_name(signal).scale)


def random_values(message: Message, rng: np.random.Generator) -> dict[str, float]:
    """Values within the range of each field of a message."""
    values: dict[str, float] = {}
    for signal in message.signals:
        if signal.is_float:
            values[signal.name] = float(np.float32(rng.normal(scale=100.0)))
        elif signal.is_signed:
            values[signal.name] = rng.uniform(float(signal.minimum or 0), float(signal.maximum or 0))
        elif signal.name != "crc":
            values[signal.name] = int(rng.integers(2**signal.length))
    return values


# Golden frames ------------------------------------------------------------------------------------------------------


def test_golden_frames_cover_every_message() -> None:
    assert {row["message"] for row in GOLDEN} == {message.name for message in DATABASE.messages}


@each_golden
def test_pack_gives_the_golden_bytes(row: dict[str, Any]) -> None:
    message = Codec(node=row["node"])[row["message"]]

    data = message.pack(*(number(row["values"][field.name]) for field in message.fields))

    assert data.hex() == row["bytes"]


@each_golden
def test_unpack_gives_the_golden_values(row: dict[str, Any]) -> None:
    message = DATABASE.get_message_by_name(row["message"])

    values = Codec(node=row["node"])[row["message"]].named(bytes.fromhex(row["bytes"]))

    expected = row["values"] | row.get("decoded", {})
    assert list(values) == list(expected)
    for name, value in values.items():
        is_float = message.get_signal_by_name(name).is_float
        tolerance = abs(number(expected[name])) * 2**-24 if is_float else 0.5 * scale_of(message, name) * (1 + 1e-9)
        assert value == pytest.approx(number(expected[name]), rel=0, abs=tolerance, nan_ok=True), name


# Against cantools ---------------------------------------------------------------------------------------------------


@each_message
def test_pack_of_random_values_is_read_by_cantools_to_half_a_step(message: Message) -> None:
    rng = np.random.default_rng(SEED)
    codec = Codec()[message.name]

    for _ in range(ROUND_TRIPS):
        values = random_values(message, rng)
        read = cast(dict[str, float], message.decode(codec.pack(*values.values()), decode_choices=False))
        for name, value in values.items():
            half_step = 0.0 if isinstance(value, int) else 0.5 * scale_of(message, name) * (1 + 1e-9)
            assert abs(read[name] - value) <= half_step, (name, value)


@each_message
def test_unpack_of_random_bytes_agrees_with_cantools(message: Message) -> None:
    rng = np.random.default_rng(SEED)
    codec = Codec()[message.name]

    for _ in range(ROUND_TRIPS):
        data = bytearray(rng.bytes(message.length))
        if any(signal.name == "crc" for signal in message.signals):
            data[-1] = crc8(bytes(data[:-1]), crc8(message.frame_id.to_bytes(2, "little"))) ^ 0xFF
        raw = message.decode(bytes(data), scaling=False, decode_choices=False)
        read = message.decode(bytes(data), decode_choices=False)
        assert isinstance(raw, dict)
        assert isinstance(read, dict)
        for name, value in codec.named(bytes(data)).items():
            signal = message.get_signal_by_name(name)
            missing = signal.is_signed and not signal.is_float and raw[name] == -(2 ** (signal.length - 1))
            expected = math.nan if missing else float(read[name])
            assert value == pytest.approx(expected, rel=1e-15, abs=0, nan_ok=True), name


# Rounding, range, not available -------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.inf, 1e300, 20.971516])
def test_pack_beyond_the_range_holds_the_end(value: float) -> None:
    pose = Codec()["POSE"]

    assert pose.unpack(pose.pack(value, -value, 0.0, 0))[:2] == pytest.approx((20.97151, -20.97151))


def test_unpack_of_the_most_negative_raw_value_is_not_available() -> None:
    wheels = Codec()["WHEEL_SPEED"]

    values = wheels.unpack((0x80000).to_bytes(8, "little"))

    assert math.isnan(values[0])
    assert values[1:] == (0.0, 0.0, 0)


@pytest.mark.parametrize("counter", [-1, 16, 1e9, 0.5, -0.5, math.nan, math.inf])
def test_pack_of_an_unsigned_value_that_does_not_fit_is_refused_by_name(counter: float) -> None:
    with pytest.raises(OmnibotError, match=r"counter = .* must be a whole number, 0 … 15"):
        Codec()["TRAJECTORY_BEGIN"].pack(1, 1, counter)


def test_pack_of_a_float_beyond_single_precision_is_refused_by_name() -> None:
    with pytest.raises(OmnibotError, match=r"value = 1e\+39 is too large"):
        Codec()["PARAMETER_SET"].pack(0, 1e39, 0)


def test_pack_with_a_value_missing_is_refused() -> None:
    with pytest.raises(ValueError, match="shorter"):
        Codec()["SYNC"].pack(1)


# Length and CRC -----------------------------------------------------------------------------------------------------


def test_crc8_of_the_textbook_string_is_the_textbook_value() -> None:
    assert crc8(b"123456789") ^ 0xFF == 0x4B


@each_message
def test_unpack_of_a_wrong_length_is_refused(message: Message) -> None:
    for length in set(range(9)) - {message.length}:
        with pytest.raises(WireError, match=rf"{message.name} has {length} bytes; it must have {message.length}"):
            Codec()[message.name].unpack(bytes(length))


def test_messages_with_a_crc_are_those_tested_here() -> None:
    guarded = [m.name for m in DATABASE.messages if any(s.name == "crc" for s in m.signals)]

    assert guarded == ["COMMAND", "SYNC", "TORQUE", "PARAMETER_SET", "TRAJECTORY_BEGIN"]


@each_guarded
def test_unpack_with_any_one_or_two_bits_wrong_is_refused(name: str) -> None:
    codec = Codec()[name]
    good = int.from_bytes(codec.pack(*(1 for _ in codec.fields)), "little")
    bits = 8 * codec.length

    for first in range(bits):
        for second in range(first, bits):
            bad = good ^ (1 << first | (1 << second if second != first else 0))
            with pytest.raises(WireError, match=f"{name} .* is damaged"):
                codec.unpack(bad.to_bytes(codec.length, "little"))


@each_guarded
def test_unpack_of_a_frame_meant_for_another_node_is_refused(name: str) -> None:
    codec = Codec(node=2)[name]
    data = codec.pack(*(1 for _ in codec.fields))

    for node in set(range(NODES)) - {2}:
        with pytest.raises(WireError, match="is damaged"):
            Codec(node=node)[name].unpack(data)


# Identifiers, labels, definition ------------------------------------------------------------------------------------


@pytest.mark.parametrize("node", range(NODES))
def test_identifier_is_that_of_the_definition_and_the_node(node: int) -> None:
    codec = Codec(node=node)

    for message in DATABASE.messages:
        assert message.frame_id & 0xF == 0
        assert codec[message.name].arbitration_id == message.frame_id | node
        assert codec.of_id(message.frame_id | node) is codec[message.name]
        assert codec.of_id(message.frame_id | (node + 1) % NODES) is None


@pytest.mark.parametrize("node", [-1, NODES])
def test_node_that_does_not_exist_is_refused(node: int) -> None:
    with pytest.raises(OmnibotError, match=rf"node {node}: must be 0 … 15"):
        Codec(node=node)


def test_label_is_the_definitions_name_or_the_number() -> None:
    status = Codec()["STATUS"]

    assert status.label("mode", 3) == "TRACKING"
    assert status.label("mode", 9) == "9"
    assert status.choices["fault"]["TICK_GAP"] == 3


def test_protocol_hash_is_the_firmwares() -> None:
    header = ROOT / "build" / "host" / "generated" / "messages.h"
    if not header.exists():
        pytest.fail(f"no {header}: cmake --preset host && cmake --build --preset host")
    found = re.search(r"#define PROTOCOL_HASH 0x([0-9A-F]{8})u", header.read_text(encoding="utf-8"))
    assert found

    assert Codec().protocol_hash == int(found[1], 16)


def test_protocol_hash_does_not_depend_on_line_ends(tmp_path: Path) -> None:
    other = tmp_path / "windows.dbc"
    other.write_bytes(DBC_FILE.read_bytes().replace(b"\n", b"\r\n"))

    assert Codec(other).protocol_hash == Codec().protocol_hash


@pytest.mark.parametrize("content", [None, b"BO_ what is this?", b"\xff\xfe"])
def test_definition_that_cannot_be_read_is_refused_by_name(tmp_path: Path, content: bytes | None) -> None:
    dbc = tmp_path / "broken.dbc"
    if content is not None:
        dbc.write_bytes(content)

    with pytest.raises(OmnibotError, match=r"cannot read the wire definition .*broken\.dbc"):
        Codec(dbc)
