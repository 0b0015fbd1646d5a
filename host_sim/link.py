"""The host's side of the wire: a session with one robot over any python-can bus."""

import contextlib
import errno
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np

from host_sim.bus_choice import BusChoice, choose_bus
from host_sim.busload import worst_case_bits
from host_sim.codec import NODES, Codec, WireError
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.pil import IMAGE_FILE, EmulatedBoard
from host_sim.robot import Parameter, Robot
from host_sim.serial_bus import open_serial
from host_sim.socketcan import PromptSocketcanBus

# A tick that is not answered is asked again this often; the firmware answers a repeated tick without a second step.
REPEAT_S = 0.2
# A frame takes 0.1 ms of a bus at 1 Mbit/s.
ROOM_S = 0.0005
ANSWER_FRAMES = 2
FIELD_VALUE = 0  # of PARAMETER_GET
TRAJECTORY_FRAME_BYTES = 6
TRAJECTORY_ACK_FRAMES = 16

# A host that drives is heard more often than this, or the firmware takes it for gone (HOST_SILENT).
LISTEN_S = 0.1
DRIVING_HOST = ("COMMAND", "POSE", "WHEEL_SPEED", "SYNC", "TRAJECTORY_BEGIN", "TRAJECTORY_DATA")
OTHER_HOST = "does another host use it? Give each run a node of its own with --node"

FrameRecord = tuple[float, int, bytes]


class SilentError(OmnibotError):
    """The firmware did not answer in time."""


class RefusedError(OmnibotError):
    """The firmware answered that it will not."""


class Identity(NamedTuple):
    """Who answered."""

    protocol_hash: int
    version: str


class Answer(NamedTuple):
    """What the firmware said to a tick."""

    torque_Nm: tuple[float, float, float]
    mu_m_per_s: tuple[float, float, float]
    mode: str


class Patience:
    """A span of time that begins when it is first looked at.

    What is answered at once never looks: under User-Mode Linux a reading of the clock costs as much as half a frame.
    """

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._end_s: float | None = None

    def left_s(self) -> float:
        """Return what is left of it."""
        now_s = time.monotonic()
        if self._end_s is None:
            self._end_s = now_s + self._span_s
        return self._end_s - now_s


class BusStatistics:
    """Frames that went over the bus in both directions, and the time that they would take on the wire."""

    def __init__(self) -> None:
        self.frames = 0
        self.bits = 0

    def add(self, length_bytes: int) -> None:
        """Count a frame of so many data bytes, worst-case stuffing included."""
        self.frames += 1
        self.bits += worst_case_bits(length_bytes)

    def load_fraction(self, duration_s: float, bit_rate: float = 1e6) -> float:
        """Share of the bus taken over a time."""
        return self.bits / (bit_rate * duration_s) if duration_s > 0.0 else 0.0


class Link:
    """A session with the robot of one node.

    Parameters
    ----------
    bus
        Any python-can bus; the link does not close it.
    codec
        The wire and the node.
    timeout_s
        How long, by the wall clock, the firmware may be silent.
    record
        Called with every frame sent and received: simulated time in s, identifier, payload.
    repeat_s
        What is not answered is asked again this often, by the wall clock (default: every 0.2 s).
    """

    def __init__(
        self,
        bus: can.BusABC,
        codec: Codec,
        timeout_s: float = 2.0,
        record: Callable[[FrameRecord], None] | None = None,
        repeat_s: float | None = None,
    ) -> None:
        self.bus = bus
        self.codec = codec
        self.timeout_s = timeout_s
        self.repeat_s = min(REPEAT_S if repeat_s is None else repeat_s, timeout_s)
        self.time_s = 0.0
        self.statistics = BusStatistics()
        self.status: dict[str, float] = {}
        self.cleared_faults: list[str] = []  # that ``hello`` found latched
        # Other robots' frames are none of ours: they would fill the log and the queue.
        bus.set_filters([{"can_id": codec.node, "can_mask": NODES - 1, "extended": False}])
        self._record = record
        self._counter = 0
        self._key: int | None = None
        self._hellos = self._identities = 0  # sent, and answers to them
        self._robot_checksum: int | None = None
        self._seals = (0, 0)  # of the sensor frames that went out last
        self._dropped_before = 0
        self.forget_rounding()
        self._pose, self._wheels, self._sync = codec["POSE"], codec["WHEEL_SPEED"], codec["SYNC"]
        self._torque, self._slip = codec["TORQUE"], codec["SLIP"]
        self._speed_step = self._wheels.fields[0].unit_per_step

    # ---- frames

    def send(self, name: str, *values: float) -> None:
        """Send a message of the wire, its fields in their order."""
        message = self.codec[name]
        self.send_frame(message.arbitration_id, message.pack(*values))

    def send_frame(self, arbitration_id: int, data: bytes) -> None:
        """Send a frame as it is; where the bus has no room, wait for it."""
        message = can.Message(arbitration_id=arbitration_id, is_extended_id=False, data=data)
        patience = Patience(self.timeout_s)
        while True:
            try:
                self.bus.send(message, timeout=self.timeout_s)
                break
            except can.CanError as error:
                # A SocketCAN interface queues ten frames, and python-can does not wait for room.
                if error.error_code != errno.ENOBUFS or patience.left_s() <= 0.0:
                    raise self._failed("send on", error) from error
            time.sleep(ROOM_S)
        self._note(arbitration_id, data)

    def _take(self, wait_s: float) -> can.Message | None:
        try:
            return self.bus.recv(wait_s)
        except can.CanError as error:
            raise self._failed("receive from", error) from error

    def _failed(self, verb: str, error: can.CanError) -> OmnibotError:
        down = error.error_code == errno.ENETDOWN
        cure = "; bring it up: sudo ip link set INTERFACE up, and a real one with: type can bitrate 1000000"
        return OmnibotError(f"cannot {verb} {self.bus.channel_info}: {error}{cure if down else ''}")

    def receive_frame(self, wait_s: float) -> tuple[int, bytes] | None:
        """Return identifier and payload of the next frame that comes in time; None when none does."""
        message = self._take(wait_s)
        if message is None:
            return None
        data = bytes(message.data)
        self._note(message.arbitration_id, data)
        return message.arbitration_id, data

    def _note(self, arbitration_id: int, data: bytes) -> None:
        self.statistics.add(len(data))
        if self._record is not None:
            self._record((self.time_s, arbitration_id, data))

    def _note_status(self, arbitration_id: int, data: bytes) -> None:
        """Keep the newest STATUS, the key of ARM, and who is there, whatever we wait for."""
        if arbitration_id == self.codec["STATUS"].arbitration_id:
            # A peer of another protocol may send anything by this name; hello tells the user about it.
            with contextlib.suppress(WireError):
                self.status = self.codec["STATUS"].named(data)
        elif arbitration_id == self.codec["CHALLENGE"].arbitration_id:
            with contextlib.suppress(WireError):
                self._key = int(self.codec["CHALLENGE"].named(data)["key"])
        elif arbitration_id == self.codec["IDENTITY"].arbitration_id:
            self._identities += 1
        elif arbitration_id == self.codec["PARAMETER_STORE"].arbitration_id:
            with contextlib.suppress(WireError):
                self._robot_checksum = int(self.codec["PARAMETER_STORE"].named(data)["robot_checksum"])

    def _silent(self, waiting_for: str) -> SilentError:
        sil = f"is the firmware running there? (omnibot-sil --can INTERFACE --node {self.codec.node})"
        return SilentError(
            f"no {waiting_for} from node {self.codec.node} on {self.bus.channel_info} within {self.timeout_s:g} s: "
            + getattr(self.bus, "cure", sil)
        )

    def wait_for(self, name: str, timeout_s: float | None = None) -> dict[str, float]:
        """Return the next message of a name; SilentError when none comes in time."""
        wanted = self.codec[name]
        deadline = time.monotonic() + (self.timeout_s if timeout_s is None else timeout_s)
        while (left := deadline - time.monotonic()) > 0.0:
            received = self.receive_frame(min(left, self.repeat_s))
            if received is None:
                continue
            self._note_status(*received)
            if received[0] == wanted.arbitration_id:
                return wanted.named(received[1])
        raise self._silent(name)

    def _next_counter(self) -> int:
        self._counter = (self._counter + 1) & 0xF
        return self._counter

    # ---- before and after the drive

    def hello(self, pace: str = "lockstep") -> Identity:
        """Make sure that a firmware is there that speaks our protocol, and put it into IDLE without faults.

        ``pace`` is ``lockstep`` or ``realtime``: what it is to step by. Its own motors, if it has any, are off then.
        """
        self._drain()
        self._refuse_second_host()
        identity = self.greet()
        self.command("STOP")
        self._wait_for_rest()
        self.cleared_faults = self.faults()
        self.command("CLEAR")
        self._use(pace)
        self._refuse_two_robots()
        self._dropped_before = int(self.status.get("dropped_frames", 0))
        return identity

    def greet(self) -> Identity:
        """Begin a session with a firmware that speaks our protocol; in lockstep it lets go if it was driving."""
        self._drain()
        identity = self._identity()
        theirs = int(identity["protocol_hash"])
        if theirs != self.codec.protocol_hash:
            raise OmnibotError(
                f"node {self.codec.node} speaks protocol {theirs:08X}, this host {self.codec.protocol_hash:08X}: "
                "rebuild the firmware from this protocol/omnibot.dbc (tools/build host) and start it again"
            )
        major, minor, patch = (int(identity[part]) for part in ("major", "minor", "patch"))
        return Identity(theirs, f"{major}.{minor}.{patch}")

    def _refuse_second_host(self) -> None:
        """Before the first word, make sure that nobody drives this robot: our HELLO would end that drive.

        A host on this machine has claimed it, and may pause for as long as it likes; one elsewhere is heard.
        """
        claim: Callable[[int], bool] | None = getattr(self.bus, "claim", None)
        if (claim is None or claim(self.codec.node)) and not self._hears_a_host():
            return
        raise OmnibotError(
            f"another host drives node {self.codec.node} on {self.bus.channel_info}: wait until it is done, or give "
            "this run a robot of its own with --node"
        )

    def _hears_a_host(self) -> bool:
        """Listen for frames that drive our robot, for as long as its host can be silent without losing it."""
        if getattr(self.bus, "is_ours_alone", False):
            return False
        deadline = time.monotonic() + LISTEN_S
        while (left := deadline - time.monotonic()) > 0.0:
            message = self._take(left)
            heard = self.codec.of_id(message.arbitration_id) if message is not None and message.is_rx else None
            if heard is not None and heard.name in DRIVING_HOST:
                return True
        return False

    def _refuse_two_robots(self) -> None:
        """By now every robot has answered HELLO; more answers than questions are those of two."""
        if self._identities > self._hellos:
            raise OmnibotError(
                f"two robots are node {self.codec.node} on {self.bus.channel_info}: end one of them, an omnibot-sil "
                "that was left running perhaps, or give each a --node of its own"
            )

    def check_robot(self, robot: Robot) -> None:
        """Make sure that the firmware said in ``hello`` to be made of the file that a robot was read from."""
        if self._robot_checksum is None:
            raise self._silent("PARAMETER_STORE")
        if self._robot_checksum != robot.checksum:
            raise RefusedError(
                f"node {self.codec.node} is built for another robot ({self._robot_checksum:08X}) than {robot.file} "
                f"({robot.checksum:08X}): build it for this one (cmake --preset host -DOMNIBOT_ROBOT={robot.file} && "
                "cmake --build --preset host; a board: --preset board), or name its own file with --robot"
            )

    def _wait_for_rest(self) -> None:
        """Wait until a robot that was still driving, for another host, has braked."""
        while self.mode() == "STOPPING":
            self.wait_for("STATUS")

    def _use(self, pace: str) -> None:
        """Have the robot take its sensors from us, and step as ``pace`` says."""
        try:
            self.command(f"USE_{pace.upper()}")
        except RefusedError as error:
            if "UNABLE" not in str(error):
                raise
            raise RefusedError(
                f"node {self.codec.node} on {self.bus.channel_info} cannot step in {pace}: "
                f"start it as omnibot-sil --can INTERFACE --time {pace}"
            ) from error

    def _identity(self) -> dict[str, float]:
        """Ask who is there until somebody answers: a firmware that was just started may not listen yet."""
        deadline = time.monotonic() + self.timeout_s
        self._hellos = self._identities = 0
        while time.monotonic() < deadline:
            self.send("HELLO", self.codec.protocol_hash)
            self._hellos += 1
            with contextlib.suppress(SilentError):
                return self.wait_for("IDENTITY", self.repeat_s)
        raise self._silent("IDENTITY")

    def _drain(self) -> None:
        """Read what came before we ask, so that it is not taken for the answer."""
        deadline = time.monotonic() + self.timeout_s
        while (received := self.receive_frame(0.0)) is not None:
            self._note_status(*received)
            if time.monotonic() > deadline:
                raise OmnibotError(
                    f"node {self.codec.node} on {self.bus.channel_info} never falls silent: {OTHER_HOST}"
                )

    def start(self) -> None:
        """Have the robot drive: ARM it, and START with the key that it gives; RefusedError says why not."""
        self._drain()
        self._key = None
        self._ask_for("ARM")
        self._await_status("ARM")  # CHALLENGE comes before it
        if self._key is None:
            raise self._silent("CHALLENGE")
        self._ask_for("START", self._key)
        self._await_status("START")

    def command(self, operation: str, timeout_s: float | None = None) -> None:
        """Ask for a change of mode; RefusedError says why not."""
        self._drain()
        self._ask_for(operation)
        self._await_status(operation, timeout_s)

    def _ask_for(self, operation: str, key: int = 0) -> None:
        self.send("COMMAND", self.codec["COMMAND"].choices["operation"][operation], self._next_counter(), key)

    def _await_status(self, operation: str, timeout_s: float | None = None) -> None:
        # A STATUS that was under way before the command may come before the one that answers it.
        wanted = {"ARM": "ARMED", "START": "TRACKING", "CLEAR": "IDLE"}.get(operation)
        status = self.codec["STATUS"]
        while True:
            answer = self.wait_for("STATUS", timeout_s)
            refusal = status.label("refusal", answer["refusal"])
            mode = status.label("mode", answer["mode"])
            if refusal != "NONE":
                raise RefusedError(f"the firmware refused {operation}: {refusal} (mode {mode})")
            if wanted is None or mode == wanted:
                return

    def set_parameter(self, parameter: Parameter, value: float) -> None:
        """Set a firmware parameter and check that it was taken."""
        self.request_parameter(parameter, parameter.check(value))

    def request_parameter(self, parameter: Parameter, value: float) -> None:
        """Set a firmware parameter to a value that the firmware alone judges; RefusedError has its reason and range."""
        self.send("PARAMETER_SET", parameter.index, value, self._next_counter())
        answer = self.wait_for("PARAMETER_VALUE")
        result = self.codec["PARAMETER_VALUE"].label("result", answer["result"])
        if result != "OK":
            raise RefusedError(f"the firmware refused {parameter.name} = {value:g}: {result}{_why(result, parameter)}")
        self._check_held(parameter, value, answer)

    def check_parameter(self, parameter: Parameter, value: float) -> None:
        """Make sure that the firmware holds a value: another host may have set another one meanwhile."""
        self.send("PARAMETER_GET", parameter.index, FIELD_VALUE, 0)
        self._check_held(parameter, value, self.wait_for("PARAMETER_VALUE"))

    def _check_held(self, parameter: Parameter, value: float, answer: Mapping[str, float]) -> None:
        held = answer["value"]
        if answer["index"] != parameter.index or held != float(np.float32(value)):
            raise RefusedError(f"node {self.codec.node} holds {parameter.name} = {held:g}, not {value:g}: {OTHER_HOST}")

    def upload(self, trajectory: bytes) -> None:
        """Send a trajectory and wait until the firmware has checked it."""
        self.send("TRAJECTORY_BEGIN", len(trajectory), zlib.crc32(trajectory), self._next_counter())
        self._expect_ack("RECEIVING")
        step = TRAJECTORY_FRAME_BYTES
        for frame, offset in enumerate(range(0, len(trajectory), step), start=1):
            self.send("TRAJECTORY_DATA", offset, *trajectory[offset : offset + step].ljust(step, b"\0"))
            if offset + step >= len(trajectory):
                self._expect_ack("COMPLETE")
            elif frame % TRAJECTORY_ACK_FRAMES == 0:
                self._expect_ack("RECEIVING")

    def _expect_ack(self, wanted: str) -> None:
        answer = self.wait_for("TRAJECTORY_ACK")
        result = self.codec["TRAJECTORY_ACK"].label("result", answer["result"])
        if result != wanted:
            raise RefusedError(f"the firmware refused the trajectory at byte {answer['offset_bytes']:g}: {result}")

    @property
    def dropped(self) -> int:
        """Frames that the firmware dropped since ``hello``, by its newest STATUS."""
        return int(self.status.get("dropped_frames", 0)) - self._dropped_before

    def mode(self) -> str:
        """Return the mode in the newest STATUS."""
        return self.codec["STATUS"].label("mode", self.status.get("mode", 0))

    def fault(self) -> str:
        """Return the name of the fault in the newest STATUS."""
        return self.codec["STATUS"].label("fault", self.status.get("fault", 0))

    def faults(self) -> list[str]:
        """Return the names of all faults that are latched by the newest STATUS."""
        mask = int(self.status.get("fault_mask", 0))
        return [self.codec["STATUS"].label("fault", bit) for bit in range(mask.bit_length()) if mask >> bit & 1]

    # ---- the drive

    def tick(self, tick: int, pose: Sequence[float] | None, wheel_speed: Sequence[float]) -> Answer:
        """Send the sensors and SYNC of a tick and return the answer; asks again while there is none.

        Parameters
        ----------
        tick
            Control tick, 0 … 2^32 - 1.
        pose
            x1, x2 in m and heading in rad, -pi … pi; None: no pose frame goes out in this tick.
        wheel_speed
            Three wheel speeds, rad/s.
        """
        counter = tick & 0xF
        self.send_sensors(tick, pose, wheel_speed)
        sync = self._sync.pack(tick, *self._seals)
        patience = Patience(self.timeout_s - self.repeat_s)
        while True:
            self.send_frame(self._sync.arbitration_id, sync)
            answer = self._answer(counter)
            if answer is not None:
                return answer
            if patience.left_s() <= 0.0:
                break
        raise self._silent(f"TORQUE for tick {tick}")

    def send_sensors(self, tick: int, pose: Sequence[float] | None, wheel_speed: Sequence[float]) -> None:
        """Send the sensor frames of a tick: see ``tick``."""
        counter = tick & 0xF
        pose_seal = 0
        if pose is not None:
            data = self._pose.pack(*pose, counter)
            pose_seal = self._pose.seal(data)
            self.send_frame(self._pose.arbitration_id, data)
        data = self._wheels.pack(*self._carried(wheel_speed), counter)
        self._seals = pose_seal, self._wheels.seal(data)
        self.send_frame(self._wheels.arbitration_id, data)

    def send_sync(self, tick: int) -> None:
        """Send a tick, with its sensor frames sent before, without waiting for its answer."""
        self.send_frame(self._sync.arbitration_id, self._sync.pack(tick, *self._seals))

    def forget_rounding(self) -> None:
        """Start carrying over the rounding of wheel speeds from nothing."""
        self._speed_rest = [0.0, 0.0, 0.0]

    def hear(self, wait_s: float) -> tuple[str, dict[str, float]] | None:
        """Return name and values of the next message that comes in time; None when none does. STATUS is kept, too."""
        received = self.receive_frame(wait_s)
        if received is None:
            return None
        self._note_status(*received)
        message = self.codec.of_id(received[0])
        try:
            return ("", {}) if message is None else (message.name, message.named(received[1]))
        except WireError:
            return "", {}  # damaged on the way, or of another protocol

    def _carried(self, wheel_speed: Sequence[float]) -> list[float]:
        """Add to wheel speeds what rounding took from the frames before, so that their sum over time is true.

        Without it a steady speed is wrong by the same part of a step in every frame, and dead reckoning drifts.
        """
        wanted = [speed + rest for speed, rest in zip(wheel_speed, self._speed_rest, strict=True)]
        step = self._speed_step
        self._speed_rest = [speed - step * round(speed / step) if isfinite(speed) else 0.0 for speed in wanted]
        return wanted

    def _answer(self, counter: int) -> Answer | None:
        """Collect TORQUE and SLIP of a tick; None if they do not come. Answers to earlier ticks are passed over."""
        torque: tuple[float, ...] | None = None
        slip: tuple[float, ...] | None = None
        patience, frames = Patience(self.repeat_s), 0
        while torque is None or slip is None:
            # The first two are the answer, as a rule. Others on the bus must not put off the next asking.
            left_s = self.repeat_s if frames < ANSWER_FRAMES else patience.left_s()
            received = self.receive_frame(left_s) if left_s > 0.0 else None
            if received is None:
                return None
            frames += 1
            arbitration_id, data = received
            try:
                if arbitration_id == self._torque.arbitration_id:
                    values = self._torque.unpack(data)
                    torque = values if values[3] == counter else torque
                elif arbitration_id == self._slip.arbitration_id:
                    values = self._slip.unpack(data)
                    slip = values if values[3] == counter else slip
                else:
                    self._note_status(arbitration_id, data)
            except WireError:
                continue  # damaged on the way: the tick is asked again
        mode = self._torque.label("mode", torque[4])
        return Answer((torque[0], torque[1], torque[2]), (slip[0], slip[1], slip[2]), mode)


def _why(result: str, parameter: Parameter) -> str:
    """Return what would be right where the firmware's reason alone does not say it."""
    if result == "OUT_OF_RANGE":
        return f"; it takes {parameter.range_text()}{', whole numbers only' if parameter.integer else ''}"
    return "; parameters change only at rest: stop the robot first" if result == "IN_MOTION" else ""


def is_can_interface(name: str, root: Path = Path("/")) -> bool:
    """Tell whether the machine whose files are below a root has a CAN interface of that name (ARPHRD_CAN is 280)."""
    if name in ("", ".", "..") or "/" in name:
        return False
    try:
        return (root / "sys/class/net" / name / "type").read_text().strip() == "280"
    except OSError:
        return False


def open_bus(name: str, node: int, interface: str | None, channel: str | None, bitrate: int | None) -> can.BusABC:
    """Open the bus that the command line names.

    Parameters
    ----------
    name
        ``inproc``, ``pil``, ``can``, or the name of a SocketCAN interface such as ``vcan0``.
    interface, channel, bitrate
        python-can's own; given, they are used instead of ``name``. With ``pil``, a channel is the image to run; of the
        interface ``omnibot`` it is the library.
    """
    choice = choose_bus(name, interface, channel, bitrate)
    if choice.interface is None and choice.name == "pil":
        return EmulatedBoard(IMAGE_FILE if choice.channel is None else Path(str(choice.channel)))
    if choice.interface == "slcan":
        return open_serial(choice.channel, choice.bitrate, **choice.others)
    make, options = _bus_of(choice, node)
    try:
        return make(**options)
    except OmnibotError:
        raise
    except Exception as error:  # whatever the driver of some adapter raises
        raise OmnibotError(
            f"cannot open the bus {options}: {error or type(error).__name__}; is it plugged in, and up? "
            "omnibot doctor tells what is there"
        ) from error


def _bus_of(choice: BusChoice, node: int) -> tuple[Callable[..., can.BusABC], dict[str, Any]]:
    """Return what makes a bus, and its options."""
    if choice.interface is not None:
        named = {"interface": choice.interface, "channel": choice.channel, "bitrate": choice.bitrate}
        options = {key: value for key, value in named.items() if value is not None} | dict(choice.others)
        if choice.interface == "socketcan" and choice.channel is not None:
            del options["interface"]
            return PromptSocketcanBus, options
        return can.Bus, options | ({"node": node} if choice.interface == "omnibot" else {})
    if choice.name == "inproc":
        return InprocBus, {"node": node}
    if is_can_interface(choice.name):
        return PromptSocketcanBus, {"channel": choice.name}
    raise OmnibotError(
        f"no bus {choice.name!r}: 'inproc', 'pil', 'can' (python-can's configuration), or a SocketCAN interface "
        "that is up; tools/with-vcan -- COMMAND makes a vcan0"
    )
