import struct

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.trajectory import MAX_DURATION_US, SEGMENT_BYTES, Polyline, Segment, Trajectory

NOWHERE = Polyline(np.zeros((1, 2)))
DIAMOND = Polyline(np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]))


def coefficients(p1=(0.0,), p2=(0.0,), heading=(0.0,)):
    return np.array([np.pad(np.array(axis, dtype=float), (0, 8 - len(axis))) for axis in (p1, p2, heading)])


def random_trajectory(rng, segments=5):
    durations = rng.integers(1, 3_000_000, segments)
    return Trajectory([Segment(int(us), rng.normal(size=(3, 8))) for us in durations], NOWHERE)


# ------------------------------------------------------------------------------------------------------ evaluate


def test_evaluate_hand_case_scales_derivatives_by_duration():
    # 2 s long, s = t / 2: p1 = 1 + 3 s² = 1 + 0.75 t²; p2 = 4 s³ = 0.5 t³; heading = -2 s = -t
    trajectory = Trajectory([Segment(2_000_000, coefficients((1, 0, 3), (0, 0, 0, 4), (0, -2)))], NOWHERE)
    expected = [[1.75, 0.5, -1.0], [1.5, 1.5, -1.0], [1.5, 3.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 0.0]]
    np.testing.assert_allclose(trajectory.evaluate([1.0], derivatives=4)[0], expected, atol=1e-15)


def test_evaluate_every_axis_and_power_matches_polynomial():
    rng = np.random.default_rng(1)
    trajectory = random_trajectory(rng, segments=1)
    time_s = np.linspace(0.0, trajectory.duration_us * 1e-6, 11)[:-1]
    actual = trajectory.evaluate(time_s, derivatives=7)
    for axis in range(3):
        c = trajectory.segments[0].coefficients[axis]
        polynomial = np.polynomial.Polynomial(c, domain=[0.0, trajectory.duration_us * 1e-6], window=[0.0, 1.0])
        for order in range(8):
            expected = (polynomial.deriv(order) if order else polynomial)(time_s)
            np.testing.assert_allclose(actual[:, order, axis], expected, rtol=1e-9, atol=1e-9)


def test_evaluate_derivatives_match_finite_differences():
    trajectory = random_trajectory(np.random.default_rng(2))
    step_s = 2e-5
    inside = np.concatenate([np.linspace(a, b, 9)[1:-1] for a, b in zip(*joints(trajectory), strict=True)])
    slope = (trajectory.evaluate(inside + step_s) - trajectory.evaluate(inside - step_s)) / (2.0 * step_s)
    for order in range(3):
        largest = np.max(np.abs(trajectory.evaluate(inside)[:, order + 1]))
        np.testing.assert_allclose(slope[:, order], trajectory.evaluate(inside)[:, order + 1], atol=1e-5 * largest)


def joints(trajectory):
    seconds = trajectory.joints_us * 1e-6
    return seconds[:-1], seconds[1:]


def test_evaluate_at_joint_belongs_to_the_next_segment():
    segments = [Segment(1_000_000, coefficients((0, 1))), Segment(1_000_000, coefficients((1, 0), (0, 1)))]
    before, at = Trajectory(segments, NOWHERE).evaluate([1.0 - 1e-8, 1.0], derivatives=1)
    np.testing.assert_allclose(before[1], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(at, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def test_evaluate_tick_times_fall_on_their_microsecond():
    pieces = 5000  # 1 ms each, p1 = number of the segment
    trajectory = Trajectory([Segment(1000, coefficients((k,))) for k in range(pieces)], NOWHERE)
    assert np.any(np.floor(np.arange(pieces) * 0.001 * 1e6) != np.arange(pieces) * 1000)  # floats alone do not
    np.testing.assert_array_equal(trajectory.evaluate(np.arange(pieces) * 0.001)[:, 0, 0], np.arange(pieces))


def test_evaluate_outside_rests_at_first_and_last_point():
    trajectory = Trajectory([Segment(1_000_000, coefficients((5, 2), (0, 0, 1), (1, 1, 1)))], NOWHERE)
    result = trajectory.evaluate([-1.0, 0.0, 1.0, 9.0], derivatives=2)
    np.testing.assert_allclose(result[:, 0], [[5, 0, 1], [5, 0, 1], [7, 1, 3], [7, 1, 3]])
    np.testing.assert_array_equal(result[[0, 2, 3], 1:], 0.0)
    np.testing.assert_array_equal(result[1, 1], [2, 0, 1])


def test_evaluate_shape():
    trajectory = random_trajectory(np.random.default_rng(3))
    assert trajectory.evaluate(np.zeros(6)).shape == (6, 4, 3)
    assert trajectory.evaluate(np.zeros(6), derivatives=0).shape == (6, 1, 3)


# ---------------------------------------------------------------------------------------------------------- bytes


def test_to_bytes_golden_segment():
    # c1 of p1 is 0.1, which float32 rounds to 0x3dcccccd
    segment = Segment(0x01020304, coefficients((1, 0.1), (-2,), (0, 0, 0, 0, 0, 0, 0, 0.5)))
    golden = bytes.fromhex("04030201 0000803f cdcccc3d" + "00000000" * 6 + "000000c0" + "00000000" * 14 + "0000003f")
    assert len(golden) == SEGMENT_BYTES == 100
    assert Trajectory([segment], NOWHERE).to_bytes() == golden


def test_to_bytes_is_axis_major_ascending():
    c = np.arange(24.0).reshape(3, 8)
    data = Trajectory([Segment(7, c), Segment(MAX_DURATION_US, -c)], NOWHERE).to_bytes()
    assert struct.unpack("<I24fI24f", data) == (7, *range(24), 600_000_000, *(-k for k in range(24)))


def test_from_bytes_returns_what_was_sent():
    trajectory = random_trajectory(np.random.default_rng(4), segments=128)
    back = Trajectory.from_bytes(trajectory.to_bytes(), NOWHERE)
    assert back.to_bytes() == trajectory.to_bytes()
    for sent, got in zip(trajectory.segments, back.segments, strict=True):
        assert got.duration_us == sent.duration_us
        np.testing.assert_array_equal(got.coefficients, sent.coefficients.astype(np.float32))


def test_rounded_is_close_not_equal_and_stable():
    trajectory = random_trajectory(np.random.default_rng(5))
    rounded = trajectory.rounded()
    time_s = np.linspace(0.0, trajectory.duration_us * 1e-6, 200)
    difference = np.abs(rounded.evaluate(time_s)[:, 0] - trajectory.evaluate(time_s)[:, 0])
    assert 0.0 < np.max(difference) < 1e-5
    assert rounded.path is trajectory.path
    assert rounded.rounded().to_bytes() == rounded.to_bytes()


@pytest.mark.parametrize("size", [0, 1, 99, 101, 250])
def test_from_bytes_of_wrong_length_is_refused(size):
    with pytest.raises(OmnibotError, match=rf"^{size} bytes of trajectory; it must be a multiple of 100, not 0$"):
        Trajectory.from_bytes(bytes(size), NOWHERE)


def test_from_bytes_without_duration_is_refused():
    with pytest.raises(OmnibotError, match="a segment of 0 µs; it must last 1 … 600000000 µs"):
        Trajectory.from_bytes(bytes(100), NOWHERE)


# -------------------------------------------------------------------------------------------------------- segments


@pytest.mark.parametrize("duration_us", [-1, 0, 600_000_001, 2**32])
def test_segment_duration_outside_the_wire_is_refused(duration_us):
    with pytest.raises(OmnibotError, match="it must last 1 … 600000000 µs"):
        Segment(duration_us, coefficients())


def test_segment_of_wrong_shape_is_refused():
    with pytest.raises(OmnibotError, match=r"shape \(3, 7\); it must be \(3, 8\)"):
        Segment(1, np.zeros((3, 7)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_segment_with_non_finite_coefficient_is_refused(bad):
    with pytest.raises(OmnibotError, match="must be finite numbers"):
        Segment(1, coefficients((bad,)))


def test_segment_does_not_change_with_the_array_it_was_made_of():
    source = coefficients((1,))
    segment = Segment(1, source)
    source[0, 0] = 2.0
    assert segment.coefficients[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        segment.coefficients[0, 0] = 3.0


def test_trajectory_without_segments_is_refused():
    with pytest.raises(OmnibotError, match="at least one segment"):
        Trajectory([], NOWHERE)


# ------------------------------------------------------------------------------------------------------------ path


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((1.0, 0.0), 0.0),  # a vertex
        ((0.5, 0.5), 0.0),  # on a side
        ((0.5, -0.5), 0.0),  # on the side that closes it
        ((0.0, 0.0), np.sqrt(0.5)),  # the middle
        ((1.0, 1.0), np.sqrt(0.5)),  # outside, beside a side
        ((3.0, 0.0), 2.0),  # outside, beyond a vertex
        ((2.0, 1.0), np.sqrt(2.0)),  # outside, at the bound between vertex and side
        ((0.0, 0.9), np.sqrt(0.005)),  # inside, below a vertex
    ],
)
def test_polyline_distance_hand_cases(point, expected):
    np.testing.assert_allclose(DIAMOND.distance(np.array([point])), [expected], atol=1e-15)


def test_polyline_open_has_no_closing_side():
    line = Polyline(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]]), closed=False)
    points = np.array([[2.0, 1.5], [-3.0, -4.0], [4.0, 5.0], [5.0, 1.0]])
    np.testing.assert_allclose(line.distance(points), [1.5, 5.0, 2.0, 1.0])
    assert len(line.outline()) == 3


def test_polyline_with_a_repeated_vertex():
    line = Polyline(np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), closed=False)
    np.testing.assert_allclose(line.distance(np.array([[-3.0, 4.0], [0.5, 2.0]])), [5.0, 2.0])


def test_polyline_outline_of_closed_line_ends_where_it_starts():
    outline = DIAMOND.outline()
    assert outline.shape == (5, 2)
    np.testing.assert_array_equal(outline[0], outline[-1])
