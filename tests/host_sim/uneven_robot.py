"""Robot files of other geometries, and their literal matrices. uneven_robot.py OUT.toml writes the uneven one.

Its spokes stand 110, 130 and 120 degrees apart; wheel 3 is further out than the others and drives 10 degrees off the
square to its spoke. tests/unit/test_uneven.c has the same numbers by hand.
"""

import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from host_sim.robot import ROBOT_FILE, ROOT, Robot

Array = NDArray[Any]

# Of each wheel: placement in degrees, distance in m, drive direction in degrees.
UNEVEN = ((60.0, 0.12, 150.0), (170.0, 0.12, 260.0), (300.0, 0.16, 40.0))


def with_wheels(text: str, wheels: Sequence[tuple[float, float, float]]) -> str:
    """Return the text of a robot file with other [[wheel]] tables."""
    first, *_, rest = re.split(r"^\[\[wheel\]\]\n(?:\w.*\n)+\n?", text, flags=re.MULTILINE)
    tables = (
        f'[[wheel]]\nplacement = {{ value = {placement!r}, unit = "deg" }}\n'
        f'distance = {{ value = {distance!r}, unit = "m" }}\n'
        f'drive = {{ value = {drive!r}, unit = "deg" }}\n'
        for placement, distance, drive in wheels
    )
    return first + "\n".join(tables) + "\n" + rest


def write(path: Path, wheels: Sequence[tuple[float, float, float]] = UNEVEN) -> Path:
    """Write a robot file with other wheels."""
    path.write_text(with_wheels(ROBOT_FILE.read_text(encoding="utf-8"), wheels), encoding="utf-8")
    return path


def generate(file: Path) -> subprocess.CompletedProcess[str]:
    """Generate the C constants of a robot file beside it."""
    command = [sys.executable, str(ROOT / "tools" / "generate_constants.py"), str(file), str(file.parent)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def drawing(robot: Robot) -> Array:
    """Jr from where the wheels stand: the speed of a hub along its drive direction, by rigid-body motion."""
    rows = []
    for wheel in robot.wheels:
        hub = wheel.distance_m * np.array([np.cos(wheel.placement_rad), np.sin(wheel.placement_rad), 0.0])
        drive = np.array([np.cos(wheel.drive_rad), np.sin(wheel.drive_rad), 0.0])
        turning = np.cross([0.0, 0.0, 1.0], hub)
        rows.append([drive[0], drive[1], turning @ drive])
    return np.array(rows)


def matrices(robot: Robot) -> tuple[Callable[[complex], Array], Callable[[complex], Array]]:
    """A and S of (1) and (2) for any wheels."""
    jr, radius = drawing(robot), robot.wheel_radius_m

    def turned(theta: complex) -> Array:
        return np.array([[np.cos(theta), -np.sin(theta), 0.0], [np.sin(theta), np.cos(theta), 0.0], [0.0, 0.0, 1.0]])

    def matrix_a(theta: complex) -> Array:
        return np.vstack([turned(theta) @ jr.T, -radius * np.eye(3)])

    def matrix_s(theta: complex) -> Array:
        return np.vstack([turned(theta), jr / radius])

    return matrix_a, matrix_s


if __name__ == "__main__":
    write(Path(sys.argv[1]))
