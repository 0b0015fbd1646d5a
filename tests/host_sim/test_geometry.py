"""Robots whose wheels are not three at 120 degrees, against the literal matrices and in closed loop."""

import ctypes
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import test_manifold_literal as literal
import uneven_robot
from numpy.typing import NDArray

from host_sim.codec import Codec
from host_sim.drive import Status, start_state
from host_sim.inproc import LIBRARY_FILE, InprocBus
from host_sim.link import Link, RefusedError
from host_sim.loop import drive_without_bus
from host_sim.metrics import tracking_error
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import ROOT, Robot, load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario

Array = NDArray[Any]

HOST = ROOT / "build" / "host"
CONTROL = ("control", "floor", "kinematics", "manifold", "tracking", "trajectory", "trigonometry")
DEFAULT = load_robot()


def random_wheels(seed: int) -> list[tuple[float, float, float]]:
    """Three wheels anyhow around the robot, each driving within 25 degrees of across its spoke, either way round."""
    random = np.random.default_rng(seed)
    wheels = []
    for spoke in random.uniform(0.0, 360.0) + np.array([0.0, 120.0, 240.0]) + random.uniform(-25.0, 25.0, 3):
        way = 90.0 * random.choice([-1.0, 1.0])
        wheels.append(
            (float(spoke), float(random.uniform(0.08, 0.25)), float(spoke + way + random.uniform(-25.0, 25.0)))
        )
    return wheels


GEOMETRIES = {"uneven": uneven_robot.UNEVEN, **{f"random {seed}": random_wheels(seed) for seed in (1, 2, 3)}}


def generate(robot: Robot) -> Path:
    """Generate a robot's constants beside its file."""
    done = uneven_robot.generate(robot.file)
    assert done.returncode == 0, done.stderr
    return robot.file.parent


@pytest.fixture(scope="module", params=GEOMETRIES)
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    wheels = GEOMETRIES[request.param]
    return load_robot(uneven_robot.write(tmp_path_factory.mktemp("geometry") / "robot.toml", wheels))


@pytest.fixture(scope="module")
def firmware(robot: Robot) -> literal.Firmware:
    """The control layer, generated and compiled for a robot."""
    folder = generate(robot)
    control = ROOT / "firmware" / "control"
    sources = [*(str(control / f"{name}.c") for name in CONTROL), str(folder / "robot_constants.c")]
    flags = ["-std=c11", "-O1", "-fPIC", "-shared", "-ffp-contract=off", f"-I{control}", f"-I{folder}"]
    subprocess.run(["cc", *flags, *sources, "-lm", "-o", str(folder / "control.so")], check=True)
    return literal.Firmware(folder / "control.so")


# ----------------------------------------------------------------------------------------------------- literal matrices


def test_matrices_of_three_wheels_at_120_degrees_are_the_papers() -> None:
    matrix_a, matrix_s = uneven_robot.matrices(DEFAULT)
    for theta in (0.0, 0.7, -2.9):
        np.testing.assert_allclose(matrix_a(theta), literal.matrix_a(theta), rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(matrix_s(theta), literal.matrix_s(theta), rtol=1e-14, atol=1e-13)


@pytest.fixture
def states(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> list[literal.State]:
    """Random states, the literal model being that of the robot from here on."""
    matrix_a, matrix_s = uneven_robot.matrices(robot)
    monkeypatch.setattr(literal, "matrix_a", matrix_a)
    monkeypatch.setattr(literal, "matrix_s", matrix_s)
    monkeypatch.setattr(literal, "STATES", 40)
    return literal.random_states()


@pytest.mark.parametrize(
    "check",
    [
        literal.test_u0_of_the_firmware_is_that_of_the_paper,
        literal.test_h0_of_the_firmware_is_that_of_the_paper,
        literal.test_h0_rate_of_the_firmware_is_that_along_the_closed_loop,
        literal.test_h1_and_u1_of_the_firmware_are_those_of_the_paper,
    ],
)
def test_manifold_is_that_of_the_literal_model(
    firmware: literal.Firmware, states: list[literal.State], check: Callable[..., None]
) -> None:
    check(firmware, states)


@pytest.mark.usefixtures("states")
@pytest.mark.parametrize("order", [*literal.ORDERS, literal.EXACT, literal.OBSERVER])
def test_whole_step_is_that_of_the_literal_model(firmware: literal.Firmware, order: int) -> None:
    literal.test_whole_step_without_bounds_is_the_resummed_form(firmware, order)


@pytest.mark.parametrize("output", [0, 1])
def test_series_is_held_back_by_its_largest_eigenvalue(robot: Robot, firmware: literal.Firmware, output: int) -> None:
    """The ratio of the fixed point (C5) at rest, with gains that are not alike: -c Jr^-1 Jr^-T Mo d(eta)/d(nu)."""
    jr, gains = uneven_robot.drawing(robot), np.array([23.0, 23.0, 61.0])
    outputs = 3 - output  # without the heading or with it
    delta = literal.delta_matrix(0.0)[:outputs]
    slope = np.linalg.pinv(delta) @ np.diag(gains[:outputs]) @ delta
    expected = float(np.abs(np.linalg.eigvals(np.linalg.inv(jr.T @ jr) @ np.diag(robot.Mo) @ slope)).max())

    law = literal.Law(output, literal.to_c(literal.STIFFNESS_GAIN), literal.to_c(gains))
    params = literal.ControlParams(
        robot=firmware.robot, floor=literal.Floor(None, True, 0.01, 5.0), law=law, series_ratio_max=0.45
    )
    firmware._prepare(ctypes.byref(params))

    held_back = 0.45 / params.compliance_max_mps_per_N
    assert expected * (1.0 - 1e-5) < held_back < 1.02 * expected


def test_constants_of_three_wheels_at_120_degrees_in_another_order_are_general(tmp_path: Path) -> None:
    turned = load_robot(
        uneven_robot.write(tmp_path / "turned.toml", [(0, 0.12, 90), (120, 0.12, 210), (240, 0.12, 330)])
    )

    generate(turned)

    assert "OMNIBOT_WHEELS_ALIKE 0 " in (tmp_path / "wheel_layout.h").read_text(encoding="utf-8")
    assert "OMNIBOT_WHEELS_ALIKE 1 " in (HOST / "generated" / "wheel_layout.h").read_text(encoding="utf-8")


# ---------------------------------------------------------------------------------------------------------- closed loop

CORNER = PathRequest("rhombus", 1.0, start_before_corner_s=0.6, duration_s=1.6)


class Built(NamedTuple):
    """A robot and the firmware library that was built for it."""

    robot: Robot
    library: Path


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The firmware as PORTING.md builds it for a file of one's own."""
    folder = tmp_path_factory.mktemp("uneven")
    file = uneven_robot.write(folder / "uneven.toml")
    for command in (
        ["cmake", "--preset", "host", "-B", str(folder), f"-DOMNIBOT_ROBOT={file}"],
        ["cmake", "--build", str(folder), "--target", "omnibot"],
    ):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return Built(load_robot(file), folder / "libomnibot.so")


def largest_error(built: Built, order: str) -> float:
    """Largest tracking error around the first corner, m."""
    robot, scenario, trajectory = built.robot, Scenario(CORNER, order=order), plan(CORNER)
    plant = Plant(robot, scenario.traction_of(robot))
    plant.reset(*start_state(robot, trajectory))
    with InprocBus(str(built.library)) as bus:
        link = Link(bus, Codec())
        prepare(link, robot, scenario, trajectory)
        driven = drive_without_bus(link, plant, robot, trajectory)
    assert driven.status is Status.COMPLETED
    return float(tracking_error(driven.trace).max())


def series_ratio(robot: Robot) -> float:
    """What (C9) is proportional to: the largest eigenvalue of Jr^-1 Jr^-T Mo."""
    jr = uneven_robot.drawing(robot)
    return float(np.linalg.eigvals(np.linalg.inv(jr.T @ jr) @ np.diag(robot.Mo)).real.max())


@pytest.mark.parametrize("order", ["0", "1", "2", "observer"])
def test_uneven_robot_tracks_as_well_as_the_default_one(uneven: Built, order: str) -> None:
    """To order N the error goes with the ratio of the series to the power N + 1; the observer has no series."""
    error = largest_error(uneven, order)
    default = largest_error(Built(DEFAULT, LIBRARY_FILE), order)

    harder = series_ratio(uneven.robot) / series_ratio(DEFAULT)
    assert harder == pytest.approx(1.23, abs=0.01)
    power = 0 if order == "observer" else int(order) + 1
    assert 0.8 < error / default < 1.2 * harder**power


# ------------------------------------------------------------------------------------------- one robot, not another


def test_firmware_of_another_robot_is_refused_by_name(uneven: Built) -> None:
    with InprocBus(str(uneven.library)) as bus:
        link = Link(bus, Codec())
        with pytest.raises(RefusedError, match=r"node 0 is built for another robot .* than .*omnibot\.toml.* --robot"):
            prepare(link, DEFAULT, Scenario(CORNER), plan(CORNER))


def test_run_of_another_robot_file_tells_how_to_build_for_it(uneven: Built, tmp_path: Path) -> None:
    wrong = omnibot("run", "--robot", uneven.robot.file, "--duration", "1", "--out", tmp_path / "wrong")
    assert wrong.returncode == 1
    assert f"cmake --preset host -DOMNIBOT_ROBOT={uneven.robot.file}" in wrong.stderr
    assert wrong.stderr.count("\n") == 1

    right = omnibot(
        "run",
        "--robot",
        uneven.robot.file,
        "-i",
        "omnibot",
        "-c",
        uneven.library,
        "--duration",
        "1",
        "--out",
        tmp_path / "right",
    )
    assert right.returncode == 0, right.stderr
    assert right.stdout.startswith("completed")


def omnibot(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from host_sim.cli import main; main()", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
