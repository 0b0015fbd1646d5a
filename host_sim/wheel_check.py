"""Drive one wheel of a real robot, wheels off the ground: python -m host_sim.wheel_check -i … -c … --wheel N.

The robot is told that it stands still, and that it ought to stand where one wheel's torque alone would take it. That
wheel then turns forwards, by its own motor or by hand, and the controller's damping takes the torque back as the
encoder counts. So the torque tells whether encoder and motor agree; whether forwards is forwards, you see.
"""

import argparse
import itertools
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.link import Link, RefusedError, open_bus
from host_sim.robot import Array, Robot, load_robot
from host_sim.trajectory import Polyline, Segment, Trajectory

BEAT_S = 0.01  # the robot stops when it has heard nothing for 0.1 s
BEATS_BEFORE = 3  # a robot with a timer looks for pose and host in its first period already
REST_S = 3.0  # braking takes 2 s at most, and half a second at rest follows
AT_REST = (0.0, 0.0, 0.0)
AGREED, OPPOSED = 0.8, 1.2  # of the torque at the start
TORQUE_MAX_NM = 0.15  # half of what a TORQUE frame carries: the bound is twice the torque


class Verdict(NamedTuple):
    """What the torque did, and what that says."""

    first_Nm: float
    last_Nm: float
    text: str


def displacement(robot: Robot, wheel: int, torque_Nm: float) -> Array:
    """Return p1, p2 (m) and heading (rad) that ask one wheel, 1 … 3, of a robot at rest at the origin for a torque.

    tau = (r Jr^-T Mo + Iw Jr / r) a is the torque of an acceleration a of the body, and K1 times the error is the
    acceleration that is asked for. p lies L ahead of the body (12), so turning moves it.
    """
    radius, inertia = robot.wheel_radius_m, robot.wheel_inertia_kg_m2
    torque_of_accel = radius * np.linalg.inv(robot.Jr.T) * robot.Mo + inertia / radius * robot.Jr
    accel = np.linalg.solve(torque_of_accel, torque_Nm * np.eye(3)[wheel - 1])
    offset = robot.tracked_point_offset_m
    at_point = np.array([accel[0] - offset * accel[2], accel[1], accel[2]])
    stiffness = [robot.parameter(f"{what}_stiffness_per_s2").default for what in ("position", "position", "heading")]
    return np.asarray(np.array([0.0, offset, 0.0]) + at_point / np.array(stiffness))


def standing(point: Array, duration_s: float) -> Trajectory:
    """Return a reference that stands at a point for a time."""
    coefficients = np.zeros((3, 8))
    coefficients[:, 0] = point
    return Trajectory([Segment(round(1e6 * duration_s), coefficients)], Polyline(np.array([point[:2], point[:2]])))


def prepare(link: Link, robot: Robot, wheel: int, torque_Nm: float, duration_s: float) -> None:
    """Give a robot in IDLE the reference and a bound that lets a wrong sign be seen."""
    link.hello()
    link.check_robot(robot)
    defaults = {parameter.name: parameter.default for parameter in robot.parameters}
    for name, value in (defaults | {"order": 0.0, "torque_bound_Nm": 2.0 * torque_Nm}).items():
        link.set_parameter(robot.parameter(name), value)
    link.upload(standing(displacement(robot, wheel, torque_Nm), duration_s).to_bytes())


def use_motors(link: Link) -> None:
    """Have the robot drive its own motors."""
    try:
        link.command("USE_MOTORS")
    except RefusedError as error:
        raise OmnibotError(f"{error}: only a board has motors; omnibot-sil and the emulated board have none") from error


def beat(link: Link, tick: int, wait_s: float) -> Array | None:
    """Tell the robot that it stands still, and return the newest torques that it tells, shape (3,) in N*m."""
    link.send_sensors(tick, AT_REST, AT_REST)
    link.send_sync(tick)
    torques = None
    deadline = time.monotonic() + wait_s
    while (heard := link.hear(max(0.0, deadline - time.monotonic()))) is not None:
        name, values = heard
        if name == "TORQUE":
            torques = np.array([values[f"wheel{number}_Nm"] for number in (1, 2, 3)])
    return torques


def judge(first_Nm: float, last_Nm: float) -> Verdict:
    """Say what a wheel's torque at the start and at the end means."""
    share = last_Nm / first_Nm if first_Nm != 0.0 else math.nan
    if share <= AGREED:
        text = "the encoder counts the way the wheel was turned; if that was forwards, both signs are right"
    elif share >= OPPOSED:
        text = "the encoder counts against the motor: change the sign of one of them in the board's header"
    else:
        text = "the encoder has hardly counted: does the wheel turn, and is the encoder connected?"
    return Verdict(first_Nm, last_Nm, text)


def come_to_rest(link: Link, beats: Iterator[int]) -> None:
    """Go on until a robot that brakes is at rest: without a host that would be a fault."""
    until_s = time.monotonic() + REST_S
    while time.monotonic() < until_s and link.mode() == "STOPPING":
        beat(link, next(beats), BEAT_S)


def drive(link: Link, wheel: int, duration_s: float, show: Callable[[Array], None]) -> Verdict:
    """Drive the wheel for a time and stop; every tenth of a second the torques are shown."""
    told: list[Array] = []
    beats = itertools.count()
    for _ in range(BEATS_BEFORE):
        beat(link, next(beats), BEAT_S)
    link.start()
    try:
        for tick in range(round(duration_s / BEAT_S)):
            torques = beat(link, next(beats), BEAT_S)
            if link.status.get("fault"):
                raise OmnibotError(f"the robot stopped by itself: {link.fault()}")
            if torques is not None:
                told.append(torques)
                if tick % 10 == 0:
                    show(torques)
    finally:
        link.command("STOP")
        come_to_rest(link, beats)
    if not told:
        raise OmnibotError("the robot told no TORQUE: does it drive?")
    return judge(float(told[0][wheel - 1]), float(told[-1][wheel - 1]))


def arguments_of(words: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m host_sim.wheel_check", description=__doc__)
    parser.add_argument("-i", "--interface", required=True, help="python-can's: socketcan, slcan, …")
    parser.add_argument("-c", "--channel", required=True, help="can0, /dev/ttyUSB0@1000000, …")
    parser.add_argument("-b", "--bitrate", type=int, help="bit/s, where the interface wants it")
    parser.add_argument("--node", type=int, default=0, help="default: 0")
    parser.add_argument("--robot", type=Path, metavar="FILE", help="default: firmware/robot/omnibot.toml")
    parser.add_argument("--wheel", type=int, required=True, choices=(1, 2, 3))
    parser.add_argument("--torque", type=float, default=0.02, metavar="NM", help="default: 0.02 N*m, at most 0.15")
    parser.add_argument("--duration", type=float, default=2.0, metavar="S", help="default: 2 s, at most 60")
    arguments = parser.parse_args(words)
    if not 0.0 < arguments.torque <= TORQUE_MAX_NM:
        parser.error(f"--torque {arguments.torque:g}: must be above 0 and at most {TORQUE_MAX_NM:g} N*m")
    if not BEAT_S <= arguments.duration <= 60.0:
        parser.error(f"--duration {arguments.duration:g}: must be {BEAT_S:g} … 60 s")
    return arguments


def main(words: list[str] | None = None) -> int:
    """Check a wheel; status 0 when encoder and motor agree."""
    arguments = arguments_of(words)
    wheel = arguments.wheel
    try:
        robot = load_robot(arguments.robot)
        with open_bus("", arguments.node, arguments.interface, arguments.channel, arguments.bitrate) as bus:
            link = Link(bus, Codec(node=arguments.node))
            prepare(link, robot, wheel, arguments.torque, arguments.duration)
            use_motors(link)
            sys.stdout.write(f"wheel {wheel} must turn forwards now; torques in N*m:\n")
            verdict = drive(link, wheel, arguments.duration, _show)
    except OmnibotError as error:
        sys.stderr.write(f"wheel_check: {error}\n")
        return 1
    sys.stdout.write(f"{verdict.first_Nm:.4f} N*m at first, {verdict.last_Nm:.4f} at last: {verdict.text}\n")
    return 0 if verdict.last_Nm <= AGREED * verdict.first_Nm else 1


def _show(torques: Array) -> None:
    sys.stdout.write("  " + "  ".join(f"{torque:8.4f}" for torque in torques) + "\n")


if __name__ == "__main__":
    sys.exit(main())
