"""The robot in numbers, read from ``firmware/robot/omnibot.toml``."""

import difflib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from host_sim.errors import OmnibotError

ROOT = Path(__file__).resolve().parents[1]
ROBOT_FILE = ROOT / "firmware" / "robot" / "omnibot.toml"

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
class Robot:
    """Geometry, inertia, traction and limits of one robot, in SI units (symbols of the paper in brackets)."""

    tracked_point_offset_m: float  # L: along the body's second axis
    wheel_distance_m: float  # b
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

    @cached_property
    def Jr(self) -> Array:  # noqa: N802
        """Drive-direction matrix, shape (3, 3): body twist to contact-point speeds, m/s (theory, 'Kinematics')."""
        b, h = self.wheel_distance_m, np.sqrt(3.0) / 2.0
        return np.array([[-h, 0.5, b], [0.0, -1.0, b], [h, 0.5, b]])

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


def load_robot(path: Path = ROBOT_FILE) -> Robot:
    """Read a robot file."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise OmnibotError(f"cannot read the robot file {path}: {error}") from error

    def value(table: str, key: str) -> float:
        try:
            return float(data[table][key]["value"])
        except (KeyError, TypeError, ValueError) as error:
            raise OmnibotError(f"{path}: [{table}] needs {key} = {{ value = NUMBER, … }}") from error

    return Robot(
        tracked_point_offset_m=value("geometry", "tracked_point_offset"),
        wheel_distance_m=value("geometry", "wheel_distance"),
        wheel_radius_m=value("geometry", "wheel_radius"),
        mass_kg=value("inertia", "mass"),
        yaw_inertia_kg_m2=value("inertia", "yaw_inertia"),
        wheel_inertia_kg_m2=value("inertia", "wheel_inertia"),
        normalised_stiffness_N=value("traction", "normalised_stiffness"),
        friction_limit_N=value("traction", "friction_limit"),
        magic_shape=value("traction", "magic_shape"),
        magic_curvature=value("traction", "magic_curvature"),
        torque_limit_Nm=value("motor", "torque_limit"),
        control_period_s=value("timing", "control_period"),
        motor=Motor(
            resistance_Ohm=value("motor", "resistance"),
            torque_constant_Nm_per_A=value("motor", "torque_constant"),
            gear_ratio=value("motor", "gear_ratio"),
            supply_nominal_V=value("motor", "supply_nominal"),
            encoder_counts=value("motor", "encoder_counts"),
        ),
        parameters=tuple(_parameter(entry) for entry in data.get("parameter", [])),
    )


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
