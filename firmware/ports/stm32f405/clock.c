// SPDX-License-Identifier: MIT
#include "clock.h"

#include "messages.h"

// Waits, at the 16 MHz that the core runs from out of reset. The data sheet gives a crystal 2 ms (5.3.8) and the PLL
// 0.3 ms at most (5.3.11); a switch takes a few cycles.
#define CRYSTAL_POLLS WAIT_POLLS(20000, 16)
#define PLL_POLLS WAIT_POLLS(2000, 16)
#define SWITCH_POLLS WAIT_POLLS(100, 168)

enum { HSI_MHz = 16, PLL_INPUT_MHz = 1, PLL_N = 336, PLL_P = 2, PLL_Q = 7, CORE_MHz = 168, FLASH_WAIT_STATES = 5 };

// RM0090 7.3.2: input 1 … 2 MHz, VCO 100 … 432 MHz, 48 MHz for USB. Wait states: 3.5.1, table 10, at 2.7 … 3.6 V.
static_assert(PLL_INPUT_MHz * PLL_N >= 100 && PLL_INPUT_MHz * PLL_N <= 432, "VCO");
static_assert(PLL_INPUT_MHz * PLL_N / PLL_P == CORE_MHz, "core clock");
static_assert(PLL_INPUT_MHz * PLL_N / PLL_Q == 48, "USB clock");
static_assert(CORE_MHz / (FLASH_WAIT_STATES + 1) <= 30, "flash");

/// A boot loader may hand the chip over with its PLL on, and that can only be set while it is off (RM0090 7.3.2).
static bool leave_pll(rcc_registers_t *clocks)
{
    reg_change(&clocks->cfgr, RCC_CFGR_SW_MASK, RCC_CFGR_SW_HSI);
    if (!wait_until(&clocks->cfgr, RCC_CFGR_SWS_MASK, RCC_CFGR_SWS_HSI, SWITCH_POLLS)) {
        return false;
    }
    reg_clear(&clocks->cr, RCC_CR_CSSON | RCC_CR_PLLON);
    return wait_until(&clocks->cr, RCC_CR_PLLRDY, 0, PLL_POLLS);
}

static bool start_crystal(rcc_registers_t *clocks)
{
    reg_set(&clocks->cr, RCC_CR_HSEON);
    if (wait_until(&clocks->cr, RCC_CR_HSERDY, RCC_CR_HSERDY, CRYSTAL_POLLS)) {
        return true;
    }
    reg_clear(&clocks->cr, RCC_CR_HSEON);
    return false;
}

static bool start_pll(rcc_registers_t *clocks, uint32_t input_MHz, uint32_t source)
{
    reg_write(&clocks->pllcfgr, RCC_PLLCFGR_M(input_MHz / PLL_INPUT_MHz) | RCC_PLLCFGR_N(PLL_N) | RCC_PLLCFGR_P(PLL_P) |
                                    RCC_PLLCFGR_Q(PLL_Q) | source);
    reg_set(&clocks->cr, RCC_CR_PLLON);
    if (wait_until(&clocks->cr, RCC_CR_PLLRDY, RCC_CR_PLLRDY, PLL_POLLS)) {
        return true;
    }
    reg_clear(&clocks->cr, RCC_CR_PLLON);
    return false;
}

/// Flash and buses are made slow enough before the core gets fast.
static bool switch_to_pll(rcc_registers_t *clocks, flash_registers_t *flash)
{
    reg_change(&flash->acr, FLASH_ACR_LATENCY_MASK,
               FLASH_WAIT_STATES | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN);
    if (!wait_until(&flash->acr, FLASH_ACR_LATENCY_MASK, FLASH_WAIT_STATES, SWITCH_POLLS)) {
        return false; // RM0090 3.5.1: to be read back before the clock is raised
    }
    reg_change(&clocks->cfgr, RCC_CFGR_HPRE_MASK | RCC_CFGR_PPRE1_MASK | RCC_CFGR_PPRE2_MASK,
               RCC_CFGR_PPRE1_BY_4 | RCC_CFGR_PPRE2_BY_2);
    reg_change(&clocks->cfgr, RCC_CFGR_SW_MASK, RCC_CFGR_SW_PLL);
    if (wait_until(&clocks->cfgr, RCC_CFGR_SWS_MASK, RCC_CFGR_SWS_PLL, SWITCH_POLLS)) {
        return true;
    }
    reg_change(&clocks->cfgr, RCC_CFGR_SW_MASK | RCC_CFGR_PPRE1_MASK | RCC_CFGR_PPRE2_MASK, RCC_CFGR_SW_HSI);
    return false;
}

static clock_tree_t tree_of(uint8_t source)
{
    const uint32_t core_Hz = source == CLOCK_SOURCE_HSI ? HSI_MHz * 1000000u : CORE_MHz * 1000000u;
    const bool divided = source != CLOCK_SOURCE_HSI;
    return (clock_tree_t){
        .source = source,
        .core_Hz = core_Hz,
        .apb1_Hz = divided ? core_Hz / 4u : core_Hz,
        .apb2_Hz = divided ? core_Hz / 2u : core_Hz,
        .timer_Hz = core_Hz,
    };
}

clock_tree_t clock_start(rcc_registers_t *clocks, flash_registers_t *flash, uint32_t crystal_MHz)
{
    if ((reg_read(&clocks->cr) & RCC_CR_HSIRDY) == 0) {
        return tree_of(CLOCK_SOURCE_UNKNOWN); // we are running from it
    }
    if (!leave_pll(clocks)) {
        return tree_of(CLOCK_SOURCE_HSI);
    }
    const bool crystal = start_crystal(clocks);
    if (!start_pll(clocks, crystal ? crystal_MHz : HSI_MHz, crystal ? RCC_PLLCFGR_SRC_HSE : 0) ||
        !switch_to_pll(clocks, flash)) {
        return tree_of(CLOCK_SOURCE_HSI);
    }
    if (!crystal) {
        return tree_of(CLOCK_SOURCE_HSI_PLL);
    }
    reg_set(&clocks->cr, RCC_CR_CSSON); // a crystal that stops is an NMI
    return tree_of(CLOCK_SOURCE_HSE_PLL);
}
