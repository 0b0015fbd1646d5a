"""Where the cycles go in the costliest step or tick of the corpus: by instruction, source line, kind and function."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rich.markup import escape
from rich.table import Table

from step_cost.measure import STEP, step_cost
from step_cost.paths import Blocks

ROWS = 40


def worst_path(blocks: Blocks, paths: Counter[bytes], whole_tick: bool = False) -> bytes:
    """Return the tick that took the most cycles, for its step or as a whole."""

    def cycles(path: bytes) -> int:
        cost = blocks.cost(path)
        part = cost.total if whole_tick else step_cost(cost)
        return 0 if part is None else part.cycles

    return max(paths, key=cycles)


@dataclass
class Spent:
    """Cycles and executions by the address of the instruction."""

    cycles: Counter[int]
    times: Counter[int]

    def by(self, name: Callable[[int], str]) -> list[tuple[str, int, int]]:
        """Return name, executions and cycles, added up by a name of the address, costliest first."""
        cycles, times = Counter[str](), Counter[str]()
        for address, number in self.cycles.items():
            cycles[name(address)] += number
            times[name(address)] += self.times[address]
        return [(key, times[key], number) for key, number in cycles.most_common()]


def spent_in(blocks: Blocks, path: bytes, functions: tuple[str, ...] | None = None) -> Spent:
    """Return what was spent in some functions and what they call, or in all of a path."""
    if functions is None:
        spans = [(0, len(path) // 4)]
    else:
        spans = [(a.begin, a.end) for a in blocks.cost(path).activations if a.function in functions]
    spent = Spent(Counter(), Counter())
    for begin, end in spans:
        spent.cycles.update(blocks.by_instruction(path, begin, end))
        spent.times.update(blocks.executed(path, begin, end))
    return spent


def _instructions(blocks: Blocks, spent: Spent, what: str) -> Table:
    columns = ("address", "function", "instruction", "times", "cycles", "line")
    made = Table(*columns, title=f"{what}: the {ROWS} costliest instructions")
    for address, cycles in spent.cycles.most_common(ROWS):
        where = (blocks.image.function_at(address), escape(blocks.instruction_at(address).text))
        line = blocks.image.line_at(address)
        made.add_row(f"{address:08x}", *where, str(spent.times[address]), str(cycles), line)
    return made


def _lines(blocks: Blocks, spent: Spent, what: str) -> Table:
    made = Table("line", "function", "instructions", "cycles", title=f"{what}: the {ROWS} costliest source lines")
    image = blocks.image

    def place(address: int) -> str:
        return f"{image.line_at(address)} {image.function_at(address)}"

    for name, times, cycles in spent.by(place)[:ROWS]:
        made.add_row(*name.split(" "), str(times), str(cycles))
    return made


def _side_by_side(title: str, name: Callable[[int], str], step: Spent, tick: Spent) -> Table:
    """Tell step and whole tick apart in one table."""
    made = Table(title, "step instructions", "step cycles", "of step", "tick instructions", "tick cycles")
    in_step = {key: (times, cycles) for key, times, cycles in step.by(name)}
    whole = sum(step.cycles.values())
    for key, times, cycles in sorted(tick.by(name), key=lambda row: (-in_step.get(row[0], (0, 0))[1], -row[2])):
        step_times, step_cycles = in_step.get(key, (0, 0))
        share = f"{100.0 * step_cycles / whole:.1f} %"
        made.add_row(key, str(step_times), str(step_cycles), share, str(times), str(cycles))
    made.add_section()
    totals = (sum(step.times.values()), whole, "", sum(tick.times.values()), sum(tick.cycles.values()))
    made.add_row("all", *(str(total) for total in totals))
    return made


def profile(blocks: Blocks, paths: Counter[bytes], whole_tick: bool = False) -> Iterator[Table]:
    """Yield tables of the costliest step, control step and trajectory evaluation with all they call, and its tick.

    Instructions and lines are those of the step, or with ``whole_tick`` of the costliest tick.
    """
    path = worst_path(blocks, paths, whole_tick)
    step, tick = spent_in(blocks, path, STEP), spent_in(blocks, path)

    def kind(address: int) -> str:
        return blocks.instruction_at(address).kind

    listed, what = (tick, "tick") if whole_tick else (step, "step")
    yield _instructions(blocks, listed, what)
    yield _lines(blocks, listed, what)
    yield _side_by_side("kind of instruction", kind, step, tick)
    yield _side_by_side("function, without what it calls", blocks.image.function_at, step, tick)
