"""A snapshot in words: rows for a screen, one line for a pipe."""

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from host_sim.monitor.snapshot import Bus, Fault, Snapshot

SILENT_S = 1.0  # ten STATUS frames of a robot that has anything to say
NOTHING = "-"


class Mood(Enum):
    """How a row should catch the eye."""

    PLAIN = ""
    GOOD = "bold green"
    WARNING = "bold yellow"
    ALARM = "bold red"


class Row(NamedTuple):
    """A name, what is known, and whether it is to be noticed."""

    name: str
    text: str
    mood: Mood = Mood.PLAIN


def rows(snapshot: Snapshot, bit_rate: int = 1_000_000) -> list[Row]:
    """Return all there is to see of a snapshot, the most pressing first."""
    parts = [
        *_notice(snapshot),
        _mode(snapshot),
        *(Row("fault", _fault(fault), Mood.ALARM) for fault in snapshot.faults),
        Row("pose", _pose(snapshot)),
        _error(snapshot),
        Row("slip", _slip(snapshot)),
        Row("mu", _vector(snapshot.slip.mu_m_per_s, 1e3, "mm/s", "z.1f")),
        _torque(snapshot),
        _step_time(snapshot),
        _bus(snapshot, bit_rate),
        _dropped(snapshot),
        _heard(snapshot.bus),
        *_board(snapshot),
        *_others(snapshot.bus),
    ]
    return [part for part in parts if part.text]


def page(snapshot: Snapshot, bit_rate: int = 1_000_000) -> str:
    """Return a snapshot as lines of text."""
    return "\n".join(f"{row.name:<10}{row.text}" for row in rows(snapshot, bit_rate))


def line(snapshot: Snapshot) -> str:
    """Return a snapshot in one line."""
    said = notice(snapshot)
    if snapshot.mode is None or snapshot.bus.trouble:
        return said or "node has told nothing of its mode yet"
    tracking, pose = snapshot.tracking, snapshot.pose
    parts = [
        snapshot.mode,
        f"fault {', '.join(fault.name for fault in snapshot.faults)}" if snapshot.faults else "",
        "" if snapshot.drive_s is None else f"{snapshot.drive_s:.2f} s",
        "" if pose is None else f"at {pose[0]:z.3f} {pose[1]:z.3f} m {pose[2]:z.3f} rad",
        "" if snapshot.speed_m_per_s is None else f"{snapshot.speed_m_per_s:.3f} m/s",
        "" if tracking.error_m is None else f"error {1e3 * tracking.error_m:.3f} mm",
        "" if snapshot.slip.ratio is None else f"slip {max(map(abs, snapshot.slip.ratio)):.3f}",
        "" if snapshot.torque_Nm is None else f"torque {max(map(abs, snapshot.torque_Nm)):.3f} N*m",
        f"bus {snapshot.bus.load_fraction:.0%}",
        f"dropped {snapshot.dropped_frames}" if snapshot.dropped_frames else "",
        f"damaged {snapshot.bus.damaged_frames}" if snapshot.bus.damaged_frames else "",
        said,
    ]
    return ", ".join(part for part in parts if part)


def notice(snapshot: Snapshot) -> str:
    """Say why there is nothing new to see, and what would help; empty where all is well."""
    bus, node = snapshot.bus, snapshot.node
    if bus.trouble:
        return f"no bus, trying again: {bus.trouble}"
    if bus.frames == 0:
        if bus.silent_s < SILENT_S:
            return "listening"
        return f"silent bus: not a frame in {bus.silent_s:.0f} s; is the robot on, and the bit rate right?"
    if bus.robot_silent_s is None:
        others = ", ".join(str(other) for other in bus.other_nodes)
        hint = f"frames of node {others} are there: try --node" if others else "is the robot on?"
        return f"nothing of node {node} among {bus.frames} frames; {hint}"
    if bus.robot_silent_s > SILENT_S:
        asked = " (in lockstep a robot speaks when it is asked)" if snapshot.drive in ("LOCKSTEP", None) else ""
        return f"node {node} silent for {bus.robot_silent_s:.0f} s{asked}"
    if snapshot.protocol_matches is False:
        return f"node {node} speaks another protocol than this omnibot.dbc: what is shown may be wrong"
    return ""


def _notice(snapshot: Snapshot) -> list[Row]:
    return [Row("notice", notice(snapshot), Mood.WARNING)]


def _mode(snapshot: Snapshot) -> Row:
    mode = snapshot.mode
    moods = {"TRACKING": Mood.GOOD, "STOPPING": Mood.WARNING, "ARMED": Mood.WARNING, "FAULT": Mood.ALARM}
    since = "" if snapshot.drive_s is None else f"for {snapshot.drive_s:.2f} s"
    refused = "" if snapshot.refusal in (None, "NONE") else f"refused: {snapshot.refusal}"
    version = "" if snapshot.firmware is None else f"firmware {snapshot.firmware}"
    drive = snapshot.drive or ""
    words = [f"{mode or NOTHING} {since}".strip(), drive, refused, f"node {snapshot.node}", version]
    return Row("mode", ", ".join(word for word in words if word), moods.get(mode or "", Mood.PLAIN))


def _fault(fault: Fault) -> str:
    if fault.reaction is None:
        return f"{fault.name}: {fault.text}"
    times = "once" if fault.count == 1 else f"{fault.count} times"
    return f"{fault.name}: {fault.text} ({fault.reaction.lower()}, tick {fault.tick}, {times})"


def _pose(snapshot: Snapshot) -> str:
    if snapshot.pose is None:
        return NOTHING
    x, y, heading = snapshot.pose
    place = f"{x:z.3f} {y:z.3f} m, heading {heading:z.3f} rad ({math.degrees(heading):z.1f} deg)"
    if snapshot.speed_m_per_s is None or snapshot.yaw_rate_rad_per_s is None:
        return place
    return f"{place}; {snapshot.speed_m_per_s:.3f} m/s, {snapshot.yaw_rate_rad_per_s:z.3f} rad/s"


def _error(snapshot: Snapshot) -> Row:
    tracking = snapshot.tracking
    largest = "" if tracking.max_error_m is None else f"largest {1e3 * tracking.max_error_m:.3f} mm"
    if tracking.error_m is None or tracking.heading_error_rad is None:
        return Row("error", "; ".join(part for part in (f"{NOTHING} ({tracking.unknown})", largest) if part))
    return Row("error", f"{1e3 * tracking.error_m:.3f} mm, {1e3 * tracking.heading_error_rad:z.2f} mrad; {largest}")


def _slip(snapshot: Snapshot) -> str:
    slip = snapshot.slip
    if slip.velocity_m_per_s is None:
        return f"{NOTHING} (no wheel speeds on the bus)" if snapshot.drive == "MOTORS" else NOTHING
    ratio = "ratio - (too slow)" if slip.ratio is None else f"ratio {_numbers(slip.ratio, 'z.4f')}"
    largest = "" if slip.max_ratio is None else f"; largest {slip.max_ratio:.3f}"
    return f"{ratio}; {_vector(slip.velocity_m_per_s, 1e3, 'mm/s', 'z.1f')}{largest}"


def _torque(snapshot: Snapshot) -> Row:
    if snapshot.torque_Nm is None:
        return Row("torque", NOTHING)
    share = max(map(abs, snapshot.torque_Nm)) / snapshot.torque_limit_Nm if snapshot.torque_limit_Nm else math.inf
    largest = "" if snapshot.max_torque_Nm is None else f"; largest {snapshot.max_torque_Nm:.3f}"
    text = f"{_numbers(snapshot.torque_Nm, 'z.4f')} N*m, {share:.0%} of {snapshot.torque_limit_Nm:.3g}{largest}"
    return Row("torque", text, Mood.WARNING if share > 0.999 and snapshot.mode == "TRACKING" else Mood.PLAIN)


def _step_time(snapshot: Snapshot) -> Row:
    step = snapshot.step_time
    if step is None or step.mean_us is None:
        return Row("step time", f"{NOTHING} (not told in lockstep)" if snapshot.drive == "LOCKSTEP" else NOTHING)
    text = f"mean {step.mean_us:.1f} us, {step.min_us:.1f} to {step.max_us:.1f}; {step.overruns} overruns"
    return Row("step time", text, Mood.WARNING if step.overruns else Mood.PLAIN)


def _bus(snapshot: Snapshot, bit_rate: int) -> Row:
    bus = snapshot.bus
    pace = "" if not snapshot.pace else f"; ticks at {snapshot.pace:.2f} times real time"
    return Row("bus", f"{bus.load_fraction:.1%} of {bit_rate / 1e6:g} Mbit/s, {bus.frames_per_s:.0f} frames/s{pace}")


def _dropped(snapshot: Snapshot) -> Row:
    if snapshot.dropped_frames is None:
        return Row("dropped", NOTHING)
    reasons = snapshot.dropped_by_reason or {}
    told = ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
    missed = f"; {snapshot.missed_ticks} ticks missed" if snapshot.missed_ticks else ""
    text = f"{snapshot.dropped_frames} frames by the robot{f' ({told})' if told else ''}{missed}"
    return Row("dropped", text, Mood.WARNING if snapshot.dropped_frames or snapshot.missed_ticks else Mood.PLAIN)


def _heard(bus: Bus) -> Row:
    counts = {
        "damaged": bus.damaged_frames,
        "unknown": bus.unknown_frames,
        "error frames": bus.error_frames,
        "not heard, too fast for this machine": bus.unheard_frames,
    }
    odd = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    return Row("heard", f"{bus.frames} frames{f': {odd}' if odd else ''}", Mood.WARNING if odd else Mood.PLAIN)


def _board(snapshot: Snapshot) -> list[Row]:
    health = snapshot.health
    if health is None:
        return []
    supply = "" if health.supply_V is None else f"supply {health.supply_V:.2f} V, "
    bridges = "on" if health.bridges_on else "off"
    errors = f"errors {health.can_tx_errors}/{health.can_rx_errors}, {health.can_bus_offs} bus-offs"
    text = (
        f"{supply}bridges {bridges}, reset by {health.reset_cause}, clock {health.clock_source}, "
        f"CAN {health.can_state} ({errors}, {health.can_rx_lost} lost)"
    )
    crash = [] if health.crash is None else [Row("crash", health.crash, Mood.ALARM)]
    troubled = health.can_state in ("WARNING", "PASSIVE", "BUS_OFF")
    return [Row("board", text, Mood.WARNING if troubled else Mood.PLAIN), *crash]


def _others(bus: Bus) -> list[Row]:
    nodes = ", ".join(f"node {node}: {frames} frames" for node, frames in bus.other_nodes.items())
    return [Row("others", nodes)]


def _numbers(values: Sequence[float], form: str) -> str:
    return " ".join(f"{value:{form}}" for value in values)


def _vector(values: Sequence[float] | None, factor: float, unit: str, form: str) -> str:
    return NOTHING if values is None else f"{_numbers([factor * value for value in values], form)} {unit}"
