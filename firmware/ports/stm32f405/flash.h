// SPDX-License-Identifier: MIT
// Two sectors of the flash, away from the image, as the memory of app/settings.h (RM0090 3.6).
//
// Erasing takes the flash 1 s, 2 s at most, and each word 16 µs, 100 µs at most (data sheet, 5.3.12: 32 bits at a time,
// 2.7 … 3.6 V). While it is at it the core stops at its next fetch from the flash: no tick, no frame. So this is for a
// robot whose motors are off. The watchdog gets more time for an erase, and its own back afterwards.
#ifndef OMNIBOT_STM32F405_FLASH_H
#define OMNIBOT_STM32F405_FLASH_H

#include "registers.h"
#include "settings.h"

/// Of a sector only the beginning is used: it holds 32 sets, so 640000 saves in the flash's 10000 erases. More would
/// make the look through both pages at the start too long for the watchdog, at 16 MHz: it is 200000 cycles, estimated.
enum { FLASH_PAGE_BYTES = 8192 };

typedef struct {
    flash_registers_t *registers;
    iwdg_registers_t *watchdog;
    const pwr_registers_t *power;
    flash_sector_t *sector; // SETTINGS_PAGES of them
    uint32_t first_sector;  // its number
} flash_t;

/// False where no flash interface answers, as in an emulator: nothing can be kept there.
bool flash_answers(flash_registers_t *registers);

/// The memory for app/settings.h; points to `flash`.
settings_memory_t flash_memory(flash_t *flash);

#endif
