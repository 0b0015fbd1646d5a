// SPDX-License-Identifier: MIT
// The clock tree against an RCC whose crystal, PLL, flash or switch may be dead. Values are those of RM0090, chapter 7.
#include "clock.h"

#include "messages.h"
#include "model.h"
#include "unity.h"

enum { CRYSTAL = 1, PLL = 2, FLASH = 4, SWITCH = 8, ALL = 15 };
static uint32_t alive;

/// Answers at once, as far as it is alive: ready bits follow enable bits, the switch's status follows the switch.
static uint32_t hardware(reg_t *reg, uint32_t value)
{
    if (reg == &rcc.cr) {
        const uint32_t ready = ((alive & CRYSTAL) != 0 ? (value & (1u << 16)) << 1 : 0) |
                               ((alive & PLL) != 0 ? (value & (1u << 24)) << 1 : 0);
        return (value & ~((1u << 17) | (1u << 25))) | ready | 2u;
    }
    if (reg == &rcc.cfgr && (alive & SWITCH) != 0) {
        return (value & ~(3u << 2)) | (value & 3u) << 2;
    }
    if (reg == &flash_interface.acr && (alive & FLASH) == 0) {
        return 0;
    }
    return value;
}

void setUp(void)
{
    model_reset();
    model_on_write(hardware);
    model_set(&rcc.cr, 0x83); // out of reset: the internal oscillator is on and ready
    alive = ALL;
}

void tearDown(void)
{
    static const char *const own[] = {"rcc", "flash_interface", NULL};
    model_assert_wrote_only(own);
}

static uint32_t stuck_on_pll(reg_t *reg, uint32_t value)
{
    return reg == &rcc.cfgr ? (value & ~(3u << 2)) | 2u << 2 : value;
}

static clock_tree_t start(void)
{
    return clock_start(&rcc, &flash_interface, 8);
}

static void assert_tree(clock_tree_t tree, uint8_t source, uint32_t core_MHz, uint32_t apb1_MHz, uint32_t apb2_MHz)
{
    TEST_ASSERT_EQUAL_UINT8(source, tree.source);
    TEST_ASSERT_EQUAL_UINT32(core_MHz * 1000000u, tree.core_Hz);
    TEST_ASSERT_EQUAL_UINT32(apb1_MHz * 1000000u, tree.apb1_Hz);
    TEST_ASSERT_EQUAL_UINT32(apb2_MHz * 1000000u, tree.apb2_Hz);
    TEST_ASSERT_EQUAL_UINT32(core_MHz * 1000000u, tree.timer_Hz);
}

static void assert_never_switched(void)
{
    for (uint32_t n = 0; n < model_writes_to(&rcc.cfgr); n++) {
        TEST_ASSERT_EQUAL_HEX32(0, model_written(&rcc.cfgr, n) & 3u);
    }
}

// ---- everything works

static void test_crystal_gives_168_MHz(void)
{
    assert_tree(start(), CLOCK_SOURCE_HSE_PLL, 168, 42, 84);
    TEST_ASSERT_EQUAL_HEX32(0x07405408, model_get(&rcc.pllcfgr)); // 8 MHz / 8 * 336 / 2, / 7 for USB
    TEST_ASSERT_EQUAL_HEX32(2u, model_get(&rcc.cfgr) & 3u);
    TEST_ASSERT_EQUAL_HEX32(5u << 10 | 4u << 13, model_get(&rcc.cfgr) & (7u << 10 | 7u << 13 | 15u << 4));
    TEST_ASSERT_EQUAL_HEX32(0x705, model_get(&flash_interface.acr)); // 5 wait states, prefetch, both caches
}

static void test_other_crystal_gives_the_same_core_clock(void)
{
    const clock_tree_t tree = clock_start(&rcc, &flash_interface, 25);
    assert_tree(tree, CLOCK_SOURCE_HSE_PLL, 168, 42, 84);
    TEST_ASSERT_EQUAL_HEX32(0x07405400 | 25, model_get(&rcc.pllcfgr));
}

static void test_flash_and_buses_are_slowed_before_the_core_is_fast(void)
{
    start();
    const uint32_t switched = model_first_write(&rcc.cfgr, 2u);
    TEST_ASSERT_LESS_THAN_UINT32(switched, model_first_write(&flash_interface.acr, 5u));
    TEST_ASSERT_LESS_THAN_UINT32(switched, model_first_write(&rcc.cfgr, 5u << 10 | 4u << 13));
    TEST_ASSERT_EQUAL_HEX32(5u << 10 | 4u << 13, model_written(&rcc.cfgr, 1)); // not with it
}

static void test_pll_is_set_before_it_is_started(void)
{
    start();
    TEST_ASSERT_LESS_THAN_UINT32(model_first_write(&rcc.cr, 1u << 24), model_first_write(&rcc.pllcfgr, 8u));
}

static void test_security_system_watches_the_crystal_only(void)
{
    start();
    TEST_ASSERT_BITS_HIGH(1u << 19, model_get(&rcc.cr));
    setUp();
    alive = ALL & ~CRYSTAL;
    start();
    TEST_ASSERT_BITS_LOW(1u << 19, model_get(&rcc.cr));
}

static void test_pll_that_runs_already_is_left_and_set_anew(void)
{
    model_set(&rcc.cr, 0x83 | 1u << 24 | 1u << 25 | 1u << 19);
    model_set(&rcc.cfgr, 2u | 2u << 2);
    model_set(&rcc.pllcfgr, 0x24003010);
    assert_tree(start(), CLOCK_SOURCE_HSE_PLL, 168, 42, 84);
    TEST_ASSERT_EQUAL_HEX32(0x07405408, model_get(&rcc.pllcfgr));
    TEST_ASSERT_EQUAL_HEX32(0, model_written(&rcc.cfgr, 0) & 3u);                  // off it,
    TEST_ASSERT_EQUAL_HEX32(0, model_written(&rcc.cr, 0) & (1u << 24 | 1u << 19)); // and off with it,
    const uint32_t set = model_first_write(&rcc.pllcfgr, 0x07405408);
    TEST_ASSERT_GREATER_THAN_UINT32(1, set); // before it is set
    TEST_ASSERT_LESS_THAN_UINT32(model_first_write(&rcc.cr, 1u << 24), set);
}

static void test_pll_that_cannot_be_left_is_not_set(void)
{
    alive = ALL & ~SWITCH;
    model_set(&rcc.cr, 0x83 | 1u << 24 | 1u << 25);
    model_set(&rcc.cfgr, 2u | 2u << 2);
    model_on_read(stuck_on_pll);
    TEST_ASSERT_EQUAL_UINT8(CLOCK_SOURCE_HSI, start().source);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&rcc.pllcfgr));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&rcc.cr)); // what the core runs from is not stopped
}

// ---- something is dead

static void test_dead_crystal_falls_back_to_the_internal_oscillator(void)
{
    alive = ALL & ~CRYSTAL;
    assert_tree(start(), CLOCK_SOURCE_HSI_PLL, 168, 42, 84);
    TEST_ASSERT_EQUAL_HEX32(0x07005410, model_get(&rcc.pllcfgr)); // 16 MHz / 16, from the internal one
    TEST_ASSERT_BITS_LOW(1u << 16, model_get(&rcc.cr));           // and it is switched off again
}

static void test_dead_pll_leaves_16_MHz(void)
{
    alive = ALL & ~PLL;
    assert_tree(start(), CLOCK_SOURCE_HSI, 16, 16, 16);
    TEST_ASSERT_BITS_LOW(1u << 24, model_get(&rcc.cr));
    assert_never_switched();
}

static void test_dead_crystal_and_pll_leave_16_MHz(void)
{
    alive = ALL & ~(CRYSTAL | PLL);
    assert_tree(start(), CLOCK_SOURCE_HSI, 16, 16, 16);
}

static void test_flash_that_takes_no_wait_states_is_not_outrun(void)
{
    alive = ALL & ~FLASH;
    assert_tree(start(), CLOCK_SOURCE_HSI, 16, 16, 16);
    assert_never_switched();
}

static void test_switch_that_does_not_move_is_taken_back(void)
{
    alive = ALL & ~SWITCH;
    assert_tree(start(), CLOCK_SOURCE_HSI, 16, 16, 16);
    TEST_ASSERT_EQUAL_HEX32(0, model_get(&rcc.cfgr) & (3u | 7u << 10 | 7u << 13)); // buses as fast as the core again
}

static void test_rcc_that_does_not_answer_is_left_alone(void)
{
    model_set(&rcc.cr, 0);
    assert_tree(start(), CLOCK_SOURCE_UNKNOWN, 168, 42, 84);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes());
}

/// 20 ms of crystal at 16 MHz and four cycles a poll are 80000 polls.
static void test_wait_for_the_crystal_ends(void)
{
    alive = ALL & ~CRYSTAL;
    start();
    TEST_ASSERT_UINT32_WITHIN(100, 80000, model_reads_of(&rcc.cr));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_crystal_gives_168_MHz);
    RUN_TEST(test_other_crystal_gives_the_same_core_clock);
    RUN_TEST(test_flash_and_buses_are_slowed_before_the_core_is_fast);
    RUN_TEST(test_pll_is_set_before_it_is_started);
    RUN_TEST(test_security_system_watches_the_crystal_only);
    RUN_TEST(test_pll_that_runs_already_is_left_and_set_anew);
    RUN_TEST(test_pll_that_cannot_be_left_is_not_set);
    RUN_TEST(test_dead_crystal_falls_back_to_the_internal_oscillator);
    RUN_TEST(test_dead_pll_leaves_16_MHz);
    RUN_TEST(test_dead_crystal_and_pll_leave_16_MHz);
    RUN_TEST(test_flash_that_takes_no_wait_states_is_not_outrun);
    RUN_TEST(test_switch_that_does_not_move_is_taken_back);
    RUN_TEST(test_rcc_that_does_not_answer_is_left_alone);
    RUN_TEST(test_wait_for_the_crystal_ends);
    return UNITY_END();
}
