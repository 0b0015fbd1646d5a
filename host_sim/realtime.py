"""A run by the clock: the firmware's own timer paces the controller, this simulator the plant, and neither waits.

The plant is moved on at instants of its own, half a period before the firmware's steps: sensors of tick k go out, the
firmware steps on them, its torque comes back, and at the next instant the plant is integrated over the period with the
newest torque there is. In time that is the lockstep run to the bit of the wire; what comes late acts late, as it would
on a robot, and is counted.
"""

import contextlib
import gc
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from host_sim.drive import Drive, Status, diverged, left_tracking, record_row, reference_of, wrapped_pose
from host_sim.errors import OmnibotError
from host_sim.link import Answer, Link, SilentError
from host_sim.plant import Plant
from host_sim.robot import Robot
from host_sim.sensors import IDEAL_SENSORS, Readings, Sensors
from host_sim.trace import TraceRecorder
from host_sim.trajectory import Trajectory

# The plant's instants follow the firmware's clock, which may be another crystal: by this share of the phase error a
# tick, by no more than this, and only by errors of less than this share of a period. Larger ones are answers that came
# late: to follow them would stretch time.
PHASE_GAIN = 0.01
PHASE_STEP_MAX_S = 5e-6
PHASE_ERROR_MAX = 0.25

WARM_UP_PERIODS = 50
REST_S = 3.0  # braking takes 2 s at most, and half a second at rest follows
BACKLOG_FRAMES = 20  # are taken at a time: ten ticks

HISTOGRAM_CLASS_US = 20.0
HISTOGRAM_CLASSES = 150  # what is beyond is counted in the last one


def percentile(values: Sequence[float], percent: float) -> float | None:
    """Return a percentile of measured values; None without any."""
    return float(np.percentile(values, percent)) if values else None


def summary(times_us: Sequence[float]) -> dict[str, float | None]:
    """Return least, mean, 99th percentile and largest of times."""
    return {
        "min": min(times_us, default=None),
        "mean": float(np.mean(times_us)) if times_us else None,
        "p99": percentile(times_us, 99),
        "max": max(times_us, default=None),
    }


def histogram(times_us: Sequence[float]) -> dict[str, Any]:
    """Return the counts of times in classes of 20 µs from 0 on; those beyond the last one are in it."""
    places = np.minimum(np.maximum(times_us, 0.0) / HISTOGRAM_CLASS_US, HISTOGRAM_CLASSES - 1).astype(int)
    counts = np.bincount(places, minlength=1)
    return {"class_us": HISTOGRAM_CLASS_US, "counts": counts.tolist()}


@dataclass
class RealTiming:
    """What was measured of time; all lists in µs.

    ``round_trip`` is from the SYNC of a tick to the TORQUE that answers it; ``torque_jitter`` how far the time from one
    TORQUE to the next is from the period; ``plant_lateness`` how long after its instant the plant's period was begun.
    A tick is late when its TORQUE had not come at the next instant: the plant then went on with an older torque. The
    plant skips an instant, and sends no sensors, when it is late by a period or more.
    """

    period_us: float
    steps: int = 0
    late_ticks: int = 0
    skipped_instants: int = 0
    total_s: float = 0.0
    round_trip: list[float] = field(default_factory=list)
    torque_jitter: list[float] = field(default_factory=list)
    plant_lateness: list[float] = field(default_factory=list)
    reports: list[dict[str, float]] = field(default_factory=list)  # TIMING frames

    def as_dict(self, simulated_s: float) -> dict[str, Any]:
        """Return the section of ``result.json``. Step times are the firmware's own, frames included, from TIMING."""
        told = [report for report in self.reports if math.isfinite(report["step_mean_us"])]
        largest = [report["step_max_us"] for report in told]
        return {
            "steps": self.steps,
            "real_time_factor": simulated_s / self.total_s if self.total_s > 0.0 else None,
            "step_time_us": {
                "min": min((report["step_min_us"] for report in told), default=None),
                "mean": float(np.mean([report["step_mean_us"] for report in told])) if told else None,
                "p99": percentile(largest, 99),  # of the largest of each 100 ticks: not below that of all ticks
                "max": max(largest, default=None),
            },
            "deadline_misses": self.late_ticks,
            "firmware_overruns": int(self.reports[-1]["overruns"]) if self.reports else None,
            "plant_skipped_instants": self.skipped_instants,
            "round_trip_us": summary(self.round_trip),
            "torque_jitter_us": summary(self.torque_jitter),
            "plant_lateness_us": summary(self.plant_lateness),
        }

    def histograms(self) -> dict[str, Any]:
        """Return the classes and counts of everything that was measured."""
        return {
            "round_trip_us": histogram(self.round_trip),
            "torque_jitter_us": histogram(self.torque_jitter),
            "plant_lateness_us": histogram(self.plant_lateness),
        }


class Listener:
    """Hears the firmware between the plant's instants, and keeps its newest answer and when it came."""

    def __init__(self, link: Link, timing: RealTiming) -> None:
        self._link = link
        self._timing = timing
        self._sent_s: dict[int, float] = {}  # when SYNC went out, by counter
        self._newest_s = -math.inf
        self.newest: Answer | None = None
        self.counter = -1  # of the newest answer
        self.answered_s = 0.0  # when a new counter came first
        self.driving_since_s: float | None = None  # first torque while TRACKING

    def sent(self, tick: int) -> None:
        """Note that the SYNC of a tick goes out now."""
        self._sent_s[tick & 0xF] = time.perf_counter()

    def listen(self, until_s: float) -> None:
        """Take frames until an instant; after it those that wait already, but never so many that it does not end."""
        while (left_s := until_s - time.perf_counter()) > 0.0:
            heard = self._link.hear(left_s)
            if heard is not None:
                self._note(*heard)
        for _ in range(BACKLOG_FRAMES):
            heard = self._link.hear(0.0)
            if heard is None:
                return
            self._note(*heard)

    def listen_for_drive(self, until_s: float) -> None:
        """Take frames until an instant, or until the firmware drives."""
        while self.driving_since_s is None and (left_s := until_s - time.perf_counter()) > 0.0:
            heard = self._link.hear(left_s)
            if heard is not None:
                self._note(*heard)

    def _note(self, name: str, values: dict[str, float]) -> None:
        if name == "TORQUE":
            self._note_torque(values)
        elif name == "SLIP" and self.newest is not None:
            mu = (values["mu1_m_per_s"], values["mu2_m_per_s"], values["mu3_m_per_s"])
            self.newest = self.newest._replace(mu_m_per_s=mu)
        elif name == "TIMING":
            self._timing.reports.append(values)

    def _note_torque(self, values: dict[str, float]) -> None:
        now_s = time.perf_counter()
        mu = self.newest.mu_m_per_s if self.newest is not None else (0.0, 0.0, 0.0)
        torque = (values["wheel1_Nm"], values["wheel2_Nm"], values["wheel3_Nm"])
        self.newest = Answer(torque, mu, self._link.codec["TORQUE"].label("mode", values["mode"]))
        interval_us = 1e6 * (now_s - self._newest_s)
        self._newest_s = now_s
        if self.newest.mode == "TRACKING" and self.driving_since_s is None:
            self.driving_since_s = now_s
        counter = int(values["counter"])
        if counter == self.counter:
            return
        self.counter, self.answered_s = counter, now_s
        if self.newest.mode != "TRACKING":
            return
        if math.isfinite(interval_us):
            self._timing.torque_jitter.append(abs(interval_us - self._timing.period_us))
        if counter in self._sent_s:
            self._timing.round_trip.append(1e6 * (now_s - self._sent_s.pop(counter)))


@contextlib.contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Keep Python's collector, which may take many periods, out of the drive."""
    was_on = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _RealTimeDrive:
    """The state of one drive: see ``drive_in_real_time``."""

    def __init__(self, link: Link, plant: Plant, robot: Robot, trajectory: Trajectory, sensors: Sensors) -> None:
        self.link, self.plant, self.robot = link, plant, robot
        self.period_s = robot.control_period_s
        self.reference = reference_of(robot, trajectory)
        self.ticks = len(self.reference)
        self.readings = Readings(sensors, self.period_s)
        self.recorder = TraceRecorder(self.ticks)
        self.timing = RealTiming(1e6 * self.period_s)
        self.listener = Listener(link, self.timing)
        self.first_sync = 0  # the tick that SYNC carries at tick 0 of the drive
        self.tick = 0  # of the drive

    def sync_of(self, tick: int) -> int:
        """Return the tick that SYNC carries: the host's ticks go on from those before the drive."""
        return (self.first_sync + tick) & 0xFFFFFFFF

    def send(self, tick: int) -> None:
        """Send the sensors and the SYNC of a tick."""
        pose = self.readings.pose(tick, wrapped_pose(self.plant))
        sync = self.sync_of(tick)
        self.link.send_sensors(sync, pose, self.readings.wheel_speed(tick, self.plant))
        self.link.send_sync(sync)
        self.listener.sent(sync)

    def send_first(self) -> None:
        """Send tick 0, as often as it takes, each time with the same readings and a SYNC that goes on."""
        self.link.forget_rounding()
        self.first_sync += 1
        self.send(0)

    def warm_up(self) -> None:
        """Do everything once that a tick does, so that no period pays for what is compiled or loaded at first use."""
        scratch, still = TraceRecorder(1), Answer((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "IDLE")
        record_row(scratch, self.plant, self.robot, 0.0, 0, self.reference[0], still)
        diverged(self.plant, self.robot, 0.0, self.reference[0])
        for _ in range(WARM_UP_PERIODS):
            self.send_first()
            self.listener.listen(time.perf_counter() + self.period_s)

    def begin(self) -> float:
        """Start the firmware and hold the plant until its first torque; returns when the plant's time begins."""
        self.warm_up()
        self.send_first()
        self.link.start()
        give_up_s = time.perf_counter() + self.link.timeout_s
        while time.perf_counter() < give_up_s:
            self.send_first()
            self.listener.listen_for_drive(time.perf_counter() + self.period_s)
            if self.listener.driving_since_s is not None:
                return self.listener.driving_since_s - 0.5 * self.period_s
            if self.listener.newest is not None and self.listener.newest.mode == "FAULT":
                raise OmnibotError(f"the firmware would not drive: fault {self.link.fault()}")
        raise SilentError(f"no TORQUE while TRACKING from node {self.link.codec.node} on {self.link.bus.channel_info}")

    def exchange(self, tick: int, instant_s: float) -> None:
        """Tell the firmware of a tick and hear it until the next instant.

        A simulator that is a period late or more tells nothing, to be in time again: the plant goes on by itself.
        """
        lateness_s = time.perf_counter() - instant_s
        self.timing.plant_lateness.append(1e6 * lateness_s)
        if lateness_s >= self.period_s:
            self.timing.skipped_instants += 1
            return
        if tick > 0:  # that of tick 0 went out before the firmware drove
            self.send(tick)
        self.listener.listen(instant_s + self.period_s)

    def advance(self, tick: int) -> tuple[Status, str] | None:
        """Integrate the period after a tick with the newest torque; returns why the run ends here, if it does."""
        self.timing.late_ticks += self.listener.counter != self.sync_of(tick) & 0xF
        answer = self.listener.newest
        assert answer is not None  # begin() saw to it
        self.timing.steps += 1
        record_row(
            self.recorder, self.plant, self.robot, self.link.time_s, tick, self.reference[tick], answer, self.step_us()
        )
        ended = left_tracking(self.link, answer)
        if ended is None:
            self.plant.step(np.array(answer.torque_Nm), self.period_s)
        return ended

    def step_us(self) -> float:
        """Return the mean step time that the firmware told last, µs; NaN before it told any."""
        return self.timing.reports[-1]["step_mean_us"] if self.timing.reports else math.nan

    def phase_step_s(self, tick: int, instant_s: float) -> float:
        """Return how far the next instant is put off to stay half a period before the firmware's steps."""
        if self.listener.counter != self.sync_of(tick) & 0xF:
            return 0.0
        error_s = self.listener.answered_s - instant_s - 0.5 * self.period_s
        if abs(error_s) > PHASE_ERROR_MAX * self.period_s:
            return 0.0
        return max(-PHASE_STEP_MAX_S, min(PHASE_STEP_MAX_S, PHASE_GAIN * error_s))

    def come_to_rest(self) -> None:
        """Have the firmware stop, and drive the plant until it has: a host that goes before is a fault."""
        self.link.command("STOP")
        instant_s = time.perf_counter()
        for tick in range(self.tick + 1, self.tick + 1 + round(REST_S / self.period_s)):
            if self.link.mode() != "STOPPING":
                return
            instant_s += self.period_s
            self.send(tick)
            self.listener.listen(instant_s)
            if self.listener.newest is not None:
                self.plant.step(np.array(self.listener.newest.torque_Nm), self.period_s)

    def run(self) -> tuple[Status, str]:
        """Drive to the end of the trajectory."""
        instant_s = self.begin()
        for tick in range(self.ticks):
            self.tick = tick
            self.link.time_s = tick * self.period_s
            ended = diverged(self.plant, self.robot, self.link.time_s, self.reference[tick])
            if ended is not None:
                return ended
            self.exchange(tick, instant_s)
            ended = self.advance(tick)
            if ended is not None:
                return ended
            instant_s += self.period_s + self.phase_step_s(tick, instant_s)
        return Status.COMPLETED, ""


def drive_in_real_time(
    link: Link,
    plant: Plant,
    robot: Robot,
    trajectory: Trajectory,
    sensors: Sensors = IDEAL_SENSORS,
) -> Drive:
    """Start the prepared firmware and run it against the plant by the clock; ``drive.drive``'s counterpart.

    Parameters
    ----------
    link
        A session with a robot in IDLE that steps by its own timer.
    plant
        On the reference; it is held there until the firmware's first torque.
    robot, trajectory
        What is driven, and where.
    sensors
        What the firmware gets to see of the plant.
    """
    session = _RealTimeDrive(link, plant, robot, trajectory, sensors)
    begin_s = time.perf_counter()
    try:
        with _no_garbage_collection():
            status, reason = session.run()
    except SilentError as error:
        status, reason = Status.TIMEOUT, str(error)
    except OmnibotError as error:
        status, reason = Status.FAULT, str(error)
    except KeyboardInterrupt:
        status, reason = Status.INTERRUPTED, f"stopped by Ctrl-C at {link.time_s:.3f} s"
    session.timing.total_s = time.perf_counter() - begin_s
    if status in (Status.COMPLETED, Status.INTERRUPTED):
        with contextlib.suppress(OmnibotError, KeyboardInterrupt):
            session.come_to_rest()
    return Drive(status, reason, session.recorder.to_trace(), session.timing)
