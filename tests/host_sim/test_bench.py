"""The bench: its equations, its notion of an equal error, and what it says where it cannot measure. No times."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from host_sim.bench import loops, plants, vcan
from host_sim.bench.plants import Other, Period, compare, measure
from host_sim.cli import app
from host_sim.errors import OmnibotError
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.traction import Traction

ROBOT = load_robot()


@pytest.mark.parametrize("kind", ["linear", "magic"])
@pytest.mark.parametrize("epsilon", [5e-5, 0.1])
def test_equations_given_to_scipy_are_the_plants(kind: Any, epsilon: float) -> None:
    rng = np.random.default_rng(1)
    traction = Traction.of(ROBOT, kind, epsilon)
    plant = Plant(ROBOT, traction, 1.0, plants.DELTA_M_PER_S)
    for _ in range(5):
        twist, slip, torque = rng.normal(size=3), epsilon * rng.normal(size=3), rng.uniform(-0.1, 0.1, 3)
        plant.reset(np.zeros(3), twist, slip)
        body, wheels = plant.accelerations(torque)
        other = Other(ROBOT, traction, Period(twist, slip, torque, np.zeros(6)))

        rates = other.rates(0.0, np.concatenate([twist, slip / other.unit]))

        np.testing.assert_allclose(rates[:3], body, rtol=1e-9)
        slip_rate = ROBOT.Jr @ body - ROBOT.wheel_radius_m * wheels
        np.testing.assert_allclose(rates[3:] * other.unit, slip_rate, rtol=1e-6, atol=1e-9 * np.abs(rates[:3]).max())


class Stub:
    """An integrator as exact as its tolerance, that takes as many seconds as that has digits."""

    def integrate(self, _method: str, tolerance: float) -> tuple[np.ndarray, float]:
        return np.array([tolerance]), -np.log10(tolerance)

    def error(self, end: np.ndarray, reference: np.ndarray) -> float:
        return float(abs(end[0] - reference[0]))


@pytest.mark.parametrize(("error", "digits"), [(1.0, 4.0), (2e-7, 7.0), (1e-10, 10.0)])
def test_time_that_counts_is_that_of_the_loosest_tolerance_as_exact(error: float, digits: float) -> None:
    stubs: Any = [Stub(), Stub()]

    assert compare(stubs, [np.zeros(1)] * 2, "Radau", error) == (digits, True)


def test_integrator_that_is_never_as_exact_is_told_apart() -> None:
    stubs: Any = [Stub()]

    assert compare(stubs, [np.zeros(1)], "Radau", 1e-11) == (10.0, False)


def test_plant_is_as_exact_as_it_promises_and_faster_than_all_of_scipys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plants, "PERIODS", 50)

    row = measure(ROBOT, "random", "magic", 0.01)

    assert row["error"] < 2e-6
    assert all(row[method]["times_slower"] > 2.0 for method in ("radau", "bdf", "lsoda"))


def bench(*options: str) -> Result:
    return CliRunner().invoke(app, ["bench", *options])


def test_loop_without_a_bus_is_the_faster_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loops, "MEASURED_S", 0.0)

    result = bench("--only", "loop", "--json")

    figures = json.loads(result.stdout)
    assert figures["loop_real_time_factor"] > 2.0 * figures["inproc_real_time_factor"] > 0.0
    assert figures["plant_vs_radau"] is None
    assert figures["vcan_vs_pingpong"] is None


def test_bench_without_the_interface_says_how_to_get_one() -> None:
    result = bench("--only", "vcan", "--bus", "nope0")

    assert result.exit_code == 0
    assert "no CAN interface nope0" in result.stdout
    assert "with --bus vcan0 tools/with-vcan makes one" in result.stdout


def test_bench_that_cannot_make_an_interface_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "with-vcan"
    broken.write_text("#!/bin/sh\necho 'with-vcan: no kernel' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(vcan, "WITH_VCAN", broken)
    monkeypatch.setattr(vcan, "is_can_interface", lambda _name: False)

    result = bench("--only", "vcan")

    assert "no CAN interface vcan0" in result.stdout
    assert "tools/with-vcan failed: with-vcan: no kernel" in result.stdout


def test_unknown_part_is_refused_by_the_known_ones() -> None:
    result = bench("--only", "plant,wheel")

    assert isinstance(result.exception, OmnibotError)
    assert str(result.exception) == "no part 'wheel' of the bench; there are: plant, loop, vcan"
