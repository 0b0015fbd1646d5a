// SPDX-License-Identifier: MIT
#include "motor.h"

#include <math.h>

float motor_duty(const motor_t *motor, float torque_Nm, float wheel_rad_per_s, float supply_V, float duty_max)
{
    const float wheel_constant_Nm_A = motor->torque_constant_Nm_A * motor->gear_ratio;
    const float current_A = torque_Nm / wheel_constant_Nm_A;
    const float voltage_V = motor->resistance_Ohm * current_A + wheel_constant_Nm_A * wheel_rad_per_s;
    if (!(supply_V > 0.0f)) {
        return 0.0f;
    }
    const float duty = voltage_V / supply_V;
    if (duty > duty_max) {
        return duty_max;
    }
    if (duty < -duty_max) {
        return -duty_max;
    }
    return isnan(duty) ? 0.0f : duty;
}
