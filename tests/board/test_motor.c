// SPDX-License-Identifier: MIT
// Torque to duty against the motor's own physics: a simulated winding with that voltage on it gives the torque.
#include "motor.h"

#include "unity.h"

#include <math.h>

static const motor_t motor = {.resistance_Ohm = 2.2f,
                              .torque_constant_Nm_A = 0.0115f,
                              .gear_ratio = 20.0f,
                              .supply_nominal_V = 12.0f,
                              .encoder_counts = 80000.0f};

void setUp(void)
{
}

void tearDown(void)
{
}

/// Ohm's law around the winding: the voltage less the back-EMF drives the current, the current makes the torque.
static float torque_at_wheel(float duty, float supply_V, float wheel_rad_per_s)
{
    const float shaft_rad_per_s = wheel_rad_per_s * 20.0f;
    const float current_A = (duty * supply_V - 0.0115f * shaft_rad_per_s) / 2.2f;
    return 0.0115f * current_A * 20.0f;
}

static void test_duty_gives_the_torque_at_any_speed_and_supply(void)
{
    for (float supply = 9.0f; supply <= 12.6f; supply += 0.9f) {
        for (float speed = -20.0f; speed <= 20.0f; speed += 5.0f) {
            for (float torque = -0.2f; torque <= 0.2f; torque += 0.05f) {
                const float duty = motor_duty(&motor, torque, speed, supply, 0.95f);
                TEST_ASSERT_TRUE(fabsf(duty) < 0.95f);
                TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, torque, torque_at_wheel(duty, supply, speed));
            }
        }
    }
}

static void test_signs_are_those_of_torque_and_speed(void)
{
    TEST_ASSERT_TRUE(motor_duty(&motor, 0.1f, 0.0f, 12.0f, 0.95f) > 0.0f);
    TEST_ASSERT_TRUE(motor_duty(&motor, -0.1f, 0.0f, 12.0f, 0.95f) < 0.0f);
    TEST_ASSERT_TRUE(motor_duty(&motor, 0.0f, 10.0f, 12.0f, 0.95f) > 0.0f); // no torque: the back-EMF is met
    TEST_ASSERT_TRUE(motor_duty(&motor, 0.0f, -10.0f, 12.0f, 0.95f) < 0.0f);
}

static void test_duty_is_held_within_its_bound(void)
{
    TEST_ASSERT_EQUAL_FLOAT(0.95f, motor_duty(&motor, 2.0f, 50.0f, 12.0f, 0.95f));
    TEST_ASSERT_EQUAL_FLOAT(-0.95f, motor_duty(&motor, -2.0f, -50.0f, 12.0f, 0.95f));
    TEST_ASSERT_EQUAL_FLOAT(0.95f, motor_duty(&motor, INFINITY, 0.0f, 12.0f, 0.95f));
}

static void test_what_makes_no_sense_gives_no_voltage(void)
{
    TEST_ASSERT_EQUAL_FLOAT(0.0f, motor_duty(&motor, 0.1f, 0.0f, 0.0f, 0.95f));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, motor_duty(&motor, 0.1f, 0.0f, -1.0f, 0.95f));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, motor_duty(&motor, 0.1f, 0.0f, NAN, 0.95f));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, motor_duty(&motor, NAN, 0.0f, 12.0f, 0.95f));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, motor_duty(&motor, 0.1f, NAN, 12.0f, 0.95f));
}

/// The robot file says what the drive must be good for: its torque limit at 1 m/s, from the lowest supply.
static void test_motors_of_the_robot_file_give_the_torque_limit_at_1_m_per_s(void)
{
    const float duty = motor_duty(&omnibot_motor, 0.2f, 1.0f / 0.0349f, 9.0f, 1.0f);
    TEST_ASSERT_TRUE(duty < 0.95f);
    TEST_ASSERT_EQUAL_FLOAT(80000.0f, omnibot_motor.encoder_counts); // a turn of the wheel: 4000 times the gear
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_duty_gives_the_torque_at_any_speed_and_supply);
    RUN_TEST(test_signs_are_those_of_torque_and_speed);
    RUN_TEST(test_duty_is_held_within_its_bound);
    RUN_TEST(test_what_makes_no_sense_gives_no_voltage);
    RUN_TEST(test_motors_of_the_robot_file_give_the_torque_limit_at_1_m_per_s);
    return UNITY_END();
}
