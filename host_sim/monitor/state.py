"""What a listener knows of one robot, by the frames that it has heard: fed frame by frame, without a clock or a bus."""

import math
import tomllib
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import can

from host_sim.codec import NODES, Codec, MessageCodec, WireError
from host_sim.errors import OmnibotError
from host_sim.monitor.driving import Driving, known
from host_sim.monitor.snapshot import Bus, Fault, Health, Snapshot, StepTime
from host_sim.monitor.traffic import Traffic
from host_sim.monitor.upload import Overheard
from host_sim.robot import ROOT, Robot

FAULTS_FILE = ROOT / "firmware" / "app" / "faults.toml"

EVENTS = 200
MISSED_S = 1.0  # after frames were missed, a START may be older than it looks
FIELD_VALUE = 0  # of PARAMETER_VALUE
OF_HOST = {
    *("COMMAND", "POSE", "WHEEL_SPEED", "SYNC", "PARAMETER_SET", "PARAMETER_GET"),
    *("TRAJECTORY_BEGIN", "TRAJECTORY_DATA", "HELLO"),
}

Values = tuple[float, ...]


class Event(NamedTuple):
    """Something that happened: the bus' time, in s, and words."""

    time_s: float
    text: str


def fault_texts(path: Path = FAULTS_FILE) -> dict[str, str]:
    """Read when each fault comes up."""
    try:
        faults = tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
        return {str(fault["name"]): str(fault["when"]) for fault in faults}
    except (OSError, tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise OmnibotError(f"cannot read the faults' names from {path}: {error}") from error


class MonitorState:
    """Feed it with frames, ask it for snapshots.

    Parameters
    ----------
    codec
        The wire, and the node to look at.
    robot
        Whose geometry and limits turn frames into slip, and into a tracked point.
    bit_rate
        Of the bus, bit/s: what the load is measured against.
    """

    def __init__(self, codec: Codec, robot: Robot, bit_rate: int = 1_000_000) -> None:
        self.codec, self.robot, self.bit_rate = codec, robot, bit_rate
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self.event_count = 0
        self.parameters: dict[str, float] = {}
        self.overheard = Overheard(robot.control_period_s)
        self.driving = Driving(codec, robot, self.overheard, self.parameter)
        self._texts = fault_texts()
        self._handlers: dict[str, Callable[[Values], None]] = {
            "COMMAND": self._on_command,
            "SYNC": self._on_sync,
            "TORQUE": self._on_torque,
            "SLIP": self._on_slip,
            "STATUS": self._on_status,
            "TIMING": self._on_timing,
            "HEALTH": self._on_health,
            "CRASH": self._on_crash,
            "DROPS": self._on_drops,
            "FAULT_RECORD": self._on_fault_record,
            "PARAMETER_VALUE": self._on_parameter_value,
            "TRAJECTORY_BEGIN": self._on_trajectory_begin,
            "TRAJECTORY_DATA": self._on_trajectory_data,
            "TRAJECTORY_ACK": self._on_trajectory_ack,
            "IDENTITY": self._on_identity,
        }
        # the bus
        self.trouble = ""
        self._traffic, self._ticks = Traffic(), Traffic()
        self._damaged_frames = self._unknown_frames = self._error_frames = self._unheard_frames = 0
        self._other_nodes: Counter[int] = Counter()
        self._time_s = self._robot_heard_s = self._missed_s = math.nan
        # the robot
        self.mode: str | None = None
        self.drive: str | None = None
        self._operation = ""
        self._drive_asked: str | None = None
        self._upload: str | None = None
        self._identity: dict[str, float] = {}
        self._status: dict[str, float] = {}
        self._records: dict[int, Values] = {}
        self._timing: Values | None = None
        self._health: dict[str, float] = {}
        self._crash: Values | None = None
        self._drops: dict[str, float] = {}

    # ---- frames

    def feed(self, time_s: float, frame: can.Message) -> None:
        """Take a frame that was heard at an instant by the bus' clock."""
        self._time_s = time_s
        if frame.is_error_frame:
            self._error_frames += 1
            return
        self._traffic.add(time_s, len(frame.data))
        if frame.is_extended_id or frame.is_remote_frame or frame.is_fd:
            self._unknown_frames += 1
            return
        message = self.codec.of_id(frame.arbitration_id)
        if message is None:
            self._note_stranger(frame.arbitration_id)
            return
        if message.name not in OF_HOST:
            self._robot_heard_s = time_s
        self._take(message, bytes(frame.data))

    def _note_stranger(self, arbitration_id: int) -> None:
        """Count a frame that is not of this node: another robot's, or none of ours."""
        node = arbitration_id & (NODES - 1)
        if self.codec.of_id(arbitration_id - node + self.codec.node) is not None:
            self._other_nodes[node] += 1
        else:
            self._unknown_frames += 1

    def _take(self, message: MessageCodec, data: bytes) -> None:
        try:
            values = message.unpack(data)
        except WireError:
            self._damaged_frames += 1
            return
        if message.name in ("POSE", "WHEEL_SPEED"):
            self.driving.take_sensor(message.name, data, values)
        handler = self._handlers.get(message.name)
        if handler is not None:
            handler(values)

    def lose(self, trouble: str) -> None:
        """Take note that the bus cannot be heard, or, with no words, that it can again; what was said is not known."""
        if trouble and not self.trouble:
            self.tell(f"the bus is lost: {trouble}")
        elif self.trouble and not trouble:
            self.tell("the bus is back")
        self.trouble = trouble
        self.overheard.forget()
        self.driving.lose()

    def miss(self, frames: int) -> None:
        """Take note that this machine was too slow for some frames: those of a START may have been among them."""
        self._unheard_frames += frames
        self._missed_s = self._time_s
        self.driving.miss()

    def tell(self, text: str) -> None:
        """Add an event."""
        self.events.append(Event(self._time_s, text))
        self.event_count += 1

    def parameter(self, name: str) -> float:
        """Return a parameter as it was heard; its default where it was not."""
        return self.parameters.get(name, self.robot.parameter(name).default)

    def _named(self, name: str, values: Values) -> dict[str, float]:
        return dict(zip((field.name for field in self.codec[name].fields), values, strict=True))

    @property
    def _by_ticks(self) -> bool:
        """Whether SYNC's ticks are the robot's time."""
        return self.drive != "MOTORS"

    # ---- each tick

    def _on_sync(self, values: Values) -> None:
        tick, pose_seal, speed_seal = map(int, values)
        if self.driving.take_sync(self._time_s, tick, pose_seal, speed_seal, by_ticks=self._by_ticks):
            self._ticks.add(self._time_s, 0)

    def _on_torque(self, values: Values) -> None:
        mode = self.codec["TORQUE"].label("mode", values[4])
        self._note_mode(mode)
        self.driving.take_torque(self._time_s, values[:3], mode, by_ticks=self._by_ticks)

    def _on_slip(self, values: Values) -> None:
        self.driving.mu = values[:3]

    # ---- mode and faults

    def _note_mode(self, mode: str) -> None:
        if mode == self.mode:
            return
        self.tell(f"mode {mode}" if self.mode is None else f"mode {self.mode} → {mode}")
        if mode == "TRACKING":
            missed = self._time_s - self._missed_s < MISSED_S
            self.driving.begin(heard=self.mode is not None and not missed)
        self.driving.note_mode(mode)
        self.mode = mode

    def _on_status(self, values: Values) -> None:
        before, status = self._status, self._named("STATUS", values)
        self._status = status
        refusal = self._refusal()
        if refusal != "NONE":
            self.tell(f"refused {self._operation or 'a command'}: {refusal}")
        elif self._drive_asked is not None:
            self.drive = self._drive_asked
        self._drive_asked = None
        self._note_mode(self.codec["STATUS"].label("mode", status["mode"]))
        self._note_faults(int(before.get("fault_mask", 0)), int(status["fault_mask"]))

    def _refusal(self) -> str | None:
        return self.codec["STATUS"].label("refusal", self._status["refusal"]) if self._status else None

    def _note_faults(self, before: int, mask: int) -> None:
        for number in _bits(mask & ~before):
            fault = self._fault(number)
            self.tell(f"fault {fault.name}: {fault.text}")
        if before and not mask:
            self.tell("faults cleared")
            self._records.clear()

    def _on_fault_record(self, values: Values) -> None:
        self._records[int(values[0])] = values

    def _faults(self) -> tuple[Fault, ...]:
        """Return the latched faults, the first cause first."""
        first = int(self._status.get("fault", 0))
        numbers = sorted(_bits(int(self._status.get("fault_mask", 0))), key=lambda number: number != first)
        return tuple(self._fault(number) for number in numbers)

    def _fault(self, number: int) -> Fault:
        name, record = self.codec["STATUS"].label("fault", number), self._records.get(number)
        text = self._texts.get(name, "not of this protocol")
        if record is None:
            return Fault(name, text, None, None, None)
        _, reaction, count, tick = record
        return Fault(name, text, self.codec["FAULT_RECORD"].label("reaction", reaction), int(count), int(tick))

    # ---- set-up and reports

    def _on_command(self, values: Values) -> None:
        self._operation = self.codec["COMMAND"].label("operation", values[0])
        self._drive_asked = self._operation.removeprefix("USE_") if self._operation.startswith("USE_") else None

    def _on_identity(self, values: Values) -> None:
        before, self._identity = self._identity, self._named("IDENTITY", values)
        self.drive = self.codec["IDENTITY"].label("drive", self._identity["drive"])
        if before.get("protocol_hash") != self._identity["protocol_hash"]:
            other = "" if self._protocol_matches() else ", of another protocol: what is shown may be wrong"
            self.tell(f"firmware {self._firmware()}{other}")

    def _firmware(self) -> str | None:
        parts = [f"{self._identity[part]:g}" for part in ("major", "minor", "patch") if self._identity]
        return ".".join(parts) or None

    def _protocol_matches(self) -> bool | None:
        return self._identity["protocol_hash"] == self.codec.protocol_hash if self._identity else None

    def _on_parameter_value(self, values: Values) -> None:
        index, _, field, value = values
        for parameter in self.robot.parameters:
            if parameter.index == index and field == FIELD_VALUE and math.isfinite(value):
                self.parameters[parameter.name] = value

    def _on_trajectory_begin(self, values: Values) -> None:
        self.overheard.begin(int(values[0]), int(values[1]))

    def _on_trajectory_data(self, values: Values) -> None:
        self.overheard.take(int(values[0]), bytes(map(int, values[1:])))

    def _on_trajectory_ack(self, values: Values) -> None:
        self._upload = self.codec["TRAJECTORY_ACK"].label("result", values[1])
        self.overheard.acknowledge(self._upload)
        if self._upload != "RECEIVING":
            self.tell(f"trajectory of {values[0]:g} bytes: {self._upload}")

    def _on_timing(self, values: Values) -> None:
        self._timing = values

    def _on_health(self, values: Values) -> None:
        self._health = self._named("HEALTH", values)

    def _on_crash(self, values: Values) -> None:
        self._crash = values
        self.tell(f"the run before ended in a crash at {self._crash_text()}")

    def _crash_text(self) -> str | None:
        return None if self._crash is None else f"pc {int(self._crash[0]):08X}, lr {int(self._crash[1]):08X}"

    def _on_drops(self, values: Values) -> None:
        self._drops = self._named("DROPS", values)

    # ---- snapshot

    def snapshot(self, now_s: float) -> Snapshot:
        """Return all that is known at an instant by the bus' clock; before the first frame, seconds of listening."""
        driving, motion = self.driving, self.driving.motion()
        return Snapshot(
            node=self.codec.node,
            firmware=self._firmware(),
            protocol_matches=self._protocol_matches(),
            drive=self.drive,
            mode=self.mode,
            refusal=self._refusal(),
            faults=self._faults(),
            tick=driving.tick,
            clock_s=driving.clock_s,
            drive_s=driving.drive_s(),
            pace=self._ticks.per_second(now_s)[0] * self.robot.control_period_s if driving.tick is not None else None,
            pose=driving.pose,
            speed_m_per_s=None if motion is None else motion.speed_m_per_s,
            yaw_rate_rad_per_s=None if motion is None else float(motion.twist[2]),
            wheel_speed_rad_per_s=driving.wheel_speed,
            torque_Nm=driving.torque,
            max_torque_Nm=known(driving.max_torque_Nm),
            torque_limit_Nm=self.parameter("torque_bound_Nm"),
            tracking=driving.tracking(),
            slip=driving.slip(),
            step_time=self._step_time(),
            health=self._health_now(),
            dropped_frames=int(self._status["dropped_frames"]) if self._status else None,
            dropped_by_reason={name: int(count) for name, count in self._drops.items()} or None,
            missed_ticks=int(self._status["missed_ticks"]) if self._status else None,
            upload=self._upload,
            parameters=dict(self.parameters),
            bus=self._bus(now_s),
        )

    def _step_time(self) -> StepTime | None:
        if self._timing is None:
            return None
        least, mean, largest, overruns = self._timing
        return StepTime(known(least), known(mean), known(largest), int(overruns))

    def _health_now(self) -> Health | None:
        if not self._health:
            return None
        health, message = self._health, self.codec["HEALTH"]
        return Health(
            reset_cause=message.label("reset_cause", health["reset_cause"]),
            clock_source=message.label("clock_source", health["clock_source"]),
            can_state=message.label("can_state", health["can_state"]),
            bridges_on=bool(health["bridges"]),
            can_tx_errors=int(health["can_tx_errors"]),
            can_rx_errors=int(health["can_rx_errors"]),
            can_bus_offs=int(health["can_bus_offs"]),
            can_rx_lost=int(health["can_rx_lost"]),
            supply_V=known(health["supply_V"]),
            crash=self._crash_text(),
        )

    def _bus(self, now_s: float) -> Bus:
        frames_per_s, bits_per_s = self._traffic.per_second(now_s)
        return Bus(
            load_fraction=bits_per_s / self.bit_rate,
            frames_per_s=frames_per_s,
            frames=self._traffic.frames,
            silent_s=now_s if math.isnan(self._time_s) else max(now_s - self._time_s, 0.0),
            robot_silent_s=known(max(now_s - self._robot_heard_s, 0.0)),
            damaged_frames=self._damaged_frames + self.driving.damaged_frames,
            unknown_frames=self._unknown_frames,
            error_frames=self._error_frames,
            unheard_frames=self._unheard_frames,
            other_nodes=dict(sorted(self._other_nodes.items())),
            trouble=self.trouble,
        )


def _bits(mask: int) -> list[int]:
    """Return the places of the bits that are set."""
    return [place for place in range(mask.bit_length()) if mask >> place & 1]
