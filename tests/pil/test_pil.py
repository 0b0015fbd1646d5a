"""omnibot run --bus pil: the same bytes as in-process, and no emulator left behind, whatever happens."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from image import IMAGE_FILE
from processes import emulators_of, is_running, wait_until

from host_sim import pil
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import LIBRARY_FILE
from host_sim.link import Link, open_bus
from host_sim.pil import EmulatedBoard, Emulator

OMNIBOT = Path(sys.executable).parent / "omnibot"
# The paper's rhombus at its slowest speed: from a straight side through the whole rounded corner onto the next side.
CORNER = [OMNIBOT, "run", "--path", "rhombus", "--speed", "0.0936", "--corner", "rounded", "--epsilon", "0.01"]
CORNER += ["--order", "1", "--traction", "magic", "--start-before-corner", "0.2", "--duration", "0.5"]
PIL = ["--bus", "pil", "--channel", IMAGE_FILE]
LAP = [OMNIBOT, "run", *PIL]  # of the rhombus: longer than any test waits
PATIENT = ["--timeout", "30"]  # where other tests have the machine

Running = "subprocess.Popen[str]"


def omnibot(*arguments: str | Path, **options: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([OMNIBOT, *arguments], capture_output=True, text=True, timeout=120, check=False, **options)  # type: ignore[call-overload,no-any-return]


def start(command: list[str | Path], out: Path) -> Running:
    return subprocess.Popen(
        [*command, *PATIENT, "--out", out], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def finish(process: Running) -> tuple[int, str]:
    _, messages = process.communicate(timeout=120)
    return process.returncode, messages


@pytest.fixture
def lap(tmp_path: Path) -> Iterator[tuple[Running, int, Path]]:
    """A lap that is being driven, the emulator it has started, and its folder."""
    folder = tmp_path / "lap"
    process = start(LAP, folder)
    log = folder / "bus.log"
    wait_until(lambda: log.exists() and b" 040#" in log.read_bytes(), 60.0)  # a SYNC
    (emulator,) = emulators_of(process.pid)
    yield process, emulator, folder
    process.kill()
    process.communicate()
    if is_running(emulator):  # a test has failed: that emulator shall not outlive it
        os.kill(emulator, signal.SIGKILL)


# ---- the same bytes


@pytest.fixture(scope="module")
def corner_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two emulated runs at once, and one in-process."""
    folder = tmp_path_factory.mktemp("corner")
    started = [start([*CORNER, *PIL], folder / name) for name in ("first", "second")]
    started.append(start([*CORNER, "--bus", "inproc"], folder / "inproc"))
    assert [finish(process) for process in started] == [(0, "")] * 3
    return folder


def test_trace_over_the_corner_is_that_of_the_run_in_process(corner_runs: Path) -> None:
    result = omnibot("compare", corner_runs / "first", corner_runs / "inproc")
    assert result.stdout.endswith("agree in every array, all 501 ticks, byte for byte\n")
    assert result.returncode == 0


def test_runs_at_once_give_the_same_log_byte_for_byte(corner_runs: Path) -> None:
    logs = [(corner_runs / name / "bus.log").read_bytes() for name in ("first", "second")]
    assert logs[0].count(b"\n") > 501 * 5
    assert logs[0] == logs[1]


def test_corner_is_driven_and_not_a_straight_line(corner_runs: Path) -> None:
    result = json.loads((corner_runs / "first" / "result.json").read_text())
    assert result["status"] == "completed"
    assert result["bus"]["name"] == "pil"
    assert result["tracking"]["max_path_deviation_m"] > 1e-4  # what rounding takes off the corner


# ---- from power-on


def test_board_tells_who_it_is_and_drives_nothing_after_power_on() -> None:
    with EmulatedBoard(IMAGE_FILE) as board:
        link = Link(board, Codec())
        assert link.hello().protocol_hash == Codec().protocol_hash
        assert Codec()["STATUS"].label("mode", link.status["mode"]) == "IDLE"
        assert link.fault() == "NONE"
        answer = link.tick(1, (0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
        assert answer.torque_Nm == (0.0, 0.0, 0.0)
        assert answer.mode == "IDLE"


def test_firmware_that_boots_slowly_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def slow_at_first(board: EmulatedBoard, timeout: float | None) -> tuple[int | None, int | None]:
        asked.append(timeout)
        return (None, None) if len(asked) < 3 else super(EmulatedBoard, board).get_version(timeout)

    monkeypatch.setattr(EmulatedBoard, "get_version", slow_at_first, raising=False)
    with EmulatedBoard(IMAGE_FILE) as board:
        Link(board, Codec()).hello()
    assert len(asked) >= 3


# ---- no emulator stays behind


def test_emulator_ends_with_the_bus() -> None:
    with EmulatedBoard(IMAGE_FILE) as board:
        pid = board.emulator.pid
        assert is_running(pid)
    assert not is_running(pid)


def test_emulator_ends_with_an_exception_in_the_run() -> None:
    with contextlib.suppress(ZeroDivisionError), EmulatedBoard(IMAGE_FILE) as board:
        pid = board.emulator.pid
        raise ZeroDivisionError
    assert not is_running(pid)


def test_emulator_that_was_stopped_by_a_signal_is_a_firmware_that_is_silent() -> None:
    with EmulatedBoard(IMAGE_FILE) as board:
        link = Link(board, Codec(), timeout_s=0.5)
        link.hello()
        os.kill(board.emulator.pid, signal.SIGSTOP)
        with pytest.raises(OmnibotError, match=r"no TORQUE for tick 1 from node 0 on qemu.*within 0.5 s"):
            link.tick(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert not is_running(board.emulator.pid)


def test_emulator_killed_in_a_run_is_named_as_the_cause(lap: tuple[Running, int, Path]) -> None:
    process, emulator, folder = lap
    os.kill(emulator, signal.SIGKILL)
    status, messages = finish(process)
    assert status == 1
    assert "qemu-system-arm ended by signal 9" in messages
    assert "Traceback" not in messages
    assert json.loads((folder / "result.json").read_text())["status"] == "fault"


def test_emulator_ends_with_ctrl_c_and_the_run_is_written(lap: tuple[Running, int, Path]) -> None:
    process, emulator, folder = lap
    os.kill(process.pid, signal.SIGINT)
    status, messages = finish(process)
    assert status != 0
    assert "Traceback" not in messages
    assert json.loads((folder / "result.json").read_text())["status"] == "interrupted"
    assert not is_running(emulator)


@pytest.mark.parametrize("killer", [signal.SIGKILL, signal.SIGTERM], ids=lambda killer: killer.name)
def test_emulator_ends_with_a_run_that_is_killed(lap: tuple[Running, int, Path], killer: signal.Signals) -> None:
    process, emulator, _ = lap
    os.kill(process.pid, killer)
    finish(process)
    wait_until(lambda: not is_running(emulator))


# ---- errors


def refused(image: Path) -> str:
    with pytest.raises(OmnibotError) as error:
        open_bus("pil", 0, None, str(image), None)
    return str(error.value)


def test_image_that_is_not_there_is_named_with_its_cure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert refused(tmp_path / "other.elf").endswith("(No such file or directory): give the board's omnibot.elf")
    monkeypatch.setattr(pil, "IMAGE_FILE", tmp_path / "omnibot.elf")
    assert refused(tmp_path / "omnibot.elf").endswith("(No such file or directory): tools/build board makes it")


def test_file_that_is_no_elf_for_arm_is_refused(tmp_path: Path) -> None:
    for content in (b"", b"\x7fELF\x01\x01", b"#!/bin/sh\n" * 9, IMAGE_FILE.with_suffix(".bin").read_bytes()):
        (tmp_path / "omnibot.elf").write_bytes(content)
        assert "is no ELF file for ARM" in refused(tmp_path / "omnibot.elf")
    assert "is no ELF file for ARM" in refused(LIBRARY_FILE)  # an ELF file, for this machine
    assert "Is a directory" in refused(tmp_path)


def link_image(tmp_path: Path, assembly: str) -> Path:
    """An image for ARM whose vector table and code are as given."""
    source, image = tmp_path / "other.s", tmp_path / "other.elf"
    source.write_text(f".syntax unified\n.cpu cortex-m4\n.thumb\n.text\n{assembly}\n")
    linker = ["-nostdlib", "-Wl,-Ttext=0x08000000", "-Wl,-e,0x08000000"]
    subprocess.run(["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", *linker, source, "-o", image], check=True)
    return image


def test_image_that_locks_the_processor_up_is_told_in_the_emulators_words(tmp_path: Path) -> None:
    image = link_image(tmp_path, ".word 0x20001000\n.word 0xF0000001\n.word 0xF0000001\n.word 0xF0000001")
    assert "qemu-system-arm ended by signal 6: qemu: fatal: Lockup" in refused(image)


def test_image_that_never_answers_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pil, "BOOT_S", 0.5)
    image = link_image(tmp_path, ".word 0x20001000\n.word loop + 1\n.thumb_func\nloop: b loop")
    assert refused(image) == (
        f"qemu-system-arm with {image} does not answer within 0.5 s: is it an omnibot image of this node?"
    )


def test_missing_emulator_is_named_with_what_installs_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "no qemu-system-arm in PATH: tools/setup board, or apt-get install qemu-system-arm" in refused(IMAGE_FILE)


def test_emulator_that_refuses_its_options_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pil, "MACHINE", "nonesuch")
    message = refused(IMAGE_FILE)
    assert "qemu-system-arm ended with status 1" in message
    assert "unsupported machine type" in message


def test_error_on_the_command_line_is_one_line(tmp_path: Path) -> None:
    result = omnibot("run", "--bus", "pil", "--channel", tmp_path / "none.elf", "--out", tmp_path / "out")
    assert result.returncode == 1
    assert result.stderr.startswith("omnibot: no firmware image")
    assert result.stderr.count("\n") == 1


def test_run_by_the_clock_is_refused() -> None:
    result = omnibot("run", "--bus", "pil", "--time", "realtime")
    assert result.returncode == 1
    assert result.stderr.startswith("omnibot: the emulated board counts instructions, not time")


def test_emulators_have_ports_of_their_own() -> None:
    emulators = [Emulator(IMAGE_FILE) for _ in range(3)]
    try:
        assert len({emulator.port for emulator in emulators}) == 3
    finally:
        for emulator in emulators:
            emulator.stop()
            emulator.stop()
