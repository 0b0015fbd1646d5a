// SPDX-License-Identifier: MIT
// Counters that stop at their largest value instead of starting over.
#ifndef OMNIBOT_APP_COUNTER_H
#define OMNIBOT_APP_COUNTER_H

#include <stdint.h>

static inline uint32_t counter_sum(uint32_t a, uint32_t b)
{
    return b < UINT32_MAX - a ? a + b : UINT32_MAX;
}

static inline void counter_add(uint16_t *counter, uint32_t more)
{
    const uint32_t sum = counter_sum(*counter, more);
    *counter = sum < UINT16_MAX ? (uint16_t)sum : UINT16_MAX;
}

#endif
