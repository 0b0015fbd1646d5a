// SPDX-License-Identifier: MIT
// The whole board on the register model, from reset to driving its motors and off again: what a host sends comes in
// through the CAN controller's registers, what the wheels get is read from those of timer and pins.
#include "loop.h"

#include "crc.h"
#include "messages.h"
#include "model.h"
#include "unity.h"

#include <math.h>
#include <string.h>

enum { NODE = 3, ENABLE_PIN = 15, SEGMENT_BYTES = 100, FRAME_BYTES = 6, CYCLES_A_TICK = 168000 };
#define MOE (1u << 15)

static loop_t loop;
static bool crystal, rcc_answers, flash_is_there;
static uint32_t break_flag;
static uint32_t cycles;

// ---- the hardware

static uint32_t on_rcc_cr(uint32_t value)
{
    const uint32_t enabled = value & ((crystal ? 1u << 16 : 0) | 1u << 24);
    return rcc_answers ? (value & ~(1u << 17 | 1u << 25)) | enabled << 1 | 3u : 0;
}

static void take_mailbox(const reg_t *reg, uint32_t value)
{
    for (uint32_t mailbox = 0; mailbox < 3; mailbox++) {
        if (reg == &can1.tx[mailbox].ir && (value & 1u) != 0) {
            model_set(&can1.tsr, model_get(&can1.tsr) & ~(1u << (26 + mailbox)));
        }
    }
}

static uint32_t on_write(reg_t *reg, uint32_t value)
{
    if (reg == &rcc.cr) {
        return on_rcc_cr(value);
    }
    if (reg == &rcc.cfgr) {
        return (value & ~(3u << 2)) | (value & 3u) << 2;
    }
    if (reg == &flash_interface.cr && !flash_is_there) {
        return 0;
    }
    if (reg == &can1.mcr) {
        model_set(&can1.msr, value & 1u);
    }
    if (reg == &gpio_b.bsrr) {
        model_set(&gpio_b.odr, (model_get(&gpio_b.odr) & ~(value >> 16)) | (value & 0xFFFFu));
    }
    if (reg == &tim8.sr) {
        return break_flag;
    }
    if (reg == &tim8.bdtr && (value & MOE) == 0) {
        model_set(&tim8.sr, break_flag); // nothing is said of a break that is over
    }
    take_mailbox(reg, value);
    return value;
}

static uint32_t on_read(reg_t *reg, uint32_t value)
{
    if (reg == &dwt.cyccnt) {
        return cycles += 10;
    }
    return value;
}

static void power_on(void)
{
    model_reset();
    memset(settings_sectors, 0xFF, sizeof settings_sectors); // a board that never kept anything
    model_on_write(on_write);
    model_on_read(on_read);
    model_set(&rcc.cr, rcc_answers ? 0x83 : 0);
    model_set(&rcc.csr, 0x0E000000);
    model_set(&can1.tsr, 7u << 26);
    memset(&loop, 0, sizeof loop);
}

void setUp(void)
{
    crystal = true;
    rcc_answers = true;
    flash_is_there = true;
    break_flag = 0;
    memset(&board_crash, 0, sizeof board_crash);
    power_on();
}

void tearDown(void)
{
}

static bool bridges_are_on(void)
{
    const bool enabled = (model_get(&gpio_b.odr) & 1u << ENABLE_PIN) != 0;
    TEST_ASSERT_EQUAL(enabled, (model_get(&tim8.bdtr) & MOE) != 0);
    return enabled;
}

static void assert_wheels_at_rest(void)
{
    TEST_ASSERT_FALSE(bridges_are_on());
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_UINT32(0, model_get(&tim8.ccr[i]));
    }
}

static void never_switched_on(void)
{
    for (uint32_t n = 0; n < model_writes(); n++) {
        const access_t write = model_write(n);
        TEST_ASSERT_FALSE(write.reg == &tim8.bdtr && (write.value & MOE) != 0);
        TEST_ASSERT_FALSE(write.reg == &gpio_b.bsrr && (write.value & 1u << ENABLE_PIN) != 0);
    }
}

// ---- time and the host

static void supply(float voltage_V)
{
    model_set(&adc1.sr, 1u << 1);
    model_set(&adc1.dr, (uint32_t)(voltage_V / 11.0f / 3.3f * 4096.0f));
}

static void pass_periods(uint32_t periods)
{
    for (uint32_t i = 0; i < periods; i++) {
        board_count_tick(&loop.board);
        cycles += CYCLES_A_TICK;
    }
    model_set(&can1.tsr, 7u << 26); // the bus keeps up
    model_forget();
    loop_turn(&loop);
}

static void pass(uint32_t ticks)
{
    for (uint32_t i = 0; i < ticks; i++) {
        pass_periods(1);
    }
}

static uint32_t word_at(const uint8_t *byte)
{
    return (uint32_t)byte[0] | (uint32_t)byte[1] << 8 | (uint32_t)byte[2] << 16 | (uint32_t)byte[3] << 24;
}

static void host_sends(const frame_t *frame)
{
    const uint32_t fifo = frame->id < 0x100 ? 0 : 1;
    model_set(&can1.rfr[fifo], 1);
    model_set(&can1.rx[fifo].ir, (uint32_t)frame->id << 21);
    model_set(&can1.rx[fifo].dtr, frame->length);
    model_set(&can1.rx[fifo].dlr, word_at(frame->data));
    model_set(&can1.rx[fifo].dhr, word_at(frame->data + 4));
    can_interrupt(&loop.board.can, fifo);
    model_set(&can1.tsr, 7u << 26);
    loop_turn(&loop);
}

static uint8_t next_request(void)
{
    static uint8_t requests;
    requests = (uint8_t)((requests + 1) & 0xFu);
    return requests;
}

/// With the key that the robot gave, as a host that has read its CHALLENGE.
static void command(uint8_t operation)
{
    frame_t frame;
    const command_message_t message = {.operation = operation, .counter = next_request(), .key = loop.app.key};
    command_encode(&frame, NODE, &message);
    host_sends(&frame);
}

static void arm_and_start(void)
{
    command(OPERATION_ARM);
    command(OPERATION_START);
}

static void heartbeat(uint32_t tick)
{
    frame_t frame;
    const uint8_t counter = tick & 0xFu;
    pose_encode(&frame, NODE, &(pose_message_t){.counter = counter});
    host_sends(&frame);
    const uint8_t pose_crc = crc8_frame(&frame, frame.length);
    sync_encode(&frame, NODE, &(sync_message_t){.tick = tick, .pose_crc = pose_crc});
    host_sends(&frame);
}

/// One segment of a second that stands 5 cm aside of the tracked point, which is 12 cm ahead: the robot pushes.
static void upload(void)
{
    uint8_t byte[SEGMENT_BYTES + 2] = {0};
    const uint32_t duration_us = 1000000;
    const float aside_m = 0.05f, ahead_m = 0.12f;
    memcpy(byte, &duration_us, sizeof duration_us);
    memcpy(byte + 4, &aside_m, sizeof aside_m);
    memcpy(byte + 4 + 32, &ahead_m, sizeof ahead_m);
    uint32_t crc = CRC32_START;
    for (int i = 0; i < SEGMENT_BYTES; i++) {
        crc = crc32_update(crc, byte[i]);
    }
    frame_t frame;
    trajectory_begin_encode(&frame, NODE,
                            &(trajectory_begin_message_t){SEGMENT_BYTES, crc32_finish(crc), next_request()});
    host_sends(&frame);
    for (uint16_t at = 0; at < SEGMENT_BYTES; at = (uint16_t)(at + FRAME_BYTES)) {
        const uint8_t *b = byte + at;
        trajectory_data_encode(&frame, NODE, &(trajectory_data_message_t){at, b[0], b[1], b[2], b[3], b[4], b[5]});
        host_sends(&frame);
    }
}

static void start(void)
{
    loop_start(&loop, NODE);
    supply(12.0f);
    pass(SUPPLY_LOW_PERIODS + 1);
}

static void drive(void)
{
    frame_t frame;
    start();
    hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
    host_sends(&frame);
    upload();
    command(OPERATION_USE_MOTORS);
    heartbeat(0);
    pass(1);
    arm_and_start();
    pass(1);
}

// ---- out of reset

static void test_first_of_all_the_bridges_are_switched_off(void)
{
    static const char *const own[] = {"rcc", "gpio_b", NULL};
    board_bridges_off();
    model_assert_wrote_only(own);
    const uint32_t clock = model_first_write(&rcc.ahb1enr, 1u << 1);
    const uint32_t low = model_first_write(&gpio_b.bsrr, 1u << (ENABLE_PIN + 16));
    const uint32_t output = model_first_write(&gpio_b.moder, 1u << 2 * ENABLE_PIN);
    TEST_ASSERT_LESS_THAN_UINT32(low, clock);
    TEST_ASSERT_LESS_THAN_UINT32(output, low); // low before it is an output
    TEST_ASSERT_EQUAL_UINT32(output + 1, model_writes());
}

static void test_start_leaves_the_bridges_off_and_starts_the_watchdog_last(void)
{
    loop_start(&loop, NODE);
    never_switched_on();
    assert_wheels_at_rest();
    const uint32_t fed = model_writes() - 1;
    TEST_ASSERT_EQUAL_PTR(&iwdg.kr, model_write(fed).reg);
    TEST_ASSERT_EQUAL_UINT8(CLOCK_SOURCE_HSE_PLL, loop.app.port.drive == DRIVE_LOCKSTEP ? loop.board.clock.source : 0);
}

static void test_start_writes_no_peripheral_but_those_it_uses(void)
{
    static const char *const used[] = {"rcc",  "flash_interface", "pwr",     "gpio_a", "gpio_b", "gpio_c", "adc1",
                                       "tim3", "adc_common",      "tim4",    "tim5",   "tim8",   "iwdg",   "usart1",
                                       "can1", "dbgmcu",          "systick", "nvic",   "scb",    "dwt",    NULL};
    loop_start(&loop, NODE);
    model_assert_wrote_only(used);
}

/// Positions of RM0090 12.1.3: 20 and 21 are CAN1's receive FIFOs, 37 USART1.
static void test_start_enables_three_interrupts_and_a_tick_of_1_kHz(void)
{
    loop_start(&loop, NODE);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&nvic.iser[1]));
    TEST_ASSERT_EQUAL_HEX32(1u << 5, model_written(&nvic.iser[1], 0));
    TEST_ASSERT_EQUAL_HEX32(1u << 20 | 1u << 21, model_written(&nvic.iser[0], 0) | model_written(&nvic.iser[0], 1));
    TEST_ASSERT_EQUAL_UINT32(167999, model_get(&systick.load));
    TEST_ASSERT_EQUAL_HEX32(7, model_get(&systick.ctrl));
}

/// Pins and functions as in data sheet DS8626, table 9, of the wiring that README.md shows.
static void test_pins_have_their_functions(void)
{
    static const struct {
        gpio_registers_t *port;
        uint32_t pin, function;
    } wired[] = {
        {&gpio_a, 0, 2}, {&gpio_a, 1, 2}, {&gpio_b, 4, 2}, {&gpio_b, 5, 2},  {&gpio_b, 6, 2},
        {&gpio_b, 7, 2}, {&gpio_a, 6, 3}, {&gpio_c, 6, 3}, {&gpio_c, 7, 3},  {&gpio_c, 8, 3},
        {&gpio_b, 8, 9}, {&gpio_b, 9, 9}, {&gpio_a, 9, 7}, {&gpio_a, 10, 7},
    };
    static const uint32_t outputs_of_b[] = {12, 13, 14, 15};
    model_set(&gpio_a.moder, 0xA8000000); // out of reset: the debugger's pins
    loop_start(&loop, NODE);
    for (size_t i = 0; i < sizeof wired / sizeof wired[0]; i++) {
        const uint32_t pin = wired[i].pin;
        TEST_ASSERT_EQUAL_HEX32(2, model_get(&wired[i].port->moder) >> 2 * pin & 3u);
        TEST_ASSERT_EQUAL_HEX32(wired[i].function, model_get(&wired[i].port->afr[pin / 8]) >> 4 * (pin % 8) & 15u);
    }
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_HEX32(1, model_get(&gpio_b.moder) >> 2 * outputs_of_b[i] & 3u);
    }
    TEST_ASSERT_EQUAL_HEX32(3, model_get(&gpio_c.moder) & 3u);                 // analog
    TEST_ASSERT_EQUAL_HEX32(0xA8000000 >> 26, model_get(&gpio_a.moder) >> 26); // the debugger keeps its pins
}

static void test_without_a_crystal_can_is_left_alone_and_the_uart_serves(void)
{
    crystal = false;
    loop_start(&loop, NODE);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&can1.mcr));
    TEST_ASSERT_EQUAL_UINT8(CLOCK_SOURCE_HSI_PLL, loop.board.clock.source);
    TEST_ASSERT_EQUAL(LINE_UART, loop.board.link.line);
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_ABSENT, board_health(&loop.board).can_state);
}

static void test_emulator_without_a_clock_tree_starts_all_the_same(void)
{
    rcc_answers = false;
    power_on();
    loop_start(&loop, NODE);
    TEST_ASSERT_EQUAL_UINT32(167999, model_get(&systick.load));
    TEST_ASSERT_EQUAL_UINT8(CLOCK_SOURCE_UNKNOWN, board_health(&loop.board).clock_source);
    never_switched_on();
    supply(12.0f);
    pass(SUPPLY_LOW_PERIODS + 1);
    TEST_ASSERT_TRUE(isnan(board_health(&loop.board).supply_V)); // what its converter says is not believed
    TEST_ASSERT_EQUAL_UINT8(FAULT_SUPPLY, board_motor_fault(&loop.board));
}

static void test_crash_of_the_run_before_is_told_once(void)
{
    static const exception_frame_t frame = {.pc = 0x08000ABC, .lr = 0x08000DEF};
    crash_record(&board_crash, &scb, &frame);
    power_on();
    loop_start(&loop, NODE);
    TEST_ASSERT_TRUE(loop.app.crash_known);
    TEST_ASSERT_EQUAL_HEX32(0x08000ABC, loop.app.crash_pc);
    TEST_ASSERT_EQUAL_UINT8(RESET_CAUSE_CRASH, loop.board.reset_cause);
    TEST_ASSERT_FALSE(crash_is_there(&board_crash));
    power_on();
    loop_start(&loop, NODE);
    TEST_ASSERT_FALSE(loop.app.crash_known);
    TEST_ASSERT_EQUAL_UINT8(RESET_CAUSE_POWER, loop.board.reset_cause);
}

/// PM0214 4.4.5: the key 0x05FA, and bit 2 asks for the reset; what was written before is in memory by then.
static void test_reset_is_asked_for_after_all_else_is_written(void)
{
    board_reset();
    TEST_ASSERT_EQUAL_UINT32(1, model_writes());
    TEST_ASSERT_EQUAL_HEX32(0x05FA0004, model_written(&scb.aircr, 0));
    TEST_ASSERT_EQUAL_STRING("ss", model_core_log());
}

// ---- driving

static void test_motors_are_driven_after_use_motors_and_start(void)
{
    drive();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, loop.app.mode);
    TEST_ASSERT_TRUE(bridges_are_on());
    TEST_ASSERT_GREATER_THAN_UINT32(0, model_get(&tim8.ccr[0]));
}

/// Wheel 1 pushes against wheel 3 to go aside, by theory.md's Jr: minus and plus root three over two along x1.
static void test_wheels_push_to_the_side_where_the_path_is(void)
{
    drive();
    const uint32_t directions = model_get(&gpio_b.odr) >> 12 & 7u;
    TEST_ASSERT_EQUAL_HEX32(4, directions & 5u); // 1 backwards, 3 forwards
}

static uint16_t key_after(uint32_t more_cycles)
{
    frame_t frame;
    power_on();
    start();
    cycles += more_cycles;
    hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
    host_sends(&frame);
    upload();
    command(OPERATION_ARM);
    TEST_ASSERT_EQUAL_UINT8(MODE_ARMED, loop.app.mode);
    return loop.app.key;
}

/// So that a recording of an earlier start does not start the robot.
static void test_key_of_arm_comes_of_the_cycle_counter(void)
{
    const uint16_t key = key_after(0);
    TEST_ASSERT_NOT_EQUAL(key, key_after(1));
    TEST_ASSERT_NOT_EQUAL(key, key_after(1000));
}

static void test_motors_stay_off_in_lockstep(void)
{
    frame_t frame;
    start();
    hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
    host_sends(&frame);
    upload();
    arm_and_start();
    for (uint32_t tick = 0; tick < 10; tick++) {
        heartbeat(tick);
        pass(1);
        never_switched_on();
    }
    assert_wheels_at_rest();
}

enum { REST_PERIODS = 2600 }; // 2 s of braking at most, half a second at rest

static void test_stop_brakes_and_switches_off_at_rest(void)
{
    drive();
    command(OPERATION_STOP);
    pass(1);
    TEST_ASSERT_TRUE(bridges_are_on());
    pass(REST_PERIODS);
    assert_wheels_at_rest();
}

static void test_host_that_falls_silent_stops_the_motors(void)
{
    drive();
    pass(97);
    TEST_ASSERT_TRUE(bridges_are_on());
    pass(2);
    TEST_ASSERT_EQUAL_UINT8(FAULT_HOST_SILENT, loop.app.fault);
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, loop.app.mode);
    pass(REST_PERIODS);
    assert_wheels_at_rest();
}

static void test_low_battery_stops_the_motors_for_good(void)
{
    drive();
    supply(8.0f);
    for (uint32_t tick = 1; tick < 100; tick++) {
        heartbeat(tick);
        pass(1);
    }
    assert_wheels_at_rest();
    TEST_ASSERT_EQUAL_UINT8(FAULT_SUPPLY, loop.app.fault);
    supply(12.0f);
    for (uint32_t tick = 100; tick < 200; tick++) {
        heartbeat(tick);
        pass(1);
    }
    assert_wheels_at_rest();
}

static void test_3V3_that_sinks_stops_the_motors_at_once(void)
{
    drive();
    model_set(&pwr.csr, 1u << 2);
    pass(1);
    assert_wheels_at_rest();
    TEST_ASSERT_EQUAL_UINT8(FAULT_SUPPLY, loop.app.fault);
}

static void test_bridge_that_trips_is_a_fault(void)
{
    drive();
    break_flag = 1u << 7;
    model_set(&tim8.sr, break_flag);
    pass(1);
    assert_wheels_at_rest();
    TEST_ASSERT_EQUAL_UINT8(FAULT_BRIDGE, loop.app.fault);
}

static void test_empty_battery_refuses_to_drive_and_nothing_moves(void)
{
    loop_start(&loop, NODE);
    supply(5.0f);
    pass(50);
    frame_t frame;
    hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
    host_sends(&frame);
    upload();
    command(OPERATION_USE_MOTORS);
    heartbeat(0);
    pass(1);
    arm_and_start();
    pass(1);
    never_switched_on();
    TEST_ASSERT_EQUAL_UINT8(FAULT_SUPPLY, loop.app.fault);
}

static void test_wheel_speed_is_measured_over_the_time_that_passed(void)
{
    drive();
    model_set(&tim5.cnt, 800); // a hundredth of a turn in 1 ms
    pass(1);
    TEST_ASSERT_FLOAT_WITHIN(0.5f, 62.8f, loop.app.wheel_speed.value.x);
    model_set(&tim5.cnt, 2400); // two hundredths in 2 ms
    pass_periods(2);
    TEST_ASSERT_FLOAT_WITHIN(0.5f, 62.8f, loop.app.wheel_speed.value.x);
}

// ---- health

static bool was_fed(void)
{
    return model_writes_to(&iwdg.kr) == 1;
}

static void test_watchdog_is_fed_by_each_tick_on_time(void)
{
    start();
    for (int i = 0; i < 10; i++) {
        pass(1);
        TEST_ASSERT_TRUE(was_fed());
        TEST_ASSERT_EQUAL_HEX32(0xAAAA, model_written(&iwdg.kr, 0));
    }
    model_forget();
    loop_turn(&loop); // no tick
    TEST_ASSERT_FALSE(was_fed());
}

static void test_watchdog_is_not_fed_by_a_tick_after_a_missed_one(void)
{
    start();
    pass_periods(2);
    TEST_ASSERT_FALSE(was_fed());
    pass(1);
    TEST_ASSERT_TRUE(was_fed());
}

static void test_watchdog_is_not_fed_by_an_app_out_of_order(void)
{
    start();
    loop.app.mode = MODE_FAULT + 1;
    pass(1);
    TEST_ASSERT_FALSE(was_fed());
    loop.app.mode = MODE_IDLE;
    loop.app.robot = NULL;
    board_count_tick(&loop.board);
    loop.app.port.drive = DRIVE_LOCKSTEP;
    model_forget();
    loop_turn(&loop);
    TEST_ASSERT_FALSE(was_fed());
}

static void test_missed_periods_are_overruns_by_the_timer_and_nothing_in_lockstep(void)
{
    start();
    pass_periods(5);
    TEST_ASSERT_EQUAL_UINT16(0, loop.app.overruns);
    command(OPERATION_USE_REALTIME);
    pass_periods(5);
    TEST_ASSERT_EQUAL_UINT16(4, loop.app.overruns);
}

static void test_step_time_is_told_where_cycles_are_counted(void)
{
    start();
    pass(1);
    TEST_ASSERT_EQUAL_UINT32(0, loop.app.step_times.count); // in lockstep a SYNC is the step
    heartbeat(1);
    TEST_ASSERT_EQUAL_UINT32(1, loop.app.step_times.count);
    command(OPERATION_USE_REALTIME);
    heartbeat(2);
    pass(1); // tick 0 tells and starts anew
    const uint32_t before = loop.app.step_times.count;
    pass(1);
    TEST_ASSERT_EQUAL_UINT32(before + 1, loop.app.step_times.count);
}

static void test_health_tells_counters_and_voltage(void)
{
    start();
    model_set(&can1.esr, 0x05800003);
    loop.board.can.bus_offs = 300;
    atomic_store(&loop.board.can.lost, 7u);
    pass(1);
    const app_health_t *health = &loop.app.health;
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_PASSIVE, health->can_state);
    TEST_ASSERT_EQUAL_UINT8(0x80, health->can_tx_errors);
    TEST_ASSERT_EQUAL_UINT8(5, health->can_rx_errors);
    TEST_ASSERT_EQUAL_UINT8(255, health->can_bus_offs);
    TEST_ASSERT_EQUAL_UINT8(7, health->can_rx_lost);
    TEST_ASSERT_FLOAT_WITHIN(0.02f, 12.0f, health->supply_V);
}

// ---- sleep

static void test_idle_board_sleeps_with_interrupts_masked(void)
{
    start();
    loop_turn(&loop);
    model_forget();
    loop_turn(&loop);
    TEST_ASSERT_EQUAL_STRING("mumwu", model_core_log()); // pump, then sleep
}

static void test_board_does_not_sleep_over_a_tick_or_a_byte(void)
{
    start();
    board_count_tick(&loop.board);
    model_forget();
    board_sleep(&loop.board);
    TEST_ASSERT_EQUAL_STRING("mu", model_core_log());
    loop_turn(&loop);
    TEST_ASSERT_TRUE(ring_put(&loop.board.usart.received, 'V'));
    model_forget();
    board_sleep(&loop.board);
    TEST_ASSERT_EQUAL_STRING("mu", model_core_log());
}

static void test_board_offers_a_memory_for_parameters_where_its_flash_answers(void)
{
    loop_start(&loop, NODE);
    const settings_memory_t *memory = board_settings(&loop.board);
    TEST_ASSERT_NOT_NULL(memory);
    uint8_t word[4];
    model_set(&settings_sectors[1].words[64], 0x04030201);
    TEST_ASSERT_TRUE(memory->read(memory->context, 1, 256, word, sizeof word));
    TEST_ASSERT_EQUAL_HEX8_ARRAY(((uint8_t[]){1, 2, 3, 4}), word, 4);
    TEST_ASSERT_EQUAL_HEX32(0x80000000, model_get(&flash_interface.cr)); // locked

    flash_is_there = false;
    power_on();
    loop_start(&loop, NODE);
    TEST_ASSERT_NULL(board_settings(&loop.board));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_board_offers_a_memory_for_parameters_where_its_flash_answers);
    RUN_TEST(test_first_of_all_the_bridges_are_switched_off);
    RUN_TEST(test_start_leaves_the_bridges_off_and_starts_the_watchdog_last);
    RUN_TEST(test_start_writes_no_peripheral_but_those_it_uses);
    RUN_TEST(test_start_enables_three_interrupts_and_a_tick_of_1_kHz);
    RUN_TEST(test_pins_have_their_functions);
    RUN_TEST(test_without_a_crystal_can_is_left_alone_and_the_uart_serves);
    RUN_TEST(test_emulator_without_a_clock_tree_starts_all_the_same);
    RUN_TEST(test_crash_of_the_run_before_is_told_once);
    RUN_TEST(test_reset_is_asked_for_after_all_else_is_written);
    RUN_TEST(test_motors_are_driven_after_use_motors_and_start);
    RUN_TEST(test_wheels_push_to_the_side_where_the_path_is);
    RUN_TEST(test_key_of_arm_comes_of_the_cycle_counter);
    RUN_TEST(test_motors_stay_off_in_lockstep);
    RUN_TEST(test_stop_brakes_and_switches_off_at_rest);
    RUN_TEST(test_host_that_falls_silent_stops_the_motors);
    RUN_TEST(test_low_battery_stops_the_motors_for_good);
    RUN_TEST(test_3V3_that_sinks_stops_the_motors_at_once);
    RUN_TEST(test_bridge_that_trips_is_a_fault);
    RUN_TEST(test_empty_battery_refuses_to_drive_and_nothing_moves);
    RUN_TEST(test_wheel_speed_is_measured_over_the_time_that_passed);
    RUN_TEST(test_watchdog_is_fed_by_each_tick_on_time);
    RUN_TEST(test_watchdog_is_not_fed_by_a_tick_after_a_missed_one);
    RUN_TEST(test_watchdog_is_not_fed_by_an_app_out_of_order);
    RUN_TEST(test_missed_periods_are_overruns_by_the_timer_and_nothing_in_lockstep);
    RUN_TEST(test_step_time_is_told_where_cycles_are_counted);
    RUN_TEST(test_health_tells_counters_and_voltage);
    RUN_TEST(test_idle_board_sleeps_with_interrupts_masked);
    RUN_TEST(test_board_does_not_sleep_over_a_tick_or_a_byte);
    return UNITY_END();
}
