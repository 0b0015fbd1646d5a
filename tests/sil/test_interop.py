"""Other people's tools on our bus, with our definition of it, unmodified: cantools, can-utils and python-can.

All of them listen to one run. It is slow, so that the slowest of them keeps up; the oracle is its trace.
"""

import collections
import math
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import can
import pytest
from listeners import (
    DEADLINE_S,
    PYTHON,
    Frame,
    Listeners,
    Signals,
    Terminal,
    decoded,
    frames_of_candump,
    listeners,
    number,
    once_a_tick,
    rows_of,
    torque_by_tick,
)
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import DBC_FILE, Codec
from host_sim.trace import Trace

Start = Callable[..., "subprocess.Popen[bytes]"]

CORNER = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "0.4"]
TICKS = 401
FORMATS = ("log", "asc", "blf")  # that python-can's scripts write and read
CODEC = Codec()
# What answers of the firmware follow from the frames that it gets; STATUS and DROPS count the played answers as well.
ANSWERS = [
    CODEC[name].arbitration_id
    for name in ("TORQUE", "SLIP", "IDENTITY", "CHALLENGE", "PARAMETER_VALUE", "TRAJECTORY_ACK")
]


@dataclass(frozen=True)
class Recording:
    """A run, and what everybody heard of it."""

    folder: Path
    trace: Trace
    decoded: list[tuple[str, Signals]]  # cantools decode
    screen: list[str]  # of cantools monitor

    @property
    def candump(self) -> Path:
        return next(self.folder.glob("candump-*.log"))

    def messages(self, name: str) -> list[Signals]:
        """The messages of a name, by cantools decode."""
        return [signals for found, signals in self.decoded if found == name]


def start_listeners(heard: Listeners, folder: Path) -> None:
    """Start a candump that writes a log, one that is decoded as it comes, and a can.logger for each format."""
    heard.start("candump", "-l", "vcan0", cwd=folder, stdout=subprocess.DEVNULL)
    with (folder / "decoded").open("w") as out:
        candump = heard.start("candump", "vcan0", stdout=subprocess.PIPE)
        heard.also(PYTHON, "-m", "cantools", "decode", DBC_FILE, stdin=candump.stdout, stdout=out)
    assert candump.stdout is not None
    candump.stdout.close()
    for suffix in FORMATS:
        logger = (PYTHON, "-m", "can.logger", "-i", "socketcan", "-c", "vcan0", "-f", folder / f"logger.{suffix}")
        heard.start(*logger, stdout=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, start_firmware_once: Start) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    firmware = start_firmware_once()
    terminal = Terminal(rows=250, columns=100)
    with listeners() as heard:
        start_listeners(heard, folder)
        heard.start(
            *(PYTHON, "-m", "cantools", "monitor", DBC_FILE, "-i", "socketcan", "-c", "vcan0"), **terminal.options()
        )
        run = CliRunner().invoke(app, ["run", *CORNER, "--bus", "vcan0", "--pace", "0.1", "--out", str(folder)])
        assert run.exit_code == 0, run.output
    firmware.kill()  # what is played later is played to another one
    firmware.wait()
    screen = terminal.lines()
    return Recording(folder, Trace.load(folder), decoded((folder / "decoded").read_text().splitlines()), screen)


# ---- cantools decode


def test_cantools_decodes_torque_and_slip_of_every_tick(recording: Recording) -> None:
    torque = once_a_tick(recording.messages("TORQUE"))
    slip = once_a_tick(recording.messages("SLIP"))

    wheels = ("wheel1_Nm", "wheel2_Nm", "wheel3_Nm")
    assert [tuple(number(row[wheel]) for wheel in wheels) for row in torque] == rows_of(recording.trace, "torque")
    mus = ("mu1_m_per_s", "mu2_m_per_s", "mu3_m_per_s")
    assert [tuple(number(row[mu]) for mu in mus) for row in slip] == rows_of(recording.trace, "mu")
    assert {row["wheel1_Nm"].partition(" ")[2] for row in torque} == {"N*m"}
    assert {row["mode"] for row in torque} == {"TRACKING"}


def test_cantools_decodes_pose_and_wheel_speed_to_a_step(recording: Recording) -> None:
    poses, speeds = recording.messages("POSE"), recording.messages("WHEEL_SPEED")

    assert len(poses) == len(speeds) == len(recording.trace)
    for pose, truth in zip(poses, rows_of(recording.trace, "pose"), strict=True):
        assert number(pose["x1_m"]) == pytest.approx(truth[0], abs=0.51e-5)
        assert number(pose["x2_m"]) == pytest.approx(truth[1], abs=0.51e-5)
        assert math.remainder(number(pose["heading_rad"]) - truth[2], math.tau) == pytest.approx(0.0, abs=0.51e-4)
    # Half a step of rounding, and half of one that the frame before had left over.
    wheels = ("wheel1_rad_per_s", "wheel2_rad_per_s", "wheel3_rad_per_s")
    for speed, truth in zip(speeds, rows_of(recording.trace, "wheel_speed"), strict=True):
        assert [number(speed[wheel]) for wheel in wheels] == pytest.approx(truth, abs=0.51e-3)


def test_cantools_decodes_every_frame_by_name(recording: Recording) -> None:
    names = {name for name, _ in recording.decoded}

    assert len(recording.decoded) == len(frames_of_candump(recording.candump))
    assert names >= {"HELLO", "IDENTITY", "PARAMETER_SET", "TRAJECTORY_DATA", "CHALLENGE", "STATUS", "DROPS"}
    assert recording.messages("IDENTITY")[0]["drive"] == "LOCKSTEP"
    set_epsilon = [row["value"] for row in recording.messages("PARAMETER_SET") if row["index"] == "1"]
    assert [float(value) for value in set_epsilon] == pytest.approx([0.01])


# ---- cantools monitor


def test_cantools_monitor_shows_every_message_with_its_last_values(recording: Recording) -> None:
    shown = dict(decoded(recording.screen))

    assert "Discarded: 0, Errors: 0" in recording.screen[0]
    assert shown.keys() == {name for name, _ in recording.decoded}
    for name, signals in shown.items():
        assert signals == recording.messages(name)[-1], name
    assert [number(shown["TORQUE"][f"wheel{n}_Nm"]) for n in (1, 2, 3)] == recording.trace.torque[-1].tolist()


# ---- candump's log, and ours


def test_our_log_tells_what_candump_heard(recording: Recording) -> None:
    """For each identifier: what crosses on its way between two programs may be in another order between them."""
    ours, theirs = by_identifier(frames_of_candump(recording.folder / "bus.log")), by_identifier(heard_by(recording))

    assert ours.keys() == theirs.keys()
    for identifier, payloads in theirs.items():
        told = ours[identifier]
        assert payloads[: len(told)] == told
        assert len(payloads) - len(told) <= 1  # what follows the last answer, nobody waits for


def test_our_tools_read_candumps_log(recording: Recording) -> None:
    with can.LogReader(recording.candump) as log:
        frames = [(message.arbitration_id, bytes(message.data)) for message in log]

    assert torque_by_tick(frames, CODEC) == rows_of(recording.trace, "torque")


def heard_by(recording: Recording) -> list[Frame]:
    return frames_of_candump(recording.candump)


def by_identifier(frames: list[Frame]) -> dict[int, list[bytes]]:
    payloads: dict[int, list[bytes]] = collections.defaultdict(list)
    for identifier, data in frames:
        payloads[identifier].append(data)
    return payloads


# ---- python-can's logger


@pytest.mark.parametrize("suffix", FORMATS)
def test_python_can_logger_writes_what_candump_heard(recording: Recording, suffix: str) -> None:
    with can.LogReader(recording.folder / f"logger.{suffix}") as log:
        frames = [(message.arbitration_id, bytes(message.data)) for message in log]

    assert frames == heard_by(recording)


# ---- a recording played to the firmware


def answers_in(log: Path) -> collections.Counter[Frame]:
    return collections.Counter(frame for frame in frames_of_candump(log) if frame[0] in ANSWERS)


def play(folder: Path, *player: str | Path) -> collections.Counter[Frame]:
    """Return the answers on the bus while a recording is played to the firmware."""
    log = folder / "heard.log"
    with listeners() as heard, log.open("w") as out:
        heard.start("candump", "-L", "vcan0", stdout=out)
        subprocess.run(player, check=True, stdout=subprocess.DEVNULL, timeout=DEADLINE_S)
    return answers_in(log)


def twice(answers: collections.Counter[Frame]) -> collections.Counter[Frame]:
    """A player sends the recorded answers as well; the firmware, just started, must give each of them again."""
    assert answers.total() > 2 * TICKS
    return answers + answers


def test_canplayer_plays_candumps_log_and_the_firmware_answers_as_it_did(
    tmp_path: Path, recording: Recording, start_firmware: Start
) -> None:
    # Not our bus.log: what is sent before the drive has one time there, and so many frames at once find no room.
    start_firmware()
    log = recording.candump

    assert play(tmp_path, "canplayer", "-I", log) == twice(answers_in(log))


@pytest.mark.parametrize("suffix", FORMATS)
def test_python_can_player_plays_each_format_and_the_firmware_answers_as_it_did(
    tmp_path: Path, recording: Recording, start_firmware: Start, suffix: str
) -> None:
    start_firmware()
    # A tick of the firmware is counted, not timed; but what comes too fast for a busy machine is lost.
    pace = ("--ignore-timestamps", "--gap", "0.002")
    player = (PYTHON, "-m", "can.player", "-i", "socketcan", "-c", "vcan0", *pace)

    answers = play(tmp_path, *player, recording.folder / f"logger.{suffix}")

    assert answers == twice(answers_in(recording.candump))
