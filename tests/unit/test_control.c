// SPDX-License-Identifier: MIT
// The whole step: signs of the torques first, then values by hand, the orders against their limit, the observer, dead
// reckoning, the bounds, and what must never come out. Wheel signs for a push: ahead (−, 0, +), left (+, −−, +), left
// turn (+, +, +).
#include "control.h"

#include "kinematics.h"
#include "manifold.h"
#include "unity.h"

static const double m = 1.903, Ic = 0.0132, Iw = 1.6e-5, L = 0.12, b = 0.12, r = 0.0349;
static const double half_root3 = 0.86602540378443864676;
static const double pi = 3.14159265358979323846;

static const vec3_t zero = {0.0f, 0.0f, 0.0f};
static control_params_t params;
static control_state_t state;
static control_input_t input;
static control_output_t output;

/// At rest with no error, at a heading: the reference is the tracked point.
static void rest_at(double heading)
{
    const float at = (float)heading;
    input = (control_input_t){.pose_is_new = true, .pose = {0.5f, -0.25f, at}};
    input.reference.position = (vec3_t){(float)(0.5 - L * sin((double)at)), (float)(-0.25 + L * cos((double)at)), at};
}

/// The wheels and the reference of a body twist that is to stay as it is, at zero heading and with no error.
static void move_steadily(vec3_t twist)
{
    rest_at(0.0);
    const vec3_t z = kinematics_point_twist(&omnibot, twist);
    input.wheel_speed_rad_per_s = wheels_of_body(&omnibot.wheel_rate_of_twist, twist);
    input.reference.velocity = z;
    input.reference.acceleration = vec3_add_turn(zero, twist.z, z);
    input.reference.jerk = vec3_add_turn(zero, twist.z, vec3_add_turn(zero, twist.z, z));
}

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
        .observer_lag_s = 3.0e-3f,
        .force_bound_N = 1000.0f,
        .torque_bound_Nm = 1000.0f,
    };
    state = (control_state_t){0};
    rest_at(0.0);
}

void tearDown(void)
{
}

static void step(void)
{
    control_prepare(&params);
    TEST_ASSERT_TRUE(control_step(&params, &state, &input, &output));
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
    input.wheel_speed_rad_per_s = wheels_of_body(&omnibot.wheel_rate_of_twist, (vec3_t){0.1f, 0.0f, 0.0f});
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

static void test_step_of_any_order_without_slip_equals_order0(void)
{
    move_steadily((vec3_t){0.7f, -0.4f, 1.5f});
    input.reference.position.x += 0.02f;
    input.reference.jerk.y += 3.0f;
    params.floor.compliance_per_N = 0.0f;
    step();
    const control_output_t order0 = output;
    for (params.order = 1; params.order <= CONTROL_OBSERVER; params.order++) {
        step();

        assert_same(order0.torque_Nm, output.torque_Nm);
        assert_same(order0.wheel_force_N, output.wheel_force_N);
        assert_same(order0.twist, output.twist);
        assert_same(order0.eta, output.eta);
        assert_same(order0.mu_mps, output.mu_mps);
    }
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
        params.floor.compliance_per_N = i == 0 ? 1.0e-3f : 2.0e-3f;
        step();
        difference[i] = vec3_max_abs(vec3_sub(output.torque_Nm, torque0));
    }

    TEST_ASSERT_FLOAT_WITHIN(0.1f, 2.0f, difference[1] / difference[0]);
}

static void test_step_order1_gives_the_hand_computed_torque(void)
{
    // Straight ahead at ω = 0 everything is one number.
    const double v = 0.5, a = 2.0, jerk = 20.0, epsilon = 0.01, K1 = 70.0, K2 = 23.0;
    move_steadily((vec3_t){(float)v, 0.0f, 0.0f});
    input.reference.acceleration.x = (float)a;
    input.reference.jerk.x = (float)jerk;
    params.order = 1;
    step();
    const double c = epsilon * (v + 1e-3);
    const double nu = v - c * m / 1.5 * a;
    const double eta = a - K2 * (nu - v);
    const double eta_rate = jerk - K2 * (eta - a) - K1 * (nu - v);
    const double force = m * eta / sqrt(3.0), force_rate = m * eta_rate / sqrt(3.0);
    const double slip_rate = -c * force_rate - epsilon * eta * force; // V̇ = η
    const double torque = r * force + Iw * (half_root3 * eta - slip_rate) / r;
    assert_vec3(-torque, 0.0, torque, output.torque_Nm, 5e-7);
    // What the test can tell: the slip's growth is a hundred times the tolerance.
    TEST_ASSERT_GREATER_THAN_FLOAT(1e-5f, (float)fabs(Iw * epsilon * eta * force / r));
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

// ---- the series and its limit

static void far_from_the_reference(void)
{
    move_steadily((vec3_t){0.3f, 0.2f, 0.5f});
    input.reference.position = vec3_add(input.reference.position, (vec3_t){3.0f, 1.0f, 0.8f});
}

/// Moving, turning and pulling hard.
static void far_from_straight(void)
{
    move_steadily((vec3_t){0.7f, -0.4f, 1.5f});
    input.reference.position.x += 0.02f;
    input.reference.acceleration.y += 2.0f;
}

static vec3_t wheel_force_at(vec3_t twist)
{
    const tracking_t tracking = tracking_from(&omnibot, &params.law, input.pose, &input.reference);
    const vec3_t eta = tracking_eta(&omnibot, &params.law, &tracking, twist);
    return manifold_force(&omnibot, vec3_add_turn(eta, twist.z, twist));
}

/// c = ε (V + δ) with the encoders' V.
static float compliance(void)
{
    const vec3_t odometry = kinematics_odometry(&omnibot, input.wheel_speed_rad_per_s);
    return params.floor.compliance_per_N * (kinematics_speed(odometry, params.speed_length_m) + params.delta_mps);
}

/// ν + c Jr⁻¹ λ(ν) − v_odo.
static vec3_t residual_of(vec3_t twist)
{
    const vec3_t slip = body_of_wheels(&omnibot.twist_of_contact_speed, wheel_force_at(twist));
    return vec3_sub(vec3_add_scaled(twist, compliance(), slip),
                    kinematics_odometry(&omnibot, input.wheel_speed_rad_per_s));
}

static vec3_t twist_of_order(int32_t order)
{
    params.order = order;
    step();
    return output.twist;
}

static void test_step_orders_approach_their_limit_by_the_ratio(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = 6.0f;
    const vec3_t limit = twist_of_order(CONTROL_EXACT);
    float distance[CONTROL_ORDER_MAX + 1];
    for (int32_t order = 0; order <= CONTROL_ORDER_MAX; order++) {
        distance[order] = vec3_max_abs(vec3_sub(twist_of_order(order), limit));
    }
    const double ratio = 0.01 * 0.501 * 23.0 * m / 1.5;
    for (int i = 0; i < CONTROL_ORDER_MAX; i++) {
        TEST_ASSERT_FLOAT_WITHIN(0.01f * (float)ratio, (float)ratio, distance[i + 1] / distance[i]);
    }
}

static void test_step_orders_turning_approach_their_limit_by_the_yaw_ratio(void)
{
    move_steadily((vec3_t){0.0f, 0.0f, 2.0f});
    const vec3_t up = {(float)(-40.0 * L), 0.0f, 40.0f};
    input.reference.acceleration = vec3_add(input.reference.acceleration, up);
    const float limit = twist_of_order(CONTROL_EXACT).z;
    const double ratio = 0.01 * 2.001 * 23.0 * Ic / (3.0 * b * b);
    for (int32_t order = 0; order < CONTROL_ORDER_MAX; order++) {
        const float near = twist_of_order(order + 1).z - limit, far = twist_of_order(order).z - limit;
        TEST_ASSERT_FLOAT_WITHIN(0.01f * (float)ratio, (float)ratio, near / far);
    }
}

static float noise(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (float)(int32_t)*seed / 2147483648.0f;
}

static vec3_t random_vec3(uint32_t *seed, float planar, float turn)
{
    const float x = planar * noise(seed), y = planar * noise(seed);
    return (vec3_t){x, y, turn * noise(seed)};
}

/// Near the reference, as a robot that tracks is.
static void move_somehow(uint32_t *seed)
{
    move_steadily(random_vec3(seed, 0.7f, 1.5f));
    input.reference.position = vec3_add(input.reference.position, random_vec3(seed, 0.01f, 0.02f));
    input.reference.velocity = vec3_add(input.reference.velocity, random_vec3(seed, 0.05f, 0.1f));
    input.reference.acceleration = vec3_add(input.reference.acceleration, random_vec3(seed, 1.0f, 2.0f));
}

static void test_step_exact_is_where_the_series_ends(void)
{
    uint32_t seed = 7;
    for (int i = 0; i < 300; i++) {
        move_somehow(&seed);
        params.law.output = i % 2 == 0 ? OUTPUT_POSTURE : OUTPUT_POINT;
        params.floor.compliance_per_N = 1e-4f * powf(10.0f, 2.0f * fabsf(noise(&seed)));
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.0f, vec3_max_abs(residual_of(twist_of_order(CONTROL_EXACT))));
    }
}

// ---- ε held back

/// c as it shows: ahead at 0.5 m/s with a pull of m a, order 1 lags by c m a / 1.5.
static double visible_compliance(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = 2.0f;
    return (0.5 - (double)twist_of_order(1).x) * 1.5 / (m * 2.0);
}

static void test_step_compliance_grows_to_its_bound_and_stays(void)
{
    params.series_ratio_max = 0.3f;
    const double most = 0.3 * 1.5 / (23.0 * m);
    for (int i = 0; i <= 60; i++) {
        const double epsilon = pow(10.0, -3.0 + 0.05 * i);
        params.floor.compliance_per_N = (float)epsilon;
        const double wanted = epsilon * 0.501;
        const double expected = wanted < most ? wanted : most;
        TEST_ASSERT_FLOAT_WITHIN((float)(1e-4 * most), (float)expected, (float)visible_compliance());
    }
}

static void test_step_compliance_is_bounded_in_every_order_of_the_series(void)
{
    // Past the bound ε makes no difference to the twist, whatever the order.
    params.series_ratio_max = 0.3f;
    for (int32_t order = 1; order <= CONTROL_EXACT; order++) {
        far_from_straight();
        params.floor.compliance_per_N = 0.2f;
        const vec3_t at02 = twist_of_order(order);
        params.floor.compliance_per_N = 1.0f;
        assert_same(at02, twist_of_order(order));
    }
}

static void test_step_compliance_bound_of_zero_is_order0(void)
{
    params.series_ratio_max = 0.0f;
    far_from_straight();
    const vec3_t odometry = twist_of_order(0);
    for (int32_t order = 1; order <= CONTROL_EXACT; order++) {
        assert_same(odometry, twist_of_order(order));
    }
}

static void test_step_compliance_bound_falls_with_the_damping(void)
{
    params.series_ratio_max = 0.3f;
    params.floor.compliance_per_N = 1.0f;
    const double soft = visible_compliance();
    params.law.damping_per_s = (vec3_t){46.0f, 46.0f, 46.0f};
    TEST_ASSERT_FLOAT_WITHIN((float)(1e-4 * soft), (float)(0.5 * soft), (float)visible_compliance());
}

// ---- the observer

/// 1 − e^(−T/τ): the layer's τ by (18), with M22 Γ²'s eigenvalue of 76.9, and the lag.
static double observer_gain(void)
{
    const double x = (double)output.twist.x, y = (double)output.twist.y, w = (double)output.twist.z;
    const double layer = (double)params.floor.compliance_per_N * (sqrt(x * x + y * y + w * w) + 1e-3) / 76.9138565;
    return 1.0 - exp(-1e-3 / (layer + (double)params.observer_lag_s + 1e-6));
}

static void test_step_observer_relaxes_to_the_applied_force_by_its_gain(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    input.reference.acceleration.x = 2.0f;
    params.order = CONTROL_OBSERVER;
    state.force_estimate_N = (vec3_t){1.0f, -2.0f, 0.5f};
    for (int k = 0; k < 50; k++) {
        const vec3_t before = state.force_estimate_N;
        step();
        const float gain = (float)observer_gain();
        const vec3_t expected = vec3_add_scaled(before, gain, vec3_sub(output.wheel_force_N, before));
        // e^x is cut after its cubic term: x⁴/24 of the way.
        const float way = vec3_max_abs(vec3_sub(output.wheel_force_N, before));
        TEST_ASSERT_FLOAT_WITHIN(1e-6f + 5e-4f * way, 0.0f, vec3_max_abs(vec3_sub(expected, state.force_estimate_N)));
    }
    TEST_ASSERT_FLOAT_WITHIN(1e-3f, 0.0f, vec3_max_abs(vec3_sub(output.wheel_force_N, state.force_estimate_N)));
}

static void test_step_observer_lags_as_the_boundary_layer_and_the_drive_do(void)
{
    for (int i = 0; i <= 40; i++) {
        for (int k = 0; k < 3; k++) {
            state = (control_state_t){0};
            move_steadily((vec3_t){0.8f, 0.0f, 0.0f});
            input.reference.acceleration.x = 2.0f;
            params.floor.compliance_per_N = powf(10.0f, -4.0f + 0.1f * (float)i);
            params.observer_lag_s = k == 0 ? 0.0f : k == 1 ? 1.0e-3f : 0.1f;
            params.order = CONTROL_OBSERVER;
            step();
            const float gain = state.force_estimate_N.z / output.wheel_force_N.z;
            TEST_ASSERT_FLOAT_WITHIN(0.03f, (float)observer_gain(), gain);
            TEST_ASSERT_TRUE(gain > 0.0f && gain <= 1.0f);
        }
    }
}

static void test_step_observer_at_rest_lags_by_delta(void)
{
    input.reference.acceleration.x = 2.0f;
    params.delta_mps = 0.5f;
    params.floor.compliance_per_N = 0.3f;
    params.observer_lag_s = 0.0f;
    params.order = CONTROL_OBSERVER;
    step();
    const double gain = 1.0 - exp(-1e-3 / (0.3 * 0.5 / 76.9138565));
    TEST_ASSERT_FLOAT_WITHIN(0.01f, (float)gain, state.force_estimate_N.z / output.wheel_force_N.z);
}

static void test_step_observer_without_any_lag_takes_the_force_at_once(void)
{
    far_from_straight();
    params.order = CONTROL_OBSERVER;
    params.observer_lag_s = 0.0f;
    params.floor.compliance_per_N = 0.0f;
    step();
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.0f, vec3_max_abs(vec3_sub(output.wheel_force_N, state.force_estimate_N)));
}

static void test_step_observer_follows_what_the_bounds_have_left(void)
{
    far_from_the_reference();
    params.order = CONTROL_OBSERVER;
    params.force_bound_N = 3.5f;
    params.torque_bound_Nm = 0.05f;
    for (int k = 0; k < 100; k++) {
        step();
    }
    TEST_ASSERT_TRUE(output.torque_bounded);
    TEST_ASSERT_FLOAT_WITHIN(1e-3f, 0.0f, vec3_max_abs(vec3_sub(output.wheel_force_N, state.force_estimate_N)));
    TEST_ASSERT_LESS_THAN_FLOAT(2.0f, vec3_max_abs(state.force_estimate_N));
}

static void test_step_force_estimate_follows_in_every_order(void)
{
    for (int32_t order = 0; order <= CONTROL_OBSERVER; order++) {
        state = (control_state_t){0};
        far_from_straight();
        params.order = order;
        step();
        const vec3_t expected = vec3_scale((float)observer_gain(), output.wheel_force_N);
        TEST_ASSERT_FLOAT_WITHIN(3e-3f, 0.0f, vec3_max_abs(vec3_sub(expected, state.force_estimate_N)));
    }
}

static void test_step_observer_in_steady_force_agrees_with_exact_on_a_linear_floor(void)
{
    uint32_t seed = 9;
    for (int i = 0; i < 50; i++) {
        move_somehow(&seed);
        const vec3_t exact = twist_of_order(CONTROL_EXACT);
        state = (control_state_t){0};
        for (int k = 0; k < 200; k++) {
            (void)twist_of_order(CONTROL_OBSERVER);
        }

        // The observer takes V of ν, the series that of the encoders: the slip differs by the share of the slip.
        const vec3_t odometry = kinematics_odometry(&omnibot, input.wheel_speed_rad_per_s);
        const float speed = kinematics_speed(odometry, 1.0f);
        const float slip = vec3_max_abs(vec3_sub(exact, odometry));
        TEST_ASSERT_FLOAT_WITHIN(1e-6f + 2.0f * slip * slip / speed, 0.0f, vec3_max_abs(vec3_sub(exact, output.twist)));
        // And it sits on the manifold: ν + ε (V(ν) + δ) Jr⁻¹ λ = v_odo.
        const float c = 0.01f * (kinematics_speed(output.twist, 1.0f) + 1e-3f);
        const vec3_t slip_twist = body_of_wheels(&omnibot.twist_of_contact_speed, wheel_force_at(output.twist));
        const vec3_t left = vec3_sub(vec3_add_scaled(output.twist, c, slip_twist), odometry);
        TEST_ASSERT_FLOAT_WITHIN(3e-6f + slip * slip * slip * slip / (speed * speed * speed), 0.0f, vec3_max_abs(left));
    }
}

/// s with F(s) = λ on the rising branch of (4), by halving.
static double magic_slip(double force)
{
    const double C = 1.65, E = 0.432, B = 1.0 / (0.01 * C * 5.0);
    double low = 0.0, high = 0.2;
    for (int i = 0; i < 60; i++) {
        const double s = 0.5 * (low + high), x = B * s;
        *(5.0 * sin(C * atan(x - E * (x - atan(x)))) < fabs(force) ? &low : &high) = s;
    }
    return copysign(low, force);
}

static void test_step_observer_reads_the_slip_off_the_traction_curve(void)
{
    const double force[] = {3.4, -1.0, -2.4};
    move_steadily((vec3_t){0.8f, 0.3f, 0.5f});
    params.order = CONTROL_OBSERVER;
    params.floor.linear = false;
    state.force_estimate_N = (vec3_t){(float)force[0], (float)force[1], (float)force[2]};
    step();
    // σ = −(V + δ) s is what the body does against the wheels: Jr (ν − v_odo).
    const double *const s = (double[]){magic_slip(force[0]), magic_slip(force[1]), magic_slip(force[2])};
    const double x = (double)output.twist.x, y = (double)output.twist.y, w = (double)output.twist.z;
    const double V = sqrt(x * x + y * y + w * w) + 1e-3;
    const double dx = x - 0.8, dy = y - 0.3, dw = w - 0.5;
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(-V * s[0]), (float)(-half_root3 * dx + 0.5 * dy + b * dw));
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(-V * s[1]), (float)(-dy + b * dw));
    TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(-V * s[2]), (float)(half_root3 * dx + 0.5 * dy + b * dw));
    // The curve matters: the linear floor would slip less.
    TEST_ASSERT_GREATER_THAN_FLOAT(1.15f * 0.034f, (float)s[0]);
}

// ---- dead reckoning

static void test_step_without_a_new_pose_takes_that_of_the_state(void)
{
    far_from_straight();
    step();
    const control_output_t seen = output;
    state.pose.value = input.pose;
    input.pose = (vec3_t){7.0f, -7.0f, 2.0f};
    input.pose_is_new = false;

    step();

    assert_same(seen.torque_Nm, output.torque_Nm);
    assert_same(seen.error, output.error);
}

static void test_step_with_a_new_pose_does_not_look_at_that_of_the_state(void)
{
    far_from_straight();
    step();
    const vec3_t torque = output.torque_Nm;
    state.pose.value = (vec3_t){7.0f, -7.0f, 2.0f};

    step();

    assert_same(torque, output.torque_Nm);
}

/// The pose after a period that begins with the output's twist and keeps an acceleration.
static void assert_pose_has_moved_at(vec3_t acceleration)
{
    const vec3_t twist = vec3_add_scaled(output.twist, 0.5e-3f, acceleration); // halfway
    const vec3_t expected =
        kinematics_moved_pose((pose_sum_t){.value = input.pose}, rotation_of(input.pose.z), twist, 1.0e-3f).value;
    TEST_ASSERT_FLOAT_WITHIN(1.2e-7f, 0.0f, vec3_max_abs(vec3_sub(expected, state.pose.value)));
}

static void test_step_moves_the_pose_by_the_corrected_twist_and_half_of_what_it_gains(void)
{
    far_from_straight();
    params.order = CONTROL_EXACT;
    step();
    const vec3_t odometry = kinematics_odometry(&omnibot, input.wheel_speed_rad_per_s);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.01f, vec3_max_abs(vec3_sub(output.twist, odometry)));
    TEST_ASSERT_GREATER_THAN_FLOAT(1.5f, vec3_max_abs(output.eta)); // 0.75 µm of the way

    assert_pose_has_moved_at(output.eta);
}

static void test_step_without_any_force_moves_the_pose_straight_on(void)
{
    far_from_straight();
    params.force_bound_N = 0.0f;
    step();
    // A velocity that stays in the world turns back in the body: ν̇ = −ω×ν.
    assert_pose_has_moved_at(vec3_add_turn(zero, -output.twist.z, output.twist));
}

static void test_step_without_poses_keeps_moving_the_pose(void)
{
    move_steadily((vec3_t){0.5f, 0.0f, 0.0f});
    step();
    input.pose_is_new = false;
    for (int k = 1; k < 1000; k++) {
        input.reference.position.x += 0.0005f;
        step();
    }
    assert_vec3(1.0, -0.25, 0.0, state.pose.value, 1e-3);
    TEST_ASSERT_FLOAT_WITHIN(1e-3f, 0.0f, vec3_max_abs(output.error));
}

// ---- bounds

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
    step();
    const control_output_t wide = output;
    TEST_ASSERT_TRUE(wide.force_bounded);
    params.torque_bound_Nm = 0.05f;

    step();

    TEST_ASSERT_TRUE(output.force_bounded);
    TEST_ASSERT_TRUE(output.torque_bounded);
    TEST_ASSERT_FLOAT_WITHIN(3.5f * 2e-7f, 3.5f, vec3_max_abs(wide.wheel_force_N));
    TEST_ASSERT_FLOAT_WITHIN(0.05f * 2e-7f, 0.05f, vec3_max_abs(output.torque_Nm));
    // The force told is what the bounded torque makes.
    const float share = 0.05f / vec3_max_abs(wide.torque_Nm);
    assert_parallel(wide.wheel_force_N, output.wheel_force_N);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 3.5f * share, vec3_max_abs(output.wheel_force_N));
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

static void assert_step_is_refused(void)
{
    const control_state_t before = state;
    control_prepare(&params);
    TEST_ASSERT_FALSE(control_step(&params, &state, &input, &output));
    assert_output_is_zero();
    TEST_ASSERT_EQUAL_MEMORY(&before, &state, sizeof state);
}

static void test_step_with_any_number_not_finite_is_refused_with_zeros(void)
{
    const float bad[] = {NAN, -NAN, INFINITY, -INFINITY};
    for (int32_t order = 0; order <= CONTROL_OBSERVER; order++) {
        const int looked_at = order == 0 ? 15 : 18; // order 0 has no use for the jerk
        for (int i = 0; i < looked_at; i++) {
            for (int k = 0; k < 4; k++) {
                move_steadily((vec3_t){0.3f, 0.2f, 0.5f});
                params.order = order;
                step(); // leaves numbers that must go
                *input_number(i) = bad[k];

                assert_step_is_refused();
            }
        }
    }
}

static void test_step_whose_result_overflows_is_refused_with_zeros(void)
{
    for (int32_t order = 0; order <= CONTROL_OBSERVER; order++) {
        rest_at(0.0);
        params.order = order;
        input.reference.position.x = 3.0e38f;

        assert_step_is_refused();
    }
}

static void test_step_with_a_gain_not_finite_is_refused_with_zeros(void)
{
    params.law.stiffness_per_s2.x = NAN;

    assert_step_is_refused();
}

static void test_step_with_a_state_not_finite_is_refused_with_zeros(void)
{
    params.order = CONTROL_OBSERVER;
    input.pose_is_new = false;
    state.pose.value.y = NAN;
    assert_step_is_refused();

    input.pose_is_new = true;
    step();
    TEST_ASSERT_TRUE(isfinite(vec3_sum(state.pose.value))); // a pose heals it
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
    RUN_TEST(test_step_of_any_order_without_slip_equals_order0);
    RUN_TEST(test_step_order1_accelerating_ahead_knows_that_the_body_lags_the_wheels);
    RUN_TEST(test_step_order1_braking_knows_that_the_body_leads_the_wheels);
    RUN_TEST(test_step_order1_turning_up_knows_that_the_body_lags_the_wheels);
    RUN_TEST(test_step_order1_lagging_body_is_pushed_harder);
    RUN_TEST(test_step_order1_differs_from_order0_by_order_epsilon);
    RUN_TEST(test_step_order1_gives_the_hand_computed_torque);
    RUN_TEST(test_step_order1_slip_is_that_of_the_bounded_force);
    RUN_TEST(test_step_orders_approach_their_limit_by_the_ratio);
    RUN_TEST(test_step_orders_turning_approach_their_limit_by_the_yaw_ratio);
    RUN_TEST(test_step_exact_is_where_the_series_ends);
    RUN_TEST(test_step_compliance_grows_to_its_bound_and_stays);
    RUN_TEST(test_step_compliance_is_bounded_in_every_order_of_the_series);
    RUN_TEST(test_step_compliance_bound_of_zero_is_order0);
    RUN_TEST(test_step_compliance_bound_falls_with_the_damping);
    RUN_TEST(test_step_observer_relaxes_to_the_applied_force_by_its_gain);
    RUN_TEST(test_step_observer_lags_as_the_boundary_layer_and_the_drive_do);
    RUN_TEST(test_step_observer_at_rest_lags_by_delta);
    RUN_TEST(test_step_observer_without_any_lag_takes_the_force_at_once);
    RUN_TEST(test_step_observer_follows_what_the_bounds_have_left);
    RUN_TEST(test_step_force_estimate_follows_in_every_order);
    RUN_TEST(test_step_observer_in_steady_force_agrees_with_exact_on_a_linear_floor);
    RUN_TEST(test_step_observer_reads_the_slip_off_the_traction_curve);
    RUN_TEST(test_step_without_a_new_pose_takes_that_of_the_state);
    RUN_TEST(test_step_with_a_new_pose_does_not_look_at_that_of_the_state);
    RUN_TEST(test_step_moves_the_pose_by_the_corrected_twist_and_half_of_what_it_gains);
    RUN_TEST(test_step_without_any_force_moves_the_pose_straight_on);
    RUN_TEST(test_step_without_poses_keeps_moving_the_pose);
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
    RUN_TEST(test_step_with_a_state_not_finite_is_refused_with_zeros);
    RUN_TEST(test_step_twice_gives_the_same);
    return UNITY_END();
}
