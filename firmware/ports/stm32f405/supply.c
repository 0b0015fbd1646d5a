// SPDX-License-Identifier: MIT
#include "supply.h"

void supply_init(supply_t *supply, float minimum_V)
{
    *supply = (supply_t){.minimum_V = minimum_V, .low = true};
}

void supply_tick(supply_t *supply, float voltage_V)
{
    const float threshold_V = supply->low ? supply->minimum_V + SUPPLY_RISE_V : supply->minimum_V;
    const bool low = !(voltage_V >= threshold_V); // not a number is low
    supply->periods = low != supply->low ? supply->periods + 1u : 0;
    if (supply->periods == SUPPLY_LOW_PERIODS) {
        supply->low = low;
        supply->periods = 0;
    }
}
