// SPDX-License-Identifier: MIT
// The whole step: signs of the torques first, then values by hand, the two orders against each other, the bounds, and
// what must never come out. Wheel signs for a push: ahead (−, 0, +), left (+, −−, +), left turn (+, +, +).
#include "control.h"

#include "kinematics.h"
#include "unity.h"

static const double m = 1.903, Ic = 0.0132, Iw = 1.6e-5, L = 0.12, b = 0.12, r = 0.0349;
static const double half_root3 = 0.86602540378443864676;
static const double pi = 3.14159265358979323846;

static control_params_t params;
static control_input_t input;
static control_output_t output;

/// At rest with no error, at a heading: the reference is the tracked point.
static void rest_at(double heading)
{
    const float at = (float)heading;
    input = (control_input_t){.pose = {0.5f, -0.25f, at}};
    input.reference.position = (vec3_t){(float)(0.5 - L * sin((double)at)), (float)(-0.25 + L * cos((double)at)), at};
}

/// The wheels and the reference of a body twist that is to stay as it is, at zero heading and with no error.
static void move_steadily(vec3_t twist)
{
    rest_at(0.0);
    const vec3_t z = kinematics_point_twist(&omnibot, twist);
    input.wheel_speed_rad_per_s = mat3_apply(&omnibot.wheel_rate_of_twist, twist);
    input.reference.velocity = z;
    input.reference.acceleration = vec3_turn(twist.z, z);
    input.reference.jerk = vec3_turn(twist.z, vec3_turn(twist.z, z));
}

void setUp(void)
{
    params = (control_params_t){
        .robot = &omnibot,
        .order = 0,
        .epsilon_per_N = 0.01f,
        .delta_mps = 1.0e-3f,
        .speed_length_m = 1.0f,
        .gains = {{70.0f, 70.0f, 70.0f}, {23.0f, 23.0f, 23.0f}},
        .force_bound_N = 1000.0f,
        .torque_bound_Nm = 1000.0f,
    };
    rest_at(0.0);
}

void tearDown(void)
{
}

static void step(void)
{
    TEST_ASSERT_TRUE(control_step(&params, &input, &output));
}

static void assert_vec3(double x, double y, double z, vec3_t actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)x, actual.x);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)y, actual.y);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)z, actual.z);
}

static void assert_same(vec3_t expected, vec3_t actual)
{
    assert_vec3((double)expected.x, (double)expected.y, (double)expected.z, actual, 0.0);
}

static void assert_output_is_zero(void)
{
    const vec3_t all[] = {output.torque_Nm, output.mu_mps, output.wheel_force_N,
                          output.twist,     output.eta,    output.error};
    for (size_t i = 0; i < sizeof all / sizeof all[0]; i++) {
        TEST_ASSERT_FALSE(isnan(all[i].x + all[i].y + all[i].z));
        TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(all[i]));
    }
    TEST_ASSERT_FALSE(output.force_bounded);
    TEST_ASSERT_FALSE(output.torque_bounded);
}

static const double small = 1.0e-5; // N·m: what rounding of the error may cause

static void assert_pushes_ahead(double sign)
{
    TEST_ASSERT_LESS_THAN_FLOAT(0.0f, (float)sign * output.torque_Nm.x);
    TEST_ASSERT_FLOAT_WITHIN((float)small, 0.0f, output.torque_Nm.y);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.0f, (float)sign * output.torque_Nm.z);
}

static void assert_pushes_left(double sign)
{
    TEST_ASSERT_GREATER_THAN_FLOAT(0.0f, (float)sign * output.torque_Nm.x);
    TEST_ASSERT_LESS_THAN_FLOAT(0.0f, (float)sign * output.torque_Nm.y);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.0f, (float)sign * output.torque_Nm.z);
}

// ---- signs: position errors

static void test_step_behind_along_world_x_facing_ahead_pushes_ahead(void)
{
    input.reference.position.x += 0.01f;
    step();
    assert_pushes_ahead(1.0);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, -0.01f, output.error.x);
}

static void test_step_ahead_along_world_x_pushes_back(void)
{
    input.reference.position.x -= 0.01f;
    step();
    assert_pushes_ahead(-1.0);
}

static void test_step_behind_along_world_y_facing_ahead_pushes_left(void)
{
    input.reference.position.y += 0.01f;
    step();
    assert_pushes_left(1.0);
}

static void test_step_behind_along_world_x_facing_left_pushes_right(void)
{
    rest_at(pi / 2.0);
    input.reference.position.x += 0.01f;
    step();
    assert_pushes_left(-1.0);
}

static void test_step_behind_along_world_y_facing_left_pushes_ahead(void)
{
    rest_at(pi / 2.0);
    input.reference.position.y += 0.01f;
    step();
    assert_pushes_ahead(1.0);
}

static void test_step_behind_along_world_x_facing_back_pushes_back(void)
{
    rest_at(pi);
    input.reference.position.x += 0.01f;
    step();
    assert_pushes_ahead(-1.0);
}

// ---- signs: heading errors

/// The part of the torques that turns: the push of a heading error along body x cancels in the sum.
static float turning_torque(void)
{
    return vec3_sum(output.torque_Nm);
}

static void test_step_heading_right_of_the_reference_turns_left(void)
{
    input.reference.position.z += 0.1f;
    step();
    // 7 rad/s² about the point: Mo's yaw part, and each wheel's own spin b/r of it.
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(7.0 * (r * Ic / b + 3.0 * Iw * b / r)), turning_torque());
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(7.0 * L), output.eta.x);
}

static void test_step_heading_left_of_the_reference_turns_right(void)
{
    input.reference.position.z -= 0.1f;
    step();
    TEST_ASSERT_LESS_THAN_FLOAT(0.0f, turning_torque());
}

static void test_step_heading_just_below_pi_reference_just_above_minus_pi_turns_left(void)
{
    rest_at(pi - 0.01);
    input.reference.position.z = (float)(-pi + 0.01);
    step();
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, -0.02f, output.error.z);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.0f, turning_torque());
}

static void test_step_heading_just_above_minus_pi_reference_just_below_pi_turns_right(void)
{
    rest_at(-pi + 0.01);
    input.reference.position.z = (float)(pi - 0.01);
    step();
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.02f, output.error.z);
    TEST_ASSERT_LESS_THAN_FLOAT(0.0f, turning_torque());
}

// ---- signs: velocity errors

static void test_step_rolling_ahead_unasked_brakes(void)
{
    input.wheel_speed_rad_per_s = mat3_apply(&omnibot.wheel_rate_of_twist, (vec3_t){0.1f, 0.0f, 0.0f});
    step();
    assert_pushes_ahead(-1.0);
}

static void test_step_each_wheel_rolling_alone_is_braked(void)
{
    for (int wheel = 0; wheel < 3; wheel++) {
        rest_at(0.4);
        input.wheel_speed_rad_per_s =
            (vec3_t){wheel == 0 ? 1.0f : 0.0f, wheel == 1 ? 1.0f : 0.0f, wheel == 2 ? 1.0f : 0.0f};
        step();
        const vec3_t t = output.torque_Nm;
        TEST_ASSERT_LESS_THAN_FLOAT(0.0f, wheel == 0 ? t.x : wheel == 1 ? t.y : t.z);
    }
}

// ---- order 0 by hand

static void test_step_order0_at_rest_without_error_gives_no_torque(void)
{
    for (int i = -31; i <= 31; i++) {
        rest_at(0.1 * i);
        step();
        assert_vec3(0.0, 0.0, 0.0, output.torque_Nm, small);
        assert_vec3(0.0, 0.0, 0.0, output.mu_mps, 1e-5);
    }
}

static void test_step_order0_accelerating_ahead_gives_the_hand_computed_torque(void)
{
    input.reference.acceleration.x = 1.5f;
    step();
    // u0 = r λ0 + Iw J η, λ0 = ± m a / √3, J η = ± (√3/2) a / r
    const double torque = r * m * 1.5 / sqrt(3.0) + Iw * half_root3 * 1.5 / r;
    assert_vec3(-torque, 0.0, torque, output.torque_Nm, 1e-6);
    assert_vec3(1.5, 0.0, 0.0, output.eta, 1e-4);
}

static void test_step_order0_accelerating_left_gives_the_hand_computed_torque(void)
{
    input.reference.acceleration.y = 1.5f;
    step();
    const double torque = r * m * 1.5 / 3.0 + Iw * 0.5 * 1.5 / r;
    assert_vec3(torque, -2.0 * torque, torque, output.torque_Nm, 1e-6);
}

static void test_step_order0_turning_up_about_the_centre_gives_the_hand_computed_torque(void)
{
    // The point at (0, L) then accelerates by −L along x.
    input.reference.acceleration = (vec3_t){(float)(-2.0 * L), 0.0f, 2.0f};
    step();
    const double torque = r * Ic * 2.0 / (3.0 * b) + Iw * b * 2.0 / r;
    assert_vec3(torque, torque, torque, output.torque_Nm, 1e-6);
}

static void test_step_order0_in_a_steady_left_bend_gives_the_hand_computed_torque(void)
{
    move_steadily((vec3_t){1.0f, 0.0f, 2.0f});
    step();
    // ω νx = 2 m/s² to the left; the wheels keep their speeds.
    const double torque = r * 2.0 * m / 3.0;
    assert_vec3(torque, -2.0 * torque, torque, output.torque_Nm, 1e-5);
    assert_vec3(1.0, 0.0, 2.0, output.twist, 1e-6);
    assert_vec3(0.0, 0.0, 0.0, output.eta, 1e-4);
}

static void test_step_order0_driving_straight_gives_no_torque(void)
{
    move_steadily((vec3_t){0.7f, -0.4f, 0.0f});
    step();
    assert_vec3(0.0, 0.0, 0.0, output.torque_Nm, 3.0 * small);
}

static void test_step_order0_wheel_force_and_mu_belong_together(void)
{
    move_steadily((vec3_t){1.0f, 0.0f, 2.0f});
    step();
    // Across: H = −κ λ / (3/2 + r²), κ = V + δ, V² = 1 + (1 · 2)².
    const double kappa = sqrt(5.0) + 1e-3;
    const double H = -kappa * 2.0 * m / 3.0 / (1.5 + r * r);
    assert_vec3(2.0 * m / 3.0, -4.0 * m / 3.0, 2.0 * m / 3.0, output.wheel_force_N, 1e-4);
    assert_vec3(H, -2.0 * H, H, output.mu_mps, 1e-3);
}

// ---- order 1

static void test_step_order1_without_slip_equals_order0(void)
{
    move_steadily((vec3_t){0.7f, -0.4f, 1.5f});
    input.reference.position.x += 0.02f;
    input.reference.jerk.y += 3.0f;
    params.epsilon_per_N = 0.0f;
    step();
    const control_output_t order0 = output;
    params.order = 1;

    step();

    assert_same(order0.torque_Nm, output.torque_Nm);
    assert_same(order0.wheel_force_N, output.wheel_force_N);
    assert_same(order0.twist, output.twist);
    assert_same(order0.eta, output.eta);
    assert_same(order0.mu_mps, output.mu_mps);
}

static void test_step_order1_accelerating_ahead_knows_that_the_body_lags_the_wheels(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = 2.0f;
    params.order = 1;
    step();
    // σ = −ε κ λ0, ν = v_odo + Jr⁻¹ σ: ahead by −ε κ m a / (3/2), κ = 0.5 + δ
    const double lag = 0.01 * 0.501 * m * 2.0 / 1.5;
    assert_vec3(0.5 - lag, 0.0, 0.0, output.twist, 1e-5);
}

static void test_step_order1_braking_knows_that_the_body_leads_the_wheels(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = -2.0f;
    params.order = 1;
    step();
    TEST_ASSERT_GREATER_THAN_FLOAT(0.505f, output.twist.x);
}

static void test_step_order1_turning_up_knows_that_the_body_lags_the_wheels(void)
{
    move_steadily((vec3_t){0.0f, 0.0f, 1.0f});
    input.reference.acceleration = vec3_add(input.reference.acceleration, (vec3_t){(float)(-3.0 * L), 0.0f, 3.0f});
    params.order = 1;
    step();
    // Yaw: ε κ Ic ω̇ / (3 b²), κ = 1 · ω + δ
    TEST_ASSERT_FLOAT_WITHIN(2e-5f, (float)(1.0 - 0.01 * 1.001 * Ic * 3.0 / (3.0 * b * b)), output.twist.z);
}

static void test_step_order1_lagging_body_is_pushed_harder(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = 2.0f;
    step();
    const float torque0 = output.torque_Nm.z;
    params.order = 1;

    step();

    TEST_ASSERT_GREATER_THAN_FLOAT(torque0, output.torque_Nm.z);
}

static void test_step_order1_differs_from_order0_by_order_epsilon(void)
{
    move_steadily((vec3_t){0.7f, -0.4f, 1.5f});
    input.reference.position.x += 0.02f;
    step();
    const vec3_t torque0 = output.torque_Nm;
    params.order = 1;
    float difference[2];
    for (int i = 0; i < 2; i++) {
        params.epsilon_per_N = i == 0 ? 1.0e-3f : 2.0e-3f;
        step();
        difference[i] = vec3_max_abs(vec3_sub(output.torque_Nm, torque0));
    }

    TEST_ASSERT_FLOAT_WITHIN(0.1f, 2.0f, difference[1] / difference[0]);
}

static void test_step_order1_slip_is_that_of_the_bounded_force(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = 20.0f;
    params.order = 1;
    params.force_bound_N = 1.0f;
    step();
    // Wheels 1 and 3 pull 1 N each: ahead by √3/3 · 2 of it through Jr⁻¹; the force is the bounded one in κ λ too.
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(0.5 - 0.01 * 0.501 * 2.0 / sqrt(3.0)), output.twist.x);
}

// ---- bounds

static void far_from_the_reference(void)
{
    move_steadily((vec3_t){0.3f, 0.2f, 0.5f});
    input.reference.position = vec3_add(input.reference.position, (vec3_t){3.0f, 1.0f, 0.8f});
}

static void assert_parallel(vec3_t a, vec3_t c)
{
    const vec3_t unit_a = vec3_scale(1.0f / vec3_max_abs(a), a);
    const vec3_t unit_c = vec3_scale(1.0f / vec3_max_abs(c), c);
    assert_vec3((double)unit_a.x, (double)unit_a.y, (double)unit_a.z, unit_c, 1e-6);
}

static void test_step_within_its_bounds_reports_none(void)
{
    input.reference.position.x += 0.001f;
    step();
    TEST_ASSERT_FALSE(output.force_bounded);
    TEST_ASSERT_FALSE(output.torque_bounded);
}

static void test_step_force_bound_keeps_direction_and_is_hit(void)
{
    far_from_the_reference();
    step();
    const control_output_t free = output;
    params.force_bound_N = 3.5f;

    step();

    TEST_ASSERT_TRUE(output.force_bounded);
    TEST_ASSERT_FALSE(output.torque_bounded);
    TEST_ASSERT_FLOAT_WITHIN(3.5f * 2e-7f, 3.5f, vec3_max_abs(output.wheel_force_N));
    assert_parallel(free.wheel_force_N, output.wheel_force_N);
    assert_parallel(free.torque_Nm, output.torque_Nm);
    assert_same(free.eta, output.eta);
}

static void test_step_mu_is_that_of_the_bounded_force(void)
{
    far_from_the_reference();
    step();
    const control_output_t free = output;
    params.force_bound_N = 3.5f;

    step();

    const float share = vec3_max_abs(output.wheel_force_N) / vec3_max_abs(free.wheel_force_N);
    TEST_ASSERT_LESS_THAN_FLOAT(0.1f, share);
    assert_vec3((double)(share * free.mu_mps.x), (double)(share * free.mu_mps.y), (double)(share * free.mu_mps.z),
                output.mu_mps, 1e-4 * (double)vec3_max_abs(output.mu_mps));
}

static void test_step_torque_bound_keeps_direction_and_is_hit(void)
{
    far_from_the_reference();
    step();
    const control_output_t free = output;
    params.torque_bound_Nm = 0.2f;

    step();

    TEST_ASSERT_TRUE(output.torque_bounded);
    TEST_ASSERT_FALSE(output.force_bounded);
    TEST_ASSERT_FLOAT_WITHIN(0.2f * 2e-7f, 0.2f, vec3_max_abs(output.torque_Nm));
    assert_parallel(free.torque_Nm, output.torque_Nm);
}

static void test_step_both_bounds_together_hold_both(void)
{
    far_from_the_reference();
    params.order = 1;
    params.force_bound_N = 3.5f;
    params.torque_bound_Nm = 0.05f;

    step();

    TEST_ASSERT_TRUE(output.force_bounded);
    TEST_ASSERT_TRUE(output.torque_bounded);
    TEST_ASSERT_FLOAT_WITHIN(3.5f * 2e-7f, 3.5f, vec3_max_abs(output.wheel_force_N));
    TEST_ASSERT_FLOAT_WITHIN(0.05f * 2e-7f, 0.05f, vec3_max_abs(output.torque_Nm));
}

static void test_step_bound_of_zero_gives_zero_torque(void)
{
    far_from_the_reference();
    params.force_bound_N = 0.0f;
    step();
    assert_vec3(0.0, 0.0, 0.0, output.torque_Nm, 0.0);

    params.force_bound_N = 3.5f;
    params.torque_bound_Nm = 0.0f;
    step();
    assert_vec3(0.0, 0.0, 0.0, output.torque_Nm, 0.0);
}

static void test_step_bound_just_above_the_demand_changes_nothing(void)
{
    far_from_the_reference();
    step();
    const control_output_t free = output;
    params.force_bound_N = nextafterf(vec3_max_abs(free.wheel_force_N), 1e9f);
    params.torque_bound_Nm = nextafterf(vec3_max_abs(free.torque_Nm), 1e9f);

    step();

    TEST_ASSERT_FALSE(output.force_bounded);
    TEST_ASSERT_FALSE(output.torque_bounded);
    assert_same(free.torque_Nm, output.torque_Nm);
}

static void test_step_bounded_demand_still_has_its_error_in_the_output(void)
{
    far_from_the_reference();
    params.force_bound_N = 3.5f;
    step();
    assert_vec3(-3.0, -1.0, -0.8, output.error, 1e-5);
}

// ---- what must never come out

/// The i-th number of the input.
static float *input_number(int i)
{
    vec3_t *const triplet[] = {&input.pose,
                               &input.wheel_speed_rad_per_s,
                               &input.reference.position,
                               &input.reference.velocity,
                               &input.reference.acceleration,
                               &input.reference.jerk};
    vec3_t *const of = triplet[i / 3];
    return i % 3 == 0 ? &of->x : i % 3 == 1 ? &of->y : &of->z;
}

static void test_step_with_any_number_not_finite_is_refused_with_zeros(void)
{
    const float bad[] = {NAN, -NAN, INFINITY, -INFINITY};
    for (int32_t order = 0; order <= CONTROL_ORDER_MAX; order++) {
        for (int i = 0; i < 18; i++) {
            for (int k = 0; k < 4; k++) {
                move_steadily((vec3_t){0.3f, 0.2f, 0.5f});
                params.order = order;
                step(); // leaves numbers that must go
                *input_number(i) = bad[k];

                TEST_ASSERT_FALSE(control_step(&params, &input, &output));
                assert_output_is_zero();
            }
        }
    }
}

static void test_step_whose_result_overflows_is_refused_with_zeros(void)
{
    for (int32_t order = 0; order <= CONTROL_ORDER_MAX; order++) {
        rest_at(0.0);
        params.order = order;
        input.reference.position.x = 3.0e38f;

        TEST_ASSERT_FALSE(control_step(&params, &input, &output));
        assert_output_is_zero();
    }
}

static void test_step_with_a_gain_not_finite_is_refused_with_zeros(void)
{
    params.gains.stiffness_per_s2.x = NAN;

    TEST_ASSERT_FALSE(control_step(&params, &input, &output));
    assert_output_is_zero();
}

static void test_step_twice_gives_the_same(void)
{
    far_from_the_reference();
    params.order = 1;
    step();
    const control_output_t first = output;

    step();

    assert_same(first.torque_Nm, output.torque_Nm);
    assert_same(first.mu_mps, output.mu_mps);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_step_behind_along_world_x_facing_ahead_pushes_ahead);
    RUN_TEST(test_step_ahead_along_world_x_pushes_back);
    RUN_TEST(test_step_behind_along_world_y_facing_ahead_pushes_left);
    RUN_TEST(test_step_behind_along_world_x_facing_left_pushes_right);
    RUN_TEST(test_step_behind_along_world_y_facing_left_pushes_ahead);
    RUN_TEST(test_step_behind_along_world_x_facing_back_pushes_back);
    RUN_TEST(test_step_heading_right_of_the_reference_turns_left);
    RUN_TEST(test_step_heading_left_of_the_reference_turns_right);
    RUN_TEST(test_step_heading_just_below_pi_reference_just_above_minus_pi_turns_left);
    RUN_TEST(test_step_heading_just_above_minus_pi_reference_just_below_pi_turns_right);
    RUN_TEST(test_step_rolling_ahead_unasked_brakes);
    RUN_TEST(test_step_each_wheel_rolling_alone_is_braked);
    RUN_TEST(test_step_order0_at_rest_without_error_gives_no_torque);
    RUN_TEST(test_step_order0_accelerating_ahead_gives_the_hand_computed_torque);
    RUN_TEST(test_step_order0_accelerating_left_gives_the_hand_computed_torque);
    RUN_TEST(test_step_order0_turning_up_about_the_centre_gives_the_hand_computed_torque);
    RUN_TEST(test_step_order0_in_a_steady_left_bend_gives_the_hand_computed_torque);
    RUN_TEST(test_step_order0_driving_straight_gives_no_torque);
    RUN_TEST(test_step_order0_wheel_force_and_mu_belong_together);
    RUN_TEST(test_step_order1_without_slip_equals_order0);
    RUN_TEST(test_step_order1_accelerating_ahead_knows_that_the_body_lags_the_wheels);
    RUN_TEST(test_step_order1_braking_knows_that_the_body_leads_the_wheels);
    RUN_TEST(test_step_order1_turning_up_knows_that_the_body_lags_the_wheels);
    RUN_TEST(test_step_order1_lagging_body_is_pushed_harder);
    RUN_TEST(test_step_order1_differs_from_order0_by_order_epsilon);
    RUN_TEST(test_step_order1_slip_is_that_of_the_bounded_force);
    RUN_TEST(test_step_within_its_bounds_reports_none);
    RUN_TEST(test_step_force_bound_keeps_direction_and_is_hit);
    RUN_TEST(test_step_mu_is_that_of_the_bounded_force);
    RUN_TEST(test_step_torque_bound_keeps_direction_and_is_hit);
    RUN_TEST(test_step_both_bounds_together_hold_both);
    RUN_TEST(test_step_bound_of_zero_gives_zero_torque);
    RUN_TEST(test_step_bound_just_above_the_demand_changes_nothing);
    RUN_TEST(test_step_bounded_demand_still_has_its_error_in_the_output);
    RUN_TEST(test_step_with_any_number_not_finite_is_refused_with_zeros);
    RUN_TEST(test_step_whose_result_overflows_is_refused_with_zeros);
    RUN_TEST(test_step_with_a_gain_not_finite_is_refused_with_zeros);
    RUN_TEST(test_step_twice_gives_the_same);
    return UNITY_END();
}
