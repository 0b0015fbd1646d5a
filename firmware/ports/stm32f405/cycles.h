// SPDX-License-Identifier: MIT
// The core's cycle counter (Armv7-M architecture manual, C1.8). An emulator may have none; then nothing is timed.
#ifndef OMNIBOT_STM32F405_CYCLES_H
#define OMNIBOT_STM32F405_CYCLES_H

#include "registers.h"

typedef struct {
    const dwt_registers_t *registers;
    bool works; // it was seen to count
    uint32_t core_Hz;
} cycles_t;

void cycles_start(cycles_t *cycles, scb_registers_t *core, dwt_registers_t *registers, uint32_t core_Hz);

/// The count; wraps every 25 s at 168 MHz. 0 when it does not work.
uint32_t cycles_now(const cycles_t *cycles);

/// Nanoseconds of a number of cycles, UINT32_MAX where they are more.
uint32_t cycles_to_ns(const cycles_t *cycles, uint32_t count);

#endif
