// SPDX-License-Identifier: MIT
// The clock tree (RM0090 7.2): the crystal through the PLL to 168 MHz; without a crystal the internal oscillator
// through the PLL to the same 168 MHz, too inexact for CAN; without a PLL the internal oscillator alone, 16 MHz.
#ifndef OMNIBOT_STM32F405_CLOCK_H
#define OMNIBOT_STM32F405_CLOCK_H

#include "registers.h"

typedef struct {
    uint8_t source; // CLOCK_SOURCE_… of the wire
    uint32_t core_Hz;
    uint32_t apb1_Hz;
    uint32_t apb2_Hz;
    uint32_t timer_Hz; // of the timers on APB2: twice the bus clock where that is divided (RM0090 7.2, figure 21)
} clock_tree_t;

/// Sets up the tree out of reset, from a crystal of crystal_MHz, 4 … 26; every wait is bounded. CLOCK_SOURCE_UNKNOWN is
/// an RCC that does not answer, as in QEMU; 168 MHz are taken for granted then.
clock_tree_t clock_start(rcc_registers_t *clocks, flash_registers_t *flash, uint32_t crystal_MHz);

#endif
