"""What the firmware may cost: the figures of tests/bench/budgets.toml, and who grew where one is exceeded.

The file has two halves. The upper one is written by people: what must hold, whatever the code, and how much more than
the budgets is let pass. The lower one is written by `--update`: the budgets, which are the figures of that day, and the
instructions by function behind them.
"""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from host_sim.trace import write_atomically
from step_cost.errors import CostError

MARK = "# ---- written by: omnibot cost --update\n"
STEP_FIGURES = ("instructions_max", "cycles_max")
MEMORY_FIGURES = ("stack_bytes", "flash_bytes", "ram_bytes")
GROWN = 6  # functions named

Result = dict[str, Any]


class BudgetError(CostError):
    """A figure is above what it may be."""


def read(file: Path) -> Result:
    """Return the file's contents."""
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CostError(f"cannot read the budgets {file}: {error}") from error


def cycle_limits(file: Path) -> dict[str, int]:
    """Return the cycles that must hold, by step."""
    limits = read(file)["must_hold"]
    return {name: limit["cycles_max"] for name, limit in limits.items() if "cycles_max" in limit}


def figures(result: Result) -> dict[str, dict[str, int | float]]:
    """Return what budgets are about: by step, 'tick' and 'firmware', by name of the figure."""
    found: dict[str, dict[str, int | float]] = {
        name: {figure: measured[figure] for figure in (*STEP_FIGURES, "worst_over_median")}
        for name, measured in result["steps"].items()
    }
    orders = result["steps"]["tick"]["by_order"]
    found["tick"]["worst_over_median"] = max(measured["worst_over_median"] for measured in orders.values())
    found["firmware"] = {figure: result[figure] for figure in MEMORY_FIGURES}
    return found


def composition(result: Result) -> dict[str, dict[str, int]]:
    """Return what each budget's figure is made of: instructions by function, bytes by module, the stack's chain."""
    modules = {name: sum(parts.values()) for name, parts in result["modules"].items()}
    return {**result["by_function"], "flash": modules, "stack": result["stack_chain"]}


def grown(now: dict[str, int], before: dict[str, int]) -> str:
    """Return who takes more than before, most first."""
    growth = {name: number - before.get(name, 0) for name, number in now.items()}
    rising = sorted((name for name in growth if growth[name] > 0), key=lambda name: -growth[name])
    told = [f"{name} {before.get(name, 0)} → {now[name]} (+{growth[name]})" for name in rising[:GROWN]]
    more = f" and {len(rising) - GROWN} more" if len(rising) > GROWN else ""
    return "; ".join(told) + more if told else "none"


# ---- the check


def exceeded(result: Result, allowed: Result) -> Iterator[str]:
    """Yield a line for each figure that is above its budget or above what must hold."""
    measured, parts = figures(result), composition(result)
    lenience = _lenience(result, allowed)
    for name, budgets in allowed.get("budget", {}).items():
        for figure, budget in budgets.items():
            most = budget * (1.0 + lenience)
            if measured[name][figure] > most:
                made_of = {"stack_bytes": "stack", "flash_bytes": "flash"}.get(figure, name)
                before = allowed["baseline"].get(made_of, {})
                who = f"; grew: {grown(parts[made_of], before)}" if made_of in parts else ""
                yield _line(name, figure, measured[name][figure], budget, f"budget {budget}") + who
    for name, limits in allowed["must_hold"].items():
        for figure, limit in limits.items():
            for each in _held_to(name, measured):
                if measured[each][figure] > limit:
                    yield _line(each, figure, measured[each][figure], limit, f"must hold: at most {limit}")


def _held_to(name: str, measured: Result) -> list[str]:
    """Return whom a limit is about: 'every_step' means each order."""
    return [each for each in measured if each not in ("tick", "firmware")] if name == "every_step" else [name]


def _line(name: str, figure: str, value: float, limit: float, what: str) -> str:
    over = value - limit
    return f"{name}: {figure} {value:g}, {what}: {over:.4g} over ({100.0 * over / limit:.1f} %)"


def _lenience(result: Result, allowed: Result) -> float:
    same = result["compiler"] == allowed["made_by"]["compiler"]
    return float(allowed["lenience"]["same_compiler" if same else "other_compiler"])


def check(result: Result, file: Path) -> str:
    """Return one line about a result within its budgets; BudgetError says what is not."""
    allowed = read(file)
    if "budget" not in allowed:
        raise CostError(f"{file} holds no budgets yet: omnibot cost --update writes them")
    lines = list(exceeded(result, allowed))
    if lines:
        raise BudgetError("\n  ".join([f"{len(lines)} figures are above {file.name}:", *lines]))
    count = sum(len(budgets) for budgets in allowed["budget"].values())
    return f"within all {count} budgets and every limit of {file.name}"


# ---- the update


def update(result: Result, file: Path) -> None:
    """Make the figures of a result the budgets."""
    try:
        upper = file.read_text(encoding="utf-8").partition(MARK)[0]
    except OSError as error:
        raise CostError(f"cannot read the budgets {file}: {error}") from error
    write_atomically(file, (upper + MARK + "\n".join(_written(result)) + "\n").encode())


def _written(result: Result) -> Iterator[str]:
    yield f'[made_by]\ncompiler = "{result["compiler"]}"'
    for name, numbers in figures(result).items():
        yield f"\n[budget.{name}]"
        yield from (f"{figure} = {value}" for figure, value in numbers.items() if figure != "worst_over_median")
    for name, parts in composition(result).items():
        yield f"\n[baseline.{name}]"
        yield from (f'"{key}" = {number}' for key, number in sorted(parts.items()))
