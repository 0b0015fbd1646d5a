"""Which bus is opened: our own names, python-can's options, and its configuration in a home and an environment."""

import json
import os
import subprocess
import sys
from pathlib import Path

import can
import pytest

from host_sim.bus_choice import BusChoice, choose_bus
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import open_bus
from host_sim.robot import ROOT

CANRC = "[default]\ninterface = virtual\nchannel = from-file\nbitrate = 250000\n"
VARIABLES = ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home of its own, and nothing of python-can's in the environment."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.fixture
def canrc(home: Path) -> Path:
    file = home / ".canrc"
    file.write_text(CANRC)
    return file


# ---- what is configured


@pytest.mark.usefixtures("canrc")
def test_own_buses_are_the_same_whatever_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    for name in ("inproc", "pil", "vcan0"):
        assert choose_bus(name, None, None, None) == BusChoice(name)
    with open_bus("inproc", 0, None, None, None) as bus:
        assert isinstance(bus, InprocBus)


@pytest.mark.usefixtures("canrc")
def test_configured_bus_is_python_cans() -> None:
    assert choose_bus("can", None, None, None) == BusChoice("can", "virtual", "from-file", 250_000)
    with open_bus("can", 0, None, None, None) as bus, can.Bus() as other:
        other.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert bus.recv(5.0) is not None


@pytest.mark.usefixtures("canrc")
def test_environment_goes_before_files_and_options_before_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_CHANNEL", "from-environment")
    assert choose_bus("can", None, None, None).channel == "from-environment"
    assert choose_bus("can", None, "from-option", None) == BusChoice("can", "virtual", "from-option", 250_000)
    assert choose_bus("can", "udp_multicast", None, 125_000).label == "udp_multicast:from-environment"


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize(
    "environment",
    [
        {"CAN_INTERFACE": "virtual", "CAN_CHANNEL": "a", "CAN_BITRATE": "500000"},
        {"CAN_CONFIG": json.dumps({"interface": "virtual", "channel": "a", "bitrate": 500000})},
    ],
)
def test_environment_alone_is_enough(monkeypatch: pytest.MonkeyPatch, environment: dict[str, str]) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert choose_bus("can", None, None, None) == BusChoice("can", "virtual", "a", 500_000)


@pytest.mark.usefixtures("canrc")
def test_channel_alone_is_of_the_configured_interface() -> None:
    assert choose_bus("inproc", None, "mine", None).label == "virtual:mine"


def test_further_options_of_a_file_reach_the_bus(home: Path) -> None:
    (home / "can.conf").write_text("[default]\ninterface = virtual\nchannel = a\nreceive_own_messages = true\n")
    with open_bus("can", 0, None, None, None) as bus:
        bus.send(can.Message(arbitration_id=2, is_extended_id=False))
        assert bus.recv(5.0) is not None


def test_serial_port_of_a_file_is_opened_as_our_own(home: Path) -> None:
    (home / ".canrc").write_text("[default]\ninterface = slcan\nchannel = /dev/there-is-none\n")
    with pytest.raises(OmnibotError, match=r"cannot open /dev/there-is-none"):
        open_bus("can", 0, None, None, None)


# ---- what is wrong with it


@pytest.mark.usefixtures("home")
def test_nothing_configured_says_where_to() -> None:
    for options in (("can", None, None, None), ("inproc", None, "can0", None)):
        with pytest.raises(OmnibotError, match=r"no CAN interface is configured: give one with -i, or CAN_.*canrc"):
            choose_bus(*options)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("interface = virtual\n", "cannot read python-can's configuration .*no section headers"),
        ("[default]\ninterface = vitrual\n", 'Unknown interface type "vitrual"; there are: .*socketcan.*virtual'),
        ("[default]\ninterface = virtual\nport = x\n", "cannot read python-can's configuration .*Port"),
    ],
)
def test_damaged_file_is_one_line_that_says_so(home: Path, text: str, says: str) -> None:
    (home / ".canrc").write_text(text)
    with pytest.raises(OmnibotError, match=says) as raised:
        choose_bus("can", None, None, None)
    assert "\n" not in str(raised.value)


@pytest.mark.usefixtures("home")
def test_damaged_environment_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_CONFIG", "{interface: virtual}")
    with pytest.raises(OmnibotError, match=r"cannot read python-can's configuration \(.*CAN_CONFIG"):
        choose_bus("can", None, None, None)


def test_channel_beside_a_bus_that_has_one_is_refused() -> None:
    with pytest.raises(OmnibotError, match="--channel can0 says nothing beside --bus vcan0"):
        choose_bus("vcan0", None, "can0", None)
    with pytest.raises(OmnibotError, match="--bitrate 500000 says nothing beside --bus pil"):
        choose_bus("pil", None, None, 500_000)


# ---- the installed command


def test_command_takes_the_bus_from_a_home(home: Path) -> None:
    (home / ".canrc").write_text("[default]\ninterface = omnibot\nchannel = from-home\n")
    command = [sys.executable, "-c", "from host_sim.cli import main; main()", "param", "get", "epsilon"]
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES} | {"HOME": str(home)}
    got = subprocess.run(
        [*command, "--bus", "can", "--node", "7"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=ROOT,
        env=environment,
    )
    assert (got.returncode, got.stdout, got.stderr) == (0, "0.01\n", "")
