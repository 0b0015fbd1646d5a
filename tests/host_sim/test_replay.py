"""Replay: a session's frames give the recorded answers; what was changed in the log is named by tick, signal, size."""

import re
from collections.abc import Callable
from pathlib import Path

import can
import cantools
import pytest
from cantools.database.can import Database

from host_sim.canlog import Recording, write_log
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import FrameRecord, Link
from host_sim.planner import PathRequest, plan
from host_sim.replay import Difference, Outcome, inspect, replay
from host_sim.robot import ROOT, load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario

CODEC = Codec()
TICK = 237

Frames = list[can.Message]
Edit = Callable[[Frames], None]


def replay_of(path: Path, timeout_s: float = 2.0) -> Outcome:
    session = inspect(path)
    with InprocBus() as bus:
        return replay(session, bus, timeout_s)


def places(frames: Frames, name: str) -> list[int]:
    """Return where the frames of a message are in a log."""
    return [k for k, frame in enumerate(frames) if frame.arbitration_id == CODEC[name].arbitration_id]


def of_tick(frames: Frames, name: str) -> can.Message:
    """Return the frame of a message that comes once a tick, at TICK."""
    return frames[places(frames, name)[TICK]]


def edited(recorded_run: Path, path: Path, edit: Edit) -> Path:
    """Write the recorded session with a change."""
    frames = list(Recording(recorded_run))
    edit(frames)
    write_log(frames, path, path.suffix)
    return path


# ---- the same again


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_fresh_run_is_replayed_byte_for_byte(tmp_path: Path, recorded_run: Path, suffix: str) -> None:
    path = edited(recorded_run, tmp_path / f"bus{suffix}", lambda _: None)

    outcome = replay_of(path)

    recorded = list(Recording(path))
    senders = cantools.database.load_file(ROOT / "protocol" / "omnibot.dbc")
    assert isinstance(senders, Database)
    from_robot = [f for f in recorded if senders.get_message_by_frame_id(f.arbitration_id).senders == ["ROBOT"]]
    assert outcome.found == {}
    assert outcome.ticks == 761
    assert outcome.frames == len(from_robot) - 1  # but for the STATUS of its start, before HELLO
    assert outcome.beyond == 0


def test_log_may_end_within_the_drive(tmp_path: Path, recorded_run: Path) -> None:
    def cut(frames: Frames) -> None:
        del frames[places(frames, "SYNC")[TICK] + 1 :]

    outcome = replay_of(edited(recorded_run, tmp_path / "bus.log", cut))

    assert outcome.found == {}
    assert outcome.beyond == 2  # TORQUE and SLIP of the last SYNC


def test_hello_that_nobody_heard_changes_nothing(tmp_path: Path, recorded_run: Path) -> None:
    def repeat(frames: Frames) -> None:
        hello = places(frames, "HELLO")[0]
        frames.insert(hello, frames[hello])

    assert replay_of(edited(recorded_run, tmp_path / "bus.log", repeat)).found == {}


def test_other_robots_and_frames_on_the_bus_change_nothing(tmp_path: Path, recorded_run: Path) -> None:
    def crowd(frames: Frames) -> None:
        other = Codec(node=3)["TORQUE"]
        frames[500:500] = [
            can.Message(0.0, other.arbitration_id, is_extended_id=False, data=other.pack(0.1, 0.1, 0.1, 0, 3)),
            can.Message(0.0, 0x7F0, is_extended_id=False, data=b"1234"),
            can.Message(0.0, 0x050, is_extended_id=True, data=b"12345678"),
            can.Message(0.0, is_error_frame=True),
        ]

    path = edited(recorded_run, tmp_path / "bus.log", crowd)
    with InprocBus() as bus:
        assert replay(inspect(path, node=0), bus).found == {}


# ---- what was changed is named


def flip(name: str, bit: int) -> Edit:
    """Change one bit of the frame of TICK, as a fault between bus and log would."""

    def edit(frames: Frames) -> None:
        of_tick(frames, name).data[bit // 8] ^= 1 << bit % 8

    return edit


def flip_and_seal(bit: int) -> Edit:
    """Change one bit of the POSE of TICK, and the checksums that vouch for it."""

    def edit(frames: Frames) -> None:
        flip("POSE", bit)(frames)
        sync = of_tick(frames, "SYNC")
        tick, _, wheel_speed_crc = CODEC["SYNC"].unpack(bytes(sync.data))
        seal = CODEC["POSE"].seal(bytes(of_tick(frames, "POSE").data))
        sync.data = bytearray(CODEC["SYNC"].pack(tick, seal, wheel_speed_crc))

    return edit


def lose(name: str) -> Edit:
    def edit(frames: Frames) -> None:
        del frames[places(frames, name)[TICK]]

    return edit


def found_in(path: Path) -> dict[str, Difference]:
    return {item.name: item for item in replay_of(path).differences}


def torque_at_tick(frames: Frames) -> dict[str, float]:
    """Return what cantools decodes of the recorded TORQUE of TICK."""
    database = cantools.database.load_file(ROOT / "protocol" / "omnibot.dbc")
    assert isinstance(database, Database)
    values = database.decode_message("TORQUE", bytes(of_tick(frames, "TORQUE").data), decode_choices=False)
    return {f"TORQUE.{name}": float(value) for name, value in values.items()}  # type: ignore[arg-type, union-attr]


@pytest.mark.parametrize(
    "edit", [flip("POSE", 0), flip("POSE", 12), flip_and_seal(12), flip("WHEEL_SPEED", 25), lose("POSE")]
)
def test_changed_sensor_frame_changes_the_torque_of_its_tick(tmp_path: Path, recorded_run: Path, edit: Edit) -> None:
    recorded = torque_at_tick(list(Recording(recorded_run)))

    found = found_in(edited(recorded_run, tmp_path / "bus.log", edit))

    torques = [item for name, item in found.items() if re.fullmatch("TORQUE.wheel._Nm", name)]
    assert torques
    for item in torques:
        assert isinstance(item.replayed, float)
        if item.first_tick == TICK:
            assert item.recorded == pytest.approx(recorded[item.name], abs=1e-9)
        assert item.largest >= 0.99e-5  # a step of the wire
    assert min(item.first_tick or 0 for item in found.values()) == TICK


def test_damaged_sensor_frame_is_told_as_dropped(tmp_path: Path, recorded_run: Path) -> None:
    found = found_in(edited(recorded_run, tmp_path / "bus.log", flip("POSE", 12)))
    assert (found["DROPS.damaged"].recorded, found["DROPS.damaged"].replayed) == (0, 1)
    found = found_in(edited(recorded_run, tmp_path / "bus.log", flip_and_seal(12)))
    assert "DROPS.damaged" not in found


@pytest.mark.parametrize(
    ("bit", "name", "size"),
    [(0, "wheel1_Nm", 1e-5), (18, "wheel2_Nm", 4e-5), (43, "wheel3_Nm", 0.02048)],
)
def test_altered_torque_is_off_by_the_altered_bit(
    tmp_path: Path, recorded_run: Path, bit: int, name: str, size: float
) -> None:
    (item,) = found_in(edited(recorded_run, tmp_path / "bus.log", flip("TORQUE", bit))).values()

    assert (item.name, item.unit, item.first_tick, item.frames) == (f"TORQUE.{name}", "N*m", TICK, 1)
    assert item.largest == pytest.approx(size)
    assert f"tick {TICK}: TORQUE.{name}" in str(item)


def test_altered_mode_and_checksum_are_named(tmp_path: Path, recorded_run: Path) -> None:
    (item,) = found_in(edited(recorded_run, tmp_path / "mode.log", flip("TORQUE", 53))).values()
    assert (item.name, item.recorded, item.replayed) == ("TORQUE.mode", "IDLE", "TRACKING")
    (item,) = found_in(edited(recorded_run, tmp_path / "crc.log", flip("TORQUE", 63))).values()
    assert "CRC" in item.name
    assert item.first_tick == TICK


@pytest.mark.parametrize("name", ["TORQUE", "SLIP"])
def test_lost_answer_is_named_and_nothing_else(tmp_path: Path, recorded_run: Path, name: str) -> None:
    (item,) = found_in(edited(recorded_run, tmp_path / "bus.log", lose(name))).values()
    assert (item.name, item.first_tick, item.frames, item.recorded) == (name, TICK, 1, "no frame")


def test_answer_to_another_tick_stands_for_no_other(tmp_path: Path, recorded_run: Path) -> None:
    outcome = replay_of(edited(recorded_run, tmp_path / "bus.log", flip("TORQUE", 49)))  # of its counter

    assert [(item.name, item.frames, item.replayed) for item in outcome.differences] == [
        ("TORQUE", 1, "no frame"),
        ("TORQUE", 1, "a frame"),
    ]
    assert outcome.differences[1].first_tick == TICK


def test_lost_tick_is_named_by_the_answers_that_do_not_come(tmp_path: Path, recorded_run: Path) -> None:
    found = found_in(edited(recorded_run, tmp_path / "bus.log", lose("SYNC")))
    for name in ("TORQUE", "SLIP"):
        assert (found[name].first_tick, found[name].frames, found[name].replayed) == (TICK, 1, "no frame")
    assert (found["STATUS.missed_ticks"].recorded, found["STATUS.missed_ticks"].replayed) == (0, 1)


def test_another_parameter_is_named_by_its_value_and_the_torque(tmp_path: Path, recorded_run: Path) -> None:
    def change(frames: Frames) -> None:
        frame = frames[places(frames, "PARAMETER_SET")[5]]
        index, value, counter = CODEC["PARAMETER_SET"].unpack(bytes(frame.data))
        frame.data = bytearray(CODEC["PARAMETER_SET"].pack(index, 1.5 * value, counter))

    found = found_in(edited(recorded_run, tmp_path / "bus.log", change))

    value = found["PARAMETER_VALUE.value"]
    assert value.first_tick is None
    assert isinstance(value.recorded, float)
    assert value.replayed == 1.5 * value.recorded
    assert "before the first tick" in str(value)
    assert "TORQUE.wheel1_Nm" in found


# ---- what cannot be replayed


def refusal(path: Path) -> str:
    with pytest.raises(OmnibotError) as refused:
        inspect(path)
    return str(refused.value)


def test_log_of_a_real_time_session_is_refused(tmp_path: Path, recorded_run: Path) -> None:
    def use_realtime(frames: Frames) -> None:
        for k in places(frames, "COMMAND"):
            operation, counter, key = CODEC["COMMAND"].unpack(bytes(frames[k].data))
            if CODEC["COMMAND"].label("operation", operation) == "USE_LOCKSTEP":
                other = CODEC["COMMAND"].choices["operation"]["USE_REALTIME"]
                frames[k].data = bytearray(CODEC["COMMAND"].pack(other, counter, key))

    assert "--time lockstep" in refusal(edited(recorded_run, tmp_path / "bus.log", use_realtime))


def test_log_without_the_beginning_of_its_session_is_refused(tmp_path: Path, recorded_run: Path) -> None:
    def cut(frames: Frames) -> None:
        del frames[: places(frames, "SYNC")[TICK]]

    assert "from its beginning" in refusal(edited(recorded_run, tmp_path / "bus.log", cut))


def test_log_of_another_protocol_is_refused(tmp_path: Path, recorded_run: Path) -> None:
    def other(frames: Frames) -> None:
        frames[places(frames, "HELLO")[0]].data = bytearray.fromhex("78563412")

    assert "12345678" in refusal(edited(recorded_run, tmp_path / "bus.log", other))


def test_damaged_log_sends_nothing(tmp_path: Path, recorded_run: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_bytes((recorded_run / "bus.log").read_bytes()[:-7])
    assert "cut off" in refusal(path)


# ---- a robot with a life before, and one that dies


def drive_a_little(bus: can.BusABC, gap: int = 0, record: Callable[[FrameRecord], None] | None = None) -> None:
    link = Link(bus, CODEC, record=record)
    link.hello()
    link.upload(plan(PathRequest("line", 0.3)).to_bytes())
    link.start()
    for tick in range(60):
        link.time_s = 1e-3 * tick
        link.tick(tick + (gap if tick > 30 else 0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    link.command("STOP")


@pytest.mark.parametrize("gap", [0, 50])
def test_second_session_is_replayed_but_for_what_came_of_the_first(tmp_path: Path, gap: int) -> None:
    """The first one leaves a robot that brakes, or that has the fault TICK_GAP, and has dropped a frame."""
    recorded: list[FrameRecord] = []
    with InprocBus() as bus:
        drive_a_little(bus, gap)
        bus.send(can.Message(arbitration_id=0x040, is_extended_id=False, data=bytes(7)))
        drive_a_little(bus, record=recorded.append)
    frames = (can.Message(time_s, name, is_extended_id=False, data=data) for time_s, name, data in recorded)
    write_log(frames, tmp_path / "second.log", ".log")

    outcome = replay_of(tmp_path / "second.log")

    assert outcome.differences == []
    assert outcome.ticks == 60
    names = {item.name for item in outcome.excused if not item.name.startswith("STATUS before START.")}
    assert names == {"CHALLENGE.key", "DROPS.damaged", "STATUS.dropped_frames"}


def test_parameters_that_the_session_found_set_are_told_apart(tmp_path: Path) -> None:
    recorded: list[FrameRecord] = []
    robot, scenario = load_robot(), Scenario(PathRequest("line", 0.5))
    with InprocBus() as bus:
        drive_a_little(bus)
        tuning = Link(bus, CODEC)
        tuning.hello()
        tuning.set_parameter(robot.parameter("braking_m_per_s2"), 3.0)
        link = Link(bus, CODEC, record=recorded.append)
        prepare(link, robot, scenario, plan(scenario.path))
        link.tick(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    frames = [can.Message(time_s, name, is_extended_id=False, data=data) for time_s, name, data in recorded]
    write_log(frames, tmp_path / "second.log", ".log")

    outcome = replay_of(tmp_path / "second.log")

    assert outcome.differences == []
    assert "PARAMETER_VALUE before PARAMETER_SET.value" in {item.name for item in outcome.excused}


class Robot(can.BusABC):
    """A robot at the far end of a bus, that falls silent after so many SYNCs."""

    channel_info = "far away"

    def __init__(self, syncs: int) -> None:
        self._inner = InprocBus()
        self._left = syncs
        self.sent: list[int] = []
        super().__init__(channel=None)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append(msg.arbitration_id)
        self._left -= msg.arbitration_id == 0x040
        if self._left >= 0:
            self._inner.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self._inner._recv_internal(timeout)

    def shutdown(self) -> None:
        self._inner.shutdown()
        super().shutdown()


def test_robot_far_away_is_made_to_rest_before_and_after(recorded_run: Path) -> None:
    with Robot(syncs=10_000) as bus:
        drive_a_little(bus)
        bus.sent.clear()
        outcome = replay(inspect(recorded_run), bus)

    assert outcome.differences == []
    assert {item.name for item in outcome.excused} == {"CHALLENGE.key"}
    assert bus.sent[0] == CODEC["HELLO"].arbitration_id
    assert bus.sent[-1] == CODEC["COMMAND"].arbitration_id


def test_robot_that_falls_silent_is_told_with_its_tick(recorded_run: Path) -> None:
    with Robot(syncs=300) as bus:
        outcome = replay(inspect(recorded_run), bus, timeout_s=0.2)

    assert "tick 300: no TORQUE" in outcome.gave_up
    assert [(item.name, item.first_tick, item.replayed) for item in outcome.differences] == [
        ("TORQUE", 300, "no frame")
    ]
