"""The generated C codec, called through ctypes: against golden frames and against the Python codec."""

import ctypes
import json
import math
from functools import cache
from typing import Any, cast

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal

from host_sim.codec import DBC_FILE, NODES, Codec, WireError, crc8
from host_sim.inproc import Frame
from host_sim.robot import ROOT

LIBRARY_FILE = ROOT / "build" / "host" / "libprotocol-visible.so"
GOLDEN = json.loads((ROOT / "tests" / "data" / "golden_frames.json").read_text(encoding="utf-8"))
DATABASE = cast(Database, cantools.database.load_file(DBC_FILE))
SEED = 20140
CASES = 2000  # a message
DECODE_OK, DECODE_WRONG_LENGTH, DECODE_WRONG_CRC = range(3)
FLOAT_EPSILON = 2.0**-23

each_golden = pytest.mark.parametrize("row", GOLDEN, ids=lambda row: f"{row['message']}: {row['why']}")
each_message = pytest.mark.parametrize("message", DATABASE.messages, ids=lambda message: message.name)


def is_physical(signal: Signal) -> bool:
    """Signed, scaled and float signals are floats in C (tools/generate_codec.py)."""
    return bool(signal.is_float or signal.is_signed or signal.scale != 1)


def c_type(signal: Signal) -> type[ctypes.c_float | ctypes.c_uint8 | ctypes.c_uint16 | ctypes.c_uint32]:
    if is_physical(signal):
        return ctypes.c_float
    unsigned = {8: ctypes.c_uint8, 16: ctypes.c_uint16, 32: ctypes.c_uint32}
    return next(made for bits, made in unsigned.items() if signal.length <= bits)


def fields(message: Message) -> list[Signal]:
    return [signal for signal in message.signals if signal.name != "crc"]


class CodecInC:
    """One message's functions and struct."""

    def __init__(self, library: ctypes.CDLL, message: Message) -> None:
        name = message.name.lower()
        layout = [(signal.name, c_type(signal)) for signal in fields(message)]
        self.struct = type(f"{name}_message_t", (ctypes.Structure,), {"_fields_": layout})
        self.encoder, self.decoder = library[f"{name}_encode"], library[f"{name}_decode"]
        self.encoder.restype = None
        self.encoder.argtypes = (ctypes.POINTER(Frame), ctypes.c_uint8, ctypes.POINTER(self.struct))
        self.decoder.argtypes = (ctypes.POINTER(self.struct), ctypes.POINTER(Frame))

    def encode(self, node: int, values: list[float]) -> tuple[int, bytes]:
        frame = Frame()
        self.encoder(frame, node, self.struct(*values))
        return frame.id, bytes(frame.data[: frame.length])

    def decode(self, arbitration_id: int, data: bytes) -> tuple[int, dict[str, float]]:
        values = self.struct()
        frame = Frame(arbitration_id, len(data), (ctypes.c_uint8 * 8)(*data[:8]))
        result = self.decoder(values, frame)
        return result, {name: getattr(values, name) for name, _ in self.struct._fields_}


@pytest.fixture(scope="module")
def library() -> ctypes.CDLL:
    if not LIBRARY_FILE.exists():
        pytest.fail(f"no {LIBRARY_FILE}: cmake --preset host && cmake --build --preset host")
    return ctypes.CDLL(str(LIBRARY_FILE))


@cache  # reading the definition takes longer than the arithmetic
def python_codec(node: int = 0) -> Codec:
    return Codec(node=node)


def number(value: float | None) -> float:
    """JSON has no NaN: golden frames say null."""
    return math.nan if value is None else value


def sealed(message: Message, arbitration_id: int, payload: bytes) -> bytes:
    """The payload with its CRC made right, if it has one."""
    if len(fields(message)) == len(message.signals):
        return payload
    return payload[:-1] + bytes((crc8(payload[:-1], crc8(arbitration_id.to_bytes(2, "little"))) ^ 0xFF,))


# Golden frames ------------------------------------------------------------------------------------------------------


@each_golden
def test_encode_gives_the_golden_bytes(library: ctypes.CDLL, row: dict[str, Any]) -> None:
    message = DATABASE.get_message_by_name(row["message"])
    values = [number(row["values"][signal.name]) for signal in fields(message)]

    arbitration_id, data = CodecInC(library, message).encode(row["node"], values)

    assert arbitration_id == message.frame_id | row["node"]
    assert data.hex() == row["bytes"]


@each_golden
def test_decode_gives_the_golden_values(library: ctypes.CDLL, row: dict[str, Any]) -> None:
    message = DATABASE.get_message_by_name(row["message"])
    arbitration_id = message.frame_id | row["node"]

    result, values = CodecInC(library, message).decode(arbitration_id, bytes.fromhex(row["bytes"]))

    assert result == DECODE_OK
    for signal in fields(message):
        expected = number((row["values"] | row.get("decoded", {}))[signal.name])
        half_step = 0.0 if signal.is_float or not is_physical(signal) else 0.5 * float(signal.scale)
        tolerance = half_step + abs(expected) * FLOAT_EPSILON
        assert values[signal.name] == pytest.approx(expected, rel=0, abs=tolerance, nan_ok=True), signal.name


# Against the Python codec -------------------------------------------------------------------------------------------


def random_value(signal: Signal, rng: np.random.Generator) -> float:
    """A value as the firmware could hold it: within the range, at its ends, beyond them, or none at all."""
    if not is_physical(signal):
        return int(rng.integers(2**signal.length))
    end = 1e3 if signal.is_float else float(signal.maximum or 0)
    special = [math.nan, math.inf, -math.inf, 0.0, -0.0, end, -end, 1e30, -1e30, 1e-40]
    value = rng.choice(special) if rng.random() < 0.1 else rng.uniform(-1.2 * end, 1.2 * end)
    return float(np.float32(value))


def is_near_a_tie(signal: Signal, value: float) -> bool:
    """Tell whether single precision cannot say on which side of the middle of two steps a value lies."""
    steps = value / float(signal.scale)
    return abs(abs(steps) % 1.0 - 0.5) <= abs(steps) * FLOAT_EPSILON


def raw_value(message: Message, data: bytes, signal: Signal) -> int:
    read = message.decode(data, scaling=False, decode_choices=False)
    return int(cast(dict[str, int], read)[signal.name])


@each_message
def test_encode_of_random_values_gives_the_bytes_of_the_python_codec(library: ctypes.CDLL, message: Message) -> None:
    rng = np.random.default_rng(SEED)
    in_c = CodecInC(library, message)
    different = dict.fromkeys((signal.name for signal in fields(message)), 0)

    for _ in range(CASES):
        node = int(rng.integers(NODES))
        in_python = python_codec(node)[message.name]
        values = [random_value(signal, rng) for signal in fields(message)]
        arbitration_id, data = in_c.encode(node, values)
        expected = in_python.pack(*values)
        assert arbitration_id == in_python.arbitration_id
        if data == expected:
            continue
        in_python.unpack(data)  # the CRC is right
        for signal, value in zip(fields(message), values, strict=True):
            steps_apart = abs(raw_value(message, data, signal) - raw_value(message, expected, signal))
            assert steps_apart <= (1 if is_physical(signal) and is_near_a_tie(signal, value) else 0), (signal, value)
            different[signal.name] += steps_apart

    for signal in fields(message):
        # At 2^(length - 1) steps single precision knows 2^(25 - length) places within a step: one of them is the
        # middle, half of what is rounded to it came from below. Smaller values are better; the 3 is for chance.
        share = 2.0 ** (signal.length - 26) if is_physical(signal) and not signal.is_float else 0.0
        assert different[signal.name] <= (share * CASES + 3 if share else 0), signal.name


@each_message
def test_decode_of_random_bytes_gives_the_values_of_the_python_codec(library: ctypes.CDLL, message: Message) -> None:
    rng = np.random.default_rng(SEED)
    in_c, in_python = CodecInC(library, message), python_codec()[message.name]

    for _ in range(CASES):
        data = sealed(message, message.frame_id, rng.bytes(message.length))
        result, values = in_c.decode(message.frame_id, data)
        assert result == DECODE_OK
        for name, expected in in_python.named(data).items():
            assert values[name] == pytest.approx(expected, rel=FLOAT_EPSILON, abs=0, nan_ok=True), (name, data.hex())


@each_message
def test_decode_of_random_bytes_is_refused_when_the_python_codec_refuses(
    library: ctypes.CDLL, message: Message
) -> None:
    rng = np.random.default_rng(SEED)
    in_c, in_python = CodecInC(library, message), python_codec()[message.name]

    for _ in range(CASES):
        data = rng.bytes(message.length)
        try:
            in_python.unpack(data)
            expected = DECODE_OK
        except WireError:
            expected = DECODE_WRONG_CRC
        assert in_c.decode(message.frame_id, data)[0] == expected


@each_message
def test_decode_of_a_wrong_length_is_refused_and_writes_nothing(library: ctypes.CDLL, message: Message) -> None:
    in_c = CodecInC(library, message)

    for length in set(range(9)) - {message.length}:
        result, values = in_c.decode(message.frame_id, b"\xff" * length)
        assert result == DECODE_WRONG_LENGTH
        assert set(values.values()) == {0}
