// SPDX-License-Identifier: MIT
// The law (33) against its literal form in double: world-frame ∆ = ∂P0/∂q S1 and ∆̇, solved, not inverted by hand; η̇
// against a numerical derivative along the closed loop; both for the posture and, by ∆⁺, for the point.
#include "tracking.h"

#include "kinematics.h"
#include "unity.h"

static const double L = 0.12;
static const double pi = 3.14159265358979323846;

static tracking_law_t law; // of the firmware; its output tells the literal law's too

/// A state of the loop and the reference with its derivatives, in double.
typedef struct {
    double pose[3], twist[3];
    double y[3], y1[3], y2[3], y3[3];
} scene_t;

void setUp(void)
{
    law = (tracking_law_t){OUTPUT_POSTURE, {70.0f, 70.0f, 40.0f}, {23.0f, 23.0f, 11.0f}};
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
        scene.pose[i] = rounded(3.0 * noise(&state));
        scene.twist[i] = rounded((i == 2 ? 4.0 : 1.0) * noise(&state));
        scene.y[i] = rounded(scene.pose[i] + 0.2 * noise(&state));
        scene.y1[i] = rounded(noise(&state));
        scene.y2[i] = rounded(2.0 * noise(&state));
        scene.y3[i] = rounded(10.0 * noise(&state));
    }
    return scene;
}

// ---- the literal law

static void output_map(const double pose[3], double y[3])
{
    y[0] = pose[0] - L * sin(pose[2]);
    y[1] = pose[1] + L * cos(pose[2]);
    y[2] = pose[2];
}

static void multiply(double a[3][3], double b[3][3], double product[3][3])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            product[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
        }
    }
}

/// ∆(θ) = ∂P0/∂q S1.
static void delta(double heading, double result[3][3])
{
    const double c = cos(heading), s = sin(heading);
    double gradient[3][3] = {{1.0, 0.0, -L * c}, {0.0, 1.0, -L * s}, {0.0, 0.0, 1.0}};
    double S1[3][3] = {{c, -s, 0.0}, {s, c, 0.0}, {0.0, 0.0, 1.0}};
    multiply(gradient, S1, result);
}

/// ∆̇ = ω d∆/dθ, by the five-point difference (error 1e-13).
static void delta_rate(double heading, double turn_rate, double result[3][3])
{
    const double h = 1e-3;
    double at[4][3][3];
    delta(heading - 2.0 * h, at[0]);
    delta(heading - h, at[1]);
    delta(heading + h, at[2]);
    delta(heading + 2.0 * h, at[3]);
    for (int i = 0; i < 9; i++) {
        const int row = i / 3, column = i % 3;
        const double slope =
            at[0][row][column] - 8.0 * at[1][row][column] + 8.0 * at[2][row][column] - at[3][row][column];
        result[row][column] = turn_rate * slope / (12.0 * h);
    }
}

static double determinant(double a[3][3])
{
    return a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0]) +
           a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
}

/// Cramer's rule.
static void solve(double a[3][3], const double right[3], double x[3])
{
    for (int column = 0; column < 3; column++) {
        double replaced[3][3];
        for (int i = 0; i < 9; i++) {
            replaced[i / 3][i % 3] = i % 3 == column ? right[i / 3] : a[i / 3][i % 3];
        }
        x[column] = determinant(replaced) / determinant(a);
    }
}

/// η = ∆⁺ a = ∆ᵀ (∆ ∆ᵀ)⁻¹ a with the first two rows of ∆: the point's.
static void solve_point(double D[3][3], const double right[3], double eta[3])
{
    double gram[2][2];
    for (int i = 0; i < 4; i++) {
        const double *row = D[i / 2], *other = D[i % 2];
        gram[i / 2][i % 2] = row[0] * other[0] + row[1] * other[1] + row[2] * other[2];
    }
    const double scale = 1.0 / (gram[0][0] * gram[1][1] - gram[0][1] * gram[1][0]);
    const double first = scale * (gram[1][1] * right[0] - gram[0][1] * right[1]);
    const double second = scale * (gram[0][0] * right[1] - gram[1][0] * right[0]);
    for (int i = 0; i < 3; i++) {
        eta[i] = D[0][i] * first + D[1][i] * second;
    }
}

static void literal_eta(const scene_t *scene, double eta[3])
{
    const double K1[] = {70.0, 70.0, 40.0}, K2[] = {23.0, 23.0, 11.0};
    double y[3], D[3][3], D_rate[3][3], right[3];
    output_map(scene->pose, y);
    delta(scene->pose[2], D);
    delta_rate(scene->pose[2], scene->twist[2], D_rate);
    for (int i = 0; i < 3; i++) {
        double velocity = 0.0, turning = 0.0;
        for (int j = 0; j < 3; j++) {
            velocity += D[i][j] * scene->twist[j];
            turning += D_rate[i][j] * scene->twist[j];
        }
        right[i] = scene->y2[i] - K2[i] * (velocity - scene->y1[i]) - K1[i] * (y[i] - scene->y[i]) - turning;
    }
    if (law.output == OUTPUT_POINT) {
        solve_point(D, right, eta);
    } else {
        solve(D, right, eta);
    }
}

/// Moves the closed loop ν̇ = η, q̇ = S1 ν on by a time, with the reference's own Taylor series; one RK4 step.
static scene_t slope_of(const scene_t *scene)
{
    const double c = cos(scene->pose[2]), s = sin(scene->pose[2]);
    scene_t slope = {.pose = {c * scene->twist[0] - s * scene->twist[1], s * scene->twist[0] + c * scene->twist[1],
                              scene->twist[2]}};
    literal_eta(scene, slope.twist);
    for (int i = 0; i < 3; i++) {
        slope.y[i] = scene->y1[i];
        slope.y1[i] = scene->y2[i];
        slope.y2[i] = scene->y3[i];
        slope.y3[i] = 0.0;
    }
    return slope;
}

static scene_t moved(const scene_t *scene, double h, const scene_t *slope)
{
    scene_t result = *scene;
    for (int i = 0; i < 3; i++) {
        result.pose[i] += h * slope->pose[i];
        result.twist[i] += h * slope->twist[i];
        result.y[i] += h * slope->y[i];
        result.y1[i] += h * slope->y1[i];
        result.y2[i] += h * slope->y2[i];
    }
    return result;
}

static scene_t integrated(const scene_t *scene, double h)
{
    const scene_t k1 = slope_of(scene);
    const scene_t at2 = moved(scene, 0.5 * h, &k1);
    const scene_t k2 = slope_of(&at2);
    const scene_t at3 = moved(scene, 0.5 * h, &k2);
    const scene_t k3 = slope_of(&at3);
    const scene_t at4 = moved(scene, h, &k3);
    const scene_t k4 = slope_of(&at4);
    scene_t result = moved(scene, h / 6.0, &k1);
    result = moved(&result, h / 3.0, &k2);
    result = moved(&result, h / 3.0, &k3);
    return moved(&result, h / 6.0, &k4);
}

// ---- the firmware's

static vec3_t single(const double value[3])
{
    return (vec3_t){(float)value[0], (float)value[1], (float)value[2]};
}

static tracking_t tracking_of(const scene_t *scene)
{
    const reference_t reference = {single(scene->y), single(scene->y1), single(scene->y2), single(scene->y3)};
    return tracking_from(&omnibot, &law, single(scene->pose), &reference);
}

static vec3_t eta_of(const scene_t *scene)
{
    const tracking_t tracking = tracking_of(scene);
    return tracking_eta(&omnibot, &law, &tracking, single(scene->twist));
}

static void assert_vec3(const double expected[3], vec3_t actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[0], actual.x);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[1], actual.y);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected[2], actual.z);
}

/// The output exactly on the reference, at rest, at a heading.
static scene_t at_rest(double heading)
{
    scene_t scene = {.pose = {0.5, -0.25, rounded(heading)}};
    output_map(scene.pose, scene.y);
    return scene;
}

// ---- the error

static void test_error_behind_along_world_x_is_negative_whatever_the_heading(void)
{
    const double heading[] = {0.0, pi / 2.0, -2.0};
    for (int i = 0; i < 3; i++) {
        scene_t scene = at_rest(heading[i]);
        scene.y[0] += 0.1;

        assert_vec3((double[]){-0.1, 0.0, 0.0}, tracking_of(&scene).error, 1e-6);
    }
}

static void test_error_of_heading_right_of_the_reference_is_negative(void)
{
    scene_t scene = at_rest(0.3);
    scene.y[2] += 0.1;

    assert_vec3((double[]){0.0, 0.0, -0.1}, tracking_of(&scene).error, 1e-6);
}

static void test_error_of_heading_across_pi_takes_the_short_way(void)
{
    scene_t scene = at_rest(pi - 0.01);
    scene.y[2] = -pi + 0.02; // 0.03 further left
    assert_vec3((double[]){0.0, 0.0, -0.03}, tracking_of(&scene).error, 1e-6);

    scene = at_rest(-pi + 0.01);
    scene.y[2] = pi - 0.02; // 0.03 further right
    assert_vec3((double[]){0.0, 0.0, 0.03}, tracking_of(&scene).error, 1e-6);
}

static void test_error_of_heading_against_a_reference_of_many_turns_takes_the_short_way(void)
{
    scene_t scene = at_rest(0.2);
    scene.y[2] = 0.25 + 20.0 * pi;

    assert_vec3((double[]){0.0, 0.0, -0.05}, tracking_of(&scene).error, 1e-5);
}

static void test_standing_output_is_wanted_to_follow_the_reference_seen_from_the_body(void)
{
    // Facing left: what points along the world's first axis points to the right of the body.
    scene_t scene = at_rest(pi / 2.0);
    scene.y[0] += 0.5; // the point is half a metre behind
    scene.y1[0] = 1.0;
    scene.y2[1] = 2.0;
    scene.y3[0] = 3.0;
    scene.y3[2] = 4.0;

    const tracking_t tracking = tracking_of(&scene);

    assert_vec3((double[]){-0.5, 0.0, 0.0}, tracking.error, 1e-6);
    assert_vec3((double[]){2.0, -(23.0 * 1.0 + 70.0 * 0.5), 0.0}, tracking.standing, 1e-5);
    assert_vec3((double[]){23.0 * 2.0, -(3.0 + 70.0 * 1.0), 4.0}, tracking.standing_rate, 1e-5);
}

// ---- η, by hand

static void test_eta_at_rest_on_the_reference_is_zero(void)
{
    const scene_t scene = at_rest(0.7);

    assert_vec3((double[]){0.0, 0.0, 0.0}, eta_of(&scene), 1e-5);
}

static void test_eta_behind_along_x_accelerates_ahead_by_the_stiffness(void)
{
    scene_t scene = at_rest(0.0);
    scene.y[0] += 0.1;

    assert_vec3((double[]){7.0, 0.0, 0.0}, eta_of(&scene), 1e-5);
}

static void test_eta_behind_along_y_accelerates_left_by_the_stiffness(void)
{
    scene_t scene = at_rest(0.0);
    scene.y[1] += 0.1;

    assert_vec3((double[]){0.0, 7.0, 0.0}, eta_of(&scene), 1e-5);
}

static void test_eta_heading_behind_turns_left_about_the_tracked_point(void)
{
    scene_t scene = at_rest(0.0);
    scene.y[2] += 0.1;

    assert_vec3((double[]){4.0 * L, 0.0, 4.0}, eta_of(&scene), 1e-5);
}

static void test_eta_too_fast_along_each_axis_brakes_by_the_damping(void)
{
    scene_t scene = at_rest(0.0);
    scene.twist[0] = 0.1;
    assert_vec3((double[]){-2.3, 0.0, 0.0}, eta_of(&scene), 1e-5);

    scene = at_rest(0.0);
    scene.twist[1] = 0.1;
    assert_vec3((double[]){0.0, -2.3, 0.0}, eta_of(&scene), 1e-5);
}

static void test_eta_reference_accelerating_follows_it(void)
{
    scene_t scene = at_rest(pi / 2.0);
    scene.y2[0] = 1.5; // world x is body −y

    assert_vec3((double[]){0.0, -1.5, 0.0}, eta_of(&scene), 1e-5);
}

static void test_eta_turning_on_the_spot_about_the_point_needs_no_point_acceleration(void)
{
    // p stands still, heading turns at ω: the centre circles p with radius L, νx = L ω; in the body that is constant.
    scene_t scene = at_rest(0.0);
    scene.twist[0] = 2.0 * L;
    scene.twist[2] = 2.0;
    scene.y1[2] = 2.0;

    assert_vec3((double[]){0.0, 0.0, 0.0}, eta_of(&scene), 1e-5);
}

// ---- η and η̇ against the literal law

static void assert_eta_is_literal(tracking_output_t of)
{
    law.output = of;
    for (uint32_t seed = 0; seed < 500; seed++) {
        const scene_t scene = random_scene(seed);
        double expected[3];
        literal_eta(&scene, expected);

        // Terms reach 70: 1e-4 is about ten units in the last place.
        assert_vec3(expected, eta_of(&scene), 1e-4);
    }
}

static void test_eta_at_random_states_agrees_with_the_literal_law(void)
{
    assert_eta_is_literal(OUTPUT_POSTURE);
}

static void test_eta_of_the_point_at_random_states_agrees_with_the_literal_pseudo_inverse(void)
{
    assert_eta_is_literal(OUTPUT_POINT);
}

static void assert_eta_rate_is_that_of_the_loop(tracking_output_t of)
{
    law.output = of;
    const double h = 1e-4;
    for (uint32_t seed = 0; seed < 500; seed++) {
        const scene_t scene = random_scene(seed);
        const scene_t after = integrated(&scene, h), before = integrated(&scene, -h);
        double eta[3], eta_after[3], eta_before[3], expected[3];
        literal_eta(&scene, eta);
        literal_eta(&after, eta_after);
        literal_eta(&before, eta_before);
        for (int i = 0; i < 3; i++) {
            expected[i] = (eta_after[i] - eta_before[i]) / (2.0 * h);
        }
        const tracking_t tracking = tracking_of(&scene);

        const vec3_t actual = tracking_eta_rate(&omnibot, &law, &tracking, single(scene.twist), single(eta));

        // Terms reach 23 × 60: 3e-3 is 2e-6 of them; the difference itself errs by h² of the third derivative, 1e-4.
        assert_vec3(expected, actual, 3e-3);
    }
}

static void test_eta_rate_at_random_states_agrees_with_the_closed_loop(void)
{
    assert_eta_rate_is_that_of_the_loop(OUTPUT_POSTURE);
}

static void test_eta_rate_of_the_point_at_random_states_agrees_with_the_closed_loop(void)
{
    assert_eta_rate_is_that_of_the_loop(OUTPUT_POINT);
}

static void test_eta_rate_on_the_reference_is_the_jerk_seen_from_the_body(void)
{
    scene_t scene = at_rest(pi / 2.0);
    scene.y3[0] = 5.0;
    const tracking_t tracking = tracking_of(&scene);

    const vec3_t rate = tracking_eta_rate(&omnibot, &law, &tracking, (vec3_t){0.0f, 0.0f, 0.0f}, eta_of(&scene));

    assert_vec3((double[]){0.0, -5.0, 0.0}, rate, 1e-3);
}

// ---- the point alone, by hand

static void test_eta_of_the_point_ahead_turns_as_little_as_it_moves(void)
{
    // Along x the point moves by νx − L ω; the smallest [νx, ω] that gives 7 m/s² shares as 1 : −L.
    law.output = OUTPUT_POINT;
    scene_t scene = at_rest(0.0);
    scene.y[0] += 0.1;

    const double share = 7.0 / (1.0 + L * L);
    assert_vec3((double[]){share, 0.0, -L * share}, eta_of(&scene), 1e-5);
}

static void test_eta_of_the_point_does_not_look_at_the_heading(void)
{
    law.output = OUTPUT_POINT;
    scene_t scene = at_rest(0.4);
    scene.y[2] += 1.0;
    scene.y1[2] = 2.0;
    scene.y2[2] = 3.0;

    assert_vec3((double[]){0.0, 0.0, 0.0}, eta_of(&scene), 2e-5);
}

// ---- the gradient

/// η + ω×ν of the literal law.
static void literal_specific_force(const scene_t *scene, double sum[3])
{
    literal_eta(scene, sum);
    sum[0] -= scene->twist[2] * scene->twist[1];
    sum[1] += scene->twist[2] * scene->twist[0];
}

static void assert_gradient_is_that_of_the_law(tracking_output_t of)
{
    law.output = of;
    const double h = 1e-4; // quadratic in ν: a central difference is exact but for rounding
    for (uint32_t seed = 0; seed < 300; seed++) {
        const scene_t scene = random_scene(seed);
        const mat3_t gradient = tracking_gradient(&omnibot, &law, single(scene.twist));
        for (int j = 0; j < 3; j++) {
            scene_t after = scene, before = scene;
            after.twist[j] += h;
            before.twist[j] -= h;
            double up[3], down[3];
            literal_specific_force(&after, up);
            literal_specific_force(&before, down);
            for (int i = 0; i < 3; i++) {
                TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)((up[i] - down[i]) / (2.0 * h)), gradient.m[i][j]);
            }
        }
    }
}

static void test_gradient_at_random_states_agrees_with_a_difference_of_the_literal_law(void)
{
    assert_gradient_is_that_of_the_law(OUTPUT_POSTURE);
}

static void test_gradient_of_the_point_at_random_states_agrees_with_a_difference_of_the_literal_law(void)
{
    assert_gradient_is_that_of_the_law(OUTPUT_POINT);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_error_behind_along_world_x_is_negative_whatever_the_heading);
    RUN_TEST(test_error_of_heading_right_of_the_reference_is_negative);
    RUN_TEST(test_error_of_heading_across_pi_takes_the_short_way);
    RUN_TEST(test_error_of_heading_against_a_reference_of_many_turns_takes_the_short_way);
    RUN_TEST(test_standing_output_is_wanted_to_follow_the_reference_seen_from_the_body);
    RUN_TEST(test_eta_at_rest_on_the_reference_is_zero);
    RUN_TEST(test_eta_behind_along_x_accelerates_ahead_by_the_stiffness);
    RUN_TEST(test_eta_behind_along_y_accelerates_left_by_the_stiffness);
    RUN_TEST(test_eta_heading_behind_turns_left_about_the_tracked_point);
    RUN_TEST(test_eta_too_fast_along_each_axis_brakes_by_the_damping);
    RUN_TEST(test_eta_reference_accelerating_follows_it);
    RUN_TEST(test_eta_turning_on_the_spot_about_the_point_needs_no_point_acceleration);
    RUN_TEST(test_eta_at_random_states_agrees_with_the_literal_law);
    RUN_TEST(test_eta_of_the_point_at_random_states_agrees_with_the_literal_pseudo_inverse);
    RUN_TEST(test_eta_rate_at_random_states_agrees_with_the_closed_loop);
    RUN_TEST(test_eta_rate_of_the_point_at_random_states_agrees_with_the_closed_loop);
    RUN_TEST(test_eta_rate_on_the_reference_is_the_jerk_seen_from_the_body);
    RUN_TEST(test_eta_of_the_point_ahead_turns_as_little_as_it_moves);
    RUN_TEST(test_eta_of_the_point_does_not_look_at_the_heading);
    RUN_TEST(test_gradient_at_random_states_agrees_with_a_difference_of_the_literal_law);
    RUN_TEST(test_gradient_of_the_point_at_random_states_agrees_with_a_difference_of_the_literal_law);
    return UNITY_END();
}
