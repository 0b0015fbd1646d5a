"""Closed loop over the in-process bus: the figures that the theory promises, and what a user does wrong."""

import json
import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.drive import Status, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.link import Link
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.run import BusLog, prepare
from host_sim.scenario import Scenario
from host_sim.trace import Trace, compare

RHOMBUS = ["--path", "rhombus", "--corner", "rounded", "--corner-accel", "2", "--start-before-corner", "2"]
SHORT = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "1.2"]


def run(out: Path, *options: str) -> dict[str, Any]:
    """Run ``omnibot run`` and return its result; an error of the run is raised."""
    outcome = CliRunner().invoke(app, ["run", "--out", str(out), *options])
    if outcome.exception is not None:
        raise outcome.exception
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    return result


def max_error_m(out: Path, *options: str) -> float:
    """Return the largest tracking error of a run that completed."""
    result = run(out, *RHOMBUS, "--duration", "4", *options)
    assert result["status"] == "completed"
    return float(result["tracking"]["max_error_m"])


# ---- what the theory promises (theory, 'What a correct closed loop does'), each within 10 % of its prototype


@pytest.mark.parametrize(
    ("traction", "order0_m", "order1_m"), [("linear", 2.05e-3, 2.1e-4), ("magic", 2.16e-3, 3.3e-4)]
)
def test_order_1_corrects_what_order_0_leaves(tmp_path: Path, traction: str, order0_m: float, order1_m: float) -> None:
    order0 = max_error_m(tmp_path / "0", "--speed", "0.5", "--traction", traction, "--order", "0")
    order1 = max_error_m(tmp_path / "1", "--speed", "0.5", "--traction", traction, "--order", "1")
    assert order0 == pytest.approx(order0_m, rel=0.1)
    assert order1 == pytest.approx(order1_m, rel=0.1)
    assert order0 > 5.0 * order1


@pytest.fixture(scope="module")
def errors_m(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., float]:
    """Return the largest tracking error of a run, remembered: several tests compare with the same ones."""

    @cache
    def of(traction: str, speed: str, epsilon: str, order: str) -> float:
        options = ("--traction", traction, "--speed", speed, "--epsilon", epsilon, "--order", order)
        return max_error_m(tmp_path_factory.mktemp("run"), *options)

    return of


@pytest.mark.parametrize(
    ("traction", "speed", "epsilon", "order", "times"),
    [
        ("linear", "0.5", "0.01", "1", 8.0),
        ("linear", "0.5", "0.01", "2", 25.0),
        ("magic", "1", "0.01", "3", 12.0),
        ("magic", "1", "0.01", "exact", 12.0),
        ("magic", "1", "0.01", "observer", 40.0),
        ("magic", "1", "0.05", "observer", 20.0),
        ("magic", "1", "0.1", "observer", 10.0),
    ],
)
def test_error_falls_below_that_of_order_0(
    errors_m: Callable[..., float], traction: str, speed: str, epsilon: str, order: str, times: float
) -> None:
    assert errors_m(traction, speed, epsilon, "0") >= times * errors_m(traction, speed, epsilon, order)


@pytest.mark.parametrize("traction", ["linear", "magic"])
@pytest.mark.parametrize("speed", ["0.5", "1"])
def test_higher_order_is_never_worse(errors_m: Callable[..., float], traction: str, speed: str) -> None:
    errors = [errors_m(traction, speed, "0.01", order) for order in ("0", "1", "2", "3", "exact")]
    for lower, higher in pairwise(errors):
        assert higher <= 1.02 * lower


@pytest.mark.parametrize(
    ("speed", "table1_m"), [(0.0234, 5.564e-4), (0.0468, 1.44e-2), (0.0702, 4.66e-2), (0.0936, 1.423e-1)]
)
def test_path_deviation_is_far_below_the_papers_table_1(tmp_path: Path, speed: float, table1_m: float) -> None:
    result = run(tmp_path, *RHOMBUS, "--duration", "4", "--epsilon", "0.01", "--order", "1", "--speed", str(speed))
    assert result["tracking"]["max_path_deviation_m"] < table1_m / 8.0


def test_whole_lap_starts_and_ends_at_rest(tmp_path: Path) -> None:
    result = run(tmp_path, "--speed", "1.0")
    trace = Trace.load(tmp_path)
    assert result["tracking"]["max_error_m"] < 5e-3
    assert abs(trace.body_twist[0]).max() == 0.0
    assert abs(trace.body_twist[-1]).max() < 5e-3  # what the slower pole leaves of the ramp


def test_point_output_tracks_the_point_and_leaves_the_heading(tmp_path: Path) -> None:
    corner = [*RHOMBUS, "--duration", "4", "--speed", "0.5"]
    posture = run(tmp_path / "posture", *corner, "--output", "posture")["tracking"]
    point = run(tmp_path / "point", *corner, "--output", "point")["tracking"]
    assert point["max_error_m"] < 1.2 * posture["max_error_m"]
    assert posture["max_heading_error_rad"] < 1e-3
    assert point["max_heading_error_rad"] > 5e-3


# ---- determinism


def test_same_run_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    run(tmp_path / "a", *SHORT)
    run(tmp_path / "b", *SHORT)
    assert compare(Trace.load(tmp_path / "a"), Trace.load(tmp_path / "b")) == []
    assert (tmp_path / "a" / "trace.npz").read_bytes() == (tmp_path / "b" / "trace.npz").read_bytes()


def test_compare_verb_tells_equal_from_different(tmp_path: Path) -> None:
    run(tmp_path / "a", *SHORT)
    run(tmp_path / "b", *SHORT, "--order", "0")
    runner = CliRunner()
    same = runner.invoke(app, ["compare", str(tmp_path / "a"), str(tmp_path / "a")])
    assert same.exit_code == 0
    assert "identical" in same.output
    different = runner.invoke(app, ["compare", str(tmp_path / "a"), str(tmp_path / "b")])
    assert different.exit_code != 0
    assert "torque" in different.output


# ---- what is written


def test_result_holds_every_input_and_figure(tmp_path: Path) -> None:
    result = run(tmp_path, *SHORT, "--set", "position_damping_per_s=30")
    scenario = result["scenario"]
    assert scenario["delta_m_per_s"] == 1e-3
    assert scenario["speed_length_m"] == 1.0
    assert scenario["parameters"] == {"position_damping_per_s": "30"}
    assert result["timing"]["steps"] == 1201
    assert set(result["timing"]["step_time_us"]) == {"mean", "p99", "max"}
    assert result["bus"]["frames"] > 5 * 1201
    assert 0.5 < result["bus"]["load_fraction_at_1Mbps"] < 0.7
    assert result["bus"]["dropped"] == 0
    assert {"report.html", "result.json", "trace.npz", "bus.log"} <= {file.name for file in tmp_path.iterdir()}


def test_setting_by_name_is_that_of_the_option(tmp_path: Path) -> None:
    run(tmp_path / "a", *SHORT, "--set", "order=exact", "--set", "output=point")
    run(tmp_path / "b", *SHORT, "--order", "exact", "--output", "point")
    assert compare(Trace.load(tmp_path / "a"), Trace.load(tmp_path / "b")) == []


def test_changed_gain_changes_the_run(tmp_path: Path) -> None:
    run(tmp_path / "a", *SHORT)
    run(tmp_path / "b", *SHORT, "--set", "position_damping_per_s=30")
    assert compare(Trace.load(tmp_path / "a"), Trace.load(tmp_path / "b")) != []


def test_mu_of_the_firmware_predicts_the_slip_of_the_plant(tmp_path: Path) -> None:
    """σ = ε Γ µ of theory, 'Kinematics': in steady cornering the firmware's µ must tell the plant's slip velocity."""
    run(tmp_path, *RHOMBUS, "--duration", "4", "--traction", "linear", "--speed", "0.5")
    trace, robot = Trace.load(tmp_path), load_robot()
    gamma = robot.Jr @ robot.Jr.T + robot.wheel_radius_m**2 * np.eye(3)
    middle = slice(1900, 2100)  # within the corner's blend
    predicted = 0.01 * trace.mu[middle] @ gamma.T
    speed = (trace.body_twist[middle, :2] ** 2).sum(axis=1) ** 0.5
    actual = trace.slip_ratio[middle] * (speed + 1e-3)[:, None]
    assert abs(predicted - actual).max() < 0.1 * abs(actual).max()


# ---- what a user does wrong: one line that names the cure, a non-zero exit


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--path", "spiral"], "rhombus"),
        (["--speed", "-1"], "speed_m_per_s"),
        (["--speed", "nan"], "speed_m_per_s"),
        (["--corner", "bevelled"], "rounded"),
        (["--epsilon", "0"], "epsilon"),
        (["--epsilon", "2"], "epsilon"),
        (["--epsilon", "nan"], "epsilon"),
        (["--traction", "glue"], "linear"),
        (["--order", "7"], "no order '7'; there are: 0, 1, 2, 3, exact, observer"),
        (["--output", "pose"], "no output 'pose'; there are: posture, point"),
        (["--bus", "vcan9"], "tools/with-vcan"),
        (["-i", "nonsense", "-c", "x"], "cannot open the bus"),
        (["--node", "16"], "0 … 15"),
        (["--set", "mass=3"], "position_damping_per_s"),
        (["--set", "order"], "NAME=VALUE"),
        (["--set", "traction=0"], "there are: linear, magic"),
        (["--set", "epsilon=stiff"], "must be a number"),
        (["--set", "position_damping_per_s=-3"], "position_damping_per_s"),
        (["--pace", "0"], "--pace"),
        (["--timeout", "-1"], "--timeout"),
        (["--dbc", "nowhere.dbc"], "nowhere.dbc"),
    ],
)
def test_bad_input_is_refused_by_name(tmp_path: Path, options: list[str], says: str) -> None:
    with pytest.raises(OmnibotError, match=says) as caught:
        run(tmp_path, *options)
    assert "\n" not in str(caught.value)


def test_unwritable_folder_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OmnibotError, match="--out"):
        run(tmp_path / "file" / "below", *SHORT)


# ---- how a drive ends


class FailingPlant:
    """A plant that flies off, or whose user presses Ctrl-C."""

    def __init__(self, plant: Any, at_tick: int, what: str) -> None:
        self._plant, self._left, self._what = plant, at_tick, what

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def step(self, *arguments: Any) -> None:
        self._left -= 1
        if self._left == 0 and self._what == "ctrl-c":
            raise KeyboardInterrupt
        if self._left == 0:
            self._plant.reset([math.nan, 0.0, 0.0], [0.0, 0.0, 0.0])
        self._plant.step(*arguments)


@pytest.mark.parametrize(("what", "status"), [("nan", Status.DIVERGED), ("ctrl-c", Status.INTERRUPTED)])
def test_drive_that_is_cut_short_keeps_its_rows(tmp_path: Path, what: str, status: Status) -> None:
    robot = load_robot()
    scenario = Scenario(PathRequest("rhombus", 0.5, duration_s=1.2, start_before_corner_s=0.3))
    trajectory = plan(scenario.path)
    plant = Plant(robot, scenario.traction_of(robot))
    plant.reset(*start_state(robot, trajectory))
    log = BusLog(tmp_path / "bus.log", "vcan0")
    with can.Bus(interface="omnibot", channel="inproc") as bus:
        link = Link(bus, Codec(), record=log.record)
        prepare(link, robot, scenario, trajectory)
        driven = drive(link, FailingPlant(plant, 100, what), robot, trajectory)  # type: ignore[arg-type]
    log.close()
    assert driven.status is status
    assert driven.reason
    assert len(driven.trace) == 100
