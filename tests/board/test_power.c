// SPDX-License-Identifier: MIT
// Battery, 3.3 V and reset cause. Register bits are those of RM0090, chapters 5, 7 and 13.
#include "adc.h"
#include "power.h"
#include "supply.h"

#include "messages.h"
#include "model.h"
#include "unity.h"

#include <math.h>
#include <string.h>

enum { EOC = 1 << 1, SWSTART = 1 << 30, ADON = 1 };

void setUp(void)
{
    model_reset();
}

void tearDown(void)
{
    static const char *const own[] = {"adc1", "adc_common", "pwr", "rcc", NULL};
    model_assert_wrote_only(own);
}

// ---- converter

static adc_t start_adc(uint8_t channel)
{
    adc_t adc;
    const adc_wiring_t wiring = {.channel = channel, .volt_per_bit = 0.01f};
    adc_start(&adc, &adc1, &adc_common, &wiring);
    return adc;
}

static void convert(adc_t *adc, uint32_t bits)
{
    model_set(&adc1.sr, EOC);
    model_set(&adc1.dr, bits);
    adc_tick(adc);
}

static void test_one_channel_is_converted_at_its_longest_sampling(void)
{
    start_adc(10);
    TEST_ASSERT_EQUAL_UINT32(10, model_get(&adc1.sqr3));
    TEST_ASSERT_EQUAL_UINT32(0, model_get(&adc1.sqr1));
    TEST_ASSERT_EQUAL_HEX32(7, model_get(&adc1.smpr1)); // channel 10 is the first of that register
    TEST_ASSERT_EQUAL_HEX32(ADON, model_get(&adc1.cr2));
    TEST_ASSERT_EQUAL_HEX32(1u << 16, model_get(&adc_common.ccr)); // 84 MHz / 4 is below 36 MHz
    model_reset();
    start_adc(9);
    TEST_ASSERT_EQUAL_HEX32(7u << 27, model_get(&adc1.smpr2));
    TEST_ASSERT_EQUAL_HEX32(0, model_get(&adc1.smpr1));
}

static void test_voltage_is_unknown_until_a_conversion_has_ended(void)
{
    adc_t adc = start_adc(10);
    adc_tick(&adc);
    TEST_ASSERT_TRUE(isnan(adc.battery_V));
    TEST_ASSERT_EQUAL_UINT32(0, model_reads_of(&adc1.dr));
    convert(&adc, 1200);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, 12.0f, adc.battery_V);
}

static void test_each_period_starts_one_conversion_and_waits_for_none(void)
{
    adc_t adc = start_adc(10);
    model_forget();
    for (int i = 0; i < 5; i++) {
        adc_tick(&adc);
    }
    TEST_ASSERT_EQUAL_UINT32(5, model_writes());
    TEST_ASSERT_EQUAL_UINT32(5, model_reads_of(&adc1.sr));
    TEST_ASSERT_EQUAL_HEX32(SWSTART | ADON, model_written(&adc1.cr2, 4));
}

static void test_voltage_follows_smoothly(void)
{
    adc_t adc = start_adc(10);
    convert(&adc, 1200);
    convert(&adc, 1120);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-3f, 11.9f, adc.battery_V); // an eighth of the way
    for (int i = 0; i < 100; i++) {
        convert(&adc, 1120);
    }
    TEST_ASSERT_FLOAT_WITHIN(1.0e-3f, 11.2f, adc.battery_V);
}

static void test_bits_above_the_twelve_are_not_looked_at(void)
{
    adc_t adc = start_adc(10);
    convert(&adc, 0xFFFFF001);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, 0.01f, adc.battery_V);
}

// ---- supply

static void periods(supply_t *supply, uint32_t count, float voltage_V)
{
    for (uint32_t i = 0; i < count; i++) {
        supply_tick(supply, voltage_V);
    }
}

static void test_supply_is_low_until_it_has_been_well_for_a_while(void)
{
    supply_t supply;
    supply_init(&supply, 9.0f);
    TEST_ASSERT_TRUE(supply.low);
    periods(&supply, SUPPLY_LOW_PERIODS - 1, 12.0f);
    TEST_ASSERT_TRUE(supply.low);
    periods(&supply, 1, 12.0f);
    TEST_ASSERT_FALSE(supply.low);
}

static void test_a_dip_is_borne_and_a_drop_is_not(void)
{
    supply_t supply;
    supply_init(&supply, 9.0f);
    periods(&supply, 100, 12.0f);
    for (int i = 0; i < 5; i++) {
        periods(&supply, SUPPLY_LOW_PERIODS - 1, 8.9f);
        periods(&supply, 1, 9.1f);
    }
    TEST_ASSERT_FALSE(supply.low);
    periods(&supply, SUPPLY_LOW_PERIODS, 8.9f);
    TEST_ASSERT_TRUE(supply.low);
}

static void test_low_supply_is_well_again_half_a_volt_higher(void)
{
    supply_t supply;
    supply_init(&supply, 9.0f);
    periods(&supply, 1000, 9.4f);
    TEST_ASSERT_TRUE(supply.low);
    periods(&supply, SUPPLY_LOW_PERIODS, 9.6f);
    TEST_ASSERT_FALSE(supply.low);
    periods(&supply, 1000, 9.4f);
    TEST_ASSERT_FALSE(supply.low);
}

static void test_unknown_voltage_is_low(void)
{
    supply_t supply;
    supply_init(&supply, 9.0f);
    periods(&supply, 100, 12.0f);
    periods(&supply, SUPPLY_LOW_PERIODS, NAN);
    TEST_ASSERT_TRUE(supply.low);
}

// ---- 3.3 V

static void test_detector_is_set_to_2V9_and_nothing_else_is_changed(void)
{
    model_set(&pwr.cr, 1u << 14); // the regulator's scale
    power_start(&pwr);
    TEST_ASSERT_EQUAL_HEX32(1u << 14 | 7u << 5 | 1u << 4, model_get(&pwr.cr));
    TEST_ASSERT_FALSE(power_is_low(&pwr));
    model_set(&pwr.csr, 1u << 2);
    TEST_ASSERT_TRUE(power_is_low(&pwr));
}

// ---- reset

/// What the chip sets: a power-on the brown-out's flag too, and every cause the pin's.
static void test_cause_of_each_reset_is_told_and_cleared(void)
{
    enum { BOR = 1 << 25, PIN = 1 << 26, POR = 1 << 27, SOFT = 1 << 28, IWDG = 1 << 29, WWDG = 1 << 30 };
    static const struct {
        uint32_t flags;
        uint8_t cause;
    } cases[] = {
        {PIN | POR | BOR, RESET_CAUSE_POWER},
        {PIN | BOR, RESET_CAUSE_BROWN_OUT},
        {PIN, RESET_CAUSE_PIN},
        {PIN | SOFT, RESET_CAUSE_SOFTWARE},
        {PIN | IWDG, RESET_CAUSE_WATCHDOG},
        {PIN | WWDG, RESET_CAUSE_WATCHDOG},
        {PIN | IWDG | SOFT, RESET_CAUSE_WATCHDOG},
        {0, RESET_CAUSE_UNKNOWN},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        model_set(&rcc.csr, cases[i].flags | 3u); // the 32 kHz run
        TEST_ASSERT_EQUAL_UINT8(cases[i].cause, power_reset_cause(&rcc));
        TEST_ASSERT_BITS_HIGH(1u << 24 | 1u, model_get(&rcc.csr)); // RMVF, and the 32 kHz go on
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_one_channel_is_converted_at_its_longest_sampling);
    RUN_TEST(test_voltage_is_unknown_until_a_conversion_has_ended);
    RUN_TEST(test_each_period_starts_one_conversion_and_waits_for_none);
    RUN_TEST(test_voltage_follows_smoothly);
    RUN_TEST(test_bits_above_the_twelve_are_not_looked_at);
    RUN_TEST(test_supply_is_low_until_it_has_been_well_for_a_while);
    RUN_TEST(test_a_dip_is_borne_and_a_drop_is_not);
    RUN_TEST(test_low_supply_is_well_again_half_a_volt_higher);
    RUN_TEST(test_unknown_voltage_is_low);
    RUN_TEST(test_detector_is_set_to_2V9_and_nothing_else_is_changed);
    RUN_TEST(test_cause_of_each_reset_is_told_and_cleared);
    return UNITY_END();
}
