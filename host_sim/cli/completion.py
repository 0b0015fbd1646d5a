"""What the shell completes where TAB is pressed: the values that an option knows."""

from collections.abc import Callable, Iterator
from pathlib import Path

import can
from serial.tools import list_ports

from host_sim.limits import LIMIT_NAMES
from host_sim.link import is_can_interface
from host_sim.planner import NAMED_PATHS
from host_sim.robot import Parameter, load_robot
from host_sim.scenario import plant_numbers

Complete = Callable[[str], list[str]]


def one_of(*values: str) -> Complete:
    """Complete one of these."""

    def complete(incomplete: str) -> list[str]:
        return [value for value in values if value.startswith(incomplete)]

    return complete


def some_of(*values: str) -> Complete:
    """Complete the last of a comma-separated list of these."""

    def complete(incomplete: str) -> list[str]:
        *before, last = incomplete.split(",")
        left = (value for value in values if value not in before)
        return [",".join([*before, value]) for value in left if value.startswith(last)]

    return complete


def path(incomplete: str) -> list[str]:
    """Complete a path that we know, or a file of waypoints."""
    folder, slash, begun = incomplete.rpartition("/")
    places = [place for place in Path(folder + slash).glob(f"{begun}*") if not place.name.startswith(".")]
    files = [folder + slash + place.name for place in places if place.is_dir() or place.suffix in (".csv", ".toml")]
    return [*one_of(*NAMED_PATHS)(incomplete), *sorted(files)]


def parameter(incomplete: str) -> list[str]:
    """Complete the name of a firmware parameter."""
    return one_of(*(known.name for known in load_robot().parameters))(incomplete)


def setting(incomplete: str) -> list[str]:
    """Complete NAME=VALUE of a firmware parameter: its choices, or its default to be edited."""
    return one_of(*(text for known in load_robot().parameters for text in _texts(known)))(incomplete)


def _texts(parameter: Parameter) -> Iterator[str]:
    if parameter.choices:
        yield from (f"{parameter.name}={choice}" for choice in parameter.choices)
    else:
        yield f"{parameter.name}={parameter.default:g}"


def choice_of(name: str) -> Complete:
    """Complete a choice of a firmware parameter."""

    def complete(incomplete: str) -> list[str]:
        return one_of(*load_robot().parameter(name).choices)(incomplete)

    return complete


def plant(incomplete: str) -> list[str]:
    """Complete NAME=NUMBER of the robot, with the number that it has."""
    robot = load_robot()
    return one_of(*(f"{name}={getattr(robot, name):g}" for name in plant_numbers()))(incomplete)


def limit(incomplete: str) -> list[str]:
    """Complete NAME= of a limit."""
    return one_of(*(f"{name}=" for name in LIMIT_NAMES))(incomplete)


def _can_interfaces() -> list[str]:
    return [entry.name for entry in sorted(Path("/sys/class/net").glob("*")) if is_can_interface(entry.name)]


def bus(incomplete: str) -> list[str]:
    """Complete a bus: of ours, or of the machine."""
    return one_of("inproc", "pil", *_can_interfaces())(incomplete)


def interface(incomplete: str) -> list[str]:
    """Complete one of python-can's interfaces."""
    return one_of(*sorted(can.VALID_INTERFACES))(incomplete)


def channel(incomplete: str) -> list[str]:
    """Complete a CAN interface or a serial port that is there."""
    return one_of(*_can_interfaces(), *(port.device for port in list_ports.comports()))(incomplete)


node = one_of(*map(str, range(16)))
