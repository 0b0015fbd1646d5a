// SPDX-License-Identifier: MIT
// The board as a whole: what is set up in which order, and what a tick of its timer does.
#ifndef OMNIBOT_STM32F405_BOARD_H
#define OMNIBOT_STM32F405_BOARD_H

#include "clock.h"
#include "link.h"
#include "usart.h"

#include <stdatomic.h>

typedef struct {
    clock_tree_t clock;
    usart_t usart;
    link_t link;
    _Atomic uint32_t ticks; // of the timer, since the start
    uint32_t ticks_done;
} board_t;

/// Takes the torque off the wheels: bridges off, whatever else holds. Needs no memory but the stack and no set-up.
void board_bridges_off(void);

/// Brings up clock, pins, lines and timer. The bridges stay off.
void board_start(board_t *board);

/// Periods since it was asked last.
uint32_t board_periods(board_t *board);

/// Moves bytes out where no interrupt does it.
void board_pump(board_t *board);

/// Waits for the next interrupt.
void board_sleep(void);

#endif
