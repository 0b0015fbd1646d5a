"""The plant's period against scipy's integrators for stiff systems, at the same error.

Two kinds of torques: `tracking`, as smooth as a controller's with a little noise, and `random`, a new torque of up to
half the motor's limit in every period, so that every period begins with a boundary layer.

Errors are those of slip velocity, relative to |σ| + ε (V + δ) · 1 N, and of the body twist, relative to its size,
against scipy's Radau with tolerances far below. Of each integrator that time counts which it takes with the loosest
tolerance that is as exact as the plant was over the same periods. The equations that scipy is given are compiled.
"""

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from host_sim.plant import Plant
from host_sim.robot import Array, Robot, load_robot
from host_sim.traction import Traction, TractionKind, compiled, curve

EPSILONS = (4e-11, 5e-5, 1e-3, 1e-2, 1e-1)
KINDS: tuple[TractionKind, ...] = ("linear", "magic")
DELTA_M_PER_S = 1e-3
PERIODS = 1000  # of ours
COMPARED_PERIODS = 5  # of scipy's, spread over the run
ROUNDS = 10  # the fastest of them counts: the one least disturbed by other work on the machine
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
REFERENCE_TOLERANCE = 1e-12
ERROR_FLOOR = 1e-8  # nobody is asked to be more exact: the reference is not to be trusted much further


@dataclass(frozen=True)
class Period:
    """A period of the plant that others integrate as well."""

    twist: Array
    slip: Array
    torque: Array
    end: Array  # twist and slip velocity that the plant came to, shape (6,)


def tracking_torque(k: int, rng: np.random.Generator) -> Array:
    """As a controller of a circle asks for: 0.04 N·m that turn slowly, and 5 % of noise."""
    return 0.04 * np.sin(0.01 * k + np.array([0.0, 2.1, 4.2])) + 0.002 * rng.normal(size=3)


def random_torque(_k: int, rng: np.random.Generator) -> Array:
    """Up to half the motor's limit, new in every period."""
    return rng.uniform(-0.1, 0.1, 3)


TORQUES: dict[str, Callable[[int, np.random.Generator], Array]] = {
    "tracking": tracking_torque,
    "random": random_torque,
}


@compiled
def _rates(
    law: Array, jr: Array, mo: Array, radius: float, inertia: float, torque: Array, unit: float, y: Array, out: Array
) -> None:
    """Write the derivatives of (ν, σ / unit), literally."""
    speed = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]) + DELTA_M_PER_S
    out[0], out[1], out[2] = y[2] * y[1], -y[2] * y[0], 0.0
    for wheel in range(3):
        force = -curve(law, y[3 + wheel] * unit / speed)[0]
        out[3 + wheel] = -radius * (torque[wheel] - radius * force) / inertia
        for axis in range(3):
            out[axis] += jr[wheel, axis] * force / mo[axis]
    for wheel in range(3):
        out[3 + wheel] += jr[wheel, 0] * out[0] + jr[wheel, 1] * out[1] + jr[wheel, 2] * out[2]
        out[3 + wheel] /= unit


class Other:
    """One of scipy's integrators on the plant's equations, in (ν, σ / unit) with the unit ε (V + δ) · 1 N."""

    def __init__(self, robot: Robot, traction: Traction, period: Period) -> None:
        self.robot, self.traction, self.period = robot, traction, period
        self.unit = traction.epsilon * (float(np.linalg.norm(period.twist)) + DELTA_M_PER_S)

    def rates(self, _t: float, y: Array) -> Array:
        """Return the derivatives by time."""
        robot, out = self.robot, np.empty(6)
        radius_m, inertia = robot.wheel_radius_m, robot.wheel_inertia_kg_m2
        _rates(self.traction.law, robot.Jr, robot.Mo, radius_m, inertia, self.period.torque, self.unit, y, out)
        return out

    def integrate(self, method: str, tolerance: float) -> tuple[Array, float]:
        """Return twist and slip velocity at the period's end, shape (6,), and the seconds that it took."""
        begin_s = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # LSODA's, where it gives up: its error tells
            solution = solve_ivp(
                self.rates,
                (0.0, self.robot.control_period_s),
                np.concatenate([self.period.twist, self.period.slip / self.unit]),
                method=method,
                rtol=tolerance,
                atol=np.repeat([1e-3 * tolerance, tolerance], 3),
            )
        took_s = time.perf_counter() - begin_s
        end = solution.y[:, -1] if solution.success else np.full(6, np.inf)
        return np.concatenate([end[:3], end[3:] * self.unit]), took_s

    def error(self, end: Array, reference: Array) -> float:
        """Return how far one end is from another."""
        twist, slip = reference[:3], reference[3:]
        speed = float(np.linalg.norm(twist))
        scale = np.abs(slip) + self.traction.epsilon * (speed + DELTA_M_PER_S)
        return float(max(np.max(np.abs(end[3:] - slip) / scale), np.max(np.abs(end[:3] - twist)) / speed))


def drive_plant(robot: Robot, traction: Traction, torques: Array) -> tuple[float, list[Period]]:
    """Return the seconds of a period, the median of some stretches, and the period before each stretch."""
    plant = Plant(robot, traction, 1.0, DELTA_M_PER_S)
    plant.step(np.zeros(3), robot.control_period_s)  # compiled now
    plant.reset(np.zeros(3), [0.4, 0.0, 0.3])
    took_s, periods = [], []
    for torque, *stretch in np.array_split(torques, COMPARED_PERIODS):
        before = plant.body_twist, plant.slip_velocity
        plant.step(torque, robot.control_period_s)
        periods.append(Period(*before, torque, np.concatenate([plant.body_twist, plant.slip_velocity])))
        begin_s = time.perf_counter()
        for further in stretch:
            plant.step(further, robot.control_period_s)
        took_s.append((time.perf_counter() - begin_s) / len(stretch))
    return float(np.median(took_s)), periods


def compare(others: list[Other], references: list[Array], method: str, error: float) -> tuple[float, bool]:
    """Return the median seconds a period of one integrator with the loosest tolerance of at most this error.

    Without one, those with the tightest tolerance, and False.
    """
    took_s = 0.0
    for tolerance in TOLERANCES:
        ends = [other.integrate(method, tolerance) for other in others]
        took_s = float(np.median([took for _, took in ends]))
        errors = [other.error(end, ref) for other, (end, _), ref in zip(others, ends, references, strict=True)]
        if max(errors) <= error:
            fastest = [float(np.median([other.integrate(method, tolerance)[1] for other in others])) for _ in range(2)]
            return min(took_s, *fastest), True
    return took_s, False


def measure(robot: Robot, torques: str, kind: TractionKind, epsilon: float) -> dict[str, Any]:
    """Return the row of one floor and one kind of torques."""
    traction = Traction.of(robot, kind, epsilon)
    rng = np.random.default_rng(1)
    series = np.array([TORQUES[torques](k, rng) for k in range(PERIODS)])
    took_s, periods = min((drive_plant(robot, traction, series) for _ in range(ROUNDS)), key=lambda round_: round_[0])
    others = [Other(robot, traction, period) for period in periods]
    references = [other.integrate("Radau", REFERENCE_TOLERANCE)[0] for other in others]
    error = max(other.error(o.end, ref) for other, o, ref in zip(others, periods, references, strict=True))
    row: dict[str, Any] = {
        "torques": torques,
        "traction": kind,
        "epsilon": epsilon,
        "us_per_period": 1e6 * took_s,
        "error": error,
    }
    for method in ("Radau", "BDF", "LSODA"):
        theirs_s, as_exact = compare(others, references, method, max(error, ERROR_FLOOR))
        row[method.lower()] = {
            "us_per_period": 1e6 * theirs_s,
            "times_slower": theirs_s / took_s,
            "as_exact": as_exact,
        }
    return row


def measure_plants() -> dict[str, Any]:
    """Measure every floor; ``plant_vs_…`` are the least of the ratios, of all that came as near."""
    robot = load_robot()
    rows = [measure(robot, *case) for case in product(TORQUES, KINDS, EPSILONS)]
    least = {
        f"plant_vs_{method}": min(row[method]["times_slower"] for row in rows) for method in ("radau", "bdf", "lsoda")
    }
    return least | {"plant": rows}
