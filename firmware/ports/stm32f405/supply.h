// SPDX-License-Identifier: MIT
// Whether the battery can drive the motors. Pure: low after SUPPLY_LOW_PERIODS in a row below the minimum, well again
// as long above it by SUPPLY_RISE_V. A voltage that is not known is low.
#ifndef OMNIBOT_STM32F405_SUPPLY_H
#define OMNIBOT_STM32F405_SUPPLY_H

#include <stdbool.h>
#include <stdint.h>

enum { SUPPLY_LOW_PERIODS = 20 };
#define SUPPLY_RISE_V 0.5f

typedef struct {
    float minimum_V;
    bool low;
    uint32_t periods; // in a row that say otherwise
} supply_t;

/// Low until it has been seen to be well.
void supply_init(supply_t *supply, float minimum_V);

/// A period with a voltage has passed.
void supply_tick(supply_t *supply, float voltage_V);

#endif
