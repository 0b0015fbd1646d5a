// SPDX-License-Identifier: MIT
// Stopping along the path against the friction circle and the chain rule (braking.h), and against closed forms of a
// whole stop on a straight line.
#include "braking.h"

#include "unity.h"

static const double T = 1e-3;
static const double distance_m = 0.12; // of the wheels from the centre

static braking_t braking;

void setUp(void)
{
    braking_reset(&braking);
}

void tearDown(void)
{
}

static void assert_vec3(double x, double y, double z, vec3_t actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)x, actual.x);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)y, actual.y);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)z, actual.z);
}

/// One step at a rate, on a path; returns σ̇.
static double rate_change(double rate, double acceleration_mps2, vec3_t velocity, vec3_t acceleration)
{
    braking = (braking_t){.rate = (float)rate};
    reference_t reference = {.velocity = velocity, .acceleration = acceleration};
    robot_t robot = omnibot;
    robot.tracked_point_offset_m = 0.5f; // where it is does not matter
    (void)braking_step(&braking, &robot, (float)acceleration_mps2, &reference);
    return ((double)braking.rate - (double)(float)rate) / T;
}

static double at_wheels(double x, double y, double turn)
{
    return sqrt(x * x + y * y + distance_m * distance_m * turn * turn);
}

// ---- how hard

static void test_braking_uses_what_the_path_leaves_of_the_acceleration(void)
{
    const struct {
        double rate;
        vec3_t velocity, acceleration;
    } path[] = {
        {1.0, {1.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}},  {1.0, {1.0f, 0.0f, 0.0f}, {0.0f, 1.2f, 0.0f}},
        {0.5, {1.0f, 0.0f, 0.0f}, {0.0f, 1.2f, 0.0f}},  {0.7, {0.0f, -0.8f, 0.0f}, {-1.1f, 0.4f, 0.0f}},
        {1.0, {0.0f, 0.0f, 3.0f}, {0.0f, 0.0f, 6.0f}},  {0.9, {0.3f, 0.4f, 2.0f}, {0.5f, -0.6f, 4.0f}},
        {0.8, {0.5f, 0.3f, -1.0f}, {0.9f, 0.9f, 5.0f}},
    };
    for (size_t i = 0; i < sizeof path / sizeof path[0]; i++) {
        const vec3_t v = path[i].velocity, a = path[i].acceleration;
        const double change = rate_change(path[i].rate, 1.5, v, a);
        const double along = change * at_wheels((double)v.x, (double)v.y, (double)v.z);
        const double bend = path[i].rate * path[i].rate * at_wheels((double)a.x, (double)a.y, (double)a.z);
        TEST_ASSERT_LESS_THAN_FLOAT(0.0f, (float)change);
        TEST_ASSERT_FLOAT_WITHIN(5e-4f, 1.5f, (float)sqrt(along * along + bend * bend));
    }
}

static void test_braking_in_a_bend_that_leaves_too_little_uses_a_quarter(void)
{
    const float bend[] = {1.4967f, 1.5166f, 3.0f}; // that leave 0.1, nothing and less
    for (size_t i = 0; i < sizeof bend / sizeof bend[0]; i++) {
        const double change = rate_change(1.0, 1.5, (vec3_t){0.5f, 0.0f, 0.0f}, (vec3_t){0.0f, bend[i], 0.0f});
        TEST_ASSERT_FLOAT_WITHIN(5e-4f, (float)(-0.25 * 1.5 / 0.5), (float)change);
    }
}

static void test_braking_of_what_is_too_fast_for_its_acceleration_takes_two_seconds(void)
{
    const struct {
        float speed_mps, change_per_s;
    } expected[] = {{2.5f, -0.6f}, {3.5f, -0.5f}, {5.0f, -0.5f}, {10.0f, -0.5f}};
    for (int i = 0; i < 4; i++) {
        const vec3_t velocity = {expected[i].speed_mps, 0.0f, 0.0f}, straight = {0.0f, 0.0f, 0.0f};
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, expected[i].change_per_s, (float)rate_change(1.0, 1.5, velocity, straight));
    }
}

// ---- what becomes of the reference

static void test_reference_obeys_the_chain_rule(void)
{
    const vec3_t v = {0.3f, -0.4f, 1.0f}, a = {0.5f, 0.6f, -0.7f}, j = {2.0f, -3.0f, 4.0f};
    const double rates[] = {1.0, 0.6, 0.2};
    for (int i = 0; i < 3; i++) {
        const double rate = rates[i];
        braking = (braking_t){.rate = (float)rate};
        reference_t reference = {{1.0f, 2.0f, 3.0f}, v, a, j};
        (void)braking_step(&braking, &omnibot, 1.5f, &reference);
        const double change = ((double)braking.rate - (double)(float)rate) / T;
        const double jerk = 3.0 * rate * change;
        assert_vec3(1.0, 2.0, 3.0, reference.position, 0.0);
        assert_vec3(rate * (double)v.x, rate * (double)v.y, rate * (double)v.z, reference.velocity, 1e-6);
        assert_vec3(rate * rate * (double)a.x + change * (double)v.x, rate * rate * (double)a.y + change * (double)v.y,
                    rate * rate * (double)a.z + change * (double)v.z, reference.acceleration, 1e-3);
        assert_vec3(rate * rate * rate * (double)j.x + jerk * (double)a.x,
                    rate * rate * rate * (double)j.y + jerk * (double)a.y,
                    rate * rate * rate * (double)j.z + jerk * (double)a.z, reference.jerk, 2e-3);
    }
}

static void test_reference_in_the_last_step_comes_to_rest_exactly(void)
{
    braking = (braking_t){.rate = 0.0012f};
    reference_t reference = {.velocity = {1.0f, 0.0f, 0.0f}};
    TEST_ASSERT_EQUAL_UINT32(1, braking_step(&braking, &omnibot, 1.5f, &reference)); // 0.6 µs
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, braking.rate);
    assert_vec3(0.0012, 0.0, 0.0, reference.velocity, 1e-9);
    assert_vec3(-0.0012 / T, 0.0, 0.0, reference.acceleration, 1e-5); // not −1.5
}

static void test_reference_at_rest_stands(void)
{
    braking = (braking_t){.rate = 0.0f};
    reference_t reference = {{1.0f, 2.0f, 3.0f}, {1.0f, 1.0f, 1.0f}, {2.0f, 2.0f, 2.0f}, {3.0f, 3.0f, 3.0f}};
    TEST_ASSERT_EQUAL_UINT32(0, braking_step(&braking, &omnibot, 1.5f, &reference));
    assert_vec3(1.0, 2.0, 3.0, reference.position, 0.0);
    assert_vec3(0.0, 0.0, 0.0, reference.velocity, 0.0);
    assert_vec3(0.0, 0.0, 0.0, reference.acceleration, 0.0);
    assert_vec3(0.0, 0.0, 0.0, reference.jerk, 0.0);
}

// ---- how long

static uint32_t passes(double rate, double speed_mps)
{
    braking = (braking_t){.rate = (float)rate};
    reference_t reference = {.velocity = {(float)speed_mps, 0.0f, 0.0f}};
    return braking_step(&braking, &omnibot, 1.5f, &reference);
}

static void test_trajectory_time_that_passes_is_the_mean_rate_to_the_nearest_microsecond(void)
{
    TEST_ASSERT_EQUAL_UINT32(599, passes(0.6, 1.0)); // 0.6 … 0.5985: 599.25
    TEST_ASSERT_EQUAL_UINT32(600, passes(0.6, 2.5)); // 0.6 … 0.5994: 599.7
    TEST_ASSERT_EQUAL_UINT32(999, passes(1.0, 1.0)); // 1 … 0.9985: 999.25
}

/// Stops on a straight line; gives the periods until the rate is 0, and returns the way.
static double stop(double speed_mps, double acceleration_mps2, int *periods)
{
    uint32_t time_us = 0;
    *periods = 0;
    while (braking.rate > 0.0f) {
        reference_t reference = {.velocity = {(float)speed_mps, 0.0f, 0.0f}};
        time_us += braking_step(&braking, &omnibot, (float)acceleration_mps2, &reference);
        TEST_ASSERT_LESS_THAN(2100, ++*periods);
    }
    return speed_mps * 1e-6 * time_us;
}

static void test_stop_takes_the_way_and_the_time_of_a_steady_deceleration(void)
{
    const double speed_mps[] = {0.2, 0.5, 1.0, 2.0};
    for (int i = 0; i < 4; i++) {
        int periods;
        braking_reset(&braking);
        const double way_m = stop(speed_mps[i], 1.5, &periods);
        TEST_ASSERT_INT_WITHIN(1, (int)(speed_mps[i] / 1.5 / T), periods);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)(speed_mps[i] * speed_mps[i] / 3.0), (float)way_m);
    }
}

static void test_stop_from_a_standstill_takes_a_twentieth_of_a_second(void)
{
    const double speed_mps[] = {0.0, 0.05, 0.075};
    for (int i = 0; i < 3; i++) {
        int periods;
        braking_reset(&braking);
        (void)stop(speed_mps[i], 1.5, &periods);
        TEST_ASSERT_INT_WITHIN(1, 50, periods);
    }
}

static void test_braking_is_over_after_half_a_second_at_rest(void)
{
    reference_t reference = {0};
    braking = (braking_t){.rate = 0.0f};
    for (int k = 0; k < 500; k++) {
        TEST_ASSERT_FALSE(braking_is_over(&braking));
        (void)braking_step(&braking, &omnibot, 1.5f, &reference);
    }
    TEST_ASSERT_TRUE(braking_is_over(&braking));
    braking.rest_us = 499999;
    TEST_ASSERT_FALSE(braking_is_over(&braking));
}

static void test_reset_begins_at_full_rate_and_has_not_rested(void)
{
    braking = (braking_t){.rate = 0.0f, .rest_us = 500000};
    braking_reset(&braking);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 1.0f, braking.rate);
    TEST_ASSERT_EQUAL_UINT32(0, braking.rest_us);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_braking_uses_what_the_path_leaves_of_the_acceleration);
    RUN_TEST(test_braking_in_a_bend_that_leaves_too_little_uses_a_quarter);
    RUN_TEST(test_braking_of_what_is_too_fast_for_its_acceleration_takes_two_seconds);
    RUN_TEST(test_reference_obeys_the_chain_rule);
    RUN_TEST(test_reference_in_the_last_step_comes_to_rest_exactly);
    RUN_TEST(test_reference_at_rest_stands);
    RUN_TEST(test_trajectory_time_that_passes_is_the_mean_rate_to_the_nearest_microsecond);
    RUN_TEST(test_stop_takes_the_way_and_the_time_of_a_steady_deceleration);
    RUN_TEST(test_stop_from_a_standstill_takes_a_twentieth_of_a_second);
    RUN_TEST(test_braking_is_over_after_half_a_second_at_rest);
    RUN_TEST(test_reset_begins_at_full_rate_and_has_not_rested);
    return UNITY_END();
}
