"""Mutation testing: change the firmware's C in one small place at a time and see whether the unit tests notice.

  tools/mutate firmware/control               every mutant of a folder
  tools/mutate firmware/control/floor.c       of a file
  tools/mutate firmware --sample 300          300 of them, always the same for a --seed

A mutant is killed if a test of tests/unit fails, crashes under the sanitizers, or takes ten times its processor time.
Score: the killed of all but those of which a compiler makes the same machine code as of the source ('equivalent').
Survivors that are argued in tests/mutation/survivors.toml count as survivors.

Exit status 1 if a mutant survives that is not argued, if an argued one is killed, equivalent or no longer there, or if
the score of a PATH in a run over everything is below --at-least.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mutation import argued, trial
from mutation.equivalence import Equivalence
from mutation.errors import MutationError
from mutation.operators import Mutant, Mutator, unique
from mutation.project import Project
from mutation.schemata import MUTANTS_MAX, Schemata, mutated
from mutation.syntax import Texts, parse

ROOT = Path(__file__).resolve().parents[2]
ARGUED = "tests/mutation/survivors.toml"
KILLED = {"failed", "crashed", "timeout"}


@dataclass
class Survey:
    """The mutants of what was asked for: by number, what they look like, and what became of those that were tried."""

    root: Path
    paths: dict[str, list[str]]  # as they were given, and the files in each
    mutants: dict[int, Mutant]
    changes: dict[int, argued.Change]
    verdicts: dict[int, trial.Verdict] = field(default_factory=dict)

    def line(self, number: int) -> int:
        """Return the line that a mutant stands in, counted from 1."""
        mutant = self.mutants[number]
        return (self.root / self.changes[number].file).read_bytes().count(b"\n", 0, mutant.start) + 1

    def numbers(self, *outcomes: str) -> list[int]:
        """Return the mutants of which this became."""
        return [n for n, verdict in self.verdicts.items() if verdict.outcome in outcomes]

    def part(self, files: Sequence[str]) -> Survey:
        """Return what became of the mutants of some files."""
        verdicts = {n: v for n, v in self.verdicts.items() if self.changes[n].file in files}
        return Survey(self.root, {}, self.mutants, self.changes, verdicts)

    @property
    def score(self) -> float:
        """Killed over all that are a change; 1 if there are none."""
        killed, alive = len(self.numbers(*KILLED)), len(self.numbers("survived"))
        return killed / (killed + alive) if killed + alive else 1.0


def chosen_files(root: Path, path: str, known: Sequence[str]) -> list[str]:
    """Return the C files that a path asks for."""
    name = os.path.relpath(Path(path).resolve(), root)
    files = [f for f in known if f.endswith((".c", ".h")) and (f == name or f.startswith(f"{name}/"))]
    if not files:
        raise MutationError(f"{path} is no C file of the project, and no folder with one")
    return sorted(files)


def find_mutants(project: Project, paths: dict[str, list[str]]) -> Survey:
    """Return every mutant of the files."""
    texts, files = Texts(), {file for part in paths.values() for file in part}
    found: list[Mutant] = []
    mutator = Mutator({str(project.root / file) for file in files}, texts)
    folders = {str(Path(file).parent) for file in files}
    for source, options in project.options().items():
        if str(Path(source).parent) in folders:
            found += mutator.mutants(parse(project.root / source, options, texts))
    mutants = dict(enumerate(unique(iter(found))))
    if len(mutants) > MUTANTS_MAX:
        raise MutationError(f"there are {len(mutants)} mutants, more than {MUTANTS_MAX}: give fewer files")
    names = {n: os.path.relpath(m.file, project.root) for n, m in mutants.items()}
    changes = {n: argued.change(texts[m.file], m, names[n]) for n, m in mutants.items()}
    return Survey(project.root, paths, mutants, changes)


def with_all_mutants(survey: Survey) -> dict[str, bytes]:
    """Return the texts that hold the mutants, by file."""
    texts = {}
    for file in {change.file for change in survey.changes.values()}:
        inside = {n: m for n, m in survey.mutants.items() if survey.changes[n].file == file}
        texts[file] = Schemata((survey.root / file).read_bytes(), inside).render()
    return texts


def try_constant(project: Project, tests: Sequence[trial.Measured]) -> trial.Verdict:
    """Judge the mutant that stands in the tree, building one test after the other until one kills it."""
    for measured in tests:
        try:
            project.make(measured.test)
        except MutationError:
            return trial.Verdict("invalid")
        verdict = trial.judge([measured], None)
        if verdict.outcome != "survived":
            return verdict
    return trial.Verdict("survived")


def try_constants(
    project: Project, survey: Survey, numbers: Sequence[int], tests: Sequence[trial.Measured]
) -> dict[int, trial.Verdict]:
    """Judge the mutants that the compiler must see, in the tests that run anything of their file."""
    verdicts = {}
    for number in numbers:
        file, mutant = survey.changes[number].file, survey.mutants[number]
        beside = [
            n for n, change in survey.changes.items() if change.file == file and not survey.mutants[n].is_constant
        ]
        near = [t for t in tests if not beside or any(t.reaches(n) for n in beside)]
        source = (survey.root / file).read_bytes()
        project.put(file, mutated(source, mutant))
        verdicts[number] = try_constant(project, trial.order(near, file))
        project.put(file, source)
    return verdicts


def try_mutants(project: Project, survey: Survey, numbers: Sequence[int], jobs: int) -> None:
    """Find out what becomes of mutants."""
    project.copy(with_all_mutants(survey))
    project.make()
    tests = [trial.measure(test, project.build.parent) for test in project.tests()]
    constant = [n for n in numbers if survey.mutants[n].is_constant]
    files = {n: survey.changes[n].file for n in numbers if not survey.mutants[n].is_constant}
    survey.verdicts = trial.judge_all(tests, files, jobs)
    survey.verdicts |= try_constants(project, survey, constant, tests)
    equivalence, survived = Equivalence(project), survey.numbers("survived")
    with ThreadPoolExecutor(jobs) as pool:
        same = pool.map(lambda n: equivalence.holds(survey.changes[n].file, survey.mutants[n]), survived)
        survey.verdicts |= {
            n: trial.Verdict("equivalent") for n, is_same in zip(survived, same, strict=True) if is_same
        }


def complaints(survey: Survey, reasons: dict[argued.Change, str], at_least: float | None) -> list[str]:
    """Return what makes the run a failure."""
    survivors = {survey.changes[n] for n in survey.numbers("survived")}
    gone = {survey.changes[n]: f"is {v.outcome}, not survived" for n, v in survey.verdicts.items()}
    gone = {change: what for change, what in gone.items() if change not in survivors}
    here = [change for change in reasons if any(change.file in files for files in survey.paths.values())]
    found = [f"argued survivor, {line}" for line in argued.stale(here, set(survey.changes.values()), gone)]
    unargued = [n for n in survey.numbers("survived") if survey.changes[n] not in reasons]
    if unargued:
        found.append(f"{len(unargued)} survivors are not argued in {ARGUED}")
    for path, files in survey.paths.items():
        percent = 100 * survey.part(files).score
        if at_least is not None and percent < at_least:
            found.append(f"the score of {path} is {percent:.1f} %, below {at_least:g} %")
    return found


def described(survey: Survey, number: int, reasons: dict[argued.Change, str]) -> dict[str, Any]:
    """Return a mutant as --json shows it."""
    change, verdict = survey.changes[number], survey.verdicts[number]
    return {
        **change._asdict(),
        "at": survey.line(number),
        "operator": survey.mutants[number].operator,
        "outcome": verdict.outcome,
        "test": verdict.test,
        "reason": reasons.get(change, ""),
    }


def print_report(survey: Survey, reasons: dict[argued.Change, str]) -> None:
    """Print survivors and scores for a reader."""
    for number in sorted(survey.numbers("survived")):
        change = survey.changes[number]
        mark = "argued" if change in reasons else "SURVIVED"
        print(f"{change.file}:{survey.line(number)}: {change.function}: {mark}: {survey.mutants[number].operator}")
        print(f"    {change.line}\n    {change.mutant}")
        if change in reasons:
            print(f"    {reasons[change]}")
    print("file                                     mutants  killed  survived  equivalent  score")
    single = {change.file: [change.file] for change in sorted(survey.changes.values())}
    for name, files in {**single, **{path: files for path, files in survey.paths.items() if len(files) > 1}}.items():
        part = survey.part(files)
        if part.verdicts:
            killed, alive, same = (len(part.numbers(*o)) for o in (KILLED, ["survived"], ["equivalent"]))
            print(f"{name:40} {len(part.verdicts):7} {killed:7} {alive:9} {same:11} {100 * part.score:5.1f} %")


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    """Return what is asked for."""
    parser = argparse.ArgumentParser(
        prog="mutate", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("path", nargs="+", help="a folder or a file of C")
    parser.add_argument(
        "-j", "--jobs", type=int, default=os.cpu_count() or 1, help="mutants at a time (default: cores)"
    )
    parser.add_argument("--sample", type=int, metavar="N", help="try N mutants only")
    parser.add_argument("--seed", type=int, default=1, help="which ones (default: 1)")
    parser.add_argument("--at-least", type=float, default=90.0, metavar="PERCENT", help="least score (default: 90)")
    parser.add_argument("--list", action="store_true", help="show the mutants and try none")
    parser.add_argument("--json", action="store_true", help="print the result for machines")
    parser.add_argument("--root", type=Path, default=ROOT, help="the project (default: this one)")
    parsed = parser.parse_args(words)
    for name in ("jobs", "sample"):
        if getattr(parsed, name) is not None and getattr(parsed, name) < 1:
            parser.error(f"--{name} is a whole number above 0, not {getattr(parsed, name)}")
    return parsed


def run(asked: argparse.Namespace) -> int:
    """Do what is asked for."""
    root = asked.root.resolve()
    project = Project(root, root / "build" / "mutation")
    known = project.files()
    paths = {path: chosen_files(root, path, known) for path in asked.path}
    reasons = argued.read(root / ARGUED)
    project.copy({})
    project.configure()
    survey = find_mutants(project, paths)
    if asked.list:
        for number, change in survey.changes.items():
            print(f"{change.file}:{survey.line(number)}: {change.function}: {change.line} -> {change.mutant}")
        return 0
    numbers = list(survey.mutants)
    if asked.sample is not None and asked.sample < len(numbers):
        numbers = sorted(random.Random(asked.seed).sample(numbers, asked.sample))
    try_mutants(project, survey, numbers, asked.jobs)
    whole = len(numbers) == len(survey.mutants)
    wrong = complaints(survey, reasons, asked.at_least if whole else None)
    if asked.json:
        mutants = [described(survey, n, reasons) for n in sorted(survey.verdicts)]
        counts = Counter(verdict.outcome for verdict in survey.verdicts.values())
        print(json.dumps({"score": survey.score, **counts, "wrong": wrong, "mutants": mutants}, indent=1))
    else:
        print_report(survey, reasons)
    for line in wrong:
        print(f"mutate: {line}", file=sys.stderr)
    return 1 if wrong else 0


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line."""
    try:
        return run(arguments(words))
    except MutationError as error:
        print(f"mutate: {error}", file=sys.stderr)
        return 2
