// SPDX-License-Identifier: MIT
#include "mode.h"

#include "messages.h"

#include <assert.h>

enum { MODE_COUNT = 4 };
static_assert(MODE_FAULT == MODE_COUNT - 1, "a row of the table for each mode of the DBC");

static const uint8_t next_mode[MODE_COUNT][EVENT_COUNT] = {
    [MODE_BOOT] = {[EVENT_READY] = MODE_IDLE,
                   [EVENT_START] = MODE_BOOT,
                   [EVENT_STOP] = MODE_BOOT,
                   [EVENT_CLEAR] = MODE_BOOT,
                   [EVENT_RESTART] = MODE_BOOT,
                   [EVENT_FAULT] = MODE_FAULT},
    [MODE_IDLE] = {[EVENT_READY] = MODE_IDLE,
                   [EVENT_START] = MODE_TRACKING,
                   [EVENT_STOP] = MODE_IDLE,
                   [EVENT_CLEAR] = MODE_IDLE,
                   [EVENT_RESTART] = MODE_IDLE,
                   [EVENT_FAULT] = MODE_FAULT},
    [MODE_TRACKING] = {[EVENT_READY] = MODE_TRACKING,
                       [EVENT_START] = MODE_TRACKING,
                       [EVENT_STOP] = MODE_IDLE,
                       [EVENT_CLEAR] = MODE_TRACKING,
                       [EVENT_RESTART] = MODE_IDLE,
                       [EVENT_FAULT] = MODE_FAULT},
    [MODE_FAULT] = {[EVENT_READY] = MODE_FAULT,
                    [EVENT_START] = MODE_FAULT,
                    [EVENT_STOP] = MODE_FAULT,
                    [EVENT_CLEAR] = MODE_IDLE,
                    [EVENT_RESTART] = MODE_FAULT,
                    [EVENT_FAULT] = MODE_FAULT},
};

uint8_t mode_after(uint8_t mode, event_t event)
{
    return next_mode[mode][event];
}

bool mode_drives(uint8_t mode)
{
    return mode == MODE_TRACKING;
}
