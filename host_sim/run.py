"""One closed-loop run: a scenario's firmware and plant are set up, driven, and what came of it is written."""

import contextlib
import fcntl
import json
import math
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np

from host_sim.drive import Drive, Status, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.link import FrameRecord, Identity, Link
from host_sim.metrics import measure
from host_sim.parameters import plain, read_value
from host_sim.plant import Plant
from host_sim.realtime import drive_in_real_time
from host_sim.report import PAGE_NAME, write_report
from host_sim.robot import Robot, shortest
from host_sim.scenario import Scenario
from host_sim.trace import FILE_NAME as TRACE_FILE
from host_sim.trace import write_atomically
from host_sim.trajectory import Trajectory

DISK_CURE = "free some space or choose another folder with --out"

# What a run writes into its folder.
RESULT_FILE, LOG_FILE = "result.json", "bus.log"
STEP_FILE = "step.json"  # what `omnibot step` writes instead of the result


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


class SetUp(NamedTuple):
    """Who was set up, by name what its parameters were before, and what they are now."""

    identity: Identity
    held: dict[str, float]
    values: dict[str, float]


def prepare(link: Link, robot: Robot, scenario: Scenario, trajectory: Trajectory) -> SetUp:
    """Bring the firmware to TRACKING, in lockstep, on a trajectory with the scenario's parameters."""
    ready = set_up(link, robot, scenario, trajectory)
    link.start()
    check_parameters(link, robot, ready.values)  # now that nobody can change them any more
    return ready


def set_up(link: Link, robot: Robot, scenario: Scenario, trajectory: Trajectory) -> SetUp:
    """Give a firmware in IDLE its pace, trajectory and parameters."""
    identity = link.hello(scenario.time)
    link.check_robot(robot)
    held = {parameter.name: shortest(read_value(link, parameter.index)) for parameter in robot.parameters}
    others = held if scenario.keep_parameters else {p.name: p.default for p in robot.parameters}
    # All of them are set, those that stay as they are as well: so the log of the bus is whole.
    values = others | scenario.firmware_parameters(robot)
    for name, value in values.items():
        link.set_parameter(robot.parameter(name), value)
    link.upload(trajectory.to_bytes())
    return SetUp(identity, held, values)


def check_parameters(link: Link, robot: Robot, values: Mapping[str, float]) -> None:
    """Make sure that the firmware holds what it was told."""
    for name, value in values.items():
        link.check_parameter(robot.parameter(name), value)


def overridden(robot: Robot, ready: SetUp) -> dict[str, dict[str, float | str]]:
    """Return what somebody had set in the robot and the run set otherwise: by name the value held and the run's."""
    found = {}
    for parameter in robot.parameters:
        held, value = ready.held[parameter.name], shortest(ready.values[parameter.name])
        if held not in (value, shortest(parameter.default)):
            found[parameter.name] = {"held": plain(parameter, held), "run": plain(parameter, value)}
    return found


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
        for name in (RESULT_FILE, STEP_FILE, LOG_FILE, TRACE_FILE, PAGE_NAME):
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
    ready, driven = _drive(link, plant, robot, scenario, trajectory, pace)
    if driven.status is not Status.TIMEOUT:
        with contextlib.suppress(OmnibotError):
            link.command("STOP")
    simulated_s = len(driven.trace) * robot.control_period_s
    result: dict[str, Any] = {
        "status": driven.status.value,
        "reason": driven.reason,
        "scenario": scenario.as_dict() | {"bus": bus_name, "command": command},
        "versions": _versions(link, robot, ready.identity),
        "parameters": {p.name: plain(p, ready.values[p.name]) for p in robot.parameters},
        "overridden_parameters": overridden(robot, ready),
        "cleared_faults": link.cleared_faults,
        **measure(driven.trace, trajectory.path.distance, robot.torque_limit_Nm).as_dict(),
        "timing": driven.timing.as_dict(simulated_s),
        "histograms": driven.timing.histograms(),
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


def _drive(
    link: Link, plant: Plant, robot: Robot, scenario: Scenario, trajectory: Trajectory, pace: float
) -> tuple[SetUp, Drive]:
    """Drive as the scenario's ``time`` says."""
    if scenario.time == "lockstep":
        ready = prepare(link, robot, scenario, trajectory)
        return ready, drive(link, plant, robot, trajectory, pace, scenario.sensors)
    ready = set_up(link, robot, scenario, trajectory)
    check_parameters(link, robot, ready.values)  # before the start: from then on every period counts
    return ready, drive_in_real_time(link, plant, robot, trajectory, scenario.sensors)


def _versions(link: Link, robot: Robot, identity: Identity) -> dict[str, str]:
    """Return what took part in a run."""
    packages = ("omnibot", "numpy", "numba", "python-can", "cantools")
    return {
        "firmware": identity.version,
        "protocol": f"{link.codec.protocol_hash:08X}",
        "robot": f"{robot.checksum:08X}",
        "python": platform.python_version(),
        **{package: version(package) for package in packages},
    }
