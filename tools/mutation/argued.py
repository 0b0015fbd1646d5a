"""The mutants that no test can kill, or need not, each with its reason: tests/mutation/survivors.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from mutation.errors import MutationError
from mutation.operators import Mutant
from mutation.schemata import mutated

WORDS = {"file": str, "function": str, "line": str, "mutants": list, "reason": str}


class Change(NamedTuple):
    """A mutant as a reader sees it: the lines it stands in, before and after, with single spaces."""

    file: str
    function: str
    line: str
    mutant: str


def squeezed(text: bytes) -> str:
    """Return a text with single spaces."""
    return " ".join(text.decode().split())


def change(text: bytes, mutant: Mutant, file: str) -> Change:
    """Return what a mutant changes in the text of its file."""
    first = text.rfind(b"\n", 0, mutant.start) + 1
    last = text.find(b"\n", mutant.end)
    last = len(text) if last < 0 else last
    after = mutated(text, mutant)
    return Change(
        file, mutant.function, squeezed(text[first:last]), squeezed(after[first : last + len(after) - len(text)])
    )


def read(path: Path) -> dict[Change, str]:
    """Return the reason for each argued survivor."""
    if not path.exists():
        return {}
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8")).get("argued", [])
    except tomllib.TOMLDecodeError as error:
        raise MutationError(f"{path}: {error}") from error
    reasons = {}
    for number, entry in enumerate(entries, 1):
        wrong = [w for w, kind in WORDS.items() if not isinstance(entry.get(w), kind) or not entry[w]]
        unknown = sorted(set(entry) - set(WORDS))
        if wrong or unknown:
            what = f"has no {wrong[0]}" if wrong else f"has an unknown {unknown[0]}"
            raise MutationError(f"{path}: argued survivor {number} {what}; it needs {', '.join(WORDS)}")
        for mutant in entry["mutants"]:
            reasons[Change(entry["file"], entry["function"], entry["line"], mutant)] = entry["reason"]
    return reasons


def stale(reasons: Iterable[Change], existing: set[Change], gone: dict[Change, str]) -> list[str]:
    """Return what is wrong with argued survivors, given all mutants and what became of those that did not survive."""
    found = []
    for argued in reasons:
        if argued not in existing:
            found.append(f"{argued.file}: {argued.function}: no such mutant: {argued.line} -> {argued.mutant}")
        elif argued in gone:
            found.append(f"{argued.file}: {argued.function}: {gone[argued]}: {argued.line} -> {argued.mutant}")
    return found
