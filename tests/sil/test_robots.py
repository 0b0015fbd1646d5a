"""Several robots on one bus: each is driven as if it were alone."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.trace import Trace, compare

Start = Callable[..., "subprocess.Popen[bytes]"]

OMNIBOT = [sys.executable, "-c", "from host_sim.cli import main; main()"]
DRIVES = {
    2: ["--path", "circle", "--speed", "0.4", "--duration", "1.5"],
    9: ["--path", "line", "--speed", "0.6", "--order", "1", "--duration", "1.5"],
}
TIMEOUT_s = 300.0


def start_run(node: int, folder: Path, *more: str) -> "subprocess.Popen[bytes]":
    """Start a simulator of the node's robot, patient with a machine that runs several."""
    options = ["--bus", "vcan0", "--node", str(node), "--timeout", "60", "--out", str(folder), *more]
    return subprocess.Popen([*OMNIBOT, "run", *DRIVES[node], *options], stdout=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Trace]:
    """The same drives in-process, where nobody else is."""
    folder = tmp_path_factory.mktemp("alone")
    for node, drive in DRIVES.items():
        run = CliRunner().invoke(app, ["run", *drive, "--out", str(folder / str(node))])
        assert run.exit_code == 0, run.output
    return {node: Trace.load(folder / str(node)) for node in DRIVES}


def test_two_robots_driven_at_once_give_the_traces_of_each_alone(
    tmp_path: Path, start_firmware: Start, alone: dict[int, Trace]
) -> None:
    for node in DRIVES:
        start_firmware(node=node)
    runs = {node: start_run(node, tmp_path / str(node)) for node in DRIVES}

    assert [run.wait(TIMEOUT_s) for run in runs.values()] == [0, 0]
    for node in DRIVES:
        assert compare(Trace.load(tmp_path / str(node)), alone[node]) == []


def test_robot_that_dies_leaves_its_neighbour_to_drive(
    tmp_path: Path, start_firmware: Start, alone: dict[int, Trace]
) -> None:
    firmwares = {node: start_firmware(node=node) for node in DRIVES}
    # Held back to the clock, so that the death falls into the drive; it is given up as soon as it is silent.
    dying = start_run(9, tmp_path / "9", "--pace", "0.2", "--timeout", "1")
    living = start_run(2, tmp_path / "2")
    while not (tmp_path / "9" / "bus.log").exists() and dying.poll() is None:
        time.sleep(0.05)
    firmwares[9].kill()

    assert dying.wait(TIMEOUT_s) == 1
    assert living.wait(TIMEOUT_s) == 0
    assert compare(Trace.load(tmp_path / "2"), alone[2]) == []
