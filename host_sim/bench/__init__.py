"""How fast plant, loop and bus are, each beside its reference: ratios of one run."""

import time
from typing import Any

from host_sim.bench.loops import measure_loops
from host_sim.bench.plants import measure_plants
from host_sim.bench.vcan import measure_vcan
from host_sim.errors import OmnibotError

SLOW_CLOCK_US = 1.0
PARTS = ("plant", "loop", "vcan")


def choose(only: str | None) -> tuple[str, ...]:
    """Return the parts that a comma-separated list names; all without one."""
    names = PARTS if only is None else tuple(name.strip() for name in only.split(","))
    for name in names:
        if name not in PARTS:
            raise OmnibotError(f"no part {name!r} of the bench; there are: {', '.join(PARTS)}")
    return names


def bench(parts: tuple[str, ...], interface: str) -> dict[str, Any]:
    """Measure some parts; a figure that was not measured is None, and ``missing`` says why."""
    result: dict[str, Any] = dict.fromkeys(
        ("plant_vs_radau", "inproc_real_time_factor", "loop_real_time_factor", "vcan_vs_pingpong"), None
    )
    result["clock_us"] = clock_us()
    if "plant" in parts:
        result |= measure_plants()
    if "loop" in parts:
        result |= measure_loops()
    if "vcan" in parts:
        result |= measure_vcan(interface)
    return result


def clock_us(readings: int = 1000) -> float:
    """Return what a reading of the clock takes: a loop that reads it every tick is slower by that."""
    begin_s = time.perf_counter()
    for _ in range(readings):
        time.perf_counter()
    return 1e6 * (time.perf_counter() - begin_s) / readings


def table(result: dict[str, Any]) -> str:
    """Return what was measured as text."""
    lines = []
    if result["plant_vs_radau"] is not None:
        lines.append("plant, µs a period, and how many times longer scipy takes at the same error")
        lines.append(f"  {'torques':<10}{'floor':<8}{'ε':>7}{'µs':>8}{'error':>10}{'Radau':>8}{'BDF':>8}{'LSODA':>8}")
        lines += [_plant_line(row) for row in result["plant"]]
        lines.append(f"  at least {result['plant_vs_radau']:.0f} times faster than Radau")
    for name, label in (("loop", "without a bus, one compiled loop"), ("inproc", "in-process, through python-can")):
        factor = result[f"{name}_real_time_factor"]
        if factor is not None:
            lines.append(f"closed loop {label}: {factor:.1f} times real time, {1e3 * factor:.0f} ticks/s")
    if result["vcan_vs_pingpong"] is not None:
        us, frames_us = result["vcan_us_per_tick"], result["pingpong_us_per_tick"]
        lines.append(
            f"closed loop over a vcan of {result['vcan_kernel']}: {us:.0f} µs a tick, {result['vcan_vs_pingpong']:.2f} "
            f"times the {frames_us:.0f} µs of its frames alone, from C to C"
        )
    if result["clock_us"] > SLOW_CLOCK_US:
        lines.append(
            f"a reading of the clock takes {result['clock_us']:.0f} µs here, and a tick through python-can has four of "
            "them: outside of tools/with-vcan that loop shows its own speed"
        )
    return "\n".join([*lines, *([result["missing"]] if "missing" in result else [])])


def _plant_line(row: dict[str, Any]) -> str:
    slower = "".join(_slower(row[name]) for name in ("radau", "bdf", "lsoda"))
    floor = f"  {row['torques']:<10}{row['traction']:<8}{row['epsilon']:>7g}"
    return f"{floor}{row['us_per_period']:>8.2f}{row['error']:>10.1e}{slower}"


def _slower(other: dict[str, Any]) -> str:
    """Return how many times longer another took; with a > where it was not even as exact."""
    times = f"{other['times_slower']:.0f}"
    return f"{times if other['as_exact'] else '>' + times:>8}"
