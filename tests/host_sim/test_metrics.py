"""The figures of merit, on traces whose figures are known in closed form."""

import json
from dataclasses import replace

import numpy as np
import pytest

from host_sim.metrics import measure, tracking_error, wrap_angle
from host_sim.trace import Trace

LIMIT_Nm = 0.2


def make_trace(rows: int) -> Trace:
    """A robot at rest in the origin, all columns zero."""
    wide, narrow = np.zeros((rows, 3)), np.zeros(rows)
    return Trace(
        tick=np.arange(rows, dtype=np.int64),
        time_s=np.arange(rows) * 1e-3,
        pose=wide,
        body_twist=wide,
        wheel_speed=wide,
        slip_ratio=wide,
        wheel_force=wide,
        torque=wide,
        point=np.zeros((rows, 2)),
        reference_point=np.zeros((rows, 2)),
        reference_heading=narrow,
        mu=wide,
        step_time_us=narrow,
    )


def distance_to_x_axis(points: np.ndarray) -> np.ndarray:
    return np.abs(points[:, 1])


def figures(trace: Trace) -> dict[str, dict[str, float | None]]:
    return measure(trace, distance_to_x_axis, LIMIT_Nm).as_dict()


# Tracking -----------------------------------------------------------------------------------------------------------


def test_tracking_of_a_constant_offset_is_that_offset() -> None:
    trace = replace(make_trace(10), point=np.tile([3.0, 4.0], (10, 1)))

    tracking = figures(trace)["tracking"]

    assert tracking["max_error_m"] == 5.0
    assert tracking["rms_error_m"] == 5.0
    assert tracking["max_path_deviation_m"] == 4.0


def test_tracking_rms_of_a_sine_is_amplitude_over_root_two() -> None:
    x = 0.01 * np.sin(2 * np.pi * np.arange(1000) / 1000)
    trace = replace(make_trace(1000), point=np.column_stack([x, 0 * x]))

    tracking = figures(trace)["tracking"]

    assert tracking["max_error_m"] == pytest.approx(0.01)
    assert tracking["rms_error_m"] == pytest.approx(0.01 / np.sqrt(2))


def test_tracking_late_on_the_path_is_an_error_but_no_deviation() -> None:
    trace = replace(
        make_trace(2), point=np.array([[0.0, 0.0], [0.7, 0.0]]), reference_point=np.array([[0, 0], [1.0, 0]])
    )

    tracking = figures(trace)["tracking"]

    assert tracking["max_error_m"] == pytest.approx(0.3)
    assert tracking["max_path_deviation_m"] == 0.0


@pytest.mark.parametrize(
    ("heading", "reference", "error"),
    [(0.1, 0.0, 0.1), (0.0, 0.1, 0.1), (3.1, -3.1, 2 * np.pi - 6.2), (20 * np.pi + 0.2, 0.0, 0.2), (np.pi, 0.0, np.pi)],
)
def test_heading_error_is_taken_the_short_way_round(heading: float, reference: float, error: float) -> None:
    pose = np.tile([0.0, 0.0, heading], (3, 1))
    trace = replace(make_trace(3), pose=pose, reference_heading=np.full(3, reference))

    assert figures(trace)["tracking"]["max_heading_error_rad"] == pytest.approx(error)


def test_wrap_angle_keeps_plus_pi_and_turns_minus_pi() -> None:
    np.testing.assert_array_equal(wrap_angle(np.array([np.pi, -np.pi, 0.0, 2 * np.pi])), [np.pi, np.pi, 0.0, 0.0])
    wrapped = wrap_angle(np.linspace(-50.0, 50.0, 100_001))
    assert wrapped.min() > -np.pi
    assert wrapped.max() <= np.pi


# Slip and torque ----------------------------------------------------------------------------------------------------


def test_slip_is_the_largest_magnitude_of_any_wheel() -> None:
    slip = np.zeros((5, 3))
    slip[1, 0], slip[3, 2] = 0.04, -0.09

    assert figures(replace(make_trace(5), slip_ratio=slip))["slip"] == {"max_ratio": 0.09}


def test_torque_saturation_counts_ticks_with_a_motor_at_its_limit() -> None:
    torque = np.zeros((8, 3))
    torque[0] = [0.2, -0.2, 0.2]
    torque[1, 1] = -0.199995  # the limit, as the wire rounds it
    torque[2, 2] = 0.1999

    assert figures(replace(make_trace(8), torque=torque))["torque"] == {"max_Nm": 0.2, "saturated_fraction": 0.25}


# No value -----------------------------------------------------------------------------------------------------------


def test_figures_of_an_empty_trace_are_null_in_json() -> None:
    empty = figures(make_trace(0))

    assert all(value is None for section in empty.values() for value in section.values())
    assert "null" in json.dumps(empty, allow_nan=False)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_figures_of_a_diverged_trace_are_null_in_json(bad: float) -> None:
    wide, point = np.zeros((4, 3)), np.zeros((4, 2))
    wide[2, 1], point[2, 1], wide[3, 2] = bad, bad, bad
    trace = replace(make_trace(4), pose=wide, point=point, slip_ratio=wide, torque=wide)

    broken = figures(trace)

    assert all(value is None for section in broken.values() for value in section.values())
    json.dumps(broken, allow_nan=False)


def test_figures_of_huge_numbers_do_not_overflow() -> None:
    trace = replace(make_trace(2), point=np.full((2, 2), 1e300))

    tracking = figures(trace)["tracking"]

    assert tracking["max_error_m"] == pytest.approx(np.sqrt(2) * 1e300)
    assert tracking["rms_error_m"] == pytest.approx(np.sqrt(2) * 1e300)


def test_one_bad_column_leaves_the_other_figures() -> None:
    slip = np.zeros((2, 3))
    slip[0, 0] = np.nan

    section = figures(replace(make_trace(2), slip_ratio=slip))

    assert section["slip"] == {"max_ratio": None}
    assert section["tracking"]["max_error_m"] == 0.0


def test_tracking_error_has_a_value_for_each_row() -> None:
    np.testing.assert_array_equal(tracking_error(make_trace(3)), np.zeros(3))
