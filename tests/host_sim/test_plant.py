"""The plant against equations and an integrator that it has not seen."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from host_sim import plant as plant_module
from host_sim.errors import OmnibotError
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.traction import Traction

ROBOT = load_robot()
PERIOD = 1e-3
DELTA = 1e-3
EPSILONS = [4e-11, 5e-5, 1e-3, 1e-2, 1e-1]
KINDS = ["linear", "magic"]
JR, MO = ROBOT.Jr, ROBOT.Mo
RADIUS, WHEEL_INERTIA = ROBOT.wheel_radius_m, ROBOT.wheel_inertia_kg_m2


def make_plant(kind: str, epsilon: float, speed_length: float = 1.0) -> Plant:
    return Plant(ROBOT, Traction.of(ROBOT, kind, epsilon), speed_length, DELTA)


def random_twist(rng: np.random.Generator, speed: float) -> np.ndarray:
    twist = rng.normal(size=3)
    return twist * speed / np.linalg.norm(twist)


# ------------------------------------------------------------------------------------------------------- Reference


class Reference:
    """scipy's Radau in (ν, x = σ/unit, pose, wheel angle), the equations as theory.md has them, Jacobian included."""

    def __init__(self, traction: Traction, unit: float, speed_length: float = 1.0) -> None:
        self.traction, self.unit = traction, unit
        self.metric = np.array([1.0, 1.0, speed_length**2])
        self.torque = np.zeros(3)

    def rates(self, _t: float, y: np.ndarray) -> np.ndarray:
        twist, slip, heading = y[:3], y[3:6] * self.unit, y[8]
        speed = math.sqrt(self.metric @ twist**2)
        force = -self.traction.force(slip / (speed + DELTA))
        twist_rate = JR.T @ force / MO - np.array([-twist[2] * twist[1], twist[2] * twist[0], 0.0])
        slip_rate = JR @ twist_rate - RADIUS * (self.torque - RADIUS * force) / WHEEL_INERTIA
        c, s = math.cos(heading), math.sin(heading)
        pose_rate = [c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]]
        return np.concatenate([twist_rate, slip_rate / self.unit, pose_rate, (JR @ twist - slip) / RADIUS])

    def jacobian(self, _t: float, y: np.ndarray) -> np.ndarray:
        twist, slip, heading = y[:3], y[3:6] * self.unit, y[8]
        speed = math.sqrt(self.metric @ twist**2)
        inverse = 1.0 / (speed + DELTA)
        slope = self.traction.slope(slip * inverse)
        force_twist = np.outer(slope * slip * inverse**2, self.metric * twist / speed if speed > 0.0 else np.zeros(3))
        force_slip = -np.diag(slope) * inverse
        x, v, turn = twist
        coriolis = np.array([[0.0, -turn, -v], [turn, 0.0, x], [0.0, 0.0, 0.0]])
        twist_twist = (JR.T @ force_twist) / MO[:, None] - coriolis
        twist_slip = (JR.T @ force_slip) / MO[:, None]
        out = np.zeros((12, 12))
        out[:3, :3], out[:3, 3:6] = twist_twist, twist_slip * self.unit
        out[3:6, :3] = (JR @ twist_twist + RADIUS**2 / WHEEL_INERTIA * force_twist) / self.unit
        out[3:6, 3:6] = JR @ twist_slip + RADIUS**2 / WHEEL_INERTIA * force_slip
        c, s = math.cos(heading), math.sin(heading)
        out[6:9, :3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        out[6:8, 8] = [-s * x - c * v, c * x - s * v]
        out[9:, :3], out[9:, 3:6] = JR / RADIUS, -np.eye(3) * self.unit / RADIUS
        return out

    def period(self, pose, twist, slip, torque, rtol=1e-10):
        """Twist, slip velocity, pose and wheel angle after one period."""
        self.torque = np.asarray(torque, dtype=float)
        solution = solve_ivp(
            self.rates,
            (0.0, PERIOD),
            np.concatenate([twist, np.asarray(slip) / self.unit, pose, np.zeros(3)]),
            method="Radau",
            rtol=rtol,
            atol=np.repeat([1e-14, 1e-9, 1e-13, 1e-12], 3),
            jac=self.jacobian,
            first_step=1e-17,
        )
        assert solution.success
        y = solution.y[:, -1]
        return y[:3], y[3:6] * self.unit, y[6:9], y[9:]


def compare(kind, epsilon, twist, slip, torque, speed_length=1.0):
    """Integrate a period both ways; require what the module promises."""
    plant = make_plant(kind, epsilon, speed_length)
    pose = np.array([0.3, -0.2, 0.7])
    plant.reset(pose, twist, slip)
    unit = epsilon * (plant.speed + DELTA)
    twist_1, slip_1, pose_1, angle_1 = Reference(plant.traction, unit, speed_length).period(pose, twist, slip, torque)
    plant.step(torque, PERIOD)
    assert not plant.diverged
    speed = np.linalg.norm(twist_1)
    np.testing.assert_allclose(plant.body_twist, twist_1, rtol=0.0, atol=5e-7 * speed)
    wheel_speed = (JR @ twist_1 - slip_1) / RADIUS
    np.testing.assert_allclose(plant.wheel_speed, wheel_speed, rtol=0.0, atol=1e-6 * np.abs(wheel_speed).max())
    scale = np.abs(slip_1) + epsilon * (plant.speed + DELTA)  # the slip velocity of a newton of force
    assert np.all(np.abs(plant.slip_velocity - slip_1) <= 2e-6 * scale)
    np.testing.assert_allclose(plant.pose, pose_1, rtol=0.0, atol=3e-9)  # 30 % of the layer skipped
    np.testing.assert_allclose(plant.wheel_angle, angle_1, rtol=0.0, atol=1e-8 / RADIUS)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("epsilon", EPSILONS)
class TestAgainstReference:
    def test_from_rest(self, kind, epsilon):
        compare(kind, epsilon, np.zeros(3), np.zeros(3), [0.11, -0.08, 0.03])

    @pytest.mark.parametrize("seed", [31, 32, 33])
    def test_near_the_manifold(self, kind, epsilon, seed):
        rng = np.random.default_rng(seed)
        slip = epsilon * 1.2 * rng.uniform(-3.0, 3.0, 3)
        compare(kind, epsilon, random_twist(rng, 1.2), slip, rng.uniform(-0.15, 0.15, 3))

    @pytest.mark.parametrize("speed", [0.002, 0.1, 1.5])
    def test_far_off_the_manifold(self, kind, epsilon, speed):
        rng = np.random.default_rng(4)
        slip = speed * rng.uniform(-0.5, 0.5, 3)
        compare(kind, epsilon, random_twist(rng, speed), slip, rng.uniform(-0.2, 0.2, 3))

    def test_more_torque_than_the_floor_takes(self, kind, epsilon):
        rng = np.random.default_rng(5)
        compare(kind, epsilon, random_twist(rng, 0.4), np.zeros(3), [0.2, -0.05, -0.19])


@pytest.mark.parametrize("kind", KINDS)
def test_standstill_within_the_period_is_integrated(kind):
    compare(kind, 0.01, [1.3e-3, 0.0, 0.0], np.zeros(3), [0.08, 0.0, -0.08])


def test_speed_length_is_that_of_the_speed():
    compare("magic", 0.01, [0.1, 0.05, 3.0], [1e-3, 0.0, 2e-3], [0.05, 0.02, -0.1], speed_length=0.12)
    plant = make_plant("linear", 0.01, 0.12)
    plant.reset([0.0, 0.0, 0.0], [0.3, 0.4, 10.0])
    assert plant.speed == pytest.approx(math.hypot(0.5, 1.2))


def test_wheels_spin_up_at_the_smallest_epsilon_and_are_caught_again():
    plant = make_plant("magic", 4e-11)
    plant.reset(np.zeros(3), [0.3, 0.1, 0.0])
    for _ in range(30):
        plant.step([-0.2, 0.0, 0.2], PERIOD)
    spinning = plant.slip_velocity
    assert abs(spinning[0]) > 0.5
    assert abs(spinning[2]) > 0.5
    for _ in range(60):
        plant.step(np.zeros(3), PERIOD)
    assert not plant.diverged
    assert np.abs(plant.slip_ratio).max() < plant.traction.peak_slip


# -------------------------------------------------------------------------------------------------------- Equations


def block_matrices(heading: float):
    """S and A of theory.md, and their derivatives by θ, literally."""
    b, r, h = ROBOT.wheel_distance_m, RADIUS, math.sqrt(3.0) / 2.0
    jr = np.array([[-h, 0.5, b], [0.0, -1.0, b], [h, 0.5, b]])
    c, s = math.cos(heading), math.sin(heading)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = np.array([[-s, -c, 0.0], [c, -s, 0.0], [0.0, 0.0, 0.0]])
    zero = np.zeros((3, 3))
    both = np.block([[rotation, rotation @ jr.T], [jr / r, -r * np.eye(3)]])
    both_by_heading = np.block([[turned, turned @ jr.T], [zero, zero]])
    return both, both_by_heading, rotation, turned


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("epsilon", [5e-5, 1e-2, 0.3])
def test_accelerations_are_those_of_the_block_matrices(kind, epsilon):
    rng = np.random.default_rng(6)
    plant = make_plant(kind, epsilon)
    mass = np.diag([*MO, WHEEL_INERTIA, WHEEL_INERTIA, WHEEL_INERTIA])
    for _ in range(10):
        twist, heading = rng.normal(size=3), rng.uniform(-3.0, 3.0)
        slip, torque = epsilon * rng.normal(size=3) * 3.0, rng.uniform(-0.2, 0.2, 3)
        plant.reset([0.0, 0.0, heading], twist, slip)
        both, by_heading, rotation, turned = block_matrices(heading)
        jacobian = np.vstack([rotation, (JR / RADIUS) @ np.eye(3)])  # S
        constraint = both[:, 3:]  # A
        np.testing.assert_allclose(constraint.T @ jacobian, np.zeros((3, 3)), atol=1e-15)
        velocity = np.concatenate([rotation @ twist, (JR @ twist - slip) / RADIUS])  # q̇
        v_and_w = np.linalg.solve(both, velocity)
        force = -plant.traction.force(slip / (np.linalg.norm(twist) + DELTA))
        applied = np.concatenate([np.zeros(3), torque]) + constraint @ force
        # [S A]ᵀ M [S A] (v̇, ẇ) = [S A]ᵀ (B τ + A λ − M d[S A]/dt (v, w))
        rate = np.linalg.solve(both.T @ mass @ both, both.T @ (applied - mass @ (twist[2] * by_heading @ v_and_w)))
        acceleration = both @ rate + twist[2] * by_heading @ v_and_w  # q̈
        body = rotation.T @ acceleration[:3] + twist[2] * turned.T @ velocity[:3]  # ν̇ of ν = R(θ)ᵀ q̇
        ours, wheels = plant.accelerations(torque)
        np.testing.assert_allclose(ours, body, rtol=1e-9, atol=1e-9 * np.abs(body).max())
        np.testing.assert_allclose(wheels, acceleration[3:], rtol=1e-9, atol=1e-9 * np.abs(acceleration[3:]).max())


@pytest.mark.parametrize(("kind", "speed"), list(itertools.product(KINDS, [0.002, 0.5])))
def test_jacobian_is_the_derivative_of_the_rates(kind, speed):
    rng = np.random.default_rng(7)
    epsilon = 0.01
    plant = make_plant(kind, epsilon)
    c, law = plant._constants, plant._law
    w = np.zeros((plant_module._WORK_ROWS, 3))
    for _ in range(5):
        v, slip = random_twist(rng, speed), epsilon * (speed + DELTA) * rng.normal(size=3) * 30.0
        numeric = np.empty((3, 3))
        for j in range(3):
            step = np.zeros(3)
            step[j] = 1e-5 * epsilon * (speed + DELTA)
            above = plant_module._rates(c, law, w, *v, *(slip + step))
            below = plant_module._rates(c, law, w, *v, *(slip - step))
            numeric[:, j] = (np.array(above[3:6]) - np.array(below[3:6])) / (2.0 * step[j])
        analytic = np.empty((3, 3))
        plant_module._rates_at(c, law, w, v, slip)
        plant_module._jacobian(c, w[plant_module._SLOPE], v, slip, analytic)
        # Weak terms (V by σ is one) are some 1e-4 of the largest.
        np.testing.assert_allclose(analytic, numeric, rtol=0.0, atol=2e-8 / (epsilon * (speed + DELTA)) * 77.0)


@pytest.mark.parametrize("kind", KINDS)
def test_power_goes_into_motion_and_friction(kind):
    rng = np.random.default_rng(8)
    plant = make_plant(kind, 0.02)
    for _ in range(20):
        plant.reset(np.zeros(3), rng.normal(size=3), 0.3 * rng.normal(size=3))
        torque = rng.uniform(-0.2, 0.2, 3)
        body, wheels = plant.accelerations(torque)
        kinetic = plant.body_twist @ (MO * body) + WHEEL_INERTIA * plant.wheel_speed @ wheels
        friction = plant.wheel_force @ plant.slip_velocity  # q̇ᵀ A λ
        assert friction < 0.0
        assert np.all(plant.wheel_force * plant.slip_velocity <= 0.0)
        assert kinetic == pytest.approx(torque @ plant.wheel_speed + friction, rel=1e-9, abs=1e-9)


def test_method_coefficients_meet_the_order_conditions():
    c, a, b = np.array(plant_module._NODES), plant_module._A, plant_module._WEIGHTS
    for k in range(1, 6):
        np.testing.assert_allclose(a @ c ** (k - 1), c**k / k, atol=1e-14)
    for k in range(1, 10):
        assert b @ c ** (k - 1) == pytest.approx(1.0 / k, abs=1e-14)
    np.testing.assert_allclose(a @ plant_module._A_INVERSE, np.eye(5), atol=1e-13)
    t, inverse = plant_module._T, plant_module._T_INVERSE
    np.testing.assert_allclose((t * plant_module._MU @ inverse).real, plant_module._A_INVERSE, atol=1e-12)


# -------------------------------------------------------------------------------------------------------- Behaviour


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("wheel", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_torque_of_a_wheel_drives_the_body_its_way(kind, wheel, sign):
    plant = make_plant(kind, 0.01)
    plant.reset(np.zeros(3), np.zeros(3))
    torque = np.zeros(3)
    torque[wheel] = 0.02 * sign
    for _ in range(20):
        plant.step(torque, PERIOD)
    assert sign * plant.wheel_speed[wheel] > 0.0
    assert sign * (JR @ plant.body_twist)[wheel] > 0.0
    assert sign * plant.slip_velocity[wheel] < 0.0  # the rim runs ahead of the floor
    assert sign * plant.wheel_force[wheel] > 0.0
    assert sign * (JR @ plant.pose)[wheel] > 0.0
    assert sign * plant.wheel_angle[wheel] > 0.0


@pytest.mark.parametrize(("axis", "torque"), [(0, [-1.0, 0.0, 1.0]), (1, [0.5, -1.0, 0.5]), (2, [1.0, 1.0, 1.0])])
@pytest.mark.parametrize("kind", KINDS)
def test_torques_along_an_axis_move_the_body_along_it(kind, axis, torque):
    plant = make_plant(kind, 0.01)
    plant.reset(np.zeros(3), np.zeros(3))
    for _ in range(50):
        plant.step(0.02 * np.array(torque), PERIOD)
    assert plant.body_twist[axis] > 0.01
    assert np.abs(np.delete(plant.body_twist, axis)).max() < 1e-6  # a curved law turns the body a little
    # Steady: the torque accelerates body and wheels alike, and the slip is that of the force.
    inertia = MO[axis] + WHEEL_INERTIA * np.sum(JR[:, axis] ** 2) / RADIUS**2
    expected = 0.02 * np.array(torque) @ JR[:, axis] / RADIUS / inertia
    assert plant.accelerations(0.02 * np.array(torque))[0][axis] == pytest.approx(expected, rel=3e-3)
    np.testing.assert_allclose(plant.traction.force(plant.slip_ratio), -plant.wheel_force, rtol=1e-15)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("epsilon", [0.0, *EPSILONS])
def test_rest_stays_rest(kind, epsilon):
    plant = make_plant(kind, epsilon)
    plant.reset([1.0, 2.0, 0.5], np.zeros(3))
    for _ in range(10):
        plant.step(np.zeros(3), PERIOD)
    assert plant.pose.tolist() == [1.0, 2.0, 0.5]
    for value in (plant.body_twist, plant.slip_velocity, plant.wheel_speed, plant.wheel_angle, plant.wheel_force):
        assert not value.any()
    assert not plant.diverged


def test_coasting_body_goes_straight_and_friction_ends_all_slip():
    plant = make_plant("linear", 0.01)
    plant.reset(np.zeros(3), [0.5, 0.0, 0.0], [0.0, 0.02, -0.01])
    for _ in range(200):
        plant.step(np.zeros(3), PERIOD)
    assert np.abs(plant.slip_velocity).max() < 1e-6
    np.testing.assert_allclose(plant.wheel_speed, JR @ plant.body_twist / RADIUS, atol=1e-4)
    assert plant.accelerations(np.zeros(3))[0] == pytest.approx([0.0, 0.0, 0.0], abs=0.02)


def test_slip_at_the_smallest_epsilon_is_that_of_the_rigid_force():
    """The manifold to leading order: λ from σ̇ = 0, with the 3×3 system written anew."""
    epsilon = 4e-11
    plant = make_plant("linear", epsilon)
    plant.reset(np.zeros(3), [0.4, -0.3, 1.0])
    torque = np.array([0.05, -0.1, 0.02])
    plant.step(torque, PERIOD)
    x, y, turn = plant.body_twist
    gram = JR @ np.diag(1.0 / MO) @ JR.T + RADIUS**2 / WHEEL_INERTIA * np.eye(3)
    force = np.linalg.solve(gram, JR @ [-turn * y, turn * x, 0.0] + RADIUS / WHEEL_INERTIA * torque)
    np.testing.assert_allclose(plant.wheel_force, force, rtol=1e-9)
    np.testing.assert_allclose(plant.slip_velocity, -epsilon * (plant.speed + DELTA) * force, rtol=1e-9)


def test_rigid_plant_is_the_limit_of_stiff_ones():
    rigid, stiff = make_plant("magic", 0.0), make_plant("magic", 1e-9)
    for plant in (rigid, stiff):
        plant.reset([0.1, 0.2, 0.3], [0.4, -0.3, 1.0])
        for k in range(100):
            plant.step([0.05 * math.cos(0.1 * k), -0.06, 0.03], PERIOD)
    np.testing.assert_allclose(rigid.body_twist, stiff.body_twist, atol=1e-9)
    np.testing.assert_allclose(rigid.pose, stiff.pose, atol=1e-9)
    np.testing.assert_allclose(rigid.wheel_speed, stiff.wheel_speed, atol=1e-6)
    np.testing.assert_allclose(rigid.wheel_angle, stiff.wheel_angle, atol=1e-7)
    np.testing.assert_allclose(rigid.wheel_force, stiff.wheel_force, rtol=1e-6)
    assert not rigid.slip_ratio.any()


def test_same_inputs_give_the_same_bits_whatever_came_before():
    states = []
    for warm_up in (0, 7):
        plant = make_plant("magic", 0.01)
        rng = np.random.default_rng(9)
        for _ in range(warm_up):
            plant.step([0.2, -0.2, 0.1], PERIOD)
        plant.reset(np.zeros(3), [0.2, 0.0, 0.5], [1e-3, 0.0, 0.0])
        for _ in range(50):
            plant.step(rng.uniform(-0.1, 0.1, 3), PERIOD)
        states.append(b"".join(x.tobytes() for x in (plant.pose, plant.body_twist, plant.slip_velocity)))
    assert states[0] == states[1]


@pytest.mark.parametrize("period", [1e-5, 1e-4, 1e-2, 0.1])
def test_period_may_be_any(period):
    whole, parts = make_plant("magic", 0.01), make_plant("magic", 0.01)
    for plant, pieces in ((whole, 1), (parts, 16)):
        plant.reset(np.zeros(3), [0.2, 0.1, 0.5])
        for _ in range(pieces):
            plant.step([0.03, -0.02, 0.01], period / pieces)
    np.testing.assert_allclose(whole.body_twist, parts.body_twist, atol=1e-7)
    np.testing.assert_allclose(whole.slip_velocity, parts.slip_velocity, atol=1e-8)
    np.testing.assert_allclose(whole.pose, parts.pose, atol=1e-9)


# ------------------------------------------------------------------------------------------------ Counters, failures


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("epsilon", EPSILONS)
@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_work_of_a_tracking_run_is_bounded(kind, epsilon, speed):
    """Measured: 1 to 5 steps and 1 to 10 iterations a period; an explicit method would need 1e8 at the small end."""
    plant = make_plant(kind, epsilon)
    plant.reset(np.zeros(3), [speed, 0.0, 0.3])
    rng = np.random.default_rng(10)
    periods = 200
    for k in range(periods):
        smooth = 0.04 * np.sin(0.02 * k + np.array([0.0, 2.0, 4.0]))
        plant.step(smooth + 0.002 * rng.normal(size=3), PERIOD)
    assert not plant.diverged
    assert periods <= plant.steps <= 7 * periods
    assert plant.rejected <= periods
    assert plant.steps <= plant.newton_iterations <= 16 * periods
    assert plant.njev <= 12 * periods
    assert 3 * plant.steps <= plant.nlu <= 30 * periods
    assert plant.nfev >= 5 * plant.newton_iterations
    if epsilon < 1e-9:
        assert plant.layers_skipped == periods


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_torque_that_is_not_finite_is_divergence(bad):
    plant = make_plant("magic", 0.01)
    plant.reset(np.zeros(3), [0.1, 0.0, 0.0])
    plant.step([0.0, bad, 0.0], PERIOD)
    assert plant.diverged
    plant.step(np.zeros(3), PERIOD)
    assert plant.diverged  # until the reset
    plant.reset(np.zeros(3), np.zeros(3))
    plant.step(np.zeros(3), PERIOD)
    assert not plant.diverged


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
@pytest.mark.parametrize("epsilon", [0.0, 4e-11, 0.1])
def test_state_out_of_bounds_is_divergence_or_survived_but_ends(bad, epsilon):
    plant = make_plant("linear", epsilon)
    plant.reset(np.zeros(3), [bad, 0.0, 1.0])
    plant.step([0.1, 0.0, 0.0], PERIOD)
    assert plant.diverged or np.isfinite(plant.body_twist).all()
    assert plant.diverged or math.isfinite(bad)


def test_arguments_out_of_range_are_refused():
    traction = Traction.of(ROBOT, "linear", 0.01)
    with pytest.raises(OmnibotError, match="delta"):
        Plant(ROBOT, traction, 1.0, 0.0)
    with pytest.raises(OmnibotError, match="speed length"):
        Plant(ROBOT, traction, -1.0)
    with pytest.raises(OmnibotError, match="above 0"):
        Plant(ROBOT, traction).step(np.zeros(3), 0.0)
