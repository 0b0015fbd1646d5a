// SPDX-License-Identifier: MIT
// Defaults and ranges against numbers written out here, every edge from both sides, and where each parameter goes.
#include "parameters.h"

#include "messages.h"
#include "unity.h"

/// firmware/robot/omnibot.toml, read by eye.
static const struct {
    float minimum, maximum, initial;
    bool integer;
} expected[] = {
    {0.0f, 5.0f, 5.0f, true},       // order
    {0.0f, 1.0f, 0.01f, false},     // epsilon
    {1e-6f, 1.0f, 1e-3f, false},    // delta_m_per_s
    {0.0f, 10.0f, 1.0f, false},     // speed_length_m
    {0.0f, 10000.0f, 70.0f, false}, // position_stiffness_per_s2
    {0.0f, 500.0f, 23.0f, false},   // position_damping_per_s
    {0.0f, 10000.0f, 70.0f, false}, // heading_stiffness_per_s2
    {0.0f, 500.0f, 23.0f, false},   // heading_damping_per_s
    {0.0f, 1000.0f, 3.5f, false},   // force_bound_N
    {0.0f, 0.327f, 0.2f, false},    // torque_bound_Nm
    {0.0f, 1.0f, 0.0f, true},       // output
    {0.0f, 1.0f, 1.0f, true},       // traction
    {0.1f, 1000.0f, 5.0f, false},   // friction_limit_N
    {0.01f, 1e9f, 0.3f, false},     // series_ratio_max
    {0.0f, 1.0f, 0.0f, false},      // observer_lag_s
    {0.0f, 3600.0f, 0.5f, false},   // pose_timeout_s
    {0.0f, 1.0f, 0.005f, false},    // wheel_speed_timeout_s
    {0.0f, 100.0f, 10.0f, true},    // tick_gap_max
    {0.1f, 20.0f, 1.5f, false},     // braking_m_per_s2
    {0.001f, 100.0f, 2.0f, false},  // error_limit_m
};

static parameters_t parameters;

void setUp(void)
{
    parameters_reset(&parameters);
}

void tearDown(void)
{
}

static void assert_same(float wanted, float actual)
{
    TEST_ASSERT_FLOAT_WITHIN(0.0f, wanted, actual);
}

static void assert_refused(uint8_t index, float value)
{
    const float before = parameters.value[index];
    TEST_ASSERT_EQUAL_UINT8(PARAMETER_VALUE_RESULT_OUT_OF_RANGE, parameters_set(&parameters, index, value));
    assert_same(before, parameters.value[index]);
}

static void assert_taken(uint8_t index, float value)
{
    TEST_ASSERT_EQUAL_UINT8(PARAMETER_VALUE_RESULT_OK, parameters_set(&parameters, index, value));
    assert_same(value, parameters.value[index]);
}

// ---- defaults and ranges

static void test_reset_gives_every_default(void)
{
    TEST_ASSERT_EQUAL(sizeof expected / sizeof expected[0], PARAMETER_COUNT);
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        parameters.value[i] = -1.0f;
    }

    parameters_reset(&parameters);

    for (int i = 0; i < PARAMETER_COUNT; i++) {
        assert_same(expected[i].initial, parameters.value[i]);
    }
}

static void test_set_default_is_taken(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        assert_taken(i, expected[i].initial);
    }
}

static void test_set_at_both_ends_of_the_range_is_taken(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        assert_taken(i, expected[i].minimum);
        assert_taken(i, expected[i].maximum);
    }
}

static void test_set_just_outside_the_range_is_refused(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        assert_refused(i, nextafterf(expected[i].minimum, -1e9f));
        assert_refused(i, nextafterf(expected[i].maximum, INFINITY));
    }
}

static void test_set_far_outside_the_range_is_refused(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        assert_refused(i, 3.0e38f);
        assert_refused(i, -3.0e38f);
        assert_refused(i, INFINITY);
        assert_refused(i, -INFINITY);
    }
}

static void test_set_nan_is_refused(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        assert_refused(i, NAN);
        assert_refused(i, -NAN);
    }
}

static void test_set_negative_zero_is_zero(void)
{
    assert_taken(PARAMETER_EPSILON, -0.0f);
    assert_taken(PARAMETER_ORDER, -0.0f);
    TEST_ASSERT_EQUAL_INT32(0, parameters_for_control(&parameters, &omnibot).order);
}

static void test_set_integer_with_a_fraction_is_refused(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        if (expected[i].integer) {
            assert_refused(i, 0.5f);
            assert_refused(i, nextafterf(1.0f, 0.0f));
            assert_refused(i, 1e-30f);
        } else {
            const float inner = expected[i].minimum + 0.37f * (expected[i].maximum - expected[i].minimum);
            assert_taken(i, inner);
        }
    }
}

static void test_set_unknown_index_is_refused(void)
{
    const parameters_t before = parameters;
    for (uint32_t i = PARAMETER_COUNT; i < 256; i++) {
        TEST_ASSERT_EQUAL_UINT8(PARAMETER_VALUE_RESULT_UNKNOWN_INDEX, parameters_set(&parameters, (uint8_t)i, 0.5f));
    }
    TEST_ASSERT_EQUAL_MEMORY(&before, &parameters, sizeof before);
}

static void test_set_one_leaves_the_others(void)
{
    for (uint8_t i = 0; i < PARAMETER_COUNT; i++) {
        parameters_reset(&parameters);
        assert_taken(i, expected[i].maximum);
        for (uint8_t k = 0; k < PARAMETER_COUNT; k++) {
            assert_same(k == i ? expected[k].maximum : expected[k].initial, parameters.value[k]);
        }
    }
}

// ---- where they go

static void test_control_gets_each_parameter_in_its_place(void)
{
    assert_taken(0, 0.0f);
    assert_taken(1, 0.5f);
    assert_taken(2, 0.25f);
    assert_taken(3, 4.0f);
    assert_taken(4, 81.0f);
    assert_taken(5, 17.0f);
    assert_taken(6, 33.0f);
    assert_taken(7, 9.0f);
    assert_taken(8, 2.5f);
    assert_taken(9, 0.125f);
    assert_taken(10, 1.0f);
    assert_taken(11, 0.0f);
    assert_taken(12, 6.5f);
    assert_taken(13, 0.75f);
    assert_taken(14, 0.007f);
    assert_taken(15, 2.5f);

    const control_params_t control = parameters_for_control(&parameters, &omnibot);

    TEST_ASSERT_EQUAL_PTR(&omnibot, control.robot);
    TEST_ASSERT_EQUAL_INT32(0, control.order);
    assert_same(0.5f, control.floor.compliance_per_N);
    assert_same(0.25f, control.delta_mps);
    assert_same(4.0f, control.speed_length_m);
    assert_same(81.0f, control.law.stiffness_per_s2.x);
    assert_same(81.0f, control.law.stiffness_per_s2.y);
    assert_same(33.0f, control.law.stiffness_per_s2.z);
    assert_same(17.0f, control.law.damping_per_s.x);
    assert_same(17.0f, control.law.damping_per_s.y);
    assert_same(9.0f, control.law.damping_per_s.z);
    assert_same(2.5f, control.force_bound_N);
    assert_same(0.125f, control.torque_bound_Nm);
    TEST_ASSERT_EQUAL(OUTPUT_POINT, control.law.output);
    TEST_ASSERT_TRUE(control.floor.linear);
    TEST_ASSERT_EQUAL_PTR(&omnibot.floor_curve, control.floor.curve);
    assert_same(6.5f, control.floor.friction_limit_N);
    assert_same(0.75f, control.series_ratio_max);
    assert_same(0.007f, control.observer_lag_s);
    assert_same(2.5f, parameters.value[PARAMETER_POSE_TIMEOUT_S]); // the application's own
}

static void test_control_defaults_choose_posture_and_the_magic_formula(void)
{
    const control_params_t control = parameters_for_control(&parameters, &omnibot);

    TEST_ASSERT_EQUAL_INT32(CONTROL_OBSERVER, control.order);
    TEST_ASSERT_EQUAL(OUTPUT_POSTURE, control.law.output);
    TEST_ASSERT_FALSE(control.floor.linear);
}

static void test_control_order_reaches_the_largest_that_control_knows(void)
{
    for (int32_t order = 0; order <= CONTROL_OBSERVER; order++) {
        assert_taken(PARAMETER_ORDER, (float)order);
        TEST_ASSERT_EQUAL_INT32(order, parameters_for_control(&parameters, &omnibot).order);
    }
    assert_refused(PARAMETER_ORDER, (float)(CONTROL_OBSERVER + 1));
}

static void test_control_compliance_is_epsilon_over_the_robots_own_stiffness(void)
{
    robot_t softer = omnibot;
    softer.normalised_compliance_per_N = 4.0f; // 1/G0
    assert_taken(PARAMETER_EPSILON, 0.25f);
    assert_same(1.0f, parameters_for_control(&parameters, &softer).floor.compliance_per_N);
}

static void test_control_is_prepared_with_what_was_set(void)
{
    assert_taken(PARAMETER_SERIES_RATIO_MAX, 0.3f);
    assert_taken(PARAMETER_POSITION_DAMPING_PER_S, 10.0f);
    // Where ρ = c K2 m/1.5 reaches its bound, m = 1.903 kg.
    const float most = 0.3f * 1.5f / (10.0f * 1.903f);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f * most, most,
                             parameters_for_control(&parameters, &omnibot).compliance_max_mps_per_N);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_reset_gives_every_default);
    RUN_TEST(test_set_default_is_taken);
    RUN_TEST(test_set_at_both_ends_of_the_range_is_taken);
    RUN_TEST(test_set_just_outside_the_range_is_refused);
    RUN_TEST(test_set_far_outside_the_range_is_refused);
    RUN_TEST(test_set_nan_is_refused);
    RUN_TEST(test_set_negative_zero_is_zero);
    RUN_TEST(test_set_integer_with_a_fraction_is_refused);
    RUN_TEST(test_set_unknown_index_is_refused);
    RUN_TEST(test_set_one_leaves_the_others);
    RUN_TEST(test_control_gets_each_parameter_in_its_place);
    RUN_TEST(test_control_defaults_choose_posture_and_the_magic_formula);
    RUN_TEST(test_control_order_reaches_the_largest_that_control_knows);
    RUN_TEST(test_control_compliance_is_epsilon_over_the_robots_own_stiffness);
    RUN_TEST(test_control_is_prepared_with_what_was_set);
    return UNITY_END();
}
