// SPDX-License-Identifier: MIT
// The manifold against residuals in double: Newton's law of the body for the wheel forces, Γ µ = −κ λ for the slip, and
// a finite difference in time. tests/host_sim/test_manifold_literal.py holds it against the paper's own matrices.
#include "manifold.h"

#include "unity.h"

static const double m = 1.903, Ic = 0.0132, b = 0.12, r = 0.0349;
static const double half_root3 = 0.86602540378443864676;

/// A state of the slow system and how it moves, in double.
typedef struct {
    double v[3], eta[3], eta_rate[3];
    double mobility;
} scene_t;

void setUp(void)
{
}

void tearDown(void)
{
}

static double noise(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return (double)(int32_t)*state / 2147483648.0;
}

/// Rounded to float at once, so that both sides see the same numbers.
static double rounded(double value)
{
    return (double)(float)value;
}

static scene_t random_scene(uint32_t seed)
{
    uint32_t state = seed * 2654435761u + 1u;
    (void)noise(&state);
    scene_t scene;
    for (int i = 0; i < 3; i++) {
        scene.v[i] = rounded((i == 2 ? 4.0 : 1.5) * noise(&state));
        scene.eta[i] = rounded((i == 2 ? 20.0 : 5.0) * noise(&state));
        scene.eta_rate[i] = rounded((i == 2 ? 300.0 : 80.0) * noise(&state));
    }
    scene.mobility = rounded(1.0 + 0.9 * noise(&state));
    return scene;
}

static vec3_t single(const double value[3])
{
    return (vec3_t){(float)value[0], (float)value[1], (float)value[2]};
}

static void assert_vec3(const double expected[3], vec3_t actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[0], actual.x);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[1], actual.y);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[2], actual.z);
}

static double largest(const double value[3])
{
    return fmax(fabs(value[0]), fmax(fabs(value[1]), fabs(value[2])));
}

// ---- the robot in double, from its drawing

static const double Jr[3][3] = {{-half_root3, 0.5, b}, {0.0, -1.0, b}, {half_root3, 0.5, b}};
static const double Mo[3] = {m, m, Ic};

/// Jrᵀ x: what forces or slip at the wheels do to the body.
static void to_body(const double wheels[3], double body[3])
{
    for (int i = 0; i < 3; i++) {
        body[i] = Jr[0][i] * wheels[0] + Jr[1][i] * wheels[1] + Jr[2][i] * wheels[2];
    }
}

/// Wheel forces that make the wrench Mo a: by the geometry of three wheels, Jr⁻ᵀ = ⅔ of the direction, ⅓ of the turn.
static void forces_for(const double acceleration[3], double force[3])
{
    for (int i = 0; i < 3; i++) {
        force[i] = 2.0 / 3.0 * m * (Jr[i][0] * acceleration[0] + Jr[i][1] * acceleration[1]) +
                   Ic * acceleration[2] / (3.0 * b);
    }
}

/// H with Γ H = −κ λ, by Γ's eigenvalues: 3/2 + r² across, 3 b² + r² along (1, 1, 1).
static void slip_of(double mobility, const double force[3], double H[3])
{
    const double mean = (force[0] + force[1] + force[2]) / 3.0;
    for (int i = 0; i < 3; i++) {
        H[i] = -mobility * ((force[i] - mean) / (1.5 + r * r) + mean / (3.0 * b * b + r * r));
    }
}

/// a + ω×v for the twist v.
static void with_turning(const double acceleration[3], double turn_rate, const double v[3], double sum[3])
{
    sum[0] = acceleration[0] - turn_rate * v[1];
    sum[1] = acceleration[1] + turn_rate * v[0];
    sum[2] = acceleration[2];
}

/// λ a time later along ν̇ = η.
static void force_at(const scene_t *scene, double time, double force[3])
{
    double v[3], eta[3], acceleration[3];
    for (int i = 0; i < 3; i++) {
        v[i] = scene->v[i] + scene->eta[i] * time + 0.5 * scene->eta_rate[i] * time * time;
        eta[i] = scene->eta[i] + scene->eta_rate[i] * time;
    }
    with_turning(eta, v[2], v, acceleration);
    forces_for(acceleration, force);
}

/// λ of a twist that changes at a rate, and λ̇ where that rate changes too.
static vec3_t force_of(vec3_t twist, vec3_t acceleration)
{
    return manifold_force(&omnibot, vec3_add_turn(acceleration, twist.z, twist));
}

static vec3_t force_rate_of(vec3_t twist, vec3_t acceleration, vec3_t jerk)
{
    return manifold_force(&omnibot, manifold_specific_force_rate(twist, acceleration, jerk));
}

// ---- λ: signs and values by hand

static void test_force_accelerating_ahead_pulls_with_wheel3_and_against_wheel1(void)
{
    const vec3_t force = force_of((vec3_t){0.0f, 0.0f, 0.0f}, (vec3_t){1.0f, 0.0f, 0.0f});

    assert_vec3((double[]){-m / sqrt(3.0), 0.0, m / sqrt(3.0)}, force, 1e-6);
}

static void test_force_accelerating_left_pulls_twice_with_wheel2(void)
{
    const vec3_t force = force_of((vec3_t){0.0f, 0.0f, 0.0f}, (vec3_t){0.0f, 1.0f, 0.0f});

    assert_vec3((double[]){m / 3.0, -2.0 * m / 3.0, m / 3.0}, force, 1e-6);
}

static void test_force_turning_up_pulls_alike(void)
{
    const vec3_t force = force_of((vec3_t){0.0f, 0.0f, 0.0f}, (vec3_t){0.0f, 0.0f, 1.0f});

    assert_vec3((double[]){Ic / (3.0 * b), Ic / (3.0 * b), Ic / (3.0 * b)}, force, 1e-8);
}

static void test_force_driving_a_left_bend_pulls_to_the_left(void)
{
    // Ahead at 1 m/s, turning left at 2 rad/s: centripetal 2 m/s² along body y.
    const vec3_t force = force_of((vec3_t){1.0f, 0.0f, 2.0f}, (vec3_t){0.0f, 0.0f, 0.0f});

    assert_vec3((double[]){2.0 * m / 3.0, -4.0 * m / 3.0, 2.0 * m / 3.0}, force, 1e-6);
}

static void test_force_driving_sideways_in_a_left_bend_pulls_backward(void)
{
    // Along body y at 1 m/s, turning left at 2 rad/s: centripetal 2 m/s² along −x.
    const vec3_t force = force_of((vec3_t){0.0f, 1.0f, 2.0f}, (vec3_t){0.0f, 0.0f, 0.0f});

    assert_vec3((double[]){2.0 * m / sqrt(3.0), 0.0, -2.0 * m / sqrt(3.0)}, force, 1e-6);
}

static void test_force_at_random_states_obeys_newton(void)
{
    for (uint32_t seed = 0; seed < 300; seed++) {
        const scene_t scene = random_scene(seed);
        const vec3_t force = force_of(single(scene.v), single(scene.eta));
        double wrench[3], acceleration[3];
        to_body((double[]){(double)force.x, (double)force.y, (double)force.z}, wrench);
        with_turning(scene.eta, scene.v[2], scene.v, acceleration);

        for (int i = 0; i < 3; i++) {
            TEST_ASSERT_FLOAT_WITHIN(3e-5f, (float)(Mo[i] * acceleration[i]), (float)wrench[i]);
        }
    }
}

// ---- H of a force

static void test_slip_of_forces_that_turn_is_against_them_by_the_soft_eigenvalue(void)
{
    const double H = -0.5 / (3.0 * b * b + r * r);

    assert_vec3((double[]){H, H, H}, manifold_of_force(&omnibot, 0.5f, (vec3_t){1.0f, 1.0f, 1.0f}), 1e-5);
}

static void test_slip_of_forces_that_push_is_against_them_by_the_stiff_eigenvalue(void)
{
    const double H = -0.5 / (1.5 + r * r);

    assert_vec3((double[]){H, -H, 0.0}, manifold_of_force(&omnibot, 0.5f, (vec3_t){1.0f, -1.0f, 0.0f}), 1e-6);
}

static void test_slip_of_random_forces_balances_them(void)
{
    for (uint32_t seed = 0; seed < 300; seed++) {
        uint32_t state = seed;
        const double force[] = {rounded(4.0 * noise(&state)), rounded(4.0 * noise(&state)),
                                rounded(4.0 * noise(&state))};
        const double mobility = rounded(1.0 + 0.9 * noise(&state));

        const vec3_t slip = manifold_of_force(&omnibot, (float)mobility, single(force));

        // Γ H = −κ λ, with Γ = Jr Jrᵀ + r².
        const double H[] = {(double)slip.x, (double)slip.y, (double)slip.z};
        double body[3];
        to_body(H, body);
        for (int i = 0; i < 3; i++) {
            const double left = Jr[i][0] * body[0] + Jr[i][1] * body[1] + Jr[i][2] * body[2] + r * r * H[i];
            TEST_ASSERT_FLOAT_WITHIN(3e-5f, (float)(-mobility * force[i]), (float)left);
        }
    }
}

static void test_slip_without_mobility_is_none(void)
{
    assert_vec3((double[]){0.0, 0.0, 0.0}, manifold_of_force(&omnibot, 0.0f, (vec3_t){1.0f, 2.0f, 3.0f}), 0.0);
}

static void test_slip_at_random_states_is_the_slow_manifold(void)
{
    for (uint32_t seed = 0; seed < 300; seed++) {
        const scene_t scene = random_scene(seed);
        double force[3], expected[3];
        force_at(&scene, 0.0, force);
        slip_of(scene.mobility, force, expected);

        const vec3_t ours = force_of(single(scene.v), single(scene.eta));
        const vec3_t slip = manifold_of_force(&omnibot, (float)scene.mobility, ours);

        assert_vec3(expected, slip, 5e-6 * (10.0 + largest(expected)));
    }
}

// ---- λ̇

static void test_force_rate_at_random_states_agrees_with_a_finite_difference(void)
{
    const double h = 1e-4;
    for (uint32_t seed = 0; seed < 300; seed++) {
        const scene_t scene = random_scene(seed);
        double after[3], before[3], expected[3];
        force_at(&scene, h, after);
        force_at(&scene, -h, before);
        for (int i = 0; i < 3; i++) {
            expected[i] = (after[i] - before[i]) / (2.0 * h);
        }

        const vec3_t rate = force_rate_of(single(scene.v), single(scene.eta), single(scene.eta_rate));

        // The difference itself errs by h² of the third derivative, 1e-5; terms reach 2 m/1.5 · 80.
        assert_vec3(expected, rate, 1e-6 * (200.0 + largest(expected)));
    }
}

static void test_force_rate_in_steady_straight_motion_is_zero(void)
{
    const vec3_t still = {0.0f, 0.0f, 0.0f};

    assert_vec3((double[]){0.0, 0.0, 0.0}, force_rate_of((vec3_t){1.0f, 0.5f, 0.0f}, still, still), 0.0);
}

static void test_force_rate_of_jerk_alone_is_the_force_of_that_acceleration(void)
{
    const vec3_t still = {0.0f, 0.0f, 0.0f};

    const vec3_t rate = force_rate_of(still, still, (vec3_t){3.0f, 0.0f, 0.0f});

    assert_vec3((double[]){-m * sqrt(3.0), 0.0, m * sqrt(3.0)}, rate, 3e-6);
}

static void test_force_rate_turning_up_while_ahead_pulls_more_to_the_left(void)
{
    // Ahead at 1 m/s, ω̇ = 2 rad/s²: the centripetal acceleration grows by 2 m/s³ along body y.
    const vec3_t rate =
        force_rate_of((vec3_t){1.0f, 0.0f, 0.0f}, (vec3_t){0.0f, 0.0f, 2.0f}, (vec3_t){0.0f, 0.0f, 0.0f});

    assert_vec3((double[]){2.0 * m / 3.0, -4.0 * m / 3.0, 2.0 * m / 3.0}, rate, 1e-6);
}

static void test_force_rate_speeding_up_in_a_left_bend_pulls_more_to_the_left(void)
{
    const vec3_t rate =
        force_rate_of((vec3_t){0.0f, 0.0f, 2.0f}, (vec3_t){1.0f, 0.0f, 0.0f}, (vec3_t){0.0f, 0.0f, 0.0f});

    assert_vec3((double[]){2.0 * m / 3.0, -4.0 * m / 3.0, 2.0 * m / 3.0}, rate, 1e-6);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_force_accelerating_ahead_pulls_with_wheel3_and_against_wheel1);
    RUN_TEST(test_force_accelerating_left_pulls_twice_with_wheel2);
    RUN_TEST(test_force_turning_up_pulls_alike);
    RUN_TEST(test_force_driving_a_left_bend_pulls_to_the_left);
    RUN_TEST(test_force_driving_sideways_in_a_left_bend_pulls_backward);
    RUN_TEST(test_force_at_random_states_obeys_newton);
    RUN_TEST(test_slip_of_forces_that_turn_is_against_them_by_the_soft_eigenvalue);
    RUN_TEST(test_slip_of_forces_that_push_is_against_them_by_the_stiff_eigenvalue);
    RUN_TEST(test_slip_of_random_forces_balances_them);
    RUN_TEST(test_slip_without_mobility_is_none);
    RUN_TEST(test_slip_at_random_states_is_the_slow_manifold);
    RUN_TEST(test_force_rate_at_random_states_agrees_with_a_finite_difference);
    RUN_TEST(test_force_rate_in_steady_straight_motion_is_zero);
    RUN_TEST(test_force_rate_of_jerk_alone_is_the_force_of_that_acceleration);
    RUN_TEST(test_force_rate_turning_up_while_ahead_pulls_more_to_the_left);
    RUN_TEST(test_force_rate_speeding_up_in_a_left_bend_pulls_more_to_the_left);
    return UNITY_END();
}
