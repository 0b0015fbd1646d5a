// SPDX-License-Identifier: MIT
// A register model for the drivers of firmware/ports/stm32f405: every peripheral as memory, every access logged in
// order, and hooks through which a test plays the hardware. A driver that touches anything but a register of a known
// peripheral fails its test.
#ifndef OMNIBOT_TESTS_BOARD_MODEL_H
#define OMNIBOT_TESTS_BOARD_MODEL_H

#include "registers.h"

typedef struct {
    const char *block; // name of the peripheral, as in registers.h
    const reg_t *reg;
    uint32_t value;
    bool write;
} access_t;

/// All registers 0, nothing logged, no hooks.
void model_reset(void);

/// Forgets the log and keeps registers and hooks.
void model_forget(void);

/// The hardware's part: what a register holds after a write of a value, and what it gives when read.
typedef uint32_t (*model_hook_t)(reg_t *reg, uint32_t value);
void model_on_write(model_hook_t hook);
void model_on_read(model_hook_t hook);

/// Past the log and the hooks: what the hardware sets, and what it sees.
void model_set(reg_t *reg, uint32_t value);
uint32_t model_get(const reg_t *reg);

/// Every access so far, and only the writes of them: the n-th, counted from 0.
uint32_t model_accesses(void);
uint32_t model_writes(void);
access_t model_write(uint32_t n);

/// The writes to one register: how many, and the n-th value.
uint32_t model_writes_to(const reg_t *reg);
uint32_t model_written(const reg_t *reg, uint32_t n);
uint32_t model_reads_of(const reg_t *reg);

/// Where in the order of writes the first one with these bits set is; fails without one.
uint32_t model_first_write(const reg_t *reg, uint32_t bits);

/// Fails if anything was written outside the named peripherals; the list ends in NULL.
void model_assert_wrote_only(const char *const *blocks);

/// What the core was told, in order: 'm' mask, 'u' unmask, 'w' wait, 's' synchronise.
const char *model_core_log(void);

#endif
