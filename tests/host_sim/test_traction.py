import math

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.robot import load_robot
from host_sim.traction import Traction

ROBOT = load_robot()
EPSILONS = [4e-11, 5e-5, 1e-2, 0.1, 1.0]


def paper_formula(traction: Traction, slip: np.ndarray) -> np.ndarray:
    """(4) as printed, with B from the slope 1/ε at zero slip."""
    peak, c, e = traction.friction_limit_N, traction.shape, traction.curvature
    b = 1.0 / (traction.epsilon * c * peak)
    return peak * np.sin(c * np.arctan(b * slip - e * (b * slip - np.arctan(b * slip))))


@pytest.mark.parametrize("epsilon", EPSILONS)
def test_linear_force_is_slip_over_epsilon(epsilon):
    slip = np.array([-0.3, 0.0, 0.1])
    np.testing.assert_allclose(Traction.of(ROBOT, "linear", epsilon).force(slip), slip / epsilon, rtol=1e-15)


@pytest.mark.parametrize("epsilon", EPSILONS)
def test_magic_force_is_the_papers_formula(epsilon):
    traction = Traction.of(ROBOT, "magic", epsilon)
    slip = epsilon * np.array([-1e6, -40.0, -3.0, 0.0, 0.1, 1.0, 8.0, 15.0, 100.0, 1e9])
    np.testing.assert_allclose(traction.force(slip), paper_formula(traction, slip), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("kind", ["linear", "magic"])
@pytest.mark.parametrize("epsilon", EPSILONS)
def test_slope_is_the_derivative_of_the_force(kind, epsilon):
    traction = Traction.of(ROBOT, kind, epsilon)
    slip = epsilon * np.concatenate([-np.geomspace(1e-3, 1e4, 15), [0.0], np.geomspace(1e-3, 1e4, 15)])
    step = 1e-5 * (np.abs(slip) + epsilon)
    numeric = (traction.force(slip + step) - traction.force(slip - step)) / (2.0 * step)
    # The largest slope is the scale of the rounding in the difference.
    np.testing.assert_allclose(traction.slope(slip), numeric, rtol=1e-6, atol=1e-9 / epsilon)


@pytest.mark.parametrize("kind", ["linear", "magic"])
def test_slope_at_zero_slip_is_one_over_epsilon(kind):
    assert float(Traction.of(ROBOT, kind, 0.01).slope(0.0)) == pytest.approx(100.0, rel=1e-14)


def test_magic_force_peaks_at_the_friction_limit_and_falls_beyond():
    traction = Traction.of(ROBOT, "magic", 0.01)
    peak = traction.peak_slip
    forces = traction.force(peak * np.array([0.5, 0.99, 1.0, 1.01, 2.0]))
    assert forces[2] == pytest.approx(ROBOT.friction_limit_N, rel=1e-14)
    assert np.all(np.diff(forces[:3]) > 0.0)
    assert np.all(np.diff(forces[2:]) < 0.0)


def test_magic_force_of_a_locked_wheel_is_finite():
    traction = Traction.of(ROBOT, "magic", 4e-11)
    floor = ROBOT.friction_limit_N * math.sin(ROBOT.magic_shape * math.pi / 2.0)
    np.testing.assert_allclose(traction.force([1e3, -1e300]), [floor, -floor], rtol=1e-9)


@pytest.mark.parametrize("kind", ["linear", "magic"])
def test_force_is_odd_and_keeps_the_shape(kind):
    traction = Traction.of(ROBOT, kind, 0.01)
    slip = np.random.default_rng(2).normal(size=(4, 3)).T  # not contiguous
    assert traction.force(slip).shape == (3, 4)
    np.testing.assert_array_equal(traction.force(-slip), -traction.force(slip))
    assert traction.force(slip)[1, 2] == traction.force(slip[1, 2])
    assert math.isnan(float(traction.force(math.nan)))


def test_linear_curve_has_no_peak():
    assert Traction.of(ROBOT, "linear", 0.01).peak_slip == math.inf


def test_epsilon_zero_is_rigid():
    assert Traction.of(ROBOT, "magic", 0.0).rigid
    assert not Traction.of(ROBOT, "magic", 4e-11).rigid


@pytest.mark.parametrize("epsilon", [-1e-9, 1.0001, math.nan, math.inf])
def test_epsilon_out_of_range_is_refused_by_its_range(epsilon):
    with pytest.raises(OmnibotError, match=r"epsilon = .* is outside 0 … 1"):
        Traction.of(ROBOT, "linear", epsilon)


def test_unknown_kind_is_refused_by_the_known_ones():
    with pytest.raises(OmnibotError, match="linear, magic"):
        Traction.of(ROBOT, "pacejka", 0.01)


def test_curve_constants_out_of_range_are_refused():
    with pytest.raises(OmnibotError, match="shape"):
        Traction("magic", 0.01, shape=2.5)
    with pytest.raises(OmnibotError, match="above 0 N"):
        Traction("magic", 0.01, friction_limit_N=0.0)
