// SPDX-License-Identifier: MIT
// Watchdog, crash record, cycle counter, LED: what tells of a robot that is not well.
#include "cycles.h"
#include "fault.h"
#include "led.h"
#include "watchdog.h"

#include "messages.h"
#include "model.h"
#include "unity.h"

#include <string.h>

static bool settles; // the watchdog takes its settings over
static bool counts;  // the cycle counter counts

static uint32_t on_read(reg_t *reg, uint32_t value)
{
    if (reg == &iwdg.sr && !settles) {
        return 3;
    }
    if (reg == &dwt.cyccnt && counts) {
        model_set(reg, value + 7);
    }
    return value;
}

void setUp(void)
{
    model_reset();
    model_on_read(on_read);
    settles = true;
    counts = true;
}

void tearDown(void)
{
    static const char *const own[] = {"iwdg", "scb", "dwt", NULL};
    model_assert_wrote_only(own);
}

// ---- watchdog

/// RM0090 21.3: started by 0xCCCC, unlocked by 0x5555, fed by 0xAAAA. 50 ms are 400 of the 32 kHz divided by four.
static void test_watchdog_runs_before_it_is_set_and_resets_after_50_ms(void)
{
    TEST_ASSERT_TRUE(watchdog_start(&iwdg));
    TEST_ASSERT_EQUAL_HEX32(0xCCCC, model_written(&iwdg.kr, 0));
    TEST_ASSERT_EQUAL_HEX32(0x5555, model_written(&iwdg.kr, 1));
    TEST_ASSERT_EQUAL_HEX32(0xAAAA, model_written(&iwdg.kr, 2));
    TEST_ASSERT_EQUAL_UINT32(0, model_get(&iwdg.pr));
    TEST_ASSERT_EQUAL_UINT32(400, model_get(&iwdg.rlr));
    TEST_ASSERT_EQUAL_PTR(&iwdg.kr, model_write(0).reg);
    TEST_ASSERT_EQUAL_PTR(&iwdg.kr, model_write(1).reg);
    TEST_ASSERT_EQUAL_PTR(&iwdg.kr, model_write(4).reg);
}

static void test_watchdog_that_takes_no_settings_is_not_waited_for_without_end(void)
{
    settles = false;
    TEST_ASSERT_FALSE(watchdog_start(&iwdg));
    TEST_ASSERT_UINT32_WITHIN(100, 42000, model_reads_of(&iwdg.sr)); // 1 ms
    TEST_ASSERT_EQUAL_HEX32(0xAAAA, model_get(&iwdg.kr));
}

static void test_watchdog_is_fed_by_a_healthy_tick_alone(void)
{
    static const struct {
        tick_health_t health;
        uint32_t fed;
    } cases[] = {
        {{.periods = 1, .app_in_order = true}, 1},  {{.periods = 2, .app_in_order = true}, 0},
        {{.periods = 0, .app_in_order = true}, 0},  {{.periods = UINT32_MAX, .app_in_order = true}, 0},
        {{.periods = 1, .app_in_order = false}, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        model_forget();
        watchdog_tick(&iwdg, &cases[i].health);
        TEST_ASSERT_EQUAL_UINT32(cases[i].fed, model_writes());
        if (cases[i].fed == 1) {
            TEST_ASSERT_EQUAL_HEX32(0xAAAA, model_written(&iwdg.kr, 0));
        }
    }
}

// ---- crash record

static crash_t record(void)
{
    static const exception_frame_t frame = {.lr = 0x08001235, .pc = 0x08004321};
    crash_t crash;
    model_set(&scb.icsr, 0x00400803); // BusFault pending; HardFault active
    model_set(&scb.cfsr, 0x8200);
    model_set(&scb.bfar, 0x10000000);
    crash_record(&crash, &scb, &frame);
    return crash;
}

static void test_crash_is_there_with_what_the_core_said(void)
{
    const crash_t crash = record();
    TEST_ASSERT_TRUE(crash_is_there(&crash));
    TEST_ASSERT_EQUAL_HEX32(0x08004321, crash.facts.pc);
    TEST_ASSERT_EQUAL_HEX32(0x08001235, crash.facts.lr);
    TEST_ASSERT_EQUAL_UINT32(3, crash.facts.exception);
    TEST_ASSERT_EQUAL_HEX32(0x8200, crash.facts.cfsr);
    TEST_ASSERT_EQUAL_HEX32(0x10000000, crash.facts.bfar);
}

static void test_crash_without_a_stack_has_no_place(void)
{
    crash_t crash;
    crash_record(&crash, &scb, NULL);
    TEST_ASSERT_TRUE(crash_is_there(&crash));
    TEST_ASSERT_EQUAL_HEX32(0, crash.facts.pc);
    TEST_ASSERT_EQUAL_HEX32(0, crash.facts.lr);
}

static void test_crash_cleared_is_gone(void)
{
    crash_t crash = record();
    crash_clear(&crash);
    TEST_ASSERT_FALSE(crash_is_there(&crash));
}

static void test_memory_that_came_up_with_anything_is_no_crash(void)
{
    crash_t crash;
    memset(&crash, 0, sizeof crash);
    TEST_ASSERT_FALSE(crash_is_there(&crash));
    memset(&crash, 0xFF, sizeof crash);
    TEST_ASSERT_FALSE(crash_is_there(&crash));
}

static void test_one_bit_flipped_anywhere_is_no_crash(void)
{
    for (size_t bit = 0; bit < 8 * sizeof(crash_t); bit++) {
        crash_t crash = record();
        uint8_t byte[sizeof crash];
        memcpy(byte, &crash, sizeof byte);
        byte[bit / 8] ^= (uint8_t)(1u << bit % 8);
        memcpy(&crash, byte, sizeof byte);
        TEST_ASSERT_FALSE(crash_is_there(&crash));
    }
}

// ---- cycle counter

static void test_counter_that_counts_works(void)
{
    cycles_t cycles;
    cycles_start(&cycles, &scb, &dwt, 168000000);
    TEST_ASSERT_TRUE(cycles.works);
    TEST_ASSERT_BITS_HIGH(1u << 24, model_get(&scb.demcr));
    TEST_ASSERT_BITS_HIGH(1u, model_get(&dwt.ctrl));
    TEST_ASSERT_LESS_THAN_UINT32(model_first_write(&dwt.ctrl, 1), model_first_write(&scb.demcr, 1u << 24));
    const uint32_t before = cycles_now(&cycles);
    TEST_ASSERT_EQUAL_UINT32(7, cycles_now(&cycles) - before);
}

static void test_counter_that_stands_still_times_nothing(void)
{
    cycles_t cycles;
    counts = false;
    cycles_start(&cycles, &scb, &dwt, 168000000);
    TEST_ASSERT_FALSE(cycles.works);
    TEST_ASSERT_EQUAL_UINT32(0, cycles_now(&cycles));
}

static void test_cycles_are_nanoseconds_at_the_cores_clock(void)
{
    cycles_t cycles = {.core_Hz = 168000000};
    TEST_ASSERT_EQUAL_UINT32(1000000, cycles_to_ns(&cycles, 168000));
    TEST_ASSERT_EQUAL_UINT32(5, cycles_to_ns(&cycles, 1));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, cycles_to_ns(&cycles, UINT32_MAX));
    cycles.core_Hz = 16000000;
    TEST_ASSERT_EQUAL_UINT32(62500, cycles_to_ns(&cycles, 1000));
}

// ---- LED

/// Flashes that begin within a time.
static uint32_t flashes(uint8_t mode, uint8_t fault, bool on_crystal, uint32_t time_ms)
{
    uint32_t count = 0;
    bool before = false;
    for (uint32_t t = 0; t < time_ms; t++) {
        const bool now = led_is_on(mode, fault, on_crystal, t);
        count += now && !before ? 1u : 0u;
        before = now;
    }
    return count;
}

static void test_led_tells_the_mode(void)
{
    TEST_ASSERT_EQUAL_UINT32(10, flashes(MODE_IDLE, FAULT_NONE, true, 10000));
    TEST_ASSERT_EQUAL_UINT32(20, flashes(MODE_IDLE, FAULT_NONE, false, 10000));
    TEST_ASSERT_EQUAL_UINT32(1, flashes(MODE_TRACKING, FAULT_NONE, true, 10000)); // on and on
    TEST_ASSERT_EQUAL_UINT32(0, flashes(MODE_BOOT, FAULT_NONE, true, 10000));
}

static void test_led_counts_the_fault_and_pauses(void)
{
    for (uint8_t fault = FAULT_STALE_POSE; fault <= FAULT_BRIDGE; fault++) {
        const uint32_t round_ms = 400u * fault + 1000u;
        TEST_ASSERT_EQUAL_UINT32(3u * fault, flashes(MODE_FAULT, fault, true, 3 * round_ms));
        for (uint32_t t = 400u * fault - 200u; t < round_ms; t++) {
            TEST_ASSERT_FALSE(led_is_on(MODE_FAULT, fault, true, t));
        }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_watchdog_runs_before_it_is_set_and_resets_after_50_ms);
    RUN_TEST(test_watchdog_that_takes_no_settings_is_not_waited_for_without_end);
    RUN_TEST(test_watchdog_is_fed_by_a_healthy_tick_alone);
    RUN_TEST(test_crash_is_there_with_what_the_core_said);
    RUN_TEST(test_crash_without_a_stack_has_no_place);
    RUN_TEST(test_crash_cleared_is_gone);
    RUN_TEST(test_memory_that_came_up_with_anything_is_no_crash);
    RUN_TEST(test_one_bit_flipped_anywhere_is_no_crash);
    RUN_TEST(test_counter_that_counts_works);
    RUN_TEST(test_counter_that_stands_still_times_nothing);
    RUN_TEST(test_cycles_are_nanoseconds_at_the_cores_clock);
    RUN_TEST(test_led_tells_the_mode);
    RUN_TEST(test_led_counts_the_fault_and_pauses);
    return UNITY_END();
}
