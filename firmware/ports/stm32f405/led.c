// SPDX-License-Identifier: MIT
#include "led.h"

#include "messages.h"

enum { SECOND_ms = 1000, FLASH_ms = 50, SECOND_FLASH_ms = 200, SLOW_FLASH_ms = 200, PAUSE_ms = 1000 };

static bool flashes_when_idle(bool on_crystal, uint32_t time_ms)
{
    const uint32_t phase = time_ms % SECOND_ms;
    const bool second = phase >= SECOND_FLASH_ms && phase < SECOND_FLASH_ms + FLASH_ms;
    return phase < FLASH_ms || (!on_crystal && second);
}

static bool counts(uint32_t number, uint32_t time_ms)
{
    const uint32_t flashes_ms = 2u * SLOW_FLASH_ms * number;
    const uint32_t phase = time_ms % (flashes_ms + PAUSE_ms);
    return phase < flashes_ms && phase % (2u * SLOW_FLASH_ms) < SLOW_FLASH_ms;
}

bool led_is_on(uint8_t mode, uint8_t fault, bool on_crystal, uint32_t time_ms)
{
    switch (mode) {
    case MODE_IDLE:
        return flashes_when_idle(on_crystal, time_ms);
    case MODE_TRACKING:
        return true;
    case MODE_FAULT:
        return counts(fault, time_ms);
    default:
        return false;
    }
}
