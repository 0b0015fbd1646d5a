"""The firmware as a process on vcan0. tools/with-vcan -- pytest tests/sil."""

import contextlib
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from host_sim.robot import ROOT

SIL = ROOT / "build" / "host" / "omnibot-sil"
Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture(autouse=True, scope="session")
def vcan0() -> None:
    if not Path("/sys/class/net/vcan0").exists():
        pytest.fail("there is no vcan0: run these tests as tools/with-vcan -- pytest tests/sil", pytrace=False)
    if not SIL.exists():
        pytest.fail("there is no omnibot-sil: tools/build host makes it", pytrace=False)


@contextlib.contextmanager
def firmwares() -> Iterator[Start]:
    """Start omnibot-sil and wait until it listens; what is left at the end is killed."""
    started: list[subprocess.Popen[bytes]] = []

    def start(*options: str, node: int = 0) -> "subprocess.Popen[bytes]":
        process = subprocess.Popen([SIL, "--can", "vcan0", "--node", str(node), *options], stderr=subprocess.PIPE)
        started.append(process)
        assert process.stderr is not None
        while b"on vcan0" not in (line := process.stderr.readline()):
            assert line, "omnibot-sil ended before it listened"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


@pytest.fixture
def start_firmware() -> Iterator[Start]:
    with firmwares() as start:
        yield start


@pytest.fixture(scope="module")
def start_firmware_once() -> Iterator[Start]:
    """The same, for what all tests of a module look at."""
    with firmwares() as start:
        yield start
