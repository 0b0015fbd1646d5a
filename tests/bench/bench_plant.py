"""Speed of the plant against scipy's Radau, in the same run on the same periods; prints JSON.

    .venv/bin/python tests/bench/bench_plant.py

Two loads: `tracking`, torques as smooth as a controller's with a little noise, and `random`, a new torque of up to half
the motor's limit in every period, so that every period begins with a boundary layer.
"""

import json
import statistics
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from host_sim.plant import Plant
from host_sim.robot import Array, Robot, load_robot
from host_sim.traction import Traction

EPSILONS = (4e-11, 5e-5, 1e-3, 1e-2, 1e-1)
KINDS = ("linear", "magic")
DELTA = 1e-3
PERIODS = 1000  # of ours
REFERENCE_PERIODS = 15  # of scipy's, spread over the run


def tracking_torque(k: int, rng: np.random.Generator) -> Array:
    """As a controller of a circle asks for: 0.04 N·m that turn slowly, and 5 % of noise."""
    return 0.04 * np.sin(0.01 * k + np.array([0.0, 2.1, 4.2])) + 0.002 * rng.normal(size=3)


def random_torque(_k: int, rng: np.random.Generator) -> Array:
    """Up to half the motor's limit, new in every period."""
    return rng.uniform(-0.1, 0.1, 3)


def scipy_period(robot: Robot, traction: Traction, twist: Array, slip: Array, torque: Array) -> float:
    """Seconds that scipy's Radau takes for one period, rtol 1e-6, in (ν, slip in units of ε (V + δ))."""
    jr, mo, r, iw = robot.Jr, robot.Mo, robot.wheel_radius_m, robot.wheel_inertia_kg_m2
    unit = traction.epsilon * (float(np.linalg.norm(twist)) + DELTA)

    def rates(_t: float, y: Array) -> Array:
        nu, sigma = y[:3], y[3:] * unit
        force = -traction.force(sigma / (np.sqrt(nu @ nu) + DELTA))
        body = jr.T @ force / mo - np.array([-nu[2] * nu[1], nu[2] * nu[0], 0.0])
        return np.concatenate([body, (jr @ body - r * (torque - r * force) / iw) / unit])

    start = time.perf_counter()
    solve_ivp(
        rates,
        (0.0, robot.control_period_s),
        np.concatenate([twist, slip / unit]),
        method="Radau",
        rtol=1e-6,
        atol=np.repeat([1e-9, 1e-6], 3),
    )
    return time.perf_counter() - start


def measure(
    robot: Robot, kind: str, epsilon: float, load: Callable[[int, np.random.Generator], Array]
) -> dict[str, float]:
    """Median times of a period, ours and scipy's, µs."""
    rng = np.random.default_rng(1)
    plant = Plant(robot, Traction.of(robot, kind, epsilon), 1.0, DELTA)
    plant.reset(np.zeros(3), [0.4, 0.0, 0.3])
    plant.step(np.zeros(3), robot.control_period_s)  # compiled now
    ours, theirs = [], []
    before = plant.steps, plant.newton_iterations
    for k in range(PERIODS):
        torque = load(k, rng)
        if k % (PERIODS // REFERENCE_PERIODS) == 0:
            theirs.append(scipy_period(robot, plant.traction, plant.body_twist, plant.slip_velocity, torque))
        start = time.perf_counter()
        plant.step(torque, robot.control_period_s)
        ours.append(time.perf_counter() - start)
    return {
        "us_per_period": 1e6 * statistics.median(ours),
        "scipy_us_per_period": 1e6 * statistics.median(theirs),
        "times_faster_than_scipy": statistics.median(theirs) / statistics.median(ours),
        "steps_per_period": (plant.steps - before[0]) / PERIODS,
        "newton_iterations_per_period": (plant.newton_iterations - before[1]) / PERIODS,
    }


def plant_vs_radau(robot: Robot) -> dict[str, object]:
    """Time of a period by traction, load and ε, and how it compares."""
    result: dict[str, object] = {}
    fastest_gain = []
    for name, load in (("tracking", tracking_torque), ("random", random_torque)):
        for kind in KINDS:
            rows = {f"{epsilon:g}": measure(robot, kind, epsilon, load) for epsilon in EPSILONS}
            times = [row["us_per_period"] for row in rows.values()]
            gains = [row["times_faster_than_scipy"] for row in rows.values()]
            result[f"{name}_{kind}"] = {
                "epsilon": rows,
                "smallest_over_largest_epsilon": times[0] / times[-1],
                "slowest_over_fastest": max(times) / min(times),
                "least_times_faster_than_scipy": min(gains),
            }
            fastest_gain.append(min(gains))
    result["plant_vs_radau"] = min(fastest_gain)
    return result


if __name__ == "__main__":
    print(json.dumps(plant_vs_radau(load_robot()), indent=2))
