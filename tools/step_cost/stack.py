"""The deepest that the stack can go: frames as the compiler tells them (-fstack-usage), along every chain of calls."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

from step_cost.calls import Function, calls_of
from step_cost.errors import CostError
from step_cost.image import Image, ImageError

OBJECT = re.compile(r" -o (\S+)")
LINE = re.compile(r"[^\t]*:(?P<function>[^:\t]+)\t(?P<bytes>\d+)\t(?P<kind>\S+)$")


class StackError(CostError):
    """A stack whose depth has no bound that is known."""


@dataclass(frozen=True)
class Chain:
    """A chain of calls and the stack that it takes."""

    total_bytes: int
    frames: tuple[tuple[str, int], ...]  # function, bytes


def usage_files(folder: Path) -> list[Path]:
    """Return the compiler's files on stack usage, without those of objects that the build no longer has."""
    files = sorted(folder.rglob("*.su"))
    commands = folder / "compile_commands.json"
    if not commands.exists():
        return files
    lines = [str(entry["command"]) for entry in json.loads(commands.read_text(encoding="utf-8"))]
    made = {(folder / found[1]).with_suffix(".su") for line in lines if (found := OBJECT.search(line))}
    return [file for file in files if file in made]


def usage(folder: Path) -> dict[str, int]:
    """Return the frame of each function compiled in a build folder, the largest where names repeat."""
    found: dict[str, int] = {}
    for file in usage_files(folder):
        for line in file.read_text(encoding="utf-8").splitlines():
            match = LINE.match(line)
            if match is None:
                raise StackError(f"{file}: cannot read '{line}'")
            if match["kind"] != "static":
                raise StackError(f"{match['function']} has a stack of unknown size ({match['kind']}): {file}")
            found[match["function"]] = max(found.get(match["function"], 0), int(match["bytes"]))
    if not found:
        raise StackError(f"no .su files below {folder}: tools/build target makes them")
    return found


class StackDepths:
    """Depths by function.

    A frame is the larger of the compiler's figure and of what the function's instructions push: newlib's assembler has
    no figure, and gcc 12 leaves out register arguments that it puts back on the stack.
    """

    def __init__(self, image: Image, build: Path) -> None:
        self._functions = calls_of(image)
        self._usage = usage(build)
        self._chains: dict[str, Chain] = {}

    def frame_bytes(self, name: str) -> int:
        """Return a function's own frame."""
        plain = name.partition("@")[0]
        return max(self._usage.get(plain, 0), self._functions[name].pushed_bytes)

    def of(self, name: str, above: tuple[str, ...] = ()) -> Chain:
        """Return the deepest chain from a function on."""
        if name in above:
            raise StackError(f"recursion: {' → '.join([*above, name])}")
        if name not in self._functions:
            raise ImageError(f"the image has no function {name}")
        if name not in self._chains:
            self._chains[name] = self._deepest(self._functions[name], (*above, name))
        return self._chains[name]

    def _deepest(self, function: Function, above: tuple[str, ...]) -> Chain:
        own = (function.name, self.frame_bytes(function.name))
        inner = [self.of(called, above) for _, called in function.calls]
        below = max(inner, key=lambda chain: chain.total_bytes, default=Chain(0, ()))
        chains = [Chain(own[1] + below.total_bytes, (own, *below.frames))]
        for jump in sorted(function.jumps):  # the frame is gone by then
            after = self.of(jump, above)
            chains.append(Chain(after.total_bytes, ((function.name, 0), *after.frames)))
        return max(chains, key=lambda chain: chain.total_bytes)
