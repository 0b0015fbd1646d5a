// SPDX-License-Identifier: MIT
// Where the series is held back (C9): ρ = c K2 m/1.5 in translation, c K2 Ic/(3b²) in yaw, of which the larger counts.
#include "control.h"
#include "unity.h"

static const double m = 1.903, Ic = 0.0132, b = 0.12, ratio_max = 0.45;

void setUp(void)
{
}

void tearDown(void)
{
}

/// c at which the larger ρ is ratio_max, as control_prepare has it.
static double compliance_max(tracking_output_t output, float translation_per_s, float yaw_per_s)
{
    control_params_t params = {
        .robot = &omnibot,
        .floor = {.curve = &omnibot.floor_curve, .linear = true, .compliance_per_N = 0.01f, .friction_limit_N = 5.0f},
        .law = {.output = output, .damping_per_s = {translation_per_s, translation_per_s, yaw_per_s}},
        .series_ratio_max = (float)ratio_max,
    };
    control_prepare(&params);
    return (double)params.compliance_max_mps_per_N;
}

static void assert_close(double expected, double actual)
{
    TEST_ASSERT_FLOAT_WITHIN((float)(1.0e-5 * expected), (float)expected, (float)actual);
}

static void test_stiff_translation_holds_the_series_back(void)
{
    assert_close(ratio_max / (23.0 * m / 1.5), compliance_max(OUTPUT_POSTURE, 23.0f, 1.0f));
}

static void test_stiff_yaw_holds_the_series_back(void)
{
    assert_close(ratio_max / (230.0 * Ic / (3.0 * b * b)), compliance_max(OUTPUT_POSTURE, 1.0f, 230.0f));
}

static void test_yaw_that_nothing_damps_holds_nothing_back(void)
{
    assert_close(ratio_max / (1.0 * m / 1.5), compliance_max(OUTPUT_POINT, 1.0f, 230.0f));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_stiff_translation_holds_the_series_back);
    RUN_TEST(test_stiff_yaw_holds_the_series_back);
    RUN_TEST(test_yaw_that_nothing_damps_holds_nothing_back);
    return UNITY_END();
}
