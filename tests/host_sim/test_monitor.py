"""What the monitor makes of frames, beside the record of the run that they are of, and the wire's README."""

import dataclasses
import json
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from rich.console import Console
from test_realtime import ClockedBus, by_the_clock
from typer.testing import CliRunner

from host_sim.busload import bus_load
from host_sim.cli import app
from host_sim.codec import DBC_FILE, Codec, load_messages
from host_sim.monitor.driving import BRAKING, NO_START, NO_TRAJECTORY, NOT_DRIVING
from host_sim.monitor.listen import News
from host_sim.monitor.motion import MotionWindow
from host_sim.monitor.snapshot import Snapshot
from host_sim.monitor.state import OF_HOST, MonitorState, fault_texts
from host_sim.monitor.terminal import picture, sparkline
from host_sim.monitor.text import line, notice, page
from host_sim.robot import ROOT, load_robot
from host_sim.trace import Trace

ROBOT, CODEC = load_robot(), Codec()
PERIOD_S = ROBOT.control_period_s

# Of a position and of a heading on the wire, half a step; the tracked point is L from the body's centre.
POINT_RESOLUTION_m = math.hypot(0.5e-5, 0.5e-5) + ROBOT.tracked_point_offset_m * 0.5e-4

MODES = ("BOOT", "IDLE", "ARMED", "TRACKING", "STOPPING", "FAULT")


class Recorded:
    """A run's folder, read."""

    def __init__(self, folder: Path) -> None:
        self.frames = list(can.LogReader(folder / "bus.log"))
        self.trace = Trace.load(folder)
        self.result: dict[str, Any] = json.loads((folder / "result.json").read_text())
        self.error_m = np.linalg.norm(self.trace.point - self.trace.reference_point, axis=1)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """The rhombus' first corner, with the slip that the paper is about."""
    folder = tmp_path_factory.mktemp("run")
    corner = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "1.2", "--epsilon", "0.02"]
    outcome = CliRunner().invoke(app, ["run", *corner, "--out", str(folder)])
    assert outcome.exit_code == 0, outcome.output
    return Recorded(folder)


def new_state() -> MonitorState:
    return MonitorState(CODEC, ROBOT)


def frame(name: str, *values: float, time_s: float = 0.0) -> can.Message:
    return frame_of(name, CODEC[name].pack(*values), time_s)


def frame_of(name: str, data: bytes, time_s: float) -> can.Message:
    return can.Message(timestamp=time_s, arbitration_id=CODEC[name].arbitration_id, is_extended_id=False, data=data)


def status(mode: str = "IDLE", refusal: int = 0, fault: int = 0, mask: int = 0, dropped: int = 0) -> can.Message:
    return frame("STATUS", MODES.index(mode), refusal, fault, mask, dropped, 0)


def feed(state: MonitorState, frames: Sequence[can.Message]) -> Snapshot:
    for message in frames:
        state.feed(message.timestamp, message)
    return state.snapshot(frames[-1].timestamp)


def at_each_torque(state: MonitorState, frames: Sequence[can.Message]) -> Iterator[Snapshot]:
    """The snapshot after each tick of TRACKING: after SLIP, which follows TORQUE."""
    for message in frames:
        state.feed(message.timestamp, message)
        if message.arbitration_id == CODEC["SLIP"].arbitration_id and state.mode == "TRACKING":
            yield state.snapshot(message.timestamp)


def index_of(frames: Sequence[can.Message], name: str) -> int:
    return next(n for n, message in enumerate(frames) if message.arbitration_id == CODEC[name].arbitration_id)


# ---- beside the record of a run


def test_every_tick_of_a_run_is_that_of_its_trace(run: Recorded) -> None:
    seen = list(at_each_torque(new_state(), run.frames))
    assert len(seen) == len(run.trace)
    drive_s = np.array([snapshot.drive_s for snapshot in seen])
    np.testing.assert_allclose(drive_s, run.trace.time_s, atol=1e-9)
    np.testing.assert_allclose([s.pose for s in seen], run.trace.pose, atol=0.51e-4)
    np.testing.assert_array_equal([s.torque_Nm for s in seen], run.trace.torque)
    np.testing.assert_array_equal([s.slip.mu_m_per_s for s in seen], run.trace.mu)
    np.testing.assert_allclose([s.wheel_speed_rad_per_s for s in seen], run.trace.wheel_speed, atol=5.1e-4)
    np.testing.assert_allclose([s.tracking.error_m for s in seen], run.error_m, atol=POINT_RESOLUTION_m)
    reference = np.array([s.tracking.reference for s in seen])
    np.testing.assert_allclose(reference[:, :2], run.trace.reference_point, atol=1e-9)
    assert seen[-1].tracking.max_error_m == pytest.approx(run.result["tracking"]["max_error_m"], abs=POINT_RESOLUTION_m)
    assert seen[-1].max_torque_Nm == run.result["torque"]["max_Nm"]
    assert all(s.mode == "TRACKING" and s.drive == "LOCKSTEP" and s.tracking.unknown == "" for s in seen)
    assert seen[-1].firmware == run.result["versions"]["firmware"]
    assert seen[-1].parameters["epsilon"] == pytest.approx(0.02)


def test_slip_and_speed_are_the_means_of_the_trace(run: Recorded) -> None:
    seen = list(at_each_torque(new_state(), run.frames))
    span = round(0.05 / PERIOD_S)
    speed = np.linalg.norm(run.trace.body_twist[:, :2], axis=1)
    assert np.abs(run.trace.slip_ratio).max() > 0.03, "there is no slip to see"
    for tick in range(span, len(seen), 25):
        window = slice(tick - span, tick + 1)
        assert seen[tick].speed_m_per_s == pytest.approx(speed[window].mean(), abs=2e-3)
        if speed[window].min() > 0.3:
            ratio = seen[tick].slip.ratio
            assert ratio is not None
            np.testing.assert_allclose(ratio, run.trace.slip_ratio[window].mean(axis=0), atol=3e-3)
    last = seen[-1].slip.max_ratio
    assert last == pytest.approx(run.result["slip"]["max_ratio"], rel=0.1)


def test_standing_robot_has_no_slip_ratio(run: Recorded) -> None:
    still = run.trace.body_twist[-1]
    assert math.hypot(*still[:2]) < 0.05
    slip = list(at_each_torque(new_state(), run.frames))[-1].slip
    assert slip.ratio is None
    assert slip.velocity_m_per_s is not None


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.1])
def test_turning_robot_has_the_twist_and_slip_that_it_was_given(heading: float) -> None:
    """A steady twist is an arc; its wheels turn by Jr times the twist less the slip."""
    twist, slip, window = np.array([0.4, -0.3, 2.0]), np.array([0.02, -0.01, 0.03]), MotionWindow(ROBOT)
    wheel_speed = (ROBOT.Jr @ twist - slip) / ROBOT.wheel_radius_m
    for tick in range(80):
        turned = twist[2] * tick * PERIOD_S
        along, across = math.sin(turned) / twist[2], (1.0 - math.cos(turned)) / twist[2]
        arc = np.array([[along, -across], [across, along]])
        cosine, sine = math.cos(heading), math.sin(heading)
        x, y = np.array([[cosine, -sine], [sine, cosine]]) @ arc @ twist[:2]
        window.add_wheel_speed(tick * PERIOD_S, wheel_speed.tolist())
        window.add_pose(tick * PERIOD_S, (x, y, math.remainder(heading + turned, math.tau)))
    motion = window.motion()
    assert motion is not None
    assert motion.slip_m_per_s is not None
    np.testing.assert_allclose(motion.twist, twist, atol=5e-4)  # the arc's chord over 50 ms is 4e-4 shorter
    np.testing.assert_allclose(motion.slip_m_per_s, slip, atol=5e-4)
    ratio = motion.slip_ratio(1e-3, 0.5)
    np.testing.assert_allclose(ratio, slip / (math.hypot(0.4, 0.3, 0.5 * 2.0) + 1e-3), atol=5e-4)


def test_load_is_that_of_the_wire_definition(run: Recorded) -> None:
    load = bus_load(load_messages(DBC_FILE))
    told = {message.arbitration_id for message in run.frames}
    expected = sum(f.bits / f.period_s for f in load.frames if f.period_s and f.arbitration_id in told) / load.bit_rate
    assert 0.6 < expected <= load.load_fraction
    bus = feed(new_state(), run.frames).bus
    assert bus.load_fraction == pytest.approx(expected, rel=0.01)
    assert bus.frames == run.result["bus"]["frames"] == len(run.frames)
    slow = MonitorState(Codec(), ROBOT, bit_rate=500_000)
    assert feed(slow, run.frames).bus.load_fraction == pytest.approx(2.0 * bus.load_fraction)


def test_load_fades_on_a_bus_that_falls_silent(run: Recorded) -> None:
    state = new_state()
    feed(state, run.frames)
    end_s = run.frames[-1].timestamp
    assert 0.2 < state.snapshot(end_s + 0.5).bus.load_fraction < 0.5
    assert state.snapshot(end_s + 2.0).bus.load_fraction == 0.0
    assert state.snapshot(end_s + 2.0).pace == 0.0


def test_curves_are_points_of_the_trace(run: Recorded) -> None:
    state = new_state()
    feed(state, run.frames)
    driven = [sample for sample in state.driving.samples if math.isfinite(sample.error_m)]
    assert len(driven) == pytest.approx(len(run.trace) / 20, abs=2)
    for sample in driven:
        tick = round(sample.clock_s / PERIOD_S) - 1  # tick 0 is the first SYNC, a period after nothing
        assert sample.error_m == pytest.approx(run.error_m[tick], abs=POINT_RESOLUTION_m)
        assert sample.torque_Nm == tuple(run.trace.torque[tick])
    assert [sample.number for sample in state.driving.samples] == list(range(1, len(state.driving.samples) + 1))


def test_run_in_real_time_has_the_error_of_its_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    class Tapped(ClockedBus):
        """Keeps what goes over it, with its time."""

        def __init__(self) -> None:
            super().__init__()
            self.frames: list[can.Message] = []

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            msg.timestamp = self.now_s
            self.frames.append(msg)
            super().send(msg, timeout)

        def recv(self, timeout: float | None = None) -> can.Message | None:
            received = super().recv(timeout)
            if received is not None:
                received.timestamp = self.now_s
                self.frames.append(received)
            return received

    bus = Tapped()
    trace = by_the_clock(monkeypatch, bus).trace
    seen = [snapshot for snapshot in at_each_torque(new_state(), bus.frames) if snapshot.drive_s is not None]
    assert {snapshot.drive for snapshot in seen} == {"REALTIME"}
    error = np.linalg.norm(trace.point - trace.reference_point, axis=1)
    ticks = [round(snapshot.drive_s / PERIOD_S) for snapshot in seen]  # type: ignore[operator]
    assert len(set(ticks) & set(range(len(trace)))) >= len(trace) - 1
    for tick, snapshot in zip(ticks, seen, strict=True):
        if tick < len(trace):
            assert snapshot.tracking.error_m == pytest.approx(error[tick], abs=POINT_RESOLUTION_m)


def test_robot_with_motors_is_followed_by_the_clock_of_the_bus(run: Recorded) -> None:
    """Its host is a heartbeat that tells a pose every tenth tick of the robot's, by ticks of its own."""
    frames, tick, sent = [], 0, b""
    for message in run.frames:
        name, data = CODEC.of_id(message.arbitration_id).name, bytes(message.data)  # type: ignore[union-attr]
        if name == "COMMAND" and data[0] == CODEC["COMMAND"].choices["operation"]["USE_LOCKSTEP"]:
            frames.append(frame("COMMAND", 6, data[1] & 0xF, 0))
        elif name == "SYNC":
            if tick % 10 == 0:
                pose = CODEC["POSE"].pack(*CODEC["POSE"].unpack(sent)[:3], tick // 10 & 0xF)
                told = [("POSE", pose), ("SYNC", CODEC["SYNC"].pack(tick // 10, CODEC["POSE"].seal(pose), 0))]
                frames += [frame_of(what, payload, message.timestamp) for what, payload in told]
            tick += 1
        elif name == "POSE":
            sent = data
        elif name != "WHEEL_SPEED":
            frames.append(message)
    seen = list(at_each_torque(new_state(), frames))
    assert len(seen) == len(run.trace)
    assert {snapshot.drive for snapshot in seen} == {"MOTORS"}
    for number, snapshot in enumerate(seen):
        assert snapshot.drive_s == pytest.approx(number // 10 * 10 * PERIOD_S)
        assert snapshot.tracking.error_m == pytest.approx(run.error_m[number // 10 * 10], abs=POINT_RESOLUTION_m)
    assert seen[-1].slip.velocity_m_per_s is None
    assert "no wheel speeds" in page(seen[-1])


# ---- what cannot be known


def test_monitor_that_comes_late_says_why_there_is_no_error(run: Recorded) -> None:
    middle = feed(new_state(), run.frames[len(run.frames) // 2 : -1000])
    assert middle.tracking.error_m is None
    assert middle.tracking.unknown == NO_TRAJECTORY
    assert middle.mode == "TRACKING"
    assert middle.pose is not None


def test_start_that_was_missed_is_not_guessed(run: Recorded) -> None:
    state, start = new_state(), index_of(run.frames, "CHALLENGE")
    feed(state, run.frames[:start])
    state.miss(200)
    snapshot = feed(state, run.frames[start + 200 : 3000])
    assert snapshot.tracking.unknown == NO_START
    assert snapshot.drive_s is None


@pytest.mark.parametrize("lost", ["TRAJECTORY_BEGIN", "TRAJECTORY_DATA"])
def test_upload_of_which_a_frame_is_lost_is_not_taken_for_the_trajectory(run: Recorded, lost: str) -> None:
    place = index_of(run.frames, lost)
    snapshot = feed(new_state(), [*run.frames[:place], *run.frames[place + 1 : 3000]])
    assert snapshot.upload == "COMPLETE"
    assert snapshot.tracking.unknown == NO_TRAJECTORY


def test_upload_that_is_refused_leaves_what_was_there(run: Recorded) -> None:
    state = new_state()
    half = feed(state, run.frames[:3000])
    assert half.tracking.error_m is not None
    refused = [frame("TRAJECTORY_BEGIN", 100, 1234, 5), frame("TRAJECTORY_ACK", 0, 6)]
    feed(state, refused)
    assert feed(state, run.frames[3000:3100]).tracking.error_m is not None
    feed(state, [frame("TRAJECTORY_BEGIN", 100, 1234, 5), frame("TRAJECTORY_ACK", 0, 0)])
    assert feed(state, run.frames[3100:3200]).tracking.unknown == NO_TRAJECTORY


def test_braking_and_standing_robots_have_no_error(run: Recorded) -> None:
    state = new_state()
    assert feed(state, run.frames).tracking.unknown == BRAKING
    snapshot = feed(state, [status("IDLE")])
    assert (snapshot.tracking.unknown, snapshot.tracking.error_m) == (NOT_DRIVING, None)
    assert snapshot.tracking.max_error_m is not None
    assert snapshot.drive_s is None


def test_bus_that_was_lost_leaves_nothing_to_compare_with(run: Recorded) -> None:
    state = new_state()
    feed(state, run.frames[:3000])
    state.lose("Network is down")
    state.lose("Network is down")
    lost = state.snapshot(3.0)
    assert "Network is down" in notice(lost)
    assert "trying again" in line(lost)
    state.lose("")
    assert feed(state, run.frames[3000:3100]).tracking.unknown == NO_TRAJECTORY
    assert [event.text for event in state.events][-2:] == ["the bus is lost: Network is down", "the bus is back"]


def test_frames_that_were_missed_in_a_drive_do_not_end_its_error(run: Recorded) -> None:
    state = new_state()
    feed(state, run.frames[:2500])
    state.miss(500)
    snapshot = feed(state, run.frames[3000:4000])
    assert snapshot.drive_s is not None
    tick = round(snapshot.drive_s / PERIOD_S)
    assert snapshot.tracking.error_m == pytest.approx(run.error_m[tick], abs=POINT_RESOLUTION_m)
    assert snapshot.bus.unheard_frames == 500
    assert "500 not heard" in page(snapshot)


# ---- modes, faults, refusals, reports


@pytest.mark.parametrize("mode", list(CODEC["STATUS"].choices["mode"]))
def test_every_mode_is_shown(mode: str) -> None:
    state = new_state()
    snapshot = feed(state, [status(mode)])
    assert snapshot.mode == mode
    assert mode in line(snapshot)
    assert mode in shown(state, snapshot)
    assert [event.text for event in state.events] == [f"mode {mode}"]


def readme_faults() -> list[tuple[int, str, str, str]]:
    """The table of the wire's README: number, name, when, reaction."""
    table = (ROOT / "protocol" / "README.md").read_text()
    rows = re.findall(r"^\| (\d+) ([A-Z_]+) \| (.*?) \| .*? \| (brake|cut) \|$", table, re.MULTILINE)
    return [(int(number), name, when, reaction) for number, name, when, reaction in rows]


@pytest.mark.parametrize(("number", "name", "when", "reaction"), readme_faults())
def test_every_fault_is_shown_with_its_text(number: int, name: str, when: str, reaction: str) -> None:
    state = new_state()
    code = CODEC["FAULT_RECORD"].choices["reaction"][reaction.upper()]
    snapshot = feed(state, [frame("FAULT_RECORD", number, code, 3, 4711), status("FAULT", 0, number, 1 << number)])
    (fault,) = snapshot.faults
    assert dataclasses.astuple(fault) == (name, when, reaction.upper(), 3, 4711)
    screen = shown(state, snapshot)
    for words in (name, when, reaction, "tick 4711", "3 times"):
        assert words in re.sub(r"\s+", " ", screen)
    assert f"fault {name}: {when}" in [event.text for event in state.events]
    cleared = feed(state, [status("IDLE")])
    assert cleared.faults == ()
    assert name not in page(cleared)


def test_readme_has_all_faults_of_the_wire() -> None:
    of_wire = {name for name in CODEC["STATUS"].choices["fault"] if name != "NONE"}
    assert {name for _, name, _, _ in readme_faults()} == of_wire == set(fault_texts())


def test_first_cause_comes_first_of_several_faults() -> None:
    snapshot = feed(new_state(), [status("FAULT", 0, 9, 1 << 9 | 1 << 1 | 1 << 2)])
    assert [fault.name for fault in snapshot.faults] == ["ERROR_LIMIT", "STALE_POSE", "STALE_WHEEL_SPEED"]


def test_refusal_is_told_with_what_was_refused() -> None:
    state = new_state()
    refusal = CODEC["STATUS"].choices["refusal"]["NO_TRAJECTORY"]
    arm = frame("COMMAND", CODEC["COMMAND"].choices["operation"]["ARM"], 1, 0)
    snapshot = feed(state, [arm, status("IDLE", refusal)])
    assert snapshot.refusal == "NO_TRAJECTORY"
    assert state.events[-2].text == "refused ARM: NO_TRAJECTORY"
    assert "refused: NO_TRAJECTORY" in page(snapshot)


def test_reports_of_a_board_are_shown() -> None:
    state = new_state()
    frames = [
        status("IDLE", dropped=7),
        frame("TIMING", 15.5, 17.3, 41.2, 2),
        frame("HEALTH", 4, 2, 3, 1, 12, 130, 5, 9, 11.87),
        frame("CRASH", 0x0800ABCD, 0x08001234),
        frame("DROPS", 4, 2, 1, 0),
        frame("IDENTITY", CODEC.protocol_hash, 1, 2, 3, 1, 2),
    ]
    snapshot = feed(state, frames)
    assert snapshot.drive == "MOTORS"
    words = page(snapshot)
    for part in (
        *("mean 17.3 us, 15.5 to 41.2; 2 overruns", "supply 11.87 V", "bridges on", "reset by WATCHDOG"),
        *("clock HSI_PLL", "CAN PASSIVE", "errors 12/130, 5 bus-offs", "9 lost", "pc 0800ABCD, lr 08001234"),
        *("7 frames by the robot (4 damaged, 2 replayed, 1 masqueraded)", "firmware 1.2.3"),
    ):
        assert part in words


def test_robot_of_another_protocol_is_told() -> None:
    snapshot = feed(new_state(), [status(), frame("IDENTITY", CODEC.protocol_hash ^ 1, 0, 1, 0, 0, 0)])
    assert snapshot.protocol_matches is False
    assert "another protocol" in notice(snapshot)


# ---- frames that are none of ours, damaged, or missing


def test_host_frames_are_those_of_the_wire_definition() -> None:
    assert {message.name for message in load_messages(DBC_FILE) if "HOST" in message.senders} == OF_HOST


@pytest.mark.parametrize("name", ["TORQUE", "SYNC", "POSE", "WHEEL_SPEED"])
def test_damaged_frames_are_counted_and_change_nothing(run: Recorded, name: str) -> None:
    """Each bit of a checked frame turned over, in a tick of its own; a sensor frame is checked by its SYNC."""
    state, first = new_state(), 100
    ids = [CODEC[of_tick].arbitration_id for of_tick in ("POSE", "WHEEL_SPEED", "SYNC", "TORQUE", "SLIP")]
    frames = [message for message in run.frames if message.arbitration_id in ids]
    ticks = [frames[begin : begin + 5] for begin in range(0, len(frames), 5)]
    place = ids.index(CODEC[name].arbitration_id)
    feed(state, [message for tick in ticks[:first] for message in tick])
    for bit in range(8 * CODEC[name].length):
        before, tick = state.snapshot(0.0), list(ticks[first + bit])
        data = bytearray(tick[place].data)
        data[bit // 8] ^= 1 << bit % 8
        tick[place] = frame_of(name, bytes(data), tick[place].timestamp)
        after = feed(state, tick)
        damaged = after.bus.damaged_frames - before.bus.damaged_frames
        assert damaged == (0 if counter_of(name, bit) else 1), bit
        if name == "TORQUE":
            assert after.torque_Nm == before.torque_Nm
        if name in ("SYNC", "POSE"):
            assert after.pose == before.pose
        if name in ("SYNC", "WHEEL_SPEED"):
            assert after.wheel_speed_rad_per_s == before.wheel_speed_rad_per_s


def counter_of(name: str, bit: int) -> bool:
    """Whether a bit is of a sensor frame's counter: the frame is then of another tick, not damaged."""
    return name in ("POSE", "WHEEL_SPEED") and bit >= 60


def test_frames_of_a_wrong_length_and_of_nobody_are_counted() -> None:
    odd = [
        can.Message(arbitration_id=0x100, data=b"\1\2", is_extended_id=False),
        can.Message(arbitration_id=0x7F0, data=b"", is_extended_id=False),
        can.Message(arbitration_id=0x100, data=bytes(8), is_extended_id=True),
        can.Message(arbitration_id=0x100, is_remote_frame=True, dlc=8, is_extended_id=False),
        can.Message(is_error_frame=True),
        can.Message(arbitration_id=0x103, data=bytes(8), is_extended_id=False),
    ]
    state = new_state()
    bus = feed(state, odd).bus
    assert (bus.damaged_frames, bus.unknown_frames, bus.error_frames, bus.frames) == (1, 3, 1, 5)
    assert bus.other_nodes == {3: 1}
    assert "1 damaged, 3 unknown, 1 error frames" in page(state.snapshot(0.0))


def test_run_of_another_node_is_seen_only_where_it_is_asked_for(run: Recorded) -> None:
    shifted = [
        can.Message(timestamp=m.timestamp, arbitration_id=m.arbitration_id | 5, data=m.data, is_extended_id=False)
        for m in run.frames[:3000]
    ]
    snapshot = feed(new_state(), shifted)
    assert (snapshot.mode, snapshot.pose, snapshot.bus.damaged_frames) == (None, None, 0)
    assert snapshot.bus.other_nodes == {5: 3000}
    assert snapshot.bus.load_fraction > 0.0
    assert "frames of node 5 are there: try --node" in notice(snapshot)


def test_robot_that_appears_later_is_seen(run: Recorded) -> None:
    state = new_state()
    assert notice(state.snapshot(0.2)) == "listening"
    assert "silent bus: not a frame in 7 s" in notice(state.snapshot(7.0))
    hello = frame("HELLO", 1)
    assert "nothing of node 0 among 1 frames; is the robot on?" in notice(feed(state, [hello]))
    snapshot = feed(state, run.frames[:3000])
    assert notice(snapshot) == ""
    assert snapshot.tracking.error_m is not None
    assert "node 0 silent for 4 s" in notice(state.snapshot(run.frames[2999].timestamp + 4.0))


def test_host_that_begins_anew_starts_the_drive_anew(run: Recorded) -> None:
    state = new_state()
    feed(state, run.frames)
    seen = list(at_each_torque(state, run.frames))
    np.testing.assert_allclose([s.tracking.error_m for s in seen], run.error_m, atol=POINT_RESOLUTION_m)
    assert seen[0].tracking.max_error_m == pytest.approx(run.error_m[0], abs=POINT_RESOLUTION_m)
    assert state.driving.clock_s == pytest.approx(2 * len(run.trace) * PERIOD_S)


def test_tick_that_wraps_is_no_event() -> None:
    state = new_state()
    for tick in (0xFFFFFFFE, 0xFFFFFFFF, 0, 1):
        feed(state, [frame("SYNC", tick, 0, 0)])
    assert state.driving.clock_s == pytest.approx(4 * PERIOD_S)


def test_values_that_are_not_available_are_none_in_json() -> None:
    state = new_state()
    pose = frame("POSE", math.nan, 0.0, 0.0, 1)
    seal = CODEC["POSE"].seal(bytes(pose.data))
    unknown = frame("TIMING", math.nan, math.nan, math.nan, 0)
    snapshot = feed(state, [status(), unknown, pose, frame("SYNC", 1, seal, 0), frame("SLIP", math.nan, 0.0, 0.0, 1)])
    plain = json.loads(json.dumps(snapshot.as_dict(), allow_nan=False))
    assert plain["pose"] is None
    assert plain["step_time"]["mean_us"] is None
    assert plain["slip"]["mu_m_per_s"] == [None, 0.0, 0.0]
    assert plain["mode"] == "IDLE"


# ---- the screen


def shown(state: MonitorState, snapshot: Snapshot, columns: int = 80, lines: int = 24, **options: bool) -> str:
    """Return the screen as text."""
    console = Console(width=columns, height=lines, force_terminal=True, color_system=None, legacy_windows=False)
    news = News(snapshot, list(state.driving.samples), list(state.events), state.event_count)
    with console.capture() as capture:
        console.print(picture(news, columns, lines, **options))
    return capture.get()


def test_screen_of_a_run_has_its_numbers_and_fits(run: Recorded) -> None:
    state = new_state()
    snapshot = feed(state, run.frames[:3000])
    screen = shown(state, snapshot)
    assert len(screen.splitlines()) <= 24
    assert max(map(len, screen.splitlines())) <= 80
    tick = round(snapshot.drive_s / PERIOD_S)  # type: ignore[operator]
    assert f"TRACKING for {tick * PERIOD_S:.2f} s, LOCKSTEP" in screen
    told = re.search(r"^error +([\d.]+) mm", screen, re.MULTILINE)
    assert told is not None
    assert float(told[1]) * 1e-3 == pytest.approx(run.error_m[tick], abs=POINT_RESOLUTION_m + 1e-6)
    assert f"{run.trace.torque[tick][0]:z.4f}" in screen
    assert "\x1b[" not in screen
    assert shown(state, snapshot, ascii_only=True).isascii() is False  # events have arrows ...
    curves = [text for text in shown(state, snapshot, ascii_only=True).splitlines() if " 0 to " in text]
    assert len(curves) == 4
    assert all(text.isascii() for text in curves)  # ... curves have no blocks


def test_sparkline_is_as_high_as_the_largest_of_each_share() -> None:
    assert sparkline([0.0, 1.0, 2.0, 4.0, 8.0], 5) == "▁▁▂▄█"
    assert sparkline([0.0, 8.0, 1.0, 0.0, math.nan, math.nan], 3) == "█▁ "
    assert sparkline([0.0, 0.0], 10) == "▁▁"
    assert sparkline([], 10) == ""
