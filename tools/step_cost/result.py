"""Everything measured, as one dictionary: what --json prints, what budgets and tables read."""

from collections import Counter
from pathlib import Path
from typing import Any

from step_cost import motors
from step_cost.corpus import ORDERS, TICK
from step_cost.errors import CostError
from step_cost.image import Image
from step_cost.layout import layouts
from step_cost.measure import STEP, Class, Figures, Measurement, Target
from step_cost.messages import Messages
from step_cost.profile import spent_in, worst_path
from step_cost.stack import StackDepths

CORE_MHz = 168.0
PERIOD_us = 1000.0
OUTPUT = "posture"  # the one that the figures of an order are about; those of the point are beside them
POINT = "point"

COUNTED = "instructions: every one that the firmware's own target code executes, on an emulated Cortex-M4F"
ESTIMATED = (
    "cycles: by a model of the Cortex-M4's manual (ARM DDI 0439, tables 3-1 and 7-1), memory without wait states; "
    "what a board's flash adds is not in them. low and high take every chance of the manual, or none"
)


def summary(figures: Figures) -> dict[str, Any]:
    """Return what is told of the costs of one thing."""
    instructions, cycles = figures.range_of("instructions"), figures.range_of("cycles")
    microseconds = cycles.maximum / CORE_MHz
    return {
        "seen": figures.count,
        "instructions_min": instructions.minimum,
        "instructions_median": instructions.median,
        "instructions_max": instructions.maximum,
        "cycles_min": cycles.minimum,
        "cycles_median": cycles.median,
        "cycles_max": cycles.maximum,
        "cycles_max_low": figures.range_of("low").maximum,
        "cycles_max_high": figures.range_of("high").maximum,
        "microseconds_max": round(microseconds, 3),
        "share_of_period_max": round(microseconds / PERIOD_us, 6),
        "worst_over_median": round(cycles.maximum / cycles.median, 4),
    }


def step_name(order: str) -> str:
    """Return an order's name among the steps."""
    return f"order{order}" if order.isdigit() else order


def steps(measurement: Measurement) -> dict[str, Any]:
    """Return the steps by order, and the tick."""
    found: dict[str, Any] = {}
    for order in ORDERS:
        found[step_name(order)] = summary(measurement.steps[Class(order, OUTPUT)])
        found[step_name(order)][POINT] = summary(measurement.steps[Class(order, POINT)])
    whole = Figures()
    for (_, kind), figures in measurement.ticks.items():
        if kind == TICK:
            whole.seen.update(figures.seen)
    found["tick"] = summary(whole) | {"by_order": _ticks_by_order(measurement)}
    return found


def _ticks_by_order(measurement: Measurement) -> dict[str, Any]:
    return {step_name(order): summary(measurement.ticks[Class(order, OUTPUT), TICK]) for order in ORDERS}


def other_ticks(measurement: Measurement) -> dict[str, Any]:
    """Return what is no ordinary tick, by its kind."""
    found: dict[str, Figures] = {}
    for (_, kind), figures in measurement.ticks.items():
        if kind != TICK:
            found.setdefault(kind, Figures()).seen.update(figures.seen)
    return {kind: summary(figures) for kind, figures in found.items()}


def by_function(target: Target, measurement: Measurement) -> dict[str, dict[str, int]]:
    """Return each function's own instructions in the costliest step of each order and in the costliest tick."""
    blocks, found = target.blocks, {}
    for order in ORDERS:
        paths = measurement.paths[Class(order, OUTPUT), TICK]
        spent = spent_in(blocks, worst_path(blocks, paths), STEP)
        found[step_name(order)] = _named(target, spent.times)
    ticks = [path for (_, kind), paths in measurement.paths.items() if kind == TICK for path in paths]
    costliest = max(ticks, key=lambda path: blocks.cost(path).total.cycles)
    found["tick"] = _named(target, spent_in(blocks, costliest).times)
    return found


def _named(target: Target, times: Counter[int]) -> dict[str, int]:
    by_name: Counter[str] = Counter()
    for address, number in times.items():
        by_name[target.image.function_at(address)] += number
    return dict(by_name.most_common())


def memory(image: Image, board: Image | None, stack_bytes: int) -> dict[str, Any]:
    """Return flash and RAM: the board's own, where its image is there, else those of the firmware without a port."""
    sizes = layouts(image.file)
    store_bytes, app_bytes = sizes["store_t"].size, sizes["app_t"].size
    measured = image if board is None else board
    variables_bytes = app_bytes if board is None else board.variables_bytes
    return {
        "flash_bytes": measured.flash_bytes,
        "ram_bytes": variables_bytes - store_bytes + stack_bytes,
        "sizes_of": measured.file.name,
        "store_bytes": store_bytes,
        "variables_bytes": variables_bytes,
        "modules": {name: dict(parts) for name, parts in sorted(measured.modules.items())},
        "state_bytes": {name: sizes[name].size for name in STATES if name in sizes},
    }


STATES = (
    "app_t",
    "store_t",
    "outbox_t",
    "parameters_t",
    "control_params_t",
    "control_state_t",
    "control_input_t",
    "control_output_t",
    "robot_t",
    "trajectory_segment_t",
    "frame_t",
)


def collect(target: Target, measurement: Measurement, build: Path, board: Image | None) -> dict[str, Any]:
    """Return the whole result."""
    depths = StackDepths(target.image, build)
    called = [name for name in sorted(target.image.functions) if name.startswith("app_")]
    deepest = max((depths.of(name) for name in called), key=lambda chain: chain.total_bytes)
    if measurement.painted_stack_bytes > deepest.total_bytes:
        raise CostError(
            f"the stack went {measurement.painted_stack_bytes} bytes deep, deeper than the {deepest.total_bytes} of "
            "every chain of calls: tools/step_cost/calls.py misses one"
        )
    return {
        "counted": COUNTED,
        "estimated": ESTIMATED,
        "core_MHz": CORE_MHz,
        "period_us": PERIOD_us,
        "compiler": target.image.compiler,
        "steps": steps(measurement),
        "other_ticks": other_ticks(measurement) | {motors.KIND: summary(motors.MotorTicks(target).measure())},
        "messages": {
            name: {verb: summary(figures) for verb, figures in both.items()}
            for name, both in Messages(target).measure().items()
        },
        "functions": {name: summary(figures) for name, figures in sorted(measurement.functions.items())},
        "stack_bytes": deepest.total_bytes,
        "stack_painted_bytes": measurement.painted_stack_bytes,
        "stack_chain": dict(deepest.frames),
        "by_function": by_function(target, measurement),
        **memory(target.image, board, deepest.total_bytes),
    }
