// SPDX-License-Identifier: MIT
// What is left of a processor fault after the reset that it leads to: a record in memory that no start-up clears.
#ifndef OMNIBOT_STM32F405_FAULT_H
#define OMNIBOT_STM32F405_FAULT_H

#include "registers.h"

typedef struct {
    uint32_t magic;
    uint32_t
        exception;   // number of the exception: 3 HardFault, 4 MemManage, 5 BusFault, 6 UsageFault, 2 a failed crystal
    uint32_t pc, lr; // where; 0 where the stack was no good
    uint32_t cfsr, hfsr, mmfar, bfar; // PM0214 4.4.13 ff.
} crash_facts_t;

typedef struct {
    crash_facts_t facts;
    uint32_t crc; // CRC-32 of the facts
} crash_t;

/// The registers that the core pushes when it takes an exception (PM0214 2.3.7).
typedef struct {
    uint32_t r0, r1, r2, r3, r12, lr, pc, xpsr;
} exception_frame_t;

/// Writes the record. frame may be NULL.
void crash_record(crash_t *crash, const scb_registers_t *core, const exception_frame_t *frame);

/// Whether there is a whole record; out of power-on there is whatever the memory came up with.
bool crash_is_there(const crash_t *crash);

/// Forgets it.
void crash_clear(crash_t *crash);

#endif
