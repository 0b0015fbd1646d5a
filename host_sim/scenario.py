"""What is run: the path, the floor, and what the firmware is told of them."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from host_sim.errors import OmnibotError
from host_sim.planner import PathRequest
from host_sim.robot import Robot
from host_sim.sensors import IDEAL_SENSORS, Sensors
from host_sim.traction import Traction, TractionKind

# What plant and firmware share, unless the scenario tells the firmware otherwise.
SHARED_PARAMETERS = ("order", "epsilon", "output", "traction", "delta_m_per_s", "speed_length_m")


# What paces a run: the simulator's ticks, or the firmware's own timer.
PACES = ("lockstep", "realtime")


def plant_numbers() -> list[str]:
    """Return the names of the robot's numbers that a plant may have otherwise than its firmware believes."""
    numbers = {item.name for item in fields(Robot) if item.type in (float, "float")} - {"control_period_s"}
    return sorted(numbers | {"wheel_distance_m"})


@dataclass(frozen=True)
class Scenario:
    """What is run: everything that the result depends on."""

    path: PathRequest
    epsilon: float = 0.01
    order: str = "observer"
    output: str = "posture"
    traction: TractionKind = "magic"
    delta_m_per_s: float = 1e-3
    speed_length_m: float = 1.0
    parameters: Mapping[str, str] = field(default_factory=dict)  # of the firmware, over the ones above
    keep_parameters: bool = False  # the others stay as the robot holds them; else they are set to their defaults
    plant: Mapping[str, float] = field(default_factory=dict)  # numbers of the robot that the firmware does not know of
    sensors: Sensors = IDEAL_SENSORS
    time: str = "lockstep"  # one of PACES
    seed: int = 0  # of the simulator's noise; there is none yet

    def __post_init__(self) -> None:
        """Refuse a pace that there is not."""
        if self.time not in PACES:
            raise OmnibotError(f"time {self.time!r}: must be {' or '.join(PACES)}")

    def firmware_parameters(self, robot: Robot) -> dict[str, float]:
        """Return what the firmware is told, each value checked against its range."""
        shared = {name: str(getattr(self, name)) for name in SHARED_PARAMETERS}
        return {name: robot.parameter(name).parse(text) for name, text in {**shared, **self.parameters}.items()}

    def plant_robot(self, robot: Robot) -> Robot:
        """Return the robot as it is, where that differs from what the firmware believes."""
        numbers = plant_numbers()
        for name, value in self.plant.items():
            if name not in numbers:
                raise OmnibotError(f"the plant has no {name!r}; there are: {', '.join(numbers)}")
            if not 0.0 < value < math.inf:
                raise OmnibotError(f"{name} = {value:g} of the plant must be above 0")
        others = dict(self.plant)
        farther = others.pop("wheel_distance_m", robot.wheel_distance_m) / robot.wheel_distance_m
        wheels = tuple(replace(wheel, distance_m=farther * wheel.distance_m) for wheel in robot.wheels)
        return replace(robot, wheels=wheels, **others)  # type: ignore[arg-type]  # the names were checked

    def traction_of(self, robot: Robot) -> Traction:
        """Return the floor; a slipping one, since a firmware at the wheels' end of a rigid one has nothing to do."""
        if not 0.0 < self.epsilon <= 1.0:
            raise OmnibotError(f"epsilon = {self.epsilon:g} 1/N must be above 0 and at most 1")
        return Traction.of(robot, self.traction, self.epsilon)

    def as_dict(self) -> dict[str, Any]:
        """Return all inputs, defaults written out, as plain values."""
        inputs = asdict(self)
        return {**inputs.pop("path"), **inputs}
