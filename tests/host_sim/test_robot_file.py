"""The robot file: what it may hold, and what plant and pages make of its wheels."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uneven_robot
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from host_sim.errors import OmnibotError
from host_sim.planner import PathRequest
from host_sim.plant import Plant
from host_sim.report.path import outline
from host_sim.robot import ROBOT_FILE, load_robot
from host_sim.scenario import Scenario
from host_sim.traction import Traction

Array = NDArray[Any]

DEFAULT = load_robot()
TEXT = ROBOT_FILE.read_text(encoding="utf-8")


def test_checksum_is_that_of_the_numbers_alone(tmp_path: Path) -> None:
    def checksum(text: str) -> int:
        (tmp_path / "robot.toml").write_text(text, encoding="utf-8")
        return load_robot(tmp_path / "robot.toml").checksum

    assert checksum(TEXT) == DEFAULT.checksum
    assert (
        checksum("# a comment\n" + TEXT.replace('source = "paper, section 4.1"', 'source = "measured"'))
        == DEFAULT.checksum
    )
    assert checksum(TEXT.replace("value = 1.903", "value = 1.904")) != DEFAULT.checksum
    assert checksum(TEXT.replace("value = 270.0", "value = 271.0")) != DEFAULT.checksum
    assert checksum(TEXT.replace("default = 23.0", "default = 24.0", 1)) != DEFAULT.checksum


def test_environment_names_the_robot_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIBOT_ROBOT", str(uneven_robot.write(tmp_path / "mine.toml")))
    assert load_robot().wheel_distance_m == 0.16
    assert load_robot(ROBOT_FILE).wheel_distance_m == 0.12


def wheels_at(*placements: float) -> list[tuple[float, float, float]]:
    return [(placement, 0.12, placement + 90.0) for placement in placements]


@pytest.mark.parametrize(
    ("wheels", "says"),
    [
        (wheels_at(45, 135, 225, 315), r"4 \[\[wheel\]\] tables: there must be 3\. .*WHEEL_SPEED"),
        (wheels_at(60, 180), r"2 \[\[wheel\]\] tables: there must be 3"),
        ([(60, 0.12, 60), (180, 0.12, 180), (300, 0.12, 300)], r"every way: .* \(least singular value of Jr 0: "),
        ([(60, 0.12, 90), (180, 0.12, 90), (300, 0.12, 90)], r"every way"),
        (wheels_at(10, 60, 110), r"tip over: its centre of mass, the origin, must lie between the three wheels"),
        (wheels_at(0, 90, 180), r"tip over"),  # on the line between two of them
        ([(60, -0.12, 150), *wheels_at(180, 300)], r"\[\[wheel\]\] 1 distance = -0\.12 m: it must be above 0"),
    ],
)
def test_wheels_that_cannot_be_driven_are_refused(
    tmp_path: Path, wheels: list[tuple[float, float, float]], says: str
) -> None:
    file = uneven_robot.write(tmp_path / "robot.toml", wheels)
    with pytest.raises(OmnibotError, match=rf"^{re.escape(str(file))}: .*{says}"):
        load_robot(file)
    generated = uneven_robot.generate(file)
    assert generated.returncode == 1
    assert generated.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            'value = 0.0349, unit = "m"',
            'value = 34.9, unit = "mm"',
            r"\[geometry\] wheel_radius is in 'mm': it must be in 'm'",
        ),
        ("value = 1.903", 'value = "heavy"', r"\[inertia\] needs mass = \{ value = NUMBER, unit = \"kg\", … \}"),
        ("value = 1.903", "value = nan", r"\[inertia\] needs mass"),
        (
            "placement = { symbol",
            "place = { symbol",
            r"\[\[wheel\]\] 1 needs placement = \{ value = NUMBER, unit = \"deg\"",
        ),
        ("[[wheel]]", "[[whee]]", r"0 \[\[wheel\]\] tables"),
    ],
)
def test_numbers_that_are_missing_or_in_another_unit_are_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    file = tmp_path / "robot.toml"
    assert old in TEXT
    file.write_text(TEXT.replace(old, new), encoding="utf-8")
    with pytest.raises(OmnibotError, match=says):
        load_robot(file)


def test_loads_are_those_of_a_table_on_three_legs(tmp_path: Path) -> None:
    """No wheel, no torque: forces at the hubs balance the weight and its moments about both axes."""
    robot = load_robot(uneven_robot.write(tmp_path / "robot.toml"))
    hubs = np.array([np.array([np.cos(w.placement_rad), np.sin(w.placement_rad)]) * w.distance_m for w in robot.wheels])
    assert robot.load_shares.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(robot.load_shares @ hubs, 0.0, atol=1e-15)
    np.testing.assert_allclose(DEFAULT.load_shares, 1.0 / 3.0)


def test_report_draws_the_wheels_where_they_stand(tmp_path: Path) -> None:
    robot = load_robot(uneven_robot.write(tmp_path / "robot.toml"))
    ends = outline(robot)["wheels"].reshape(3, 3, 2)[:, :2]  # and a gap

    for (one, other), wheel in zip(ends, robot.wheels, strict=True):
        spoke = np.array([np.cos(wheel.placement_rad), np.sin(wheel.placement_rad)])
        drive = np.array([np.cos(wheel.drive_rad), np.sin(wheel.drive_rad)])
        np.testing.assert_allclose((one + other) / 2.0, wheel.distance_m * spoke, atol=1e-15)
        np.testing.assert_allclose(other - one, 2.0 * robot.wheel_radius_m * drive, atol=1e-15)


def test_plant_may_have_its_wheels_further_out_than_the_firmware_knows() -> None:
    actual = Scenario(PathRequest("line", 0.5), plant={"wheel_distance_m": 0.15}).plant_robot(DEFAULT)
    assert [wheel.distance_m for wheel in actual.wheels] == pytest.approx([0.15] * 3)
    assert actual.mass_kg == DEFAULT.mass_kg


def test_plant_of_the_uneven_robot_is_the_literal_model(tmp_path: Path) -> None:
    """M q'' = B u + A lambda by scipy, from rest and through a turn, against the plant's own coordinates and method."""
    robot = load_robot(uneven_robot.write(tmp_path / "robot.toml"))
    matrix_a, matrix_s = uneven_robot.matrices(robot)
    traction = Traction.of(robot, "magic", 0.01)
    mass = np.diag([*robot.Mo, *3 * [robot.wheel_inertia_kg_m2]])
    torque = np.array([0.05, -0.03, 0.02])

    def rates(_: float, y: Array) -> Array:
        a, rate = matrix_a(y[2]), y[6:]
        twist = matrix_s(y[2])[:3].T @ rate[:3]
        force = -traction.force(a.T @ rate / (float(np.linalg.norm(twist)) + 1e-3))
        return np.concatenate([rate, np.linalg.solve(mass, np.concatenate([np.zeros(3), torque]) + a @ force)])

    twist = np.array([0.4, -0.3, 1.2])
    start = np.concatenate([[0.1, 0.2, 0.7, 0.0, 0.0, 0.0], matrix_s(0.7) @ twist])
    reference = solve_ivp(rates, (0.0, 0.05), start, method="Radau", rtol=1e-10, atol=1e-12).y[:, -1]
    plant = Plant(robot, traction)
    plant.reset([0.1, 0.2, 0.7], twist)
    for _ in range(50):
        plant.step(torque, 1e-3)

    np.testing.assert_allclose(plant.pose, reference[:3], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(plant.wheel_speed, reference[9:], rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(matrix_s(plant.pose[2])[:3] @ plant.body_twist, reference[6:9], rtol=0.0, atol=1e-6)
