// SPDX-License-Identifier: MIT
#include "flash.h"

#include "core.h"
#include "power.h"
#include "watchdog.h"
#include "wire.h"

static_assert(FLASH_PAGE_BYTES <= sizeof(flash_sector_t), "a page lies within its sector");
static_assert(FLASH_PAGE_BYTES % SETTINGS_SLOT_BYTES == 0, "whole slots");

// Data sheet, 5.3.12, at the largest: a word 100 µs, a sector of 128 kB 2 s.
#define PROGRAM_POLLS WAIT_POLLS(1000, 168)
#define ERASE_POLLS WAIT_POLLS(2500000, 168)

bool flash_answers(flash_registers_t *registers)
{
    reg_write(&registers->cr, FLASH_CR_LOCK);
    return (reg_read(&registers->cr) & FLASH_CR_LOCK) != 0;
}

// ---- an operation

/// The keys are for a locked register alone: otherwise they lock it until the next reset (RM0090 3.6.1).
static void unlock(flash_registers_t *registers)
{
    if ((reg_read(&registers->cr) & FLASH_CR_LOCK) != 0) {
        reg_write(&registers->keyr, FLASH_KEY1);
        reg_write(&registers->keyr, FLASH_KEY2);
    }
}

/// Ready for an operation, with no complaint left of one before. Not below 2.9 V: 32 bits at a time need 2.7 V.
static bool begin(const flash_t *flash, uint32_t operation)
{
    flash_registers_t *registers = flash->registers;
    if (power_is_low(flash->power) || !wait_until(&registers->sr, FLASH_SR_BSY, 0, PROGRAM_POLLS)) {
        return false;
    }
    unlock(registers);
    reg_write(&registers->sr, FLASH_SR_EOP | FLASH_SR_ERRORS); // cleared by ones
    reg_write(&registers->cr, operation | FLASH_CR_PSIZE_32);
    return reg_read(&registers->cr) == (operation | FLASH_CR_PSIZE_32);
}

static void end(const flash_t *flash)
{
    reg_write(&flash->registers->cr, FLASH_CR_LOCK);
}

static bool succeeded(const flash_t *flash)
{
    return (reg_read(&flash->registers->sr) & (FLASH_SR_BSY | FLASH_SR_ERRORS)) == 0;
}

// ---- erasing

/// What the data cache has read of the sector is no longer there. It can be emptied only while it is off
/// (RM0090 3.5.2).
static void empty_cache(flash_registers_t *registers)
{
    const uint32_t settings = reg_read(&registers->acr);
    reg_write(&registers->acr, settings & ~FLASH_ACR_DCEN);
    reg_write(&registers->acr, (settings & ~FLASH_ACR_DCEN) | FLASH_ACR_DCRST);
    reg_write(&registers->acr, settings & ~FLASH_ACR_DCEN);
    reg_write(&registers->acr, settings);
}

static bool erase_sector(const flash_t *flash)
{
    reg_set(&flash->registers->cr, FLASH_CR_STRT);
    core_synchronise();
    return wait_until(&flash->registers->sr, FLASH_SR_BSY, 0, ERASE_POLLS) && succeeded(flash);
}

/// The watchdog is given its own time back whatever comes of it.
static bool flash_erase(void *context, uint8_t page)
{
    const flash_t *flash = context;
    const bool ready = begin(flash, FLASH_CR_SER | FLASH_CR_SNB(flash->first_sector + page));
    const bool erased = ready && watchdog_stretch(flash->watchdog) && erase_sector(flash);
    const bool guarded = !ready || watchdog_restore(flash->watchdog);
    end(flash);
    empty_cache(flash->registers);
    return erased && guarded;
}

// ---- programming and reading

static bool program_word(const flash_t *flash, reg_t *word, uint32_t value)
{
    reg_write(word, value);
    core_synchronise(); // the write has begun before its end is looked for
    return wait_until(&flash->registers->sr, FLASH_SR_BSY, 0, PROGRAM_POLLS) && succeeded(flash);
}

static bool flash_program(void *context, uint8_t page, uint32_t offset, const uint8_t *bytes, uint32_t length)
{
    const flash_t *flash = context;
    reg_t *word = &flash->sector[page].words[offset / 4u];
    bool good = begin(flash, FLASH_CR_PG);
    for (uint32_t i = 0; i < length / 4u; i++) {
        good = good && program_word(flash, &word[i], wire_load(&bytes[(size_t)4 * i]));
    }
    end(flash);
    return good;
}

static bool flash_read(void *context, uint8_t page, uint32_t offset, uint8_t *bytes, uint32_t length)
{
    const flash_t *flash = context;
    const reg_t *word = &flash->sector[page].words[offset / 4u];
    for (uint32_t i = 0; i < length / 4u; i++) {
        wire_store(&bytes[(size_t)4 * i], reg_read(&word[i]));
    }
    return true;
}

settings_memory_t flash_memory(flash_t *flash)
{
    return (settings_memory_t){
        .context = flash,
        .page_bytes = FLASH_PAGE_BYTES,
        .read = flash_read,
        .erase = flash_erase,
        .program = flash_program,
    };
}
