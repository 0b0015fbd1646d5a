// SPDX-License-Identifier: MIT
// Polynomials and their derivatives against term-by-term sums in double, and the cursor's walk over the joints.
#include "trajectory.h"

#include "unity.h"

static trajectory_segment_t segment[4];
static trajectory_cursor_t cursor;

/// Segment of constant velocity `slope` metres a duration on axis 0, from `start`.
static trajectory_segment_t ramp(uint32_t duration_us, float start, float slope)
{
    trajectory_segment_t made = {.duration_us = duration_us};
    made.coefficient[0][0] = start;
    made.coefficient[0][1] = slope;
    return made;
}

void setUp(void)
{
    segment[0] = ramp(1000, 10.0f, 1.0f);
    segment[1] = ramp(300, 20.0f, 2.0f);
    segment[2] = ramp(1, 30.0f, 3.0f);
    segment[3] = ramp(5000, 40.0f, 4.0f);
    cursor = (trajectory_cursor_t){0, 0};
}

void tearDown(void)
{
}

static void assert_cursor(uint16_t in_segment, uint32_t time_us)
{
    TEST_ASSERT_EQUAL_UINT16(in_segment, cursor.segment);
    TEST_ASSERT_EQUAL_UINT32(time_us, cursor.time_us);
}

static void advance(uint32_t step_us)
{
    trajectory_advance(segment, 4, &cursor, step_us);
}

static void assert_vec3_is_zero(vec3_t actual)
{
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(actual));
}

// ---- polynomials

/// d-th time derivative, and the sum of the sizes of its terms: what rounding is relative to.
static double derivative(const float *coefficient, int d, double s, double duration_s, double *size)
{
    double sum = 0.0;
    *size = 0.0;
    for (int k = d; k < TRAJECTORY_COEFFICIENTS; k++) {
        double term = (double)coefficient[k] * pow(s, k - d);
        for (int j = 0; j < d; j++) {
            term *= (double)(k - j) / duration_s;
        }
        sum += term;
        *size += fabs(term);
    }
    return sum;
}

static void assert_axis(const trajectory_segment_t *of, int axis, uint32_t time_us, const float actual[4])
{
    const double s = (double)time_us / (double)of->duration_us;
    for (int d = 0; d < 4; d++) {
        double size = 0.0;
        const double expected = derivative(of->coefficient[axis], d, s, (double)of->duration_us * 1e-6, &size);
        TEST_ASSERT_FLOAT_WITHIN((float)(3e-6 * size + 1e-30), (float)expected, actual[d]);
    }
}

static void fill_with_noise(trajectory_segment_t *of, uint32_t seed)
{
    uint32_t state = seed;
    for (int axis = 0; axis < TRAJECTORY_AXES; axis++) {
        for (int k = 0; k < TRAJECTORY_COEFFICIENTS; k++) {
            state = state * 1664525u + 1013904223u;
            of->coefficient[axis][k] = (float)(int32_t)state / 2147483648.0f;
        }
    }
}

static void test_reference_of_random_polynomials_agrees_with_their_analytic_derivatives(void)
{
    static const uint32_t duration_us[] = {1000, 250000, 1000000, 7000000};
    for (uint32_t i = 0; i < 4; i++) {
        segment[0].duration_us = duration_us[i];
        fill_with_noise(&segment[0], 7u + i);
        for (uint32_t k = 0; k <= 20; k++) {
            cursor.time_us = duration_us[i] / 20u * k;

            const reference_t y = trajectory_reference(segment, 4, &cursor);

            assert_axis(&segment[0], 0, cursor.time_us,
                        (float[4]){y.position.x, y.velocity.x, y.acceleration.x, y.jerk.x});
            assert_axis(&segment[0], 1, cursor.time_us,
                        (float[4]){y.position.y, y.velocity.y, y.acceleration.y, y.jerk.y});
            assert_axis(&segment[0], 2, cursor.time_us,
                        (float[4]){y.position.z, y.velocity.z, y.acceleration.z, y.jerk.z});
        }
    }
}

static void test_reference_of_each_power_alone_has_its_four_derivatives_by_hand(void)
{
    // At s = 1/2 in a segment of 2 s: d/dt = 1/2 d/ds.
    static const float expected[TRAJECTORY_COEFFICIENTS][4] = {
        {1.0f, 0.0f, 0.0f, 0.0f},
        {0.5f, 0.5f, 0.0f, 0.0f},
        {0.25f, 0.5f, 0.5f, 0.0f},
        {0.125f, 0.375f, 0.75f, 0.75f},
        {0.0625f, 0.25f, 0.75f, 1.5f},
        {0.03125f, 0.15625f, 0.625f, 1.875f},
        {0.015625f, 0.09375f, 0.46875f, 1.875f},
        {0.0078125f, 0.0546875f, 0.328125f, 1.640625f},
    };
    for (int power = 0; power < TRAJECTORY_COEFFICIENTS; power++) {
        segment[0] = (trajectory_segment_t){.duration_us = 2000000};
        segment[0].coefficient[1][power] = 1.0f;
        cursor.time_us = 1000000;

        const reference_t y = trajectory_reference(segment, 4, &cursor);

        TEST_ASSERT_FLOAT_WITHIN(1e-6f, expected[power][0], y.position.y);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, expected[power][1], y.velocity.y);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, expected[power][2], y.acceleration.y);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, expected[power][3], y.jerk.y);
        TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, y.position.x);
        TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, y.position.z);
    }
}

static void test_reference_at_the_start_is_the_first_coefficients(void)
{
    segment[0] = (trajectory_segment_t){
        500000, {{1.0f, 2.0f, 3.0f, 4.0f}, {-1.0f, 0.5f, 0.25f, 0.125f}, {0.1f, 0.2f, 0.3f, 0.4f}}};

    const reference_t y = trajectory_reference(segment, 4, &cursor);

    TEST_ASSERT_EQUAL_FLOAT(1.0f, y.position.x);
    TEST_ASSERT_EQUAL_FLOAT(4.0f, y.velocity.x);
    TEST_ASSERT_EQUAL_FLOAT(24.0f, y.acceleration.x);
    TEST_ASSERT_EQUAL_FLOAT(192.0f, y.jerk.x);
    TEST_ASSERT_EQUAL_FLOAT(-1.0f, y.position.y);
    TEST_ASSERT_EQUAL_FLOAT(1.0f, y.velocity.y);
    TEST_ASSERT_EQUAL_FLOAT(0.1f, y.position.z);
    TEST_ASSERT_EQUAL_FLOAT(0.4f, y.velocity.z);
}

// ---- walking

static void test_advance_within_a_segment_moves_the_time(void)
{
    advance(400);
    advance(599);

    assert_cursor(0, 999);
}

static void test_advance_by_nothing_stays(void)
{
    advance(0);

    assert_cursor(0, 0);
}

static void test_advance_to_the_exact_joint_belongs_to_the_next_segment(void)
{
    advance(1000);

    assert_cursor(1, 0);
    const reference_t y = trajectory_reference(segment, 4, &cursor);
    TEST_ASSERT_EQUAL_FLOAT(20.0f, y.position.x);
    TEST_ASSERT_EQUAL_FLOAT(2.0f / 300e-6f, y.velocity.x);
}

static void test_advance_past_a_joint_keeps_the_rest(void)
{
    advance(990);
    advance(25);

    assert_cursor(1, 15);
}

static void test_advance_over_several_short_segments_in_one_step_lands_right(void)
{
    advance(990);
    advance(10 + 300 + 1 + 7);

    assert_cursor(3, 7);
}

static void test_advance_to_the_joint_behind_several_segments_belongs_to_the_next(void)
{
    advance(1300);
    assert_cursor(2, 0);

    advance(1);
    assert_cursor(3, 0);
}

static void test_advance_in_small_steps_equals_one_large_step(void)
{
    for (int i = 0; i < 1313; i++) {
        advance(1);
    }

    assert_cursor(3, 12);
}

static void test_advance_to_the_exact_end_stays_in_the_last_segment(void)
{
    advance(6301);

    assert_cursor(3, 5000);
}

static void test_advance_beyond_the_end_stays_at_the_end(void)
{
    advance(6302);
    assert_cursor(3, 5000);

    advance(1000);
    assert_cursor(3, 5000);
}

static void test_advance_by_the_longest_step_stays_at_the_end(void)
{
    advance(3);
    advance(UINT32_MAX);
    assert_cursor(3, 5000);

    advance(UINT32_MAX);
    assert_cursor(3, 5000);
}

static void test_advance_in_the_longest_segment_does_not_overflow(void)
{
    segment[0].duration_us = UINT32_MAX;

    trajectory_advance(segment, 1, &cursor, UINT32_MAX - 1);
    trajectory_advance(segment, 1, &cursor, 1000);

    assert_cursor(0, UINT32_MAX);
}

static void test_advance_with_one_segment_ends_in_it(void)
{
    trajectory_advance(segment, 1, &cursor, 1000);

    assert_cursor(0, 1000);
}

// ---- the end

static void test_reference_just_before_the_end_still_moves(void)
{
    advance(6300);

    TEST_ASSERT_FLOAT_WITHIN(0.01f, 800.0f, trajectory_reference(segment, 4, &cursor).velocity.x);
}

static void test_reference_at_the_end_rests_at_the_last_point(void)
{
    segment[3].coefficient[1][3] = 5.0f; // still moving, accelerating and jerking there
    advance(10000);

    const reference_t y = trajectory_reference(segment, 4, &cursor);

    TEST_ASSERT_EQUAL_FLOAT(44.0f, y.position.x);
    TEST_ASSERT_EQUAL_FLOAT(5.0f, y.position.y);
    assert_vec3_is_zero(y.velocity);
    assert_vec3_is_zero(y.acceleration);
    assert_vec3_is_zero(y.jerk);
}

static void test_reference_at_the_end_of_an_inner_segment_is_not_at_rest(void)
{
    cursor = (trajectory_cursor_t){0, 1000};

    TEST_ASSERT_FLOAT_WITHIN(0.1f, 1000.0f, trajectory_reference(segment, 4, &cursor).velocity.x);
}

// ---- what is not a trajectory

static void test_trajectory_with_nothing_behind_it_is_accepted(void)
{
    const trajectory_segment_t alone = ramp(1000, 0.5f, 1.0f); // a look past its end is an error of the sanitizer's
    TEST_ASSERT_TRUE(trajectory_coefficients_are_valid(&alone, 1));
    TEST_ASSERT_TRUE(trajectory_durations_are_valid(&alone, 1));
    TEST_ASSERT_TRUE(trajectory_is_continuous(&alone, 1));
}

static void test_segment_with_a_bad_coefficient_anywhere_is_refused(void)
{
    const float bad[] = {NAN,     -NAN,   INFINITY, -INFINITY, nextafterf(TRAJECTORY_COEFFICIENT_MAX, 2e4f),
                         -1.1e4f, 3.0e38f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        for (int place = 0; place < 4 * TRAJECTORY_AXES * TRAJECTORY_COEFFICIENTS; place++) {
            setUp();
            TEST_ASSERT_TRUE(trajectory_coefficients_are_valid(segment, 4));
            segment[place / 24].coefficient[place % 24 / 8][place % 8] = bad[i];

            TEST_ASSERT_FALSE(trajectory_coefficients_are_valid(segment, 4));
            TEST_ASSERT_TRUE(trajectory_coefficients_are_valid(segment, (uint16_t)(place / 24))); // those before it
        }
    }
}

static void test_segment_with_the_largest_coefficients_is_accepted(void)
{
    for (int place = 0; place < TRAJECTORY_AXES * TRAJECTORY_COEFFICIENTS; place++) {
        segment[0].coefficient[place / TRAJECTORY_COEFFICIENTS][place % TRAJECTORY_COEFFICIENTS] =
            place % 2 == 0 ? TRAJECTORY_COEFFICIENT_MAX : -TRAJECTORY_COEFFICIENT_MAX;
    }

    TEST_ASSERT_TRUE(trajectory_coefficients_are_valid(segment, 1));
}

static void test_duration_of_any_segment_outside_its_bounds_is_refused(void)
{
    static const uint32_t good_us[] = {1, 2, 599999999u, 600000000u};
    static const uint32_t bad_us[] = {0, 600000001u, 1u << 31, UINT32_MAX};
    for (int i = 0; i < 16; i++) {
        setUp();
        segment[i / 4].duration_us = good_us[i % 4];
        TEST_ASSERT_TRUE(trajectory_durations_are_valid(segment, 4));
        segment[i / 4].duration_us = bad_us[i % 4];
        TEST_ASSERT_FALSE(trajectory_durations_are_valid(segment, 4));
    }
}

static void test_durations_of_an_hour_and_no_more_are_accepted(void)
{
    static trajectory_segment_t hour[128];
    for (int i = 0; i < 128; i++) {
        hour[i].duration_us = 3600000000u / 128u;
    }
    TEST_ASSERT_TRUE(trajectory_durations_are_valid(hour, 128));
    hour[77].duration_us++;
    TEST_ASSERT_FALSE(trajectory_durations_are_valid(hour, 128));
    for (int i = 0; i < 128; i++) {
        hour[i].duration_us = 600000000u;
    }
    TEST_ASSERT_TRUE(trajectory_durations_are_valid(hour, 6));
    TEST_ASSERT_FALSE(trajectory_durations_are_valid(hour, 7));
    TEST_ASSERT_FALSE(trajectory_durations_are_valid(hour, 8)); // 5.05e8 in 32 bits
    TEST_ASSERT_FALSE(trajectory_durations_are_valid(hour, 128));
}

/// Four segments of which each ends at 1 in every axis with all its coefficients in use, and starts there.
static void make_continuous(void)
{
    for (int place = 0; place < 4 * 24; place++) {
        segment[place / 24].coefficient[place % 24 / 8][place % 8] = place % 8 == 0  ? 1.0f
                                                                     : place % 8 < 7 ? 0.25f
                                                                                     : -1.5f;
    }
}

static void test_jump_at_any_joint_beyond_the_bound_is_refused(void)
{
    static const float good[] = {0.0f, 0.9e-3f, -0.9e-3f, 0.9e-3f};
    static const float bad[] = {1.1e-3f, -1.1e-3f, 6.2831853f, -9000.0f}; // a whole turn of the heading as well
    for (int i = 0; i < 9 * 4; i++) {
        make_continuous();
        segment[1 + i / 12].coefficient[i % 12 / 4][0] += good[i % 4];
        segment[1 + i / 12].coefficient[i % 12 / 4][1] -= good[i % 4];
        TEST_ASSERT_TRUE(trajectory_is_continuous(segment, 4));
        segment[1 + i / 12].coefficient[i % 12 / 4][0] += bad[i % 4] - good[i % 4];
        segment[1 + i / 12].coefficient[i % 12 / 4][1] -= bad[i % 4] - good[i % 4];
        TEST_ASSERT_FALSE(trajectory_is_continuous(segment, 4));
        TEST_ASSERT_TRUE(trajectory_is_continuous(segment, (uint16_t)(1 + i / 12))); // before the jump
    }
}

static void test_jump_of_each_power_at_the_end_of_any_segment_is_refused(void)
{
    for (int i = 0; i < 3 * 24; i++) {
        make_continuous();
        segment[i / 24].coefficient[i % 24 / 8][i % 8] += 2e-3f;
        TEST_ASSERT_FALSE(trajectory_is_continuous(segment, 4));
    }
}

static void test_jump_of_velocity_and_heading_of_many_turns_are_accepted(void)
{
    make_continuous();
    segment[1].coefficient[0][1] += 40.0f; // the end stays where it was
    segment[1].coefficient[0][2] -= 40.0f;
    for (int i = 0; i < 4; i++) {
        segment[i].coefficient[2][0] += 200.0f; // rad
    }
    TEST_ASSERT_TRUE(trajectory_is_continuous(segment, 4));
}

static void test_jump_of_exactly_the_bound_is_accepted(void)
{
    static const float bound[TRAJECTORY_AXES] = {1.0e-3f, 1.0e-3f, 1.0e-3f}; // m, m, rad: protocol/README.md
    for (int axis = 0; axis < TRAJECTORY_AXES; axis++) {
        trajectory_segment_t at_rest[2] = {{.duration_us = 1000}, {.duration_us = 1000}};
        at_rest[1].coefficient[axis][0] = bound[axis];
        TEST_ASSERT_TRUE(trajectory_is_continuous(at_rest, 2));
        at_rest[1].coefficient[axis][0] = nextafterf(bound[axis], 1.0f);
        TEST_ASSERT_FALSE(trajectory_is_continuous(at_rest, 2));
    }
}

static void test_one_segment_alone_has_no_joint(void)
{
    TEST_ASSERT_TRUE(trajectory_is_continuous(segment, 1));
    TEST_ASSERT_FALSE(trajectory_is_continuous(segment, 2)); // from 11 to 20
}

static void test_reference_of_the_wildest_valid_segment_is_finite(void)
{
    segment[0].duration_us = 1;
    for (int k = 0; k < TRAJECTORY_COEFFICIENTS; k++) {
        segment[0].coefficient[0][k] = TRAJECTORY_COEFFICIENT_MAX;
    }
    cursor.time_us = 1;

    const reference_t y = trajectory_reference(segment, 4, &cursor);

    TEST_ASSERT_TRUE(isfinite(vec3_sum(y.velocity)));
    TEST_ASSERT_TRUE(isfinite(vec3_sum(y.acceleration)));
    TEST_ASSERT_TRUE(isfinite(vec3_sum(y.jerk)));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_reference_of_random_polynomials_agrees_with_their_analytic_derivatives);
    RUN_TEST(test_reference_of_each_power_alone_has_its_four_derivatives_by_hand);
    RUN_TEST(test_reference_at_the_start_is_the_first_coefficients);
    RUN_TEST(test_advance_within_a_segment_moves_the_time);
    RUN_TEST(test_advance_by_nothing_stays);
    RUN_TEST(test_advance_to_the_exact_joint_belongs_to_the_next_segment);
    RUN_TEST(test_advance_past_a_joint_keeps_the_rest);
    RUN_TEST(test_advance_over_several_short_segments_in_one_step_lands_right);
    RUN_TEST(test_advance_to_the_joint_behind_several_segments_belongs_to_the_next);
    RUN_TEST(test_advance_in_small_steps_equals_one_large_step);
    RUN_TEST(test_advance_to_the_exact_end_stays_in_the_last_segment);
    RUN_TEST(test_advance_beyond_the_end_stays_at_the_end);
    RUN_TEST(test_advance_by_the_longest_step_stays_at_the_end);
    RUN_TEST(test_advance_in_the_longest_segment_does_not_overflow);
    RUN_TEST(test_advance_with_one_segment_ends_in_it);
    RUN_TEST(test_reference_just_before_the_end_still_moves);
    RUN_TEST(test_reference_at_the_end_rests_at_the_last_point);
    RUN_TEST(test_reference_at_the_end_of_an_inner_segment_is_not_at_rest);
    RUN_TEST(test_trajectory_with_nothing_behind_it_is_accepted);
    RUN_TEST(test_segment_with_a_bad_coefficient_anywhere_is_refused);
    RUN_TEST(test_segment_with_the_largest_coefficients_is_accepted);
    RUN_TEST(test_duration_of_any_segment_outside_its_bounds_is_refused);
    RUN_TEST(test_durations_of_an_hour_and_no_more_are_accepted);
    RUN_TEST(test_jump_at_any_joint_beyond_the_bound_is_refused);
    RUN_TEST(test_jump_of_each_power_at_the_end_of_any_segment_is_refused);
    RUN_TEST(test_jump_of_velocity_and_heading_of_many_turns_are_accepted);
    RUN_TEST(test_jump_of_exactly_the_bound_is_accepted);
    RUN_TEST(test_one_segment_alone_has_no_joint);
    RUN_TEST(test_reference_of_the_wildest_valid_segment_is_finite);
    return UNITY_END();
}
