// SPDX-License-Identifier: MIT
// A sensor reading off the bus: it waits until the SYNC of its tick vouches for it, and then grows old.
#ifndef OMNIBOT_APP_READING_H
#define OMNIBOT_APP_READING_H

#include "counter.h"
#include "vec3.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    vec3_t value;
    uint32_t age_ticks;
    bool fresh;           // taken since the last tick
    bool waits;           // a frame has come that no SYNC has vouched for yet
    uint8_t counter, crc; // of that frame: low bits of its tick, CRC-8 of all of it
    vec3_t waiting;
} reading_t;

typedef enum { READING_NONE, READING_TAKEN, READING_OF_ANOTHER_TICK, READING_DAMAGED } reading_verdict_t;

/// Of unknown age, and nothing waits.
static inline void reading_forget(reading_t *reading)
{
    *reading = (reading_t){.age_ticks = UINT32_MAX};
}

/// A frame has come. Returns false when one that waited is lost by it.
static inline bool reading_arrive(reading_t *reading, vec3_t value, uint8_t counter, uint8_t crc)
{
    const bool alone = !reading->waits;
    reading->waits = true;
    reading->waiting = value;
    reading->counter = counter;
    reading->crc = crc;
    return alone;
}

/// A value that needs nobody to vouch for it. One that is not available (NaN) is none: the reading grows older as if
/// nothing had come.
static inline void reading_take(reading_t *reading, vec3_t value)
{
    if (isfinite(vec3_sum(value))) {
        reading->value = value;
        reading->fresh = true;
    }
}

/// The SYNC of a tick: takes what waits if it is of that tick and whole.
static inline reading_verdict_t reading_confirm(reading_t *reading, uint8_t counter, uint8_t crc)
{
    if (!reading->waits) {
        return READING_NONE;
    }
    reading->waits = false;
    if (reading->counter != counter) {
        return READING_OF_ANOTHER_TICK;
    }
    if (reading->crc != crc) {
        return READING_DAMAGED;
    }
    reading_take(reading, reading->waiting);
    return READING_TAKEN;
}

/// So many ticks have passed.
static inline void reading_age(reading_t *reading, uint32_t ticks)
{
    reading->age_ticks = reading->fresh ? 0 : counter_sum(reading->age_ticks, ticks);
    reading->fresh = false;
}

#endif
