"""The wire: ``protocol/omnibot.dbc`` as functions from SI values to bytes and back.

cantools reads the definition; the arithmetic is ours, because cantools truncates and neither clamps nor knows 'not
available'. The same rules hold in the firmware: values are rounded to the nearest step and held within the range, NaN
is the most negative raw value of a signed physical signal, and a signal called ``crc`` is made and checked here.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, cast

import cantools
from cantools.database.can import Database, Message, Signal

from host_sim.errors import OmnibotError
from host_sim.robot import ROOT

DBC_FILE = ROOT / "protocol" / "omnibot.dbc"
NODE_BITS = 4
NODES = 1 << NODE_BITS


# The messages that this host speaks, their fields in order.
SPOKEN = {
    "COMMAND": ("operation", "counter", "key"),
    "POSE": ("x1_m", "x2_m", "heading_rad", "counter"),
    "WHEEL_SPEED": ("wheel1_rad_per_s", "wheel2_rad_per_s", "wheel3_rad_per_s", "counter"),
    "SYNC": ("tick", "pose_crc", "wheel_speed_crc"),
    "TORQUE": ("wheel1_Nm", "wheel2_Nm", "wheel3_Nm", "counter", "mode"),
    "SLIP": ("mu1_m_per_s", "mu2_m_per_s", "mu3_m_per_s", "counter"),
    "STATUS": ("mode", "refusal", "fault", "fault_mask", "dropped_frames", "missed_ticks"),
    "TIMING": ("step_min_us", "step_mean_us", "step_max_us", "overruns"),
    "HEALTH": (
        "reset_cause",
        "clock_source",
        "can_state",
        "bridges",
        "can_tx_errors",
        "can_rx_errors",
        "can_bus_offs",
        "can_rx_lost",
        "supply_V",
    ),
    "CRASH": ("pc", "lr"),
    "DROPS": ("damaged", "replayed", "masqueraded", "unsent"),
    "FAULT_RECORD": ("fault", "reaction", "count", "tick"),
    "CHALLENGE": ("key", "ticks"),
    "PARAMETER_SET": ("index", "value", "counter"),
    "PARAMETER_GET": ("index", "field", "part"),
    "PARAMETER_VALUE": ("index", "result", "field", "value"),
    "PARAMETER_TEXT": ("index", "field", "part", "char0", "char1", "char2", "char3", "char4", "char5"),
    "PARAMETER_STORE": ("origin", "count", "unsaved", "robot_checksum"),
    "TRAJECTORY_BEGIN": ("length_bytes", "crc32", "counter"),
    "TRAJECTORY_DATA": ("offset_bytes", "byte0", "byte1", "byte2", "byte3", "byte4", "byte5"),
    "TRAJECTORY_ACK": ("offset_bytes", "result"),
    "HELLO": ("protocol_hash",),
    "IDENTITY": ("protocol_hash", "major", "minor", "patch", "peer_matches", "drive"),
}


class WireError(OmnibotError):
    """A frame that is not what it says it is."""


def crc8(data: bytes, crc: int = 0xFF) -> int:
    """CRC-8 SAE J1850 without the final inversion, so that it can be continued."""
    for byte in data:
        crc = _CRC8[crc ^ byte]
    return crc


def _crc8_table() -> bytes:
    table = bytearray()
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1) ^ 0x1D if crc & 0x80 else crc << 1
        table.append(crc & 0xFF)
    return bytes(table)


_CRC8 = _crc8_table()


class Field(NamedTuple):
    """How one signal lies in the little-endian word of the payload; ``raw_max`` is 0 for plain unsigned ones."""

    name: str
    start: int
    mask: int
    sign: int
    raw_max: int
    unit_per_step: float
    steps_per_unit: float
    is_float: bool
    unit: str


def _field(signal: Signal) -> Field:
    physical = signal.is_signed and not signal.is_float
    sign = 1 << (signal.length - 1)
    scale = float(signal.scale)
    return Field(
        name=signal.name,
        start=signal.start,
        mask=(1 << signal.length) - 1,
        sign=sign if physical else 0,
        raw_max=sign - 1 if physical else 0,
        unit_per_step=scale,
        steps_per_unit=1.0 / scale,
        is_float=signal.is_float,
        unit=signal.unit or "",
    )


class MessageCodec:
    """One message of the wire for one node: ``pack`` and ``unpack`` take and give values in the order of ``fields``."""

    def __init__(self, message: Message, node: int) -> None:
        self.name = message.name
        self.arbitration_id = message.frame_id | node
        self.length = message.length
        self.from_robot = "ROBOT" in message.senders
        self.purpose = message.comment or ""
        self.fields = tuple(_field(signal) for signal in message.signals if signal.name != "crc")
        self.choices = {s.name: {str(v): int(k) for k, v in s.choices.items()} for s in message.signals if s.choices}
        self._labels = {name: {k: v for v, k in choices.items()} for name, choices in self.choices.items()}
        self._to_raw = tuple((field.start, _to_raw(field)) for field in self.fields)
        self._from_raw = tuple((field.start, field.mask, _from_raw(field)) for field in self.fields)
        self._has_crc = any(signal.name == "crc" for signal in message.signals)
        self._id_crc = crc8(self.arbitration_id.to_bytes(2, "little"))

    def pack(self, *values: float) -> bytes:
        """Return the payload of the values, one for each of ``fields``, in SI units."""
        word = 0
        for (start, to_raw), value in zip(self._to_raw, values, strict=True):
            word |= to_raw(value) << start
        data = word.to_bytes(self.length, "little")
        if not self._has_crc:
            return data
        return data[:-1] + bytes((crc8(data[:-1], self._id_crc) ^ 0xFF,))

    def seal(self, data: bytes) -> int:
        """Return the CRC-8 over identifier and whole payload, by which SYNC vouches for a sensor frame."""
        return crc8(data, self._id_crc) ^ 0xFF

    def unpack(self, data: bytes) -> tuple[float, ...]:
        """Return the values of a payload; WireError for one that is too short, too long or damaged."""
        if len(data) != self.length:
            raise WireError(f"{self.name} has {len(data)} bytes; it must have {self.length}")
        if self._has_crc and crc8(data[:-1], self._id_crc) ^ 0xFF != data[-1]:
            raise WireError(f"{self.name} {data.hex()} is damaged: its CRC is wrong")
        return self.decode(data)

    def decode(self, data: bytes) -> tuple[float, ...]:
        """Return the values of a payload, whole or not."""
        word = int.from_bytes(data, "little")
        return tuple([from_raw(word >> start & mask) for start, mask, from_raw in self._from_raw])

    def named(self, data: bytes) -> dict[str, float]:
        """Return the values of a payload by name."""
        return dict(zip((field.name for field in self.fields), self.unpack(data), strict=True))

    def labels(self, signal: str) -> dict[int, str]:
        """Return the names that the definition gives to values of a signal."""
        return self._labels.get(signal, {})

    def label(self, signal: str, value: float) -> str:
        """Return the name that the definition gives to a value of a signal."""
        return self._labels[signal].get(int(value), f"{value:g}")


def _to_raw(field: Field) -> Callable[[float], int]:
    """Return the function from a value of a field to its raw bits: a closure, because every frame calls it."""
    if field.is_float:
        return lambda value: _float_bits(field, value)
    if not field.raw_max:
        return lambda value: _whole(field, value)
    mask, sign, largest, steps_per_unit = field.mask, field.sign, field.raw_max, field.steps_per_unit

    def physical(value: float) -> int:
        steps = value * steps_per_unit
        if steps >= 0.0:
            return int(steps + 0.5) if steps < largest else largest
        if steps < 0.0:
            return int(steps - 0.5 if steps > -largest else -largest) & mask
        return sign  # not a number

    return physical


def _whole(field: Field, value: float) -> int:
    if not (0 <= value <= field.mask and value == int(value)):
        raise OmnibotError(f"{field.name} = {value} must be a whole number, 0 … {field.mask}")
    return int(value)


def _float_bits(field: Field, value: float) -> int:
    try:
        return int.from_bytes(struct.pack("<f", value), "little")
    except OverflowError as error:
        raise OmnibotError(f"{field.name} = {value} is too large for single precision") from error


def _from_raw(field: Field) -> Callable[[int], float]:
    """Return the function from the raw bits of a field to its value."""
    if field.is_float:
        return lambda raw: cast(float, struct.unpack("<f", raw.to_bytes(4, "little"))[0])
    if not field.raw_max:
        return lambda raw: raw
    sign, unit_per_step = field.sign, field.unit_per_step
    return lambda raw: ((raw ^ sign) - sign) * unit_per_step if raw != sign else math.nan


def load_messages(dbc: Path) -> list[Message]:
    """Read the messages of a wire definition."""
    return _read(dbc)[1]


def _read(dbc: Path) -> tuple[bytes, list[Message]]:
    try:
        content = dbc.read_bytes()
        database = cantools.database.load_string(content.decode("utf-8"), "dbc")
    except (OSError, UnicodeDecodeError, cantools.Error) as error:
        raise OmnibotError(f"cannot read the wire definition {dbc}: {error}") from error
    return content, cast(Database, database).messages


class Codec:
    """Every message of a wire definition, by name, for one node."""

    def __init__(self, dbc: Path = DBC_FILE, node: int = 0) -> None:
        if not 0 <= node < NODES:
            raise OmnibotError(f"node {node}: must be 0 … {NODES - 1}")
        content, messages = _read(dbc)
        self.node = node
        # Line ends are a matter of the checkout, not of the wire.
        self.protocol_hash = zlib.crc32(content.replace(b"\r\n", b"\n"))
        try:
            self._by_name = {message.name: MessageCodec(message, node) for message in messages}
        except (ArithmeticError, ValueError) as error:
            raise OmnibotError(f"cannot use the wire definition {dbc}: {error}") from error
        for name, names in SPOKEN.items():
            found = tuple(field.name for field in self._by_name[name].fields) if name in self._by_name else None
            if found != names:
                raise OmnibotError(
                    f"cannot use the wire definition {dbc}: it needs a message {name} of {', '.join(names)}"
                )
        self._by_id = {codec.arbitration_id: codec for codec in self._by_name.values()}

    def __getitem__(self, name: str) -> MessageCodec:
        return self._by_name[name]

    def __iter__(self) -> Iterator[MessageCodec]:
        return iter(self._by_name.values())

    def of_id(self, arbitration_id: int) -> MessageCodec | None:
        """Return the message of an identifier, if it is one of ours."""
        return self._by_id.get(arbitration_id)
