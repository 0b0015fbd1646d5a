"""The coefficients a1 … a72 of firmware/control/COEFFICIENTS.md against matrices built in numbers.

The oracle knows no symbol: A and S of (1) and (2) at a heading, a 6x6 mass matrix, numpy.linalg.solve. The compact form
of the theory is a second one, and the constants in C are those that the same matrices give.
"""

import importlib.util
import math
import re
import shutil
import struct
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from host_sim.robot import load_robot

Array = NDArray[np.float64]
Matrices = dict[str, Array]

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "generate_coefficients.py"
DOCUMENT = ROOT / "firmware" / "control" / "COEFFICIENTS.md"
CONSTANTS = ROOT / "build" / "host" / "generated" / "robot_constants.c"
LIBRARY = ROOT / "build" / "host" / "libcontrol-visible.so"

ROBOT = load_robot()
STATES = 100
TOLERANCE = 1e-9  # of the largest entry of each matrix
ROUNDING = 1e-11  # of that of the six rows that are solved for together

# The numbering of the paper: nine coefficients each, row by row.
FIRST = {"B0": 1, "B1": 10, "B3": 19, "B2": 28, "C0": 37, "C1": 46, "C3": 55, "C2": 64}


@pytest.fixture(scope="session")
def tool() -> ModuleType:
    """The generator; what it derives is kept in it."""
    if TOOL.stem not in sys.modules:
        spec = importlib.util.spec_from_file_location(TOOL.stem, TOOL)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[TOOL.stem] = module
        spec.loader.exec_module(module)
    return sys.modules[TOOL.stem]


@pytest.fixture(scope="session")
def derived(tool: ModuleType) -> Any:
    return tool.derive()


# ------------------------------------------------------------------------------------------------------ random states


class Case:
    """Numbers for every symbol: a robot, a velocity, a fast variable, a torque, a heading."""

    def __init__(self, random: np.random.Generator, real_robot: bool) -> None:
        self.m, self.Ic = ROBOT.mass_kg, ROBOT.yaw_inertia_kg_m2
        self.Iw, self.b, self.r = ROBOT.wheel_inertia_kg_m2, ROBOT.wheel_distance_m, ROBOT.wheel_radius_m
        self.G0 = ROBOT.normalised_stiffness_N
        if not real_robot:
            self.m, self.Ic, self.Iw, self.b, self.r, self.G0 = (float(x) for x in random.uniform(0.1, 2.0, 6))
        self.Vd = float(10.0 ** random.uniform(-3.0, 0.5))
        self.v = random.uniform(-1.0, 1.0, 3) * [1.5, 1.5, 4.0]
        self.w = random.uniform(-1.0, 1.0, 3)
        self.u = random.uniform(-0.2, 0.2, 3)
        self.theta = float(random.uniform(-np.pi, np.pi))

    @property
    def symbols(self) -> dict[str, float]:
        velocity = {f"v{i + 1}": float(x) for i, x in enumerate(self.v)}
        return {name: getattr(self, name) for name in ("m", "Ic", "Iw", "b", "r", "G0", "Vd")} | velocity

    @property
    def mass(self) -> Array:
        return np.diag([self.m, self.m, self.Ic, self.Iw, self.Iw, self.Iw])

    def a(self, theta: complex) -> NDArray[Any]:
        """A of (1), corrected."""
        angles = theta + np.array([-2.0, 0.0, 2.0]) * np.pi / 3.0
        return np.vstack([np.sin(angles), -np.cos(angles), np.full(3, self.b), -self.r * np.eye(3)])

    def s(self, theta: complex) -> NDArray[Any]:
        """S of (2), corrected."""
        c, s = np.cos(theta), np.sin(theta)
        return np.vstack([[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], self.jr / self.r])

    @property
    def jr(self) -> Array:
        """Drive directions: of wheel i at −120°, 0°, 120° behind the second body axis."""
        h = math.sqrt(0.75)
        return np.array([[-h, 0.5, self.b], [0.0, -1.0, self.b], [h, 0.5, self.b]])

    def slope(self, matrix: str) -> Array:
        """Derivative of A or S by the heading: a complex step, exact to rounding."""
        stepped: Array = np.imag(getattr(self, matrix)(self.theta + 1e-20j)) / 1e-20
        return stepped


def literal(case: Case) -> Matrices:
    """The eight matrices: M q'' = B u + A lambda premultiplied by [S A]', one column after the other."""
    a, s, mass = case.a(case.theta), case.s(case.theta), case.mass
    a_slope, s_slope = case.slope("a"), case.slope("s")
    both = np.hstack([s, a])
    heading_of_v, heading_of_w = s[2], a[2]
    forces = {
        "0": -mass @ s_slope * (heading_of_v @ case.v),
        "1": -mass @ (a_slope * (heading_of_v @ case.v) + np.outer(s_slope @ case.v, heading_of_w)),
        "2": -case.G0 / case.Vd * a @ (a.T @ a),
        "3": np.vstack([np.zeros((3, 3)), np.eye(3)]),
    }
    matrices = {}
    for index, force in forces.items():
        solved = np.linalg.solve(both.T @ mass @ both, both.T @ force)
        matrices[f"B{index}"], matrices[f"C{index}"] = solved[:3], solved[3:]
    return matrices


def compact(case: Case) -> Matrices:
    """The same in the body frame: Mv = Mo + Iw J'J, Omega and the blocks of the inverse mass matrix."""
    jr, mo = case.jr, np.diag([case.m, case.m, case.Ic])
    j, unit = jr / case.r, np.eye(3)
    gamma = jr @ jr.T + case.r**2 * unit
    mixed = (mo - case.Iw * unit) @ jr.T
    mass = np.block([[mo + case.Iw * j.T @ j, mixed], [mixed.T, jr @ mo @ jr.T + case.r**2 * case.Iw * unit]])
    inverse = np.linalg.inv(mass)
    quarter_turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    omega = case.v[2] * quarter_turn
    omega_of_mu = omega @ jr.T + np.outer(quarter_turn @ case.v, np.full(3, case.b))
    matrices = {}
    for name, left, right in (("B", inverse[:3, :3], inverse[:3, 3:]), ("C", inverse[3:, :3], inverse[3:, 3:])):
        matrices[f"{name}0"] = -(left + right @ jr) @ mo @ omega
        matrices[f"{name}1"] = -(left + right @ jr) @ mo @ omega_of_mu
        matrices[f"{name}2"] = -case.G0 / case.Vd * right @ gamma @ gamma
        matrices[f"{name}3"] = left @ j.T - case.r * right
    return matrices


@pytest.fixture(scope="session")
def cases() -> list[Case]:
    random = np.random.default_rng(2014)
    return [Case(random, real_robot=i % 2 == 0) for i in range(STATES)]


# -------------------------------------------------------------------------------------------------- the two candidates


class ClosedForms:
    """a1 … a72 as functions of the symbols: compiled from the derivation, or read out of the document."""

    def __init__(self, entries: list[Any]) -> None:
        self.entries = entries

    def matrices(self, case: Case) -> Matrices:
        values = [float(entry(**case.symbols)) for entry in self.entries]
        return {name: np.reshape(values[first - 1 : first + 8], (3, 3)) for name, first in FIRST.items()}


def rows_of_document() -> list[tuple[int, str, str, float]]:
    """Number, entry, closed form and value of each row."""
    pattern = re.compile(r"^\| a(\d+) \| (\S+) \| (.+) \| (\S+) \|$", re.MULTILINE)
    text = DOCUMENT.read_text(encoding="utf-8").replace("−", "-")
    return [(int(number), entry, form, float(value)) for number, entry, form, value in pattern.findall(text)]


def as_function(form: str) -> Any:
    """Make a function of a closed form of the document."""
    code = form.replace("·", "*").replace("²", "**2").replace("√3", "3**0.5")
    compiled = compile(code, form, "eval")

    def value(**symbols: float) -> float:
        b, r = symbols["b"], symbols["r"]
        return float(eval(compiled, {"P": 2.0 * r**2 + 3.0, "Q": 3.0 * b**2 + r**2}, symbols))

    return value


@pytest.fixture(scope="session", params=["derivation", "document"])
def forms(request: pytest.FixtureRequest, tool: ModuleType, derived: Any) -> ClosedForms:
    if request.param == "document":
        return ClosedForms([as_function(form) for _, _, form, _ in rows_of_document()])
    return ClosedForms([sp.lambdify(tool.ARGUMENTS, entry) for entry in derived.entries])


def assert_same(actual: Matrices, expected: Matrices) -> None:
    assert actual.keys() == expected.keys()
    for name, matrix in expected.items():
        # B0 and B1 are what is left of numbers of the size of C0 and C1, solved for with a matrix of condition 2e5.
        solved = max(np.max(np.abs(expected[half + name[1]])) for half in "BC")
        size = np.max(np.abs(matrix))
        np.testing.assert_allclose(
            actual[name], matrix, rtol=0.0, atol=TOLERANCE * size + ROUNDING * solved, err_msg=name
        )


# --------------------------------------------------------------------------------------------------------------- tests


def test_document_numbers_every_coefficient_as_the_paper_does() -> None:
    places = [f"{name}[{i},{j}]" for name in FIRST for i in (1, 2, 3) for j in (1, 2, 3)]

    assert [(number, entry) for number, entry, _, _ in rows_of_document()] == list(enumerate(places, start=1))


def test_closed_forms_are_the_literal_matrices(forms: ClosedForms, cases: list[Case]) -> None:
    for case in cases:
        assert_same(forms.matrices(case), literal(case))


def test_closed_forms_are_the_compact_form_of_the_theory(forms: ClosedForms, cases: list[Case]) -> None:
    for case in cases:
        assert_same(forms.matrices(case), compact(case))


def test_values_of_the_document_are_those_of_the_robot(tool: ModuleType) -> None:
    case = Case(np.random.default_rng(0), real_robot=True)
    *velocity, case.Vd = tool.STATE
    case.v = np.array(velocity)
    expected = literal(case)

    for number, entry, _, value in rows_of_document():
        name, i, j = entry[:2], int(entry[3]) - 1, int(entry[5]) - 1
        size = float(np.max(np.abs(expected[name])))
        assert value == pytest.approx(expected[name][i, j], rel=1e-5, abs=1e-8 * size), number


def test_with_the_missing_terms_they_are_newtons_law(
    tool: ModuleType, derived: Any, forms: ClosedForms, cases: list[Case]
) -> None:
    """M q'' = B u + A lambda itself, q'' a complex step of q' = S v + A w along the motion: nothing premultiplied."""
    fast = (tool.mu1, tool.mu2, tool.mu3)
    missing = sp.lambdify((*tool.ARGUMENTS, *fast), derived.missing_v.col_join(derived.missing_mu))
    needed = 0.0
    for case in cases:
        x = forms.matrices(case)
        v, w, u = case.v, case.w, case.u
        # w = ε µ, so that ε B1 µ is B1 w; with ε = 1 the rest of µ's factors is 1 too.
        quadratic = np.ravel(missing(*case.symbols.values(), *w))
        v_rate = x["B0"] @ v + (x["B1"] + x["B2"]) @ w + x["B3"] @ u + quadratic[:3]
        w_rate = x["C0"] @ v + (x["C1"] + x["C2"]) @ w + x["C3"] @ u + quadratic[3:]
        a, s = case.a(case.theta), case.s(case.theta)
        step = 1e-20j
        later = case.theta + step * (s @ v + a @ w)[2]
        q_rate = case.s(later) @ (v + step * v_rate) + case.a(later) @ (w + step * w_rate)

        force = case.mass @ np.imag(q_rate) / 1e-20
        traction = -case.G0 / case.Vd * a @ (a.T @ a @ w)

        wheels = np.concatenate([np.zeros(3), u])
        size = np.max(np.abs(traction)) + np.max(np.abs(wheels))
        np.testing.assert_allclose(force, wheels + traction, rtol=0.0, atol=1e-9 * size)
        needed = max(needed, float(np.max(np.abs(case.mass @ np.hstack([s, a]) @ quadratic))) / size)
    assert needed > 1e-3  # without them it would not hold


# ------------------------------------------------------------------------------------------------------ constants in C


def numbers(field: str) -> Array:
    """The numbers of a field of the generated C, as single precision has them."""
    assert CONSTANTS.exists(), "cmake --preset host && cmake --build --preset host"
    found = re.search(rf"\.{field} = (\{{.*?\}}|\S+),", CONSTANTS.read_text(encoding="utf-8"))
    assert found, field
    texts = found[1].strip("{}").split(", ")
    return np.array([float(text.rstrip("f")) for text in texts], dtype=np.float32).astype(np.float64)


def of_body(field: str) -> Array:
    """The matrix from the body to the wheels that a wheel_map_t stands for: rows are drive directions, scaled."""
    ahead, side, turn = numbers(field)
    return np.array([[-ahead, side, turn], [0.0, -2.0 * side, turn], [ahead, side, turn]])


def gamma_inverse() -> Array:
    """The matrix that the two numbers of it stand for."""
    of_difference, of_sum = numbers("slip_mobility_inverse")
    return np.diag(3 * [of_difference]) + of_sum


# Of each constant: the fields of robot_t that hold it, and the matrix that they stand for.
IN_C = {
    "J": (("wheel_rate_of_twist",), lambda: of_body("wheel_rate_of_twist")),
    "Iw J": (("inertia_torque_of_accel",), lambda: of_body("inertia_torque_of_accel")),
    "J^-1": (("twist_of_wheel_rate",), lambda: of_body("twist_of_wheel_rate").T),
    "Jr^-1": (("twist_of_contact_speed",), lambda: of_body("twist_of_contact_speed").T),
    "Gamma^-1": (("slip_mobility_inverse",), gamma_inverse),
    "Lambda": (("wheel_force_of_specific",), lambda: of_body("wheel_force_of_specific")),
    "Jr^-1 Lambda": (("slip_mass",), lambda: np.diag(numbers("slip_mass"))),
}


def expected_constants(case: Case) -> Matrices:
    """What they must be, from S and A alone."""
    j = case.s(0.0)[3:]
    gamma = case.a(case.theta).T @ case.a(case.theta)
    from_contact = np.linalg.inv(j * case.r)
    rolling = from_contact.T @ case.mass[:3, :3]
    return {
        "J": j,
        "Iw J": case.Iw * j,
        "J^-1": np.linalg.inv(j),
        "Jr^-1": from_contact,
        "Gamma^-1": np.linalg.inv(gamma),
        "Lambda": rolling,
        "Jr^-1 Lambda": from_contact @ rolling,
    }


@pytest.mark.parametrize("name", IN_C)
def test_constants_in_c_are_those_of_the_same_matrices(name: str) -> None:
    expected = expected_constants(Case(np.random.default_rng(1), real_robot=True))[name]
    fields, matrix = IN_C[name]

    np.testing.assert_allclose(matrix(), expected, rtol=0.0, atol=1.2e-7 * np.max(np.abs(expected)))
    library = LIBRARY.read_bytes()
    for values in map(numbers, fields):
        assert struct.pack(f"<{len(values)}f", *values) in library  # the controller is made with them


def test_slow_manifold_of_the_coefficients_is_the_one_of_the_constants_in_c(
    forms: ClosedForms, cases: list[Case]
) -> None:
    """(28) by C0, C2 and C3 with u0 = r lambda0 + Iw J eta, against -kappa inv(Gamma) Lambda (eta + v3 x v)."""
    for case in cases[::2]:
        x = forms.matrices(case)
        acceleration = case.u * [20.0, 20.0, 80.0]
        inertial = acceleration + np.cross([0.0, 0.0, case.v[2]], case.v)
        force = of_body("wheel_force_of_specific") @ inertial
        u0 = case.r * force + case.Iw * of_body("wheel_rate_of_twist") @ acceleration

        actual = -case.Vd / case.G0 * gamma_inverse() @ force

        expected = -np.linalg.solve(x["C2"], x["C0"] @ case.v + x["C3"] @ u0)
        # Gamma's condition is 34.
        np.testing.assert_allclose(actual, expected, rtol=0.0, atol=34 * 1e-7 * np.max(np.abs(expected)))


# -------------------------------------------------------------------------------------------------------------- stale


def test_document_is_the_one_that_is_derived(tool: ModuleType) -> None:
    tool.main(["--check"])


def test_changed_document_is_stale_until_it_is_written_again(tool: ModuleType, tmp_path: Path) -> None:
    copy = tmp_path / DOCUMENT.name
    shutil.copy(DOCUMENT, copy)
    copy.write_text(copy.read_text(encoding="utf-8").replace("| 2·r²·v3/P |", "| r²·v3/P |"), encoding="utf-8")
    before = copy.read_text(encoding="utf-8")

    with pytest.raises(SystemExit, match="stale; tools/generate_coefficients"):
        tool.main([str(copy), "--check"])

    assert copy.read_text(encoding="utf-8") == before
    tool.main([str(copy)])
    tool.main([str(copy), "--check"])
    assert copy.read_text(encoding="utf-8") == DOCUMENT.read_text(encoding="utf-8")


def test_absent_document_is_stale(tool: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="stale"):
        tool.main([str(tmp_path / "none.md"), "--check"])
