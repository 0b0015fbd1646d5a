"""Which board, and which node: what -DOMNIBOT_BOARD and -DOMNIBOT_NODE choose, and what they refuse."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def configure(build: Path, *options: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ["cmake", "--preset", "board", "-B", build, *options],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def test_reference_board_is_node_0(tmp_path: Path) -> None:
    result = configure(tmp_path)

    assert result.returncode == 0, result.stderr
    header = (tmp_path / "generated" / "board_header.h").read_text()
    assert '#include "board_omnibot.h"' in header
    assert "#define BOARD_NODE 0\n" in header


@pytest.mark.parametrize("node", ["1", "9", "10", "15"])
def test_node_goes_into_the_image(tmp_path: Path, node: str) -> None:
    assert configure(tmp_path, f"-DOMNIBOT_NODE={node}").returncode == 0

    assert f"#define BOARD_NODE {node}\n" in (tmp_path / "generated" / "board_header.h").read_text()


@pytest.mark.parametrize("node", ["16", "-1", "1.5", "two", "", "007"])
def test_node_that_cannot_be_is_refused(tmp_path: Path, node: str) -> None:
    result = configure(tmp_path, f"-DOMNIBOT_NODE={node}")

    assert result.returncode != 0
    assert f"OMNIBOT_NODE={node} must be 0 … 15" in result.stderr


def test_board_that_is_not_there_is_named(tmp_path: Path) -> None:
    result = configure(tmp_path, "-DOMNIBOT_BOARD=nothing")

    assert result.returncode != 0
    message = " ".join(result.stderr.split())
    assert "OMNIBOT_BOARD=nothing: there is no board_nothing.h in firmware/ports/stm32f405" in message
