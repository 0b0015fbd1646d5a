"""The closed loop without a bus: the firmware's C and the plant in one compiled loop.

Firmware, plant and arithmetic are those of `drive.drive` over the in-process bus, and so is the trace, byte for byte:
every value is rounded to the steps of its signal on the way, and the firmware packs, checks and unpacks the frames.
Left out are python-can, the codec in Python and the session's record of the frames.
"""

import contextlib
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from host_sim.codec import Codec
from host_sim.drive import DIVERGED_ERROR_M, Drive, Status, Timing, diverged, left_tracking, reference_of
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Answer, Link
from host_sim.plant import Complex, Counts, Plant, advance, observe
from host_sim.robot import Array, Robot
from host_sim.trace import FIRST, ROW_WIDTH, Trace
from host_sim.traction import compiled
from host_sim.trajectory import Trajectory

# Rows of the signals' steps: three each.
_POSE, _WHEEL_SPEED, _TORQUE, _MU = 0, 3, 6, 9
_UNIT_PER_STEP, _STEPS_PER_UNIT, _LARGEST = range(3)

_TIME, _SEEN, _APPLIED, _POINT, _REFERENCE, _HEADING, _FAST, _STEP_TIME = (
    FIRST[name]
    for name in ("time_s", "pose", "torque", "point", "reference_point", "reference_heading", "mu", "step_time_us")
)


@compiled
def _on_wire(value: float, step: Array) -> float:
    """Return the value that a frame carries for this one."""
    if math.isnan(value):
        return value
    steps = min(max(value * step[_STEPS_PER_UNIT], -step[_LARGEST]), step[_LARGEST])
    return float(math.trunc(steps + math.copysign(0.5, steps)) * step[_UNIT_PER_STEP])


@compiled
def _sense(row: Array, rest: Array, steps: Array, sensors: NDArray[np.float32]) -> None:
    """Write what the frames of a tick carry of pose and wheel speeds; `rest` is what rounding has taken so far."""
    heading = row[_SEEN + 2]
    sensors[0] = _on_wire(row[_SEEN], steps[_POSE])
    sensors[1] = _on_wire(row[_SEEN + 1], steps[_POSE + 1])
    sensors[2] = _on_wire(heading - math.tau * np.rint(heading / math.tau), steps[_POSE + 2])
    for i in range(3):
        wanted = row[_SEEN + 6 + i] + rest[i]
        unit = steps[_WHEEL_SPEED, _UNIT_PER_STEP]
        rest[i] = wanted - unit * np.rint(wanted / unit)
        sensors[3 + i] = _on_wire(wanted, steps[_WHEEL_SPEED + i])


@compiled
def _loop(
    tick: Any,
    instance: NDArray[np.uint64],
    tracking: int,
    steps: Array,
    reference: Array,
    offset_m: float,
    period_s: float,
    plant: tuple[Array, Array, Array, Array, Complex, Counts],
    rows: Array,
) -> tuple[int, int, int, bool]:
    """Run until something ends it; return rows written, the tick then, the last mode, whether the plant was solved."""
    c, law, y, w, z, n = plant
    sensors, answer = np.zeros(6, dtype=np.float32), np.zeros(6, dtype=np.float32)
    rest, torque = np.zeros(3), np.zeros(3)
    mode = tracking
    for k in range(len(reference)):
        row = rows[k]
        observe(c, law, y, row[_SEEN:])
        heading = row[_SEEN + 2]
        row[_POINT] = row[_SEEN] - offset_m * math.sin(heading)
        row[_POINT + 1] = row[_SEEN + 1] + offset_m * math.cos(heading)
        if not math.hypot(row[_POINT] - reference[k, 0], row[_POINT + 1] - reference[k, 1]) <= DIVERGED_ERROR_M:
            return k, k, mode, True
        _sense(row, rest, steps, sensors)
        mode = tick(instance.ctypes, k, sensors.ctypes, answer.ctypes)
        row[0], row[_TIME], row[_HEADING], row[_STEP_TIME] = k, k * period_s, reference[k, 2], 0.0
        row[_REFERENCE], row[_REFERENCE + 1] = reference[k, 0], reference[k, 1]
        for i in range(3):
            torque[i] = _on_wire(answer[i], steps[_TORQUE + i])
            row[_APPLIED + i] = torque[i]
            row[_FAST + i] = _on_wire(answer[3 + i], steps[_MU + i])
        if mode != tracking:
            return k + 1, k, mode, True
        if not advance(c, law, y, torque, period_s, w, z, n):
            return k + 1, k + 1, mode, k + 1 == len(reference)
    return len(reference), len(reference), mode, True


def _steps(codec: Codec) -> Array:
    """Return how pose, wheel speeds, torques and µ are rounded on the wire, shape (12, 3)."""
    fields = [field for name in ("POSE", "WHEEL_SPEED", "TORQUE", "SLIP") for field in codec[name].fields[:3]]
    return np.array([(field.unit_per_step, field.steps_per_unit, field.raw_max) for field in fields])


def drive_without_bus(link: Link, plant: Plant, robot: Robot, trajectory: Trajectory) -> Drive:
    """Run the prepared firmware against the plant as `drive.drive` does, with sensors that see everything.

    Parameters
    ----------
    link
        A session in TRACKING over an `InprocBus`; the frames of the drive are not counted and not recorded.
    plant
        On the reference, see ``start_state``; with wheels that slip.
    robot, trajectory
        What is driven, and where.
    """
    bus = link.bus
    if not isinstance(bus, InprocBus):
        raise OmnibotError(f"a loop without a bus needs the firmware in-process, not {bus.channel_info}")
    reference = reference_of(robot, trajectory)
    rows = np.empty((len(reference), ROW_WIDTH))
    begin_s = time.perf_counter()
    count, at, mode, solved = _loop(
        bus.library.omnibot_lockstep,
        bus.instance,
        link.codec["TORQUE"].choices["mode"]["TRACKING"],
        _steps(link.codec),
        reference,
        robot.tracked_point_offset_m,
        robot.control_period_s,
        plant.arrays,
        rows,
    )
    timing = Timing(total_s=time.perf_counter() - begin_s)
    plant.diverged |= not solved
    link.time_s = at * robot.control_period_s
    name = link.codec["TORQUE"].label("mode", mode)
    if name in ("FAULT", "STOPPING"):
        with contextlib.suppress(OmnibotError):
            link.command("STOP")  # its STATUS tells the fault
    ended = left_tracking(link, Answer((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), name))
    if ended is None and count < len(reference):
        ended = diverged(plant, robot, link.time_s, reference[count])
    status, reason = ended or (Status.COMPLETED, "")
    return Drive(status, reason, Trace.of_rows(rows[:count]), timing)
