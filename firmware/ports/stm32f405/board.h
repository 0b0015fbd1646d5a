// SPDX-License-Identifier: MIT
// The board as a whole: what is set up in which order, and what it knows of itself.
#ifndef OMNIBOT_STM32F405_BOARD_H
#define OMNIBOT_STM32F405_BOARD_H

#include "adc.h"
#include "app.h"
#include "can.h"
#include "clock.h"
#include "cycles.h"
#include "fault.h"
#include "flash.h"
#include "link.h"
#include "supply.h"
#include "usart.h"
#include "wheels.h"

#include <stdatomic.h>

typedef struct {
    uint8_t reset_cause; // RESET_CAUSE_… of the wire
    clock_tree_t clock;
    cycles_t cycles;
    usart_t usart;
    can_t can;
    link_t link;
    wheels_t wheels;
    adc_t adc;
    supply_t supply;
    flash_t flash;
    settings_memory_t settings;
    bool keeps_settings;
    _Atomic uint32_t ticks; // of the timer, since the start
    uint32_t ticks_done;
} board_t;

/// What a fault left behind, in memory that no start-up clears.
extern crash_t board_crash;

/// Takes the torque off the wheels: bridges off, whatever else holds. Needs no memory but the stack and no set-up.
void board_bridges_off(void);

/// Brings up clock, pins, lines, wheels, timer and, last, the watchdog. The bridges stay off.
void board_start(board_t *board, uint8_t node);

/// Where parameters outlive a reset; NULL where nothing does. Saving may stop the core for 2 s: not with motors on.
const settings_memory_t *board_settings(const board_t *board);

/// The timer's interrupt.
void board_count_tick(board_t *board);

/// Periods of the timer since it was asked last.
uint32_t board_periods(board_t *board);

/// A period has passed: lines and voltages are looked after.
void board_tick(board_t *board);

/// Why the motors can't be driven, a FAULT_… of the wire: SUPPLY, BRIDGE, or NONE when they can.
uint8_t board_motor_fault(const board_t *board);

app_health_t board_health(board_t *board);

/// Puts the watchdog off if the tick was healthy.
void board_feed_watchdog(uint32_t periods, bool app_in_order);

void board_show(const board_t *board, uint8_t mode, uint8_t fault);

/// Moves bytes out where no interrupt does it.
void board_pump(board_t *board);

/// Waits for the next interrupt, unless there is something to do already.
void board_sleep(board_t *board);

/// Ends this run and begins the next one.
void board_reset(void);

#endif
