// SPDX-License-Identifier: MIT
#include "model.h"

#include "core.h"
#include "unity.h"

#include <string.h>

// The instances of registers.h, here in the host's memory.
rcc_registers_t rcc;
flash_registers_t flash_interface;
flash_sector_t settings_sectors[2];
pwr_registers_t pwr;
gpio_registers_t gpio_a, gpio_b, gpio_c, gpio_d;
adc_registers_t adc1;
adc_common_registers_t adc_common;
timer_registers_t tim1, tim2, tim3, tim4, tim5, tim8;
iwdg_registers_t iwdg;
usart_registers_t usart1;
can_registers_t can1;
dbgmcu_registers_t dbgmcu;
systick_registers_t systick;
nvic_registers_t nvic;
scb_registers_t scb;
dwt_registers_t dwt;

#define BLOCK(instance)                                                                                                \
    {                                                                                                                  \
#instance, &(instance), sizeof(instance)                                                                       \
    }
static const struct {
    const char *name;
    void *base;
    size_t bytes;
} blocks[] = {
    BLOCK(rcc),        BLOCK(flash_interface),
    BLOCK(pwr),        BLOCK(gpio_a),
    BLOCK(gpio_b),     BLOCK(gpio_c),
    BLOCK(adc1),       BLOCK(gpio_d),
    BLOCK(adc_common), BLOCK(tim1),
    BLOCK(tim2),       BLOCK(tim3),
    BLOCK(tim4),       BLOCK(tim5),
    BLOCK(tim8),       BLOCK(iwdg),
    BLOCK(usart1),     BLOCK(can1),
    BLOCK(scb),        BLOCK(dbgmcu),
    BLOCK(systick),    BLOCK(nvic),
    BLOCK(dwt),        BLOCK(settings_sectors),
};

enum { LOG_MAX = 1 << 18, CORE_LOG_MAX = 256 };

static access_t log_of_accesses[LOG_MAX];
static uint32_t logged;
static char core_log[CORE_LOG_MAX];
static model_hook_t on_write, on_read;

void model_reset(void)
{
    for (size_t i = 0; i < sizeof blocks / sizeof blocks[0]; i++) {
        memset(blocks[i].base, 0, blocks[i].bytes);
    }
    on_write = NULL;
    on_read = NULL;
    model_forget();
}

void model_forget(void)
{
    logged = 0;
    memset(core_log, 0, sizeof core_log);
}

void model_on_write(model_hook_t hook)
{
    on_write = hook;
}

void model_on_read(model_hook_t hook)
{
    on_read = hook;
}

void model_set(reg_t *reg, uint32_t value)
{
    reg->word = value;
}

uint32_t model_get(const reg_t *reg)
{
    return reg->word;
}

// ---- what the drivers call

static const char *block_of(const reg_t *reg)
{
    const uintptr_t address = (uintptr_t)reg;
    for (size_t i = 0; i < sizeof blocks / sizeof blocks[0]; i++) {
        const uintptr_t base = (uintptr_t)blocks[i].base;
        if (address >= base && address < base + blocks[i].bytes && (address - base) % sizeof *reg == 0) {
            return blocks[i].name;
        }
    }
    TEST_FAIL_MESSAGE("access outside every peripheral");
    return NULL;
}

static void note(const reg_t *reg, uint32_t value, bool write)
{
    TEST_ASSERT_LESS_THAN_UINT32_MESSAGE(LOG_MAX, logged, "the driver never stops");
    log_of_accesses[logged++] = (access_t){block_of(reg), reg, value, write};
}

uint32_t reg_read(const reg_t *reg)
{
    const uint32_t value = on_read == NULL ? reg->word : on_read((reg_t *)(uintptr_t)reg, reg->word);
    note(reg, value, false);
    return value;
}

void reg_write(reg_t *reg, uint32_t value)
{
    note(reg, value, true);
    reg->word = on_write == NULL ? value : on_write(reg, value);
}

static void core(char what)
{
    const size_t length = strlen(core_log);
    TEST_ASSERT_LESS_THAN(CORE_LOG_MAX - 1, length);
    core_log[length] = what;
}

void core_mask_interrupts(void)
{
    core('m');
}

void core_unmask_interrupts(void)
{
    core('u');
}

void core_wait_for_interrupt(void)
{
    core('w');
}

void core_synchronise(void)
{
    core('s');
}

// ---- what the tests ask

uint32_t model_accesses(void)
{
    return logged;
}

uint32_t model_writes(void)
{
    uint32_t writes = 0;
    for (uint32_t i = 0; i < logged; i++) {
        writes += log_of_accesses[i].write ? 1u : 0u;
    }
    return writes;
}

access_t model_write(uint32_t n)
{
    for (uint32_t i = 0; i < logged; i++) {
        if (log_of_accesses[i].write && n-- == 0) {
            return log_of_accesses[i];
        }
    }
    TEST_FAIL_MESSAGE("fewer writes than that");
    return (access_t){0};
}

static uint32_t count(const reg_t *reg, bool write)
{
    uint32_t found = 0;
    for (uint32_t i = 0; i < logged; i++) {
        found += log_of_accesses[i].reg == reg && log_of_accesses[i].write == write ? 1u : 0u;
    }
    return found;
}

uint32_t model_writes_to(const reg_t *reg)
{
    return count(reg, true);
}

uint32_t model_reads_of(const reg_t *reg)
{
    return count(reg, false);
}

uint32_t model_written(const reg_t *reg, uint32_t n)
{
    for (uint32_t i = 0; i < logged; i++) {
        if (log_of_accesses[i].reg == reg && log_of_accesses[i].write && n-- == 0) {
            return log_of_accesses[i].value;
        }
    }
    TEST_FAIL_MESSAGE("fewer writes to it than that");
    return 0;
}

uint32_t model_first_write(const reg_t *reg, uint32_t bits)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < logged; i++) {
        const access_t *access = &log_of_accesses[i];
        if (access->write && access->reg == reg && (access->value & bits) == bits) {
            return n;
        }
        n += access->write ? 1u : 0u;
    }
    TEST_FAIL_MESSAGE("no such write");
    return 0;
}

void model_assert_wrote_only(const char *const *allowed)
{
    for (uint32_t i = 0; i < logged; i++) {
        bool found = !log_of_accesses[i].write;
        for (const char *const *name = allowed; *name != NULL && !found; name++) {
            found = strcmp(*name, log_of_accesses[i].block) == 0;
        }
        TEST_ASSERT_TRUE_MESSAGE(found, log_of_accesses[i].block);
    }
}

const char *model_core_log(void)
{
    return core_log;
}
