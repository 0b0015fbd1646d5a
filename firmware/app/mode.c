// SPDX-License-Identifier: MIT
#include "mode.h"

#include "messages.h"

#include <assert.h>

enum { MODE_COUNT = 6 };
static_assert(MODE_FAULT == MODE_COUNT - 1, "a row of the table for each mode of the DBC");

/// Events that a row leaves out change nothing in its mode: they are its number plus one, so that zero says so.
#define TO(mode) ((uint8_t)((mode) + 1))

static const uint8_t next_mode[MODE_COUNT][EVENT_COUNT] = {
    [MODE_BOOT] = {[EVENT_READY] = TO(MODE_IDLE), [EVENT_BRAKE] = TO(MODE_FAULT), [EVENT_CUT] = TO(MODE_FAULT)},
    [MODE_IDLE] = {[EVENT_ARM] = TO(MODE_ARMED), [EVENT_BRAKE] = TO(MODE_FAULT), [EVENT_CUT] = TO(MODE_FAULT)},
    [MODE_ARMED] = {[EVENT_START] = TO(MODE_TRACKING),
                    [EVENT_LAPSE] = TO(MODE_IDLE),
                    [EVENT_STOP] = TO(MODE_IDLE),
                    [EVENT_RESTART] = TO(MODE_IDLE),
                    [EVENT_BRAKE] = TO(MODE_FAULT),
                    [EVENT_CUT] = TO(MODE_FAULT)},
    [MODE_TRACKING] = {[EVENT_STOP] = TO(MODE_STOPPING),
                       [EVENT_RESTART] = TO(MODE_IDLE),
                       [EVENT_BRAKE] = TO(MODE_STOPPING),
                       [EVENT_CUT] = TO(MODE_FAULT)},
    [MODE_STOPPING] = {[EVENT_REST] = TO(MODE_IDLE),
                       [EVENT_REST_WITH_FAULT] = TO(MODE_FAULT),
                       [EVENT_RESTART] = TO(MODE_IDLE),
                       [EVENT_CUT] = TO(MODE_FAULT)},
    [MODE_FAULT] = {[EVENT_CLEAR] = TO(MODE_IDLE)},
};

uint8_t mode_after(uint8_t mode, event_t event)
{
    const uint8_t next = next_mode[mode][event];
    return next == 0 ? mode : (uint8_t)(next - 1);
}

bool mode_drives(uint8_t mode)
{
    return mode == MODE_TRACKING || mode == MODE_STOPPING;
}

bool mode_is_safe(uint8_t mode)
{
    return mode == MODE_BOOT || mode == MODE_IDLE || mode == MODE_FAULT;
}
