"""Parameters that outlive the firmware's process, over a real vcan."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.link import Link, RefusedError, open_bus
from host_sim.robot import load_robot

Start = Callable[..., "subprocess.Popen[bytes]"]
EPSILON = load_robot().parameter("epsilon")


@pytest.fixture
def link() -> Iterator[Link]:
    with open_bus("vcan0", node=0, interface=None, channel=None, bitrate=None) as bus:
        yield Link(bus, Codec())


def store_of(link: Link) -> tuple[str, int]:
    """Where the firmware's parameters come from, and how many of them are not saved."""
    link.send("HELLO", link.codec.protocol_hash)
    values = link.wait_for("PARAMETER_STORE")
    return link.codec["PARAMETER_STORE"].label("origin", values["origin"]), int(values["unsaved"])


def test_saved_parameter_outlives_a_killed_firmware(tmp_path: Path, start_firmware: Start, link: Link) -> None:
    kept = ("--parameters", str(tmp_path / "parameters"))
    firmware = start_firmware(*kept)
    assert store_of(link) == ("DEFAULTS", 0)
    link.hello()
    link.set_parameter(EPSILON, 0.25)
    assert store_of(link) == ("DEFAULTS", 1)
    link.command("SAVE_PARAMETERS")
    firmware.kill()
    firmware.wait()

    start_firmware(*kept)

    assert store_of(link) == ("KEPT", 0)
    link.check_parameter(EPSILON, 0.25)


def test_file_full_of_something_else_is_told_as_lost(tmp_path: Path, start_firmware: Start, link: Link) -> None:
    file = tmp_path / "parameters"
    file.write_bytes(b"\x5a" * 16384)
    start_firmware("--parameters", str(file))

    assert store_of(link) == ("LOST", 0)
    link.send("COMMAND", link.codec["COMMAND"].choices["operation"]["NONE"], 1, 0)
    assert link.codec["STATUS"].label("fault", link.wait_for("STATUS")["fault"]) == "PARAMETERS_LOST"
    link.check_parameter(EPSILON, EPSILON.default)


# ---- the installed command


def omnibot(*arguments: str) -> Any:
    return CliRunner().invoke(app, [*arguments, "--bus", "vcan0"])


def test_what_the_command_saved_is_in_force_after_a_restart(tmp_path: Path, start_firmware: Start) -> None:
    kept = ("--parameters", str(tmp_path / "parameters"))
    firmware = start_firmware(*kept)
    assert omnibot("param", "set", "epsilon=0.25", "order=exact").exit_code == 0
    assert omnibot("param", "save").stdout.startswith("20 parameters are kept")
    assert omnibot("param", "set", "epsilon=0.5").exit_code == 0
    firmware.kill()
    firmware.wait()

    start_firmware(*kept)

    assert omnibot("param", "get", "epsilon", "order").stdout == "epsilon = 0.25 1/N\norder = exact\n"


def test_command_without_a_memory_to_save_into_says_what_has_one(start_firmware: Start) -> None:
    start_firmware()
    with pytest.raises(RefusedError, match=r"UNABLE.*omnibot-sil --parameters FILE"):
        raise omnibot("param", "save").exception


def test_run_tells_of_lost_parameters_once(tmp_path: Path, start_firmware: Start) -> None:
    file = tmp_path / "parameters"
    file.write_bytes(b"\x5a" * 16384)
    start_firmware("--parameters", str(file))
    short = ("run", "--speed", "0.5", "--start-before-corner", "0.3", "--duration", "0.4", "--out", str(tmp_path))

    for faults in (["PARAMETERS_LOST"], []):
        told = omnibot(*short)
        assert told.exit_code == 0
        assert told.stderr.count("PARAMETERS_LOST") == len(faults)
        assert json.loads((tmp_path / "result.json").read_text())["cleared_faults"] == faults
