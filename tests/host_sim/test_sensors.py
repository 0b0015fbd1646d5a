"""What the sensors make of a wheel and a pose whose motion is known."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.robot import Array
from host_sim.sensors import Encoders, Pose, Readings, Sensors

PERIOD_S = 1e-3
COUNTS = 4096
STEP_RAD = math.tau / COUNTS


def measured(angles: Array, speeds: Array, counts: int = COUNTS) -> Array:
    """Return what the encoders say at each tick of one motion, shape (ticks, 3)."""
    encoders = Encoders(counts, PERIOD_S)
    return np.array([encoders.speed(k, *both) for k, both in enumerate(zip(angles, speeds, strict=True))])


def steady(speed: Array, ticks: int, start: Array | None = None) -> tuple[Array, Array]:
    """Angles and speeds of wheels that turn evenly, shapes (ticks, 3)."""
    begin = np.array([0.1, 0.2, 0.3]) if start is None else start
    return begin + np.arange(ticks)[:, None] * PERIOD_S * speed, np.tile(speed, (ticks, 1))


# ---- encoders


@pytest.mark.parametrize("speed", [0.3, 1.0, 1.534, 5.0, 29.0, 100.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_constant_speed_is_measured_to_a_timer_tick(speed: float, sign: float) -> None:
    """Edges are timed: once two have been seen, the speed is exact but for the timer."""
    rate = sign * speed * np.array([1.0, 0.9, 1.1])
    settled = math.ceil(2.0 * STEP_RAD / (0.9 * speed) / PERIOD_S) + 2

    seen = measured(*steady(rate, settled + 400))[settled:]

    np.testing.assert_allclose(seen, np.broadcast_to(rate, seen.shape), rtol=1e-3)


@pytest.mark.parametrize("speed", [0.7, 3.1])
def test_constant_speed_is_never_off_by_more_than_a_count_over_the_window(speed: float) -> None:
    """From the first tick on, edges seen or not."""
    rate = np.array([speed, -speed, 0.5 * speed])
    seen = measured(*steady(rate, 300))
    window_s = np.maximum(PERIOD_S, STEP_RAD / abs(rate))
    assert (abs(seen - rate) <= STEP_RAD / window_s).all()


def test_first_tick_tells_the_speed_itself() -> None:
    rate = np.array([5.0, -3.0, 0.0])
    np.testing.assert_array_equal(measured(*steady(rate, 1))[0], rate)


def test_accelerating_wheel_is_followed_with_a_lag_of_a_window() -> None:
    time = PERIOD_S * np.arange(500)[:, None]
    rate = 5.0 + 40.0 * time * np.ones(3)
    angle = 0.1 + 5.0 * time + 20.0 * time**2 * np.ones(3)
    error = measured(angle, rate) - rate
    # The mean over the window since the last edge: at most one period and one count ago.
    assert abs(error[5:]).max() < 40.0 * (PERIOD_S + STEP_RAD / 5.0)


def test_reversal_changes_the_sign_and_never_exceeds_the_speed_by_a_count() -> None:
    time = PERIOD_S * np.arange(400)[:, None]
    rate = (4.0 - 20.0 * time) * np.ones(3)
    angle = (4.0 * time - 10.0 * time**2) * np.ones(3) + np.array([0.0, 3e-4, 7e-4])
    seen = measured(angle, rate)
    assert (seen[:150] > 0.0).all()
    assert (seen[-100:] < 0.0).all()
    # Around the turning point an edge passed twice tells nothing of the way between: one count over the window.
    assert abs(seen - rate).max() < STEP_RAD / PERIOD_S
    np.testing.assert_allclose(seen[-50:], rate[-50:], rtol=0.0, atol=0.1)


def test_standstill_decays_to_zero_as_one_count_over_the_time_since_the_last_edge() -> None:
    moving, turning = steady(np.array([8.0, -8.0, 2.0]), 50)
    ticks = 2000
    angles = np.vstack([moving, np.tile(moving[-1], (ticks, 1))])
    speeds = np.vstack([turning, np.zeros((ticks, 3))])

    seen = measured(angles, speeds)[50:]

    assert (np.diff(abs(seen), axis=0) <= 0.0).all()
    since_s = PERIOD_S * np.arange(1, ticks + 1)[:, None]
    assert (abs(seen[2:]) <= STEP_RAD / since_s[2:] * (1.0 + 1e-9)).all()
    assert (np.sign(seen[0]) == [1.0, -1.0, 1.0]).all()
    assert abs(seen[-1]).max() < 1e-3


def test_wheels_that_never_move_are_at_rest() -> None:
    assert (measured(np.full((20, 3), 0.123), np.zeros((20, 3))) == 0.0).all()


def test_coarser_encoder_is_coarser() -> None:
    """A wheel that swings: the fewer the counts, the larger the error."""
    time = PERIOD_S * np.arange(1000)[:, None]
    rate = 3.0 * np.cos(20.0 * time) * np.ones(3)
    angle = 0.15 * np.sin(20.0 * time) * np.ones(3) + 0.01
    errors = [float(np.abs(measured(angle, rate, counts) - rate)[5:].mean()) for counts in (256, 4096, 65536)]
    assert errors[0] > 2.0 * errors[1] > 2.0 * errors[2]


# ---- poses


@dataclass
class Wheels:
    wheel_angle: Array = field(default_factory=lambda: np.zeros(3))
    wheel_speed: Array = field(default_factory=lambda: np.array([1.0, -2.0, 3.0]))


def pose_at(tick: int) -> Pose:
    return (0.001 * tick, -0.002 * tick, 0.01 * tick)


def sent(sensors: Sensors, ticks: int = 100) -> dict[int, Pose]:
    """Return the poses that are sent by their ticks."""
    readings = Readings(sensors, PERIOD_S)
    poses = {tick: readings.pose(tick, pose_at(tick)) for tick in range(ticks)}
    return {tick: pose for tick, pose in poses.items() if pose is not None}


def test_ideal_sensors_send_every_pose_and_the_speed_itself() -> None:
    assert sent(Sensors()) == {tick: pose_at(tick) for tick in range(100)}
    assert Readings(Sensors(), PERIOD_S).wheel_speed(0, Wheels()) == [1.0, -2.0, 3.0]


@pytest.mark.parametrize(("rate_hz", "every"), [(1000.0, 1), (500.0, 2), (100.0, 10), (30.0, 33)])
def test_pose_rate_leaves_out_the_ticks_between(rate_hz: float, every: int) -> None:
    assert sent(Sensors(pose_rate_hz=rate_hz)) == {tick: pose_at(tick) for tick in range(0, 100, every)}


def test_pose_rate_of_zero_sends_the_first_alone() -> None:
    assert sent(Sensors(pose_rate_hz=0.0)) == {0: pose_at(0)}


def test_pose_delay_sends_what_was_and_at_first_the_oldest_there_is() -> None:
    poses = sent(Sensors(pose_delay_s=0.007))
    assert poses == {tick: pose_at(max(tick - 7, 0)) for tick in range(100)}


def test_pose_delay_and_rate_together() -> None:
    poses = sent(Sensors(pose_rate_hz=100.0, pose_delay_s=0.025))
    assert poses == {tick: pose_at(max(tick - 25, 0)) for tick in range(0, 100, 10)}


@pytest.mark.parametrize("rate_hz", [2000.0, 1e6])
def test_pose_rate_above_the_ticks_sends_every_pose(rate_hz: float) -> None:
    assert len(sent(Sensors(pose_rate_hz=rate_hz))) == 100


def test_readings_count_when_there_are_counts() -> None:
    readings = Readings(Sensors(encoder_counts=16), PERIOD_S)
    readings.wheel_speed(0, Wheels())
    # No edge of 22.5 degrees has passed since: as fast as before, until a count over the time is slower. The second
    # wheel's last edge was a whole count ago when the reading began.
    assert readings.wheel_speed(1, Wheels()) == pytest.approx([1.0, -2.0, 3.0], rel=0.01)


# ---- what a user does wrong


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"pose_rate_hz": -1.0}, "pose_rate_hz"),
        ({"pose_rate_hz": math.inf}, "pose_rate_hz"),
        ({"pose_rate_hz": math.nan}, "pose_rate_hz"),
        ({"pose_delay_s": -0.1}, "pose_delay_s"),
        ({"pose_delay_s": 1.1}, "pose_delay_s"),
        ({"pose_delay_s": math.nan}, "pose_delay_s"),
        ({"encoder_counts": -1}, "encoder_counts"),
        ({"encoder_counts": (1 << 24) + 1}, "encoder_counts"),
    ],
)
def test_impossible_sensors_are_refused_by_name(wrong: dict[str, float], says: str) -> None:
    with pytest.raises(OmnibotError, match=says):
        Sensors(**wrong)  # type: ignore[arg-type]
