"""The commands of every page: each indented block of commands is run as a reader would, in the project's folder.

A block is a script: its first failing command fails it. Those of `ELSEWHERE` need what a test cannot have, or are run
already by another step; each names the test that runs the same, or why nothing can.
"""

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from host_sim.robot import ROOT

COMMAND = re.compile(r"(tools/|\.venv/bin/|build/|(sudo|cmake|ctest|candump|cansend|canplayer|cp|mkdir|printf) )")
TIMEOUT_s = 900.0

ELSEWHERE = {
    "tools/test": "it runs this test",
    ".venv/bin/omnibot paper": "tests/host_sim/test_paper.py, item by item",
    ".venv/bin/omnibot sweep robustness": "tests/host_sim/test_sweep.py",
    ".venv/bin/omnibot inject": "tests/host_sim/test_inject.py",
    ".venv/bin/omnibot soak --duration 600": "tests/host_sim/test_inject.py, for less long",
    "tools/with-vcan -- tools/with-sil --time realtime -- .venv/bin/omnibot run --bus vcan0 --time realtime "
    "--set wheel_speed_timeout_s=0.1 --set tick_gap_max=100": "tests/sil/test_sil.py, shorter",
    "tools/fuzz app 600": "tests/tools/test_fuzz.py, for less long",
    "build/fuzz/tests/fuzz/flood 100000000": "tests/tools/test_fuzz.py, for less long",
    "build/fuzz/tests/fuzz/fuzz_app build/fuzz/found/app-crash-…": "tests/tools/test_fuzz.py finds such a file",
    ".venv/bin/omnibot run --bus pil": "tests/pil/test_pil.py, for less than a lap",
    "cmake --preset board -DOMNIBOT_NODE=3": "tests/tools/test_board_options.py, elsewhere",
    ".venv/bin/omnibot flash": "needs a board; tests/host_sim/test_flash.py",
    ".venv/bin/omnibot flash --dry-run": "needs a flashing tool; tests/host_sim/test_flash.py",
    ".venv/bin/omnibot run -i slcan -c /dev/ttyACM0": "needs a board; tests/slcand/test_slcand.py",
    ".venv/bin/omnibot run -i socketcan -c can0": "needs a CAN adapter; tests/sil/test_socketcan.py",
    "sudo ip link set can0 up type can bitrate 1000000 sample-point 0.857": "needs a CAN adapter",
    "candump -n 1 can0,410:7FF & cansend can0 400#00000000": "needs a CAN adapter",
    r"printf 'O\rt400400000000\r' >/dev/ttyUSB0": "needs a board",
    ".venv/bin/python -m host_sim.wheel_check -i socketcan -c can0 --wheel 1 --torque 0.02": (
        "needs a board; tests/host_sim/test_wheel_check.py"
    ),
}


class Block(NamedTuple):
    """Commands that stand together on a page."""

    page: str
    line: int
    commands: tuple[str, ...]


def pages() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in listed.stdout.split()]


def blocks_of(text: str, page: str) -> Iterator[Block]:
    """Find what is indented by four and begins as a command does; a line that ends with a backslash goes on."""
    lines = text.splitlines()
    number = 0
    while number < len(lines):
        first, block = number, []
        while number < len(lines) and lines[number].startswith("    "):
            block.append(lines[number][4:])
            number += 1
        if block and COMMAND.match(block[0]):
            yield Block(page, first + 1, tuple("\n".join(block).replace("\\\n", " ").splitlines()))
        number += 1


def without_comment(command: str) -> str:
    return " ".join(re.sub(r"\s#.*$", "", command).split())


BLOCKS = [block for page in pages() for block in blocks_of(page.read_text("utf-8"), str(page.relative_to(ROOT)))]


def test_blocks_are_found_and_what_runs_elsewhere_is_still_said() -> None:
    assert len(BLOCKS) >= 10
    said = {without_comment(command) for block in BLOCKS for command in block.commands}
    assert set(ELSEWHERE) <= said, set(ELSEWHERE) - said
    for reason in ELSEWHERE.values():
        named = re.findall(r"tests/\S+\.py", reason)
        assert all((ROOT / name).exists() for name in named), reason


@pytest.fixture(scope="module", autouse=True)
def _tidied() -> Iterator[None]:
    """Take away again what the porting page has its reader make inside the sources."""
    made = ROOT / "firmware" / "robot" / "mine.toml"
    was_there = made.exists()
    yield
    if not was_there:
        made.unlink(missing_ok=True)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: f"{block.page}:{block.line}")
def test_commands_of_the_block_work(block: Block) -> None:
    commands = [c for c in block.commands if without_comment(c) not in ELSEWHERE]
    script = "\n".join(["set -euo pipefail", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT", *commands])
    bus = ["tools/with-vcan", "--"] if "vcan0" in script and "with-vcan" not in script else []
    done = subprocess.run(
        [*bus, "bash", "-v", "-c", script], cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        check=False, timeout=TIMEOUT_s,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
