"""Clang's syntax tree of a translation unit, with every node placed in the text of its file."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mutation.errors import MutationError


@dataclass
class Node:
    """A node: its kind, clang's other words about it, and the bytes [start, end) of `file` that it is written in.

    What a macro expands to is placed at the macro's use; a node that is not written in one file has no place.
    """

    kind: str
    words: dict[str, Any]
    file: str | None
    start: int
    end: int
    of_macro: bool  # all of it comes out of one macro
    children: list[Node] = field(default_factory=list)

    @property
    def type(self) -> str:
        """The type as it is after all typedefs, without const."""
        named = self.words.get("type", {})
        text: str = named.get("desugaredQualType", named.get("qualType", ""))
        return text.removeprefix("const ")

    @property
    def spelled_type(self) -> str:
        """The type as the source names it, without const."""
        text: str = self.words.get("type", {}).get("qualType", "")
        return text.removeprefix("const ")

    @property
    def opcode(self) -> str:
        """The operator of an operator node."""
        return str(self.words.get("opcode", ""))

    def walk(self) -> Iterator[Node]:
        """Yield the node and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()


class Texts:
    """The bytes of files, read once."""

    def __init__(self) -> None:
        self._texts: dict[str, bytes] = {}

    def __getitem__(self, file: str) -> bytes:
        if file not in self._texts:
            self._texts[file] = Path(file).read_bytes()
        return self._texts[file]


def closing(text: bytes, start: int) -> int:
    """Return where the round bracket that opens at `start` closes."""
    depth = 0
    for i in range(start, len(text)):
        depth += {40: 1, 41: -1}.get(text[i], 0)
        if depth == 0:
            return i
    raise MutationError(f"a bracket is not closed: {text[start : start + 60]!r}")


class Reader:
    """Turns clang's JSON into nodes.

    Clang names a file only where it differs from the one it named last, so everything is read in the order in which it
    was written.
    """

    def __init__(self, texts: Texts) -> None:
        self._texts = texts
        self._file = ""

    def _name_files(self, location: dict[str, Any]) -> None:
        for part in (location.get("spellingLoc"), location.get("expansionLoc"), location):
            if part is not None and "offset" in part:
                self._file = part.get("file", self._file)
                part["in"] = self._file

    def _place(self, location: dict[str, Any]) -> tuple[str, int, int, bool] | None:
        """Return file, first byte, byte past the last and whether this comes out of a macro."""
        spelling, expansion = location.get("spellingLoc", location), location.get("expansionLoc", location)
        if "in" not in spelling or "in" not in expansion:
            return None
        if spelling is expansion or expansion.get("isMacroArgExpansion"):
            return spelling["in"], spelling["offset"], spelling["offset"] + spelling["tokLen"], False
        start, end, text = expansion["offset"], expansion["offset"] + expansion["tokLen"], self._texts[expansion["in"]]
        with_arguments = text[end : end + 1] == b"("
        return expansion["in"], start, closing(text, end) + 1 if with_arguments else end, True

    def node(self, words: dict[str, Any]) -> Node:
        """Return the node of clang's words and of all below it."""
        where = words.get("range", {})
        for location in (words.get("loc", {}), where.get("begin", {}), where.get("end", {})):
            self._name_files(location)
        first, last = self._place(where.get("begin", {})), self._place(where.get("end", {}))
        node = Node(words.get("kind", ""), words, None, 0, 0, of_macro=False)
        if first and last and first[0] == last[0] and first[1] < last[2]:
            of_macro = first[3] and last[3] and first[1] == last[1]
            node = Node(node.kind, words, first[0], first[1], last[2], of_macro)
        below = [*words.pop("inner", []), *words.pop("array_filler", [])]
        node.children = [self.node(child) for child in below]
        return node


def parse(source: Path, options: Sequence[str], texts: Texts) -> Node:
    """Return the syntax tree of a source."""
    command = ["clang", *options, "-w", "-fsyntax-only", "-Xclang", "-ast-dump=json", str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise MutationError(f"clang cannot read {source}:\n{done.stderr}")
    return Reader(texts).node(json.loads(done.stdout))
