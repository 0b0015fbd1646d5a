"""Drives as fast as limits allow, against an examiner of their own.

The polynomials as sent are sampled densely, the wheels follow from differences of the robot's place, the time is held
against closed forms and TOPP-RA.
"""

import math
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint

from host_sim.errors import OmnibotError
from host_sim.limits import Limits, free_speed, robot_limits
from host_sim.planner import MAX_SEGMENTS, NAMED_PATHS, PathRequest, plan, plan_with_limits
from host_sim.robot import load_robot

ROBOT = load_robot()
USUAL = Limits(2.0, 40.0, free_speed(ROBOT), 3.5, 0.2, 1.0)
TOLERANCE = 2e-3  # of a limit


def samples(trajectory, derivatives=4, per_segment=200):
    """Instants of every segment, and the output and its derivatives there by numpy's polynomials, shape (n, d, 3)."""
    time_s, values = [], []
    for begin_us, segment in zip(trajectory.joints_us, trajectory.segments, strict=False):
        duration_s = segment.duration_us * 1e-6
        inner_s = np.linspace(0.0, duration_s, per_segment)
        axes = [np.polynomial.Polynomial(c, domain=[0.0, duration_s], window=[0.0, 1.0]) for c in segment.coefficients]
        values.append([[axis.deriv(d)(inner_s) if d else axis(inner_s) for axis in axes] for d in range(derivatives)])
        time_s.append(begin_us * 1e-6 + inner_s)
    return np.concatenate(time_s), np.concatenate(np.array(values).transpose(0, 3, 1, 2))


def place_of(polynomials, time_s):
    """Centre in the world and heading, shape (n, 3); the tracked point is ahead of it on the body's second axis."""
    p1, p2, heading = (axis(time_s) for axis in polynomials)
    offset = ROBOT.tracked_point_offset_m
    return np.stack([p1 + offset * np.sin(heading), p2 - offset * np.cos(heading), heading], axis=1)


def wheels_by_differences(trajectory, step_s=1e-4):
    """Wheel speed, force and torque, each of shape (n, 3), by differences of the robot's place."""
    wheels = [wheels_of(segment, step_s) for segment in trajectory.segments]
    return tuple(np.concatenate(parts) for parts in zip(*wheels, strict=True))


def wheels_of(segment, step_s):
    duration_s = segment.duration_us * 1e-6
    axes = [np.polynomial.Polynomial(c, domain=[0.0, duration_s], window=[0.0, 1.0]) for c in segment.coefficients]
    time_s = np.linspace(0.0, duration_s, 25)
    before, here, after = (place_of(axes, time_s + shift) for shift in (-step_s, 0.0, step_s))
    load = (after - 2.0 * here + before) / step_s**2 * [ROBOT.mass_kg, ROBOT.mass_kg, ROBOT.yaw_inertia_kg_m2]
    # Σ direction · force = load of the centre, Σ b · force = moment.
    force = np.linalg.solve(directions(here[:, 2]), load[:, :, None])[:, :, 0]
    speed = (rolled(before, here) + rolled(here, after)) / (2.0 * step_s)
    spin_up = (rolled(here, after) - rolled(before, here)) / step_s**2
    return speed, force, ROBOT.wheel_radius_m * force + ROBOT.wheel_inertia_kg_m2 * spin_up


def directions(heading):
    """Drive direction of each wheel in the world and its lever arm, as columns, shape (n, 3, 3): the paper's Fig. 1."""
    angle = heading[:, None] + np.radians([150.0, 270.0, 30.0])
    return np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, ROBOT.wheel_distance_m)], axis=1)


def rolled(before, after):
    """Angle that rolling wheels turn by from place to place, shape (n, 3), rad."""
    moved = np.einsum("nij,ni->nj", directions(0.5 * (before + after)[:, 2]), after - before)
    return moved / ROBOT.wheel_radius_m


def largest(trajectory):
    """What is asked at most of each quantity, by the names of Limits."""
    _, y = samples(trajectory)
    scaled = y * [1.0, 1.0, ROBOT.wheel_distance_m]
    sizes = np.max(np.maximum(np.hypot(scaled[..., 0], scaled[..., 1]), np.abs(scaled[..., 2])), axis=0)
    speed, force, torque = (float(np.max(np.abs(wheel))) for wheel in wheels_by_differences(trajectory))
    return {
        "speed_m_per_s": sizes[1],
        "accel_m_per_s2": sizes[2],
        "jerk_m_per_s3": sizes[3],
        "wheel_speed_rad_per_s": speed,
        "wheel_force_N": force,
        "wheel_torque_Nm": torque,
    }


def assert_keeps(trajectory, limits):
    """Every limit holds; returns the one that is used most, and by how much."""
    asked = largest(trajectory)
    share = {name: asked[name] / limit for name, limit in asdict(limits).items() if limit is not None}
    for name, used in share.items():
        assert used <= 1.0 + TOLERANCE, (name, used)
    assert max(share.values()) > 0.9, share  # else it is not the fastest
    return share


def assert_smooth_from_rest_to_rest(trajectory, derivatives=4):
    _, y = samples(trajectory, derivatives, per_segment=2)
    start, end = y[0::2], y[1::2]
    np.testing.assert_allclose([start[0, 1:3], end[-1, 1:3]], 0.0, atol=2e-3)
    for order, bound in zip(range(derivatives), (1e-5, 1e-4, 1e-2, 1.0), strict=False):  # what single precision leaves
        np.testing.assert_allclose(start[1:, order], end[:-1, order], atol=bound)


def fastest(path, limits=USUAL, **changes):
    return plan(PathRequest(path, limits.of("speed_m_per_s"), profile="fastest", limits=limits, **changes))


# ------------------------------------------------------------------------------------------------- limits and paths


@pytest.mark.parametrize("path", NAMED_PATHS)
@pytest.mark.parametrize("corner", ["sharp", "rounded"])
def test_named_path_keeps_every_limit_and_is_smooth(path, corner):
    trajectory = fastest(path, corner=corner)
    assert_keeps(trajectory, USUAL)
    assert_smooth_from_rest_to_rest(trajectory)
    assert len(trajectory.segments) <= MAX_SEGMENTS


@pytest.mark.parametrize(
    ("name", "limit", "path"),
    [
        ("speed_m_per_s", 0.2, "square"),
        ("accel_m_per_s2", 0.3, "lemniscate"),
        ("jerk_m_per_s3", 0.5, "circle"),
        ("wheel_speed_rad_per_s", 15.0, "square"),
        ("wheel_force_N", 1.0, "rhombus"),
        ("wheel_torque_Nm", 0.04, "line"),
    ],
)
def test_each_limit_is_used_to_the_full_and_costs_time(name, limit, path):
    tighter = Limits(**{name: limit}).over(USUAL)
    trajectory = fastest(path, tighter)
    assert assert_keeps(trajectory, tighter)[name] > 0.97
    assert trajectory.duration_us > 1.05 * fastest(path).duration_us


@pytest.mark.parametrize("seed", range(12))
def test_random_limits_and_waypoints_are_kept(tmp_path, seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 14))
    steps = rng.normal(size=(count, 3)) * np.exp(rng.uniform(-3.0, 0.3, size=(count, 1))) * [1.0, 1.0, 2.0]
    places = np.clip(np.cumsum(steps, axis=0), -19.0, 19.0)
    scale = np.exp(rng.uniform(-1.5, 0.7, size=6))
    limits = Limits(*(float(s) * limit for s, limit in zip(scale, asdict(USUAL).values(), strict=True)))
    trajectory = fastest(waypoint_file(tmp_path, places), limits)
    assert_keeps(trajectory, limits)
    assert_smooth_from_rest_to_rest(trajectory)
    _, y = samples(trajectory, 1)
    for place in places:  # driven through, to the distance between samples
        assert np.min(np.linalg.norm((y[:, 0] - place) * [1.0, 1.0, 0.12], axis=1)) < 2e-3


def waypoint_file(folder: Path, places, time_s=None) -> str:
    file = folder / "waypoints.csv"
    head, rows = ["x1_m", "x2_m", "heading_rad"], np.asarray(places)
    if time_s is not None:
        head, rows = [*head, "time_s"], np.column_stack([rows, time_s])
    file.write_text("\n".join([",".join(head), *(",".join(repr(float(v)) for v in row) for row in rows)]), "utf-8")
    return str(file)


@pytest.mark.parametrize("scale", [1.2e-3, 1e-2, 30.0])
def test_crawl_and_dash_are_planned_as_well(scale):
    limits = Limits(2.0 * scale, 40.0 * scale, 1e3, 1e3, 1e3, 1.0 * scale if scale < 1.0 else 5.0)
    assert_keeps(fastest("lemniscate" if scale > 1.0 else "line", limits), limits)


def test_robot_limits_are_kept_where_none_are_asked_for():
    made = plan_with_limits(PathRequest("square", 3.0, corner_accel_m_per_s2=30.0))
    assert made.limits == Limits(30.0, 40.0, free_speed(ROBOT), 3.5, 0.2, 3.0)
    assert_keeps(made.trajectory, made.limits)


def test_free_speed_is_where_the_back_emf_is_the_supply():
    assert free_speed(ROBOT) == pytest.approx(12.0 / (0.0115 * 20.0))
    assert robot_limits(ROBOT) == Limits(None, None, free_speed(ROBOT), 3.5, 0.2, None)


# ------------------------------------------------------------------------------------------------------- geometry


def test_square_goes_round_once_and_turns_a_quarter_on_each_side():
    trajectory = fastest("square", corner="sharp")
    _, y = samples(trajectory)
    speed = np.hypot(y[:, 1, 0], y[:, 1, 1]) + np.abs(y[:, 1, 2])
    corners = np.array([[1, -1, 0], [1, 1, 1], [-1, 1, 2], [-1, -1, 3], [1, -1, 4]]) * [1.0, 1.0, math.pi / 2.0]
    for corner in corners:
        there = np.linalg.norm(y[:, 0] - corner, axis=1) < 1e-5
        assert np.min(speed[there]) < 1e-3
    inside = np.max(np.abs(y[:, 0, :2]), axis=1)
    np.testing.assert_allclose(inside, 1.0, atol=2e-6)
    assert np.all(np.diff(y[:, 0, 2]) > -1e-6)


@pytest.mark.parametrize("cut_m", [0.01, 0.05, 0.2])
def test_rounded_corner_is_cut_by_what_was_asked_for(cut_m):
    _, y = samples(fastest("square", corner_cut_m=cut_m))
    for corner in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)):
        assert np.min(np.linalg.norm(y[:, 0, :2] - corner, axis=1)) == pytest.approx(cut_m, rel=1e-3)


@pytest.mark.parametrize("path", ["circle", "lemniscate"])
def test_curve_is_driven_on_its_curve(path):
    made = plan_with_limits(PathRequest(path, 1.0, profile="fastest"))
    _, y = samples(made.trajectory, 1)
    x1, x2 = y[:, 0, 0], y[:, 0, 1]
    if path == "circle":
        np.testing.assert_allclose(np.hypot(x1, x2), 1.0, atol=2e-6)
    else:  # (x² + y²)² = a² (x² - y²)
        np.testing.assert_allclose((x1**2 + x2**2) ** 2, 1.5**2 * (x1**2 - x2**2), atol=1e-5)
    assert made.fit_error_m < 1e-7  # a wrong third derivative at the nodes makes it 1e-6


def test_distance_to_a_spline_is_that_to_its_densest_outline(tmp_path):
    places = [[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [0.3, 1.2, 0.0], [-0.5, 0.2, 0.0]]
    path = plan(PathRequest(waypoint_file(tmp_path, places), 0.5)).path
    points = np.random.default_rng(1).uniform(-1.0, 2.0, size=(60, 2))
    outline = path.outline()
    fine = np.concatenate([np.linspace(a, b, 200) for a, b in pairwise(outline)])
    literal = [np.min(np.linalg.norm(fine - point, axis=1)) for point in points]
    np.testing.assert_allclose(path.distance(points), literal, atol=2e-4)
    assert np.max(path.distance(np.array(places)[:, :2])) < 1e-9


# ----------------------------------------------------------------------------------------------------------- time


@pytest.mark.parametrize(("speed", "accel", "jerk"), [(1.0, 2.0, 40.0), (0.5, 1.0, 5.0), (3.0, 2.0, 10.0)])
def test_line_takes_little_more_than_the_ideal_seven_phases(speed, accel, jerk):
    # Jerk, acceleration and speed limited move over 4 m, each limit reached or not.
    if speed / accel * speed + accel / jerk * speed <= 4.0:
        ideal_s = 4.0 / speed + speed / accel + accel / jerk
    else:
        ideal_s = accel / jerk + math.sqrt((accel / jerk) ** 2 + 4.0 * 4.0 / accel)
    took_s = fastest("line", Limits(accel, jerk, 1e3, 1e3, 1e3, speed)).duration_us * 1e-6
    assert ideal_s < took_s < 1.07 * ideal_s


@pytest.mark.parametrize("path", ["lemniscate", "circle"])
def test_without_much_of_a_jerk_limit_the_time_is_that_of_toppra(path):
    # Its limits are boxes, so the one of acceleration is left out: force binds.
    limits = Limits(1e3, 1e4, free_speed(ROBOT), 3.5, 1e3, 1.2)
    took_s = fastest(path, limits).duration_us * 1e-6
    assert took_s == pytest.approx(toppra_time(path, limits), rel=0.02)


def toppra_time(path, limits):
    """Time along a circle or lemniscate, heading 0, by TOPP-RA: the wheels' forces are linear in the acceleration."""
    angle = np.linspace(0.0, 2.0 * math.pi, 801)
    if path == "circle":
        place = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        place = (
            1.5 * np.stack([np.cos(angle), np.sin(angle) * np.cos(angle)], axis=1) / (1 + np.sin(angle) ** 2)[:, None]
        )
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
    spline = toppra.SplineInterpolator(length, place)
    jr = np.array([[-math.sqrt(3.0) / 2.0, 0.5, 0.12], [0.0, -1.0, 0.12], [math.sqrt(3.0) / 2.0, 0.5, 0.12]])
    force = np.linalg.inv(jr.T)[:, :2] * ROBOT.mass_kg  # per m/s² of acceleration, heading still
    rows = np.vstack([force, -force])
    dynamics = toppra.constraint.SecondOrderConstraint(
        lambda _q, _v, a: np.asarray(a, dtype=float),
        lambda _q: rows,
        lambda _q: np.full(6, limits.wheel_force_N),
        dof=2,
    )
    velocity = toppra.constraint.JointVelocityConstraintVarying(
        lambda s: (
            np.stack([-np.abs(_along(spline, s)), np.abs(_along(spline, s))], axis=1) * limits.speed_m_per_s
            - [1e-9, -1e-9]
        )
    )
    solver = toppra.algorithm.TOPPRA([velocity, dynamics], spline, gridpoints=np.linspace(0.0, length[-1], 2001))
    return solver.compute_trajectory(0.0, 0.0).duration


def _along(spline, s):
    tangent = spline(s, 1)
    return tangent / np.linalg.norm(tangent)


def test_duration_asked_for_is_kept_and_slower_than_the_limits():
    quickest_s = fastest("square").duration_us * 1e-6
    slow = fastest("square", duration_s=1.7 * quickest_s)
    assert slow.duration_us * 1e-6 == pytest.approx(1.7 * quickest_s, abs=5e-6)
    assert largest(slow)["speed_m_per_s"] < 0.6


# ------------------------------------------------------------------------------------------------------- refusals


def refusal(**request):
    with pytest.raises(OmnibotError) as error:
        plan(PathRequest(**request))
    assert "\n" not in str(error.value)
    return str(error.value)


def test_too_short_a_duration_names_what_would_do_the_limit_and_where():
    text = refusal(path="line", speed_m_per_s=1.0, profile="fastest", duration_s=4.0)
    assert text.startswith("duration_s = 4 is too short, 4.")
    assert "is above the limit of" in text
    assert "m along the path (x1 = " in text
    enough_s = float(text.split("too short, ")[1].split(" s")[0])
    plan(PathRequest("line", 1.0, profile="fastest", duration_s=enough_s))
    refusal(path="line", speed_m_per_s=1.0, profile="fastest", duration_s=0.999 * enough_s)


def test_steady_drive_that_breaks_a_limit_names_it_and_where():
    text = refusal(path="rhombus", speed_m_per_s=0.5, corner="sharp", limits=Limits(accel_m_per_s2=5.0))
    # The velocity turns by a right angle within a control period.
    assert "rhombus at a steady 0.5 m/s is too much: acceleration 707.1 m/s^2 is above the limit of 5 m/s^2" in text
    text = refusal(path="circle", speed_m_per_s=1.0, limits=Limits(wheel_speed_rad_per_s=20.0))
    assert "wheel speed 28.65 rad/s is above the limit of 20 rad/s" in text  # 1 m/s over 34.9 mm
    plan(PathRequest("circle", 1.0, limits=Limits(wheel_speed_rad_per_s=28.7)))


def test_steady_drive_within_limits_is_the_drive_without_them():
    free = plan(PathRequest("rhombus", 0.5))
    limited = plan(PathRequest("rhombus", 0.5, limits=Limits(accel_m_per_s2=2.1, jerk_m_per_s3=50.0)))
    assert limited.to_bytes() == free.to_bytes()


def test_timed_waypoints_are_met_on_time_at_rest_at_both_ends(tmp_path):
    places = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, 0.4], [0.5, 0.5, 0.8], [0.2, 0.6, 0.8]])
    time_s = np.array([0.0, 1.0, 2.5, 4.000001])
    trajectory = plan(PathRequest(waypoint_file(tmp_path, places, time_s), 0.5))
    np.testing.assert_allclose(trajectory.evaluate(time_s)[:, 0], places, atol=1e-6)
    assert_smooth_from_rest_to_rest(trajectory)


def test_timed_waypoints_too_fast_for_the_wheels_are_refused_where_they_are(tmp_path):
    file = waypoint_file(tmp_path, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], [0.0, 1.0, 1.2])
    text = refusal(path=file, speed_m_per_s=0.5)
    assert text.startswith(f"{file} is too much: wheel ")
    assert "give it more time there" in text


def test_timed_waypoints_have_no_other_duration_and_not_too_many(tmp_path):
    places = np.zeros((130, 3))
    file = waypoint_file(tmp_path, places, np.arange(130.0))
    assert "129, with times: the firmware stores 128 segments" in refusal(path=file, speed_m_per_s=0.5)
    assert "have times of their own" in refusal(path=file, speed_m_per_s=0.5, duration_s=3.0)


def test_spline_that_leads_further_than_the_wire_is_refused(tmp_path):
    file = waypoint_file(tmp_path, [[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 16.0, 0.0], [0.0, 16.0, 0.0]])
    assert "from the origin's axes; at most 20.97 m" in refusal(path=file, speed_m_per_s=0.5)


def test_path_that_128_segments_miss_is_refused(tmp_path):
    zigzag = [[0.01 * k, 0.5 * (k % 2), 0.0] for k in range(400)]
    text = refusal(path=waypoint_file(tmp_path, zigzag), speed_m_per_s=2.0)
    assert "128 segments, as many as the firmware stores" in text


def test_crawl_of_more_than_an_hour_is_refused():
    text = refusal(path="line", speed_m_per_s=1e-3, profile="fastest")
    assert "the path takes 40" in text
    assert "the firmware stores at most 3600 s" in text
    assert "at most 3600 s" in refusal(path="line", speed_m_per_s=1.0, profile="fastest", duration_s=3600.1)
    assert plan(PathRequest("line", 1.0, profile="fastest", duration_s=3600.0)).duration_us == 3_600_000_000
