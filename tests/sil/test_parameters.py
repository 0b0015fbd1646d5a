"""Parameters that outlive the firmware's process, over a real vcan."""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from host_sim.codec import Codec
from host_sim.link import Link, open_bus
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
