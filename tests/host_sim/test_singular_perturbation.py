"""Condition 2 and Theorem 1 (Tikhonov) of the paper on the simulated robot.

The full model is the plant with linear traction, the reduced one the plant with epsilon = 0; the boundary layer and the
root (16) come from the closed forms of firmware/control/COEFFICIENTS.md. The torque is a function of time, not of the
controller: both models get the same.
"""

import importlib.util
import math
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray
from scipy.linalg import expm

from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.traction import Traction

Array = NDArray[np.float64]

TOOL = Path(__file__).resolve().parents[2] / "tools" / "generate_coefficients.py"

ROBOT = load_robot()
RADIUS, DISTANCE, STIFFNESS = ROBOT.wheel_radius_m, ROBOT.wheel_distance_m, ROBOT.normalised_stiffness_N
JR = ROBOT.Jr
GAMMA = JR @ JR.T + RADIUS**2 * np.eye(3)
LENGTH, DELTA = 0.12, 1e-3

# Rates of the boundary layer times (V + delta)/G0, 1/kg: a translation slips along (1, 0, -1) and (1, -2, 1), yaw along
# (1, 1, 1); G of sigma' = G lambda on them.
ROLLING = RADIUS**2 / ROBOT.wheel_inertia_kg_m2
RATE_PLANAR = 1.5 / ROBOT.mass_kg + ROLLING
RATE_TURN = 3.0 * DISTANCE**2 / ROBOT.yaw_inertia_kg_m2 + ROLLING
MODES = {
    "turn": (np.array([1.0, 1.0, 1.0]), RATE_TURN),
    "first planar": (np.array([1.0, 0.0, -1.0]), RATE_PLANAR),
    "second planar": (np.array([1.0, -2.0, 1.0]), RATE_PLANAR),
}

EPSILONS = 10.0 ** np.arange(-7.0, -2.9, 0.5)
PERIOD, DURATION = 1e-3, 0.5
START_POSE = np.array([0.1, -0.2, 0.4])
START_V = np.array([0.3, 0.2, 0.5])
START_MU = np.array([0.6, -0.9, 1.1])  # the root (16) is near (0.8, 0.8, 0.9)


def torque(time: float) -> Array:
    """Torques of the motors: smooth, far from what would keep the wheels from slipping."""
    return np.array(
        [0.03 * math.sin(5.0 * time), 0.025 * math.cos(7.0 * time + 1.0) - 0.01, 0.03 * math.cos(4.0 * time)]
    )


# ---------------------------------------------------------------------------------------------------------- the paper's


class Paper:
    """Matrices of (9) and (10) as functions of v and V + delta, shape (3, 3)."""

    def __init__(self, tool: ModuleType) -> None:
        planar, _, turn = map(float, ROBOT.Mo)
        self._robot = (planar, turn, ROBOT.wheel_inertia_kg_m2, DISTANCE, RADIUS, STIFFNESS)
        matrices = tool.derive().matrices
        self._functions: dict[str, Callable[..., Array]] = {
            name: sp.lambdify(tool.ARGUMENTS, matrix) for name, matrix in matrices.items()
        }

    def __call__(self, name: str, v: Array, speed: float) -> Array:
        return np.asarray(self._functions[name](*self._robot, speed, *v), dtype=np.float64)

    def root(self, v: Array, speed: float, u: Array) -> Array:
        """The root of (15): (16)."""
        return -np.linalg.solve(self("C2", v, speed), self("C3", v, speed) @ u + self("C0", v, speed) @ v)


@pytest.fixture(scope="session")
def paper() -> Paper:
    if TOOL.stem not in sys.modules:
        spec = importlib.util.spec_from_file_location(TOOL.stem, TOOL)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[TOOL.stem] = module
        spec.loader.exec_module(module)
    return Paper(sys.modules[TOOL.stem])


class Motion(NamedTuple):
    """x = (pose, wheel angles, v) and mu at the end of each period, shape (n, 3) each."""

    pose: Array
    wheel_angle: Array
    v: Array
    mu: Array


def started(epsilon: float) -> Plant:
    """A plant at the same x for every epsilon, and the same mu off the manifold."""
    plant = Plant(ROBOT, Traction.of(ROBOT, "linear", epsilon), LENGTH, DELTA)
    w = epsilon * START_MU
    plant.reset(START_POSE, START_V + JR.T @ w, GAMMA @ w)
    return plant


def w_of(plant: Plant) -> Array:
    return np.linalg.solve(GAMMA, plant.slip_velocity)


def full_motion(epsilon: float) -> Motion:
    plant, rows = started(epsilon), []
    for k in range(round(DURATION / PERIOD)):
        plant.step(torque(k * PERIOD), PERIOD)
        w = w_of(plant)
        rows.append((plant.pose, plant.wheel_angle, plant.body_twist - JR.T @ w, w / epsilon))
    assert not plant.diverged
    return Motion(*map(np.array, zip(*rows, strict=True)))


def reduced_motion(paper: Paper) -> Motion:
    plant, rows = started(0.0), []
    for k in range(round(DURATION / PERIOD)):
        u = torque(k * PERIOD)
        plant.step(u, PERIOD)
        v = plant.body_twist
        rows.append((plant.pose, plant.wheel_angle, v, paper.root(v, plant.speed + DELTA, u)))
    return Motion(*map(np.array, zip(*rows, strict=True)))


@pytest.fixture(scope="module")
def distances(paper: Paper) -> dict[str, Array]:
    """Largest distance of the full motion from the reduced one over all periods, shape (len(EPSILONS),)."""
    reduced = reduced_motion(paper)
    full = [full_motion(float(epsilon)) for epsilon in EPSILONS]
    return {
        name: np.array([np.max(np.abs(getattr(motion, name) - getattr(reduced, name))) for motion in full])
        for name in Motion._fields
    }


def slope(epsilons: Array, values: Array) -> float:
    """Exponent of epsilon."""
    return float(np.polyfit(np.log(epsilons), np.log(values), 1)[0])


# ---------------------------------------------------------------------------------------------------------- Condition 2


def test_boundary_layer_is_exponentially_stable_at_every_speed(paper: Paper) -> None:
    for speed in np.geomspace(1e-3, 3.0, 200):
        eigenvalues = np.linalg.eigvals(paper("C2", START_V, float(speed)))

        assert np.max(eigenvalues.real) < 0.0
        rates = np.sort(-eigenvalues.real) * speed / STIFFNESS
        np.testing.assert_allclose(rates, [76.9, 76.9, 79.4], rtol=0.0, atol=0.05)
        np.testing.assert_allclose(rates, [RATE_PLANAR, RATE_PLANAR, RATE_TURN], rtol=1e-12)
        np.testing.assert_allclose(eigenvalues.imag, 0.0, rtol=0.0, atol=1e-6 / speed)


@pytest.mark.parametrize("mode", MODES)
def test_boundary_layer_of_each_motion_is_an_eigenvector(paper: Paper, mode: str) -> None:
    direction, rate = MODES[mode]

    np.testing.assert_allclose(paper("C2", START_V, 0.5) @ direction, -rate / 0.5 * STIFFNESS * direction, atol=1e-10)


# -------------------------------------------------------------------------------------------------- Theorem 1, reduced


def test_rigid_plant_is_the_reduced_system(paper: Paper) -> None:
    """(17) at epsilon = 0: v' = B0 v + B2 mu + B3 u with the root (16)."""
    random = np.random.default_rng(17)
    plant = Plant(ROBOT, Traction.of(ROBOT, "linear", 0.0), LENGTH, DELTA)
    for _ in range(100):
        v, u = random.uniform(-1.0, 1.0, 3) * [1.5, 1.5, 4.0], random.uniform(-0.2, 0.2, 3)
        speed = float(random.uniform(1e-3, 3.0))
        plant.reset(START_POSE, v)

        expected = (
            paper("B0", v, speed) @ v + paper("B2", v, speed) @ paper.root(v, speed, u) + paper("B3", v, speed) @ u
        )

        np.testing.assert_allclose(plant.accelerations(u)[0], expected, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("name", ["pose", "wheel_angle", "v"])
def test_slow_variables_differ_from_the_reduced_model_by_order_epsilon(distances: dict[str, Array], name: str) -> None:
    """(19), uniformly on [0, T], the layer included."""
    assert slope(EPSILONS, distances[name]) == pytest.approx(1.0, abs=0.05)
    assert math.log10(EPSILONS[-1] / EPSILONS[0]) >= 4.0 - 1e-9
    np.testing.assert_allclose(np.diff(np.log10(distances[name])), 0.5, rtol=0.0, atol=0.025)  # at every pair, too


def test_fast_variables_differ_from_the_root_by_order_epsilon_after_the_layer(distances: dict[str, Array]) -> None:
    """At the ends of the periods: 150 time constants or more after the start, and after each change of the torque."""
    assert slope(EPSILONS, distances["mu"]) == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(np.diff(np.log10(distances["mu"])), 0.5, rtol=0.0, atol=0.025)


# ---------------------------------------------------------------------------------------------- Theorem 1, in the layer


class Layer(NamedTuple):
    """Fast variable in the layer: tau = t/epsilon, shape (n,); mu and the root at the start."""

    tau: Array
    mu: Array
    root: Array
    speed: float


def layer(paper: Paper, epsilon: float) -> Layer:
    """Eight time constants from a start off the manifold, in steps of a tenth."""
    plant, u = started(epsilon), torque(0.0)
    speed = math.sqrt(START_V[0] ** 2 + START_V[1] ** 2 + (LENGTH * START_V[2]) ** 2) + DELTA
    step = 0.1 * speed / RATE_PLANAR / STIFFNESS
    mu = []
    for _ in range(80):
        plant.step(u, epsilon * step)
        mu.append(w_of(plant) / epsilon)
    assert plant.layers_skipped == 0  # resolved, not put at its end
    return Layer(step * np.arange(1, 81), np.array(mu), paper.root(START_V, speed, u), speed)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("epsilon", [1e-7, 1e-6, 1e-5])
def test_fast_variable_decays_with_the_eigenvalues_of_c2(paper: Paper, epsilon: float, mode: str) -> None:
    direction, rate = MODES[mode]
    run = layer(paper, epsilon)
    distance = np.abs((run.mu - run.root) @ direction)
    early = slice(0, 50)  # five time constants: then what is left nears order epsilon

    measured = -np.polyfit(run.tau[early], np.log(distance[early]), 1)[0] * run.speed / STIFFNESS

    assert distance[0] > 0.1
    assert measured == pytest.approx(rate, rel=3e-3)


def test_fast_variable_is_root_plus_layer_plus_order_epsilon(paper: Paper) -> None:
    """(20) within the layer, where the root alone is off by order 1."""
    errors, off = [], []
    for epsilon in EPSILONS:
        run = layer(paper, float(epsilon))
        c2 = paper("C2", START_V, run.speed)
        boundary = np.array([expm(c2 * tau) @ (START_MU - run.root) for tau in run.tau])
        errors.append(float(np.max(np.abs(run.mu - run.root - boundary))))
        off.append(float(np.max(np.abs(run.mu - run.root))))

    assert slope(EPSILONS, np.array(errors)) == pytest.approx(1.0, abs=0.05)
    assert min(off) > 1.0
    assert errors[0] < 1e-6
