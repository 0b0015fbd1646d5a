// SPDX-License-Identifier: MIT
// Encoders and bridges: counting over the ends of 16 and 32 bits, signs wheel by wheel, and off whatever happens.
// Register bits are those of RM0090, chapters 17 and 18.
#include "wheels.h"

#include "model.h"
#include "unity.h"

#include <string.h>

enum { MOE = 1 << 15, BIF = 1 << 7, ENABLE_PIN = 15, PERIOD = 8400 };

static const motor_t motor = {.resistance_Ohm = 2.0f,
                              .torque_constant_Nm_A = 0.01f,
                              .gear_ratio = 20.0f,
                              .supply_nominal_V = 12.0f,
                              .encoder_counts = 80000.0f};
static wheels_wiring_t wiring;
static wheels_t wheels;

/// BSRR moves ODR; a break holds MOE at 0.
static bool broken;
static uint32_t hardware(reg_t *reg, uint32_t value)
{
    if (reg == &gpio_b.bsrr) {
        model_set(&gpio_b.odr, (model_get(&gpio_b.odr) & ~(value >> 16)) | (value & 0xFFFFu));
    }
    if (reg == &tim8.bdtr && broken) {
        model_set(&tim8.sr, BIF);
        return value & ~(uint32_t)MOE;
    }
    return value;
}

void setUp(void)
{
    model_reset();
    model_on_write(hardware);
    broken = false;
    wiring = (wheels_wiring_t){
        .encoder = {{&tim5, 32, 1}, {&tim3, 16, 1}, {&tim4, 16, 1}},
        .direction = {{&gpio_b, 12}, {&gpio_b, 13}, {&gpio_b, 14}},
        .forwards = {1, 1, 1},
        .enable = {&gpio_b, ENABLE_PIN},
        .pwm = &tim8,
        .duty_max = 0.95f,
    };
    memset(&wheels, 0, sizeof wheels);
    wheels_start(&wheels, &wiring, &motor, 168000000);
}

void tearDown(void)
{
    static const char *const own[] = {"tim3", "tim4", "tim5", "tim8", "gpio_b", NULL};
    model_assert_wrote_only(own);
}

static bool pin_is_high(uint32_t pin)
{
    return (model_get(&gpio_b.odr) & 1u << pin) != 0;
}

static void assert_off(void)
{
    TEST_ASSERT_FALSE(pin_is_high(ENABLE_PIN));
    TEST_ASSERT_BITS_LOW(MOE, model_get(&tim8.bdtr));
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_UINT32(0, model_get(&tim8.ccr[i]));
    }
}

// ---- encoders

static void test_timers_count_the_edges_of_both_inputs_over_their_whole_span(void)
{
    timer_registers_t *const timers[] = {&tim5, &tim3, &tim4};
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_HEX32(3, model_get(&timers[i]->smcr) & 7u);
        TEST_ASSERT_EQUAL_HEX32(0x0101, model_get(&timers[i]->ccmr1) & 0x0303u); // each input to its own channel
        TEST_ASSERT_EQUAL_HEX32(i == 0 ? UINT32_MAX : 0xFFFF, model_get(&timers[i]->arr));
        TEST_ASSERT_EQUAL_HEX32(1, model_get(&timers[i]->cr1));
        TEST_ASSERT_EQUAL_PTR(&timers[i]->cr1, model_write(model_writes() - 1u - 4u * (uint32_t)(2 - i)).reg);
    }
}

static void move(encoder_t *encoder, uint32_t from, uint32_t to, int32_t counts)
{
    model_set(&encoder->wiring.timer->cnt, from);
    (void)encoder_counts(encoder);
    model_set(&encoder->wiring.timer->cnt, to);
    TEST_ASSERT_EQUAL_INT32(counts, encoder_counts(encoder));
    TEST_ASSERT_EQUAL_INT32(0, encoder_counts(encoder));
}

static void test_counts_run_over_the_ends_of_16_bits(void)
{
    encoder_t *encoder = &wheels.encoder[1];
    move(encoder, 10, 25, 15);
    move(encoder, 25, 10, -15);
    move(encoder, 0xFFF0, 0x0010, 32);
    move(encoder, 0x0010, 0xFFF0, -32);
    move(encoder, 0, 0x7FFF, 32767);
    move(encoder, 0, 0x8000, -32768);
}

static void test_counts_run_over_the_ends_of_32_bits(void)
{
    encoder_t *encoder = &wheels.encoder[0];
    move(encoder, 0xFFFFFFF0, 0x00000010, 32);
    move(encoder, 0x00000010, 0xFFFFFFF0, -32);
    move(encoder, 0xFFFF, 0x10000, 1);
}

static void test_speed_is_counts_over_time_wheel_by_wheel(void)
{
    timer_registers_t *const timers[] = {&tim5, &tim3, &tim4};
    for (int i = 0; i < 3; i++) {
        setUp();
        model_set(&timers[i]->cnt, 800); // a hundredth of a turn
        const vec3_t speed = wheels_measure(&wheels, 0.001f);
        const float expected[3] = {speed.x, speed.y, speed.z};
        for (int k = 0; k < 3; k++) {
            TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, k == i ? 62.8318531f : 0.0f, expected[k]); // ten turns a second
        }
        model_set(&timers[i]->cnt, 0);
        const vec3_t back = wheels_measure(&wheels, 0.002f);
        TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, -31.4159265f, back.x + back.y + back.z);
    }
}

static void test_encoder_the_other_way_round_is_turned_by_its_sign(void)
{
    wiring.encoder[2].sign = -1;
    wheels_start(&wheels, &wiring, &motor, 168000000);
    model_set(&tim4.cnt, 800);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-4f, -62.8318531f, wheels_measure(&wheels, 0.001f).z);
}

// ---- bridges

static void test_pwm_is_20_kHz_on_three_channels_with_no_dead_time(void)
{
    TEST_ASSERT_EQUAL_UINT32(PERIOD - 1, model_get(&tim8.arr)); // 168 MHz / 20 kHz
    TEST_ASSERT_EQUAL_UINT32(0, model_get(&tim8.psc));
    TEST_ASSERT_EQUAL_HEX32(0x6868, model_get(&tim8.ccmr1)); // PWM mode 1, preloaded
    TEST_ASSERT_EQUAL_HEX32(0x0068, model_get(&tim8.ccmr2));
    TEST_ASSERT_EQUAL_HEX32(0x111, model_get(&tim8.ccer));
    TEST_ASSERT_LESS_THAN_UINT32(model_first_write(&tim8.cr1, 1),
                                 model_first_write(&tim8.egr, 1)); // preloads taken over
    TEST_ASSERT_EQUAL_HEX32(0x1C00, model_get(&tim8.bdtr)); // off, driven low, break input low-active, no dead time
}

static void test_start_leaves_the_bridges_off(void)
{
    assert_off();
    for (uint32_t n = 0; n < model_writes(); n++) {
        const access_t write = model_write(n);
        TEST_ASSERT_FALSE(write.reg == &tim8.bdtr && (write.value & MOE) != 0);
        TEST_ASSERT_FALSE(write.reg == &gpio_b.bsrr && (write.value & 1u << ENABLE_PIN) != 0);
    }
}

/// 0.12 N·m take 0.6 A, 1.2 V, a tenth of 12 V.
static void test_torque_of_each_wheel_goes_to_its_own_bridge(void)
{
    for (uint32_t i = 0; i < 3; i++) {
        setUp();
        const vec3_t torque = {i == 0 ? 0.12f : 0.0f, i == 1 ? 0.12f : 0.0f, i == 2 ? 0.12f : 0.0f};
        wheels_drive(&wheels, torque, 12.0f);
        for (uint32_t k = 0; k < 3; k++) {
            TEST_ASSERT_UINT32_WITHIN(1, k == i ? PERIOD / 10 : 0, model_get(&tim8.ccr[k]));
            TEST_ASSERT_TRUE(pin_is_high(12 + k));
        }
    }
}

static void test_backwards_is_the_other_direction_with_the_same_share(void)
{
    wheels_drive(&wheels, (vec3_t){-0.12f, 0.12f, -0.12f}, 12.0f);
    TEST_ASSERT_UINT32_WITHIN(1, PERIOD / 10, model_get(&tim8.ccr[0]));
    TEST_ASSERT_FALSE(pin_is_high(12));
    TEST_ASSERT_TRUE(pin_is_high(13));
    TEST_ASSERT_FALSE(pin_is_high(14));
}

static void test_bridge_the_other_way_round_is_turned_by_its_sign(void)
{
    wiring.forwards[0] = -1;
    wheels_drive(&wheels, (vec3_t){0.12f, 0.0f, 0.0f}, 12.0f);
    TEST_ASSERT_FALSE(pin_is_high(12));
    wheels_drive(&wheels, (vec3_t){-0.12f, 0.0f, 0.0f}, 12.0f);
    TEST_ASSERT_TRUE(pin_is_high(12));
}

static void test_speed_measured_last_is_met_by_voltage(void)
{
    model_set(&tim5.cnt, 127); // 9.97 rad/s, 2.0 V
    (void)wheels_measure(&wheels, 0.001f);
    wheels_drive(&wheels, (vec3_t){0}, 12.0f);
    TEST_ASSERT_UINT32_WITHIN(5, PERIOD / 6, model_get(&tim8.ccr[0]));
}

static void test_share_never_exceeds_its_bound(void)
{
    wheels_drive(&wheels, (vec3_t){100.0f, -100.0f, 100.0f}, 12.0f);
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_UINT32_WITHIN(1, 95 * PERIOD / 100, model_get(&tim8.ccr[i]));
    }
}

static void test_switching_on_sets_shares_and_directions_first_and_enable_last(void)
{
    model_forget();
    wheels_drive(&wheels, (vec3_t){0.12f, 0.12f, 0.12f}, 12.0f);
    const uint32_t on = model_first_write(&tim8.bdtr, MOE);
    const uint32_t enabled = model_first_write(&gpio_b.bsrr, 1u << ENABLE_PIN);
    TEST_ASSERT_EQUAL_UINT32(model_writes() - 1, enabled);
    TEST_ASSERT_LESS_THAN_UINT32(enabled, on);
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_LESS_THAN_UINT32(on, model_first_write(&tim8.ccr[i], 0x300));
    }
    model_forget();
    wheels_drive(&wheels, (vec3_t){0.12f, 0.12f, 0.12f}, 12.0f);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&tim8.bdtr)); // once is enough; again would undo a trip
}

static void test_off_takes_enable_away_first(void)
{
    wheels_drive(&wheels, (vec3_t){0.12f, 0.12f, 0.12f}, 12.0f);
    model_forget();
    wheels_off(&wheels);
    assert_off();
    TEST_ASSERT_EQUAL_PTR(&gpio_b.bsrr, model_write(0).reg);
    TEST_ASSERT_EQUAL_HEX32(1u << (ENABLE_PIN + 16), model_write(0).value);
}

static void test_bridge_that_trips_is_seen_until_it_is_switched_on_anew(void)
{
    TEST_ASSERT_FALSE(wheels_have_tripped(&wheels));
    wheels_drive(&wheels, (vec3_t){0.12f, 0.0f, 0.0f}, 12.0f);
    TEST_ASSERT_FALSE(wheels_have_tripped(&wheels));
    model_set(&tim8.sr, BIF);
    TEST_ASSERT_TRUE(wheels_have_tripped(&wheels));
    wheels_off(&wheels);
    TEST_ASSERT_FALSE(wheels_have_tripped(&wheels));
    model_forget();
    wheels_drive(&wheels, (vec3_t){0.12f, 0.0f, 0.0f}, 12.0f);
    TEST_ASSERT_EQUAL_HEX32(~(uint32_t)BIF, model_written(&tim8.sr, 0)); // cleared by a zero
}

static void test_bridge_that_is_still_tripped_is_seen_at_once(void)
{
    broken = true;
    wheels_drive(&wheels, (vec3_t){0.12f, 0.0f, 0.0f}, 12.0f);
    TEST_ASSERT_TRUE(wheels_have_tripped(&wheels));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_timers_count_the_edges_of_both_inputs_over_their_whole_span);
    RUN_TEST(test_counts_run_over_the_ends_of_16_bits);
    RUN_TEST(test_counts_run_over_the_ends_of_32_bits);
    RUN_TEST(test_speed_is_counts_over_time_wheel_by_wheel);
    RUN_TEST(test_encoder_the_other_way_round_is_turned_by_its_sign);
    RUN_TEST(test_pwm_is_20_kHz_on_three_channels_with_no_dead_time);
    RUN_TEST(test_start_leaves_the_bridges_off);
    RUN_TEST(test_torque_of_each_wheel_goes_to_its_own_bridge);
    RUN_TEST(test_backwards_is_the_other_direction_with_the_same_share);
    RUN_TEST(test_bridge_the_other_way_round_is_turned_by_its_sign);
    RUN_TEST(test_speed_measured_last_is_met_by_voltage);
    RUN_TEST(test_share_never_exceeds_its_bound);
    RUN_TEST(test_switching_on_sets_shares_and_directions_first_and_enable_last);
    RUN_TEST(test_off_takes_enable_away_first);
    RUN_TEST(test_bridge_that_trips_is_seen_until_it_is_switched_on_anew);
    RUN_TEST(test_bridge_that_is_still_tripped_is_seen_at_once);
    return UNITY_END();
}
