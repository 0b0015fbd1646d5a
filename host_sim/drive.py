"""Driving in lockstep: the prepared firmware on a bus, the plant at its other end, a tick at a time.

Each control tick sends pose, wheel speeds and SYNC(k), waits for TORQUE(k), and integrates the plant over one period
with that torque held. Nothing in it depends on the wall clock: the same run gives the same trace at any speed.
`realtime` drives by the clock, with what is here that has nothing to do with waiting.
"""

import math
import time
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

import numpy as np

from host_sim.errors import OmnibotError
from host_sim.link import OTHER_HOST, Answer, Link, SilentError
from host_sim.plant import Plant
from host_sim.robot import Array, Robot
from host_sim.sensors import IDEAL_SENSORS, Readings, Sensors
from host_sim.trace import Trace, TraceRecorder, Vector
from host_sim.trajectory import Trajectory

# A run is lost when the tracked point is this far from where it should be.
DIVERGED_ERROR_M = 2.0


class Status(StrEnum):
    """How a run ended."""

    COMPLETED = "completed"
    DIVERGED = "diverged"
    FAULT = "fault"
    TIMEOUT = "timeout"
    INTERRUPTED = "interrupted"


@dataclass
class Timing:
    """Wall-clock times of a run."""

    answers_s: list[float] = field(default_factory=list)
    total_s: float = 0.0

    def as_dict(self, simulated_s: float) -> dict[str, Any]:
        """Return the section of ``result.json``: here a step's time is from SYNC to its answer, transport included."""
        microseconds = 1e6 * np.array(self.answers_s)
        known = len(microseconds) > 0
        return {
            "steps": len(microseconds),
            "real_time_factor": simulated_s / self.total_s if self.total_s > 0.0 else None,
            "step_time_us": {
                "mean": float(microseconds.mean()) if known else None,
                "p99": float(np.percentile(microseconds, 99)) if known else None,
                "max": float(microseconds.max()) if known else None,
            },
            "deadline_misses": 0,  # lockstep waits: there is no deadline to miss
        }

    def histograms(self) -> dict[str, Any]:
        """Return none: how long a lockstep answer takes says nothing about a loop that keeps its period."""
        return {}


class Measured(Protocol):
    """What a drive measured of time."""

    def as_dict(self, simulated_s: float) -> dict[str, Any]:
        """Return the section of ``result.json``."""

    def histograms(self) -> dict[str, Any]:
        """Return what is drawn: by name the classes' width ``class_us`` and ``counts``."""


@dataclass(frozen=True)
class Drive:
    """What came out of a drive."""

    status: Status
    reason: str
    trace: Trace
    timing: Measured


def start_state(robot: Robot, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return pose and body twist, shapes (3,), that are on the reference at its start and move with it."""
    position, velocity = trajectory.evaluate(np.zeros(1), derivatives=1)[0]
    cosine, sine = math.cos(position[2]), math.sin(position[2])
    offset = robot.tracked_point_offset_m
    pose = position - offset * np.array([-sine, cosine, 0.0])
    point_x = cosine * velocity[0] + sine * velocity[1]
    point_y = cosine * velocity[1] - sine * velocity[0]
    return pose, np.array([point_x + offset * velocity[2], point_y, velocity[2]])


def reference_of(robot: Robot, trajectory: Trajectory) -> Array:
    """Return tracked point (m) and heading (rad) of every tick, rounded as the firmware has them, shape (n, 3)."""
    ticks = round(trajectory.duration_us * 1e-6 / robot.control_period_s) + 1
    return trajectory.rounded().evaluate(robot.control_period_s * np.arange(ticks), derivatives=0)[:, 0]


def drive(
    link: Link,
    plant: Plant,
    robot: Robot,
    trajectory: Trajectory,
    pace: float = math.inf,
    sensors: Sensors = IDEAL_SENSORS,
) -> Drive:
    """Run the prepared firmware against the plant to the trajectory's end, or until something ends it earlier.

    Parameters
    ----------
    link
        A session in TRACKING.
    plant
        On the reference, see ``start_state``.
    robot, trajectory
        What is driven, and where.
    pace
        Never faster than so many times real time.
    sensors
        What the firmware gets to see of the plant.
    """
    readings = Readings(sensors, robot.control_period_s)
    period_s = robot.control_period_s
    reference = reference_of(robot, trajectory).tolist()
    recorder, timing = TraceRecorder(len(reference)), Timing()
    status, reason = Status.COMPLETED, ""
    begin_s = time.perf_counter()
    try:
        for tick, point in enumerate(reference):
            ended = _step(link, plant, robot, tick, point, readings, recorder, timing)
            if ended is not None:
                status, reason = ended
                break
            if pace < math.inf:
                _wait_until(begin_s + (tick + 1) * period_s / pace)
    except SilentError as error:
        status, reason = Status.TIMEOUT, str(error)
    except OmnibotError as error:
        status, reason = Status.FAULT, str(error)
    except KeyboardInterrupt:
        status, reason = Status.INTERRUPTED, f"stopped by Ctrl-C at {link.time_s:.3f} s"
    timing.total_s = time.perf_counter() - begin_s
    return Drive(status, reason, recorder.to_trace(), timing)


def _step(
    link: Link,
    plant: Plant,
    robot: Robot,
    tick: int,
    reference: Vector,
    readings: Readings,
    recorder: TraceRecorder,
    timing: Timing,
) -> tuple[Status, str] | None:
    """One tick: sensors out, torque in, row recorded, plant moved on. Returns why the run ends here, if it does."""
    link.time_s = tick * robot.control_period_s
    ended = diverged(plant, robot, link.time_s, reference)
    if ended is not None:
        return ended
    seen_pose = readings.pose(tick, wrapped_pose(plant))
    seen_speed = readings.wheel_speed(tick, plant)
    asked_s = time.perf_counter()
    answer = link.tick(tick, seen_pose, seen_speed)
    timing.answers_s.append(time.perf_counter() - asked_s)
    record_row(recorder, plant, robot, link.time_s, tick, reference, answer)
    ended = left_tracking(link, answer)
    if ended is None:
        plant.step(answer.torque_Nm, robot.control_period_s)
    return ended


def wrapped_pose(plant: Plant) -> tuple[float, float, float]:
    """Return the plant's pose in m, m, rad, the heading in -pi … pi."""
    x1, x2, heading = plant.pose.tolist()
    return x1, x2, math.remainder(heading, math.tau)


def tracked_point(plant: Plant, robot: Robot) -> tuple[float, float]:
    """Return where the tracked point is in {G}, m (12)."""
    x1, x2, heading = plant.pose.tolist()
    offset = robot.tracked_point_offset_m
    return x1 - offset * math.sin(heading), x2 + offset * math.cos(heading)


def diverged(plant: Plant, robot: Robot, time_s: float, reference: Vector) -> tuple[Status, str] | None:
    """Return why a run is lost at a time, if it is."""
    if plant.diverged:
        return Status.DIVERGED, f"the plant could not be integrated beyond {time_s:.3f} s"
    point = tracked_point(plant, robot)
    error_m = math.hypot(point[0] - reference[0], point[1] - reference[1])
    if not error_m <= DIVERGED_ERROR_M:
        return Status.DIVERGED, f"the tracking error reached {error_m:.3g} m at {time_s:.3f} s"
    return None


def left_tracking(link: Link, answer: Answer) -> tuple[Status, str] | None:
    """Return why the firmware no longer drives, if it does not."""
    if answer.mode == "TRACKING":
        return None
    fault = link.fault() if answer.mode in ("FAULT", "STOPPING") else "NONE"
    cause = f"mode {answer.mode}; {OTHER_HOST}" if fault == "NONE" else f"fault {fault}"
    status = Status.DIVERGED if fault == "ERROR_LIMIT" else Status.FAULT
    return status, f"the firmware left TRACKING at {link.time_s:.3f} s: {cause}"


def record_row(
    recorder: TraceRecorder,
    plant: Plant,
    robot: Robot,
    time_s: float,
    tick: int,
    reference: Vector,
    answer: Answer,
    step_time_us: float = 0.0,
) -> None:
    """Add the row of a tick: the plant as it is, and the torque that it gets until the next."""
    seen = plant.observe()
    recorder.append(
        tick=tick,
        time_s=time_s,
        pose=seen.pose.tolist(),
        body_twist=seen.body_twist.tolist(),
        wheel_speed=seen.wheel_speed.tolist(),
        slip_ratio=seen.slip_ratio.tolist(),
        wheel_force=seen.wheel_force.tolist(),
        torque=answer.torque_Nm,
        point=tracked_point(plant, robot),
        reference_point=reference[:2],
        reference_heading=reference[2],
        mu=answer.mu_m_per_s,
        step_time_us=step_time_us,
    )


def _wait_until(instant_s: float) -> None:
    """Sleep until a reading of ``time.perf_counter``."""
    left_s = instant_s - time.perf_counter()
    if left_s > 0.0:
        time.sleep(left_s)
