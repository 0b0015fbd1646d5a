"""Many runs in one table: where the loop stays bounded, what wrong beliefs cost, how far dead reckoning drifts.

Every run is the real firmware in-process. Where the sensors see everything it runs in the compiled loop, the same to
the last bit as over python-can and ten times faster.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import can
import numpy as np

from host_sim.codec import Codec
from host_sim.drive import drive, start_state
from host_sim.link import Link
from host_sim.loop import drive_without_bus
from host_sim.metrics import measure, tracking_error
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.pool import in_processes
from host_sim.robot import load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario
from host_sim.sensors import IDEAL_SENSORS, Sensors
from host_sim.traction import TractionKind

ORDERS = ("0", "1", "2", "3", "exact", "observer")
EPSILONS = (1e-11, 1e-8, 5e-5, 1e-3, 1e-2, 5e-2, 0.2, 1.0)
SPEEDS_M_PER_S = (0.0234, 0.0936, 0.5, 1.0, 1.5)
TRACTIONS: tuple[TractionKind, ...] = ("linear", "magic")

# Far beyond anything the law asks for: the plain law of the paper.
BOUNDS_OFF = {"force_bound_N": "1000", "torque_bound_Nm": "0.327", "series_ratio_max": "1e9"}


@dataclass(frozen=True)
class Case:
    """One run of a sweep, with what its row of the table says of it."""

    labels: dict[str, Any]
    scenario: Scenario


def corner_path(speed_m_per_s: float, corner: str = "rounded") -> PathRequest:
    """Return two seconds before and after the first corner, or what of them fits on a side."""
    before_s = min(2.0, 2.1 / speed_m_per_s)
    return PathRequest("rhombus", speed_m_per_s, corner, 2.0, before_s + 2.0, before_s)


def stability_cases() -> Iterator[Case]:
    """Every order on every floor at every speed, with the bounds on and off."""
    for bounds, parameters in (("on", {}), ("off", BOUNDS_OFF)):
        grid = itertools.product(SPEEDS_M_PER_S, EPSILONS, TRACTIONS, ("sharp", "rounded"), ORDERS)
        for speed, epsilon, traction, corner, order in grid:
            labels = {
                "bounds": bounds,
                "speed_m_per_s": speed,
                "epsilon": epsilon,
                "traction": traction,
                "corner": corner,
                "order": order,
            }
            yield Case(
                labels, Scenario(corner_path(speed, corner), epsilon, order, traction=traction, parameters=parameters)
            )


def robustness_cases() -> Iterator[Case]:
    """Each wrong belief and each worse sensor alone, at 1 m/s on the magic floor with ε = 0.01."""
    robot = load_robot()
    mass, radius, friction = robot.mass_kg, robot.wheel_radius_m, robot.friction_limit_N
    wrongs: dict[str, dict[str, Any]] = {
        "nothing": {},
        "epsilon believed 3 times too large": {"parameters": {"epsilon": "0.03"}},
        "epsilon believed 3 times too small": {"parameters": {"epsilon": "0.0033333"}},
        "mass 20 % larger": {"plant": {"mass_kg": 1.2 * mass}},
        "mass 20 % smaller": {"plant": {"mass_kg": 0.8 * mass}},
        "friction limit halved": {"plant": {"friction_limit_N": 0.5 * friction}},
        "wheel radius 1 % larger": {"plant": {"wheel_radius_m": 1.01 * radius}},
        "wheel radius 1 % smaller": {"plant": {"wheel_radius_m": 0.99 * radius}},
        "pose 5 ms late": {"sensors": Sensors(pose_delay_s=5e-3)},
        "pose at 50 Hz": {"sensors": Sensors(pose_rate_hz=50.0)},
        "encoders of 4096 counts": {"sensors": Sensors(encoder_counts=4096)},
    }
    for (wrong, changes), order in itertools.product(wrongs.items(), ORDERS):
        yield Case({"wrong": wrong, "order": order}, Scenario(corner_path(1.0), 0.01, order, **changes))


def odometry_cases() -> Iterator[Case]:
    """One lap with only the first pose known, at 0.5 m/s on the magic floor with ε = 0.01."""
    for path, order in itertools.product(("rhombus", "lemniscate"), ORDERS):
        scenario = Scenario(
            PathRequest(path, 0.5),
            0.01,
            order,
            parameters={"pose_timeout_s": "3600"},
            sensors=Sensors(pose_rate_hz=0.0),
        )
        yield Case({"path": path, "order": order}, scenario)


SWEEPS: dict[str, Callable[[], Iterator[Case]]] = {
    "stability": stability_cases,
    "robustness": robustness_cases,
    "odometry": odometry_cases,
}


def run_case(case: Case) -> dict[str, Any]:
    """Run one case in-process; returns its row."""
    robot, scenario = load_robot(), case.scenario
    actual = scenario.plant_robot(robot)
    trajectory = plan(scenario.path)
    plant = Plant(actual, scenario.traction_of(actual), scenario.speed_length_m, scenario.delta_m_per_s)
    plant.reset(*start_state(robot, trajectory))
    with can.Bus(interface="omnibot", channel="inproc") as bus:
        link = Link(bus, Codec())
        prepare(link, robot, scenario, trajectory)
        if scenario.sensors == IDEAL_SENSORS:
            driven = drive_without_bus(link, plant, robot, trajectory)
        else:
            driven = drive(link, plant, robot, trajectory, sensors=scenario.sensors)
    metrics = measure(driven.trace, trajectory.path.distance, robot.torque_limit_Nm)
    row = {
        **case.labels,
        "status": driven.status.value,
        "max_error_m": metrics.tracking.max_error_m,
        "max_slip_ratio": metrics.slip.max_ratio,
    }
    if scenario.sensors != IDEAL_SENSORS:
        row["final_error_m"] = float(tracking_error(driven.trace)[-1]) if len(driven.trace) else None
    return row


def run_sweep(name: str, jobs: int | None = None) -> Iterator[dict[str, Any]]:
    """Run a sweep on so many processes (default: one a core); gives the rows in order."""
    return in_processes(run_case, SWEEPS[name](), jobs, at_once=4)


def table(rows: list[dict[str, Any]]) -> str:
    """Return rows as a Markdown table."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [columns, ["---"] * len(columns)] + [[_text(row.get(column)) for column in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) and np.isfinite(value) else str(value)
