// SPDX-License-Identifier: MIT
// Three PWM outputs of TIM8 or TIM1 at 20 kHz (RM0090 17). Off is the timer's own off: MOE 0 holds the outputs low
// whatever the compare registers say, and the break input (bridges' fault, low) and a failing crystal clear it without
// the processor (17.3.12).
//
// Dead time: none. The outputs go to bridges with one PWM and one direction input, which keep their own two switches
// apart; the complementary outputs that the timer's dead time is for are not used.
#ifndef OMNIBOT_STM32F405_PWM_H
#define OMNIBOT_STM32F405_PWM_H

#include "registers.h"

enum { PWM_CHANNELS = 3, PWM_RATE_HZ = 20000 };

typedef struct {
    timer_registers_t *timer;
    uint32_t period; // in ticks of the timer
} pwm_t;

/// Runs the timer, outputs off. timer_Hz is the timer's clock.
void pwm_start(pwm_t *pwm, timer_registers_t *timer, uint32_t timer_Hz);

/// Lets the outputs go, unless the break input still holds them.
void pwm_enable(pwm_t *pwm);

void pwm_disable(pwm_t *pwm);

/// Sets a channel's share of the period that is high, 0 … 1; in force from the next period on.
void pwm_set(pwm_t *pwm, uint32_t channel, float share);

/// Whether a break has come since pwm_enable.
bool pwm_has_tripped(const pwm_t *pwm);

#endif
