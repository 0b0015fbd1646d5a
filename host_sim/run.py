"""One closed-loop run: the firmware on a bus, the plant at its other end, in lockstep.

Each control tick sends pose, wheel speeds and SYNC(k), waits for TORQUE(k), and integrates the plant over one period
with that torque held. Nothing in it depends on the wall clock: the same run gives the same trace at any speed.
"""

import contextlib
import fcntl
import json
import math
import platform
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any

import can
import numpy as np

from host_sim.errors import OmnibotError
from host_sim.link import OTHER_HOST, FrameRecord, Identity, Link, SilentError
from host_sim.metrics import measure
from host_sim.planner import PathRequest
from host_sim.plant import Plant
from host_sim.report import PAGE_NAME, write_report
from host_sim.robot import Array, Robot
from host_sim.sensors import IDEAL_SENSORS, Readings, Sensors
from host_sim.trace import FILE_NAME as TRACE_FILE
from host_sim.trace import Trace, TraceRecorder, write_atomically
from host_sim.traction import Traction, TractionKind
from host_sim.trajectory import Trajectory

DISK_CURE = "free some space or choose another folder with --out"

# What a run writes into its folder.
RESULT_FILE, LOG_FILE = "result.json", "bus.log"

# A run is lost when the tracked point is this far from where it should be.
DIVERGED_ERROR_M = 2.0


# What plant and firmware share, unless the scenario tells the firmware otherwise.
SHARED_PARAMETERS = ("order", "epsilon", "output", "traction", "delta_m_per_s", "speed_length_m")


class Status(StrEnum):
    """How a run ended."""

    COMPLETED = "completed"
    DIVERGED = "diverged"
    FAULT = "fault"
    TIMEOUT = "timeout"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Scenario:
    """What is run: everything that the result depends on."""

    path: PathRequest
    epsilon: float = 0.01
    order: str = "observer"
    output: str = "posture"
    traction: TractionKind = "magic"
    delta_m_per_s: float = 1e-3
    speed_length_m: float = 1.0
    parameters: Mapping[str, str] = field(default_factory=dict)  # of the firmware, over the ones above
    plant: Mapping[str, float] = field(default_factory=dict)  # numbers of the robot that the firmware does not know of
    sensors: Sensors = IDEAL_SENSORS
    seed: int = 0  # of the simulator's noise; there is none yet

    def firmware_parameters(self, robot: Robot) -> dict[str, float]:
        """Return what the firmware is told, each value checked against its range."""
        shared = {name: str(getattr(self, name)) for name in SHARED_PARAMETERS}
        return {name: robot.parameter(name).parse(text) for name, text in {**shared, **self.parameters}.items()}

    def plant_robot(self, robot: Robot) -> Robot:
        """Return the robot as it is, where that differs from what the firmware believes."""
        numbers = {item.name for item in fields(Robot) if item.type in (float, "float")} - {"control_period_s"}
        for name, value in self.plant.items():
            if name not in numbers:
                raise OmnibotError(f"the plant has no {name!r}; there are: {', '.join(sorted(numbers))}")
            if not 0.0 < value < math.inf:
                raise OmnibotError(f"{name} = {value:g} of the plant must be above 0")
        return replace(robot, **dict(self.plant))  # type: ignore[arg-type]  # the names were checked

    def traction_of(self, robot: Robot) -> Traction:
        """Return the floor; a slipping one, since a firmware at the wheels' end of a rigid one has nothing to do."""
        if not 0.0 < self.epsilon <= 1.0:
            raise OmnibotError(f"epsilon = {self.epsilon:g} 1/N must be above 0 and at most 1")
        return Traction.of(robot, self.traction, self.epsilon)

    def as_dict(self) -> dict[str, Any]:
        """Return all inputs, defaults written out, as plain values."""
        inputs = asdict(self)
        return {**inputs.pop("path"), **inputs}


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


@dataclass(frozen=True)
class Drive:
    """What came out of a drive."""

    status: Status
    reason: str
    trace: Trace
    timing: Timing


class BusLog:
    """Frames in candump's log format, stamped with simulated time; ``can.LogReader`` reads it again."""

    def __init__(self, path: Path, channel: str) -> None:
        self._path = path
        with self._cured():
            self._writer = can.CanutilsLogWriter(path, channel=channel)

    @contextlib.contextmanager
    def _cured(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OmnibotError(f"cannot write {self._path}: {error.strerror or error}; {DISK_CURE}") from error

    def record(self, frame: FrameRecord) -> None:
        """Write one frame."""
        time_s, arbitration_id, data = frame
        message = can.Message(
            timestamp=time_s, arbitration_id=arbitration_id, data=data, is_extended_id=False, check=False
        )
        try:
            self._writer.on_message_received(message)
        except OSError as error:
            raise OmnibotError(f"cannot write {self._path}: {error.strerror or error}; {DISK_CURE}") from error

    def close(self) -> None:
        """Finish the file; once more does nothing."""
        with self._cured():
            self._writer.stop()


def start_state(robot: Robot, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return pose and body twist, shapes (3,), that are on the reference at its start and move with it."""
    position, velocity = trajectory.evaluate(np.zeros(1), derivatives=1)[0]
    cosine, sine = math.cos(position[2]), math.sin(position[2])
    offset = robot.tracked_point_offset_m
    pose = position - offset * np.array([-sine, cosine, 0.0])
    point_x = cosine * velocity[0] + sine * velocity[1]
    point_y = cosine * velocity[1] - sine * velocity[0]
    return pose, np.array([point_x + offset * velocity[2], point_y, velocity[2]])


def prepare(link: Link, robot: Robot, scenario: Scenario, trajectory: Trajectory) -> Identity:
    """Bring the firmware to TRACKING on a trajectory with the scenario's parameters."""
    identity = link.hello()
    # All of them: a firmware that has run before still holds what it was told then.
    values = {parameter.name: parameter.default for parameter in robot.parameters} | scenario.firmware_parameters(robot)
    for name, value in values.items():
        link.set_parameter(robot.parameter(name), value)
    link.upload(trajectory.to_bytes())
    link.command("START")
    for name, value in values.items():  # now that nobody can change them any more
        link.check_parameter(robot.parameter(name), value)
    return identity


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
    ticks = round(trajectory.duration_us * 1e-6 / period_s) + 1
    reference = trajectory.rounded().evaluate(period_s * np.arange(ticks), derivatives=0)[:, 0]
    recorder, timing = TraceRecorder(ticks), Timing()
    status, reason = Status.COMPLETED, ""
    begin_s = time.perf_counter()
    try:
        for tick in range(ticks):
            ended = _step(link, plant, robot, tick, reference[tick], readings, recorder, timing)
            if ended is not None:
                status, reason = ended
                break
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
    reference: Array,
    readings: Readings,
    recorder: TraceRecorder,
    timing: Timing,
) -> tuple[Status, str] | None:
    """One tick: sensors out, torque in, row recorded, plant moved on. Returns why the run ends here, if it does."""
    pose, wheel_speed = plant.pose, plant.wheel_speed
    x1, x2, heading = pose.tolist()
    offset = robot.tracked_point_offset_m
    point = (x1 - offset * math.sin(heading), x2 + offset * math.cos(heading))
    error_m = math.hypot(point[0] - reference[0], point[1] - reference[1])
    link.time_s = tick * robot.control_period_s
    if plant.diverged:
        return Status.DIVERGED, f"the plant could not be integrated beyond {link.time_s:.3f} s"
    if not error_m <= DIVERGED_ERROR_M:
        return Status.DIVERGED, f"the tracking error reached {error_m:.3g} m at {link.time_s:.3f} s"
    seen_pose = readings.pose(tick, (x1, x2, math.remainder(heading, math.tau)))
    seen_speed = readings.wheel_speed(tick, plant)
    asked_s = time.perf_counter()
    answer = link.tick(tick, seen_pose, seen_speed)
    timing.answers_s.append(time.perf_counter() - asked_s)
    recorder.append(
        tick=tick,
        time_s=link.time_s,
        pose=pose,
        body_twist=plant.body_twist,
        wheel_speed=wheel_speed,
        slip_ratio=plant.slip_ratio,
        wheel_force=plant.wheel_force,
        torque=answer.torque_Nm,
        point=point,
        reference_point=reference[:2],
        reference_heading=reference[2],
        mu=answer.mu_m_per_s,
    )
    if answer.mode != "TRACKING":
        cause = f"fault {link.fault()}" if answer.mode == "FAULT" else f"mode {answer.mode}; {OTHER_HOST}"
        return Status.FAULT, f"the firmware left TRACKING at {link.time_s:.3f} s: {cause}"
    plant.step(np.array(answer.torque_Nm), robot.control_period_s)
    return None


def _wait_until(instant_s: float) -> None:
    """Sleep until a reading of ``time.perf_counter``."""
    left_s = instant_s - time.perf_counter()
    if left_s > 0.0:
        time.sleep(left_s)


@contextlib.contextmanager
def run_folder(folder: Path) -> Iterator[Path]:
    """Take a folder for one run: before anything is simulated, make sure that it can be written, and by nobody else.

    What an earlier run left there goes, so that no two runs are mixed.
    """
    cure = "give a folder that can be written with --out"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("w")
    except OSError as error:
        raise OmnibotError(f"cannot write into {folder}: {error.strerror or error}; {cure}") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise OmnibotError(
                f"another run writes into {folder}; give this one a folder of its own with --out"
            ) from error
        for name in (RESULT_FILE, LOG_FILE, TRACE_FILE, PAGE_NAME):
            (folder / name).unlink(missing_ok=True)
        try:
            yield folder
        finally:
            (folder / ".lock").unlink(missing_ok=True)


def execute(
    scenario: Scenario,
    robot: Robot,
    trajectory: Trajectory,
    link: Link,
    log: BusLog,
    folder: Path,
    bus_name: str,
    command: str,
    pace: float = math.inf,
) -> dict[str, Any]:
    """Run a scenario and write its folder; returns what ``result.json`` holds.

    Whatever ends the drive, what was recorded until then is written.
    """
    actual = scenario.plant_robot(robot)
    plant = Plant(actual, scenario.traction_of(actual), scenario.speed_length_m, scenario.delta_m_per_s)
    plant.step(np.zeros(3), robot.control_period_s)  # compiles it, so that the drive is not charged for that
    plant.reset(*start_state(robot, trajectory))
    identity = prepare(link, robot, scenario, trajectory)
    driven = drive(link, plant, robot, trajectory, pace, scenario.sensors)
    if driven.status is not Status.TIMEOUT:
        with contextlib.suppress(OmnibotError):
            link.command("STOP")
    simulated_s = len(driven.trace) * robot.control_period_s
    result: dict[str, Any] = {
        "status": driven.status.value,
        "reason": driven.reason,
        "scenario": scenario.as_dict() | {"bus": bus_name, "time": "lockstep", "command": command},
        "versions": _versions(link, identity),
        **measure(driven.trace, trajectory.path.distance, robot.torque_limit_Nm).as_dict(),
        "timing": driven.timing.as_dict(simulated_s),
        "bus": {
            "name": bus_name,
            "frames": link.statistics.frames,
            "load_fraction_at_1Mbps": link.statistics.load_fraction(simulated_s),
            "dropped": link.dropped,
        },
    }
    log.close()
    driven.trace.save(folder)
    write_report(folder, driven.trace, result, trajectory.path.outline(), robot)
    # Last: a folder with a result is a whole one.
    write_atomically(folder / RESULT_FILE, (json.dumps(result, indent=2, allow_nan=False) + "\n").encode())
    return result


def _versions(link: Link, identity: Identity) -> dict[str, str]:
    """Return what took part in a run."""
    packages = ("omnibot", "numpy", "numba", "python-can", "cantools")
    return {
        "firmware": identity.version,
        "protocol": f"{link.codec.protocol_hash:08X}",
        "python": platform.python_version(),
        **{package: version(package) for package in packages},
    }
