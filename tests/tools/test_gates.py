"""A defect of each kind, planted into a copy of the sources, is caught by the gate that is there for it.

The copy without any passes. The gates' own tests are beside this: test_check_misra.py, test_coverage.py and others.
"""

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNITS = ("slcan", "control")

# File, what stands there, what is put in its place.
OFF_BY_ONE = ("protocol/slcan.c", "slcan->line_chars < SLCAN_LINE_CHARS", "slcan->line_chars <= SLCAN_LINE_CHARS")
WRONG_SIGN = ("firmware/control/tracking.c", "vec3_sub(driven, vec3_gained(K1,", "vec3_add(driven, vec3_gained(K1,")
OCTAL = ("protocol/slcan.c", "hex_digit(frame->length)", "hex_digit((uint32_t)frame->length & 017)")
UNSET = ("protocol/slcan.c", "    *value = 0;\n", "")
NARROW = (
    "protocol/crc.c",
    "uint8_t crc8_frame(",
    "uint8_t narrow(int);\nuint8_t narrow(int v)\n{\n    return v;\n}\n\nuint8_t crc8_frame(",
)
COMMA = (
    "protocol/crc.c",
    "uint8_t crc8_frame(",
    "int comma(int);\nint comma(int v)\n{\n    return v++, v;\n}\n\nuint8_t crc8_frame(",
)
NEVER_RUN = (
    "protocol/slcan.c",
    "    slcan->spoilt = true;\n    slcan->flags",
    "    if (slcan->count > 9999) {\n        slcan->count = 0;\n    }\n    slcan->spoilt = true;\n    slcan->flags",
)


class Tree:
    """A copy of the sources, and the gates run in it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, names.split("\0")):
            if (ROOT / name).is_file():
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, root / name)
        for made in ("build/unity", "build/target/generated"):
            shutil.copytree(ROOT / made, root / made)  # by tools/build check and tools/build target

    @contextmanager
    def planted(self, file: str, there: str, instead: str) -> Iterator[None]:
        """Put a defect into a source for a while."""
        path = self.root / file
        text = path.read_text(encoding="utf-8")
        assert text.count(there) == 1, f"{file} holds {there!r} {text.count(there)} times: plant something else"
        path.write_text(text.replace(there, instead), encoding="utf-8")
        yield
        path.write_text(text, encoding="utf-8")

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        environment = os.environ | {"PATH": path}
        return subprocess.run(
            command, cwd=self.root, env=environment, capture_output=True, text=True, check=False, timeout=300
        )

    def build(self, preset: str, *targets: str) -> "subprocess.CompletedProcess[str]":
        """Configure a preset and build some of it."""
        configured = self.run("cmake", "--preset", preset)
        assert configured.returncode == 0, configured.stderr
        return self.run("cmake", "--build", "--preset", preset, "--target", *targets)

    def unit(self, module: str) -> "subprocess.CompletedProcess[str]":
        """Build a module's unit test under sanitizers and run it."""
        built = self.build("check", f"test_{module}")
        assert built.returncode == 0, built.stdout
        return self.run(f"build/check/tests/unit/test_{module}")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    return Tree(tmp_path_factory.mktemp("gates"))


# ---- nothing planted


def test_copy_as_it_is_passes(tree: Tree) -> None:
    for module in UNITS:
        assert tree.unit(module).returncode == 0
    misra = tree.run("tools/check-misra")
    assert misra.returncode == 0, misra.stdout + misra.stderr
    for preset in ("analyze", "clang"):
        built = tree.build(preset, "protocol")
        assert built.returncode == 0, built.stdout


# ---- planted


def test_misra_violation_is_caught_by_check_misra(tree: Tree) -> None:
    line = (tree.root / OCTAL[0]).read_text(encoding="utf-8").split(OCTAL[1])[0].count("\n") + 1

    with tree.planted(*OCTAL):
        result = tree.run("tools/check-misra")

    assert result.returncode == 1
    assert f"protocol/slcan.c:{line}: MISRA C:2012 rule 7.1" in result.stdout.splitlines()


def test_write_out_of_bounds_is_caught_by_the_sanitizers(tree: Tree) -> None:
    with tree.planted(*OFF_BY_ONE):
        result = tree.unit("slcan")

    assert result.returncode != 0
    assert "protocol/slcan.c" in result.stderr
    assert "out of bounds" in result.stderr


def test_sign_error_in_the_control_law_is_caught_by_its_unit_tests(tree: Tree) -> None:
    with tree.planted(*WRONG_SIGN):
        result = tree.unit("control")

    assert result.returncode != 0
    assert ":FAIL" in result.stdout


def test_use_of_a_value_never_set_is_caught_by_the_analyzer(tree: Tree) -> None:
    with tree.planted(*UNSET):
        result = tree.build("analyze", "protocol")

    assert result.returncode != 0
    assert "[-Werror=analyzer-use-of-uninitialized-value]" in result.stdout


def test_line_that_no_test_runs_is_caught_by_coverage(tree: Tree) -> None:
    with tree.planted(*NEVER_RUN):
        result = tree.run("tools/coverage")

    assert result.returncode == 1
    assert "FAIL protocol" in result.stdout, result.stdout + result.stderr
    assert any(text.endswith(": never run") and "protocol/slcan.c" in text for text in result.stdout.splitlines())


@pytest.mark.parametrize(
    ("preset", "defect", "warning"),
    [("check", NARROW, "conversion"), ("clang", NARROW, "implicit-int-conversion"), ("clang", COMMA, "comma")],
)
def test_warning_is_an_error(tree: Tree, preset: str, defect: tuple[str, str, str], warning: str) -> None:
    with tree.planted(*defect):
        result = tree.build(preset, "protocol")

    assert result.returncode != 0
    assert f"-W{warning}]" in result.stdout or f"-Werror={warning}]" in result.stdout


# ---- what the checkers of Python look at


def test_every_python_script_is_looked_at_by_ruff_and_mypy() -> None:
    scripts = {
        path
        for path in (ROOT / "tools").iterdir()
        if path.is_file() and not path.suffix and "python" in path.read_text(encoding="utf-8").split("\n", 1)[0]
    }
    assert scripts

    ruff = Path(sys.executable).with_name("ruff")
    shown = subprocess.run(
        [ruff, "check", "--show-files", "tools"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert scripts <= set(map(Path, shown))

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]
    assert settings["strict"]
    assert scripts <= {path for pattern in settings["files"] for path in ROOT.glob(pattern)}
