// SPDX-License-Identifier: MIT
// The traction curve turned round against the magic formula forwards in double; then its ends and what is no number.
#include "floor.h"

#include "robot.h"
#include "unity.h"

#include <stddef.h>

static const double C = 1.65, E = 0.432;

static floor_t ground;

void setUp(void)
{
    ground = (floor_t){.curve = &omnibot.floor_curve, .compliance_per_N = 0.01f, .friction_limit_N = 5.0f};
}

void tearDown(void)
{
}

/// Of the floor as it is set up now.
static float slip_ratio(float force_N)
{
    floor_prepare(&ground);
    return floor_slip_ratio(&ground, force_N);
}

/// F(s) of (4), with the slope 1 / (ε/G0) at 0.
static double magic_force(double slip_ratio)
{
    const double compliance = (double)ground.compliance_per_N, peak = (double)ground.friction_limit_N;
    const double x = slip_ratio / (compliance * C * peak);
    return peak * sin(C * atan(x - E * (x - atan(x))));
}

static void assert_is_inverse_up_to(double share, double tolerance)
{
    for (int i = 1; i <= 10000; i++) {
        const float force = (float)(share * (double)ground.friction_limit_N * i / 10000.0);
        const double back = magic_force((double)slip_ratio(force));
        TEST_ASSERT_FLOAT_WITHIN((float)tolerance * force, force, (float)back);
    }
}

// ---- the magic formula

static void test_slip_makes_the_force_it_was_asked_for(void)
{
    assert_is_inverse_up_to(0.9, 2e-3);
}

static void test_slip_at_the_default_bound_is_closer_still(void)
{
    assert_is_inverse_up_to(0.7, 5e-4);
}

static void test_slip_of_every_floor_is_the_same_curve(void)
{
    static const float compliance[] = {1e-9f, 1e-5f, 0.2f, 1.0f};
    static const float limit[] = {0.1f, 3.0f, 20.0f, 1000.0f};
    for (int i = 0; i < 16; i++) {
        ground.compliance_per_N = compliance[i / 4];
        ground.friction_limit_N = limit[i % 4];
        assert_is_inverse_up_to(0.9, 2e-3);
    }
}

static void test_slip_of_a_small_force_is_the_linear_one(void)
{
    TEST_ASSERT_FLOAT_WITHIN(1e-3f * 1e-4f, 1e-4f, slip_ratio(0.01f));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, slip_ratio(0.0f));
}

static void test_slip_grows_faster_than_the_force(void)
{
    float last = 0.0f, last_step = 0.0f;
    for (int i = 1; i <= FLOOR_CURVE_INTERVALS; i++) {
        const float share = omnibot.floor_curve.force_share_max * (float)i / (float)FLOOR_CURVE_INTERVALS;
        const float slip = slip_ratio(5.0f * share);
        TEST_ASSERT_GREATER_OR_EQUAL_FLOAT(last_step * 0.999f, slip - last);
        last_step = slip - last;
        last = slip;
    }
}

static void test_softening_between_two_points_lies_on_the_line(void)
{
    const float *softening = omnibot.floor_curve.softening;
    const float force = 5.0f * omnibot.floor_curve.force_share_max * 10.25f / (float)FLOOR_CURVE_INTERVALS;

    const float expected = 0.01f * force * (0.75f * softening[10] + 0.25f * softening[11]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f * expected, expected, slip_ratio(force));
}

static void test_slip_is_odd(void)
{
    for (int i = 0; i <= 120; i++) {
        const float force = 0.05f * (float)i;
        TEST_ASSERT_FLOAT_WITHIN(0.0f, -slip_ratio(force), slip_ratio(-force));
    }
}

static void test_slip_beyond_the_end_is_as_soft_as_at_the_end(void)
{
    const float compliance = 0.01f * omnibot.floor_curve.softening[FLOOR_CURVE_INTERVALS];
    const float force[] = {4.75f, 4.7500005f, 5.0f, 100.0f, 3.0e10f};
    for (int i = 0; i < 5; i++) {
        const float slip = compliance * force[i];
        TEST_ASSERT_FLOAT_WITHIN(1e-5f * slip, slip, slip_ratio(force[i]));
        TEST_ASSERT_FLOAT_WITHIN(1e-5f * slip, -slip, slip_ratio(-force[i]));
    }
}

static void test_slip_of_no_number_is_none(void)
{
    // Under the sanitizers: neither NaN to an integer nor a read beyond the table.
    TEST_ASSERT_TRUE(isnan(slip_ratio(NAN)));
    TEST_ASSERT_TRUE(isnan(slip_ratio(-NAN)));
    TEST_ASSERT_TRUE(isinf(slip_ratio(INFINITY)));
    ground.friction_limit_N = NAN;
    (void)slip_ratio(1.0f);
    ground.friction_limit_N = 0.0f;
    (void)slip_ratio(0.0f);
    (void)slip_ratio(1.0f);
}

// ---- the linear floor

static void test_slip_on_the_linear_floor_is_proportional_without_end(void)
{
    ground.linear = true;
    ground.curve = NULL; // it must not look
    floor_prepare(&ground);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.03f, floor_slip_ratio(&ground, 3.0f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, -2.0f, floor_slip_ratio(&ground, -200.0f));
}

// ---- three wheels

static void test_slips_of_three_wheels_are_each_their_own(void)
{
    const vec3_t force = {1.0f, -2.0f, 4.0f};

    floor_prepare(&ground);
    const vec3_t slip = floor_slip_ratios(&ground, force);

    TEST_ASSERT_FLOAT_WITHIN(0.0f, slip_ratio(1.0f), slip.x);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, slip_ratio(-2.0f), slip.y);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, slip_ratio(4.0f), slip.z);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_slip_makes_the_force_it_was_asked_for);
    RUN_TEST(test_slip_at_the_default_bound_is_closer_still);
    RUN_TEST(test_slip_of_every_floor_is_the_same_curve);
    RUN_TEST(test_slip_of_a_small_force_is_the_linear_one);
    RUN_TEST(test_slip_grows_faster_than_the_force);
    RUN_TEST(test_softening_between_two_points_lies_on_the_line);
    RUN_TEST(test_slip_is_odd);
    RUN_TEST(test_slip_beyond_the_end_is_as_soft_as_at_the_end);
    RUN_TEST(test_slip_of_no_number_is_none);
    RUN_TEST(test_slip_on_the_linear_floor_is_proportional_without_end);
    RUN_TEST(test_slips_of_three_wheels_are_each_their_own);
    return UNITY_END();
}
