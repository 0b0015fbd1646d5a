"""Fig. 3a: the largest ε at which the robot still tracks."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from host_sim.drive import Status
from host_sim.metrics import tracking_error
from host_sim.paper.published import EPSILON_STAR, predicted_epsilon_star
from host_sim.paper.section import Section, Table, figure_text, length_text
from host_sim.paper.simulate import Case, Outcome, Simulator
from host_sim.planner import RHOMBUS_DIAGONAL_M
from host_sim.report.figure import (
    REFERENCE,
    STYLES,
    Axis,
    Drawn,
    Figure,
    Panel,
    Style,
    curve,
    level,
    line,
    points,
    upright,
)
from host_sim.robot import Array, Robot

SPEED_m_per_s = 0.5
ORDERS = ("0", "1", "2", "3", "exact", "observer")
BOUNDS_ON: tuple[tuple[str, str], ...] = ()
GRID = np.geomspace(1e-4, 0.3, 257)  # neighbours are 3 % apart

# What tracking means here: the run completes, the error stays below ...
ERROR_LIMIT_m = 0.1
# ... and between two ticks at constant velocity, long after the corner, the torque changes by no more than this. A
# quiet loop is at 0.1 mN·m, what its sensors resolve on the wire; one that oscillates soon flips between its limits.
QUIET_Nm = 5e-3
QUIET_FROM_s, QUIET_TO_s = 2.4, 2.7  # the corner's time is 0.5 s, braking starts at 2.78 s at the earliest

SHOWN_EPSILON = 0.1


def bounds_off(robot: Robot) -> tuple[tuple[str, str], ...]:
    """Return the firmware parameters that let everything through."""
    largest = {name: robot.parameter(name).maximum for name in ("force_bound_N", "torque_bound_Nm", "series_ratio_max")}
    return tuple((name, repr(value)) for name, value in largest.items())


def case_of(order: str, epsilon: float, parameters: tuple[tuple[str, str], ...]) -> Case:
    """Return the run by which stability is judged."""
    return Case(SPEED_m_per_s, epsilon, order, "rounded", "linear", 0.5, 3.2, parameters)


def tracks(outcome: Outcome) -> bool:
    """Tell whether a run tracked: completed, a small error, no oscillation that lasts."""
    if outcome.status is not Status.COMPLETED or not outcome.error_m < ERROR_LIMIT_m:
        return False
    time_s = outcome.trace.time_s
    torque = outcome.trace.torque[(time_s >= QUIET_FROM_s) & (time_s < QUIET_TO_s)]
    return bool(np.abs(np.diff(torque, axis=0)).max() < QUIET_Nm)


def largest_tracking(passes: Callable[[float], bool], grid: Array = GRID) -> float:
    """Bisect a rising grid for the last value that passes; infinite if all do, 0 if none does."""
    if passes(float(grid[-1])):
        return math.inf
    low, high = -1, len(grid) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if passes(float(grid[middle])):
            low = middle
        else:
            high = middle
    return float(grid[low]) if low >= 0 else 0.0


def fig3a(simulator: Simulator) -> Section:
    """Measure ε* of every order, with the bounds off and on, and show a run past it."""
    robot = simulator.robot
    bounds = {"off": bounds_off(robot), "on": BOUNDS_ON}

    def measured(order: str, parameters: tuple[tuple[str, str], ...]) -> float:
        return largest_tracking(lambda epsilon: tracks(simulator.run(case_of(order, epsilon, parameters))))

    found = {order: {name: measured(order, bounds[name]) for name in bounds} for order in ORDERS}
    damping = robot.parameter("position_damping_per_s").default
    paper_case = case_of("1", EPSILON_STAR, bounds["off"])
    predicted = predicted_epsilon_star(robot, damping, SPEED_m_per_s + paper_case.scenario.delta_m_per_s)
    at_paper = simulator.run(paper_case)
    shown = _shown(simulator, bounds)
    captions = (
        "Largest ε at which each order tracks, with and without the firmware's bounds; an arrow: beyond the grid's "
        "end.",
        f"Past ε*, at ε = {SHOWN_EPSILON:g}: the N → ∞ limit without and with the bounds, and the observer; beside "
        "them the paper's order 1 at the paper's own ε*.",
    )
    return Section(
        title="Fig. 3a: the largest ε that is stable",
        paper="unstable from ε* = 5·10⁻⁵ on",
        ours=f"tracks at 5·10⁻⁵ to {length_text(at_paper.error_m)}; order 1 up to ε* = {_text(found['1']['off'])}, "
        f"predicted {figure_text(predicted)}",
        remarks=_remarks(found, predicted, at_paper),
        tables=[_table(found, _at_end(simulator, bounds))],
        figures=[
            Figure("fig3a-epsilon-star", captions[0], [_found_panel(found, predicted)], wide=True),
            Figure("fig3a-runs", captions[1], _run_panels(shown), wide=True),
        ],
        numbers={"fig3a": _numbers(found, predicted, at_paper)},
    )


def _name(order: str) -> str:
    return f"order {order}" if order.isdigit() else order


def _text(epsilon: float) -> str:
    """Write an ε* that may be beyond the grid."""
    if epsilon == 0.0:
        return f"below {figure_text(float(GRID[0]))}"
    return f"above {figure_text(float(GRID[-1]))}" if math.isinf(epsilon) else figure_text(epsilon)


def _remarks(found: dict[str, dict[str, float]], predicted: float, at_paper: Outcome) -> list[str]:
    """Say what was measured, and how it compares."""
    return [
        f"ε* here is the largest ε, bisected on a grid with steps of 3 %, at which a run at {SPEED_m_per_s:g} m/s "
        "around the rounded corner on the linear floor tracks: it completes, its error stays below 0.1 m, and two "
        "seconds after the corner, at constant velocity, the torque changes by less than 5 mN·m between ticks. A "
        "quiet loop is at 0.1 mN·m; one past ε* flips between its limits from tick to tick, or is lost.",
        "A correct implementation of the expansion is predicted to be stable up to ε* = 0.5·1.5 G0/(K2 m (V+δ)) = "
        f"{figure_text(predicted)}, {predicted / EPSILON_STAR:.0f} times the paper's 5·10⁻⁵; found with the bounds "
        "off: "
        + ", ".join(f"{_text(found[order]['off'])} ({_name(order)})" for order in ("1", "2", "3", "exact"))
        + ". The boundary layer lasts 0.2 ms there; the prediction takes it for nothing beside the tick of 1 ms.",
        f"Not reproduced: instability at 5·10⁻⁵. There the firmware tracks to {length_text(at_paper.error_m)}, even "
        "with the bounds off; at the paper's own speeds, five times lower and more, the prediction is higher still.",
        "With the bounds on no run is lost, up to the end of the grid, but none of the series is quiet past its ε*: "
        "the torque flips between the bounds. Of the six only the observer has no ε* on this grid.",
    ]


def _at_end(simulator: Simulator, bounds: dict[str, tuple[tuple[str, str], ...]]) -> dict[str, list[str]]:
    """Return the largest error at the grid's end, with the bounds off and on, as texts by order."""

    def text(outcome: Outcome) -> str:
        return length_text(outcome.error_m) if outcome.status is Status.COMPLETED else "lost"

    end = float(GRID[-1])
    return {order: [text(simulator.run(case_of(order, end, bounds[name]))) for name in bounds] for order in ORDERS}


def _table(found: dict[str, dict[str, float]], at_end: dict[str, list[str]]) -> Table:
    rows = [[_name(order), "5·10⁻⁵" if order == "1" else "–"] for order in ORDERS]
    for row, order in zip(rows, ORDERS, strict=True):
        row.extend([_text(found[order][bounds]) for bounds in ("off", "on")] + at_end[order])
    head = ["", "paper ε*", "our ε*, bounds off", "our ε*, bounds on"]
    head += [f"error at ε = {GRID[-1]:g}, bounds {bounds}" for bounds in ("off", "on")]
    return Table("ε* (1/N) at 0.5 m/s, and the largest tracking error at the grid's end", head, rows)


def _numbers(found: dict[str, dict[str, float]], predicted: float, at_paper: Outcome) -> dict[str, Any]:
    """Return plain values; null: all of the grid tracks."""
    return {
        "paper_epsilon_star": EPSILON_STAR,
        "predicted_epsilon_star": predicted,
        "grid": {"lowest": float(GRID[0]), "highest": float(GRID[-1]), "points": len(GRID)},
        "speed_m_per_s": SPEED_m_per_s,
        "epsilon_star": {
            order: {f"bounds_{name}": None if math.isinf(value) else value for name, value in both.items()}
            for order, both in found.items()
        },
        "max_error_at_paper_epsilon_star_m": at_paper.error_m,
    }


def _found_panel(found: dict[str, dict[str, float]], predicted: float) -> Panel:
    """Draw ε* of each order between the paper's and the prediction."""
    drawn: list[Drawn] = []
    for bounds, shift, symbol, style in (("off", -0.15, "circle", STYLES[0]), ("on", 0.15, "square", STYLES[1])):
        values = np.array([found[order][bounds] for order in ORDERS])
        symbols = ["triangle-right" if math.isinf(value) else symbol for value in values]
        shown, rows = np.minimum(values, GRID[-1]), [place + shift for place in range(len(ORDERS))]
        dots = points(shown, rows, f"bounds {bounds}", style._replace(width_px=0.0), symbol)
        dots["marker"] = {**dots["marker"], "symbol": symbols}
        drawn.append(dots | {"hovertemplate": f"bounds {bounds}: %{{x:.3g}} 1/N<extra></extra>"})
    names = {float(place): _name(order) for place, order in enumerate(ORDERS)}
    return Panel(
        "Largest ε that tracks, at 0.5 m/s around the rounded corner (1/N)",
        drawn,
        Axis("ε (1/N)", (2e-5, 0.6), log=True),
        Axis(view=(len(ORDERS) - 0.5, -0.5), ticks=names),
        [
            upright(EPSILON_STAR, "paper", Style("--ink", "dot")),
            upright(predicted, "predicted for the series", REFERENCE._replace(width_px=3.0)),
        ],
    )


def _shown(simulator: Simulator, bounds: dict[str, tuple[tuple[str, str], ...]]) -> list[tuple[str, Outcome, Style]]:
    """Run what the second figure shows: label, outcome and style."""
    past = f"ε = {SHOWN_EPSILON:g}"
    return [
        (
            f"exact, {past}, bounds off",
            simulator.run(case_of("exact", SHOWN_EPSILON, bounds["off"])),
            STYLES[1]._replace(dash="solid"),
        ),
        (f"exact, {past}, bounds on", simulator.run(case_of("exact", SHOWN_EPSILON, bounds["on"])), STYLES[0]),
        (f"observer, {past}", simulator.run(case_of("observer", SHOWN_EPSILON, bounds["on"])), STYLES[2]),
        (
            "order 1, ε = 5·10⁻⁵",
            simulator.run(case_of("1", EPSILON_STAR, bounds["off"])),
            Style("--ink", "dot", 2.0),
        ),
    ]


def _run_panels(shown: list[tuple[str, Outcome, Style]]) -> list[Panel]:
    """Draw the runs from above, and their errors over time."""
    half = RHOMBUS_DIAGONAL_M / 2.0
    above = [line([half, 0.0, -half], [0.0, half, 0.0], "path", REFERENCE)]
    errors: list[Drawn] = []
    for label, outcome, style in shown:
        trace, error_mm = outcome.trace, 1e3 * tracking_error(outcome.trace)
        rows = np.unique(np.linspace(0, len(trace) - 1, 2000).astype(int))
        above.append(line(trace.point[rows, 0], trace.point[rows, 1], label, style))
        errors.append(curve(trace.time_s, error_mm, label, style))
        if outcome.status is not Status.COMPLETED:
            lost = style._replace(width_px=0.0)
            errors.append(points(trace.time_s[-1:], error_mm[-1:], label, lost, "x") | {"hoverinfo": "skip"})
    return [
        Panel(
            "Path from above (m)",
            above,
            Axis("x1 (m)", (-1.6, 0.8)),
            Axis("x2 (m)", (half - 1.4, half + 1.0)),
            equal=True,
            height_px=400,
        ),
        Panel(
            "Tracking error (mm); ×: lost",
            errors,
            Axis("time (s); the corner is at 0.5 s"),
            Axis(log=True, unit="mm", view=(3e-3, 1e4)),
            [level(1e3 * ERROR_LIMIT_m, f"tracking is below {1e3 * ERROR_LIMIT_m:g} mm")],
            height_px=400,
        ),
    ]
