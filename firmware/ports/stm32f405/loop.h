// SPDX-License-Identifier: MIT
// The robot on the board: frames as they come, a step a period, all of it in thread mode.
#ifndef OMNIBOT_STM32F405_LOOP_H
#define OMNIBOT_STM32F405_LOOP_H

#include "app.h"
#include "board.h"

typedef struct {
    board_t board;
    app_t app;
    uint32_t measured_at; // when the wheel speeds were, in cycles
} loop_t;

/// Brings up the board and the app, in lockstep with bridges off, until a host says USE_MOTORS.
void loop_start(loop_t *loop, uint8_t node);

/// One turn: the tick if one is due, one frame if there is one, and what is to be sent; then sleep if there was
/// nothing.
void loop_turn(loop_t *loop);

#endif
