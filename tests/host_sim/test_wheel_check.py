"""One wheel at a time, against the production firmware in lockstep: it is the one wheel that is asked to turn."""

from collections.abc import Iterator

import numpy as np
import pytest

from host_sim import wheel_check
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import LIBRARY_FILE, InprocBus
from host_sim.link import Link
from host_sim.robot import Array, load_robot

ROBOT = load_robot()
TORQUE = 0.02
AT_REST = (0.0, 0.0, 0.0)


@pytest.fixture
def link() -> Iterator[Link]:
    if not LIBRARY_FILE.exists():
        pytest.fail(f"no {LIBRARY_FILE}: cmake --preset host && cmake --build --preset host")
    with InprocBus(node=0) as bus:
        yield Link(bus, Codec(node=0))


def torques_at(link: Link, wheel: int, wheel_speed: Array) -> Array:
    """The torques that the firmware answers with on its second tick, wheels turning so fast."""
    wheel_check.prepare(link, ROBOT, wheel, TORQUE, 1.0)
    link.start()
    link.tick(0, AT_REST, tuple(wheel_speed))
    answer = link.tick(1, AT_REST, tuple(wheel_speed))
    link.command("STOP")
    return np.array(answer.torque_Nm)


@pytest.mark.parametrize("wheel", [1, 2, 3])
def test_firmware_turns_that_wheel_forwards_and_no_other(link: Link, wheel: int) -> None:
    torques = torques_at(link, wheel, np.zeros(3))

    expected = TORQUE * np.eye(3)[wheel - 1]
    # The point moves on a circle when the robot turns, which the displacement takes for a straight line.
    assert torques == pytest.approx(expected, abs=0.03 * TORQUE)


@pytest.mark.parametrize("wheel", [1, 2, 3])
@pytest.mark.parametrize("turning", [+1.0, -1.0])
def test_torque_falls_when_the_wheel_turns_forwards_and_rises_when_backwards(
    link: Link, wheel: int, turning: float
) -> None:
    at_rest = torques_at(link, wheel, np.zeros(3))[wheel - 1]
    moving = torques_at(link, wheel, turning * 3.0 * np.eye(3)[wheel - 1])[wheel - 1]

    assert (moving < wheel_check.AGREED * at_rest) == (turning > 0.0)
    assert (moving > wheel_check.OPPOSED * at_rest) == (turning < 0.0)


def test_drive_judges_the_wheel_that_it_drove_and_stops(link: Link, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wheel_check, "REST_S", 0.1)  # this robot's time is the host's: a beat is one tick of it
    wheel_check.prepare(link, ROBOT, 2, TORQUE, 1.0)
    shown: list[Array] = []

    verdict = wheel_check.drive(link, 2, 0.2, shown.append)

    assert verdict.first_Nm == pytest.approx(TORQUE, rel=0.05)
    assert "hardly counted" in verdict.text  # the host tells that the wheels stand still
    assert len(shown) == 2
    assert link.codec["STATUS"].label("mode", link.status["mode"]) == "STOPPING"


def test_fault_of_the_robot_ends_the_drive(link: Link, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel_check.prepare(link, ROBOT, 1, TORQUE, 1.0)
    link.set_parameter(ROBOT.parameter("pose_timeout_s"), 0.0)
    send_sensors = link.send_sensors
    monkeypatch.setattr(link, "send_sensors", lambda tick, _, speed: send_sensors(tick, None, speed))

    with pytest.raises(OmnibotError, match="stopped by itself: STALE_POSE"):
        wheel_check.drive(link, 1, 0.1, lambda _: None)


@pytest.mark.parametrize(
    ("first", "last", "words"),
    [
        (0.02, 0.0, "signs are right"),
        (0.02, -0.01, "signs are right"),
        (0.02, 0.02, "hardly counted"),
        (0.02, 0.04, "against the motor"),
        (0.0, 0.0, "hardly counted"),
    ],
)
def test_torque_is_judged(first: float, last: float, words: str) -> None:
    assert words in wheel_check.judge(first, last).text


def test_robot_without_motors_is_told_apart(capsys: pytest.CaptureFixture[str]) -> None:
    status = wheel_check.main(["-i", "omnibot", "-c", "inproc", "--wheel", "1"])

    assert status == 1
    assert "USE_MOTORS: UNABLE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--torque", "0.2"], "--torque 0.2: must be above 0 and at most 0.15 N*m"),
        (["--torque", "0"], "--torque 0: must be above 0"),
        (["--torque", "nan"], "--torque nan: must be above 0"),
        (["--duration", "100"], "--duration 100: must be 0.01 … 60 s"),
        (["--wheel", "4"], "invalid choice: 4"),
    ],
)
def test_bad_command_line_is_named(words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        wheel_check.main(["-i", "omnibot", "-c", "inproc", "--wheel", "1", *words])

    assert complaint in capsys.readouterr().err
