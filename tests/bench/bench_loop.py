"""How fast the closed loop runs, in-process and in lockstep, and what share of it the plant takes: one run, JSON."""

import json
import time
from collections.abc import Callable

import can
import numpy as np

from host_sim.codec import Codec
from host_sim.drive import drive, start_state
from host_sim.link import Link
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario


def best_s(measured: Callable[[], float], rounds: int = 5) -> float:
    """Return the smallest of some measurements: the one least disturbed by other work on the machine."""
    return min(measured() for _ in range(rounds))


def loop_real_time_factor() -> dict[str, float]:
    """Return simulated over wall time of a whole lap at 1 m/s, and of the plant alone on the same torques."""
    robot = load_robot()
    scenario = Scenario(PathRequest("rhombus", 1.0))
    trajectory = plan(scenario.path)
    torques: list[np.ndarray] = []

    def closed_loop() -> float:
        plant = Plant(robot, scenario.traction_of(robot))
        plant.reset(*start_state(robot, trajectory))
        with can.Bus(interface="omnibot", channel="inproc") as bus:
            link = Link(bus, Codec())
            prepare(link, robot, scenario, trajectory)
            driven = drive(link, plant, robot, trajectory)
        torques[:] = list(driven.trace.torque)
        return driven.timing.total_s

    def plant_alone() -> float:
        plant = Plant(robot, scenario.traction_of(robot))
        plant.reset(*start_state(robot, trajectory))
        begin = time.perf_counter()
        for torque in torques:
            plant.step(torque, robot.control_period_s)
        return time.perf_counter() - begin

    closed_loop()  # compiles what is not compiled yet
    loop_s, plant_s = best_s(closed_loop), best_s(plant_alone)
    simulated_s = trajectory.duration_us * 1e-6
    return {
        "inproc_real_time_factor": simulated_s / loop_s,
        "plant_real_time_factor": simulated_s / plant_s,
        "plant_share_of_loop": plant_s / loop_s,
    }


if __name__ == "__main__":
    print(json.dumps(loop_real_time_factor(), indent=2))
