"""What is known of a robot at an instant, as plain values in SI units; None is what the wire does not tell."""

import math
from dataclasses import asdict, dataclass
from typing import Any

Vector = tuple[float, ...]


@dataclass(frozen=True)
class Bus:
    """What goes over the bus.

    Attributes
    ----------
    load_fraction
        Of all nodes, over the last second by the clock, every bit stuffed that could be.
    silent_s, robot_silent_s
        Since the last frame of anybody, and of this robot.
    damaged_frames
        Of this node: a wrong length or checksum; as heard here, not by the robot.
    unknown_frames
        That are not of this protocol.
    error_frames
        That the adapter has told of.
    unheard_frames
        For which this machine was too slow.
    other_nodes
        Frames by node.
    trouble
        Why nothing can be heard, as the driver says; empty when all is well.
    """

    load_fraction: float
    frames_per_s: float
    frames: int
    silent_s: float
    robot_silent_s: float | None
    damaged_frames: int
    unknown_frames: int
    error_frames: int
    unheard_frames: int
    other_nodes: dict[int, int]
    trouble: str


@dataclass(frozen=True)
class Fault:
    """A latched fault: what it means, and what its FAULT_RECORD told if one was heard."""

    name: str
    text: str
    reaction: str | None
    count: int | None
    tick: int | None


@dataclass(frozen=True)
class Tracking:
    """How far the tracked point is from where it should be; ``unknown`` says why that is not known."""

    error_m: float | None
    heading_error_rad: float | None
    max_error_m: float | None
    reference: Vector | None
    unknown: str


@dataclass(frozen=True)
class Slip:
    """The firmware's fast variable, and the slip by pose and wheel speeds on the wire, means over 50 ms."""

    mu_m_per_s: Vector | None
    velocity_m_per_s: Vector | None
    ratio: Vector | None
    max_ratio: float | None


@dataclass(frozen=True)
class StepTime:
    """TIMING: of the last 100 ticks."""

    min_us: float | None
    mean_us: float | None
    max_us: float | None
    overruns: int


@dataclass(frozen=True)
class Health:
    """HEALTH: what a board knows of itself, and CRASH."""

    reset_cause: str
    clock_source: str
    can_state: str
    bridges_on: bool
    can_tx_errors: int
    can_rx_errors: int
    can_bus_offs: int
    can_rx_lost: int
    supply_V: float | None
    crash: str | None


@dataclass(frozen=True)
class Snapshot:
    """All of it.

    Attributes
    ----------
    clock_s
        By SYNC's ticks; by the bus' clock for a robot that moves its motors.
    drive_s
        Since START; None where its START was not heard or it does not drive.
    pace
        Seconds of the robot's time in one of the bus' clock.
    """

    node: int
    firmware: str | None
    protocol_matches: bool | None
    drive: str | None
    mode: str | None
    refusal: str | None
    faults: tuple[Fault, ...]
    tick: int | None
    clock_s: float
    drive_s: float | None
    pace: float | None
    pose: Vector | None
    speed_m_per_s: float | None
    yaw_rate_rad_per_s: float | None
    wheel_speed_rad_per_s: Vector | None
    torque_Nm: Vector | None
    max_torque_Nm: float | None
    torque_limit_Nm: float
    tracking: Tracking
    slip: Slip
    step_time: StepTime | None
    health: Health | None
    dropped_frames: int | None
    dropped_by_reason: dict[str, int] | None
    missed_ticks: int | None
    upload: str | None
    parameters: dict[str, float]
    bus: Bus

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON has it: what is not a number is None."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
