// SPDX-License-Identifier: MIT
// The three wheels: encoders in, bridges out. A bridge takes a PWM for how much and a direction; one line enables all
// three. Off is off three times over: enable low, PWM outputs off, shares zero.
#ifndef OMNIBOT_STM32F405_WHEELS_H
#define OMNIBOT_STM32F405_WHEELS_H

#include "encoder.h"
#include "motor.h"
#include "pwm.h"
#include "vec3.h"

enum { WHEEL_COUNT = PWM_CHANNELS };

typedef struct {
    gpio_registers_t *port;
    uint8_t pin;
} wheel_pin_t;

/// As the board's header says.
typedef struct {
    encoder_wiring_t encoder[WHEEL_COUNT];
    wheel_pin_t direction[WHEEL_COUNT];
    int8_t forwards[WHEEL_COUNT]; // +1: forwards while the direction is high, -1: while it is low
    wheel_pin_t enable;
    timer_registers_t *pwm; // channels 1 … 3 are wheels 1 … 3
    float duty_max;         // a bridge's upper switch needs a pause to recharge its driver
} wheels_wiring_t;

typedef struct {
    const wheels_wiring_t *wiring;
    const motor_t *motor;
    encoder_t encoder[WHEEL_COUNT];
    pwm_t pwm;
    vec3_t speed_rad_per_s; // measured last
    bool on;
} wheels_t;

/// Bridges off, encoders counting. timer_Hz is the clock of the PWM's timer.
void wheels_start(wheels_t *wheels, const wheels_wiring_t *wiring, const motor_t *motor, uint32_t timer_Hz);

/// Mean speeds since it was asked last, a time ago.
vec3_t wheels_measure(wheels_t *wheels, float time_s);

/// Puts torques on the wheels, by the speeds measured last, from a supply.
void wheels_drive(wheels_t *wheels, vec3_t torque_Nm, float supply_V);

void wheels_off(wheels_t *wheels);

/// Whether the bridges have shut themselves off since they were switched on.
bool wheels_have_tripped(const wheels_t *wheels);

#endif
