"""SLCAN in C on a pseudo-terminal, against python-can's own slcan bus: neither knows of the other."""

import ctypes
import random
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from serial_robot import SerialRobot, SlcanInC
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import Frame
from host_sim.link import Link, SilentError, open_bus
from host_sim.trace import Trace, compare

RUN = ["run", "--start-before-corner", "0.3", "--duration", "0.4", "--order", "1"]


@pytest.fixture
def robot() -> Iterator[SerialRobot]:
    with SerialRobot() as running:
        yield running


def frame_of(arbitration_id: int, data: bytes) -> Frame:
    return Frame(arbitration_id, len(data), (ctypes.c_uint8 * 8)(*data))


def python_can(robot: SerialRobot) -> can.BusABC:
    return can.Bus(interface="slcan", channel=robot.port, bitrate=1_000_000, sleep_after_open=0.0)


def test_lines_that_python_can_writes_are_read_as_the_frames_it_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = random.Random(2014)
    written = bytearray()
    with SerialRobot() as robot, python_can(robot) as bus:
        monkeypatch.setattr(bus, "_write", lambda text: written.extend(text.encode() + b"\r"))
        sent = [(generator.randrange(0x800), generator.randbytes(generator.randrange(9))) for _ in range(500)]
        for arbitration_id, data in sent:
            bus.send(can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False))
    slcan = SlcanInC()
    slcan.feed(ord("O"))
    slcan.feed(ord("\r"))
    frames = [frame for byte in written if (frame := slcan.feed(byte)) is not None]
    assert [(frame.id, bytes(frame.data[: frame.length])) for frame in frames] == sent


def test_lines_that_the_firmware_writes_are_read_by_python_can_as_the_frames_it_meant(robot: SerialRobot) -> None:
    generator = random.Random(2015)
    slcan = SlcanInC()
    slcan.feed(ord("O"))
    slcan.feed(ord("\r"))
    slcan.take()
    with python_can(robot) as bus:
        while bus.recv(0.05) is not None:
            pass
        for _ in range(200):
            arbitration_id, data = generator.randrange(0x800), generator.randbytes(generator.randrange(9))
            assert slcan.put(frame_of(arbitration_id, data))
            robot.say(slcan.take())
            message = bus.recv(2.0)
            assert message is not None
            assert (message.arbitration_id, bytes(message.data)) == (arbitration_id, data)
            assert not message.is_extended_id
            assert not message.is_remote_frame


def test_version_and_serial_number_are_what_python_can_reads(robot: SerialRobot) -> None:
    with python_can(robot) as bus:
        assert bus.get_version(2.0) == (1, 0)  # type: ignore[attr-defined]
        assert bus.get_serial_number(2.0) == "OMNI"  # type: ignore[attr-defined]


def test_session_of_python_can_is_what_the_unit_test_takes_it_for(robot: SerialRobot) -> None:
    with python_can(robot) as bus:
        Link(bus, Codec()).hello()
    assert robot.heard.startswith(b"C\rS8\r\rO\rO\rt4004")


def test_extended_and_remote_frames_do_not_reach_the_firmware_and_do_no_harm(robot: SerialRobot) -> None:
    with python_can(robot) as bus:
        bus.send(can.Message(arbitration_id=0x400, is_extended_id=True, data=b"\0\0\0\0"))
        bus.send(can.Message(arbitration_id=0x400, is_extended_id=False, is_remote_frame=True, dlc=4))
        Link(bus, Codec()).hello()
    assert robot.said.startswith(b"\a\r\r\r\a" + b"\a\a" + b"z\r")  # python-can closes what is closed, opens twice


def test_robot_that_was_closed_in_the_middle_of_a_line_speaks_to_the_next_host(robot: SerialRobot) -> None:
    with python_can(robot) as bus:
        bus._write = lambda text: bus.serialPortOrig.write(text.encode())  # type: ignore[attr-defined]
        bus.send(can.Message(arbitration_id=0x400, is_extended_id=False, data=b"\0\0"))
    with python_can(robot) as bus:
        assert Link(bus, Codec()).hello().protocol_hash == Codec().protocol_hash


# ---- the command line over a serial port


def run(*arguments: str, out: Path) -> None:
    result = CliRunner().invoke(app, [*RUN, *arguments, "--out", str(out)])
    if result.exception is not None:
        raise result.exception


def test_runs_over_a_serial_port_give_the_bytes_of_the_run_in_process(robot: SerialRobot, tmp_path: Path) -> None:
    run(out=tmp_path / "inproc")
    run("-i", "slcan", "-c", robot.port, "-b", "1000000", out=tmp_path / "first")
    run("-i", "slcan", "-c", robot.port, out=tmp_path / "again without a bit rate")
    in_process = Trace.load(tmp_path / "inproc")
    assert len(in_process) == 401
    assert compare(Trace.load(tmp_path / "first"), in_process) == []
    assert compare(Trace.load(tmp_path / "again without a bit rate"), in_process) == []


def open_port(channel: str | None) -> can.BusABC:
    return open_bus("inproc", 0, "slcan", channel, None)


def test_port_that_is_not_there_is_named() -> None:
    with pytest.raises(OmnibotError, match=r"^cannot open /dev/ttyNONE: .*No such file"):
        open_port("/dev/ttyNONE")


def test_port_that_is_no_serial_port_is_named(tmp_path: Path) -> None:
    file = tmp_path / "ttyFILE"
    file.touch()
    with pytest.raises(OmnibotError, match=f"^cannot open {file}: "):
        open_port(str(file))


@pytest.mark.parametrize("channel", [None, "", "@1000000", "/dev/ttyACM0@fast", "/dev/ttyACM0@1@2"])
def test_port_that_is_none_is_asked_for(channel: str | None) -> None:
    with pytest.raises(OmnibotError, match="slcan needs a port: --channel"):
        open_port(channel)


def test_bit_rate_that_slcan_has_no_code_for_is_refused(robot: SerialRobot) -> None:
    with pytest.raises(OmnibotError, match=f"^cannot open {robot.port}: .*bitrate"):
        open_bus("inproc", 0, "slcan", robot.port, 123_456)


def test_port_that_another_run_has_is_refused_before_a_byte_goes_out(robot: SerialRobot) -> None:
    with open_port(robot.port) as bus:
        Link(bus, Codec()).hello()
        heard = len(robot.heard)
        with pytest.raises(OmnibotError, match=f"^{robot.port} is in use by another run"):
            open_port(robot.port)
        assert len(robot.heard) == heard
        Link(bus, Codec()).hello()
    with open_port(robot.port) as bus:  # it is free again
        Link(bus, Codec()).hello()


def test_board_that_does_not_answer_is_named_with_its_port() -> None:
    with SerialRobot(mute=True) as robot, open_port(robot.port) as bus:
        link = Link(bus, Codec(), timeout_s=0.3)
        expected = f"no IDENTITY from node 0 on slcan on {robot.port} within 0.3 s: is the board on"
        with pytest.raises(SilentError, match=expected):
            link.hello()


def test_port_that_is_pulled_out_in_a_run_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with SerialRobot() as robot, open_port(robot.port) as bus:
        link = Link(bus, Codec())
        link.hello()

        def pulled(_: bytes) -> int:
            raise OSError(5, "Input/output error")

        monkeypatch.setattr(bus.serialPortOrig, "write", pulled)  # type: ignore[attr-defined]
        with pytest.raises(OmnibotError, match=f"cannot send on slcan on {robot.port}"):
            link.hello()
        monkeypatch.undo()


def test_frames_are_found_in_what_a_noisy_line_brings() -> None:
    with SerialRobot() as robot, open_port(robot.port) as bus:
        Link(bus, Codec()).hello()
        robot.say(b"\xff\xfe\r" + b"t\r" + b"tXYZ0\r" + b"t05099\r" + b"t12020a0B\r")
        while (message := bus.recv(1.0)) is not None and message.arbitration_id != 0x120:
            pass
        assert message is not None
        assert bytes(message.data) == b"\x0a\x0b"


def test_drain_takes_everything_that_lies_ready(robot: SerialRobot) -> None:
    with open_port(robot.port) as bus:
        Link(bus, Codec()).hello()
        robot.say(b"z\r\r\a" + b"t1200\r" + b"z\r" + b"t1300\r")
        seen = []
        while (message := bus.recv(0.0)) is not None:
            seen.append(message.arbitration_id)
        assert seen == [0x120, 0x130]
