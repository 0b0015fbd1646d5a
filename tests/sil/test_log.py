"""Recording and replaying on a real vcan, with can-utils at its other end."""

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import can
from typer.testing import CliRunner

from host_sim.canlog import Recording, record, write_log
from host_sim.cli import app

Start = Callable[..., "subprocess.Popen[bytes]"]
SHORT = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "1.2"]


def omnibot(*arguments: str | Path) -> str:
    """Run a verb that must not fail; returns what it prints."""
    outcome = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if outcome.exception is not None:
        raise outcome.exception
    return outcome.output


def test_canplayer_plays_our_log_and_we_record_what_it_plays(tmp_path: Path) -> None:
    omnibot("run", *SHORT, "--out", tmp_path / "run")
    played, path = list(Recording(tmp_path / "run"))[-200:], tmp_path / "recorded.blf"
    write_log(played, tmp_path / "played.log", ".log")

    with can.Bus(interface="socketcan", channel="vcan0") as bus:  # it queues what comes before we listen
        subprocess.run(["canplayer", "-I", tmp_path / "played.log", "vcan0=vcan0"], check=True, timeout=60)
        before = time.time()
        assert record(bus, path, duration_s=2.0) == 200

    recorded = list(Recording(path))
    assert [(frame.arbitration_id, bytes(frame.data)) for frame in recorded] == [
        (frame.arbitration_id, bytes(frame.data)) for frame in played
    ]
    assert all(before - 60.0 < frame.timestamp < before for frame in recorded)


def test_run_over_vcan_is_replayed_there_and_in_process(tmp_path: Path, start_firmware: Start) -> None:
    start_firmware()
    omnibot("run", *SHORT, "--bus", "vcan0", "--out", tmp_path)

    assert omnibot("replay", tmp_path).startswith("identical; compared ")
    # The firmware has a drive behind it now, and another key for START.
    lines = omnibot("replay", tmp_path, "--bus", "vcan0").splitlines()
    assert "CHALLENGE.key" in lines[0]
    assert lines[1].startswith("identical; compared ")


def test_run_in_process_is_replayed_over_vcan_by_a_robot_of_its_node(tmp_path: Path, start_firmware: Start) -> None:
    start_firmware(node=7)
    omnibot("run", *SHORT, "--node", "7", "--out", tmp_path)

    assert "identical; compared " in omnibot("replay", tmp_path, "--bus", "vcan0")
