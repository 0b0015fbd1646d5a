import math
import re
from itertools import pairwise

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.planner import MAX_SEGMENTS, PATHS, Circle, Lemniscate, PathRequest, plan

HALF_M = 3.14
SIDE_M = HALF_M * math.sqrt(2.0)
VERTICES = np.array([[HALF_M, 0.0], [0.0, HALF_M], [-HALF_M, 0.0], [0.0, -HALF_M]])
CURVES = ("line", "circle", "lemniscate")


def at_ends(segment, derivatives=3):
    """Value and time derivatives of a segment at its start and end, each of shape (derivatives + 1, 3)."""
    ends = []
    for s in (0.0, 1.0):
        powers = np.array([[math.perm(k, d) * s ** max(k - d, 0) for k in range(8)] for d in range(derivatives + 1)])
        scale = (segment.duration_us * 1e-6) ** -np.arange(derivatives + 1.0)
        ends.append(scale[:, None] * (powers @ segment.coefficients.T))
    return ends


def jumps(trajectory, derivatives=3):
    """Jump at each joint between segments, shape (joints, derivatives + 1, 3)."""
    return np.array(
        [at_ends(b, derivatives)[0] - at_ends(a, derivatives)[1] for a, b in pairwise(trajectory.segments)]
    ).reshape(-1, derivatives + 1, 3)


def peak_acceleration(trajectory, samples=101):
    """Largest acceleration in m/s², the middle of each segment included."""
    begin, end = trajectory.joints_us[:-1], trajectory.joints_us[1:]
    time_s = np.linspace(begin, end, samples)[:-1].ravel() * 1e-6
    return np.max(np.linalg.norm(trajectory.evaluate(time_s)[:, 2, :2], axis=1))


def seconds(trajectory):
    return trajectory.duration_us * 1e-6


def assert_at_rest(segment, end):
    np.testing.assert_allclose(at_ends(segment, 2)[end][1:], 0.0, atol=1e-9)


# ------------------------------------------------------------------------------------------------- rhombus: lap


@pytest.mark.parametrize("corner", ["sharp", "rounded"])
@pytest.mark.parametrize("speed", [0.0234, 0.0936, 0.5, 2.0])
def test_rhombus_lap_starts_and_ends_at_rest_at_its_first_vertex(speed, corner):
    trajectory = plan(PathRequest("rhombus", speed, corner))
    assert_at_rest(trajectory.segments[0], 0)
    assert_at_rest(trajectory.segments[-1], 1)
    for segment, end in ((trajectory.segments[0], 0), (trajectory.segments[-1], 1)):
        np.testing.assert_allclose(at_ends(segment)[end][0], [HALF_M, 0.0, 0.0], atol=1e-12)
    ramp_s = 1.5 * speed / 2.0
    assert seconds(trajectory) == pytest.approx(4.0 * SIDE_M / speed + ramp_s, abs=1e-5)


@pytest.mark.parametrize("speed", [0.0234, 0.0936, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("accel", [2.0, 3.7])
def test_rhombus_rounded_is_continuous_up_to_acceleration(speed, accel):
    trajectory = plan(PathRequest("rhombus", speed, "rounded", accel))
    np.testing.assert_allclose(jumps(trajectory, 2), 0.0, atol=1e-12)


@pytest.mark.parametrize("speed", [0.0234, 0.0936, 0.5, 1.0, 2.0])
def test_rhombus_sharp_jumps_in_velocity_at_its_three_corners_only(speed):
    trajectory = plan(PathRequest("rhombus", speed, "sharp"))
    jump = jumps(trajectory, 2)
    np.testing.assert_allclose(jump[:, [0, 2]], 0.0, atol=1e-12)
    magnitude = np.linalg.norm(jump[:, 1], axis=1)
    corners = np.flatnonzero(magnitude > 1e-9)
    np.testing.assert_allclose(magnitude[corners], math.sqrt(2.0) * speed, rtol=1e-5)
    at_corner = trajectory.evaluate(trajectory.joints_us[corners + 1] * 1e-6)[:, 0, :2]
    np.testing.assert_allclose(at_corner, VERTICES[1:], atol=1e-12)


@pytest.mark.parametrize("corner", ["sharp", "rounded"])
@pytest.mark.parametrize("accel", [0.7, 2.0, 5.3])
def test_rhombus_peak_acceleration_is_the_one_asked_for(accel, corner):
    speed = 1.0
    peak = peak_acceleration(plan(PathRequest("rhombus", speed, corner, accel)))
    shortest_us = 1.5 * speed / accel * 1e6
    assert accel * (1.0 - 2.0 / shortest_us - 1e-12) <= peak <= accel * (1.0 + 1e-12)  # 2 µs: rounding of the ramp


@pytest.mark.parametrize("corner", ["sharp", "rounded"])
def test_rhombus_peak_acceleration_of_long_ramps_is_exact_to_a_millionth(corner):
    assert peak_acceleration(plan(PathRequest("rhombus", 1.0, corner, 0.7))) == pytest.approx(0.7, rel=1e-6)


def test_corner_that_takes_a_whole_side_fits_into_a_segment():
    trajectory = plan(PathRequest("rhombus", 0.0074, "rounded", 2.62e-5))  # 599.1 s of 600.2 s
    assert peak_acceleration(trajectory) == pytest.approx(2.62e-5, rel=1e-6)


def test_rhombus_speed_is_the_one_asked_for_to_a_millionth():
    for speed in (0.0234, 0.5, 2.0):
        trajectory = plan(PathRequest("rhombus", speed, "sharp"))
        straight = trajectory.segments[1]
        assert np.linalg.norm(at_ends(straight)[0][1]) == pytest.approx(speed, rel=1e-6)


def test_rhombus_goes_counter_clockwise_with_heading_0():
    trajectory = plan(PathRequest("rhombus", 1.0))
    y = trajectory.evaluate(np.linspace(0.0, seconds(trajectory), 500))
    angle = np.unwrap(np.arctan2(y[:, 0, 1], y[:, 0, 0]))
    assert np.all(np.diff(angle) > -1e-12)
    assert angle[-1] - angle[0] == pytest.approx(2.0 * math.pi)
    np.testing.assert_array_equal(y[:, :, 2], 0.0)


def test_rhombus_rounded_cuts_the_corner_by_its_closed_form():
    # by symmetry the middle of the blend lies |∫ velocity difference| = 3/32 |v2 - v1| T off the corner
    speed, accel = 0.5, 2.0
    trajectory = plan(PathRequest("rhombus", speed, "rounded", accel, start_before_corner_s=2.0))
    jump = math.sqrt(2.0) * speed
    nearest = np.linalg.norm(trajectory.evaluate([2.0])[0, 0, :2] - VERTICES[1])
    assert nearest == pytest.approx(3.0 / 32.0 * jump * 1.5 * jump / accel, rel=1e-5)
    assert trajectory.path.distance(trajectory.evaluate([2.0])[:, 0, :2])[0] == pytest.approx(nearest / math.sqrt(2.0))


def test_rhombus_rounded_is_on_the_sharp_path_in_time_outside_blends():
    moving = {"corner_accel_m_per_s2": 2.0, "duration_s": 20.0, "start_before_corner_s": 2.0}
    sharp, rounded = (plan(PathRequest("rhombus", 0.5, corner, **moving)) for corner in ("sharp", "rounded"))
    blend_s = 1.5 * math.sqrt(2.0) * 0.5 / 2.0
    corner_s = 2.0 + SIDE_M / 0.5 * np.arange(3.0)
    time_s = np.linspace(0.0, 20.0, 2001)
    outside = np.all(np.abs(time_s[:, None] - corner_s) > blend_s / 2.0 + 1e-4, axis=1)
    assert 0.9 < np.mean(outside) < 1.0
    difference = rounded.evaluate(time_s)[outside] - sharp.evaluate(time_s)[outside]
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)


# -------------------------------------------------------------------------------- rhombus: start before the corner


@pytest.mark.parametrize("speed", [0.0234, 0.0936, 1.0])
@pytest.mark.parametrize("before_s", [2.0, 1.234567])
def test_start_before_corner_sharp_reaches_the_corner_then(speed, before_s):
    trajectory = plan(PathRequest("rhombus", speed, "sharp", duration_s=4.5, start_before_corner_s=before_s))
    start, corner = trajectory.evaluate([0.0, before_s])[:, :, :2]
    direction = np.array([-1.0, 1.0]) / math.sqrt(2.0)
    np.testing.assert_allclose(start[1], speed * direction, rtol=1e-6)
    np.testing.assert_allclose(corner[0], VERTICES[1], atol=1e-12)
    np.testing.assert_allclose(corner[1], speed * np.array([-1.0, -1.0]) / math.sqrt(2.0), rtol=1e-6)
    assert trajectory.evaluate([before_s - 1e-6])[0, 1, 1] > 0.0  # still on the first side
    assert trajectory.duration_us == 4_500_000
    assert_at_rest(trajectory.segments[-1], 1)


def test_start_before_corner_lap_ends_where_it_started():
    trajectory = plan(PathRequest("rhombus", 0.5, start_before_corner_s=3.0))
    first, last = trajectory.evaluate([0.0, seconds(trajectory)])[:, 0]
    np.testing.assert_allclose(last, first, atol=1e-12)
    assert_at_rest(trajectory.segments[-1], 1)
    assert seconds(trajectory) == pytest.approx(4.0 * SIDE_M / 0.5 + 0.5 * 1.5 * 0.5 / 2.0, abs=1e-5)


def test_start_before_corner_at_its_bounds():
    speed, accel = 0.5, 2.0
    blend_s = 1.5 * math.sqrt(2.0) * speed / accel
    for before_s in (SIDE_M / speed - 1e-6, blend_s / 2.0 + 2e-6):
        trajectory = plan(PathRequest("rhombus", speed, "rounded", accel, start_before_corner_s=before_s))
        np.testing.assert_allclose(jumps(trajectory, 2), 0.0, atol=1e-12)


# --------------------------------------------------------------------------------------- rhombus: end of the run


@pytest.mark.parametrize("corner", ["sharp", "rounded"])
def test_end_in_a_corner_stops_at_the_vertex_and_waits(corner):
    speed, before_s = 1.0, 3.0
    ramp_s = 1.5 * speed / 2.0
    blend_s = ramp_s * math.sqrt(2.0) if corner == "rounded" else 0.0
    for duration_s in np.linspace(before_s + ramp_s / 2.0 + 1e-4, before_s + blend_s / 2.0 + ramp_s - 1e-4, 7):
        trajectory = plan(PathRequest("rhombus", speed, corner, duration_s=duration_s, start_before_corner_s=before_s))
        assert trajectory.duration_us == round(duration_s * 1e6)
        np.testing.assert_allclose(jumps(trajectory, 2), 0.0, atol=1e-12)  # not even a sharp corner is passed
        rests_s = before_s + ramp_s / 2.0 + 1e-5
        y = trajectory.evaluate(np.linspace(rests_s, duration_s, 20))
        np.testing.assert_allclose(y[:, 0, :2], np.tile(VERTICES[1], (20, 1)), atol=1e-12)
        np.testing.assert_allclose(y[:, 1:], 0.0, atol=1e-12)


@pytest.mark.parametrize("corner", ["sharp", "rounded"])
def test_end_just_before_and_after_a_corner_does_not_wait(corner):
    speed, before_s = 1.0, 3.0
    ramp_s = 1.5 * speed / 2.0
    blend_s = ramp_s * math.sqrt(2.0) if corner == "rounded" else 0.0
    for duration_s in (before_s + ramp_s / 2.0 - 1e-5, before_s + blend_s / 2.0 + ramp_s + 1e-5):
        trajectory = plan(PathRequest("rhombus", speed, corner, duration_s=duration_s, start_before_corner_s=before_s))
        assert trajectory.segments[-1].duration_us == pytest.approx(ramp_s * 1e6, abs=2)
        assert np.linalg.norm(at_ends(trajectory.segments[-1])[0][1]) == pytest.approx(speed, rel=1e-6)


def test_long_duration_goes_on_lapping():
    trajectory = plan(PathRequest("rhombus", 1.0, duration_s=60.0))
    y = trajectory.evaluate(np.linspace(0.0, 60.0, 6001))[:, 0]
    turns = np.unwrap(np.arctan2(y[:, 1], y[:, 0]))[-1] / (2.0 * math.pi)
    assert turns == pytest.approx((60.0 - 0.75) / (4.0 * SIDE_M), abs=0.03)
    assert trajectory.duration_us == 60_000_000


def test_slow_run_splits_what_does_not_fit_into_a_segment():
    trajectory = plan(PathRequest("rhombus", 0.005))  # a side of 888 s, a segment holds 600 s
    np.testing.assert_allclose(jumps(trajectory, 2), 0.0, atol=1e-10)
    assert len(trajectory.segments) > 12


# ---------------------------------------------------------------------------------------------------------- curves


@pytest.mark.parametrize("path", CURVES)
@pytest.mark.parametrize("speed", [0.0234, 0.5, 2.0])
def test_curve_is_continuous_up_to_third_derivative_and_ends_at_rest(path, speed):
    trajectory = plan(PathRequest(path, speed))
    accel = 2.0
    jerk = accel**2 / speed
    np.testing.assert_allclose(jumps(trajectory) / np.array([1.0, speed, accel, jerk])[:, None], 0.0, atol=1e-12)
    assert_at_rest(trajectory.segments[0], 0)
    assert_at_rest(trajectory.segments[-1], 1)


@pytest.mark.parametrize("path", CURVES)
@pytest.mark.parametrize("speed", [0.0234, 0.5, 2.0])
def test_curve_stays_on_its_path_at_constant_speed(path, speed):
    trajectory = plan(PathRequest(path, speed))
    ramp_s = 1.875 * speed / 2.0
    time_s = np.linspace(0.0, seconds(trajectory), 3001)
    y = trajectory.evaluate(time_s)
    assert np.max(trajectory.path.distance(y[:, 0, :2])) < 2e-7
    assert np.max(trajectory.path.distance(trajectory.rounded().evaluate(time_s)[:, 0, :2])) < 1e-6
    cruise = (time_s > ramp_s) & (time_s < time_s[-1] - ramp_s)
    np.testing.assert_allclose(np.linalg.norm(y[cruise, 1, :2], axis=1), speed, rtol=1e-5)


def test_line_goes_along_x1_for_4_m():
    trajectory = plan(PathRequest("line", 0.5))
    y = trajectory.evaluate(np.linspace(0.0, seconds(trajectory), 101))
    np.testing.assert_allclose(y[[0, -1], 0], [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_array_equal(y[:, :, 1:], 0.0)
    assert peak_acceleration(trajectory, samples=2001) == pytest.approx(2.0, rel=1e-4)


def test_line_is_as_long_as_the_duration_needs():
    trajectory = plan(PathRequest("line", 0.5, duration_s=10.0))
    length_m = 0.5 * (10.0 - 1.875 * 0.5 / 2.0)
    assert trajectory.evaluate([10.0])[0, 0, 0] == pytest.approx(length_m, abs=1e-5)
    np.testing.assert_allclose(trajectory.path.outline(), [[0.0, 0.0], [length_m, 0.0]], atol=1e-5)


def test_circle_lap_matches_the_analytic_one_in_every_derivative():
    speed = 0.5
    trajectory = plan(PathRequest("circle", speed))
    ramp_s = 1.875 * speed / 2.0
    time_s = np.linspace(ramp_s + 0.01, seconds(trajectory) - ramp_s - 0.01, 1000)
    phase = speed * (time_s - ramp_s / 2.0)
    y = trajectory.evaluate(time_s)
    for order in range(4):
        expected = speed**order * np.stack(
            [np.cos(phase + order * np.pi / 2.0), np.sin(phase + order * np.pi / 2.0)], axis=1
        )
        np.testing.assert_allclose(y[:, order, :2], expected, atol=3e-5)
    np.testing.assert_allclose(y[:, 0, :2], np.stack([np.cos(phase), np.sin(phase)], axis=1), atol=1e-6)


def test_lemniscate_starts_right_upwards_and_crosses_the_origin():
    trajectory = plan(PathRequest("lemniscate", 0.5))
    y = trajectory.evaluate(np.linspace(0.0, seconds(trajectory), 2001))[:, 0]
    np.testing.assert_allclose(y[[0, -1], :2], [[1.5, 0.0]] * 2, atol=1e-12)
    np.testing.assert_allclose(y[1000, :2], [-1.5, 0.0], atol=1e-3)
    assert y[100, 1] > 0.0
    # Bernoulli: (x² + y²)² = a² (x² - y²)
    x1, x2 = y[:, 0], y[:, 1]
    np.testing.assert_allclose((x1**2 + x2**2) ** 2, 1.5**2 * (x1**2 - x2**2), atol=1e-6)


def test_lemniscate_length_is_gauss_constant():
    assert Lemniscate(2.0).length_m == pytest.approx(2.0 * 2.0 * 2.622057554292119, rel=1e-15)


def test_lemniscate_derivatives_match_finite_differences():
    curve, step_m = Lemniscate(1.5), 1e-5
    distance = np.linspace(-1.0, 9.0, 101)
    slope = (curve.derivatives(distance + step_m) - curve.derivatives(distance - step_m)) / (2.0 * step_m)
    np.testing.assert_allclose(slope[:, :3], curve.derivatives(distance)[:, 1:], atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(curve.derivatives(distance)[:, 1], axis=1), 1.0, rtol=1e-14)


def test_circle_distance_hand_cases():
    points = np.array([[1.0, 0.0], [0.0, 0.0], [3.0, 4.0], [0.0, -0.5]])
    np.testing.assert_allclose(Circle(1.0).distance(points), [0.0, 1.0, 4.0, 0.5], atol=1e-15)


def test_lemniscate_distance_hand_cases():
    points = np.array([[1.5, 0.0], [0.0, 0.0], [2.5, 0.0], [-1.6, 0.0], [0.0, 0.0005]])
    np.testing.assert_allclose(Lemniscate(1.5).distance(points), [0.0, 0.0, 1.0, 0.1, 0.0005 / 2**0.5], atol=1e-9)


def test_lemniscate_distance_matches_a_fine_polyline_everywhere():
    curve = Lemniscate(1.5)
    vertices = curve.derivatives(np.linspace(0.0, curve.length_m, 20001))[:, 0]
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (100, 2))
    brute = np.array([np.min(np.hypot(*(vertices - point).T)) for point in points])
    np.testing.assert_allclose(curve.distance(points), brute, atol=1e-5)


@pytest.mark.parametrize("path", CURVES)
def test_curve_outline_lies_on_the_path(path):
    drawn = plan(PathRequest(path, 0.5)).path
    assert np.max(drawn.distance(drawn.outline())) < 1e-12


# ---------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"path": "spiral"},
            "unknown path 'spiral'; there are: rhombus, line, circle, lemniscate, square, FILE.csv, FILE.toml",
        ),
        ({"profile": "slow"}, "unknown profile 'slow'; there are: steady, fastest"),
        ({"path": "square", "profile": "steady"}, "square can't be driven at a steady speed; leave the profile out"),
        (
            {"profile": "fastest", "start_before_corner_s": 1.0},
            "start_before_corner_s needs a path with corners (rhombus); rhombus must be driven steadily for it",
        ),
        ({"corner_cut_m": 0.0}, "corner_cut_m = 0 must be a number above 0"),
        (
            {"profile": "fastest", "corner_cut_m": 1.0},
            "corner_cut_m = 1 leaves nothing of a side of 4.441 m: at most 0.4906",
        ),
        ({"corner": "round"}, "unknown corner 'round'; there are: sharp, rounded"),
        ({"speed_m_per_s": -0.5}, "speed_m_per_s = -0.5 must be a number above 0, from 1e-06 to 1e+06"),
        ({"speed_m_per_s": 0.0}, "speed_m_per_s = 0 must be"),
        ({"speed_m_per_s": math.nan}, "speed_m_per_s = nan must be"),
        ({"speed_m_per_s": math.inf}, "speed_m_per_s = inf must be"),
        ({"speed_m_per_s": 1e-320}, "speed_m_per_s = 9.99989e-321 must be"),
        ({"duration_s": 0.0}, "duration_s = 0 must be"),
        ({"duration_s": -1.0}, "duration_s = -1 must be"),
        ({"duration_s": math.inf}, "duration_s = inf must be"),
        ({"duration_s": 1e300}, "duration_s = 1e+300 must be"),
        ({"corner_accel_m_per_s2": 0.0}, "corner_accel_m_per_s2 = 0 must be"),
        ({"corner_accel_m_per_s2": -2.0}, "corner_accel_m_per_s2 = -2 must be"),
        ({"corner_accel_m_per_s2": math.nan}, "corner_accel_m_per_s2 = nan must be"),
        ({"start_before_corner_s": 0.0}, "start_before_corner_s = 0 must be"),
        ({"start_before_corner_s": math.nan}, "start_before_corner_s = nan must be"),
        (
            {"path": "circle", "start_before_corner_s": 1.0},
            "start_before_corner_s needs a path with corners (rhombus); circle has none",
        ),
        (
            {"start_before_corner_s": 60.0},
            "start_before_corner_s = 60 is too long: the side lasts 8.881261 s; at most that",
        ),
        (
            {"start_before_corner_s": 0.1},
            "start_before_corner_s = 0.1 is too short: the rounded corner begins 0.265166 s before its time; "
            "at least that",
        ),
        (
            {"speed_m_per_s": 5.0},
            "speed_m_per_s = 5 is too high for a side of 4.441 m: at most 2.045 m/s, "
            "or corner_accel_m_per_s2 of at least 11.95",
        ),
        (
            {"speed_m_per_s": 5.0, "corner": "sharp"},
            "speed_m_per_s = 5 is too high for a side of 4.441 m: at most 2.433 m/s, "
            "or corner_accel_m_per_s2 of at least 8.447",
        ),
        (
            {"speed_m_per_s": 50.0, "corner_accel_m_per_s2": 1e6},
            "speed_m_per_s = 50 is too high for a side of 4.441 m: at most 44.4 m/s",
        ),
        (
            {"path": "circle", "speed_m_per_s": 3.0},
            "speed_m_per_s = 3 is too high for a lap of 6.283 m: at most 2.588 m/s, "
            "or corner_accel_m_per_s2 of at least 2.687",
        ),
        (
            {"path": "line", "speed_m_per_s": 3.0},
            "speed_m_per_s = 3 is too high for the line of 4 m: at most 2.065 m/s, "
            "or corner_accel_m_per_s2 of at least 4.22",
        ),
        (
            {"duration_s": 0.5},
            "duration_s = 0.5 is too short: to reach 0.5 m/s and stop takes 0.75",
        ),
        (
            {"path": "line", "duration_s": 0.5},
            "duration_s = 0.5 is too short: to reach 0.5 m/s and stop takes 0.9375 s or more",
        ),
        ({"speed_m_per_s": 2e-3, "corner_accel_m_per_s2": 1e-6}, "is too high for a side of 4.441 m: at most 0.001446"),
        (
            {"speed_m_per_s": 1e-6},
            "is too long: the firmware stores 128 segments and at most 3600 s, enough for 3600 s",
        ),
        (
            {"duration_s": 1000.0},
            "duration_s = 1000 is too long: the firmware stores 128 segments and at most 3600 s, enough for ",
        ),
        (
            {"speed_m_per_s": 1e-3, "corner_accel_m_per_s2": 2e-6},
            "corner_accel_m_per_s2 = 2e-06 makes a ramp or corner of 1060.660172 s, longer than a segment's 600 s: "
            "at least 3.536e-06 at this speed",
        ),
        ({"path": "circle", "duration_s": 1e6}, "duration_s = 1000000 is too long: the firmware stores 128 segments"),
    ],
)
def test_bad_request_is_refused_in_one_line(changes, message):
    with pytest.raises(OmnibotError) as error:
        plan(PathRequest(**{"path": "rhombus", "speed_m_per_s": 0.5} | changes))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def refusal(**request):
    with pytest.raises(OmnibotError) as error:
        plan(PathRequest(**request))
    return str(error.value)


def number_after(text, phrase):
    return float(re.search(re.escape(phrase) + r" ([0-9.e+-]+)", text)[1])


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("accel", [0.013, 2.0, 300.0])
def test_speed_and_acceleration_named_by_a_refusal_work(path, accel):
    text = refusal(path=path, speed_m_per_s=39.0, corner_accel_m_per_s2=accel)
    fastest, least = number_after(text, "at most"), number_after(text, "at least")
    plan(PathRequest(path, fastest, corner_accel_m_per_s2=accel))
    plan(PathRequest(path, 39.0, corner_accel_m_per_s2=least))
    refusal(path=path, speed_m_per_s=fastest * 1.002, corner_accel_m_per_s2=accel)
    refusal(path=path, speed_m_per_s=39.0, corner_accel_m_per_s2=least * 0.997)


@pytest.mark.parametrize("corner", ["sharp", "rounded"])
def test_acceleration_named_by_a_refusal_of_slow_ramps_works(corner):
    request = {"path": "rhombus", "speed_m_per_s": 1e-3, "corner": corner, "duration_s": 1300.0}
    least = number_after(refusal(**request, corner_accel_m_per_s2=1.5e-6), "at least")
    plan(PathRequest(**request, corner_accel_m_per_s2=least))
    refusal(**request, corner_accel_m_per_s2=least * 0.997)


def test_start_named_by_a_refusal_works():
    text = refusal(path="rhombus", speed_m_per_s=0.3, start_before_corner_s=99.0)
    longest_s = number_after(text, "the side lasts")
    plan(PathRequest("rhombus", 0.3, start_before_corner_s=longest_s))
    refusal(path="rhombus", speed_m_per_s=0.3, start_before_corner_s=longest_s + 1e-6)
    text = refusal(path="rhombus", speed_m_per_s=0.3, start_before_corner_s=0.01)
    least_s = number_after(text, "corner begins")
    plan(PathRequest("rhombus", 0.3, start_before_corner_s=least_s))
    refusal(path="rhombus", speed_m_per_s=0.3, start_before_corner_s=least_s - 1e-6)


@pytest.mark.parametrize("path", PATHS)
def test_durations_named_by_a_refusal_work(path):
    text = refusal(path=path, speed_m_per_s=0.5, duration_s=9e5)
    longest_s = number_after(text, "enough for")
    assert len(plan(PathRequest(path, 0.5, duration_s=longest_s)).segments) <= MAX_SEGMENTS
    refusal(path=path, speed_m_per_s=0.5, duration_s=longest_s + 1e-6)
    text = refusal(path=path, speed_m_per_s=0.5, duration_s=1e-3)
    shortest_s = number_after(text, "stop takes")
    plan(PathRequest(path, 0.5, duration_s=shortest_s))
    refusal(path=path, speed_m_per_s=0.5, duration_s=shortest_s - 1e-6)


def test_too_short_to_stop_before_the_corner_names_the_time_behind_it():
    request = {"path": "rhombus", "speed_m_per_s": 1.0, "corner": "sharp", "start_before_corner_s": 0.2}
    shortest_s = number_after(refusal(**request, duration_s=0.5), "stop takes")
    assert shortest_s == pytest.approx(0.2 + 0.75, abs=1e-5)
    plan(PathRequest(**request, duration_s=shortest_s))


# ------------------------------------------------------------------------------------------------- random requests


def random_request(rng):
    path = str(rng.choice(["rhombus", "rhombus", *CURVES]))
    speed, accel = float(np.exp(rng.uniform(-4.0, 0.6))), float(np.exp(rng.uniform(0.7, 2.5)))
    corner = str(rng.choice(["sharp", "rounded"]))
    before = path == "rhombus" and rng.random() < 0.6
    blend_s = 1.5 * math.sqrt(2.0) * speed / accel
    before_s = rng.uniform(blend_s / 2.0 + 1e-5, SIDE_M / speed - 1e-5) if before else None
    least_s = (before_s or 0.0) + 2.0 * blend_s
    duration_s = None if rng.random() < 0.3 else least_s + rng.uniform(0.0, 40.0 / speed)
    return PathRequest(path, speed, corner, accel, duration_s, before_s)


@pytest.mark.parametrize("seed", range(150))
def test_random_request_keeps_every_promise(seed):
    request = random_request(np.random.default_rng(seed))
    trajectory = plan(request)
    speed, accel = request.speed_m_per_s, request.corner_accel_m_per_s2
    if request.duration_s is not None:
        assert trajectory.duration_us == round(request.duration_s * 1e6)
    assert len(trajectory.segments) <= MAX_SEGMENTS
    assert_promised_continuity(trajectory, request)
    y = trajectory.evaluate(np.linspace(0.0, seconds(trajectory), 1500))
    assert np.max(np.linalg.norm(y[:, 1, :2], axis=1)) <= speed * (1.0 + 2e-5)
    assert np.max(trajectory.path.distance(y[:, 0, :2])) <= allowed_deviation(request)
    assert np.all(np.isfinite(trajectory.rounded().evaluate([0.0, 1.0])))
    assert_at_rest(trajectory.segments[-1], 1)
    if request.start_before_corner_s is None:
        assert_at_rest(trajectory.segments[0], 0)
    if request.path == "rhombus":
        assert peak_acceleration(trajectory, 21) <= accel * (1.0 + 1e-9)


def assert_promised_continuity(trajectory, request):
    jump = np.abs(jumps(trajectory))
    assert np.max(jump[:, 0]) < 1e-10
    assert np.max(jump[:, 2]) < 1e-6
    if request.path != "rhombus" or request.corner == "rounded":
        assert np.max(jump[:, 1]) < 1e-9
    else:
        at_joint = trajectory.evaluate(trajectory.joints_us[1:-1] * 1e-6)[:, 0, :2]
        to_vertex = np.min(np.linalg.norm(at_joint[:, None] - VERTICES, axis=2), axis=1)
        assert np.max(to_vertex[np.max(jump[:, 1], axis=1) > 1e-9], initial=0.0) < 1e-9


def allowed_deviation(request):
    """Largest distance from the path, m: of the middle of a blend, by its closed form."""
    if request.path == "rhombus" and request.corner == "rounded":
        return 3.0 / 32.0 * 1.5 * 2.0 * request.speed_m_per_s**2 / request.corner_accel_m_per_s2 / 2**0.5 + 1e-5
    return 2e-7
