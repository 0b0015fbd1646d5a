// SPDX-License-Identifier: MIT
// Slip near and past what the law is made for: how far ε is held back in yaw, the speed behind the observer's slip
// where it is unique and where there is none, the bounded force of the exact order; and the state while coasting.
#include "control.h"

#include "unity.h"

static const double m = 1.903, Ic = 0.0132, Iw = 1.6e-5, b = 0.12, r = 0.0349;
static const double half_root3 = 0.86602540378443864676;

static control_params_t params;
static control_state_t state;
static control_input_t input;
static control_output_t output;

void setUp(void)
{
    params = (control_params_t){
        .robot = &omnibot,
        .order = 0,
        .floor = {.curve = &omnibot.floor_curve, .linear = true, .compliance_per_N = 0.01f, .friction_limit_N = 5.0f},
        .delta_mps = 1.0e-3f,
        .speed_length_m = 1.0f,
        .law = {OUTPUT_POSTURE, {70.0f, 70.0f, 70.0f}, {23.0f, 23.0f, 23.0f}},
        .series_ratio_max = 1.0e9f,
        .force_bound_N = 1000.0f,
        .torque_bound_Nm = 1000.0f,
    };
    state = (control_state_t){0};
    input = (control_input_t){.pose_is_new = true};
    input.reference.position = (vec3_t){0.0f, 0.12f, 0.0f}; // the tracked point
}

void tearDown(void)
{
}

static void step(void)
{
    control_prepare(&params);
    TEST_ASSERT_TRUE(control_step(&params, &state, &input, &output));
}

static void roll(vec3_t twist)
{
    input.wheel_speed_rad_per_s = wheels_of_body(&omnibot.wheel_rate_of_twist, twist);
}

// ---- ε held back

static float prepared_compliance(tracking_output_t what, float planar_per_s, float heading_per_s)
{
    params.series_ratio_max = 0.3f;
    params.law.output = what;
    params.law.damping_per_s = (vec3_t){planar_per_s, planar_per_s, heading_per_s};
    control_prepare(&params);
    return params.compliance_max_mps_per_N;
}

static void test_compliance_bound_is_that_of_the_larger_ratio(void)
{
    // Theory (C9): c K2 m/1.5 in translation, c K2 Ic/(3b²) in yaw.
    const double translation = 0.3 * 1.5 / (23.0 * m), yaw = 0.3 * 3.0 * b * b / (300.0 * Ic);
    TEST_ASSERT_FLOAT_WITHIN((float)(1e-6 * translation), (float)translation,
                             prepared_compliance(OUTPUT_POSTURE, 23.0f, 23.0f));
    TEST_ASSERT_FLOAT_WITHIN((float)(1e-6 * yaw), (float)yaw, prepared_compliance(OUTPUT_POSTURE, 23.0f, 300.0f));
}

static void test_compliance_bound_of_the_point_has_no_heading_damping_in_it(void)
{
    const double translation = 0.3 * 1.5 / (0.1 * m);
    TEST_ASSERT_FLOAT_WITHIN((float)(1e-6 * translation), (float)translation,
                             prepared_compliance(OUTPUT_POINT, 0.1f, 300.0f));
}

static void test_torque_with_compliance_held_back_has_no_growth_of_it(void)
{
    // Straight ahead at ω = 0 everything is one number, and c stays at its bound.
    const double v = 0.5, a = 2.0, jerk = 20.0, K1 = 70.0, K2 = 23.0;
    roll((vec3_t){(float)v, 0.0f, 0.0f});
    input.reference.velocity.x = (float)v;
    input.reference.acceleration.x = (float)a;
    input.reference.jerk.x = (float)jerk;
    params.floor.compliance_per_N = 1.0f;
    params.series_ratio_max = 0.1f;
    params.order = 1;
    step();
    const double c = 0.1 * 1.5 / (K2 * m);
    const double nu = v - c * m / 1.5 * a;
    const double eta = a - K2 * (nu - v);
    const double eta_rate = jerk - K2 * (eta - a) - K1 * (nu - v);
    const double force = m * eta / sqrt(3.0), slip_rate = -c * m * eta_rate / sqrt(3.0);
    const double torque = r * force + Iw * (half_root3 * eta - slip_rate) / r;
    TEST_ASSERT_FLOAT_WITHIN(5e-7f, (float)torque, output.torque_Nm.z);
    TEST_ASSERT_FLOAT_WITHIN(5e-7f, (float)-torque, output.torque_Nm.x);
}

// ---- the bounded force in the exact order

/// What a wheel has of a twist: the rows of Jr.
static double largest_wheel_speed(double x, double y, double w)
{
    const double wheel[3] = {-half_root3 * x + 0.5 * y + b * w, -y + b * w, half_root3 * x + 0.5 * y + b * w};
    return fmax(fabs(wheel[0]), fmax(fabs(wheel[1]), fabs(wheel[2])));
}

static void test_exact_slip_is_that_of_the_bounded_force(void)
{
    const vec3_t odometry = {0.7f, -0.4f, 1.5f};
    roll(odometry);
    input.reference.position.x += 0.3f;
    input.reference.acceleration.y = 2.0f;
    params.order = CONTROL_EXACT;
    params.force_bound_N = 2.5f;
    step();
    TEST_ASSERT_TRUE(output.force_bounded);
    // Jr Jr⁻¹ λ = λ: the wheel that is at the bound slips by c times it.
    const double c = 0.01 * (sqrt(0.7 * 0.7 + 0.4 * 0.4 + 1.5 * 1.5) + 1e-3);
    const double slip =
        largest_wheel_speed((double)odometry.x - (double)output.twist.x, (double)odometry.y - (double)output.twist.y,
                            (double)odometry.z - (double)output.twist.z);
    TEST_ASSERT_FLOAT_WITHIN((float)(1e-4 * c * 2.5), (float)(c * 2.5), (float)slip);
}

// ---- the speed behind the observer's slip

static const double delta = 0.05;

/// V + δ, as it shows: what slips is (V + δ) s. The body's slip ratios are along x and y.
static double speed_behind(double odometry_x, double slip_x, double slip_y)
{
    setUp();
    params.order = CONTROL_OBSERVER;
    params.delta_mps = (float)delta;
    params.floor.compliance_per_N = 1.0f;
    state.force_estimate_N = (vec3_t){(float)(-half_root3 * slip_x + 0.5 * slip_y), (float)-slip_y,
                                      (float)(half_root3 * slip_x + 0.5 * slip_y)};
    roll((vec3_t){(float)odometry_x, 0.0f, 0.0f});
    step();
    const double dx = odometry_x - (double)output.twist.x, dy = -(double)output.twist.y;
    return (dx * slip_x + dy * slip_y) / (slip_x * slip_x + slip_y * slip_y);
}

/// δ + V(v_odo − x s) = x by halving; there is one x above δ while s is below one.
static double literal_speed(double odometry_x, double slip_x, double slip_y)
{
    double low = delta, high = 1e3;
    for (int i = 0; i < 80; i++) {
        const double x = 0.5 * (low + high);
        *(delta + hypot(odometry_x - x * slip_x, x * slip_y) > x ? &low : &high) = x;
    }
    return low;
}

static void test_observer_speed_is_the_only_one_that_fits_the_slip(void)
{
    for (int i = -6; i <= 6; i++) {
        for (int j = 0; j <= 6; j++) {
            const double slip_x = 0.1 * i + 0.03, slip_y = 0.1 * j;
            const double speed = literal_speed(0.5, slip_x, slip_y), most = 2.0 * (0.5 + delta);
            const double expected = speed < most ? speed : most;
            TEST_ASSERT_FLOAT_WITHIN(2e-5f, (float)expected, (float)speed_behind(0.5, slip_x, slip_y));
        }
    }
}

static void test_observer_speed_of_a_body_far_faster_than_its_wheels_is_twice_theirs(void)
{
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(2.0 * (0.5 + delta)), (float)speed_behind(0.5, -0.95, 0.0));
}

static void test_observer_speed_of_a_body_that_slips_ahead_is_no_less_than_its_wheels(void)
{
    // s·v_odo ≤ 0 makes ν faster than v_odo at any V; past s = 1 no V fits.
    const double slip[][2] = {{-1.5, 0.0}, {-3.0, 0.0}, {-1.0, 1.0}, {0.0, 1.2}, {0.0, 5.0}};
    for (size_t i = 0; i < sizeof slip / sizeof slip[0]; i++) {
        const double speed = speed_behind(0.5, slip[i][0], slip[i][1]);
        TEST_ASSERT_GREATER_OR_EQUAL_FLOAT((float)(0.5 + delta - 1e-5), (float)speed);
        TEST_ASSERT_LESS_OR_EQUAL_FLOAT((float)(2.0 * (0.5 + delta) + 1e-5), (float)speed);
    }
}

static void test_observer_speed_does_not_jump_where_its_two_roots_meet(void)
{
    // (v_odo·s − δ)² = (s·s − 1) (V² − δ²) at this slip; beyond it there is no root.
    const double slip_x = 1.2, p = 0.5 * slip_x - delta, q = 0.25 - delta * delta;
    const double slip_y = sqrt(1.0 + p * p / q - slip_x * slip_x);
    for (int i = -2; i <= 2; i++) {
        TEST_ASSERT_FLOAT_WITHIN(0.03f, (float)(q / p), (float)speed_behind(0.5, slip_x, slip_y + 1e-4 * i));
    }
}

static void test_observer_speed_of_a_body_held_by_its_wheels_is_not_below_delta(void)
{
    for (int i = 0; i <= 10; i++) {
        TEST_ASSERT_GREATER_OR_EQUAL_FLOAT((float)(delta * (1.0 - 1e-5)), (float)speed_behind(0.02, 1.5 + i, 0.0));
        TEST_ASSERT_GREATER_OR_EQUAL_FLOAT((float)(delta * (1.0 - 1e-5)), (float)speed_behind(0.5, 1.5 + i, 0.0));
    }
}

// ---- what else a robot may be

static void test_step_at_rest_with_bounds_of_zero_is_no_failure(void)
{
    params.force_bound_N = 0.0f;
    params.torque_bound_Nm = 0.0f;
    step();
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(output.torque_Nm));
    TEST_ASSERT_FALSE(output.force_bounded);
    TEST_ASSERT_FALSE(output.torque_bounded);
}

static void test_mu_grows_with_the_compliance_of_the_robot(void)
{
    robot_t softer = omnibot;
    softer.normalised_compliance_per_N = 4.0f;
    roll((vec3_t){0.5f, 0.2f, 1.0f});
    step();
    const vec3_t mu_mps = output.mu_mps;
    params.robot = &softer;

    step();

    // µ = −κ Γ⁻¹ λ, κ = (V + δ)/G0.
    TEST_ASSERT_GREATER_THAN_FLOAT(1e-3f, vec3_max_abs(mu_mps));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * mu_mps.x, output.mu_mps.x);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * mu_mps.y, output.mu_mps.y);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * mu_mps.z, output.mu_mps.z);
}

// ---- coasting

static void test_coast_keeps_the_acceleration_of_the_last_step(void)
{
    roll((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.velocity.x = 0.5f;
    input.reference.acceleration.x = 2.0f;
    step();
    for (int k = 1; k < 100; k++) {
        control_coast(&params, &state);
    }
    // 0.1 s
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.5f * 0.1f + 0.5f * 2.0f * 0.01f, state.pose.value.x);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 0.5f + 2.0f * 0.1f, state.twist.x);
}

static void test_coast_in_a_bend_follows_its_circle(void)
{
    // 0.6 m/s at 1.5 rad/s: a radius of 0.4 m, for a quarter of a turn.
    state.twist = (vec3_t){0.6f, 0.0f, 1.5f};
    state.specific_force = (vec3_t){0.0f, 0.6f * 1.5f, 0.0f};
    control_prepare(&params);
    for (int k = 0; k < 1047; k++) {
        control_coast(&params, &state);
    }
    const double turned = 1.5 * 1.047;
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(0.4 * sin(turned)), state.pose.value.x);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(0.4 - 0.4 * cos(turned)), state.pose.value.y);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)turned, state.pose.value.z);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_compliance_bound_is_that_of_the_larger_ratio);
    RUN_TEST(test_compliance_bound_of_the_point_has_no_heading_damping_in_it);
    RUN_TEST(test_torque_with_compliance_held_back_has_no_growth_of_it);
    RUN_TEST(test_exact_slip_is_that_of_the_bounded_force);
    RUN_TEST(test_observer_speed_is_the_only_one_that_fits_the_slip);
    RUN_TEST(test_observer_speed_of_a_body_far_faster_than_its_wheels_is_twice_theirs);
    RUN_TEST(test_observer_speed_of_a_body_that_slips_ahead_is_no_less_than_its_wheels);
    RUN_TEST(test_observer_speed_does_not_jump_where_its_two_roots_meet);
    RUN_TEST(test_observer_speed_of_a_body_held_by_its_wheels_is_not_below_delta);
    RUN_TEST(test_step_at_rest_with_bounds_of_zero_is_no_failure);
    RUN_TEST(test_mu_grows_with_the_compliance_of_the_robot);
    RUN_TEST(test_coast_keeps_the_acceleration_of_the_last_step);
    RUN_TEST(test_coast_in_a_bend_follows_its_circle);
    return UNITY_END();
}
