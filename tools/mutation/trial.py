"""Runs the tests on mutants and says what became of each."""

from __future__ import annotations

import os
import resource
import subprocess
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mutation.errors import MutationError
from mutation.project import Test

WALL_LIMIT_S = 300.0  # a test that waits for something, which none does
LEAST_LIMIT_S, LIMIT_FACTOR = 0.5, 10.0
QUICK_S = 0.2  # a test that takes longer waits until the others have had their try
SIGVTALRM = 26


class Verdict(NamedTuple):
    """What became of a mutant: 'failed', 'crashed' or 'timeout' in a test, or 'survived'."""

    outcome: str
    test: str = ""


@dataclass(frozen=True)
class Measured:
    """A test, the mutants it reaches, and the processor time it takes without one."""

    test: Test
    reached: bytes
    time_s: float

    def reaches(self, number: int) -> bool:
        """Whether the code of a mutant runs in it."""
        return self.reached[number] != 0


def start(test: Test, **words: str) -> subprocess.CompletedProcess[bytes]:
    """Run a test, as a mutant if MUTANT says so."""
    environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0", **words}
    try:
        return subprocess.run(
            test.command, cwd=test.folder, env=environment, capture_output=True, timeout=WALL_LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(test.command, -SIGVTALRM)


def measure(test: Test, work: Path) -> Measured:
    """Run a test on the sources as they are."""
    path = work / f"reached-{test.name}"
    path.unlink(missing_ok=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = start(test, MUTANT_REACHED=str(path))
    time_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    if done.returncode != 0:
        said = (done.stdout + done.stderr).decode(errors="replace")
        raise MutationError(f"test {test.name} fails on the sources as they are:\n{said}")
    if not path.exists():
        raise MutationError(f"test {test.name} does not end by returning from main, so nothing is known of it")
    return Measured(test, path.read_bytes(), time_s)


def order(tests: Iterable[Measured], file: str) -> list[Measured]:
    """Return the tests in the order in which they are likely to kill a mutant of a file soon."""
    return sorted(tests, key=lambda t: (t.time_s > QUICK_S, t.test.name != Path(file).stem, t.time_s))


def judge(tests: Iterable[Measured], number: int | None) -> Verdict:
    """Run the tests on a mutant, or on what is built in, until one fails."""
    for measured in tests:
        limit_s = max(LEAST_LIMIT_S, LIMIT_FACTOR * measured.time_s)
        chosen = {} if number is None else {"MUTANT": str(number)}
        status = start(measured.test, MUTANT_LIMIT_MS=str(int(1000 * limit_s)), **chosen).returncode
        if status == -SIGVTALRM:
            return Verdict("timeout", measured.test.name)
        if status != 0:
            return Verdict("failed" if status > 0 else "crashed", measured.test.name)
    return Verdict("survived")


def judge_all(tests: list[Measured], files: dict[int, str], jobs: int) -> dict[int, Verdict]:
    """Judge mutants, given by number and file; one that no test reaches has survived."""

    def one(number: int) -> Verdict:
        return judge(order((t for t in tests if t.reaches(number)), files[number]), number)

    with ThreadPoolExecutor(jobs) as pool:
        return dict(zip(files, pool.map(one, files), strict=True))
