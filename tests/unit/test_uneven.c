// SPDX-License-Identifier: MIT
// Wheels that are not three at 120°: the maps of wheels.h and a control step with them against the robot's drawing in
// double. The robot is tests/host_sim/uneven_robot.py's; tests/host_sim/test_geometry.py does the same for more of
// them.
#include "control.h"
#include "kinematics.h"
#include "manifold.h"

#include "unity.h"

static const double m = 1.903, Ic = 0.0132, Iw = 1.6e-5, r = 0.0349;
static const double deg = 0.017453292519943295;
static const double spoke_deg[3] = {60.0, 170.0, 300.0}, drive_deg[3] = {150.0, 260.0, 40.0};
static const double distance_m[3] = {0.12, 0.12, 0.16};

static double Jr[3][3];

void setUp(void)
{
    for (int i = 0; i < 3; i++) {
        const double drive[2] = {cos(deg * drive_deg[i]), sin(deg * drive_deg[i])};
        const double hub[2] = {distance_m[i] * cos(deg * spoke_deg[i]), distance_m[i] * sin(deg * spoke_deg[i])};
        Jr[i][0] = drive[0];
        Jr[i][1] = drive[1];
        Jr[i][2] = hub[0] * drive[1] - hub[1] * drive[0];
    }
}

void tearDown(void)
{
}

static void assert_vec3(const double expected[3], vec3_t actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[0], actual.x);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[1], actual.y);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[2], actual.z);
}

/// Jr a: speeds of the contact points.
static void to_wheels(vec3_t a, double wheels[3])
{
    for (int i = 0; i < 3; i++) {
        wheels[i] = Jr[i][0] * (double)a.x + Jr[i][1] * (double)a.y + Jr[i][2] * (double)a.z;
    }
}

/// Jrᵀ a: the wrench of forces at the wheels.
static void to_body(vec3_t a, double body[3])
{
    for (int i = 0; i < 3; i++) {
        body[i] = Jr[0][i] * (double)a.x + Jr[1][i] * (double)a.y + Jr[2][i] * (double)a.z;
    }
}

static const vec3_t twist = {0.4f, -0.7f, 1.5f}, force = {1.5f, -0.6f, 2.1f};

static void test_wheels_turn_as_the_body_moves_them(void)
{
    double wheels[3];
    to_wheels(twist, wheels);
    const vec3_t rates = wheels_of_body(&omnibot.wheel_rate_of_twist, twist);
    assert_vec3(wheels, vec3_scale((float)r, rates), 1.0e-6);
}

static void test_odometry_finds_the_twist_that_turned_the_wheels(void)
{
    double wheels[3];
    to_wheels(twist, wheels);
    const vec3_t rates = {(float)(wheels[0] / r), (float)(wheels[1] / r), (float)(wheels[2] / r)};
    const double expected[3] = {(double)twist.x, (double)twist.y, (double)twist.z};
    assert_vec3(expected, kinematics_odometry(&omnibot, rates), 1.0e-5);
}

static void test_wheel_forces_are_newtons_law_of_the_body(void)
{
    const vec3_t specific = {1.2f, -0.9f, 7.0f};
    const double expected[3] = {m * (double)specific.x, m * (double)specific.y, Ic * (double)specific.z};
    double wrench[3];
    to_body(manifold_force(&omnibot, specific), wrench);
    assert_vec3(expected, (vec3_t){(float)wrench[0], (float)wrench[1], (float)wrench[2]}, 1.0e-5);
}

/// Γ µ = −κ λ with Γ = Jr Jrᵀ + r².
static void test_mu_makes_the_slip_of_the_forces(void)
{
    const vec3_t mu = manifold_of_force(&omnibot, 0.5f, force);
    double body[3], slip[3];
    to_body(mu, body);
    to_wheels((vec3_t){(float)body[0], (float)body[1], (float)body[2]}, slip);
    const double left[3] = {slip[0] + r * r * (double)mu.x, slip[1] + r * r * (double)mu.y,
                            slip[2] + r * r * (double)mu.z};
    const double expected[3] = {-0.5 * (double)force.x, -0.5 * (double)force.y, -0.5 * (double)force.z};
    assert_vec3(expected, (vec3_t){(float)left[0], (float)left[1], (float)left[2]}, 2.0e-5);
}

/// D a = Jr⁻¹ Λ a: the twist that slip of the forces of a takes away.
static void test_slip_mass_is_the_twist_of_slip_like_the_forces(void)
{
    const vec3_t specific = {1.2f, -0.9f, 7.0f}, forces = manifold_force(&omnibot, specific);
    const double expected[3] = {(double)forces.x, (double)forces.y, (double)forces.z};
    double contact[3];
    to_wheels(slip_mass_times(&omnibot.slip_mass, specific), contact);
    assert_vec3(expected, (vec3_t){(float)contact[0], (float)contact[1], (float)contact[2]}, 1.0e-5);
}

// ---- a control step

static control_params_t params;
static control_input_t input;

/// A robot off its reference at a twist, on a linear floor without bounds.
static void make_scene(int32_t order, float damping_per_s, float ratio_max)
{
    params = (control_params_t){
        .robot = &omnibot,
        .order = order,
        .floor = {.curve = &omnibot.floor_curve, .linear = true, .compliance_per_N = 0.01f, .friction_limit_N = 5.0f},
        .delta_mps = 1.0e-3f,
        .speed_length_m = 1.0f,
        .law = {.output = OUTPUT_POSTURE,
                .stiffness_per_s2 = {70.0f, 70.0f, 40.0f},
                .damping_per_s = {damping_per_s, damping_per_s, damping_per_s}},
        .series_ratio_max = ratio_max,
        .force_bound_N = 1.0e9f,
        .torque_bound_Nm = 1.0e9f,
    };
    control_prepare(&params);
    input = (control_input_t){
        .pose_is_new = true,
        .pose = {0.3f, -0.2f, 0.7f},
        .wheel_speed_rad_per_s = wheels_of_body(&omnibot.wheel_rate_of_twist, twist),
        .reference = {.position = {0.31f, -0.19f, 0.72f}, .velocity = {0.6f, 0.1f, 0.8f}},
    };
}

static control_output_t output_of_step(void)
{
    control_state_t state = {0};
    control_output_t output;
    TEST_ASSERT_TRUE(control_step(&params, &state, &input, &output));
    return output;
}

/// ν + c Jr⁻¹ λ(ν) = v_odo (C5), taken through Jr.
static void test_exact_step_believes_in_the_slip_that_its_forces_make(void)
{
    make_scene(CONTROL_EXACT, 11.0f, 1.0e9f);
    const control_output_t output = output_of_step();
    const double speed = sqrt((double)(twist.x * twist.x + twist.y * twist.y + twist.z * twist.z));
    const float c = (float)(0.01 * (speed + 1.0e-3));
    double contact[3], odometry[3];
    to_wheels(output.twist, contact);
    to_wheels(twist, odometry);
    const vec3_t slip = vec3_scale(c, output.wheel_force_N);
    const vec3_t sum = {(float)contact[0] + slip.x, (float)contact[1] + slip.y, (float)contact[2] + slip.z};
    assert_vec3(odometry, sum, 2.0e-4); // ω² is not in the Newton step
    TEST_ASSERT_TRUE(vec3_max_abs(slip) > 0.1f);
}

/// τ = r λ + Iw φ̈ with φ̈ = Jr η/r where nothing slips.
static void test_torque_of_order_0_spins_the_wheels_up_beside_pushing_the_floor(void)
{
    make_scene(0, 11.0f, 1.0e9f);
    const control_output_t output = output_of_step();
    double spin[3];
    to_wheels(output.eta, spin);
    const vec3_t rolling = vec3_scale((float)r, output.wheel_force_N);
    const double expected[3] = {(double)rolling.x + Iw / r * spin[0], (double)rolling.y + Iw / r * spin[1],
                                (double)rolling.z + Iw / r * spin[2]};
    assert_vec3(expected, output.torque_Nm, 1.0e-6);
}

/// With all of K2 alike ρ/c is K2 times the largest eigenvalue of D, here found by iteration.
static void test_series_is_held_back_by_the_largest_eigenvalue(void)
{
    make_scene(1, 23.0f, 0.45f);
    vec3_t x = {0.3f, -0.8f, 0.5f};
    float growth = 0.0f;
    for (int i = 0; i < 200; i++) {
        const vec3_t next = body_of_wheels(&omnibot.twist_of_contact_speed, manifold_force(&omnibot, x));
        growth = vec3_max_abs(next);
        x = vec3_scale(1.0f / growth, next);
    }
    const float expected = 0.45f / (23.0f * growth);
    TEST_ASSERT_TRUE(params.compliance_max_mps_per_N <= 1.0001f * expected);
    TEST_ASSERT_TRUE(params.compliance_max_mps_per_N >= 0.98f * expected);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_wheels_turn_as_the_body_moves_them);
    RUN_TEST(test_odometry_finds_the_twist_that_turned_the_wheels);
    RUN_TEST(test_wheel_forces_are_newtons_law_of_the_body);
    RUN_TEST(test_mu_makes_the_slip_of_the_forces);
    RUN_TEST(test_slip_mass_is_the_twist_of_slip_like_the_forces);
    RUN_TEST(test_exact_step_believes_in_the_slip_that_its_forces_make);
    RUN_TEST(test_torque_of_order_0_spins_the_wheels_up_beside_pushing_the_floor);
    RUN_TEST(test_series_is_held_back_by_the_largest_eigenvalue);
    return UNITY_END();
}
