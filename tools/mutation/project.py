"""A copy of the project in which its unit tests are built with mutants in them."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mutation.errors import MutationError
from mutation.schemata import HEADER, RUNTIME

FLAGS = (
    "-O1 -w -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer"
    " -ftrivial-auto-var-init=pattern"  # what was not assigned shows
    " -DUNITY_TEST_ABORT=mutant_stop"
)


@dataclass(frozen=True)
class Test:
    """A program whose exit status is 0 if the tests in it pass."""

    name: str
    command: tuple[str, ...]
    folder: str


def run(command: Sequence[str | Path], folder: Path) -> str:
    """Run a command and return what it prints; raise what it complains of."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise MutationError(f"{shlex.join(map(str, command))} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def write(path: Path, content: bytes) -> None:
    """Write a file unless it has that content already, so that nothing is built twice."""
    if not path.exists() or path.read_bytes() != content:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


class Project:
    """The sources at `root`, copied into `work`/tree and built in `work`/build."""

    def __init__(self, root: Path, work: Path, tests: str = "tests/unit") -> None:
        self.root, self.tree, self.build, self._tests = root, work / "tree", work / "build", tests
        work.mkdir(parents=True, exist_ok=True)
        self._header, self._runtime = work / "mutant.h", work / "mutant.o"

    def files(self) -> list[str]:
        """Return the paths of all sources, those that git does not know yet among them."""
        listed = run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], self.root)
        return [name for name in listed.split("\0") if name and (self.root / name).is_file()]

    def copy(self, instead: Mapping[str, bytes]) -> None:
        """Make the tree like the sources, with other texts in place of some."""
        files = self.files()
        for name in files:
            write(self.tree / name, instead.get(name) or (self.root / name).read_bytes())
            shutil.copymode(self.root / name, self.tree / name)
        kept = set(files)
        for path in self.tree.rglob("*"):
            if path.is_file() and str(path.relative_to(self.tree)) not in kept and "__pycache__" not in path.parts:
                path.unlink()

    def configure(self) -> None:
        """Let CMake make the build folder, and what is generated in it."""
        self._write_runtime()
        command = ["cmake", "-S", str(self.tree), "-B", str(self.build), "-G", "Ninja", "-DCMAKE_C_COMPILER=clang"]
        command += ["-DCMAKE_BUILD_TYPE=None", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON"]
        command += [f"-DCMAKE_C_FLAGS={FLAGS} -include {self._header}"]
        command += [f"-DCMAKE_C_STANDARD_LIBRARIES={self._runtime}"]
        python, unity = self.root / ".venv/bin/python3", self.root / "build/unity"
        command += [f"-DOMNIBOT_PYTHON={python}"] if python.exists() else []
        command += [f"-DUNITY_SOURCE_DIR={unity}"] if (unity / "src/unity.c").exists() else []
        run(command, self.root)
        custom = run(["ninja", "-C", self.build, "-t", "targets", "rule", "CUSTOM_COMMAND"], self.root)
        made = [line for line in custom.splitlines() if line.endswith((".c", ".h"))]
        if made:
            run(["ninja", "-C", self.build, *made], self.root)

    def _write_runtime(self) -> None:
        source = self._runtime.with_suffix(".c")
        write(source, RUNTIME.encode())
        write(self._header, HEADER.encode())
        run(["clang", "-O1", "-c", str(source), "-o", str(self._runtime)], self.root)

    def put(self, file: str, text: bytes) -> None:
        """Put a text in place of a file's."""
        write(self.tree / file, text)

    def make(self, test: Test | None = None) -> None:
        """Build a test, or all."""
        target = f"{self._tests}/all" if test is None else str(Path(test.command[0]).relative_to(self.build))
        run(["ninja", "-C", self.build, target], self.root)

    def tests(self) -> list[Test]:
        """Return the tests that CMake has registered."""
        shown = json.loads(run(["ctest", "--test-dir", self.build / self._tests, "--show-only=json-v1"], self.root))
        found = []
        for test in shown["tests"]:
            words = {p["name"]: p["value"] for p in test["properties"]}
            found.append(Test(test["name"], tuple(test["command"]), words.get("WORKING_DIRECTORY", str(self.build))))
        if not found:
            raise MutationError(f"{self._tests} registers no test")
        return found

    def options(self) -> dict[str, list[str]]:
        """Return what each source of the firmware is compiled with, less what is there for the mutants."""
        found: dict[str, list[str]] = {}
        for entry in json.loads((self.build / "compile_commands.json").read_text(encoding="utf-8")):
            path = Path(entry["file"])
            if path.is_relative_to(self.tree):
                found.setdefault(str(path.relative_to(self.tree)), self._options(shlex.split(entry["command"])))
        return found

    def _options(self, command: list[str]) -> list[str]:
        kept, words = [], iter(command[1:])
        for word in words:
            if word in {"-c", "-o", "-include"}:
                next(words)
            elif word in {"-I", "-isystem"}:
                kept += [word, self._at_root(next(words))]
            elif word.startswith("-I"):
                kept.append(f"-I{self._at_root(word[2:])}")
            elif word.startswith(("-D", "-std=", "-ffp-", "-fno-math")) and "UNITY" not in word:
                kept.append(word)
        return kept

    def _at_root(self, folder: str) -> str:
        path = Path(os.path.normpath(folder))
        return str(self.root / path.relative_to(self.tree)) if path.is_relative_to(self.tree) else folder
