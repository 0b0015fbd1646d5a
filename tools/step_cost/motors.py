"""The tick of a robot that drives its own motors: paced by the port's timer, wheel speeds from its encoders.

The corpus is in lockstep, for that is what the host can repeat bit for bit. On the robot a tick is app_set_wheel_speed,
app_tick, and whatever frames have come; here a pose and the host's heartbeat come in each.
"""

import struct
from itertools import islice

from step_cost.corpus import NODE, ORDERS, TICK, FrameIn, Session, Wire, sessions
from step_cost.machine import INSTANCE
from step_cost.measure import Figures, Target, step_cost

KIND = "tick by the timer, own motors"


class MotorTicks:
    """Runs the first closed loop of each order as the robot itself would."""

    def __init__(self, target: Target) -> None:
        self._target, self._image = target, target.image
        codec = Wire().codec
        self._wheels, self._command = codec["WHEEL_SPEED"], codec["COMMAND"]
        drives = codec["IDENTITY"].choices["drive"]
        self._port = sum(1 << drive for drive in drives.values()) | drives["MOTORS"] << 8  # app_port_t: mask, drive
        operations = self._command.choices["operation"]
        self._told_to_drive = {f"USE_{drive}": operations[f"USE_{drive}"] for drive in drives}

    def measure(self) -> Figures:
        """Return the figures of the ticks, all orders together."""
        figures = Figures()
        for order in ORDERS:
            for session in islice(sessions((order,)), 1):
                self._run(session, figures)
        return figures

    def _run(self, session: Session, figures: Figures) -> None:
        robot, _ = self._image.objects["omnibot"]
        self._target.machine.call(self._image.function("app_init"), INSTANCE, robot, NODE, self._port)
        for group in session.groups:
            if group.kind == TICK:
                self._tick(group.frames)
                cost = self._target.blocks.cost(self._target.path())
                if step_cost(cost) is not None:
                    figures.add(cost.total)
            elif not self._chooses_drive(group.frames[0]):
                self._target.exchange(group.frames)

    def _chooses_drive(self, frame: FrameIn) -> bool:
        is_command = frame.identifier == self._command.arbitration_id
        return is_command and self._command.unpack(frame.data)[0] in self._told_to_drive.values()

    def _tick(self, frames: tuple[FrameIn, ...]) -> None:
        machine = self._target.machine
        speeds = [0.0, 0.0, 0.0]
        received = []
        for frame in frames:
            if frame.identifier == self._wheels.arbitration_id:
                speeds = list(self._wheels.unpack(frame.data)[:3])
            else:
                received.append(frame)

        def step() -> None:
            machine.begin_call()
            bits = [int.from_bytes(struct.pack("<f", speed), "little") for speed in speeds]
            machine.call_with_floats(self._image.function("app_set_wheel_speed"), bits, INSTANCE)
            machine.begin_call()
            machine.call(self._image.function("app_tick"), INSTANCE)

        self._target.exchange(received, step)
