"""The drive: sensors, torque and slip tick by tick, and how far from its trajectory the robot is."""

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from host_sim.codec import Codec
from host_sim.monitor.motion import Motion, MotionWindow
from host_sim.monitor.snapshot import Slip, Tracking, Vector
from host_sim.monitor.upload import Overheard
from host_sim.robot import Robot

SAMPLE_S = 0.02  # of the curves
SAMPLES = 1500  # half a minute of them
JUMP_TICKS = 1000  # a tick this far ahead is another host's

# Why there is no tracking error.
NOT_DRIVING = "not driving"
NO_TRAJECTORY = "the upload of the trajectory was not heard"
NO_START = "the START was not heard"
BRAKING = "braking: the time of the path slows"
NO_POSE = "no pose yet"


class Sample(NamedTuple):
    """A point of the curves; NaN is what is not known. Units as in `Snapshot`."""

    number: int
    clock_s: float
    pose: Vector
    reference: Vector
    error_m: float
    speed_m_per_s: float
    torque_Nm: Vector
    slip_ratio: Vector


class Driving:
    """What goes on at each tick.

    Parameters
    ----------
    codec, robot
        The wire, and whose geometry turns frames into slip and a tracked point.
    overheard
        Where the trajectory comes from.
    parameter
        A parameter of the firmware by its name, as far as it is known.
    """

    def __init__(self, codec: Codec, robot: Robot, overheard: Overheard, parameter: Callable[[str], float]) -> None:
        self.samples: deque[Sample] = deque(maxlen=SAMPLES)
        self.damaged_frames = 0
        self.tick: int | None = None
        self.clock_s = 0.0
        self.pose: Vector | None = None
        self.wheel_speed: Vector | None = None
        self.torque: Vector | None = None
        self.mu: Vector | None = None
        self.max_torque_Nm = math.nan
        self._codec, self._robot, self._overheard, self._parameter = codec, robot, overheard, parameter
        self._mode = ""
        self._unvouched: dict[str, tuple[bytes, tuple[float, ...]]] = {}
        self._pose_is_new = False
        self._sync_s = math.nan
        self._motion = MotionWindow(robot)
        self._sample_s = -math.inf
        self._sample_count = 0
        self._drive_s = 0.0
        self.begin(heard=False)

    def begin(self, *, heard: bool) -> None:
        """Begin a drive; ``heard`` if its START was."""
        self._start_heard = heard
        self._zero: int | None = None  # SYNC's tick at the beginning of the trajectory
        self._zero_s = math.nan  # and the bus' time
        self._reference: Vector | None = None
        self._error = self._heading_error = self._max_error = self.max_torque_Nm = self._max_ratio = math.nan

    def lose(self) -> None:
        """Something was not heard: what comes next does not follow from what came before."""
        self._start_heard, self._zero = False, None
        self._motion.clear()

    def miss(self) -> None:
        """Take note of frames that were not heard: a known drive goes on, for its ticks are numbered."""
        self._start_heard = False
        self._motion.clear()

    # ---- frames

    def take_sensor(self, name: str, data: bytes, values: tuple[float, ...]) -> None:
        """Take a POSE or WHEEL_SPEED; it counts once a SYNC has vouched for it."""
        self._unvouched[name] = data, values

    def take_sync(self, time_s: float, tick: int, pose_seal: int, speed_seal: int, *, by_ticks: bool) -> bool:
        """Take a SYNC; its ticks are the time, unless the robot has motors. Returns whether it is a new tick."""
        step = 1 if self.tick is None else (tick - self.tick) & 0xFFFFFFFF
        if step == 0:
            return False  # asked again
        if step > JUMP_TICKS:
            step = 1
            self._motion.clear()
        self.tick, self._sync_s = tick, time_s
        self.clock_s = self.clock_s + step * self._robot.control_period_s if by_ticks else time_s
        speed = self._vouched("WHEEL_SPEED", tick, speed_seal)
        if speed is not None:
            self.wheel_speed = speed
            self._motion.add_wheel_speed(self.clock_s, speed)
        pose = self._vouched("POSE", tick, pose_seal)
        if pose is not None:
            self.pose, self._pose_is_new = pose, True
            self._motion.add_pose(self.clock_s, pose)
        return True

    def _vouched(self, name: str, tick: int, seal: int) -> Vector | None:
        """Return a reading of a tick if SYNC carries the CRC of its frame and all of it is available."""
        data, values = self._unvouched.pop(name, (b"", ()))
        if not data or int(values[-1]) != tick & 0xF:
            return None
        if self._codec[name].seal(data) != seal:
            self.damaged_frames += 1
            return None
        return values[:-1] if all(map(math.isfinite, values)) else None

    def take_torque(self, time_s: float, torque_Nm: Vector, mode: str, *, by_ticks: bool) -> None:
        """Take a TORQUE: the end of a tick."""
        self.torque, self._mode = torque_Nm, mode
        if not by_ticks:
            self.clock_s = time_s
        if mode == "TRACKING":
            self.max_torque_Nm = _larger(self.max_torque_Nm, max(map(abs, torque_Nm)))
            self._follow(time_s, by_ticks=by_ticks)
        if self.clock_s - self._sample_s >= SAMPLE_S - 0.5 * self._robot.control_period_s:
            self._sample()

    def note_mode(self, mode: str) -> None:
        """Take the mode that a STATUS tells."""
        self._mode = mode

    # ---- the trajectory

    def _follow(self, time_s: float, *, by_ticks: bool) -> None:
        """Compare the newest pose with where the robot should be.

        A trajectory begins with the SYNC before the first TORQUE in TRACKING, in lockstep and in real time. A robot
        with motors counts its own ticks: there the bus' clock tells how many.
        """
        if self._zero is None and self._start_heard and self.tick is not None:
            self._zero, self._zero_s, self._start_heard = self.tick, time_s, False
        if self._zero is None or self.tick is None:
            return
        ticks = (self.tick - self._zero) & 0xFFFFFFFF
        if not by_ticks:
            ticks = max(round((self._sync_s - self._zero_s) / self._robot.control_period_s), 0)
        self._drive_s = ticks * self._robot.control_period_s
        reference = self._overheard.reference
        if reference is None or self.pose is None or not self._pose_is_new:
            return
        self._pose_is_new = False
        x, y, heading = reference.at(ticks)
        self._reference = (x, y, heading)
        point = self._tracked_point(self.pose)
        self._error = math.hypot(point[0] - x, point[1] - y)
        self._heading_error = math.remainder(self.pose[2] - heading, math.tau)
        self._max_error = _larger(self._max_error, self._error)

    def _tracked_point(self, pose: Vector) -> tuple[float, float]:
        offset = self._robot.tracked_point_offset_m
        return pose[0] - offset * math.sin(pose[2]), pose[1] + offset * math.cos(pose[2])

    def _unknown(self) -> str:
        """Say why there is no tracking error; empty where there is one."""
        if self._mode == "STOPPING":
            return BRAKING
        if self._mode != "TRACKING":
            return NOT_DRIVING
        if self._overheard.reference is None:
            return NO_TRAJECTORY
        if self._zero is None and not self._start_heard:
            return NO_START
        return NO_POSE if math.isnan(self._error) else ""

    # ---- what is known

    def drive_s(self) -> float | None:
        """Return the time since START; None where it was not heard or the robot does not drive."""
        return self._drive_s if self._mode == "TRACKING" and self._zero is not None else None

    def tracking(self) -> Tracking:
        """Return how far the robot is from where it should be."""
        unknown = self._unknown()
        if unknown:
            return Tracking(None, None, known(self._max_error), None, unknown)
        return Tracking(self._error, self._heading_error, self._max_error, self._reference, "")

    def motion(self) -> Motion | None:
        """Return the robot's speed and slip by its sensors."""
        return self._motion.motion()

    def slip(self) -> Slip:
        """Return the firmware's slip, and that by the sensors."""
        motion = self._motion.motion()
        if motion is None or motion.slip_m_per_s is None:
            return Slip(self.mu, None, None, known(self._max_ratio))
        velocity = tuple(motion.slip_m_per_s.tolist())
        return Slip(self.mu, velocity, self._ratio(motion), known(self._max_ratio))

    def _ratio(self, motion: Motion | None) -> Vector | None:
        if motion is None:
            return None
        ratio = motion.slip_ratio(self._parameter("delta_m_per_s"), self._parameter("speed_length_m"))
        return None if ratio is None else tuple(ratio.tolist())

    def _sample(self) -> None:
        """Add a point to the curves."""
        self._sample_s = self.clock_s
        self._sample_count += 1
        motion, nothing, is_known = self._motion.motion(), (math.nan,) * 3, self._unknown() == ""
        ratio = self._ratio(motion)
        if self._mode == "TRACKING" and ratio is not None:
            self._max_ratio = _larger(self._max_ratio, max(map(abs, ratio)))
        sample = Sample(
            number=self._sample_count,
            clock_s=self.clock_s,
            pose=self.pose or nothing,
            reference=self._reference if is_known and self._reference is not None else nothing,
            error_m=self._error if is_known else math.nan,
            speed_m_per_s=math.nan if motion is None else motion.speed_m_per_s,
            torque_Nm=self.torque or nothing,
            slip_ratio=ratio or nothing,
        )
        self.samples.append(sample)


def known(value: float) -> float | None:
    """Return a value, or None if it is no number."""
    return value if math.isfinite(value) else None


def _larger(a: float, b: float) -> float:
    return b if math.isnan(a) else max(a, b)
