"""The board's own image, emulated. pytest tests/pil."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from host_sim.pil import EMULATOR
from host_sim.robot import ROOT

IMAGE_FILE = ROOT / "build" / "target" / "omnibot.elf"  # as it comes; build/board may be another board's or node's


@pytest.fixture(autouse=True, scope="session")
def emulator() -> None:
    if shutil.which(EMULATOR) is None:
        pytest.fail(f"there is no {EMULATOR}: tools/setup board installs it", pytrace=False)
    if not IMAGE_FILE.exists():
        pytest.fail(f"there is no {IMAGE_FILE}: tools/build target makes it", pytrace=False)


def wait_until(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def is_running(pid: int) -> bool:
    """Tell whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def emulators_of(pid: int) -> list[int]:
    """The emulators that a process has started."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if Path(f"/proc/{child}/exe").readlink().name == EMULATOR]
