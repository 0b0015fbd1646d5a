// SPDX-License-Identifier: MIT
// Signs first: which way each wheel turns for each motion of the body; then the tracked point and the speed.
#include "kinematics.h"

#include "unity.h"

static const double L = 0.12, b = 0.12, r = 0.0349;
static const double half_root3 = 0.86602540378443864676;
static const double pi = 3.14159265358979323846;

void setUp(void)
{
}

void tearDown(void)
{
}

static void assert_near(double expected, float actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected, actual);
}

static void assert_vec3(double x, double y, double z, vec3_t actual, double tolerance)
{
    assert_near(x, actual.x, tolerance);
    assert_near(y, actual.y, tolerance);
    assert_near(z, actual.z, tolerance);
}

static vec3_t wheels_of(float x, float y, float turn)
{
    return wheels_of_body(&omnibot.wheel_rate_of_twist, (vec3_t){x, y, turn});
}

// ---- the wheels that a motion needs

static void test_wheels_moving_along_body_x_wheel1_backward_wheel2_still_wheel3_forward(void)
{
    assert_vec3(-half_root3 / r, 0.0, half_root3 / r, wheels_of(1.0f, 0.0f, 0.0f), 1e-5);
}

static void test_wheels_moving_along_body_y_outer_forward_wheel2_backward_at_full_speed(void)
{
    assert_vec3(0.5 / r, -1.0 / r, 0.5 / r, wheels_of(0.0f, 1.0f, 0.0f), 1e-5);
}

static void test_wheels_turning_left_all_forward_alike(void)
{
    assert_vec3(b / r, b / r, b / r, wheels_of(0.0f, 0.0f, 1.0f), 1e-6);
}

static void test_wheels_stand_on_a_circle_a_third_of_a_turn_apart(void)
{
    // A wheel at p drives along d: its speed is d·(ν + ω×p). All turn forward in a left turn, so p lies a quarter turn
    // behind d; the places must be those of the paper's Fig. 1: 60°, 180°, −60° from body x.
    static const double angle[] = {60.0, 180.0, -60.0};
    const vec3_t ahead = wheels_of(1.0f, 0.0f, 0.0f), side = wheels_of(0.0f, 1.0f, 0.0f);
    const float by_x[] = {ahead.x, ahead.y, ahead.z}, by_y[] = {side.x, side.y, side.z};
    for (int wheel = 0; wheel < 3; wheel++) {
        assert_near(cos(angle[wheel] * pi / 180.0) / r, by_y[wheel], 3e-6);
        assert_near(-sin(angle[wheel] * pi / 180.0) / r, by_x[wheel], 3e-6);
    }
}

// ---- odometry

static void test_odometry_wheel1_alone_moves_back_left_and_turns_left(void)
{
    const vec3_t twist = kinematics_odometry(&omnibot, (vec3_t){1.0f, 0.0f, 0.0f});

    assert_vec3(-r / sqrt(3.0), r / 3.0, r / (3.0 * b), twist, 1e-8);
}

static void test_odometry_wheel2_alone_moves_right_and_turns_left(void)
{
    const vec3_t twist = kinematics_odometry(&omnibot, (vec3_t){0.0f, 1.0f, 0.0f});

    assert_vec3(0.0, -2.0 * r / 3.0, r / (3.0 * b), twist, 1e-8);
}

static void test_odometry_wheel3_alone_moves_ahead_left_and_turns_left(void)
{
    const vec3_t twist = kinematics_odometry(&omnibot, (vec3_t){0.0f, 0.0f, 1.0f});

    assert_vec3(r / sqrt(3.0), r / 3.0, r / (3.0 * b), twist, 1e-8);
}

static void test_odometry_all_wheels_alike_turn_on_the_spot(void)
{
    const vec3_t twist = kinematics_odometry(&omnibot, (vec3_t){2.0f, 2.0f, 2.0f});

    assert_vec3(0.0, 0.0, 2.0 * r / b, twist, 1e-7);
}

static void test_odometry_of_the_wheels_of_a_twist_returns_the_twist(void)
{
    for (int i = 0; i < 27; i++) {
        const double x = 0.7 * (i % 3 - 1), y = 1.3 * (i / 3 % 3 - 1), turn = 4.0 * (i / 9 - 1);

        const vec3_t twist = kinematics_odometry(&omnibot, wheels_of((float)x, (float)y, (float)turn));

        assert_vec3(x, y, turn, twist, 3e-6);
    }
}

// ---- the tracked point

static void test_output_at_zero_heading_lies_along_world_y(void)
{
    const vec3_t y = kinematics_output(&omnibot, (vec3_t){1.0f, 2.0f, 0.0f}, rotation_of(0.0f));

    assert_vec3(1.0, 2.12, 0.0, y, 1e-6);
}

static void test_output_facing_left_lies_along_minus_world_x(void)
{
    const float quarter = (float)(pi / 2.0);

    const vec3_t y = kinematics_output(&omnibot, (vec3_t){1.0f, 2.0f, quarter}, rotation_of(quarter));

    assert_vec3(0.88, 2.0, pi / 2.0, y, 1e-6);
}

static void test_output_facing_back_lies_along_minus_world_y(void)
{
    const float half = (float)pi;

    const vec3_t y = kinematics_output(&omnibot, (vec3_t){0.0f, 0.0f, half}, rotation_of(half));

    assert_vec3(0.0, -0.12, pi, y, 1e-6);
}

static void test_point_twist_turning_left_moves_the_point_backward(void)
{
    assert_vec3(-0.12, 0.0, 1.0, kinematics_point_twist(&omnibot, (vec3_t){0.0f, 0.0f, 1.0f}), 1e-8);
}

static void test_point_twist_without_turning_is_the_twist(void)
{
    assert_vec3(0.3, -0.4, 0.0, kinematics_point_twist(&omnibot, (vec3_t){0.3f, -0.4f, 0.0f}), 1e-8);
}

static void test_point_twist_is_the_rate_of_the_output(void)
{
    // Central difference of (12) in double along x' = R ν, seen from the body.
    const double heading = 0.7, x = 0.4, y = -0.9, turn = 2.3, h = 1e-5;
    const double c = cos(heading), s = sin(heading);
    const double rate1 = c * x - s * y - L * (sin(heading + h * turn) - sin(heading - h * turn)) / (2.0 * h);
    const double rate2 = s * x + c * y + L * (cos(heading + h * turn) - cos(heading - h * turn)) / (2.0 * h);

    const vec3_t z = kinematics_point_twist(&omnibot, (vec3_t){(float)x, (float)y, (float)turn});

    assert_vec3(c * rate1 + s * rate2, c * rate2 - s * rate1, turn, z, 1e-6);
}

static void test_twist_of_point_undoes_point_twist(void)
{
    const vec3_t z = kinematics_point_twist(&omnibot, (vec3_t){0.3f, -0.4f, 5.0f});

    assert_vec3(0.3, -0.4, 5.0, kinematics_twist_of_point(&omnibot, z), 1e-6);
}

static void test_twist_of_point_standing_while_turning_left_moves_the_body_ahead(void)
{
    assert_vec3(0.12, 0.0, 1.0, kinematics_twist_of_point(&omnibot, (vec3_t){0.0f, 0.0f, 1.0f}), 1e-8);
}

// ---- speed (14)

static void test_speed_without_turning_is_the_length_of_the_velocity(void)
{
    assert_near(0.5, kinematics_speed((vec3_t){0.3f, -0.4f, 0.0f}, 1.0f), 1e-7);
}

static void test_speed_turning_counts_by_the_length(void)
{
    assert_near(1.5, kinematics_speed((vec3_t){0.0f, 0.0f, -3.0f}, 0.5f), 1e-6);
    assert_near(1.3, kinematics_speed((vec3_t){0.3f, 0.4f, 6.0f}, 0.2f), 1e-6);
}

static void test_speed_with_no_length_leaves_turning_out(void)
{
    assert_near(0.5, kinematics_speed((vec3_t){0.3f, 0.4f, 9.0f}, 0.0f), 1e-7);
}

static void test_speed_at_rest_is_zero(void)
{
    assert_near(0.0, kinematics_speed((vec3_t){0.0f, 0.0f, 0.0f}, 1.0f), 0.0);
}

static double speed_of(const double twist[3], const double rate[3], double length, double time)
{
    const double x = twist[0] + rate[0] * time, y = twist[1] + rate[1] * time, z = length * (twist[2] + rate[2] * time);
    return sqrt(x * x + y * y + z * z);
}

static float speed_rate(vec3_t twist, vec3_t acceleration, float length_m)
{
    return kinematics_speed_rate(twist, kinematics_speed(twist, length_m), acceleration, length_m);
}

static void test_speed_rate_agrees_with_a_finite_difference(void)
{
    static const double twist[][3] = {{0.3, -0.4, 1.2}, {-0.7, 0.1, -2.0}, {0.0, 0.0, 3.0}, {1e-3, 2e-3, 0.0}};
    static const double rate[][3] = {{1.0, 2.0, -3.0}, {0.0, -4.0, 5.0}, {1.0, 1.0, 1.0}, {-2.0, 0.5, 7.0}};
    static const double length[] = {0.0, 0.12, 1.0, 2.5};
    const double h = 1e-6;
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 4; k++) {
            if (i == 2 && k == 0) {
                continue; // turning on the spot with ℓ = 0 is rest: no derivative
            }
            const double expected =
                (speed_of(twist[i], rate[i], length[k], h) - speed_of(twist[i], rate[i], length[k], -h)) / (2.0 * h);
            const vec3_t at = {(float)twist[i][0], (float)twist[i][1], (float)twist[i][2]};
            const vec3_t along = {(float)rate[i][0], (float)rate[i][1], (float)rate[i][2]};

            assert_near(expected, speed_rate(at, along, (float)length[k]), 1e-5 * (1.0 + fabs(expected)));
        }
    }
}

static void test_speed_rate_speeding_up_is_positive_and_braking_negative(void)
{
    assert_near(2.0, speed_rate((vec3_t){0.0f, -0.5f, 0.0f}, (vec3_t){0.0f, -2.0f, 0.0f}, 1.0f), 1e-6);
    assert_near(-2.0, speed_rate((vec3_t){0.0f, -0.5f, 0.0f}, (vec3_t){0.0f, 2.0f, 0.0f}, 1.0f), 1e-6);
}

static void test_speed_rate_at_rest_is_zero(void)
{
    assert_near(0.0, speed_rate((vec3_t){0.0f, 0.0f, 0.0f}, (vec3_t){1.0f, 2.0f, 3.0f}, 1.0f), 0.0);
    assert_near(0.0, speed_rate((vec3_t){0.0f, 0.0f, 4.0f}, (vec3_t){1.0f, 2.0f, 3.0f}, 0.0f), 0.0);
}

static void test_speed_rate_too_slow_for_single_precision_is_finite(void)
{
    TEST_ASSERT_TRUE(isfinite(speed_rate((vec3_t){1e-25f, 0.0f, 0.0f}, (vec3_t){1.0f, 0.0f, 0.0f}, 1.0f)));
    TEST_ASSERT_TRUE(isfinite(speed_rate((vec3_t){1e-22f, 0.0f, 0.0f}, (vec3_t){1.0f, 0.0f, 0.0f}, 1.0f)));
}

// ---- the moved pose

/// The pose after a time at a twist, by 10000 steps of the midpoint rule in double.
static void integrate(double pose[3], const double twist[3], double time)
{
    const int steps = 10000;
    const double h = time / steps;
    for (int i = 0; i < steps; i++) {
        const double middle = pose[2] + 0.5 * h * twist[2];
        pose[0] += h * (cos(middle) * twist[0] - sin(middle) * twist[1]);
        pose[1] += h * (sin(middle) * twist[0] + cos(middle) * twist[1]);
        pose[2] += h * twist[2];
    }
}

static vec3_t moved_pose(vec3_t pose, vec3_t twist, float time_s)
{
    return kinematics_moved_pose((pose_sum_t){.value = pose}, rotation_of(pose.z), twist, time_s).value;
}

static void assert_moves_by(const double start[3], const double twist[3], double time, double tolerance)
{
    double end[] = {start[0], start[1], start[2]};
    integrate(end, twist, time);
    const vec3_t pose = {(float)start[0], (float)start[1], (float)start[2]};

    const vec3_t moved = moved_pose(pose, (vec3_t){(float)twist[0], (float)twist[1], (float)twist[2]}, (float)time);

    assert_near(end[0], moved.x, tolerance);
    assert_near(end[1], moved.y, tolerance);
    assert_near(0.0, (float)remainder(end[2] - (double)moved.z, 2.0 * pi), tolerance);
    TEST_ASSERT_FLOAT_WITHIN((float)pi + 1e-6f, 0.0f, moved.z);
}

static void test_moved_pose_in_a_period_agrees_with_a_fine_integration(void)
{
    // The heading halfway errs by (ω T)² / 24 of the way: 1e-8 m at 10 rad/s and 2 m/s.
    for (int i = 0; i < 81; i++) {
        const double start[] = {0.5, -0.3, 1.5 * (i % 3 - 1)};
        const double twist[] = {2.0 * (i / 3 % 3 - 1), 1.5 * (i / 9 % 3 - 1), 10.0 * (i / 27 - 1)};
        assert_moves_by(start, twist, 1e-3, 3e-7);
    }
}

static void test_moved_pose_errs_by_the_square_of_the_turn(void)
{
    // Half a second ahead at 1 m/s, turning at 1 rad/s: the chord is shorter than the arc by 1/4 / 24.
    assert_moves_by((double[]){0.0, 0.0, 0.0}, (double[]){1.0, 0.0, 1.0}, 0.5, 0.5 * 0.25 / 24.0 * 1.05);
}

static void test_moved_pose_facing_left_moves_ahead_along_world_y(void)
{
    const float quarter = (float)(pi / 2.0);

    const vec3_t moved = moved_pose((vec3_t){1.0f, 2.0f, quarter}, (vec3_t){0.5f, 0.25f, 0.0f}, 2.0f);

    assert_vec3(0.5, 3.0, pi / 2.0, moved, 1e-6);
}

static void test_moved_pose_turning_past_pi_wraps(void)
{
    const vec3_t still = {0.0f, 0.0f, 3.0f};
    assert_vec3(0.0, 0.0, 3.1 + 0.3 - 2.0 * pi, moved_pose((vec3_t){0.0f, 0.0f, 3.1f}, still, 0.1f), 1e-6);

    const vec3_t back = {0.0f, 0.0f, -3.0f};
    assert_vec3(0.0, 0.0, 2.0 * pi - 3.4, moved_pose((vec3_t){0.0f, 0.0f, -3.1f}, back, 0.1f), 1e-6);
}

static void test_moved_pose_at_rest_stays(void)
{
    const vec3_t pose = {1.0f, -2.0f, 0.75f}, still = {0.0f, 0.0f, 0.0f};

    assert_vec3(1.0, -2.0, 0.75, moved_pose(pose, still, 1e-3f), 0.0);
}

static void test_moved_pose_over_many_small_ways_loses_none_of_them(void)
{
    // A way of 3.3 µm a tick, below half of what single precision resolves at 100 m, ten thousand times.
    pose_sum_t pose = {.value = {100.0f, -100.0f, 0.0f}};
    for (int k = 0; k < 10000; k++) {
        pose = kinematics_moved_pose(pose, rotation_of(pose.value.z), (vec3_t){3.3e-3f, -3.3e-3f, 0.0f}, 1.0e-3f);
    }
    assert_vec3(100.033, -100.033, 0.0, pose.value, 8e-6);
}

static void test_moved_pose_turning_slowly_for_long_loses_nothing(void)
{
    pose_sum_t pose = {.value = {0.0f, 0.0f, 3.0f}};
    for (int k = 0; k < 100000; k++) {
        pose = kinematics_moved_pose(pose, rotation_of(pose.value.z), (vec3_t){0.0f, 0.0f, 0.01f}, 1.0e-3f);
    }
    assert_near(3.0 + 1.0 - 2.0 * pi, pose.value.z, 2e-6);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_wheels_moving_along_body_x_wheel1_backward_wheel2_still_wheel3_forward);
    RUN_TEST(test_wheels_moving_along_body_y_outer_forward_wheel2_backward_at_full_speed);
    RUN_TEST(test_wheels_turning_left_all_forward_alike);
    RUN_TEST(test_wheels_stand_on_a_circle_a_third_of_a_turn_apart);
    RUN_TEST(test_odometry_wheel1_alone_moves_back_left_and_turns_left);
    RUN_TEST(test_odometry_wheel2_alone_moves_right_and_turns_left);
    RUN_TEST(test_odometry_wheel3_alone_moves_ahead_left_and_turns_left);
    RUN_TEST(test_odometry_all_wheels_alike_turn_on_the_spot);
    RUN_TEST(test_odometry_of_the_wheels_of_a_twist_returns_the_twist);
    RUN_TEST(test_output_at_zero_heading_lies_along_world_y);
    RUN_TEST(test_output_facing_left_lies_along_minus_world_x);
    RUN_TEST(test_output_facing_back_lies_along_minus_world_y);
    RUN_TEST(test_point_twist_turning_left_moves_the_point_backward);
    RUN_TEST(test_point_twist_without_turning_is_the_twist);
    RUN_TEST(test_point_twist_is_the_rate_of_the_output);
    RUN_TEST(test_twist_of_point_undoes_point_twist);
    RUN_TEST(test_twist_of_point_standing_while_turning_left_moves_the_body_ahead);
    RUN_TEST(test_speed_without_turning_is_the_length_of_the_velocity);
    RUN_TEST(test_speed_turning_counts_by_the_length);
    RUN_TEST(test_speed_with_no_length_leaves_turning_out);
    RUN_TEST(test_speed_at_rest_is_zero);
    RUN_TEST(test_speed_rate_agrees_with_a_finite_difference);
    RUN_TEST(test_speed_rate_speeding_up_is_positive_and_braking_negative);
    RUN_TEST(test_speed_rate_at_rest_is_zero);
    RUN_TEST(test_speed_rate_too_slow_for_single_precision_is_finite);
    RUN_TEST(test_moved_pose_in_a_period_agrees_with_a_fine_integration);
    RUN_TEST(test_moved_pose_errs_by_the_square_of_the_turn);
    RUN_TEST(test_moved_pose_facing_left_moves_ahead_along_world_y);
    RUN_TEST(test_moved_pose_turning_past_pi_wraps);
    RUN_TEST(test_moved_pose_at_rest_stays);
    RUN_TEST(test_moved_pose_over_many_small_ways_loses_none_of_them);
    RUN_TEST(test_moved_pose_turning_slowly_for_long_loses_nothing);
    return UNITY_END();
}
