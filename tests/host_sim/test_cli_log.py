"""``omnibot log`` and ``omnibot replay`` as a user meets them."""

import json
from pathlib import Path
from typing import Any

import can
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.cli.app import RunFailedError
from host_sim.errors import OmnibotError


def omnibot(*arguments: str | Path) -> Any:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def refusal(*arguments: str | Path) -> str:
    outcome = omnibot(*arguments)
    assert outcome.exit_code == 1
    assert isinstance(outcome.exception, OmnibotError), outcome.exception
    return str(outcome.exception)


@pytest.mark.parametrize(
    ("name", "begins"),
    [
        ("run.csv", b"time_s,COMMAND.operation"),
        ("run.npz", b"PK"),
        ("run.mcap", b"\x89MCAP0"),
        ("run.log", b"(0.000000) vcan0 100#"),
        ("run.asc", b"date "),
        ("run.BLF", b"LOGG"),
    ],
)
def test_export_takes_the_format_from_the_name(tmp_path: Path, recorded_run: Path, name: str, begins: bytes) -> None:
    outcome = omnibot("log", "export", recorded_run, "--out", tmp_path / name)
    assert outcome.output == f"{tmp_path / name}\n"
    assert (tmp_path / name).read_bytes().startswith(begins)


def test_export_takes_the_format_from_an_option(tmp_path: Path, recorded_run: Path) -> None:
    outcome = omnibot("log", "export", recorded_run / "bus.log", "--to", "blf", "--out", tmp_path / "x", "--json")
    assert json.loads(outcome.output) == {"file": str(tmp_path / "x"), "damaged": 0}
    assert omnibot("replay", tmp_path / "x").exit_code == 1  # its name does not tell


def test_export_refuses_what_it_cannot_write(tmp_path: Path, recorded_run: Path) -> None:
    log = tmp_path / "bus.log"
    log.write_bytes((recorded_run / "bus.log").read_bytes())
    assert "mcap" in refusal("log", "export", log, "--out", tmp_path / "bus.xyz")
    assert "is the log itself" in refusal("log", "export", log, "--out", log)
    assert "cannot write" in refusal("log", "export", log, "--out", log / "below.csv")
    assert log.read_bytes() == (recorded_run / "bus.log").read_bytes()


def test_replay_of_a_run_is_identical(recorded_run: Path) -> None:
    outcome = omnibot("replay", recorded_run)
    assert outcome.exit_code == 0
    assert outcome.output.startswith("identical; compared ")
    assert "761 ticks" in outcome.output


def test_replay_of_an_altered_log_fails_and_names_the_signal(tmp_path: Path, recorded_run: Path) -> None:
    lines = (recorded_run / "bus.log").read_text().splitlines(keepends=True)
    torque = [k for k, line in enumerate(lines) if " 050#" in line][123]
    digit = lines[torque].index("#") + 2  # the lower four bits of the first byte
    lines[torque] = f"{lines[torque][:digit]}{int(lines[torque][digit], 16) ^ 1:X}{lines[torque][digit + 1 :]}"
    (tmp_path / "bus.log").write_text("".join(lines))

    outcome = omnibot("replay", tmp_path / "bus.log", "--json")

    assert outcome.exit_code == 1
    assert isinstance(outcome.exception, RunFailedError)  # main() prints no second JSON
    assert "tick 123: TORQUE.wheel1_Nm" in str(outcome.exception)
    result = json.loads(outcome.output)
    assert result["status"] == "different"
    (difference,) = result["differences"]
    assert (difference["name"], difference["first_tick"]) == ("TORQUE.wheel1_Nm", 123)
    assert abs(difference["replayed"] - difference["recorded"]) == pytest.approx(1e-5)


def test_replay_without_a_robot_says_so(recorded_run: Path) -> None:
    nobody = ("-i", "virtual", "-c", "nobody there", "--timeout", "0.2")
    assert "no IDENTITY from node 0" in refusal("replay", recorded_run, *nobody)


def test_record_keeps_what_is_on_a_bus(tmp_path: Path) -> None:
    assert "writes its own bus.log" in refusal("log", "record", tmp_path / "bus.blf", "--bus", "inproc")
    listening = ("-i", "virtual", "-c", "a bus to listen on", "--duration", "0.1")
    outcome = omnibot("log", "record", tmp_path / "bus.blf", *listening, "--json")
    assert json.loads(outcome.output) == {"file": str(tmp_path / "bus.blf"), "frames": 0}
    assert "is there already" in refusal("log", "record", tmp_path / "bus.blf", *listening)
    with can.LogReader(tmp_path / "bus.blf") as reader:
        assert list(reader) == []
