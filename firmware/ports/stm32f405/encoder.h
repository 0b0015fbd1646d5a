// SPDX-License-Identifier: MIT
// Quadrature encoders on timers in encoder mode (RM0090 18.3.12): both edges of both lines count.
#ifndef OMNIBOT_STM32F405_ENCODER_H
#define OMNIBOT_STM32F405_ENCODER_H

#include "registers.h"

/// One wheel's, as the board's header says.
typedef struct {
    timer_registers_t *timer;
    uint8_t bits; // of its counter: 16 or 32
    int8_t sign;  // +1: counts up when the wheel turns forwards, -1: down
} encoder_wiring_t;

typedef struct {
    encoder_wiring_t wiring;
    uint32_t last;
} encoder_t;

void encoder_start(encoder_t *encoder, const encoder_wiring_t *wiring);

/// Counts since it was asked last, forwards positive; right as long as they are fewer than half the counter's span.
int32_t encoder_counts(encoder_t *encoder);

/// Speed in rad/s of counts in a time, of a wheel that has so many a turn.
float encoder_speed(int32_t counts, float counts_per_turn, float time_s);

#endif
