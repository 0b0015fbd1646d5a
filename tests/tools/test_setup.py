"""tools/setup: what can be told without installing anything."""

import re
import subprocess
from pathlib import Path

import pytest

SETUP = Path(__file__).parents[2] / "tools" / "setup"


def run(*arguments):
    return subprocess.run([SETUP, *arguments], capture_output=True, text=True, timeout=10, check=False)


@pytest.mark.parametrize("arguments", [[], ["everything"], ["run", "test"]])
def test_wrong_usage_is_told_in_one_line(arguments):
    result = run(*arguments)
    assert result.returncode == 1
    assert re.fullmatch(r"setup: .*say: tools/setup run, board or test.*\n", result.stderr)


def test_help_names_every_extent():
    result = run("--help")
    assert result.returncode == 0
    assert re.search(r"^  run ", result.stdout, re.MULTILINE)
    assert re.search(r"^  board ", result.stdout, re.MULTILINE)
    assert re.search(r"^  test ", result.stdout, re.MULTILINE)
