"""Where the cycles of a step go: the costliest tick of the corpus, by function, kind of instruction and line."""

from collections import Counter
from collections.abc import Iterator

from rich.markup import escape
from rich.table import Table

from step_cost.measure import step_cost
from step_cost.paths import CALL_FROM_OUTSIDE, Blocks

LINES = 40


def worst_path(blocks: Blocks, paths: Counter[bytes]) -> bytes:
    """Return the tick whose step took the most cycles."""

    def cycles(path: bytes) -> int:
        cost = step_cost(blocks.cost(path))
        return 0 if cost is None else cost.cycles

    return max(paths, key=cycles)


def _executed(path: bytes) -> list[int]:
    return [address for address in memoryview(path).cast("I").tolist() if address != CALL_FROM_OUTSIDE]


def _by_function(blocks: Blocks, path: bytes) -> Table:
    cost = blocks.cost(path)
    calls = Counter(activation.function for activation in cost.activations)
    total = cost.total.cycles
    made = Table("function", "calls", "own instructions", "own cycles", "of tick", "with callees", title="by function")
    for name, own in sorted(cost.own.items(), key=lambda item: -item[1].cycles):
        share = f"{100 * own.cycles / total:.1f} %"
        made.add_row(name, str(calls[name]), str(own.instructions), str(own.cycles), share, str(cost.of(name).cycles))
    made.add_section()
    made.add_row("whole tick", "", str(cost.total.instructions), str(total), "100 %", "")
    return made


def _by_kind(blocks: Blocks, path: bytes) -> Table:
    spent, counts, cycles = blocks.by_instruction(path), Counter[str](), Counter[str]()
    kinds = {i.address: i.kind for address in set(_executed(path)) for i in blocks.instructions(address)}
    for address in _executed(path):
        counts.update(instruction.kind for instruction in blocks.instructions(address))
    for address, number in spent.items():
        cycles[kinds[address]] += number
    total = sum(cycles.values())
    made = Table("kind", "instructions", "cycles", "of tick", title="by kind of instruction")
    for kind, number in cycles.most_common():
        made.add_row(kind, str(counts[kind]), str(number), f"{100 * number / total:.1f} %")
    return made


def _by_line(blocks: Blocks, path: bytes) -> Table:
    spent: Counter[tuple[str, str]] = Counter()
    counts: Counter[tuple[str, str]] = Counter()
    image = blocks.image
    for address, number in blocks.by_instruction(path).items():
        spent[image.function_at(address), image.line_at(address)] += number
    for block in _executed(path):
        for instruction in blocks.instructions(block):
            counts[image.function_at(instruction.address), image.line_at(instruction.address)] += 1
    made = Table("function", "line", "instructions", "cycles", title=f"the {LINES} costliest source lines")
    for (function, line), number in spent.most_common(LINES):
        made.add_row(function, line, str(counts[function, line]), str(number))
    return made


def _by_instruction(blocks: Blocks, path: bytes) -> Table:
    executed = _executed(path)
    instructions = {i.address: i for block in set(executed) for i in blocks.instructions(block)}
    times = Counter(i.address for block in executed for i in blocks.instructions(block))
    columns = ("address", "function", "instruction", "times", "cycles", "line")
    made = Table(*columns, title=f"the {LINES} costliest instructions")
    for address, number in blocks.by_instruction(path).most_common(LINES):
        image = blocks.image
        where = (image.function_at(address), escape(instructions[address].text))
        made.add_row(f"{address:08x}", *where, str(times[address]), str(number), image.line_at(address))
    return made


def profile(blocks: Blocks, paths: Counter[bytes]) -> Iterator[Table]:
    """Yield the tables for the tick with the costliest step."""
    path = worst_path(blocks, paths)
    yield _by_instruction(blocks, path)
    yield _by_line(blocks, path)
    yield _by_kind(blocks, path)
    yield _by_function(blocks, path)
