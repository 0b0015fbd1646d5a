"""Step responses: the linear promise against scipy, and the real firmware on a nearly rigid floor against both."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import StateSpace, cont2discrete
from scipy.signal import step as scipy_step
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.planner import PathRequest
from host_sim.robot import Parameter, load_robot
from host_sim.scenario import Scenario
from host_sim.step import Decay, Step, StepRun, bounds_met, run_step
from host_sim.step_response import Gains, fit, traits

Array = NDArray[np.float64]
ROBOT = load_robot()
PAPER = Gains(70.0, 23.0)
RIGID = {"epsilon": 1e-6, "order": "0"}
GAINS = [PAPER, Gains(70.0, 6.0), Gains(64.0, 16.0), Gains(64.0, 16.0 + 1e-9), Gains(400.0, 0.0), Gains(1.0, 500.0)]


def stepped(step: Step, **scenario: Any) -> StepRun:
    with InprocBus(node=0) as bus:
        return run_step(Scenario(PathRequest("line", 0.5), **scenario), step, ROBOT, Link(bus, Codec()))


def held_torque(gains: Gains, ticks: int) -> Array:
    """The error over the offset of a double integrator whose acceleration is held for a tick, shape (ticks,)."""
    free, forced, *_ = cont2discrete(
        (np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2), 0.0), 1e-3
    )
    closed = free - forced @ np.array([[gains.stiffness_per_s2, gains.damping_per_s]])
    state, response = np.array([1.0, 0.0]), []
    for _ in range(ticks):
        response.append(state[0])
        state = closed @ state
    return np.array(response)


# ---- what the gains promise


@pytest.mark.parametrize("gains", GAINS)
def test_promise_is_the_solution_of_the_linear_system(gains: Gains) -> None:
    system = np.array([[0.0, 1.0], [-gains.stiffness_per_s2, -gains.damping_per_s]])
    time_s = np.linspace(0.0, 2.0, 41)
    exact = [expm(system * t)[0, 0] for t in time_s]
    assert gains.response(time_s) == pytest.approx(exact, abs=2e-6)


@pytest.mark.parametrize("gains", GAINS)
def test_poles_are_the_eigenvalues(gains: Gains) -> None:
    system = np.array([[0.0, 1.0], [-gains.stiffness_per_s2, -gains.damping_per_s]])
    eigenvalues = np.sort_complex(np.linalg.eigvals(system))
    assert np.sort_complex(np.array(gains.poles_per_s)) == pytest.approx(eigenvalues, rel=1e-6, abs=1e-6)


def test_promise_far_from_its_start_is_finite() -> None:
    assert abs(Gains(70.0, 500.0).response(np.array([60.0]))[0]) < 1e-3


@pytest.mark.parametrize("gains", [PAPER, Gains(70.0, 6.0), Gains(64.0, 16.0)])
def test_traits_are_those_of_scipys_step(gains: Gains) -> None:
    time_s = np.arange(0.0, 4.0, 1e-3)
    stiffness, damping = gains.stiffness_per_s2, gains.damping_per_s
    system = StateSpace([[0.0, 1.0], [-stiffness, -damping]], [[0.0], [stiffness]], [[1.0, 0.0]], [[0.0]])
    _, way = scipy_step(system, T=time_s)
    seen = traits(time_s, 1.0 - way)
    ratio = gains.damping_ratio
    overshoot = np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2)) if ratio < 1.0 else 0.0
    assert seen.overshoot == pytest.approx(overshoot, abs=1e-4)
    assert seen.rise_s == pytest.approx(time_s[way >= 0.9][0] - time_s[way >= 0.1][0], abs=2e-3)
    assert seen.settling_s == pytest.approx(time_s[np.abs(1.0 - way) > 0.02][-1], abs=2e-3)


def test_decay_that_is_cut_short_has_no_rise_and_no_settling() -> None:
    time_s = np.arange(0.0, 0.05, 1e-3)
    seen = traits(time_s, PAPER.response(time_s))
    assert (seen.rise_s, seen.settling_s, seen.overshoot) == (None, None, 0.0)


@pytest.mark.parametrize("gains", [PAPER, Gains(70.0, 6.0), Gains(300.0, 15.0), Gains(20.0, 40.0)])
def test_fit_finds_the_gains_of_scipys_response(gains: Gains) -> None:
    time_s = np.arange(0.0, 3.0, 5e-3)
    system = np.array([[0.0, 1.0], [-gains.stiffness_per_s2, -gains.damping_per_s]])
    found = fit(time_s, np.array([expm(system * t)[0, 0] for t in time_s]), PAPER)
    assert found.stiffness_per_s2 == pytest.approx(gains.stiffness_per_s2, rel=1e-4)
    assert found.damping_per_s == pytest.approx(gains.damping_per_s, rel=1e-4)


# ---- the firmware on a floor that hardly gives


@pytest.fixture(scope="module")
def rigid() -> StepRun:
    tuned = {"heading_stiffness_per_s2": "100", "heading_damping_per_s": "8"}
    return stepped(Step((0.02, -0.01, 0.05)), parameters=tuned, **RIGID)


def by_name(run: StepRun) -> dict[str, Decay]:
    return {decay.name: decay for decay in run.decays}


@pytest.mark.parametrize(("output", "gains"), [("p1", PAPER), ("p2", PAPER), ("heading", Gains(100.0, 8.0))])
def test_measured_poles_are_the_promised_ones_within_two_per_cent(rigid: StepRun, output: str, gains: Gains) -> None:
    decay = by_name(rigid)[output]
    assert rigid.result["status"] == "completed"
    assert decay.promised == gains
    fitted = decay.fitted()
    assert fitted.natural_frequency_rad_per_s == pytest.approx(gains.natural_frequency_rad_per_s, rel=0.01)
    assert fitted.damping_ratio == pytest.approx(gains.damping_ratio, rel=0.01)
    for pole, promised in zip(fitted.poles_per_s, gains.poles_per_s, strict=True):
        assert pole == pytest.approx(promised, rel=0.02)


@pytest.mark.parametrize(("output", "gains"), [("p1", PAPER), ("p2", PAPER), ("heading", Gains(100.0, 8.0))])
def test_measured_decay_is_that_of_a_torque_held_for_a_tick(rigid: StepRun, output: str, gains: Gains) -> None:
    decay = by_name(rigid)[output]
    exact = held_torque(gains, len(decay.error))
    # Steps of the wire: 10 µm and 0.1 mrad.
    assert decay.error / decay.offset == pytest.approx(exact, abs=3e-3)
    assert np.sqrt(np.mean((decay.error / decay.offset - exact) ** 2)) < 5e-4


def test_gain_that_is_wrong_in_the_firmware_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Link.set_parameter

    def wrong(link: Link, parameter: Parameter, value: float) -> None:
        right(link, parameter, 0.7 * value if parameter.name == "position_damping_per_s" else value)

    monkeypatch.setattr(Link, "set_parameter", wrong)
    monkeypatch.setattr(Link, "check_parameter", lambda *_: None)
    run = stepped(Step((0.02, 0.0, 0.1)), **RIGID)
    p1, heading = run.decays
    assert p1.promised.damping_per_s == 23.0
    assert p1.fitted().damping_per_s == pytest.approx(0.7 * 23.0, rel=0.02)
    assert heading.fitted().damping_per_s == pytest.approx(23.0, rel=0.02)
    assert run.result["outputs"][0]["rms_difference"] > 20.0 * 0.02 * 1e-3


def test_slip_that_the_firmware_does_not_know_of_moves_the_poles_and_the_observer_puts_them_back() -> None:
    step = Step((0.02, 0.0, 0.0), speed_m_per_s=1.0)
    blind, seeing = (stepped(step, order=order).result["outputs"][0] for order in ("0", "observer"))
    assert blind["rms_difference"] > 10.0 * seeing["rms_difference"]
    assert blind["measured"]["damping_ratio"] < 0.9 * PAPER.damping_ratio
    assert seeing["measured"]["damping_ratio"] == pytest.approx(PAPER.damping_ratio, rel=0.01)


def test_offset_beyond_the_force_bound_is_told() -> None:
    small, large = (stepped(Step((offset, 0.0, 0.0)), **RIGID).result["bounds"] for offset in (0.02, 0.2))
    assert small["fraction_at_bound"] == 0.0
    assert large["fraction_at_bound"] > 0.01
    assert large["max_wheel_force_N"] == pytest.approx(3.5, rel=0.01)


def test_bounds_met_counts_forces_and_torques(rigid: StepRun) -> None:
    trace = rigid.driven.trace
    strongest = float(np.abs(trace.torque).max())
    met = bounds_met(trace, {"force_bound_N": 1e3, "torque_bound_Nm": strongest})
    near = np.abs(trace.torque).max(axis=1) >= 0.99 * strongest
    assert met["fraction_at_bound"] == pytest.approx(near.mean()) != 0.0


# ---- the verb


def step_verb(*options: str) -> Any:
    outcome = CliRunner().invoke(app, ["step", *options])
    if outcome.exception is not None:
        raise outcome.exception
    return outcome


def test_verb_writes_its_folder_and_prints_what_is_in_it(tmp_path: Path) -> None:
    printed = step_verb("--duration", "0.5", "--json", "--out", str(tmp_path)).stdout
    assert json.loads(printed) == json.loads((tmp_path / "step.json").read_text())
    assert {"trace.npz", "bus.log", "report.html", "step.json"} <= {file.name for file in tmp_path.iterdir()}
    page = (tmp_path / "report.html").read_text()
    assert f">{json.loads(printed)['outputs'][0]['measured']['damping_ratio']:.4g}<" in page


def test_table_has_promise_and_measurement_side_by_side(tmp_path: Path) -> None:
    lines = step_verb(
        "--output", "point", "--set", "position_damping_per_s=6", "--out", str(tmp_path)
    ).stdout.splitlines()
    assert lines[0].split() == ["p1", "promised", "p1", "measured"]
    poles = next(line for line in lines if line.startswith("poles"))
    assert poles.split()[2:5] == ["-3.00", "±", "7.81i"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--p1", "0", "--heading", "0"], "a step needs an offset: give --p1, --p2 or --heading"),
        (["--p1", "0.0001"], r"--p1 0.0001 must be 0, or 0.001 … 1.5 m in size"),
        (["--heading", "nan"], "--heading nan must be 0, or 0.01 … 3 rad in size"),
        (["--speed", "-1"], "--speed -1 must be 0 … 3 m/s"),
        (["--duration", "0.1"], "--duration 0.1 must be 0.5 … 60 s"),
        (["--output", "point", "--heading", "0.1"], "nothing holds the heading: leave --heading 0"),
        (["--set", "position_stiffness_per_s2=0"], "position_stiffness_per_s2 below 1 brings nothing back"),
        (["--set", "position_stiffnes_per_s2=9"], "did you mean position_stiffness_per_s2"),
        (["--bus", "nowhere0"], "no bus 'nowhere0'"),
    ],
)
def test_bad_step_says_what_would_be_right_and_leaves_the_folder(tmp_path: Path, options: list[str], says: str) -> None:
    before = tmp_path / "step.json"
    before.write_text("{}")
    with pytest.raises(OmnibotError, match=says):
        step_verb(*options, "--out", str(tmp_path))
    assert before.exists()
