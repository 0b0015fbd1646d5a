#!/usr/bin/env python3
"""Write the coefficients a1 … a72 of the paper's (9)-(10) in closed form: generate_coefficients.py [FILE] [--check].

They are derived from M, S(θ), A(θ) and B alone (errata: firmware/control/THEORY.md): q̇ = S v + A w with w = ε µ goes
into M q̈ = B u + A λ, which is premultiplied by [S A]ᵀ and solved for v̇ and ẇ. With --check nothing is written, and a
file that is not the one derived fails.
"""

import argparse
import re
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import sympy as sp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from host_sim.robot import ROOT, Robot, load_robot

DOCUMENT = ROOT / "firmware" / "control" / "COEFFICIENTS.md"

# The matrices in the order of their coefficients, nine each, row by row; the paper has B3 before B2, C3 before C2.
NAMES = ("B0", "B1", "B3", "B2", "C0", "C1", "C3", "C2")
HEADINGS = {
    "B0": "B0, lower three rows: v̇ = … + B0 v",
    "B1": "B1, lower three rows: v̇ = … + ε B1 µ",
    "B3": "B3, lower three rows: v̇ = … + B3 u",
    "B2": "B2, lower three rows: v̇ = … + B2 µ",
    "C0": "C0: ε µ̇ = … + C0 v",
    "C1": "C1: ε µ̇ = … + ε C1 µ",
    "C3": "C3: ε µ̇ = … + C3 u",
    "C2": "C2: ε µ̇ = … + C2 µ",
}

m, Ic, Iw, b, r, G0, Vd = sp.symbols("m Ic Iw b r G0 Vd", positive=True)
P, Q = sp.symbols("P Q", positive=True)
v1, v2, v3 = sp.symbols("v1 v2 v3", real=True)
mu1, mu2, mu3 = sp.symbols("mu1 mu2 mu3", real=True)

ARGUMENTS = (m, Ic, Iw, b, r, G0, Vd, v1, v2, v3)
SHORTHANDS = {P: 2 * r**2 + 3, Q: 3 * b**2 + r**2}
V, MU = sp.Matrix([v1, v2, v3]), sp.Matrix([mu1, mu2, mu3])

# Where the document evaluates: v1, v2, v3, V + δ.
STATE = (0.3, 0.2, 0.5, 0.5)


@dataclass(frozen=True)
class Coefficients:
    """Matrices of (9)-(10), 3x3 each by name; ``missing_*`` is what is quadratic in µ: v̇ and ε µ̇ over ε²."""

    matrices: dict[str, sp.Matrix]
    missing_v: sp.Matrix
    missing_mu: sp.Matrix

    @property
    def entries(self) -> list[sp.Expr]:
        """The coefficients a1 … a72, first one at 0."""
        return [entry for name in NAMES for entry in self.matrices[name]]


# ------------------------------------------------------------------------------------------------------ Derivation


def matrix_s(theta: sp.Symbol) -> sp.Matrix:
    """Return S of (2), 6x3: the body frame is turned by +θ."""
    c, s, h = sp.cos(theta), sp.sin(theta), sp.sqrt(3) / 2
    body = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    wheels = [[-h / r, 1 / (2 * r), b / r], [0, -1 / r, b / r], [h / r, 1 / (2 * r), b / r]]
    return sp.Matrix(body + wheels)


def matrix_a(theta: sp.Symbol) -> sp.Matrix:
    """Return A of (1), 6x3: sin α of wheel 1, and −r."""
    angles = (theta - 2 * sp.pi / 3, theta, theta + 2 * sp.pi / 3)
    rows = [[sp.sin(x) for x in angles], [-sp.cos(x) for x in angles], [b, b, b]]
    return sp.Matrix(rows).applyfunc(sp.expand_trig).col_join(-r * sp.eye(3))


def without_heading(matrix: sp.Matrix, theta: sp.Symbol) -> sp.Matrix:
    """Reduce sin²θ + cos²θ in entries of second degree in them; a heading that is left over is an error."""

    def reduced(entry: sp.Expr) -> sp.Expr:
        return sp.expand(sp.expand(entry).subs(sp.sin(theta) ** 2, 1 - sp.cos(theta) ** 2))

    result = matrix.applyfunc(reduced)
    if result.has(theta):
        raise AssertionError("the model in the body frame depends on the heading")
    return result


def factored(matrix: sp.Matrix) -> sp.Matrix:
    """Return the matrix with every entry a single factored fraction."""
    return matrix.applyfunc(sp.factor)


def inverse(mass: sp.Matrix) -> sp.Matrix:
    """Invert the symmetric 6x6 mass matrix by blocks; the first is diagonal, what is left of the last free of roots."""
    first, off, last = mass[:3, :3], mass[:3, 3:], mass[3:, 3:]
    if not first.is_diagonal():
        raise AssertionError("Sᵀ M S is not diagonal")
    top = sp.diag(*[1 / first[i, i] for i in range(3)])
    rest = factored(last - off.T * top * off)
    low = factored(rest.to_DM().to_field().inv().to_Matrix())
    side = factored(-top * off * low)
    return factored(top - side * off.T * top).row_join(side).col_join(side.T.row_join(low))


@cache
def derive() -> Coefficients:
    """Solve M q̈ = B u + A λ for v̇ and ẇ, w = ε µ, and collect."""
    theta, rate = sp.symbols("theta rate", real=True)
    s, a = matrix_s(theta), matrix_a(theta)
    mass = sp.diag(m, m, Ic, Iw, Iw, Iw)
    both = s.row_join(a)
    projected = both.T * mass
    inverse_mass = inverse(without_heading(projected * both, theta))

    def accelerations(force: sp.Matrix) -> sp.Matrix:
        return factored(inverse_mass * force)

    # q̈ = S v̇ + A ẇ + (S' v + A' w) θ̇, and θ̇ is the third row of q̇ = S v + A w: v3 + b (w1 + w2 + w3).
    turning_s = without_heading(projected * s.diff(theta), theta) * rate
    turning_a = without_heading(projected * a.diff(theta), theta) * rate
    of_v, of_mu = s[2, :] * V, a[2, :] * MU
    gamma = without_heading(a.T * a, theta)
    product = {
        "0": accelerations(-turning_s.subs(rate, of_v[0])),
        "1": accelerations(-turning_a.subs(rate, of_v[0]) - turning_s.subs(rate, 1) * V * a[2, :]),
        "2": accelerations(-(G0 / Vd) * without_heading(both.T * a, theta) * gamma),
        "3": accelerations(without_heading(both.T * sp.zeros(3, 3).col_join(sp.eye(3)), theta)),
    }
    missing = accelerations(-turning_a.subs(rate, of_mu[0]) * MU)
    matrices = {name: product[name[1]][:3, :] if name[0] == "B" else product[name[1]][3:, :] for name in NAMES}
    return Coefficients(matrices, missing[:3, :], missing[3:, :])


# -------------------------------------------------------------------------------------------------------- Document


def closed_form(expression: sp.Expr, as_sum: bool = False) -> str:
    """Return an expression as text: factored with P and Q, or as a sum behind G0/Vd."""
    names = {value: name for name, value in SHORTHANDS.items()}
    forms = [expression.replace(lambda part: part in names, lambda part: names[part])]
    if as_sum:
        forms = [ratio * sp.expand(expression / ratio) for ratio in (G0 / Vd, -G0 / Vd)]
    return min((plain(sp.sstr(form)) for form in forms), key=lambda text: (len(text), text.count("−")))


def plain(text: str) -> str:
    """Return sympy's notation as the document writes it."""
    for old, new in (("**2", "²"), ("sqrt(3)", "√3"), ("mu", "µ"), ("*", "·"), ("-", "−")):
        text = text.replace(old, new)
    return re.sub(r"\(−([^()+−]+) \+ ([^()+−]+)\)", r"(\2 − \1)", text)  # (−x + y) is (y − x)


def numbers(robot: Robot) -> tuple[float, ...]:
    """Return the values of ``ARGUMENTS`` of a robot, at ``STATE``."""
    planar, _, turn = (float(x) for x in robot.Mo)
    wheel = (robot.wheel_inertia_kg_m2, robot.wheel_distance_m, robot.wheel_radius_m, robot.normalised_stiffness_N)
    *velocity, speed = STATE
    return (planar, turn, *wheel, speed, *velocity)


def table(rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table; the first row is its head."""
    lines = [rows[0], ("---",) * len(rows[0]), *rows[1:]]
    return "".join("| " + " | ".join(cells) + " |\n" for cells in lines)


def matrix_table(name: str, first: int, matrix: sp.Matrix, values: dict[sp.Symbol, float]) -> str:
    """Return the rows of one matrix, its first coefficient being a``first``."""
    rows: list[tuple[str, ...]] = [("a", "entry", "closed form", "value")]
    as_sum = name == "C2"  # one part for each inertia
    for place, entry in enumerate(matrix):
        value = f"{float(entry.subs(values)):.6g}".replace("-", "−")
        rows.append(
            (f"a{first + place}", f"{name}[{place // 3 + 1},{place % 3 + 1}]", closed_form(entry, as_sum), value)
        )
    return table(rows)


PREFACE = """\
# The coefficients a1 … a72

Written by `tools/generate_coefficients.py`; do not edit. The paper leaves the entries of the matrices in (9)-(10)

    v̇ = B0 v + (ε B1 + B2) µ + B3 u          q̇ = S v + ε A µ
    ε µ̇ = C0 v + (ε C1 + C2) µ + C3 u

open. Here they are, derived from M, S(θ), A(θ) and B with the signs of `THEORY.md`:

    q̈ = S v̇ + ε A µ̇ + θ̇ (∂S/∂θ v + ε ∂A/∂θ µ)          λ = −(G0/Vd) Γ µ,   Γ = AᵀA

go into M q̈ = B u + A λ; premultiplied by [S A]ᵀ it is solved for v̇ and ε µ̇. The heading drops out.

The heading rate is θ̇ = v3 + ε b (µ1 + µ2 + µ3). Products of velocities are therefore of three kinds:

- v3 times v stands in B0 and C0; the factor v3 is the one in the matrix, so that their third columns are 0;
- v3 times ε µ, and b (µ1 + µ2 + µ3) ε times v, both linear in ε µ, stand in B1 and C1;
- b (µ1 + µ2 + µ3) ε times ε µ is what the form (9)-(10) has no place for; it is given at the end.

Symbols: Vd = V + δ, P = {P}, Q = {Q}; m, Ic, Iw, b, r, G0 as in `firmware/robot/omnibot.toml`. The
determinant of [S A]ᵀ M [S A] is m²·Ic·Iw³·P⁴·Q²/(16·r⁶). P adds a number and a length squared because S and A, as the
paper has them, mix metres and radians.

The last column holds the robot's numbers at v = ({state}), Vd = {speed}, in SI units.
"""

EIGENVALUES = """\
C2's eigenvalues, those of the boundary layer (18), are −(G0/Vd)·(3/(2·m) + r²/Iw), twice, and
−(G0/Vd)·(3·b²/Ic + r²/Iw): −(G0/Vd) times {planar:.4f} and {turn:.4f}.
"""


def document(coefficients: Coefficients, robot: Robot) -> str:
    """Return COEFFICIENTS.md."""
    values = dict(zip(ARGUMENTS, numbers(robot), strict=True))
    *velocity, speed = STATE
    shorthands = {str(name): plain(sp.sstr(value)) for name, value in SHORTHANDS.items()}
    parts = [PREFACE.format(**shorthands, state=", ".join(map(str, velocity)), speed=speed)]
    for place, name in enumerate(NAMES):
        rows = matrix_table(name, 9 * place + 1, coefficients.matrices[name], values)
        parts.append(f"## {HEADINGS[name]}\n\n{rows}")
    rolling = robot.wheel_radius_m**2 / robot.wheel_inertia_kg_m2
    planar = 1.5 / robot.mass_kg + rolling
    turn = 3.0 * robot.wheel_distance_m**2 / robot.yaw_inertia_kg_m2 + rolling
    parts.append(EIGENVALUES.format(planar=planar, turn=turn))
    missing: list[tuple[str, ...]] = [("term over ε²", "closed form")]
    missing += [(f"v̇{i + 1}", closed_form(x)) for i, x in enumerate(coefficients.missing_v)]
    missing += [(f"ε µ̇{i + 1}", closed_form(x)) for i, x in enumerate(coefficients.missing_mu)]
    parts.append(
        "## What (9)-(10) leave out\n\n"
        "Quadratic in ε µ. The simulated robot has it, the controller has it from order 1 on.\n\n" + table(missing)
    )
    return "\n".join(parts)


def main(arguments: list[str] | None = None) -> None:
    """Write the document, or check it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?", default=DOCUMENT, help="Markdown file; default: %(default)s")
    parser.add_argument("--check", action="store_true", help="write nothing; fail when the file is stale")
    options = parser.parse_args(arguments)
    text = document(derive(), load_robot())
    if not options.check:
        options.file.write_text(text, encoding="utf-8")
    elif not options.file.exists() or options.file.read_text(encoding="utf-8") != text:
        sys.exit(f"{options.file}: stale; tools/generate_coefficients.py")


if __name__ == "__main__":
    main()
