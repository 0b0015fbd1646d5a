"""The frames that the firmware is measured with: closed-loop runs, random states, and what goes wrong on a bus.

Everything is made at run time, from seeds, by the simulator and the firmware's host build; nothing depends on a clock.
A session is a firmware from its start: groups of frames that go in before anybody takes the answers out.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import can
import numpy as np

from host_sim.codec import Codec
from host_sim.drive import drive, start_state
from host_sim.inproc import InprocBus
from host_sim.link import Link, RefusedError
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import Robot, load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario
from host_sim.trajectory import Trajectory

NODE = 0
SEED = 20140
ORDERS = ("0", "1", "2", "3", "exact", "observer")
OUTPUTS = ("posture", "point")
TRACTIONS = ("linear", "magic")

# Kinds of groups. Only `TICK` is a tick as it should be: driving, with fresh sensors.
SETUP, TICK, IDLE_TICK, AFTER_GAP, FAULT, BRAKING = (
    "setup",
    "tick",
    "tick without a step",
    "tick after missed ones",
    "tick with a fault",
    "tick while braking",
)

RANDOM_TICKS = 60
BRAKING_TICKS = 400  # to a stop of the reference, and some at rest
RANDOM_SETTINGS = (
    {"epsilon": "0.001"},
    {"epsilon": "0.05", "series_ratio_max": "1e9", "force_bound_N": "1000", "torque_bound_Nm": "0.327"},
    {
        "epsilon": "1",
        "observer_lag_s": "0.01",
        "speed_length_m": "0",
        "force_bound_N": "0.5",
        "torque_bound_Nm": "0.02",
    },
)


class FrameIn(NamedTuple):
    """One frame for the firmware."""

    identifier: int
    data: bytes


class Group(NamedTuple):
    """Frames that go in one behind the other; then the answers are taken out until there are none."""

    kind: str
    frames: tuple[FrameIn, ...]


@dataclass
class Session:
    """A firmware from its start."""

    name: str
    order: str
    output: str
    groups: list[Group] = field(default_factory=list)


class Recorder(InprocBus):
    """A bus to the firmware in-process that keeps what it was sent."""

    def __init__(self, **kwargs: Any) -> None:
        self.sent: list[FrameIn] = []
        super().__init__(node=NODE, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Keep the frame, and give it to the firmware."""
        self.sent.append(FrameIn(msg.arbitration_id, bytes(msg.data)))
        super().send(msg, timeout)


class Wire:
    """Frames by the name of their message."""

    def __init__(self) -> None:
        self.codec = Codec(node=NODE)
        self._sensors = {self.codec[name].arbitration_id for name in ("POSE", "WHEEL_SPEED")}
        self._sync = self.codec["SYNC"].arbitration_id

    def frame(self, name: str, *values: float) -> FrameIn:
        """Return a message of the wire, its fields in their order."""
        message = self.codec[name]
        return FrameIn(message.arbitration_id, message.pack(*values))

    def grouped(self, frames: Sequence[FrameIn]) -> Iterator[Group]:
        """Put each SYNC together with the sensors sent for it; any other frame stands alone."""
        waiting: list[FrameIn] = []
        for frame in frames:
            if frame.identifier in self._sensors:
                waiting.append(frame)
            elif frame.identifier == self._sync:
                yield Group(TICK, (*waiting, frame))
                waiting = []
            else:
                yield Group(SETUP, (frame,))


# ---- closed loops


def requests() -> dict[str, tuple[PathRequest, float]]:
    """Return what is driven in closed loop, and on what epsilon: mild slip, and so much that the bounds act."""
    return {
        "rounded": (PathRequest("rhombus", 1.0, "rounded", 12.0, 0.25, 0.1), 0.01),
        "sharp": (PathRequest("rhombus", 1.0, "sharp", 12.0, 0.2, 0.03), 0.1),
        "lemniscate": (PathRequest("lemniscate", 1.5, corner_accel_m_per_s2=12.0, duration_s=0.5), 0.03),
    }


def closed_loop(name: str, scenario: Scenario, trajectory: Trajectory, robot: Robot, wire: Wire) -> Session:
    """Drive a scenario in-process and keep every frame that the firmware was sent."""
    plant = Plant(robot, scenario.traction_of(robot))
    plant.reset(*start_state(robot, trajectory))
    with Recorder() as bus:
        link = Link(bus, wire.codec)
        prepare(link, robot, scenario, trajectory)
        drive(link, plant, robot, trajectory)
        return Session(name, scenario.order, scenario.output, list(wire.grouped(bus.sent)))


# ---- scripts: frames that no simulator would send


class Script:
    """Writes a session frame by frame, the firmware set up and driving: what a robot answers is in what comes next."""

    def __init__(self, wire: Wire, session: Session, scenario: Scenario, trajectory: Trajectory, robot: Robot) -> None:
        self._wire, self.session, self._tick = wire, session, 0
        self._bus = Recorder()
        self._link = Link(self._bus, wire.codec)
        self._note_sent(lambda: prepare(self._link, robot, scenario, trajectory))

    def close(self) -> None:
        """Let go of the firmware."""
        self._bus.shutdown()

    def _note_sent(self, act: Callable[[], object]) -> None:
        """Do something over the link and add to the session what it sent."""
        before = len(self._bus.sent)
        with contextlib.suppress(RefusedError):
            act()
        self.session.groups += self._wire.grouped(self._bus.sent[before:])

    def send(self, kind: str, *frames: FrameIn) -> None:
        """Send frames, one behind the other."""
        for frame in frames:
            self._bus.send(can.Message(arbitration_id=frame.identifier, is_extended_id=False, data=frame.data))
        while self._link.hear(0.0) is not None:
            pass
        self.session.groups.append(Group(kind, frames))

    def setup(self, name: str, *values: float) -> None:
        """Send one message that is not of a tick."""
        self.send(SETUP, self._wire.frame(name, *values))

    def command(self, operation: str) -> None:
        """Ask for a change of mode."""
        self._note_sent(lambda: self._link.command(operation))

    def tick(
        self,
        kind: str,
        pose: Sequence[float] | None = (0.0, 0.0, 0.0),
        wheel_speed: Sequence[float] | None = (0.0, 0.0, 0.0),
        ticks: int = 1,
    ) -> None:
        """Send the sensors, where there are any, and the SYNC of the tick that many ticks on."""
        self._tick += ticks
        counter = self._tick & 0xF
        frames, seals = [], []
        for name, values in (("POSE", pose), ("WHEEL_SPEED", wheel_speed)):
            if values is not None:
                frames.append(self._wire.frame(name, *values, counter))
            seals.append(0 if values is None else self._wire.codec[name].seal(frames[-1].data))
        frames.append(self._wire.frame("SYNC", self._tick, *seals))
        self.send(kind, *frames)

    def restart(self) -> None:
        """Drive again after a fault."""
        self.command("CLEAR")
        self._note_sent(self._link.start)


def random_states(script: Script, rng: np.random.Generator) -> None:
    """Poses and wheel speeds out of all that the wire can carry, most of them small."""
    for _ in range(RANDOM_TICKS):
        reach = 10.0 ** rng.uniform(-4.0, 0.0, size=2)
        pose = [*rng.uniform(-20.9, 20.9, size=2) * reach[0], rng.uniform(-np.pi, np.pi)]
        script.tick(TICK, pose, rng.uniform(-262.0, 262.0, size=3) * reach[1])
    script.tick(TICK, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))  # V = 0: no derivative


def what_goes_wrong(script: Script, robot: Robot) -> None:
    """Missing, late and unusable sensors, missed ticks, damaged frames, commands out of place."""
    nan, good = float("nan"), (0.1, 0.1, 0.1)
    script.tick(TICK)
    script.tick(TICK, pose=(nan, nan, nan))
    script.tick(TICK, wheel_speed=(nan, 0.0, 0.0))
    script.tick(FAULT, pose=(-20.0, -20.0, 0.0))  # too far off: the fault comes up in this tick
    script.tick(IDLE_TICK)
    script.restart()
    script.tick(TICK, wheel_speed=good)
    for _ in range(round(robot.parameter("wheel_speed_timeout_s").default / robot.control_period_s)):
        script.tick(TICK, wheel_speed=None)
    script.tick(FAULT, wheel_speed=None)  # stale
    script.restart()
    script.tick(FAULT, pose=None)  # never had one
    script.restart()
    most = round(robot.parameter("tick_gap_max").default)
    for missed in (1, most // 2, most):
        script.tick(TICK, wheel_speed=good)
        script.tick(AFTER_GAP, wheel_speed=good, ticks=missed + 1)
    script.tick(TICK, wheel_speed=good)
    script.tick(FAULT, wheel_speed=good, ticks=most + 2)
    script.restart()
    script.tick(TICK, wheel_speed=good)
    script.tick(IDLE_TICK, wheel_speed=good, ticks=0)  # asked again
    script.command("NONE")
    script.setup("PARAMETER_SET", 0, 1.0, 3)  # refused in motion, or a replay
    for field_of_it in range(8):
        script.setup("PARAMETER_GET", 4, field_of_it, 0)
    script.setup("PARAMETER_GET", 200, 0, 0)
    script.setup("TRAJECTORY_BEGIN", 100, 0, 4)
    script.setup("TRAJECTORY_DATA", 0, 1, 2, 3, 4, 5, 6)
    script.send(SETUP, FrameIn(0x040, bytes(7)), FrameIn(0x020, b"\x01"), FrameIn(0x050, b""), FrameIn(0x7F0, b""))
    script.command("STOP")
    for _ in range(BRAKING_TICKS):
        script.tick(BRAKING)


# ---- all of it


def sessions(orders: Sequence[str] = ORDERS) -> Iterator[Session]:
    """Make the corpus, or what of it concerns some orders, one session after the other."""
    wire, robot = Wire(), load_robot()
    paths = {name: (request, epsilon, plan(request)) for name, (request, epsilon) in requests().items()}
    for order, output, traction in product(orders, OUTPUTS, TRACTIONS):
        label = f"{order}, {output}, {traction}"
        for name, (request, epsilon, trajectory) in paths.items():
            scenario = Scenario(request, epsilon, order, output, traction)  # type: ignore[arg-type]  # of TRACTIONS
            yield closed_loop(f"{name}, {label}", scenario, trajectory, robot, wire)
        request, _, trajectory = paths["rounded"]
        for number, settings in enumerate(RANDOM_SETTINGS):
            told = dict(settings) | {"error_limit_m": "100"}
            scenario = Scenario(request, float(told.pop("epsilon")), order, output, traction, parameters=told)  # type: ignore[arg-type]
            session = Session(f"random {number}, {label}", order, output)
            with contextlib.closing(Script(wire, session, scenario, trajectory, robot)) as script:
                random_states(script, np.random.default_rng(SEED + number))
            yield session
        session = Session(f"faults, {label}", order, output)
        scenario = Scenario(request, 0.01, order, output, traction, parameters={"error_limit_m": "12"})  # type: ignore[arg-type]
        with contextlib.closing(Script(wire, session, scenario, trajectory, robot)) as script:
            what_goes_wrong(script, robot)
        yield session
