"""The result as tables, for the terminal and for the page."""

from collections.abc import Iterator
from typing import Any, NamedTuple

RESULT = dict[str, Any]


class Table(NamedTuple):
    """A table of text."""

    title: str
    head: list[str]
    rows: list[list[str]]


COSTS = [
    "instructions min / median / max",
    "cycles min / median / max",
    "max: low … high",
    "µs",
    "of 1 ms",
    "max/median",
]


def _costs(figures: RESULT) -> list[str]:
    return [
        "{instructions_min} / {instructions_median} / {instructions_max}".format_map(figures),
        "{cycles_min} / {cycles_median} / {cycles_max}".format_map(figures),
        "{cycles_max_low} … {cycles_max_high}".format_map(figures),
        f"{figures['microseconds_max']:.2f}",
        f"{100.0 * figures['share_of_period_max']:.2f} %",
        f"{figures['worst_over_median']:.3f}",
    ]


def _steps(result: RESULT) -> Table:
    rows = []
    for name, figures in result["steps"].items():
        if name != "tick":
            rows.append([name, "posture", *_costs(figures)])
            rows.append([name, "point", *_costs(figures["point"])])
    return Table("control_step with trajectory evaluation", ["order", "output", *COSTS], rows)


def _ticks(result: RESULT) -> Table:
    rows = [[name, *_costs(figures)] for name, figures in result["steps"]["tick"]["by_order"].items()]
    rows.append(["all", *_costs(result["steps"]["tick"])])
    rows += [[kind, *_costs(figures)] for kind, figures in result["other_ticks"].items()]
    return Table("tick: frames in, step, frames out", ["order", *COSTS], rows)


def _messages(result: RESULT) -> Table:
    rows = [[name, verb, *_costs(both[verb])[:4]] for name, both in result["messages"].items() for verb in both]
    return Table("messages", ["message", "", *COSTS[:4]], rows)


def _memory(result: RESULT) -> Table:
    chain = " → ".join(f"{name} {size}" for name, size in result["stack_chain"].items())
    rows = [
        ["stack, deepest chain of calls", str(result["stack_bytes"]), chain],
        ["stack, painted over the corpus", str(result["stack_painted_bytes"]), ""],
        ["flash", str(result["flash_bytes"]), result["sizes_of"]],
        ["RAM without trajectory store", str(result["ram_bytes"]), "variables and the deepest stack"],
        ["trajectory store", str(result["store_bytes"]), ""],
    ]
    return Table("memory", ["what", "bytes", ""], rows)


def _modules(result: RESULT) -> Table:
    kinds = ("code", "constants", "variables")
    rows = [[name, *(str(parts.get(kind, 0)) for kind in kinds)] for name, parts in result["modules"].items()]
    return Table(f"bytes by module of {result['sizes_of']}", ["module", *kinds], rows)


def _states(result: RESULT) -> Table:
    return Table(
        "bytes by struct", ["struct", "bytes"], [[name, str(size)] for name, size in result["state_bytes"].items()]
    )


def tables(result: RESULT) -> Iterator[Table]:
    """Yield every table of a result."""
    yield _steps(result)
    yield _ticks(result)
    yield _messages(result)
    yield _memory(result)
    yield _modules(result)
    yield _states(result)
