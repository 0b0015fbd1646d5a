"""Fig. 4: the fast variable µ around the first corner."""

from typing import Any

import numpy as np

from host_sim.paper.published import FLEXIBLE_EPSILON, DURATION_s, MU_RANGES_m_per_s, SPEEDS_m_per_s
from host_sim.paper.section import Section, Table, figure_text
from host_sim.paper.simulate import Case, Outcome, Simulator
from host_sim.report.figure import STYLES, Axis, Figure, Panel, curve, line, points
from host_sim.robot import Array, Robot
from host_sim.trace import Trace

SPEED_m_per_s = SPEEDS_m_per_s[-1]
CORNERS = ("sharp", "rounded")
MU_RESOLUTION_m_per_s = 2e-4  # of the wire


def fig4(simulator: Simulator) -> Section:
    """Follow µ at the paper's fastest speed, around both kinds of corner."""
    outcomes = {corner: simulator.run(_case(corner)) for corner in CORNERS}
    mu = {corner: _shown(outcome.trace, outcome.trace.mu) for corner, outcome in outcomes.items()}
    final = {corner: float(np.linalg.norm(rows[-1])) for corner, rows in mu.items()}
    gap = _gap(simulator.robot, outcomes["rounded"])
    force_N = implied_force_N(simulator.robot)
    ranges = {
        corner: [(float(low), float(high)) for low, high in zip(*_extent(rows), strict=True)]
        for corner, rows in mu.items()
    }
    captions = (
        "µ of the firmware, read from its SLIP frames, over time: left the sharp, right the rounded corner.",
        "The paper's curve in space, seen along two of its axes; the cross is µ = 0.",
    )
    return Section(
        title="Fig. 4: the fast variable µ",
        paper="µ1 −50…150, µ2 −200…50, µ3 −0.01…0.005 m/s, ending at 0",
        ours=f"each within ±{max(abs(rows).max() for rows in mu.values()):.2g} m/s, ending at |µ| = "
        f"{_small(final['sharp'])} (sharp), {_small(final['rounded'])} (rounded)",
        remarks=[
            f"The run of Table 1 at {100.0 * SPEED_m_per_s:.2f} cm/s and ε = 4·10⁻¹¹, order 1, over 4.5 s. µ is the "
            "firmware's, in steps of the wire, 2·10⁻⁴ m/s. Around the rounded corner its ε Γ µ is within "
            f"{100.0 * gap:.0f} % of the largest slip velocity of the plant; the rest is the bend of the magic "
            "formula, which the manifold takes for a line.",
            "Reproduced: µ leaves 0 at the corner and returns to it, as Condition 2 asks.",
            "Not reproduced: its size. By λ = −G0 Γ µ/(V+δ) the paper's µ of 150 and −200 m/s stands for wheel forces "
            f"of {figure_text(force_N)} N, on a robot that weighs 19 N; they would suit the tyre of Fig. 2.",
            "Not reproduced: its direction. With the heading at 0, as here, the velocity changes along the drive "
            "direction of wheel 2, and wheels 1 and 3 share alike: the curve in space is a line. The paper's µ3, ten "
            "thousand times smaller than µ1, belongs to another heading, which the paper leaves uncontrolled.",
        ],
        tables=[_table(ranges, final)],
        figures=[
            Figure("fig4-time", captions[0], _time_panels(outcomes), wide=True),
            Figure("fig4-space", captions[1], _space_panels(mu), wide=True),
        ],
        numbers={"fig4": _numbers(ranges, final, force_N)},
    )


def _case(corner: str) -> Case:
    """Return the run; it ends a little after what is shown, so that its braking is not."""
    return Case(SPEED_m_per_s, FLEXIBLE_EPSILON, "1", corner, duration_s=DURATION_s + 0.1)


def _shown(trace: Trace, values: Array) -> Array:
    return values[trace.time_s <= DURATION_s]


def _extent(rows: Array) -> tuple[Array, Array]:
    return rows.min(axis=0), rows.max(axis=0)


def _gamma(robot: Robot) -> Array:
    """Return Γ = Jr Jrᵀ + r² I."""
    return np.asarray(robot.Jr @ robot.Jr.T + robot.wheel_radius_m**2 * np.eye(3))


def _gap(robot: Robot, outcome: Outcome) -> float:
    """Return how far the firmware's Γ µ is from the plant's σ/ε at most, relative to the largest of the latter."""
    trace = outcome.trace
    speed = np.linalg.norm(trace.body_twist, axis=1) + outcome.delta_m_per_s
    plant = _shown(trace, trace.slip_ratio * speed[:, np.newaxis]) / FLEXIBLE_EPSILON
    firmware = _shown(trace, trace.mu) @ _gamma(robot).T
    return float(np.abs(plant - firmware).max() / np.abs(plant).max())


def implied_force_N(robot: Robot) -> float:
    """Return the largest wheel force that µ1 and µ2 at the ends of the paper's axes stand for."""
    mu = np.array([MU_RANGES_m_per_s[0][1], MU_RANGES_m_per_s[1][0], 0.0])
    force = robot.normalised_stiffness_N / SPEED_m_per_s * _gamma(robot) @ mu
    return float(np.abs(force).max())


def _small(value: float) -> str:
    return "below 2·10⁻⁴" if value < 0.9 * MU_RESOLUTION_m_per_s else figure_text(value)


def _table(ranges: dict[str, list[tuple[float, float]]], final: dict[str, float]) -> Table:
    """Ranges beside the paper's."""

    def text(low: float, high: float) -> str:
        return f"{low:.3g} … {high:.3g}".replace("-", "−")

    rows = [
        [f"µ{wheel + 1}", text(*MU_RANGES_m_per_s[wheel]), *(text(*ranges[corner][wheel]) for corner in CORNERS)]
        for wheel in range(3)
    ]
    rows.append(["|µ| at 4.5 s", "0", *(_small(final[corner]) for corner in CORNERS)])
    return Table("Range of µ (m/s)", ["", "paper (axes)", "ours, sharp corner", "ours, rounded corner"], rows)


def _numbers(ranges: dict[str, list[tuple[float, float]]], final: dict[str, float], force_N: float) -> dict[str, Any]:
    return {
        "paper_ranges_m_per_s": [list(pair) for pair in MU_RANGES_m_per_s],
        "ranges_m_per_s": {corner: [list(pair) for pair in pairs] for corner, pairs in ranges.items()},
        "final_m_per_s": final,
        "force_implied_by_paper_N": force_N,
    }


def _time_panels(outcomes: dict[str, Outcome]) -> list[Panel]:
    """Draw µ over time."""
    panels = []
    for corner, outcome in outcomes.items():
        time_s, mu = (_shown(outcome.trace, values) for values in (outcome.trace.time_s, outcome.trace.mu))
        drawn = [
            # µ3 lies on µ1
            curve(time_s, mu[:, k], f"µ{k + 1}", STYLES[k]._replace(width_px=width))
            for k, width in enumerate((4.0, 1.5, 1.5))
        ]
        axis = Axis("time (s); the corner is at 2 s", (1.5, 4.5))
        panels.append(Panel(f"µ, {corner} corner (m/s)", drawn, axis, Axis(unit="m/s"), group="fig4"))
    return panels


def _space_panels(mu: dict[str, Array]) -> list[Panel]:
    """Draw µ2 and µ3 over µ1."""
    panels = []
    for corner, rows in mu.items():
        for other in (1, 2):
            drawn = [
                line(rows[:, 0], rows[:, other], "µ", STYLES[0]),
                points([0.0], [0.0], "0", STYLES[1]._replace(width_px=0.0), "x"),
            ]
            title = f"µ{other + 1} over µ1, {corner} corner (m/s)"
            panels.append(Panel(title, drawn, Axis("µ1 (m/s)"), Axis(f"µ{other + 1} (m/s)"), equal=True))
    return panels
