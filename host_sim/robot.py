"""The robot in numbers, read from ``firmware/robot/omnibot.toml``."""

import difflib
import json
import math
import os
import tomllib
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from host_sim.errors import OmnibotError

ROOT = Path(__file__).resolve().parents[1]
ROBOT_FILE = ROOT / "firmware" / "robot" / "omnibot.toml"
ROBOT_VARIABLE = "OMNIBOT_ROBOT"  # of the environment: another robot file

WHEELS = 3
# Least of the singular values of Jr, its third column over the largest distance: 1.2 with three wheels at 120 degrees.
GRIP_MIN = 0.1

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A firmware parameter that can be set over CAN; ``integer`` ones have no fraction, choices have names."""

    index: int
    name: str
    symbol: str
    integer: bool
    unit: str
    minimum: float
    maximum: float
    default: float
    source: str
    choices: tuple[str, ...] = ()

    def parse(self, text: str) -> float:
        """Return the value that a text stands for, in its range: a number, or the name of a choice."""
        return self.check(self.number(text))

    def number(self, text: str) -> float:
        """Return the number that a text stands for, whatever the range."""
        if self.choices:
            if text not in self.choices:
                raise OmnibotError(f"no {self.name} {text!r}; there are: {', '.join(self.choices)}")
            return float(self.choices.index(text))
        try:
            return float(text)
        except ValueError:
            raise OmnibotError(f"{self.name} = {text} must be a number, {self.range_text()}") from None

    def text(self, value: float) -> str:
        """Return a value as `number` reads it: the name of a choice, or the shortest number of single precision."""
        if self.choices and value in range(len(self.choices)):
            return self.choices[int(value)]
        return f"{value:g}" if self.integer else np.format_float_positional(np.float32(value), trim="-")

    def range_text(self) -> str:
        """Return what may be set, unit included."""
        if self.choices:
            return ", ".join(self.choices)
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.minimum:g} … {self.maximum:g}{unit}"

    def check(self, value: float) -> float:
        """Return the value, or say by name what would be right."""
        if not self.minimum <= value <= self.maximum:
            raise OmnibotError(f"{self.name} = {value:g} is outside {self.range_text()}")
        if self.integer and value != round(value):
            raise OmnibotError(f"{self.name} = {value:g} must be a whole number")
        return value


def shortest(value: float) -> float:
    """Return the shortest decimal that is the same number in single precision: 0.01, not 0.009999999776."""
    return float(np.format_float_positional(np.float32(value)))


def parameter_named(name: str, parameters: Iterable[Parameter]) -> Parameter:
    """Return the parameter of a name, or say which names are near it: the paper's symbol, a part, a slip of a key."""
    by_name = {parameter.name: parameter for parameter in parameters}
    if name in by_name:
        return by_name[name]
    near = [known for known, parameter in by_name.items() if name == parameter.symbol or (name and name in known)]
    near = near or difflib.get_close_matches(name, by_name)
    near = near or [known for known in by_name if difflib.get_close_matches(name, known.split("_"), cutoff=0.8)]
    if near:
        raise OmnibotError(f"no parameter {name!r}; did you mean {' or '.join(near)}?")
    raise OmnibotError(f"no parameter {name!r}; there are: {', '.join(by_name)}")


@dataclass(frozen=True)
class Motor:
    """A brushed motor behind a gear, with an encoder on its shaft (symbols of firmware/ports/stm32f405/motor.h)."""

    resistance_Ohm: float  # R
    torque_constant_Nm_per_A: float  # kt, of the motor's shaft
    gear_ratio: float  # N
    supply_nominal_V: float
    encoder_counts: float  # a turn of the motor's shaft


@dataclass(frozen=True)
class Wheel:
    """Where a wheel stands and drives, in the body frame; angles from its first axis, counter-clockwise."""

    placement_rad: float  # alpha
    distance_m: float  # b, from the centre of mass
    drive_rad: float  # beta: the way the robot is moved when the wheel turns forwards


@dataclass(frozen=True)
class Robot:
    """Geometry, inertia, traction and limits of one robot, in SI units (symbols of the paper in brackets)."""

    tracked_point_offset_m: float  # L: along the body's second axis
    wheels: tuple[Wheel, ...]
    wheel_radius_m: float  # r
    mass_kg: float  # m
    yaw_inertia_kg_m2: float  # Ic
    wheel_inertia_kg_m2: float  # Iw
    normalised_stiffness_N: float  # G0
    friction_limit_N: float  # Dp, of one wheel
    magic_shape: float  # Cy
    magic_curvature: float  # Ey
    torque_limit_Nm: float
    control_period_s: float
    motor: Motor
    parameters: tuple[Parameter, ...]
    file: Path  # that it was read from
    checksum: int  # of the numbers in it, by which firmware and host know that they mean the same robot

    @cached_property
    def wheel_positions(self) -> Array:
        """Where the wheels stand in the body frame, shape (3, 2) in m."""
        return np.array(
            [(w.distance_m * np.cos(w.placement_rad), w.distance_m * np.sin(w.placement_rad)) for w in self.wheels]
        )

    @cached_property
    def drive_directions(self) -> Array:
        """Unit vectors that the wheels drive along in the body frame, shape (3, 2)."""
        return np.array([(np.cos(w.drive_rad), np.sin(w.drive_rad)) for w in self.wheels])

    @property
    def wheel_distance_m(self) -> float:
        """b, of the wheel that stands furthest out."""
        return max(wheel.distance_m for wheel in self.wheels)

    @cached_property
    def Jr(self) -> Array:  # noqa: N802
        """Drive-direction matrix, shape (3, 3): body twist to contact-point speeds, m/s (theory, (K1))."""
        lever = [w.distance_m * np.sin(w.drive_rad - w.placement_rad) for w in self.wheels]
        return np.column_stack([self.drive_directions, lever])

    @cached_property
    def load_shares(self) -> Array:
        """Shares of the weight that the wheels carry at rest, shape (3,): the centre of mass is the body's origin."""
        return np.asarray(np.linalg.solve(np.vstack([np.ones(WHEELS), self.wheel_positions.T]), [1.0, 0.0, 0.0]))

    @cached_property
    def Mo(self) -> Array:  # noqa: N802
        """Body inertia, shape (3,): m, m, Ic."""
        return np.array([self.mass_kg, self.mass_kg, self.yaw_inertia_kg_m2])

    def tracked_point(self, pose: Array) -> Array:
        """Position of p, shape (..., 2) in m, of poses of shape (..., 3): (12)."""
        heading = pose[..., 2]
        offset = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return np.asarray(pose[..., :2] + self.tracked_point_offset_m * offset)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of that name, or say which names there are."""
        return parameter_named(name, self.parameters)


def load_robot(path: Path | None = None) -> Robot:
    """Read a robot file: the one given, else the one that OMNIBOT_ROBOT names, else firmware/robot/omnibot.toml."""
    path = path or Path(os.environ.get(ROBOT_VARIABLE) or ROBOT_FILE)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OmnibotError(f"cannot read the robot file {path}: {error}") from error
    try:
        robot = _robot(path, data)
        _check_geometry(robot)
    except OmnibotError as error:
        raise OmnibotError(f"{path}: {error}") from error
    return robot


def _robot(path: Path, data: Mapping[str, Any]) -> Robot:
    """Make a robot of what its file holds."""

    def value(table: str, key: str, unit: str) -> float:
        return _value(data.get(table), f"[{table}]", key, unit)

    return Robot(
        tracked_point_offset_m=value("geometry", "tracked_point_offset", "m"),
        wheels=_wheels(data.get("wheel")),
        wheel_radius_m=value("geometry", "wheel_radius", "m"),
        mass_kg=value("inertia", "mass", "kg"),
        yaw_inertia_kg_m2=value("inertia", "yaw_inertia", "kg*m^2"),
        wheel_inertia_kg_m2=value("inertia", "wheel_inertia", "kg*m^2"),
        normalised_stiffness_N=value("traction", "normalised_stiffness", "N"),
        friction_limit_N=value("traction", "friction_limit", "N"),
        magic_shape=value("traction", "magic_shape", "1"),
        magic_curvature=value("traction", "magic_curvature", "1"),
        torque_limit_Nm=value("motor", "torque_limit", "N*m"),
        control_period_s=value("timing", "control_period", "s"),
        motor=Motor(
            resistance_Ohm=value("motor", "resistance", "Ohm"),
            torque_constant_Nm_per_A=value("motor", "torque_constant", "N*m/A"),
            gear_ratio=value("motor", "gear_ratio", "1"),
            supply_nominal_V=value("motor", "supply_nominal", "V"),
            encoder_counts=value("motor", "encoder_counts", "1"),
        ),
        parameters=tuple(_parameter(entry) for entry in data.get("parameter", [])),
        file=path,
        checksum=zlib.crc32(json.dumps(_without_reasons(data), sort_keys=True).encode()),
    )


def _value(table: object, where: str, key: str, unit: str) -> float:
    """Return a number of a table of the robot file, whose unit must be the one meant."""
    entry = table.get(key) if isinstance(table, dict) else None
    entry = entry if isinstance(entry, dict) else {}
    number = entry.get("value")
    if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
        raise OmnibotError(f'{where} needs {key} = {{ value = NUMBER, unit = "{unit}", … }}')
    if entry.get("unit") != unit:
        raise OmnibotError(f"{where} {key} is in {entry.get('unit')!r}: it must be in {unit!r}")
    return float(number)


def _wheels(tables: object) -> tuple[Wheel, ...]:
    """Make the wheels of their tables; as many as the wire carries."""
    entries = tables if isinstance(tables, list) else []
    if len(entries) != WHEELS:
        raise OmnibotError(
            f"{len(entries)} [[wheel]] tables: there must be {WHEELS}. Another number needs other frames in place of "
            "WHEEL_SPEED, TORQUE and SLIP (protocol/omnibot.dbc), and a control law that shares out the forces"
        )

    def wheel(number: int, table: object) -> Wheel:
        where = f"[[wheel]] {number}"
        distance_m = _value(table, where, "distance", "m")
        if not distance_m > 0.0:
            raise OmnibotError(f"{where} distance = {distance_m:g} m: it must be above 0")
        placement, drive = (math.radians(_value(table, where, key, "deg")) for key in ("placement", "drive"))
        return Wheel(placement, distance_m, drive)

    return tuple(wheel(number, table) for number, table in enumerate(entries, start=1))


def _check_geometry(robot: Robot) -> None:
    """Refuse wheels that cannot move the robot every way, or that it does not stand on."""
    unit = np.array([1.0, 1.0, robot.wheel_distance_m])
    grip = float(np.linalg.svd(robot.Jr / unit, compute_uv=False).min())
    if not grip >= GRIP_MIN:
        raise OmnibotError(
            "the wheels cannot drive the robot every way: the lines that they drive along nearly meet in one point, or "
            f"are parallel (least singular value of Jr {grip:.2g}: must be {GRIP_MIN:g} or more; 1.2 at 120 degrees)"
        )
    corners = robot.wheel_positions
    if abs(np.linalg.det(np.diff(corners, axis=0))) < 1e-9 or not robot.load_shares.min() > 0.0:
        raise OmnibotError(
            "the robot would tip over: its centre of mass, the origin, must lie between the three wheels"
        )


def _without_reasons(data: object) -> object:
    """Return what a file holds without what changes no number: symbols and sources."""
    if isinstance(data, dict):
        return {key: _without_reasons(part) for key, part in data.items() if key not in ("symbol", "source")}
    return [_without_reasons(part) for part in data] if isinstance(data, list) else data


def _parameter(entry: dict[str, object]) -> Parameter:
    """Make a parameter of its table in the robot file."""

    def number(key: str) -> float:
        return float(str(entry[key]))

    return Parameter(
        index=int(number("index")),
        name=str(entry["name"]),
        symbol=str(entry["symbol"]),
        integer=entry["type"] == "integer",
        unit=str(entry["unit"]),
        minimum=number("minimum"),
        maximum=number("maximum"),
        default=number("default"),
        source=str(entry["source"]),
        choices=tuple(str(choice) for choice in cast(list[object], entry.get("choices", []))),
    )
