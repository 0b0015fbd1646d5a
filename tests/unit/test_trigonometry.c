// SPDX-License-Identifier: MIT
// Sine, cosine and wrapping against the maths library in double.
#include "trigonometry.h"

#include "unity.h"

#include <stdio.h>

static const double pi = 3.14159265358979323846;

/// What trigonometry.h promises of each entry.
static const double promised_error = 1.2e-7;

void setUp(void)
{
}

void tearDown(void)
{
}

static double worst_of(double a, double b)
{
    return a > b ? a : b;
}

static double rotation_error(float angle_rad)
{
    const rotation_t r = rotation_of(angle_rad);
    const double cosine_error = fabs((double)r.cosine - cos((double)angle_rad));
    const double sine_error = fabs((double)r.sine - sin((double)angle_rad));
    return worst_of(cosine_error, sine_error);
}

static void assert_below(double bound, double value, float where)
{
    char message[96];
    (void)snprintf(message, sizeof message, "%.3g is not below %.3g at %.9g", value, bound, (double)where);
    TEST_ASSERT_TRUE_MESSAGE(value < bound, message);
}

static void assert_near(double expected, float actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)expected, actual);
}

// ---- rotation_of

static void test_rotation_dense_sweep_stays_below_the_promised_error(void)
{
    double worst = 0.0;
    float where = 0.0f;
    for (int32_t i = -1000000; i <= 1000000; i++) {
        const float angle = (float)i * 1.0e-4f;
        const double error = rotation_error(angle);
        where = error > worst ? angle : where;
        worst = worst_of(worst, error);
    }

    assert_below(promised_error, worst, where);
}

static void test_rotation_within_one_turn_finely_stays_below_the_promised_error(void)
{
    double worst = 0.0;
    float where = 0.0f;
    for (int32_t i = -1000000; i <= 1000000; i++) {
        const float angle = (float)i * 3.3e-6f;
        const double error = rotation_error(angle);
        where = error > worst ? angle : where;
        worst = worst_of(worst, error);
    }

    assert_below(promised_error, worst, where);
}

static void test_rotation_around_every_eighth_turn_stays_below_the_promised_error(void)
{
    // Here the reduction changes from one quarter to the next, or cancels most.
    for (int eighth = -127; eighth <= 127; eighth++) {
        float angle = (float)(eighth * pi / 4.0);
        for (int i = 0; i < 20; i++) {
            angle = nextafterf(angle, -1000.0f);
        }
        for (int i = 0; i < 40; i++) {
            assert_below(promised_error, rotation_error(angle), angle);
            angle = nextafterf(angle, 1000.0f);
        }
    }
}

static void test_rotation_of_the_largest_promised_angles_stays_below_the_promised_error(void)
{
    assert_below(promised_error, rotation_error(100.0f), 100.0f);
    assert_below(promised_error, rotation_error(-100.0f), -100.0f);
}

static void test_rotation_of_zero_is_the_identity(void)
{
    const rotation_t r = rotation_of(0.0f);

    TEST_ASSERT_EQUAL_FLOAT(1.0f, r.cosine);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, r.sine);
}

static void test_rotation_of_quarter_turns_has_the_right_signs(void)
{
    static const double cosine[] = {1.0, 0.0, -1.0, 0.0};
    static const double sine[] = {0.0, 1.0, 0.0, -1.0};
    for (int quarter = -40; quarter <= 40; quarter++) {
        const rotation_t r = rotation_of((float)(quarter * pi / 2.0));

        // An angle of 63 rad is itself rounded by up to 2e-6 rad.
        assert_near(cosine[quarter & 3], r.cosine, 4e-6);
        assert_near(sine[quarter & 3], r.sine, 4e-6);
    }
}

static void test_rotation_of_tiny_angle_keeps_it(void)
{
    const rotation_t r = rotation_of(1.0e-20f);

    TEST_ASSERT_EQUAL_FLOAT(1.0e-20f, r.sine);
    TEST_ASSERT_EQUAL_FLOAT(1.0f, r.cosine);
}

static void test_rotation_of_negative_zero_and_subnormal_is_the_identity(void)
{
    TEST_ASSERT_EQUAL_FLOAT(1.0f, rotation_of(-0.0f).cosine);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-40f, 0.0f, rotation_of(1.0e-41f).sine);
}

// ---- rotation_to_body

static void test_turned_rotation_by_a_small_angle_stays_below_the_promised_error(void)
{
    for (int32_t heading = -31; heading <= 31; heading++) {
        const float from = 0.1f * (float)heading;
        for (int32_t i = -20; i <= 20; i++) {
            const double angle = 0.005 * i, promised = fabs(angle * angle * angle) / 6.0 + 3e-7;
            const rotation_t turned = rotation_turned(rotation_of(from), (float)angle);
            assert_below(promised, fabs((double)turned.cosine - cos((double)from + angle)), from);
            assert_below(promised, fabs((double)turned.sine - sin((double)from + angle)), from);
        }
    }
}

static void test_to_body_at_zero_heading_changes_nothing(void)
{
    const vec3_t body = rotation_to_body(rotation_of(0.0f), (vec3_t){1.0f, 2.0f, 3.0f});

    assert_near(1.0, body.x, 0.0);
    assert_near(2.0, body.y, 0.0);
    assert_near(3.0, body.z, 0.0);
}

static void test_to_body_facing_left_sees_world_x_on_its_right(void)
{
    const vec3_t body = rotation_to_body(rotation_of((float)(pi / 2.0)), (vec3_t){1.0f, 0.0f, 5.0f});

    assert_near(0.0, body.x, 1e-6);
    assert_near(-1.0, body.y, 1e-6);
    assert_near(5.0, body.z, 0.0);
}

static void test_to_body_facing_left_sees_world_y_ahead(void)
{
    const vec3_t body = rotation_to_body(rotation_of((float)(pi / 2.0)), (vec3_t){0.0f, 1.0f, 0.0f});

    assert_near(1.0, body.x, 1e-6);
    assert_near(0.0, body.y, 1e-6);
}

static void test_to_body_at_any_heading_undoes_the_rotation(void)
{
    for (int i = -30; i <= 30; i++) {
        const float heading = 0.2f * (float)i;
        const double c = cos((double)heading), s = sin((double)heading);
        const vec3_t world = {(float)(c * 0.7 + s * 1.1), (float)(s * 0.7 - c * 1.1), 0.0f}; // R (0.7, −1.1)

        const vec3_t body = rotation_to_body(rotation_of(heading), world);

        assert_near(0.7, body.x, 1e-6);
        assert_near(-1.1, body.y, 1e-6);
    }
}

// ---- angle_wrap

static void test_wrap_within_half_a_turn_returns_the_angle(void)
{
    for (int i = -3141; i <= 3141; i++) {
        const float angle = (float)i * 1.0e-3f;

        TEST_ASSERT_FLOAT_WITHIN(0.0f, angle, angle_wrap(angle));
    }
}

static void test_wrap_just_past_pi_turns_to_the_other_side(void)
{
    assert_near(-pi + 0.01, angle_wrap((float)(pi + 0.01)), 1e-6);
    assert_near(pi - 0.01, angle_wrap((float)(-pi - 0.01)), 1e-6);
}

static void test_wrap_at_pi_stays_within_half_a_turn(void)
{
    const float near_pi[] = {(float)pi, nextafterf((float)pi, 0.0f), nextafterf((float)pi, 4.0f)};
    for (size_t i = 0; i < sizeof near_pi / sizeof near_pi[0]; i++) {
        // Both ends are the same heading: either will do.
        assert_near(pi, fabsf(angle_wrap(near_pi[i])), 5e-7);
        assert_near(pi, fabsf(angle_wrap(-near_pi[i])), 5e-7);
    }
}

static void test_wrap_many_turns_agrees_with_the_remainder_in_double(void)
{
    for (int32_t i = -200000; i <= 200000; i++) {
        const float angle = (float)i * 3.1e-3f; // about ±100 turns
        const double wrapped = (double)angle_wrap(angle);
        const double off = remainder(wrapped - (double)angle, 2.0 * pi);

        assert_below(5e-7, fabs(off), angle);
        // Close to half a turn the side is chosen by a rounded quotient, half a unit in its last place.
        assert_below(pi + 5e-7 + 1.2e-7 * fabs((double)angle), fabs(wrapped), angle);
    }
}

static void test_wrap_thousands_of_turns_is_still_a_whole_number_of_turns(void)
{
    // The largest heading that a valid trajectory can hold: eight coefficients of 1e4.
    for (int32_t i = -1000; i <= 1000; i++) {
        const float angle = (float)i * 80.0f;
        const double off = remainder((double)angle_wrap(angle) - (double)angle, 2.0 * pi);

        assert_below(1e-5, fabs(off), angle);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_rotation_dense_sweep_stays_below_the_promised_error);
    RUN_TEST(test_rotation_within_one_turn_finely_stays_below_the_promised_error);
    RUN_TEST(test_rotation_around_every_eighth_turn_stays_below_the_promised_error);
    RUN_TEST(test_rotation_of_the_largest_promised_angles_stays_below_the_promised_error);
    RUN_TEST(test_rotation_of_zero_is_the_identity);
    RUN_TEST(test_rotation_of_quarter_turns_has_the_right_signs);
    RUN_TEST(test_rotation_of_tiny_angle_keeps_it);
    RUN_TEST(test_rotation_of_negative_zero_and_subnormal_is_the_identity);
    RUN_TEST(test_turned_rotation_by_a_small_angle_stays_below_the_promised_error);
    RUN_TEST(test_to_body_at_zero_heading_changes_nothing);
    RUN_TEST(test_to_body_facing_left_sees_world_x_on_its_right);
    RUN_TEST(test_to_body_facing_left_sees_world_y_ahead);
    RUN_TEST(test_to_body_at_any_heading_undoes_the_rotation);
    RUN_TEST(test_wrap_within_half_a_turn_returns_the_angle);
    RUN_TEST(test_wrap_just_past_pi_turns_to_the_other_side);
    RUN_TEST(test_wrap_at_pi_stays_within_half_a_turn);
    RUN_TEST(test_wrap_many_turns_agrees_with_the_remainder_in_double);
    RUN_TEST(test_wrap_thousands_of_turns_is_still_a_whole_number_of_turns);
    return UNITY_END();
}
