// SPDX-License-Identifier: MIT
// The independent watchdog (RM0090 21): its own oscillator, and no way to stop it once it runs. It resets the board
// after WATCHDOG_TIMEOUT_MS without a healthy tick; the 32 kHz are 17 … 47 kHz over all parts and temperatures (data
// sheet, 5.3.9), so after 34 … 94 ms.
#ifndef OMNIBOT_STM32F405_WATCHDOG_H
#define OMNIBOT_STM32F405_WATCHDOG_H

#include "registers.h"

enum { WATCHDOG_TIMEOUT_MS = 50, WATCHDOG_STRETCHED_MS = 8190 };

/// What makes a tick healthy.
typedef struct {
    uint32_t periods;  // since the last tick: 1, or some were missed
    bool app_in_order; // it is in a mode that there is
} tick_health_t;

/// False when it did not take the settings: then it runs with its longest time-out, 512 ms.
bool watchdog_start(iwdg_registers_t *registers);

/// Gives it WATCHDOG_STRETCHED_MS, 5.5 … 15 s, from now on, for what stops the core longer than its own time; and takes
/// that back. False when it did not take the settings.
bool watchdog_stretch(iwdg_registers_t *registers);
bool watchdog_restore(iwdg_registers_t *registers);

bool tick_is_healthy(const tick_health_t *health);

/// Puts the reset off, if the tick was healthy.
void watchdog_tick(iwdg_registers_t *registers, const tick_health_t *health);

#endif
