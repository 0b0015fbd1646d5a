"""The closed loop on one core, over python-can and without a bus: a whole lap of the rhombus at 1 m/s."""

import time
from collections.abc import Callable
from typing import Any

from host_sim.codec import Codec
from host_sim.drive import Drive, Status, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.loop import drive_without_bus
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import Robot, load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario
from host_sim.trajectory import Trajectory

# The fastest of some drives counts, the one least disturbed by other work on the machine: as many as fit into a time.
MEASURED_S = 5.0
ROUNDS_MIN = 2  # the first one loads or compiles what is not there yet

Way = Callable[[Link, Plant, Robot, Trajectory], Drive]


def drive_once(way: Way, link: Link, scenario: Scenario, robot: Robot, trajectory: Trajectory) -> Drive:
    """Prepare the firmware on a bus and drive it."""
    plant = Plant(robot, scenario.traction_of(robot))
    plant.step((0.0, 0.0, 0.0), robot.control_period_s)  # compiled now
    plant.reset(*start_state(robot, trajectory))
    prepare(link, robot, scenario, trajectory)
    driven = way(link, plant, robot, trajectory)
    if driven.status is not Status.COMPLETED:
        raise OmnibotError(f"the run that was to be timed ended early: {driven.reason}")
    return driven


def real_time_factor(driven: Drive, robot: Robot) -> float:
    """Return how many times faster than the clock a drive was."""
    return float(driven.timing.as_dict(len(driven.trace) * robot.control_period_s)["real_time_factor"])


def measure_loops() -> dict[str, Any]:
    """Measure both ways."""
    robot, scenario = load_robot(), Scenario(PathRequest("rhombus", 1.0))
    trajectory = plan(scenario.path)

    def fastest(way: Way) -> float:
        factors: list[float] = []
        end_s = time.perf_counter() + MEASURED_S
        while len(factors) < ROUNDS_MIN or time.perf_counter() < end_s:
            with InprocBus() as bus:
                driven = drive_once(way, Link(bus, Codec()), scenario, robot, trajectory)
                factors.append(real_time_factor(driven, robot))
        return max(factors)

    inproc, loop = fastest(drive), fastest(drive_without_bus)
    return {
        "inproc_real_time_factor": inproc,
        "loop_real_time_factor": loop,
        "inproc_ticks_per_s": inproc / robot.control_period_s,
        "loop_ticks_per_s": loop / robot.control_period_s,
    }
