// SPDX-License-Identifier: MIT
// The only way to a register. On the board a read or write is one volatile access; in the host's tests
// (OMNIBOT_REGISTER_MODEL) it goes to a model that logs it and answers. A register is a type of its own, so that no
// driver can read or write one past these functions.
#ifndef OMNIBOT_STM32F405_ACCESS_H
#define OMNIBOT_STM32F405_ACCESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    volatile uint32_t word;
} reg_t;

#ifdef OMNIBOT_REGISTER_MODEL
uint32_t reg_read(const reg_t *reg);
void reg_write(reg_t *reg, uint32_t value);
#else
static inline uint32_t reg_read(const reg_t *reg)
{
    return reg->word;
}

static inline void reg_write(reg_t *reg, uint32_t value)
{
    reg->word = value;
}
#endif

/// Replaces the bits of the mask; the others stay.
static inline void reg_change(reg_t *reg, uint32_t mask, uint32_t bits)
{
    reg_write(reg, (reg_read(reg) & ~mask) | bits);
}

static inline void reg_set(reg_t *reg, uint32_t bits)
{
    reg_change(reg, bits, bits);
}

static inline void reg_clear(reg_t *reg, uint32_t bits)
{
    reg_change(reg, bits, 0);
}

// A poll takes at least four cycles of the core (load, and, compare, branch), so this many of them take at least the
// time at the clock; wait states and the bus make it two to four times as long.
enum { WAIT_CYCLES_PER_POLL_MIN = 4 };
#define WAIT_POLLS(time_us, clock_MHz) ((uint32_t)(time_us) * (uint32_t)(clock_MHz) / WAIT_CYCLES_PER_POLL_MIN)

/// Polls a register until the masked bits have the value; false when they have not after so many polls. Nothing else in
/// this port waits for a register (tools/check-waits).
static inline bool wait_until(const reg_t *reg, uint32_t mask, uint32_t value, uint32_t polls)
{
    for (uint32_t poll = 0; poll < polls; poll++) {
        if ((reg_read(reg) & mask) == value) {
            return true;
        }
    }
    return false;
}

#endif
