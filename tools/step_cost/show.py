"""The figures as tables for a terminal."""

from rich.table import Table

from step_cost.corpus import TICK
from step_cost.measure import Figures, Measurement

CORE_MHz = 168.0
PERIOD_us = 1000.0


def _row(label: str, output: str, figures: Figures) -> list[str]:
    instructions, cycles = figures.range_of("instructions"), figures.range_of("cycles")
    low, high = figures.range_of("low"), figures.range_of("high")
    microseconds = cycles.maximum / CORE_MHz
    return [
        label,
        output,
        f"{instructions.minimum} / {instructions.median} / {instructions.maximum}",
        f"{cycles.minimum} / {cycles.median} / {cycles.maximum}",
        f"{low.maximum} … {high.maximum}",
        f"{microseconds:.1f}",
        f"{100.0 * microseconds / PERIOD_us:.2f} %",
        f"{cycles.maximum / cycles.median:.3f}",
    ]


def table(measurement: Measurement) -> Table:
    """Return steps and ticks by order and output."""
    made = Table("what", "output", "instructions", "cycles", "range of max", "us", "of 1 ms", "max/median")
    for key, figures in measurement.steps.items():
        made.add_row(*_row(f"step {key.order}", key.output, figures))
    made.add_section()
    for (key, kind), figures in measurement.ticks.items():
        if kind == TICK:
            made.add_row(*_row(f"tick {key.order}", key.output, figures))
    return made
