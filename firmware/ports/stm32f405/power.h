// SPDX-License-Identifier: MIT
// The board's 3.3 V and why it was reset (RM0090 5.2, 7.3.21).
//
// Below its brown-out level the chip holds itself in reset. The level is an option byte, off as the chip is sold and
// not changed here; the voltage detector tells at 2.9 V already, and the bridges go off.
#ifndef OMNIBOT_STM32F405_POWER_H
#define OMNIBOT_STM32F405_POWER_H

#include "registers.h"

/// The cause of the last reset, a RESET_CAUSE_… of the wire: the most telling of the flags, which are cleared for the
/// next time.
uint8_t power_reset_cause(rcc_registers_t *clocks);

/// Watches for 2.9 V.
void power_start(pwr_registers_t *power);

bool power_is_low(const pwr_registers_t *power);

#endif
