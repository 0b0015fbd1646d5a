"""The firmware as a process on a real vcan: the run is the in-process one at any speed; and what happens on failure."""

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.errors import OmnibotError
from host_sim.robot import ROOT
from host_sim.trace import Trace, compare

Start = Callable[..., "subprocess.Popen[bytes]"]
SIL = ROOT / "build" / "host" / "omnibot-sil"

# Half a second around the corner, started in motion: every stage of the law works, and it is short.
CORNER = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "1.2"]


def omnibot_run(out: Path, *options: str) -> tuple[int, str]:
    """Run ``omnibot run`` on the corner; returns exit code and the error's text."""
    result = CliRunner().invoke(app, ["run", *CORNER, "--out", str(out), *options])
    if result.exception is not None and not isinstance(result.exception, (OmnibotError, SystemExit)):
        raise result.exception
    return result.exit_code, str(result.exception or "")


def status(out: Path) -> dict[str, object]:
    """Read a run's result."""
    loaded: dict[str, object] = json.loads((out / "result.json").read_text())
    return loaded


@pytest.fixture(scope="module")
def inproc(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    out = tmp_path_factory.mktemp("inproc")
    assert omnibot_run(out) == (0, "")
    return Trace.load(out)


# ---- the same run


def test_sil_at_full_speed_gives_the_trace_of_the_inproc_run(
    tmp_path: Path, start_firmware: Start, inproc: Trace
) -> None:
    start_firmware()
    assert omnibot_run(tmp_path, "--bus", "vcan0") == (0, "")
    assert compare(Trace.load(tmp_path), inproc) == []


def test_sil_ten_times_slower_gives_the_same_trace(tmp_path: Path, start_firmware: Start, inproc: Trace) -> None:
    start_firmware()
    begin = time.monotonic()
    assert omnibot_run(tmp_path, "--bus", "vcan0", "--pace", "0.1") == (0, "")
    assert time.monotonic() - begin >= 12.0
    assert compare(Trace.load(tmp_path), inproc) == []


def test_sil_stopped_and_continued_gives_the_same_trace(tmp_path: Path, start_firmware: Start, inproc: Trace) -> None:
    firmware = start_firmware()
    answered = count_frames(80)

    def stop_and_continue() -> None:
        assert answered(300), "the run never came to its middle"
        os.kill(firmware.pid, signal.SIGSTOP)
        time.sleep(0.7)
        os.kill(firmware.pid, signal.SIGCONT)

    thread = threading.Thread(target=stop_and_continue)
    thread.start()
    code, error = omnibot_run(tmp_path, "--bus", "vcan0", "--pace", "0.3")
    thread.join()
    assert (code, error) == (0, "")
    assert compare(Trace.load(tmp_path), inproc) == []
    timing = status(tmp_path)["timing"]
    assert isinstance(timing, dict)
    assert timing["step_time_us"]["max"] > 0.5e6, "the firmware was not stopped while it was asked"


def test_second_run_on_the_same_firmware_gives_the_same_trace(
    tmp_path: Path, start_firmware: Start, inproc: Trace
) -> None:
    start_firmware()
    changed = ["--set", "position_damping_per_s=40", "--set", "torque_bound_Nm=0.05"]
    assert omnibot_run(tmp_path / "first", "--bus", "vcan0", *changed) == (0, "")
    assert omnibot_run(tmp_path / "second", "--bus", "vcan0") == (0, "")
    assert compare(Trace.load(tmp_path / "second"), inproc) == []


@contextlib.contextmanager
def slow_run(out: Path) -> "Iterator[subprocess.Popen[bytes]]":
    """Have a process of its own drive the corner, at a third of real time; Ctrl-C means something to it."""
    command = [ROOT / ".venv" / "bin" / "omnibot", "run", *CORNER, "--bus", "vcan0", "--pace", "0.3", "--out", out]
    run = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # noqa: PLW1509
    )
    try:
        yield run
    finally:
        run.kill()
        run.wait()


def test_second_run_on_the_same_node_is_refused_and_the_first_goes_on(
    tmp_path: Path, start_firmware: Start, inproc: Trace
) -> None:
    start_firmware()
    answered = count_frames(80)
    with slow_run(tmp_path / "first") as first:
        assert answered(1)
        code, error = omnibot_run(tmp_path / "second", "--bus", "vcan0")
        assert code == 1
        assert "another host drives node 0" in error
        assert "--node" in error
        assert first.wait(timeout=60) == 0
    assert compare(Trace.load(tmp_path / "first"), inproc) == []


def test_two_firmwares_of_one_node_are_refused(tmp_path: Path, start_firmware: Start) -> None:
    start_firmware()
    start_firmware()
    code, error = omnibot_run(tmp_path, "--bus", "vcan0")
    assert code == 1
    assert "two robots are node 0" in error


def test_run_after_an_interrupted_one_is_as_good_as_new(tmp_path: Path, start_firmware: Start, inproc: Trace) -> None:
    start_firmware()
    answered = count_frames(80)
    with slow_run(tmp_path / "first") as first:
        assert answered(200)
        first.send_signal(signal.SIGINT)
        assert first.wait(timeout=60) == 130
    assert status(tmp_path / "first")["status"] == "interrupted"
    assert 199 <= len(Trace.load(tmp_path / "first")) < 1201
    assert omnibot_run(tmp_path / "second", "--bus", "vcan0") == (0, "")
    assert compare(Trace.load(tmp_path / "second"), inproc) == []


def test_two_nodes_on_one_bus_do_not_disturb_each_other(tmp_path: Path, start_firmware: Start, inproc: Trace) -> None:
    start_firmware(node=0)
    start_firmware(node=3)
    command = [ROOT / ".venv" / "bin" / "omnibot", "run", *CORNER, "--bus", "vcan0", "--node", "3"]
    other = subprocess.Popen([*command, "--out", tmp_path / "3"], stdout=subprocess.DEVNULL)
    assert omnibot_run(tmp_path / "0", "--bus", "vcan0") == (0, "")
    assert other.wait(timeout=60) == 0
    assert compare(Trace.load(tmp_path / "0"), inproc) == []
    assert compare(Trace.load(tmp_path / "3"), inproc) == []


def test_python_can_reads_the_bus_log(tmp_path: Path, start_firmware: Start) -> None:
    start_firmware()
    assert omnibot_run(tmp_path, "--bus", "vcan0") == (0, "")
    with can.LogReader(tmp_path / "bus.log") as log:
        ids = [message.arbitration_id for message in log]
    assert ids.count(64) == ids.count(80) == ids.count(96) == 1201


# ---- by the clock

# This machine may be anything but a real-time one: what is tested is that the loop keeps its time base and tells all.
PATIENT = ["--set", "wheel_speed_timeout_s=1", "--set", "tick_gap_max=100"]


def test_realtime_run_keeps_the_clock_and_reports_everything(tmp_path: Path, start_firmware: Start) -> None:
    firmware = start_firmware("--time", "realtime", "--timing", str(tmp_path / "timing.json"))
    assert omnibot_run(tmp_path, "--bus", "vcan0", "--time", "realtime", *PATIENT) == (0, "")
    firmware.send_signal(signal.SIGTERM)
    assert firmware.wait(timeout=5) == 0

    result = json.loads((tmp_path / "result.json").read_text())
    timing = result["timing"]
    assert result["scenario"]["time"] == "realtime"
    assert timing["steps"] == 1201
    assert 0.0 < timing["real_time_factor"] <= 1.0  # never before the clock; how far behind is the machine's matter
    assert timing["step_time_us"]["min"] <= timing["step_time_us"]["mean"] <= timing["step_time_us"]["max"]
    assert 0 <= timing["deadline_misses"] <= 1201
    assert timing["round_trip_us"]["max"] >= timing["round_trip_us"]["min"] > 0.0
    rounds = sum(result["histograms"]["round_trip_us"]["counts"])
    assert 0 < rounds <= 1201
    assert '<figure id="timing"' in (tmp_path / "report.html").read_text()

    own = json.loads((tmp_path / "timing.json").read_text())
    for name in ("step_time", "release_jitter"):
        assert sum(own[name]["classes"]) == own[name]["count"] > 1000
        assert own[name]["min_us"] <= own[name]["mean_us"] <= own[name]["max_us"]
    assert own["overruns"] >= timing["firmware_overruns"]


def test_firmware_with_a_timer_still_runs_in_lockstep(tmp_path: Path, start_firmware: Start, inproc: Trace) -> None:
    start_firmware("--time", "realtime")
    assert omnibot_run(tmp_path, "--bus", "vcan0") == (0, "")
    assert compare(Trace.load(tmp_path), inproc) == []


def test_realtime_with_a_lockstep_firmware_ends_with_the_cure(tmp_path: Path, start_firmware: Start) -> None:
    start_firmware()
    code, error = omnibot_run(tmp_path, "--bus", "vcan0", "--time", "realtime")
    assert code == 1
    assert "omnibot-sil --can INTERFACE --time realtime" in error


def test_firmware_stopped_in_real_time_faults_by_itself_when_it_goes_on(tmp_path: Path, start_firmware: Start) -> None:
    firmware = start_firmware("--time", "realtime")
    answered = count_frames(80)

    def stop_and_continue() -> None:
        assert answered(300), "the run never came to its middle"
        os.kill(firmware.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(firmware.pid, signal.SIGCONT)

    thread = threading.Thread(target=stop_and_continue)
    thread.start()
    code, error = omnibot_run(tmp_path, "--bus", "vcan0", "--time", "realtime", *PATIENT)
    thread.join()
    assert code == 1
    assert "OVERRUN" in error or "HOST_SILENT" in error
    assert status(tmp_path)["status"] == "fault"


# ---- failures


def count_frames(arbitration_id: int) -> Callable[[int], bool]:
    """Return a function that waits until so many frames of an identifier went over vcan0."""
    bus = can.Bus(interface="socketcan", channel="vcan0", can_filters=[{"can_id": arbitration_id, "can_mask": 0x7FF}])

    def wait(frames: int) -> bool:
        with bus:
            return all(bus.recv(60.0) is not None for _ in range(frames))

    return wait


def test_firmware_missing_ends_with_the_cure(tmp_path: Path) -> None:
    code, error = omnibot_run(tmp_path, "--bus", "vcan0", "--timeout", "0.5")
    assert code == 1
    assert "node 0" in error
    assert "omnibot-sil --can" in error


@pytest.mark.parametrize("deadly", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "silent"])
def test_firmware_lost_in_the_run_keeps_what_was_recorded(
    tmp_path: Path, start_firmware: Start, deadly: signal.Signals
) -> None:
    firmware = start_firmware()
    answered = count_frames(80)

    def lose() -> None:
        assert answered(300)
        os.kill(firmware.pid, deadly)

    thread = threading.Thread(target=lose)
    thread.start()
    # Slowly, so that the run is not over before the other thread has come to its turn.
    code, error = omnibot_run(tmp_path, "--bus", "vcan0", "--timeout", "0.5", "--pace", "0.3")
    thread.join()
    assert code == 1
    assert "no TORQUE for tick" in error
    assert status(tmp_path)["status"] == "timeout"
    assert 299 <= len(Trace.load(tmp_path)) < 1201  # the 300th TORQUE may have come without its SLIP
    assert (tmp_path / "report.html").exists()


def test_other_wire_definition_is_refused_by_name(tmp_path: Path, start_firmware: Start) -> None:
    start_firmware()
    other = tmp_path / "other.dbc"
    other.write_text((ROOT / "protocol" / "omnibot.dbc").read_text() + '\nCM_ "another";\n')
    code, error = omnibot_run(tmp_path / "run", "--bus", "vcan0", "--dbc", str(other))
    assert code == 1
    assert "speaks protocol" in error
    assert "rebuild" in error


# ---- omnibot-sil's own command line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], b"usage"),
        (["--can", "vcan0", "--node", "16"], b"from 0 to 15"),
        (["--can", "vcan0", "--node", "x"], b"from 0 to 15"),
        (["--can", "vcan7"], b"cannot open vcan7"),
        (["--can", "vcan0", "more"], b"usage"),
        (["--can", "vcan0", "--time", "sometimes"], b"must be lockstep or realtime"),
        (["--can", "vcan0", "--timing", "x.json"], b"add --time realtime"),
        (["--can", "vcan0", "--parameters", "/no/such/folder/p"], b"--parameters /no/such/folder/p: No such file"),
        (["--can", "vcan0", "--parameters", "pyproject.toml"], b"no file of parameters, which has 16384 bytes"),
    ],
)
def test_omnibot_sil_refuses_bad_arguments(arguments: list[str], says: bytes) -> None:
    result = subprocess.run([SIL, *arguments], cwd=ROOT, capture_output=True, timeout=10, check=False)
    assert result.returncode != 0
    assert says in result.stderr


@pytest.mark.parametrize("polite", [signal.SIGINT, signal.SIGTERM])
def test_omnibot_sil_ends_on_a_signal(start_firmware: Start, polite: signal.Signals) -> None:
    firmware = start_firmware()
    firmware.send_signal(polite)
    assert firmware.wait(timeout=5) == 0
