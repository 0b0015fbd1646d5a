// SPDX-License-Identifier: MIT
#include "wheels.h"

#include "gpio.h"

void wheels_start(wheels_t *wheels, const wheels_wiring_t *wiring, const motor_t *motor, uint32_t timer_Hz)
{
    wheels->wiring = wiring;
    wheels->motor = motor;
    pwm_start(&wheels->pwm, wiring->pwm, timer_Hz);
    wheels_off(wheels);
    for (uint32_t i = 0; i < WHEEL_COUNT; i++) {
        encoder_start(&wheels->encoder[i], &wiring->encoder[i]);
    }
}

static float measure(wheels_t *wheels, uint32_t i, float time_s)
{
    return encoder_speed(encoder_counts(&wheels->encoder[i]), wheels->motor->encoder_counts, time_s);
}

vec3_t wheels_measure(wheels_t *wheels, float time_s)
{
    wheels->speed_rad_per_s =
        (vec3_t){measure(wheels, 0, time_s), measure(wheels, 1, time_s), measure(wheels, 2, time_s)};
    return wheels->speed_rad_per_s;
}

/// The direction changes at once, the share with the next period: for at most 50 µs the old share goes the new way.
static void drive_one(wheels_t *wheels, uint32_t i, float torque_Nm, float speed_rad_per_s, float supply_V)
{
    const wheels_wiring_t *wiring = wheels->wiring;
    const float duty = motor_duty(wheels->motor, torque_Nm, speed_rad_per_s, supply_V, wiring->duty_max);
    const bool forwards = duty >= 0.0f;
    gpio_write(wiring->direction[i].port, wiring->direction[i].pin, forwards == (wiring->forwards[i] > 0));
    pwm_set(&wheels->pwm, i, forwards ? duty : -duty);
}

void wheels_drive(wheels_t *wheels, vec3_t torque_Nm, float supply_V)
{
    const vec3_t speed = wheels->speed_rad_per_s;
    drive_one(wheels, 0, torque_Nm.x, speed.x, supply_V);
    drive_one(wheels, 1, torque_Nm.y, speed.y, supply_V);
    drive_one(wheels, 2, torque_Nm.z, speed.z, supply_V);
    if (!wheels->on) {
        wheels->on = true;
        pwm_enable(&wheels->pwm);
        gpio_write(wheels->wiring->enable.port, wheels->wiring->enable.pin, true);
    }
}

void wheels_off(wheels_t *wheels)
{
    wheels->on = false;
    gpio_write(wheels->wiring->enable.port, wheels->wiring->enable.pin, false);
    pwm_disable(&wheels->pwm);
    for (uint32_t i = 0; i < WHEEL_COUNT; i++) {
        pwm_set(&wheels->pwm, i, 0.0f);
    }
}

bool wheels_have_tripped(const wheels_t *wheels)
{
    return wheels->on && pwm_has_tripped(&wheels->pwm);
}
