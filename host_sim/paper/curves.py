"""Fig. 2: the traction curves (4) and (5)."""

from typing import Any

import numpy as np

from host_sim.paper import published
from host_sim.paper.section import Section, Table
from host_sim.paper.simulate import Simulator
from host_sim.report.figure import ACTUAL, STYLES, Axis, Figure, Panel, level, line
from host_sim.robot import Array

DRAWN_END_N = 2500.0


def fig2(simulator: Simulator) -> Section:  # noqa: ARG001  # all items are called alike
    """Draw both curves with the paper's constants."""
    limit_deg = float(np.rad2deg(published.LINEAR_LIMIT))
    at_limit = np.array([published.LINEAR_LIMIT])
    longitudinal_N = float(published.longitudinal_force_N(at_limit)[0])
    lateral_N = float(published.lateral_force_N(np.array([limit_deg]))[0])
    linear_N = published.longitudinal_stiffness_N() * published.LINEAR_LIMIT
    linear_lateral_N = published.lateral_stiffness_N() * limit_deg
    rows = [
        ["peak of the curve", "2193 N (Dy)", "1936 N (Dx)"],
        ["end of the printed axis", "2000 N", "2500 N"],
        [
            "the curve at the limit of Assumption 1",
            f"{longitudinal_N:.0f} N at s = 0.1",
            f"{lateral_N:.0f} N at 0.1 rad",
        ],
        ["the line (7), (6) there", f"{linear_N:.0f} N", f"{linear_lateral_N:.0f} N"],
    ]
    caption = "Both curves at FN = 2000 N with the paper's constants, and the lines (7) and (6) of their slope at 0."
    return Section(
        title="Fig. 2: traction curves (4) and (5)",
        paper="Fy and Fx at FN = 2000 N",
        ours="the same curves; the printed axes fit the other curve each",
        remarks=[
            "The abscissa of (a) is 100 s, slip in per cent, that of (b) the slip angle in degrees: only so do the "
            "printed constants turn within ±15.",
            "The peak of (4) is 2193 N, above the end of its printed axis, 2000 N; the peak of (5) is 1936 N, well "
            "below its printed 2500 N: the axes of the two panels seem exchanged. Both are drawn to ±2500 N here.",
            f"At the limit of Assumption 1, |s| = 0.1, the line (7) is {linear_N / longitudinal_N:.1f} times above the "
            "curve: with these constants the linear region ends near |s| = 0.02.",
            "The robot weighs 1.9 kg and carries 6.2 N a wheel, not 2000 N. Where the other items say magic formula, "
            "it is (4) with its own B and D: slope 1/ε at zero slip, peak 5 N.",
        ],
        tables=[Table("Numbers of Fig. 2", ["", "(4), Fy", "(5), Fx"], rows)],
        figures=[Figure("fig2-curves", caption, _panels(), wide=True)],
        numbers={"fig2": _numbers()},
    )


def _abscissa(points: int) -> Array:
    return np.linspace(-published.ABSCISSA_END, published.ABSCISSA_END, points)


def _numbers() -> dict[str, Any]:
    """Both curves at whole numbers of their abscissa."""
    abscissa = _abscissa(31)
    return {
        "slip_percent": abscissa.tolist(),
        "longitudinal_force_N": published.longitudinal_force_N(abscissa / 100.0).tolist(),
        "slip_angle_deg": abscissa.tolist(),
        "lateral_force_N": published.lateral_force_N(abscissa).tolist(),
    }


def _panels() -> list[Panel]:
    """Draw both curves between the ends of their printed axes."""
    x = _abscissa(601)
    slip = published.longitudinal_force_N(x / 100.0)
    angle = published.lateral_force_N(x)
    return [
        _panel(
            "(a) Longitudinal force Fy of (4) (N)",
            "100 s (%)",
            slip,
            published.longitudinal_stiffness_N() / 100.0,
            published.LONGITUDINAL_AXIS_END_N,
        ),
        _panel(
            "(b) Transversal force Fx of (5) (N)",
            "slip angle δx (degrees)",
            angle,
            published.lateral_stiffness_N(),
            published.LATERAL_AXIS_END_N,
        ),
    ]


def _panel(title: str, abscissa: str, force_N: Array, slope: float, printed_end_N: float) -> Panel:
    """Draw a curve, the line of its slope at 0, and the ends of the axis as printed."""
    x = _abscissa(len(force_N))
    end = published.ABSCISSA_END
    return Panel(
        title,
        [line(x, force_N, "the curve", ACTUAL), line(x, slope * x, "its slope at 0", STYLES[1])],
        Axis(abscissa, (-end, end)),
        Axis(view=(-1.05 * DRAWN_END_N, 1.05 * DRAWN_END_N), unit="N"),
        [level(printed_end_N, f"end of the printed axis, {printed_end_N:g} N"), level(-printed_end_N)],
    )
