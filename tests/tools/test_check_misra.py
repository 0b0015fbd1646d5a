"""tools/check-misra names a rule that is not kept, and a deviation that is wrong; in a small tree of its own."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

CLEAN = """#include <stdint.h>
extern uint32_t twice(uint32_t value);
uint32_t twice(uint32_t value) { return value + value; }
extern uint32_t four_times(uint32_t value);
uint32_t four_times(uint32_t value) { return twice(value) + twice(value); }
"""
TWO_EXITS = """#include <stdint.h>
extern uint32_t half(uint32_t value);
uint32_t half(uint32_t value)
{
    if (value < 2u) { return 0u; }
    return value / 2u;
}
extern uint32_t quarter(uint32_t value);
uint32_t quarter(uint32_t value) { return half(half(value)); }
"""
OCTAL = "enum { SPEED = 010 };\n"
EXITS = '[[deviation]]\nrule = "15.5"\nfiles = ["{files}"]\nwhy = "Refused input leaves early."\n'


class Tree:
    """A tree with one source in a folder, the deviations and the tool."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("tools", "tests/static", "firmware/control", "build/target/generated"):
            (root / folder).mkdir(parents=True)
        shutil.copy(ROOT / "tools" / "check-misra", root / "tools")
        (root / "build/target/generated/messages.c").write_text("")
        self.write(CLEAN, "")

    def write(self, source: str, deviations: str) -> None:
        (self.root / "firmware/control/thing.c").write_text(source)
        (self.root / "tests/static/misra_deviations.toml").write_text(deviations)

    def check(self) -> "subprocess.CompletedProcess[str]":
        tool = self.root / "tools" / "check-misra"
        return subprocess.run([tool], capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path / "tree")


def test_clean_source_passes(tree: Tree) -> None:
    result = tree.check()

    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("place", ["firmware/control/thing.c", "build/target/generated/messages.c"])
def test_violation_is_named_by_file_line_and_rule(tree: Tree, place: str) -> None:
    with (tree.root / place).open("a") as file:
        file.write(OCTAL)
    line = (tree.root / place).read_text().count("\n")

    result = tree.check()

    assert result.returncode == 1
    name = place.removeprefix("build/target/")
    assert f"{name}:{line}: MISRA C:2012 rule 7.1" in result.stdout.splitlines()


def test_inline_suppression_does_not_hide_a_violation(tree: Tree) -> None:
    tree.write(CLEAN + "// cppcheck-suppress misra-c2012-7.1\n" + OCTAL, "")

    assert "rule 7.1" in tree.check().stdout


def test_deviation_covers_its_rule_in_its_files(tree: Tree) -> None:
    tree.write(TWO_EXITS, EXITS.format(files="firmware/control/*"))

    assert tree.check().returncode == 0


def test_deviation_covers_no_other_files(tree: Tree) -> None:
    tree.write(TWO_EXITS, EXITS.format(files="firmware/app/*"))

    result = tree.check()

    assert result.returncode == 1
    assert "firmware/control/thing.c:5: MISRA C:2012 rule 15.5" in result.stdout.splitlines()


def test_deviation_that_matches_nothing_is_named(tree: Tree) -> None:
    tree.write(CLEAN, EXITS.format(files="*"))

    result = tree.check()

    assert result.returncode == 1
    assert "misra_deviations.toml: rule 15.5 in * matches nothing: remove it" in result.stdout.splitlines()


@pytest.mark.parametrize(
    ("deviation", "complaint"),
    [
        ('rule = "15.5"\nfiles = ["*"]\nwhy = "style"\n', "must have rule, files and a reason"),
        ('rule = "15.5"\nfiles = ["*"]\n', "must have rule, files and a reason"),
        ('rule = "17.4"\nfiles = ["*"]\nwhy = "It is shorter so."\n', "rule 17.4 is mandatory"),
    ],
    ids=["short reason", "no reason", "mandatory"],
)
def test_wrong_deviation_is_refused(tree: Tree, deviation: str, complaint: str) -> None:
    tree.write(CLEAN, f"[[deviation]]\n{deviation}")

    result = tree.check()

    assert result.returncode == 1
    assert complaint in result.stderr


def test_source_that_cannot_be_read_is_named(tree: Tree) -> None:
    tree.write(CLEAN + "int broken( {\n", "")

    result = tree.check()

    assert result.returncode == 1
    assert "firmware/control/thing.c" in result.stderr


def test_missing_generated_code_is_said(tree: Tree) -> None:
    (tree.root / "build/target/generated/messages.c").unlink()

    result = tree.check()

    assert result.returncode == 1
    assert "say: tools/build target" in result.stderr
