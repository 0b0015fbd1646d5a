"""Linux' own slcand and slcan driver on a serial port with the firmware's SLCAN behind it.

tools/with-vcan --kernel -- pytest tests/slcand: it takes a kernel with slcan, and root in it.
"""

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.robot import ROOT
from host_sim.trace import Trace, compare

sys.path.insert(0, str(ROOT / "tests" / "host_sim"))

from serial_robot import SerialRobot

INTERFACE = "slcan0"
CORNER = ["--order", "1", "--start-before-corner", "0.3", "--duration", "0.4"]


@pytest.fixture
def robot() -> Iterator[SerialRobot]:
    """A robot on a serial port that slcand has made a CAN interface of."""
    if not Path("/sys/module/slcan").exists():
        pytest.fail("no slcan here: run these tests as tools/with-vcan --kernel -- pytest tests/slcand", pytrace=False)
    slcand = shutil.which("slcand")
    assert slcand is not None
    with SerialRobot() as running:
        daemon = subprocess.Popen([slcand, "-F", "-o", "-c", "-f", "-s8", running.port, INTERFACE])
        try:
            deadline = time.monotonic() + 10.0
            while not Path("/sys/class/net", INTERFACE).exists():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            subprocess.run(["ip", "link", "set", INTERFACE, "up"], check=True)
            yield running
        finally:
            daemon.terminate()
            daemon.wait(10.0)


def run(out: Path, *options: str) -> Trace:
    result = CliRunner().invoke(app, ["run", *CORNER, "--out", str(out), *options])
    if result.exception is not None:
        raise result.exception
    return Trace.load(out)


def test_run_over_slcand_gives_the_bytes_of_the_run_in_process(robot: SerialRobot, tmp_path: Path) -> None:
    over_slcand = run(tmp_path / "slcand", "-i", "socketcan", "-c", INTERFACE)
    assert len(over_slcand) == 401
    assert compare(over_slcand, run(tmp_path / "inproc")) == []
    assert robot.heard.startswith(b"C\rS8\rF\rO\r")
    assert robot.said.count(b"\a") == 1  # slcand closes what is closed


def test_end_of_slcand_closes_the_channel(robot: SerialRobot) -> None:
    subprocess.run(["ip", "link", "set", INTERFACE, "down"], check=True)
    subprocess.run(["busybox", "killall", "slcand"], check=True)
    deadline = time.monotonic() + 10.0
    while not robot.heard.endswith(b"C\r") or robot.said[-1:] != b"\r":
        assert time.monotonic() < deadline
        time.sleep(0.01)
