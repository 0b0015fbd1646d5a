"""Mutants that are no change at all: a compiler makes the same machine code of them."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from mutation.errors import MutationError
from mutation.operators import Mutant
from mutation.project import Project
from mutation.schemata import mutated

COMPILERS = ("clang", "gcc")


class Equivalence:
    """Compiles mutants and compares what comes out with what comes of the sources."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._options = {
            file: options for file, options in project.options().items() if not file.startswith(("tests/", "build/"))
        }
        self._objects = cache(self._compiled_sources)
        self._units = cache(self._units_of)

    def _units_of(self, file: str) -> tuple[str, ...]:
        """Return the sources that a file is compiled in."""
        if file in self._options:
            return (file,)
        path = str(self._project.root / file)
        units = []
        for source, options in self._options.items():
            command = ["clang", *options, "-w", "-MM", str(self._project.root / source)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if path in done.stdout.replace("\\\n", " ").split():
                units.append(source)
        return tuple(units)

    def _compile(self, compiler: str, file: str, text: bytes, units: Sequence[str]) -> list[bytes] | None:
        """Return the objects of the units with a file's text, beside which stand the other files of its folder."""
        root, home = self._project.root, Path(file).parent
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for other in (root / home).glob("*.[ch]"):
                shutil.copy(other, folder)
            (folder / Path(file).name).write_bytes(text)
            objects, made = [], folder / "made.o"
            for unit in units:
                source = Path(unit).name if Path(unit).parent == home else str(root / unit)
                command = [compiler, "-O2", "-w", f"-I{folder}", *self._options[unit], "-c", source, "-o", made.name]
                done = subprocess.run(command, cwd=folder, capture_output=True, check=False)
                if done.returncode != 0:
                    return None
                objects.append(made.read_bytes())
            return objects

    def _compiled_sources(self, compiler: str, file: str) -> list[bytes]:
        text = (self._project.root / file).read_bytes()
        objects = self._compile(compiler, file, text, self._units(file))
        if objects is None:
            raise MutationError(f"{compiler} does not compile {file}")
        return objects

    def holds(self, file: str, mutant: Mutant) -> bool:
        """Whether a compiler cannot tell the mutant of a file from the file."""
        units = self._units(file)
        text = mutated((self._project.root / file).read_bytes(), mutant)
        return bool(units) and any(
            self._compile(compiler, file, text, units) == self._objects(compiler, file) for compiler in COMPILERS
        )
