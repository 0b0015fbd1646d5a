"""The controller in C against the paper's own matrices, built literally in its coordinates and in double.

Nothing literal here uses the compact form of the theory: A and S of (1) and (2) as functions of the heading, the 9x3
and 3x3 matrices of (9) and (10) from M q'' = B u + A lambda, then (27), (28), (29), (32) and (33) as they are printed,
with the errata corrected; time derivatives are complex steps along the closed loop, exact to rounding.

To every order, the formal series of (22) comes from truncated polynomials in epsilon and time (Jet), put into
M q'' = B u + A lambda along the closed loop. The firmware's resummed form, written once more in double, is held against
that by the slope of the difference in epsilon; the firmware itself against the double by single precision.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from host_sim.robot import load_robot

Array = NDArray[Any]  # of float64, or of complex128 on a complex step

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = ROOT / "build" / "host" / "libcontrol-visible.so"

ROBOT = load_robot(ROOT / "firmware" / "robot" / "omnibot.toml")
OFFSET, B, R = ROBOT.tracked_point_offset_m, ROBOT.wheel_distance_m, ROBOT.wheel_radius_m
WHEEL_INERTIA, STIFFNESS = ROBOT.wheel_inertia_kg_m2, ROBOT.normalised_stiffness_N

STATES = 300
STEP = 1e-20  # of the complex step: no difference is taken, so it cannot be too small

# The firmware rounds to 6e-8 of what it adds; inv(Gamma) magnifies what is not along (1, 1, 1) by its condition, 34.
# Each comparison is relative to the largest entry of the result and, where they cancel, of the terms it is made of.
TOLERANCE = 1e-5


# ---------------------------------------------------------------------------------------------------- the paper's model


def matrix_a(theta: complex) -> Array:
    """A of (1), shape (6, 3), corrected: sin alpha of wheel 1, and -r."""
    alpha, beta = theta - 2.0 * np.pi / 3.0, theta + 2.0 * np.pi / 3.0
    return np.array(
        [
            [np.sin(alpha), np.sin(theta), np.sin(beta)],
            [-np.cos(alpha), -np.cos(theta), -np.cos(beta)],
            [B, B, B],
            [-R, 0.0, 0.0],
            [0.0, -R, 0.0],
            [0.0, 0.0, -R],
        ]
    )


def matrix_s(theta: complex) -> Array:
    """S of (2), shape (6, 3), corrected: the body frame is turned by +theta."""
    root3 = np.sqrt(3.0)
    return np.array(
        [
            [np.cos(theta), -np.sin(theta), 0.0],
            [np.sin(theta), np.cos(theta), 0.0],
            [0.0, 0.0, 1.0],
            [-root3 / 2.0 / R, 0.5 / R, B / R],
            [0.0, -1.0 / R, B / R],
            [root3 / 2.0 / R, 0.5 / R, B / R],
        ]
    )


def by_heading(matrix: Callable[[complex], Array], theta: complex) -> Array:
    """Derivative by theta of A or S: its first two rows are first harmonics of theta, the others constant."""
    derivative = matrix(theta + 0.5 * np.pi)
    derivative[2:] = 0.0
    return derivative


MASS = np.diag([*ROBOT.Mo, *3 * [WHEEL_INERTIA]])
INPUT = np.vstack([np.zeros((3, 3)), np.eye(3)])  # the paper's B


@dataclass(frozen=True)
class Model:
    """Matrices of (9), shape (9, 3), and of (10), shape (3, 3), by their indices."""

    b: tuple[Array, Array, Array, Array]
    c: tuple[Array, Array, Array, Array]


def model_at(theta: complex, v: Array, mobility: complex) -> Model:
    """Premultiply M q'' = B u + A lambda by [S A]' and solve for v' and epsilon mu'."""
    a, s = matrix_a(theta), matrix_s(theta)
    a_slope, s_slope = by_heading(matrix_a, theta), by_heading(matrix_s, theta)
    both = np.hstack([s, a])
    turn = s[2] @ v  # heading rate at epsilon = 0; epsilon a[2] @ mu comes on top
    force_of_mu = -(a.T @ a) / mobility  # lambda = -G0 sigma / ((V + delta) epsilon), sigma = A' q' = A' A epsilon mu

    def solved(force: Array) -> Array:
        """Accelerations, shape (6, 3), of a generalised force of shape (6, 3)."""
        return np.linalg.solve(both.T @ MASS @ both, both.T @ force)

    columns = (
        solved(-MASS @ s_slope * turn),
        solved(-MASS @ (a_slope * turn + np.outer(s_slope @ v, a[2]))),
        solved(a @ force_of_mu),
        solved(INPUT),
    )
    tops = (s, a, np.zeros((6, 3)), np.zeros((6, 3)))
    b = [np.vstack([top, column[:3]]) for top, column in zip(tops, columns, strict=True)]
    c = [column[3:] for column in columns]
    return Model((b[0], b[1], b[2], b[3]), (c[0], c[1], c[2], c[3]))


def control_u0(theta: complex, v: Array, eta: Array) -> Array:
    """u0 of (32)."""
    s = matrix_s(theta)
    turning = by_heading(matrix_s, theta) * (s @ v)[2]  # dS/dq S v: S depends on the heading alone
    return np.linalg.solve(s.T @ INPUT, s.T @ (MASS @ s @ eta + MASS @ turning @ v))


def slow_manifold(theta: complex, v: Array, eta: Array, mobility: complex) -> Array:
    """H0 of (28)."""
    c = model_at(theta, v, mobility).c
    return -np.linalg.solve(c[2], c[0] @ v + c[3] @ control_u0(theta, v, eta))


def corrections(theta: float, v: Array, mobility: float, h0: Array, h0_rate: Array) -> tuple[Array, Array]:
    """H1 and u1 of (27) and (29), which need each other: solved together."""
    model = model_at(theta, v, mobility)
    b, c = model.b, model.c
    b3_inverse = np.linalg.pinv(b[3])
    to_c = c[3] @ b3_inverse
    h1 = np.linalg.solve(c[2] - to_c @ b[2], h0_rate - c[1] @ h0 + to_c @ b[1] @ h0)
    return h1, -b3_inverse @ (b[1] @ h0 + b[2] @ h1)


def speed(twist: Array, length: float) -> complex:
    """V of (14)."""
    return np.sqrt(twist[0] ** 2 + twist[1] ** 2 + (length * twist[2]) ** 2)


# -------------------------------------------------------------------------------------------------------- random states


def as_single(values: Array) -> Array:
    """Round to what the firmware can hold, so that both sides start from the same numbers."""
    return values.astype(np.float32).astype(np.float64)


@dataclass(frozen=True)
class State:
    """A state of the slow system and how it moves."""

    theta: float
    v: Array
    eta: Array
    eta_rate: Array
    delta: float
    length: float

    def moved(self, time: complex) -> tuple[complex, Array, Array, complex]:
        """Heading, v, eta and mobility a moment later, to first order, along v' = eta."""
        v = self.v + time * self.eta
        mobility = (speed(v, self.length) + self.delta) / STIFFNESS
        return self.theta + time * self.v[2], v, self.eta + time * self.eta_rate, mobility

    @property
    def mobility(self) -> float:
        return float(np.real(self.moved(0.0)[3]))

    @property
    def mobility_rate(self) -> float:
        return float(np.imag(self.moved(1j * STEP)[3])) / STEP

    @property
    def h0(self) -> Array:
        return np.real(slow_manifold(*self.moved(0.0)))

    @property
    def h0_rate(self) -> Array:
        return np.imag(slow_manifold(*self.moved(1j * STEP))) / STEP


def random_states() -> list[State]:
    random = np.random.default_rng(20140920)

    def triplet(planar: float, turn: float) -> Array:
        return as_single(random.uniform(-1.0, 1.0, 3) * [planar, planar, turn])

    return [
        State(
            theta=float(random.uniform(-np.pi, np.pi)),
            v=triplet(1.5, 4.0),
            eta=triplet(5.0, 20.0),
            eta_rate=triplet(80.0, 300.0),
            delta=float(10.0 ** random.uniform(-4.0, 0.0)),
            length=float(random.choice([0.12, 1.0])),
        )
        for _ in range(STATES)
    ]


@pytest.fixture(scope="module")
def states() -> list[State]:
    return random_states()


# --------------------------------------------------------------------------------------------------------- the firmware


class Vec3(ctypes.Structure):
    _fields_ = [(name, ctypes.c_float) for name in "xyz"]


class Floor(ctypes.Structure):
    _fields_ = [
        ("curve", ctypes.c_void_p),
        ("linear", ctypes.c_bool),
        ("compliance_per_N", ctypes.c_float),
        ("friction_limit_N", ctypes.c_float),
        ("intervals_per_N", ctypes.c_float),  # the firmware's own, like others at the end of a struct
    ]


class Law(ctypes.Structure):
    _fields_ = [("output", ctypes.c_int), ("stiffness_per_s2", Vec3), ("damping_per_s", Vec3)]


class ControlParams(ctypes.Structure):
    _fields_ = [
        ("robot", ctypes.c_void_p),
        ("order", ctypes.c_int32),
        ("floor", Floor),
        ("delta_mps", ctypes.c_float),
        ("speed_length_m", ctypes.c_float),
        ("law", Law),
        ("series_ratio_max", ctypes.c_float),
        ("observer_lag_s", ctypes.c_float),
        ("force_bound_N", ctypes.c_float),
        ("torque_bound_Nm", ctypes.c_float),
        ("compliance_max_mps_per_N", ctypes.c_float),
        ("layer_s_per_mps", ctypes.c_float),
    ]


class ControlState(ctypes.Structure):
    _fields_ = [
        ("force_estimate_N", Vec3),
        ("pose", Vec3),
        ("pose_rest", Vec3),
        ("twist", Vec3),
        ("wheel_force_N", Vec3),
        ("specific_force", Vec3),
    ]


class ControlInput(ctypes.Structure):
    _fields_ = [
        ("pose_is_new", ctypes.c_bool),
        *((name, Vec3) for name in ("pose", "wheel_speed", "position", "velocity", "acceleration", "jerk")),
    ]


class ControlOutput(ctypes.Structure):
    _fields_ = [
        *((name, Vec3) for name in ("torque_Nm", "mu_mps", "wheel_force_N", "specific_force", "twist", "eta", "error")),
        ("force_bounded", ctypes.c_bool),
        ("torque_bounded", ctypes.c_bool),
    ]


def to_c(vector: Array) -> Vec3:
    return Vec3(*map(float, vector))


def from_c(vector: Vec3) -> Array:
    return np.array([vector.x, vector.y, vector.z])


class Firmware:
    """Functions of the control layer on numpy vectors."""

    def __init__(self, path: Path) -> None:
        library = ctypes.CDLL(str(path))
        self.robot = ctypes.addressof(ctypes.c_char.in_dll(library, "omnibot"))
        pointer, number = ctypes.c_void_p, ctypes.c_float

        def function(name: str, *arguments: Any) -> Callable[..., Array]:
            entry = library[name]
            entry.argtypes, entry.restype = [pointer, *arguments], Vec3

            def call(*values: Any) -> Array:
                return from_c(entry(self.robot, *(to_c(v) if isinstance(v, np.ndarray) else v for v in values)))

            return call

        self.of_force = function("manifold_of_force", number, Vec3)
        self._force = function("manifold_force", Vec3)
        rate = library.manifold_specific_force_rate
        rate.argtypes, rate.restype = [Vec3, Vec3, Vec3], Vec3
        self._specific_rate = rate
        library.control_prepare.argtypes, library.control_prepare.restype = [pointer], None
        self._prepare = library.control_prepare
        self._step = library.control_step
        self._step.argtypes, self._step.restype = [pointer, pointer, pointer, pointer], ctypes.c_bool

    def force(self, twist: Array, acceleration: Array) -> Array:
        """Return the wheel forces of a twist that changes at a rate."""
        return self._force(acceleration + twist[2] * np.array([-twist[1], twist[0], 0.0]))

    def force_rate(self, twist: Array, acceleration: Array, jerk: Array) -> Array:
        """Return the rate of those where the acceleration changes, too."""
        return self._force(from_c(self._specific_rate(*map(to_c, (twist, acceleration, jerk)))))

    def step(self, params: ControlParams, values: ControlInput, force_estimate: Array | None = None) -> ControlOutput:
        output, state = ControlOutput(), ControlState()
        if force_estimate is not None:
            state.force_estimate_N = to_c(force_estimate)
        self._prepare(ctypes.byref(params))
        assert self._step(*map(ctypes.byref, (params, state, values, output)))
        return output


@pytest.fixture(scope="module")
def firmware() -> Firmware:
    if not LIBRARY.exists():
        pytest.fail(f"no {LIBRARY.relative_to(ROOT)}: cmake --preset host && cmake --build --preset host")
    return Firmware(LIBRARY)


def assert_close(actual: Array, expected: Array, *terms: Array, tolerance: float = TOLERANCE) -> None:
    """Equal to the tolerance, relative to the largest entry of the result and of the terms that it is the sum of."""
    size = max(float(np.max(np.abs(part))) for part in (expected, *terms))
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance * size)


# --------------------------------------------------------------------------------------------- (a) the matrices A and S


def annihilation(a: Array, s: Array) -> float:
    return float(np.max(np.abs(a.T @ s)))


def test_a_and_s_with_the_corrected_signs_annihilate(states: list[State]) -> None:
    for state in states:
        # Entries of A and S r are of order 1: 1e-15 is a few roundings.
        assert annihilation(matrix_a(state.theta), matrix_s(state.theta)) < 1e-15


def test_a_with_the_misprinted_signs_does_not_annihilate_s(states: list[State]) -> None:
    for state in states:
        s, a = matrix_s(state.theta), matrix_a(state.theta)
        wheels = a.copy()
        wheels[3:] *= -1.0
        first = a.copy()
        first[0, 0] *= -1.0
        turned = s.copy()
        turned[:2, :2] = turned[:2, :2].T
        printed = wheels.copy()
        printed[0, 0] *= -1.0

        assert annihilation(wheels, s) == pytest.approx(2.0)
        assert annihilation(first, s) > 1.9 * abs(a[0, 0]) * max(abs(s[0, 0]), abs(s[0, 1]))
        assert annihilation(a, turned) > abs(np.sin(state.theta))
        assert annihilation(printed, turned) > 0.5


def test_heading_derivatives_of_a_and_s_agree_with_a_complex_step(states: list[State]) -> None:
    for state in states:
        for matrix in (matrix_a, matrix_s):
            stepped = np.imag(matrix(state.theta + 1j * STEP)) / STEP
            np.testing.assert_allclose(by_heading(matrix, state.theta), stepped, rtol=0.0, atol=1e-15)


def test_model_conserves_what_m_says(states: list[State]) -> None:
    """The matrices put back into M q'' = B u + A lambda leave nothing but the term quadratic in epsilon mu."""
    random = np.random.default_rng(1)
    for state in states[:50]:
        mu, u = random.normal(size=3), random.normal(size=3)
        epsilon, theta, v, mobility = 1e-3, state.theta, state.v, state.mobility
        model = model_at(theta, v, mobility)
        a, s = matrix_a(theta), matrix_s(theta)
        b, c = model.b, model.c
        x_rate = b[0] @ v + (epsilon * b[1] + b[2]) @ mu + b[3] @ u
        w_rate = c[0] @ v + (epsilon * c[1] + c[2]) @ mu + c[3] @ u
        q_rate, v_rate = x_rate[:6], x_rate[6:]
        moving = by_heading(matrix_s, theta) @ v + epsilon * by_heading(matrix_a, theta) @ mu

        force = MASS @ (s @ v_rate + a @ w_rate + moving * q_rate[2]) - INPUT @ u + a @ (a.T @ a) @ mu / mobility
        missing = epsilon**2 * MASS @ by_heading(matrix_a, theta) @ mu * (a[2] @ mu)

        np.testing.assert_allclose(q_rate, s @ v + epsilon * a @ mu, rtol=0.0, atol=1e-12)
        both = np.hstack([s, a])
        np.testing.assert_allclose(both.T @ force, both.T @ missing, rtol=0.0, atol=1e-9)


# ---------------------------------------------------------------------------------------------------- (b) order 0: (32)


def test_u0_of_the_firmware_is_that_of_the_paper(firmware: Firmware, states: list[State]) -> None:
    for state in states:
        rolling = R * firmware.force(state.v, state.eta)
        spinning = WHEEL_INERTIA * matrix_s(state.theta)[3:] @ state.eta

        assert_close(rolling + spinning, control_u0(state.theta, state.v, state.eta), rolling, spinning)


def test_u0_linearises_the_literal_model(states: list[State]) -> None:
    """On the slow manifold u0 makes v' = eta and epsilon mu' = 0: (32) and (28) belong together."""
    for state in states:
        model = model_at(state.theta, state.v, state.mobility)
        u0, h0 = control_u0(state.theta, state.v, state.eta), state.h0
        v_rate = (model.b[0] @ state.v + model.b[2] @ h0 + model.b[3] @ u0)[6:]
        w_rate = model.c[0] @ state.v + model.c[2] @ h0 + model.c[3] @ u0

        np.testing.assert_allclose(v_rate, state.eta, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(w_rate, 0.0, rtol=0.0, atol=1e-9)


# --------------------------------------------------------------------------------------------- (c) manifold and order 1


def test_h0_of_the_firmware_is_that_of_the_paper(firmware: Firmware, states: list[State]) -> None:
    for state in states:
        force = firmware.force(state.v, state.eta)
        assert_close(firmware.of_force(state.mobility, force), state.h0)


def h0_rate_of(firmware: Firmware, state: State) -> Array:
    """H0' = -inv(Gamma) (kappa' lambda + kappa lambda') by the firmware's functions."""
    force = firmware.force(state.v, state.eta)
    force_rate = firmware.force_rate(state.v, state.eta, state.eta_rate)
    return firmware.of_force(state.mobility_rate, force) + firmware.of_force(state.mobility, force_rate)


def test_h0_rate_of_the_firmware_is_that_along_the_closed_loop(firmware: Firmware, states: list[State]) -> None:
    for state in states:
        assert_close(h0_rate_of(firmware, state), state.h0_rate)


def test_h1_and_u1_of_the_firmware_are_those_of_the_paper(firmware: Firmware, states: list[State]) -> None:
    body_of_w = matrix_a(0.0)[:3]
    for state in states:
        h0, h0_rate = state.h0, state.h0_rate
        h1, u1 = corrections(state.theta, state.v, state.mobility, h0, h0_rate)

        # The firmware's chain from the same state: nothing literal goes in. The order epsilon of lambda(nu, nu') is its
        # derivative along Jr' H0, Jr' H0', as lambda' is along nu', nu''.
        ours_h0 = firmware.of_force(state.mobility, firmware.force(state.v, state.eta))
        ours_rate = h0_rate_of(firmware, state)
        force1 = firmware.force_rate(state.v, body_of_w @ ours_h0, body_of_w @ ours_rate)
        ours_h1 = firmware.of_force(state.mobility, force1)
        ours_u1 = R * force1 - R * WHEEL_INERTIA * ours_rate

        assert_close(ours_h1, h1)
        assert_close(ours_u1, u1)


def test_u1_cancels_order_epsilon_of_the_literal_model(states: list[State]) -> None:
    """What (29) is for: nothing of order epsilon is left in v'; and (27) holds."""
    for state in states:
        h0, h0_rate = state.h0, state.h0_rate
        h1, u1 = corrections(state.theta, state.v, state.mobility, h0, h0_rate)
        model = model_at(state.theta, state.v, state.mobility)
        left = (model.b[1] @ h0 + model.b[2] @ h1 + model.b[3] @ u1)[6:]
        size = float(np.max(np.abs(h0_rate)))

        np.testing.assert_allclose(left, 0.0, rtol=0.0, atol=1e-9 * size)
        recursion = model.c[1] @ h0 + model.c[2] @ h1 + model.c[3] @ u1
        np.testing.assert_allclose(recursion, h0_rate, rtol=0.0, atol=1e-9 * size)


def test_turning_the_world_changes_nothing(states: list[State]) -> None:
    """The literal matrices depend on the heading, what comes out of them does not: the compact form may drop it."""
    for state in states:
        h0, h0_rate = state.h0, state.h0_rate
        here = corrections(state.theta, state.v, state.mobility, h0, h0_rate)
        there = corrections(state.theta + 2.0, state.v, state.mobility, h0, h0_rate)
        np.testing.assert_allclose(here[0], there[0], rtol=0.0, atol=1e-11 * np.max(np.abs(here[0])))
        np.testing.assert_allclose(here[1], there[1], rtol=0.0, atol=1e-11 * np.max(np.abs(here[1])))


# ------------------------------------------------------------------------------------------------- the whole step, (33)


STIFFNESS_GAIN = np.array([70.0, 70.0, 40.0])
DAMPING_GAIN = np.array([23.0, 23.0, 11.0])


@dataclass(frozen=True)
class Scene:
    """Input of a control step; the reference by its derivatives, shape (4, 3)."""

    pose: Array
    wheel_speed: Array
    reference: Array
    epsilon: float
    delta: float
    length: float


def random_scenes() -> list[Scene]:
    random = np.random.default_rng(33)
    scenes = []
    for _ in range(STATES):
        pose = as_single(random.uniform(-1.0, 1.0, 3) * [2.0, 2.0, 3.1])
        twist = random.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 3.0]
        reference = random.uniform(-1.0, 1.0, (4, 3)) * [[0.1], [1.0], [2.0], [20.0]]
        reference[0] += pose
        scenes.append(
            Scene(
                pose=pose,
                wheel_speed=as_single(matrix_s(0.0)[3:] @ twist),
                reference=as_single(reference),
                epsilon=float(10.0 ** random.uniform(-5.0, -2.0)),
                delta=1e-3,
                length=float(random.choice([0.12, 1.0])),
            )
        )
    return scenes


def output_map(pose: Array) -> Array:
    """P0 of (12), with the heading as the third output."""
    return np.array([pose[0] - OFFSET * np.sin(pose[2]), pose[1] + OFFSET * np.cos(pose[2]), pose[2]])


def delta_matrix(theta: complex) -> Array:
    """dP0/dq S1 of (33), shape (3, 3)."""
    slope = np.array([[1.0, 0.0, -OFFSET * np.cos(theta)], [0.0, 1.0, -OFFSET * np.sin(theta)], [0.0, 0.0, 1.0]])
    return slope @ matrix_s(theta)[:3]


def delta_by_heading(theta: complex) -> Array:
    """Derivative of the same by theta; its first two rows are first harmonics: dP0/dq S1 = [R, R (-L, 0)']."""
    derivative = delta_matrix(theta + 0.5 * np.pi)
    derivative[2] = 0.0
    return derivative


def law(pose: Array, twist: Array, reference: Array) -> Array:
    """Eta of (33); ``twist`` is the body's velocity in its own frame, slip included."""
    slope = delta_matrix(pose[2])
    y_rate = slope @ twist
    wanted = reference[2] - DAMPING_GAIN * (y_rate - reference[1]) - STIFFNESS_GAIN * (output_map(pose) - reference[0])
    return np.linalg.solve(slope, wanted - delta_by_heading(pose[2]) * twist[2] @ twist)


def law_rate(pose: Array, twist: Array, reference: Array, eta: Array) -> Array:
    """Its rate along the closed loop, where the twist changes by eta and the reference by its own derivatives."""
    step = 1j * STEP
    later_pose = pose + step * (matrix_s(pose[2])[:3] @ twist)
    later_reference = reference + step * np.vstack([reference[1:], np.zeros((1, 3))])
    return np.imag(law(later_pose, twist + step * eta, later_reference)) / STEP


def literal_step(scene: Scene, order: int) -> tuple[Array, Array, Array, Array]:
    """Torque, mu, twist and eta of (22) to (33), without bounds."""
    theta, epsilon = float(scene.pose[2]), scene.epsilon
    wheels_of_v, wheels_of_w = matrix_s(theta)[3:], matrix_a(theta)[3:]
    v = np.linalg.solve(wheels_of_v, scene.wheel_speed)
    twist = v
    eta = law(scene.pose, twist, scene.reference)
    mobility = float(np.real(speed(twist, scene.length) + scene.delta)) / STIFFNESS
    if order == 1:
        # phi' = S2 v + A2 w and the body's part of S1 v + A1 w, with w = epsilon H0
        w = epsilon * slow_manifold(theta, v, eta, mobility)
        v = np.linalg.solve(wheels_of_v, scene.wheel_speed - wheels_of_w @ w)
        q_rate = matrix_s(theta)[:3] @ v + matrix_a(theta)[:3] @ w
        twist = matrix_s(theta)[:3].T @ q_rate
        eta = law(scene.pose, twist, scene.reference)
        mobility = float(np.real(speed(twist, scene.length) + scene.delta)) / STIFFNESS
    h0 = slow_manifold(theta, v, eta, mobility)
    if order == 0:
        return control_u0(theta, v, eta), h0, twist, eta
    step = 1j * STEP
    eta_rate = law_rate(scene.pose, twist, scene.reference, eta)
    later_mobility = (speed(twist + step * eta, scene.length) + scene.delta) / STIFFNESS
    later = slow_manifold(theta + step * twist[2], v + step * eta, eta + step * eta_rate, later_mobility)
    h0_rate = np.imag(later) / STEP
    h1, u1 = corrections(theta, v, mobility, h0, h0_rate)
    # (33) asks for the body's acceleration, v' is that less the growth of w: S1 v' + A1 w' seen from the body.
    v_rate = eta - matrix_s(theta)[:3].T @ matrix_a(theta)[:3] @ (epsilon * h0_rate)
    torque = control_u0(theta, v, v_rate) + epsilon * u1
    return torque, slow_manifold(theta, v, v_rate, mobility) + epsilon * h1, twist, eta


def acceleration_error(scene: Scene, order: int) -> Array:
    """What the literal robot on the manifold makes of a step's torque, less what (33) wants at its true velocity."""
    theta, epsilon = float(scene.pose[2]), scene.epsilon
    torque, mu, _, _ = literal_step(scene, order)
    a, s = matrix_a(theta), matrix_s(theta)
    v = np.linalg.solve(s[3:], scene.wheel_speed - epsilon * a[3:] @ mu)
    body_of_w = s[:3].T @ a[:3]
    twist = v + epsilon * body_of_w @ mu
    model = model_at(theta, v, float(np.real(speed(twist, scene.length) + scene.delta)) / STIFFNESS)
    b, c = model.b, model.c
    v_rate = (b[0] @ v + (epsilon * b[1] + b[2]) @ mu + b[3] @ torque)[6:]
    w_rate = c[0] @ v + (epsilon * c[1] + c[2]) @ mu + c[3] @ torque
    return v_rate + body_of_w @ w_rate - law(scene.pose, twist, scene.reference)


@pytest.mark.parametrize("order", [0, 1])
def test_error_of_the_literal_law_is_of_the_next_order_in_epsilon(order: int) -> None:
    for scene in random_scenes():
        errors = [
            float(np.linalg.norm(acceleration_error(replace(scene, epsilon=epsilon), order)))
            for epsilon in (2e-6, 1e-6)
        ]
        assert errors[0] / errors[1] == pytest.approx(2.0 ** (order + 1), rel=0.05)


# ------------------------------------------------------------------- the series of (22) to every order, literally


DEGREE = 3  # of epsilon, and of time: each power of epsilon takes one derivative more
_STRIDE = 2 * DEGREE + 1  # a polynomial in two variables as one in one: products cannot spill over


class Jet:
    """A polynomial in epsilon and time, truncated at DEGREE in each; numpy's functions work on arrays of them."""

    def __init__(self, coefficients: Array) -> None:
        self.c = coefficients  # by power of epsilon and of time

    @staticmethod
    def of(value: "Jet | float") -> "Jet":
        if isinstance(value, Jet):
            return value
        coefficients = np.zeros((DEGREE + 1, DEGREE + 1))
        coefficients[0, 0] = value
        return Jet(coefficients)

    def __add__(self, other: "Jet | float") -> "Jet":
        return Jet(self.c + Jet.of(other).c)

    def __neg__(self) -> "Jet":
        return Jet(-self.c)

    def __sub__(self, other: "Jet | float") -> "Jet":
        return Jet(self.c - Jet.of(other).c)

    def __rsub__(self, other: "Jet | float") -> "Jet":
        return Jet(Jet.of(other).c - self.c)

    def __mul__(self, other: "Jet | float") -> "Jet":
        if isinstance(other, np.ndarray):
            return NotImplemented  # it multiplies its entries
        if not isinstance(other, Jet):
            return Jet(self.c * other)
        flat = []
        for factor in (self, other):
            wide = np.zeros((DEGREE + 1, _STRIDE))
            wide[:, : DEGREE + 1] = factor.c
            flat.append(wide.ravel())
        product = np.convolve(*flat)[: (DEGREE + 1) * _STRIDE]
        return Jet(product.reshape(DEGREE + 1, _STRIDE)[:, : DEGREE + 1])

    __radd__, __rmul__ = __add__, __mul__

    def series(self, derivatives: list[float]) -> "Jet":
        """Return f of this by Taylor's series, given f and its derivatives at the constant term."""
        small = self - self.c[0, 0]
        result, power, factorial = Jet.of(0.0), Jet.of(1.0), 1.0
        for k, derivative in enumerate(derivatives):
            result = result + power * (derivative / factorial)
            power, factorial = power * small, factorial * (k + 1)
        return result

    def sin(self) -> "Jet":
        x = self.c[0, 0]
        return self.series([float(np.sin(x + 0.5 * np.pi * k)) for k in range(2 * DEGREE + 1)])

    def cos(self) -> "Jet":
        return (self + 0.5 * np.pi).sin()

    def sqrt(self) -> "Jet":
        x, derivatives, factor = self.c[0, 0], [], 1.0
        for k in range(2 * DEGREE + 1):
            derivatives.append(factor * x ** (0.5 - k))
            factor *= 0.5 - k
        return self.series(derivatives)

    def __pow__(self, power: int) -> "Jet":
        assert power == 2
        return self * self

    def rate(self) -> "Jet":
        """Return the time derivative; its highest power is not known and set to 0."""
        rate = np.zeros_like(self.c)
        rate[:, :-1] = self.c[:, 1:] * np.arange(1, DEGREE + 1)
        return Jet(rate)

    def integral(self, start: "Jet") -> "Jet":
        """Return the time integral that begins at the start's value."""
        result = np.zeros_like(self.c)
        result[:, 1:] = self.c[:, :-1] / np.arange(1, DEGREE + 1)
        result[:, 0] = start.c[:, 0]
        return Jet(result)

    def times_epsilon(self) -> "Jet":
        result = np.zeros_like(self.c)
        result[1:] = self.c[:-1]
        return Jet(result)


def each(function: Callable[..., Jet], *vectors: Array) -> Array:
    return np.array([function(*entries) for entries in zip(*vectors, strict=True)], dtype=object)


def jets(values: Array) -> Array:
    return each(Jet.of, values)


def reference_jets(reference: Array, snap: Array) -> Array:
    """The reference and its first two derivatives by time, shape (3, 3): derivatives beyond the jerk need not be 0."""
    derivatives = np.vstack([reference, snap[None]])
    factorial = np.array([1.0, 1.0, 2.0, 6.0, 24.0])
    rows = []
    for order in range(3):
        row = []
        for axis in range(3):
            coefficients = np.zeros((DEGREE + 1, DEGREE + 1))
            known = derivatives[order:, axis][: DEGREE + 1]
            coefficients[0, : len(known)] = known / factorial[: len(known)]
            row.append(Jet(coefficients))
        rows.append(row)
    return np.array(rows, dtype=object)


def law_of_jets(pose: Array, twist: Array, reference: Array) -> Array:
    """Eta of (33). Delta = R T with a constant T: its inverse is that of T after R turned back."""
    y_rate = delta_matrix(pose[2]) @ twist
    wanted = reference[2] - DAMPING_GAIN * (y_rate - reference[1]) - STIFFNESS_GAIN * (output_map(pose) - reference[0])
    right = wanted - delta_by_heading(pose[2]) @ twist * twist[2]
    return np.linalg.inv(delta_matrix(0.0)) @ (matrix_s(pose[2])[:3].T @ right)


@dataclass(frozen=True)
class Series:
    """Coefficients by power of epsilon at time 0, each of shape (DEGREE + 1, 3)."""

    torque: Array
    mu: Array
    force: Array
    twist: Array

    def at(self, epsilon: float, order: int) -> tuple[Array, Array, Array, Array]:
        """Torque, mu, wheel forces and twist up to a power of epsilon."""
        powers = epsilon ** np.arange(order + 1)
        torque, mu, force, twist = (powers @ c[: order + 1] for c in (self.torque, self.mu, self.force, self.twist))
        return torque, mu, force, twist


def literal_series(scene: Scene, *, speed_frozen: bool, snap: Array | None = None) -> Series:
    """H and u of (22) along the closed loop, from M q'' = B u + A lambda alone.

    A round of the iteration knows mu to one power of epsilon more: epsilon mu' is all that it takes from the last one.

    Parameters
    ----------
    scene
        State and reference; its epsilon is not looked at.
    speed_frozen
        V is that of the encoders and grows as that of the body does; else V is that of the body.
    snap
        Fourth derivative of the reference.
    """
    reference = reference_jets(scene.reference, np.zeros(3) if snap is None else snap)
    wheels_of_v, wheels_of_w = matrix_s(0.0)[3:], matrix_a(0.0)[3:]
    body_of_w, gamma = matrix_a(0.0)[:3], matrix_a(0.0).T @ matrix_a(0.0)
    odometry = np.linalg.solve(wheels_of_v, scene.wheel_speed)
    speed_odo = float(speed(odometry, scene.length).real)
    start, wheel_speed = jets(scene.pose), jets(scene.wheel_speed)
    pose, mu = start, jets(np.zeros(3))
    v_rate = jets(np.zeros(3))
    last: list[Array] = []
    result: list[Array] = []
    for _ in range(2 * DEGREE + 4):
        w = each(Jet.times_epsilon, mu)
        w_rate = each(lambda entry: entry.rate().times_epsilon(), mu)
        v = each(Jet.integral, v_rate, np.linalg.inv(wheels_of_v) @ (wheel_speed - wheels_of_w @ w))
        s, a = matrix_s(pose[2]), matrix_a(pose[2])
        q_rate = s @ v + a @ w
        pose = each(Jet.integral, q_rate[:3], start)
        twist = v + body_of_w @ w
        v_rate = law_of_jets(pose, twist, reference) - body_of_w @ w_rate
        moving = (by_heading_of_jets(matrix_s, pose[2]) @ v + by_heading_of_jets(matrix_a, pose[2]) @ w) * q_rate[2]
        inertia = MASS @ (s @ v_rate + a @ w_rate + moving)
        torque = np.linalg.inv((matrix_s(0.0).T @ INPUT).astype(float)) @ (s.T @ inertia)
        force = np.linalg.inv(gamma) @ (a.T @ (inertia - INPUT @ torque))
        v_speed = speed(twist, scene.length)
        if speed_frozen:
            grown = np.zeros((DEGREE + 1, DEGREE + 1))
            grown[:, 1] = v_speed.c[:, 1]
            grown[0, 0] = speed_odo
            v_speed = Jet(grown)
        mu = np.linalg.inv(gamma) @ force * (v_speed + scene.delta) * (-1.0 / STIFFNESS)
        last, result = result, [np.array([entry.c[:, 0] for entry in part]).T for part in (torque, mu, force, twist)]
    for before, now in zip(last, result, strict=True):
        np.testing.assert_allclose(before, now, rtol=1e-9, atol=1e-9 * np.abs(now).max())
    return Series(*result)


def by_heading_of_jets(matrix: Callable[[Any], Array], theta: Jet) -> Array:
    derivative = matrix(theta + 0.5 * np.pi)
    derivative[2:] = 0.0
    return derivative


# --------------------------------------------------------------------------------- the firmware's step, in double


ORDERS = (0, 1, 2, 3)
EXACT, OBSERVER = 4, 5


def wheel_force(scene: Scene, twist: Array) -> tuple[Array, Array]:
    """Lambda and eta at a twist: Newton's law of the body, M (nu' + omega x nu) = Jr' lambda."""
    eta = law(scene.pose, twist, scene.reference)
    turning = np.array([-twist[2] * twist[1], twist[2] * twist[0], 0.0])
    return np.linalg.solve(matrix_a(0.0)[:3], np.diag(ROBOT.Mo) @ (eta + turning)), eta


def resummed_step(
    scene: Scene, order: int, *, ratio_max: float = np.inf, force_estimate: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """Torque, mu, wheel forces and twist as the firmware finds them, without bounds."""
    contact = matrix_a(0.0)[:3].T  # Jr
    odometry = np.linalg.solve(matrix_s(0.0)[3:], scene.wheel_speed)
    most = ratio_max * 1.5 / (ROBOT.Mo[0] * DAMPING_GAIN[0])
    c = min(scene.epsilon * float(np.real(speed(odometry, scene.length) + scene.delta)) / STIFFNESS, most)

    def corrected(twist: Array) -> Array:
        return odometry - c * np.linalg.solve(contact, wheel_force(scene, twist)[0])

    twist = odometry
    if order == OBSERVER:
        assert force_estimate is not None
        slip_twist = np.linalg.solve(contact, scene.epsilon / STIFFNESS * force_estimate)

        def gap(behind: float) -> float:
            return float(np.real(speed(odometry - behind * slip_twist, scene.length))) + scene.delta - behind

        most = 2.0 * (float(np.real(speed(odometry, scene.length))) + scene.delta)
        twist = odometry - brentq(gap, 0.0, most, xtol=1e-14) * slip_twist
    else:
        if order == EXACT:
            # One Newton step by a complex-step Jacobian, then the round that all orders end with.
            columns = [np.imag(corrected(twist + 1j * STEP * axis)) / STEP for axis in np.eye(3)]
            twist = twist + np.linalg.solve(np.eye(3) - np.array(columns).T, corrected(twist) - twist)
        for _ in range(1 if order == EXACT else order):
            twist = corrected(twist)
    force, eta = wheel_force(scene, twist)
    wheel_rate = contact @ eta / R
    if order > 0:
        step = 1j * STEP
        eta_rate = law_rate(scene.pose, twist, scene.reference, eta)
        turning = np.array([-twist[2] * eta[1] - eta[2] * twist[1], twist[2] * eta[0] + eta[2] * twist[0], 0.0])
        force_rate = np.linalg.solve(contact.T, np.diag(ROBOT.Mo) @ (eta_rate + turning))
        speed_rate = np.imag(speed(twist + step * eta, scene.length)) / STEP
        wheel_rate = wheel_rate + (c * force_rate + scene.epsilon / STIFFNESS * speed_rate * force) / R
    gamma = contact @ contact.T + R**2 * np.eye(3)
    mobility = float(np.real(speed(twist, scene.length) + scene.delta)) / STIFFNESS
    return R * force + WHEEL_INERTIA * wheel_rate, -mobility * np.linalg.solve(gamma, force), force, twist


def firmware_params(firmware: Firmware, scene: Scene, order: int) -> ControlParams:
    return ControlParams(
        robot=firmware.robot,
        order=order,
        floor=Floor(None, True, scene.epsilon / STIFFNESS, 5.0),
        delta_mps=scene.delta,
        speed_length_m=scene.length,
        law=Law(0, to_c(STIFFNESS_GAIN), to_c(DAMPING_GAIN)),
        series_ratio_max=1e9,
        observer_lag_s=0.0,
        force_bound_N=1e9,
        torque_bound_Nm=1e9,
    )


@pytest.mark.parametrize("order", [*ORDERS, EXACT, OBSERVER])
def test_whole_step_without_bounds_is_the_resummed_form(firmware: Firmware, order: int) -> None:
    corrected = 0.0
    for scene in random_scenes():
        # Slip ratios well below one, where the observer's quadratic has its root.
        force = resummed_step(scene, 0)[2]
        force_estimate = as_single(force * min(1.0, 0.1 / (scene.epsilon * np.max(np.abs(force)))))
        if order != OBSERVER:
            force_estimate = None
        values = ControlInput(True, to_c(scene.pose), to_c(scene.wheel_speed), *map(to_c, scene.reference))

        output = firmware.step(firmware_params(firmware, scene, order), values, force_estimate)

        torque, mu, force, twist = resummed_step(scene, order, force_estimate=force_estimate)
        assert not output.force_bounded
        assert not output.torque_bounded
        assert_close(from_c(output.twist), twist)
        # Eta is a sum of terms up to 23 * 2 + 70 * 0.2: absolute errors grow accordingly.
        eta = law(scene.pose, twist, scene.reference)
        assert_close(from_c(output.eta), eta, DAMPING_GAIN * twist, tolerance=1e-5)
        assert_close(from_c(output.torque_Nm), torque, tolerance=3e-5)
        assert_close(from_c(output.wheel_force_N), force, tolerance=3e-5)
        assert_close(from_c(output.mu_mps), mu, tolerance=3e-5)
        corrected = max(corrected, float(np.max(np.abs(torque - resummed_step(scene, 0)[0])) / np.max(np.abs(torque))))
    assert (corrected > 0.1) == (order > 0)  # the scenes are such that the corrections are seen


def slopes(scene: Scene, order: int, series: Series, parts: tuple[int, ...]) -> list[float]:
    """Power of epsilon by which resummed form and truncated series differ, one a part; infinite where they do not."""
    differences = []
    for epsilon in (1e-3, 5e-4):
        pair = resummed_step(replace(scene, epsilon=epsilon), order), series.at(epsilon, order)
        differences.append([relative_difference(pair[0][part], pair[1][part]) for part in parts])
    pairs = zip(*differences, strict=True)
    return [np.inf if large < ROUNDING else float(np.log2(large / small)) for large, small in pairs]


def relative_difference(actual: Array, expected: Array) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


ROUNDING = 2e-12  # of the double: inv(Gamma) magnifies it
TORQUE, MU, FORCE, TWIST = range(4)
SERIES_SCENES = 30


@pytest.mark.parametrize("order", [0, 1])
def test_series_of_jets_is_the_literal_law_of_the_block_matrices(order: int) -> None:
    for scene in random_scenes()[:SERIES_SCENES]:
        series = literal_series(scene, speed_frozen=False)
        errors = []
        for epsilon in (2e-5, 1e-5):
            torque, mu, twist, _ = literal_step(replace(scene, epsilon=epsilon), order)
            ours = series.at(epsilon, order)
            pairs = ((torque, ours[TORQUE]), (mu, ours[MU]), (twist, ours[TWIST]))
            errors.append([relative_difference(*pair) for pair in pairs])
        for large, small in zip(*errors, strict=True):
            assert large < ROUNDING or (order == 1 and large / small == pytest.approx(4.0, rel=0.05))


def test_resummed_form_of_order_0_is_the_literal_one() -> None:
    for scene in random_scenes()[:SERIES_SCENES]:
        series = literal_series(scene, speed_frozen=False)
        assert slopes(scene, 0, series, (TORQUE, MU, FORCE, TWIST)) == [np.inf] * 4


def test_resummed_form_of_order_1_differs_from_the_literal_series_by_epsilon_squared() -> None:
    for scene in random_scenes()[:SERIES_SCENES]:
        series = literal_series(scene, speed_frozen=False)
        torque, mu, force, twist = slopes(scene, 1, series, (TORQUE, MU, FORCE, TWIST))
        assert 1.8 < torque < 2.2
        assert mu > 1.8
        assert force > 1.8
        assert twist == np.inf


@pytest.mark.parametrize("order", [2, 3])
def test_resummed_form_with_the_encoders_speed_differs_by_the_next_power(order: int) -> None:
    """The firmware takes V of (14) from the encoders: to that V it has every power of epsilon."""
    for scene in random_scenes()[:SERIES_SCENES]:
        series = literal_series(scene, speed_frozen=True)
        torque, force, twist = slopes(scene, order, series, (TORQUE, FORCE, TWIST))
        assert order + 0.8 < torque < order + 1.2
        assert order + 0.8 < force
        assert order + 0.8 < twist


@pytest.mark.parametrize("order", [2, 3, EXACT])
def test_resummed_form_misses_the_slip_of_v_at_epsilon_squared(order: int) -> None:
    """What freezing V costs: a share of the slip as large as the slip ratio."""
    for scene in random_scenes()[:SERIES_SCENES]:
        series = literal_series(scene, speed_frozen=False)
        for epsilon in (1e-3, 1e-4):
            here = replace(scene, epsilon=epsilon)
            twist, odometry = resummed_step(here, order)[TWIST], resummed_step(here, 0)[TWIST]
            missing, slip = twist - series.at(epsilon, DEGREE)[TWIST], twist - odometry
            share = float(np.linalg.norm(slip) / abs(speed(odometry, scene.length)))
            # Beside it only what the truncated series itself leaves.
            assert np.linalg.norm(missing) < (3.0 * share + 1e-2 * (epsilon / 1e-3)) * np.linalg.norm(slip)


def test_derivatives_of_the_reference_beyond_the_jerk_do_not_matter() -> None:
    """Though H1', H2'' and so on contain them: the series resums to a form with one derivative."""
    snap = np.array([300.0, -200.0, 500.0])
    for scene in random_scenes()[:10]:
        with_snap = literal_series(scene, speed_frozen=False, snap=snap)
        without = literal_series(scene, speed_frozen=False)
        for part in ("torque", "mu", "force", "twist"):
            one, other = getattr(with_snap, part), getattr(without, part)
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


@pytest.mark.parametrize("order", ORDERS)
def test_residual_of_the_manifold_falls_by_the_next_power(order: int) -> None:
    """The wheel forces asked for and the slip believed in: nu + c inv(Jr) lambda(nu) = v_odo but for order N + 1."""
    for scene in random_scenes()[:SERIES_SCENES]:
        residuals = []
        for epsilon in (2e-4, 1e-4):
            here = replace(scene, epsilon=epsilon)
            _, _, force, twist = resummed_step(here, order)
            odometry = np.linalg.solve(matrix_s(0.0)[3:], scene.wheel_speed)
            c = epsilon * float(np.real(speed(odometry, scene.length) + scene.delta)) / STIFFNESS
            slip = c * np.linalg.solve(matrix_a(0.0)[:3].T, force)
            residuals.append(float(np.linalg.norm(twist + slip - odometry)))
        assert np.log2(residuals[0] / residuals[1]) == pytest.approx(order + 1, abs=0.1)
