"""A session with the real firmware on the in-process bus; frames are lost, late or damaged."""

import errno
import math
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest

from host_sim.codec import DBC_FILE, Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import LIBRARY_FILE, InprocBus
from host_sim.link import Answer, BusStatistics, Link, RefusedError, SilentError
from host_sim.planner import CORNERS, PATHS, PathRequest, plan
from host_sim.robot import ROOT, load_robot
from host_sim.trajectory import MAX_DURATION_US, MAX_TOTAL_US, SEGMENT_BYTES, Polyline, Segment, Trajectory

NODE = 3
CODEC = Codec(node=NODE)
ROBOT = load_robot()
SECOND_US = 1_000_000
TICKS = 8

OnAnswer = Callable[[can.Message], list[can.Message]]


class DisturbedBus(InprocBus):
    """An in-process bus that passes the robot's frames through a function: it may lose, change, repeat or keep them."""

    def __init__(self) -> None:
        if not LIBRARY_FILE.exists():
            pytest.fail(f"no {LIBRARY_FILE}: cmake --preset host && cmake --build --preset host")
        self.on_answer: OnAnswer = lambda message: [message]
        self.sent: list[int] = []
        self._ready: list[can.Message] = []
        super().__init__(node=NODE)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append(msg.arbitration_id)
        super().send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._ready:
            message, _ = super()._recv_internal(timeout)
            self._ready = [] if message is None else self.on_answer(message)
        return (self._ready.pop(0) if self._ready else None), False

    def times_sent(self, name: str) -> int:
        return self.sent.count(CODEC[name].arbitration_id)


@pytest.fixture
def bus() -> Iterator[DisturbedBus]:
    with DisturbedBus() as bus:
        yield bus


@pytest.fixture
def link(bus: DisturbedBus, monkeypatch: pytest.MonkeyPatch) -> Link:
    monkeypatch.setattr("host_sim.link.REPEAT_S", 0.005)
    return Link(bus, CODEC, timeout_s=0.2)


@pytest.fixture
def tracking(link: Link) -> Link:
    link.hello()
    link.upload(straight_line().to_bytes())
    link.start()
    return link


def straight_line(segments: int = 1) -> Trajectory:
    """One metre a segment along x1 in one second each, heading 0.3."""
    coefficients = np.zeros((3, 8))
    coefficients[2, 0] = 0.3
    made = []
    for start in range(segments):
        coefficients[0, :2] = start, 1.0
        made.append(Segment(SECOND_US, coefficients))
    return Trajectory(made, Polyline(np.array([[0.0, 0.0], [segments, 0.0]]), closed=False))


def standstill(*durations_us: int, step_m: float = 0.0) -> bytes:
    """Segments at rest, each a step along x1 further; some that host_sim itself would refuse to make."""
    step = np.zeros((len(durations_us), 24), np.float32)
    step[:, 0] = step_m * np.arange(len(durations_us))
    return b"".join(struct.pack("<I", us) + row.tobytes() for us, row in zip(durations_us, step, strict=True))


def drive(link: Link, ticks: int = TICKS, first: int = 0) -> list[Answer]:
    """Answers to ticks with a robot that stays behind its reference."""
    return [link.tick(first + k, (0.001 * k, 0.0, 0.0), (0.1 * k, -0.2, 0.0)) for k in range(ticks)]


def undisturbed_answers() -> list[Answer]:
    """What a session without any disturbance gives."""
    with DisturbedBus() as bus:
        link = Link(bus, CODEC)
        link.hello()
        link.upload(straight_line().to_bytes())
        link.start()
        return drive(link)


def only_once(name: str, change: Callable[[can.Message], list[can.Message]]) -> OnAnswer:
    """Pass every frame on but the first of a name, which is changed."""
    changed = False

    def on_answer(message: can.Message) -> list[can.Message]:
        nonlocal changed
        if changed or message.arbitration_id != CODEC[name].arbitration_id:
            return [message]
        changed = True
        return change(message)

    return on_answer


# Before the drive ---------------------------------------------------------------------------------------------------


def test_hello_gives_the_firmwares_identity_and_leaves_it_idle(link: Link) -> None:
    identity = link.hello()

    assert identity.protocol_hash == CODEC.protocol_hash
    assert identity.version == "0.1.0"
    assert CODEC["STATUS"].label("mode", link.status["mode"]) == "IDLE"
    assert link.fault() == "NONE"


def test_hello_to_a_firmware_of_another_protocol_says_both_and_the_cure(bus: DisturbedBus, tmp_path: Path) -> None:
    other = tmp_path / "other.dbc"
    other.write_text(DBC_FILE.read_text(encoding="utf-8").replace("answered by STATUS", "never answered"), "utf-8")
    codec = Codec(other, node=NODE)

    with pytest.raises(OmnibotError) as caught:
        Link(bus, codec).hello()

    message = str(caught.value)
    assert f"node {NODE} speaks protocol {CODEC.protocol_hash:08X}, this host {codec.protocol_hash:08X}" in message
    assert "rebuild the firmware" in message


def test_hello_to_a_firmware_whose_status_is_shorter_still_tells_of_the_protocol(
    bus: DisturbedBus, tmp_path: Path
) -> None:
    def shorten(message: can.Message) -> list[can.Message]:
        return [can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=message.data[:6])]

    other = tmp_path / "other.dbc"
    other.write_text(DBC_FILE.read_text(encoding="utf-8") + "\n", "utf-8")
    bus.on_answer = only_once("STATUS", shorten)

    with pytest.raises(OmnibotError, match="speaks protocol"):
        Link(bus, Codec(other, node=NODE)).hello()


def test_hello_after_a_fault_clears_it(tracking: Link) -> None:
    drive(tracking, 1)
    drive(tracking, 1, first=1000)  # a gap
    assert tracking.tick(1001, (0, 0, 0), (0, 0, 0)).mode == "FAULT"

    tracking.hello()

    assert tracking.fault() == "NONE"
    assert tracking.tick(1002, (0, 0, 0), (0, 0, 0)).mode == "IDLE"


def test_parameter_set_is_what_the_firmware_then_has(bus: DisturbedBus, link: Link) -> None:
    link.hello()
    epsilon = ROBOT.parameter("epsilon")

    link.set_parameter(epsilon, 0.25)

    link.send("PARAMETER_GET", epsilon.index, 0, 0)
    answer = bus.recv(0.1)
    assert answer is not None
    assert CODEC["PARAMETER_VALUE"].named(bytes(answer.data)) == {
        "index": epsilon.index,
        "result": 0,
        "field": 0,
        "value": 0.25,
    }


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [("epsilon", 2.0, "outside 0 … 1 1/N"), ("order", 0.5, "whole number"), ("epsilon", math.nan, "outside")],
)
def test_parameter_outside_its_range_is_refused_before_it_is_sent(
    bus: DisturbedBus, link: Link, name: str, value: float, why: str
) -> None:
    with pytest.raises(OmnibotError, match=f"{name} = .* {why}"):
        link.set_parameter(ROBOT.parameter(name), value)

    assert bus.sent == []


def test_parameter_refused_by_the_firmware_says_name_and_reason(link: Link) -> None:
    epsilon = ROBOT.parameter("epsilon")

    with pytest.raises(RefusedError, match="refused epsilon = 2: OUT_OF_RANGE"):
        link.set_parameter(replace(epsilon, maximum=10.0), 2.0)
    with pytest.raises(RefusedError, match=r"refused epsilon = 0\.5: UNKNOWN_INDEX"):
        link.set_parameter(replace(epsilon, index=200), 0.5)


def test_parameter_set_in_motion_is_refused(tracking: Link) -> None:
    with pytest.raises(RefusedError, match="IN_MOTION"):
        tracking.set_parameter(ROBOT.parameter("epsilon"), 0.1)


@pytest.mark.parametrize("segments", [1, 2, 3, 24, 128])
def test_upload_is_taken_and_can_be_started(link: Link, segments: int) -> None:
    # 24 segments end with a frame that an acknowledgement is due for anyway.
    link.hello()

    link.upload(straight_line(segments).to_bytes())

    link.start()
    assert drive(link, 1)[0].mode == "TRACKING"


@pytest.mark.parametrize(
    ("trajectory", "why"),
    [
        (b"", "at byte 0: WRONG_LENGTH"),
        (bytes(SEGMENT_BYTES + 1), "at byte 0: WRONG_LENGTH"),
        (straight_line(129).to_bytes(), "at byte 0: WRONG_LENGTH"),
        (bytes(SEGMENT_BYTES), "at byte 100: BAD_DURATION"),
        (b"\x01\0\0\0" + b"\xff" * 96, "at byte 100: BAD_SEGMENT"),
        (standstill(600_000_001), "at byte 100: BAD_DURATION"),
        (standstill(*6 * [600_000_000], 1), "at byte 700: BAD_DURATION"),
        (standstill(1, 1, step_m=1.1e-3), "at byte 200: DISCONTINUOUS"),
    ],
)
def test_upload_that_makes_no_trajectory_is_refused(link: Link, trajectory: bytes, why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        link.upload(trajectory)


def test_upload_at_the_bounds_of_what_the_firmware_takes_is_taken(link: Link) -> None:
    link.upload(standstill(*6 * [MAX_DURATION_US]))
    link.upload(standstill(1, MAX_TOTAL_US - 5 * MAX_DURATION_US - 1, *5 * [MAX_DURATION_US], step_m=0.9e-3))


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("corner", CORNERS)
def test_paths_of_the_planner_are_taken(link: Link, path: str, corner: str) -> None:
    for speed in (0.01, 0.5, 2.0):
        link.upload(plan(PathRequest(path, speed, corner)).to_bytes())
    link.upload(plan(PathRequest(path, 0.5, corner, duration_s=60.0)).to_bytes())
    link.upload(plan(PathRequest(path, 1.0, corner, profile="fastest")).to_bytes())
    if path == "rhombus":
        link.upload(plan(PathRequest(path, 1.0, corner, duration_s=9.0, start_before_corner_s=1.0)).to_bytes())


def test_paths_made_by_limits_are_taken(link: Link) -> None:
    for corner in CORNERS:
        link.upload(plan(PathRequest("square", 1.0, corner)).to_bytes())
    for file in ("slalom.csv", "slalom.toml"):
        link.upload(plan(PathRequest(str(ROOT / "host_sim" / "examples" / file), 0.5)).to_bytes())


def test_upload_with_a_frame_lost_is_refused_at_its_byte(
    bus: DisturbedBus, link: Link, monkeypatch: pytest.MonkeyPatch
) -> None:
    send = bus.send

    def lose_second_data(message: can.Message, timeout: float | None = None) -> None:
        data_id = CODEC["TRAJECTORY_DATA"].arbitration_id
        if message.arbitration_id != data_id or bytes(message.data[:2]) != b"\x06\0":
            send(message, timeout)

    monkeypatch.setattr(bus, "send", lose_second_data)

    with pytest.raises(RefusedError, match="at byte 6: WRONG_OFFSET"):
        link.upload(straight_line().to_bytes())


def test_upload_with_a_byte_changed_is_refused_and_nothing_is_held(
    bus: DisturbedBus, link: Link, monkeypatch: pytest.MonkeyPatch
) -> None:
    send = bus.send

    def change_a_byte(message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == CODEC["TRAJECTORY_DATA"].arbitration_id and message.data[0] == 12:
            message.data[5] ^= 1
        send(message, timeout)

    link.hello()
    link.upload(straight_line().to_bytes())
    monkeypatch.setattr(bus, "send", change_a_byte)

    with pytest.raises(RefusedError, match="at byte 100: WRONG_CRC"):
        link.upload(straight_line().to_bytes())
    with pytest.raises(RefusedError, match="NO_TRAJECTORY"):
        link.start()


def test_upload_in_motion_is_refused(tracking: Link) -> None:
    with pytest.raises(RefusedError, match="IN_MOTION"):
        tracking.upload(straight_line().to_bytes())


# Starting and stopping ----------------------------------------------------------------------------------------------


def test_start_without_hello_is_refused(link: Link) -> None:
    with pytest.raises(RefusedError, match=r"refused ARM: UNKNOWN_PEER \(mode IDLE\)"):
        link.start()


def test_start_without_a_trajectory_is_refused(link: Link) -> None:
    link.hello()

    with pytest.raises(RefusedError, match=r"refused ARM: NO_TRAJECTORY \(mode IDLE\)"):
        link.start()


def test_start_in_motion_is_refused(tracking: Link) -> None:
    with pytest.raises(RefusedError, match=r"refused ARM: WRONG_MODE \(mode TRACKING\)"):
        tracking.start()


def test_stop_after_a_refused_start_is_not_refused(tracking: Link) -> None:
    with pytest.raises(RefusedError):
        tracking.start()

    tracking.command("STOP")

    assert tracking.tick(0, (0, 0, 0), (0, 0, 0)).mode == "STOPPING"


@pytest.mark.parametrize("operation", ["ARM", "STOP", "CLEAR"])
def test_command_is_answered_with_one_status(link: Link, bus: DisturbedBus, operation: str) -> None:
    link.hello()
    link.upload(straight_line().to_bytes())

    link.command(operation)

    assert bus.recv(0.0) is None


def test_command_is_not_answered_by_the_status_of_an_earlier_refusal(link: Link) -> None:
    link.hello()
    with pytest.raises(RefusedError, match="NO_TRAJECTORY"):
        link.start()
    link.tick(100, (0, 0, 0), (0, 0, 0))  # a tick with a status, which repeats the refusal

    link.command("STOP")

    assert link.status["refusal"] == 0


# The drive ----------------------------------------------------------------------------------------------------------


def test_tick_is_answered_with_torque_and_slip(tracking: Link) -> None:
    answers = drive(tracking)

    assert [answer.mode for answer in answers] == ["TRACKING"] * TICKS
    assert all(any(torque != 0.0 for torque in answer.torque_Nm) for answer in answers)
    assert all(math.isfinite(mu) for answer in answers for mu in answer.mu_m_per_s)


def test_tick_before_start_is_answered_with_no_torque(link: Link) -> None:
    assert link.tick(7, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0)) == Answer((0.0,) * 3, (0.0,) * 3, "IDLE")


def test_tick_with_a_pose_not_available_is_one_without_a_pose(tracking: Link) -> None:
    answer = tracking.tick(0, (math.nan, 0.0, 0.0), (0.0, 0.0, 0.0))
    tracking.command("STOP")

    assert answer == Answer((0.0,) * 3, (0.0,) * 3, "FAULT")
    assert tracking.fault() == "STALE_POSE"


def test_tick_that_goes_back_is_a_replay_and_not_answered(tracking: Link) -> None:
    answers = drive(tracking)

    with pytest.raises(SilentError, match="TORQUE for tick 0"):
        tracking.tick(0, (0, 0, 0), (0, 0, 0))
    assert tracking.tick(len(answers), (0, 0, 0), (0, 0, 0)).mode == "TRACKING"


@pytest.mark.parametrize("lost", ["TORQUE", "SLIP"])
def test_tick_with_its_answer_lost_is_asked_again_and_stepped_once(
    bus: DisturbedBus, tracking: Link, lost: str
) -> None:
    bus.on_answer = only_once(lost, lambda _: [])

    answers = drive(tracking)

    assert answers == undisturbed_answers()
    assert bus.times_sent("SYNC") == TICKS + 1
    assert bus.times_sent("POSE") == TICKS


def test_tick_with_its_sync_lost_is_asked_again(
    bus: DisturbedBus, tracking: Link, monkeypatch: pytest.MonkeyPatch
) -> None:
    send, lost = bus.send, []

    def lose_first_sync(message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == CODEC["SYNC"].arbitration_id and not lost:
            lost.append(message)
        else:
            send(message, timeout)

    monkeypatch.setattr(bus, "send", lose_first_sync)

    assert drive(tracking) == undisturbed_answers()
    assert len(lost) == 1


def test_tick_with_its_torque_damaged_is_asked_again(bus: DisturbedBus, tracking: Link) -> None:
    def damage(message: can.Message) -> list[can.Message]:
        message.data[1] ^= 0x20
        return [message]

    bus.on_answer = only_once("TORQUE", damage)

    assert drive(tracking) == undisturbed_answers()
    assert bus.times_sent("SYNC") == TICKS + 1


def test_tick_with_its_torque_cut_short_is_asked_again(bus: DisturbedBus, tracking: Link) -> None:
    def cut(message: can.Message) -> list[can.Message]:
        return [can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=message.data[:7])]

    bus.on_answer = only_once("TORQUE", cut)

    assert drive(tracking) == undisturbed_answers()


@pytest.mark.parametrize("stale_first", [True, False])
def test_tick_passes_over_answers_to_earlier_ticks(bus: DisturbedBus, tracking: Link, stale_first: bool) -> None:
    last: dict[int, can.Message] = {}

    def with_the_last_one(message: can.Message) -> list[can.Message]:
        earlier = last.get(message.arbitration_id, message)
        last[message.arbitration_id] = message
        return [earlier, message] if stale_first else [message, earlier]

    bus.on_answer = with_the_last_one

    assert drive(tracking) == undisturbed_answers()
    assert bus.times_sent("SYNC") == TICKS


def test_tick_does_not_mind_frames_of_other_nodes(bus: DisturbedBus, tracking: Link) -> None:
    def with_a_stranger(message: can.Message) -> list[can.Message]:
        stranger = message.arbitration_id ^ 1
        return [can.Message(arbitration_id=stranger, is_extended_id=False, data=message.data), message]

    bus.on_answer = with_a_stranger

    assert drive(tracking) == undisturbed_answers()


# Silence ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ask", "waiting_for"),
    [
        (Link.hello, "IDENTITY"),
        (lambda link: link.tick(5, (0, 0, 0), (0, 0, 0)), "TORQUE for tick 5"),
        (lambda link: link.command("STOP"), "STATUS"),
        (lambda link: link.set_parameter(ROBOT.parameter("order"), 1), "PARAMETER_VALUE"),
        (lambda link: link.upload(straight_line().to_bytes()), "TRAJECTORY_ACK"),
    ],
    ids=["hello", "tick", "command", "parameter", "upload"],
)
def test_silent_firmware_is_an_error_in_time_that_names_node_and_cure(
    bus: DisturbedBus, link: Link, ask: Callable[[Link], object], waiting_for: str
) -> None:
    bus.on_answer = lambda _: []
    start = time.monotonic()

    with pytest.raises(SilentError) as caught:
        ask(link)

    assert time.monotonic() - start < link.timeout_s + 0.5
    assert f"no {waiting_for} from node {NODE} on omnibot firmware in-process" in str(caught.value)
    assert f"within 0.2 s: is the firmware running there? (omnibot-sil --can INTERFACE --node {NODE})" in str(
        caught.value
    )


@pytest.mark.parametrize("name", ["STATUS", "PARAMETER_VALUE"])
def test_frames_that_keep_coming_do_not_put_off_the_timeout(bus: DisturbedBus, tracking: Link, name: str) -> None:
    other = CODEC[name]
    values = [0.0] * len(other.fields)
    chatter = can.Message(arbitration_id=other.arbitration_id, is_extended_id=False, data=other.pack(*values))

    def chat_without_end(timeout: float | None) -> tuple[can.Message, bool]:
        time.sleep(min(1e-4, timeout or 1e-4))
        return chatter, False

    bus._recv_internal = chat_without_end  # type: ignore[method-assign]
    begin = time.monotonic()
    with pytest.raises(SilentError):
        tracking.tick(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert time.monotonic() - begin < 5.0
    with pytest.raises(OmnibotError, match="never falls silent"):
        tracking.hello()


def test_parameter_that_another_host_has_changed_is_noticed(bus: DisturbedBus, link: Link) -> None:
    mine, other = link, Link(bus, CODEC, timeout_s=0.2)
    epsilon = ROBOT.parameter("epsilon")
    mine.set_parameter(epsilon, 0.01)
    mine.check_parameter(epsilon, 0.01)
    other.hello()
    other.set_parameter(epsilon, 0.5)
    with pytest.raises(RefusedError, match=r"holds epsilon = 0\.5, not 0\.01.*--node"):
        mine.check_parameter(epsilon, 0.01)


class SharedBus(DisturbedBus):
    """A bus that others may be on: what they say is heard while somebody waits, before the robot's answers."""

    is_ours_alone = False

    def __init__(self, *others: can.Message) -> None:
        super().__init__()
        self.others = list(others)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if timeout and self.others:
            return self.others.pop(0), False
        return super()._recv_internal(timeout)


def frame(name: str, is_rx: bool = True) -> can.Message:
    return can.Message(
        arbitration_id=CODEC[name].arbitration_id, is_extended_id=False, data=bytes(CODEC[name].length), is_rx=is_rx
    )


@pytest.mark.parametrize("name", ["SYNC", "POSE", "WHEEL_SPEED", "COMMAND", "TRAJECTORY_BEGIN", "TRAJECTORY_DATA"])
def test_host_that_drives_the_robot_is_noticed_before_a_word_is_said(name: str) -> None:
    with SharedBus(frame("STATUS"), frame(name)) as bus:
        with pytest.raises(OmnibotError, match=r"another host drives node 3 .*--node"):
            Link(bus, CODEC).hello()
        assert bus.sent == []


def test_other_nodes_robots_and_our_own_echo_are_no_other_host() -> None:
    elsewhere = can.Message(arbitration_id=Codec(node=NODE + 1)["SYNC"].arbitration_id, is_extended_id=False)
    others = [frame("TORQUE"), frame("STATUS"), frame("SYNC", is_rx=False), frame("PARAMETER_GET"), elsewhere]
    with SharedBus(*others) as bus:
        assert Link(bus, CODEC).hello().version == "0.1.0"
        assert bus.others == []


def test_second_robot_of_the_same_node_is_noticed(bus: DisturbedBus, link: Link) -> None:
    bus.on_answer = lambda message: [message, message]
    with pytest.raises(OmnibotError, match=f"two robots are node {NODE} on .*--node"):
        link.hello()


def test_robot_that_answers_late_is_not_taken_for_two(bus: DisturbedBus, link: Link) -> None:
    bus.on_answer = only_once("IDENTITY", lambda _: [])
    assert link.hello().version == "0.1.0"
    assert bus.times_sent("HELLO") == 2


def test_wheel_speeds_lose_nothing_to_rounding_over_time(tracking: Link) -> None:
    """0.3 of a step: rounded frame by frame it would be 0 for ever."""
    step = CODEC["WHEEL_SPEED"].fields[0].unit_per_step
    seen: list[float] = []
    tracking._record = lambda frame: seen.extend(
        CODEC["WHEEL_SPEED"].unpack(frame[2])[:1] if frame[1] == CODEC["WHEEL_SPEED"].arbitration_id else ()
    )
    for tick in range(100):
        tracking.tick(tick, (0.0, 0.0, 0.0), (0.3 * step, 0.0, 0.0))
    assert sum(seen) == pytest.approx(30.0 * step, abs=step)


def test_firmware_of_another_node_is_silent(bus: DisturbedBus) -> None:
    with pytest.raises(SilentError, match="from node 4"):
        Link(bus, Codec(node=4), timeout_s=0.05).hello()


def test_bus_that_fails_to_send_is_an_error_that_names_it(bus: DisturbedBus, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise can.CanOperationError("cable unplugged")

    monkeypatch.setattr(bus, "send", broken)

    with pytest.raises(OmnibotError, match=r"cannot send on omnibot firmware in-process.*: cable unplugged"):
        Link(bus, CODEC).send("PARAMETER_GET", 0, 0, 0)


@pytest.mark.parametrize("does", ["send", "recv"])
def test_interface_that_is_down_is_brought_up(bus: DisturbedBus, monkeypatch: pytest.MonkeyPatch, does: str) -> None:
    def down(*_: object, **__: object) -> None:
        raise can.CanOperationError("Network is down", errno.ENETDOWN)

    monkeypatch.setattr(bus, does, down)
    with pytest.raises(OmnibotError, match=r"Network is down.*; bring it up: sudo ip link set INTERFACE up"):
        Link(bus, CODEC, timeout_s=0.1).hello()


FULL = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)


def test_frame_waits_for_room_in_an_interface_whose_queue_is_full(
    bus: DisturbedBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    send, full = bus.send, [FULL] * 3

    def send_when_there_is_room(message: can.Message, timeout: float | None = None) -> None:
        if full:
            raise full.pop()
        send(message, timeout)

    monkeypatch.setattr(bus, "send", send_when_there_is_room)
    Link(bus, CODEC).send("PARAMETER_GET", 0, 0, 0)
    assert bus.times_sent("PARAMETER_GET") == 1


def test_interface_that_stays_full_is_an_error(bus: DisturbedBus, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise FULL

    monkeypatch.setattr(bus, "send", never)
    with pytest.raises(OmnibotError, match=r"cannot send on .*: Failed to transmit: No buffer space available"):
        Link(bus, CODEC, timeout_s=0.05).send("PARAMETER_GET", 0, 0, 0)


# Record -------------------------------------------------------------------------------------------------------------


def test_statistics_and_record_have_every_frame_in_order(bus: DisturbedBus) -> None:
    frames: list[tuple[float, int, bytes]] = []
    link = Link(bus, CODEC, record=frames.append)
    link.hello()
    frames.clear()
    link.statistics = BusStatistics()

    link.time_s = 0.25
    link.tick(1, (0, 0, 0), (0, 0, 0))

    names = ["POSE", "WHEEL_SPEED", "SYNC", "TORQUE", "SLIP"]
    assert [(time_s, arbitration_id) for time_s, arbitration_id, _ in frames] == [
        (0.25, CODEC[name].arbitration_id) for name in names
    ]
    assert link.statistics.frames == 5


def test_statistics_count_a_frame_with_worst_case_stuffing() -> None:
    statistics = BusStatistics()

    statistics.add(8)

    assert statistics.bits == 135  # Davis, Burns, Bril, Lukkien 2007: 80 + 10 bits a byte
    assert statistics.load_fraction(1e-3) == pytest.approx(0.135)
    assert statistics.load_fraction(0.0) == 0.0
