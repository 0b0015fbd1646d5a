// SPDX-License-Identifier: MIT
// The clock tree (RM0090 7.2): the crystal through the PLL to 168 MHz; without a crystal the internal oscillator
// through the PLL to the same 168 MHz, too inexact for CAN; without a PLL the internal oscillator alone, 16 MHz.
#ifndef OMNIBOT_STM32F405_CLOCK_H
#define OMNIBOT_STM32F405_CLOCK_H

#include "registers.h"

typedef enum {
    CLOCK_CRYSTAL,   // 168 MHz
    CLOCK_HSI_PLL,   // 168 MHz, 1 % at best
    CLOCK_HSI,       // 16 MHz
    CLOCK_NOT_THERE, // RCC does not answer: an emulator; taken for 168 MHz, which the one of QEMU has
    CLOCK_SOURCE_COUNT
} clock_source_t;

typedef struct {
    clock_source_t source;
    uint32_t core_Hz;
    uint32_t apb1_Hz;
    uint32_t apb2_Hz;
    uint32_t timer_Hz; // of the timers on APB2: twice the bus clock where that is divided (RM0090 7.2, figure 21)
} clock_tree_t;

/// Sets up the tree out of reset, from a crystal of crystal_MHz, 4 … 26; every wait is bounded.
clock_tree_t clock_start(rcc_registers_t *clocks, flash_registers_t *flash, uint32_t crystal_MHz);

#endif
