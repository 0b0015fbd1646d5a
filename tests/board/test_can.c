// SPDX-License-Identifier: MIT
// bxCAN against a controller that may not answer, whose mailboxes stay full, whose FIFOs run over, and that leaves the
// bus. Bits and order are those of RM0090, chapter 32; what passes the filters is worked out here from the registers.
#include "can.h"

#include "messages.h"
#include "model.h"
#include "unity.h"

#include <string.h>

enum { NODE = 5, APB1_HZ = 42000000, INRQ = 1, SLEEP = 2, INAK = 1, SLAK = 2 };
#define TME_ALL (7u << 26)

static can_t can;
static bool answers; // acknowledges initialisation mode
static bool stays;   // does not leave it again

static uint32_t on_mcr(uint32_t value)
{
    uint32_t state = model_get(&can1.msr) & ~(uint32_t)(INAK | SLAK);
    if (answers && ((value & INRQ) != 0 || stays)) {
        state |= INAK;
    }
    if ((value & SLEEP) != 0 || !answers) {
        state |= SLAK;
    }
    model_set(&can1.msr, state);
    return value;
}

/// Mailboxes: a request takes them, an abort gives them back.
static uint32_t hardware(reg_t *reg, uint32_t value)
{
    if (reg == &can1.mcr) {
        return on_mcr(value);
    }
    for (uint32_t mailbox = 0; mailbox < 3; mailbox++) {
        if (reg == &can1.tx[mailbox].ir && (value & 1u) != 0) {
            model_set(&can1.tsr, model_get(&can1.tsr) & ~(1u << (26 + mailbox)));
        }
        if (reg == &can1.tsr && (value & 1u << (8 * mailbox + 7)) != 0) {
            return (model_get(&can1.tsr) | 1u << (26 + mailbox));
        }
    }
    return value;
}

static void deliver(uint32_t mailbox)
{
    model_set(&can1.tsr, model_get(&can1.tsr) | 1u << (26 + mailbox));
}

void setUp(void)
{
    model_reset();
    model_on_write(hardware);
    model_set(&can1.mcr, 0x10002); // out of reset
    model_set(&can1.msr, 0xC02);
    model_set(&can1.tsr, TME_ALL);
    answers = true;
    stays = false;
    memset(&can, 0, sizeof can);
}

void tearDown(void)
{
    static const char *const own[] = {"can1", NULL};
    model_assert_wrote_only(own);
}

static void start_running(void)
{
    TEST_ASSERT_TRUE(can_start(&can, &can1, APB1_HZ, NODE));
    can_tick(&can);
    TEST_ASSERT_EQUAL(CAN_RUNNING, can.phase);
    model_forget();
}

static frame_t frame_of(uint16_t id, uint8_t length)
{
    frame_t frame = {.id = id, .length = length};
    for (uint8_t i = 0; i < length; i++) {
        frame.data[i] = (uint8_t)(0x11 * (i + 1));
    }
    return frame;
}

static bool send(uint16_t id)
{
    const frame_t frame = frame_of(id, 8);
    return can_send(&can, &frame);
}

static void set_bus_off(bool off)
{
    model_set(&can1.esr, off ? 1u << 2 | 1u << 1 | 1u : 0);
}

static void ticks(uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        can_tick(&can);
    }
}

// ---- set-up

/// 42 MHz / 3 / (1 + 11 + 2) is 1 Mbit/s, sampled at 12/14; each field is one less than it means.
static void test_bit_timing_is_1_Mbit_sampled_at_86_percent(void)
{
    start_running();
    const uint32_t btr = model_get(&can1.btr);
    const uint32_t prescaler = (btr & 0x3FFu) + 1, ts1 = (btr >> 16 & 15u) + 1, ts2 = (btr >> 20 & 7u) + 1;
    TEST_ASSERT_EQUAL_UINT32(1000000, APB1_HZ / (prescaler * (1 + ts1 + ts2)));
    TEST_ASSERT_EQUAL_UINT32(857, 1000 * (1 + ts1) / (1 + ts1 + ts2));
    TEST_ASSERT_EQUAL_HEX32(0x011A0002, btr); // SJW 2; neither loop-back nor silent
}

static void test_timing_and_filters_are_set_in_initialisation_mode(void)
{
    TEST_ASSERT_TRUE(can_start(&can, &can1, APB1_HZ, NODE));
    const uint32_t in = model_first_write(&can1.mcr, INRQ);
    TEST_ASSERT_EQUAL_UINT32(0, in);
    TEST_ASSERT_BITS_LOW(SLEEP, model_written(&can1.mcr, 0));
    TEST_ASSERT_EQUAL_UINT32(2, model_writes_to(&can1.mcr));
    TEST_ASSERT_EQUAL_PTR(&can1.mcr, model_write(model_writes() - 1).reg); // leaving it comes last
    TEST_ASSERT_GREATER_THAN_UINT32(in, model_first_write(&can1.btr, 0));
}

static void test_options_are_priority_by_identifier_and_no_automatic_bus_on(void)
{
    start_running();
    TEST_ASSERT_EQUAL_HEX32(0x10000, model_get(&can1.mcr)); // no TXFP, ABOM, NART, RFLM; frozen with the core
}

static void test_controller_that_does_not_answer_is_absent(void)
{
    answers = false;
    TEST_ASSERT_FALSE(can_start(&can, &can1, APB1_HZ, NODE));
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_ABSENT, can_condition(&can).state);
    TEST_ASSERT_UINT32_WITHIN(100, 42000, model_reads_of(&can1.msr)); // 1 ms at 168 MHz, four cycles a poll
    model_forget();
    TEST_ASSERT_TRUE(send(0x050));
    can_withdraw(&can);
    ticks(1000);
    TEST_ASSERT_EQUAL_UINT32(0, model_accesses());
}

static void test_another_bus_clock_is_refused_without_an_access(void)
{
    TEST_ASSERT_FALSE(can_start(&can, &can1, 16000000, NODE));
    TEST_ASSERT_EQUAL_UINT32(0, model_accesses());
}

/// What RM0090 32.7.4 says of a mask: a bit that is 1 must agree. FIFO that takes the frame; 2 for none, 3 for two
/// banks.
static uint32_t fifo_of(uint16_t id, bool extended, bool remote)
{
    const uint32_t word = (uint32_t)id << 21 | (extended ? 4u : 0) | (remote ? 2u : 0);
    uint32_t fifo = 2;
    for (uint32_t bank = 0; bank < 28; bank++) {
        if ((model_get(&can1.fa1r) & 1u << bank) == 0) {
            continue;
        }
        TEST_ASSERT_BITS_HIGH(1u << bank, model_get(&can1.fs1r)); // one filter of 32 bits
        TEST_ASSERT_BITS_LOW(1u << bank, model_get(&can1.fm1r));  // identifier and mask
        if (((word ^ model_get(&can1.filter[bank].r1)) & model_get(&can1.filter[bank].r2)) == 0) {
            fifo = fifo == 2 ? model_get(&can1.ffa1r) >> bank & 1u : 3;
        }
    }
    return fifo;
}

static void test_filters_take_our_node_alone_and_the_loop_apart(void)
{
    for (uint8_t node = 0; node < 16; node++) {
        setUp();
        TEST_ASSERT_TRUE(can_start(&can, &can1, APB1_HZ, node));
        TEST_ASSERT_BITS_LOW(1u, model_get(&can1.fmr)); // filters in force
        for (uint16_t id = 0; id < 0x800; id++) {
            const uint32_t expected = (id & 15) != node ? 2 : id < 0x100 ? 0 : 1;
            TEST_ASSERT_EQUAL_UINT32_MESSAGE(expected, fifo_of(id, false, false), "identifier");
        }
        TEST_ASSERT_EQUAL_UINT32(2, fifo_of(0x040u | node, true, false));
        TEST_ASSERT_EQUAL_UINT32(2, fifo_of(0x040u | node, false, true));
    }
}

static void test_joining_lasts_until_the_bus_has_been_quiet(void)
{
    stays = true;
    TEST_ASSERT_TRUE(can_start(&can, &can1, APB1_HZ, NODE));
    ticks(1000);
    TEST_ASSERT_EQUAL(CAN_JOINING, can.phase);
    TEST_ASSERT_FALSE(send(0x050)); // kept by the caller
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_BUS_OFF, can_condition(&can).state);
    model_set(&can1.msr, 0);
    ticks(1);
    TEST_ASSERT_EQUAL(CAN_RUNNING, can.phase);
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_ACTIVE, can_condition(&can).state);
}

// ---- sending

static void test_frame_is_written_before_it_is_requested(void)
{
    start_running();
    const frame_t frame = frame_of(0x055, 8);
    TEST_ASSERT_TRUE(can_send(&can, &frame));
    TEST_ASSERT_EQUAL_UINT32(4, model_writes());
    const access_t request = model_write(3);
    const can_mailbox_registers_t *mailbox = &can1.tx[2];
    TEST_ASSERT_EQUAL_PTR(&mailbox->ir, request.reg);
    TEST_ASSERT_EQUAL_HEX32(0x055u << 21 | 1u, request.value);
    TEST_ASSERT_EQUAL_HEX32(8, model_get(&mailbox->dtr));
    TEST_ASSERT_EQUAL_HEX32(0x44332211, model_get(&mailbox->dlr));
    TEST_ASSERT_EQUAL_HEX32(0x88776655, model_get(&mailbox->dhr));
}

static void test_full_mailboxes_make_the_next_frame_wait(void)
{
    start_running();
    TEST_ASSERT_TRUE(send(0x055));
    TEST_ASSERT_TRUE(send(0x065));
    TEST_ASSERT_TRUE(send(0x105));
    model_forget();
    TEST_ASSERT_FALSE(send(0x115));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes());
    deliver(1);
    TEST_ASSERT_TRUE(send(0x115));
    TEST_ASSERT_EQUAL_HEX32(0x115u << 21 | 1u, model_get(&can1.tx[1].ir));
}

static void test_frame_does_not_overtake_one_of_its_identifier(void)
{
    start_running();
    TEST_ASSERT_TRUE(send(0x325));
    TEST_ASSERT_FALSE(send(0x325));
    TEST_ASSERT_TRUE(send(0x055)); // others do not wait for it
    deliver(2);
    TEST_ASSERT_TRUE(send(0x325));
}

static void test_frame_that_nobody_acknowledges_is_taken_back(void)
{
    start_running();
    TEST_ASSERT_TRUE(send(0x055));
    ticks(CAN_SEND_TICKS_MAX);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&can1.tsr));
    ticks(1);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&can1.tsr));
    TEST_ASSERT_EQUAL_HEX32(1u << 23, model_written(&can1.tsr, 0)); // ABRQ2 alone: the other flags are cleared by ones
    TEST_ASSERT_EQUAL_UINT32(1, can.unsent);
    TEST_ASSERT_TRUE(send(0x055));
    ticks(CAN_SEND_TICKS_MAX);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&can1.tsr)); // its time began anew
}

static void test_withdraw_aborts_what_is_pending_alone(void)
{
    start_running();
    TEST_ASSERT_TRUE(send(0x055));
    TEST_ASSERT_TRUE(send(0x065));
    deliver(2);
    model_forget();
    can_withdraw(&can);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes());
    TEST_ASSERT_EQUAL_HEX32(1u << 15, model_written(&can1.tsr, 0));
}

// ---- receiving

static void arrive(uint32_t fifo, uint16_t id, uint32_t length_code)
{
    model_set(&can1.rfr[fifo], 1);
    model_set(&can1.rx[fifo].ir, (uint32_t)id << 21);
    model_set(&can1.rx[fifo].dtr, 0xABCD0700u | length_code); // time stamp and filter number besides
    model_set(&can1.rx[fifo].dlr, 0x44332211);
    model_set(&can1.rx[fifo].dhr, 0x88776655);
    can_interrupt(&can, fifo);
}

static void test_received_frame_is_read_and_released(void)
{
    frame_t frame;
    start_running();
    for (uint32_t fifo = 0; fifo < 2; fifo++) {
        arrive(fifo, 0x045, 6);
        TEST_ASSERT_EQUAL_HEX32(1u << 5, model_written(&can1.rfr[fifo], 0)); // RFOM alone
        TEST_ASSERT_TRUE(can_receive(&can, &frame));
        TEST_ASSERT_EQUAL_HEX16(0x045, frame.id);
        TEST_ASSERT_EQUAL_UINT8(6, frame.length);
        static const uint8_t expected[8] = {0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0, 0};
        TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, frame.data, 8);
        TEST_ASSERT_FALSE(can_receive(&can, &frame));
    }
}

static void test_length_codes_above_eight_mean_eight(void)
{
    frame_t frame;
    start_running();
    for (uint32_t code = 8; code < 16; code++) {
        arrive(0, 0x045, code);
        TEST_ASSERT_TRUE(can_receive(&can, &frame));
        TEST_ASSERT_EQUAL_UINT8(8, frame.length);
        TEST_ASSERT_EQUAL_HEX8(0x88, frame.data[7]);
    }
}

static void test_interrupt_without_a_frame_releases_nothing(void)
{
    start_running();
    can_interrupt(&can, 0);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes());
    TEST_ASSERT_FALSE(can_has_received(&can));
}

static void test_overrun_of_a_fifo_is_counted_and_cleared(void)
{
    start_running();
    model_set(&can1.rfr[0], 3u | 1u << 3 | 1u << 4); // three frames, full, overrun
    can_interrupt(&can, 0);
    TEST_ASSERT_EQUAL_UINT32(1, can.lost);
    TEST_ASSERT_EQUAL_HEX32(1u << 4, model_written(&can1.rfr[0], 0));
    TEST_ASSERT_EQUAL_HEX32(1u << 5, model_written(&can1.rfr[0], 1));
    TEST_ASSERT_TRUE(can_has_received(&can)); // the frame that was there is taken all the same
}

static void test_frames_beyond_the_ring_are_counted_and_the_first_kept(void)
{
    frame_t frame;
    start_running();
    for (uint16_t i = 0; i < CAN_RECEIVED_FRAMES + 3; i++) {
        arrive(0, (uint16_t)(i << 4 | NODE), 8);
    }
    TEST_ASSERT_EQUAL_UINT32(3, can.lost);
    for (uint16_t i = 0; i < CAN_RECEIVED_FRAMES; i++) {
        TEST_ASSERT_TRUE(can_receive(&can, &frame));
        TEST_ASSERT_EQUAL_HEX16(i << 4 | NODE, frame.id);
    }
    TEST_ASSERT_FALSE(can_receive(&can, &frame));
}

// ---- errors

static void test_error_counters_and_states_are_told(void)
{
    static const struct {
        uint32_t esr;
        uint8_t state, transmit, receive;
    } cases[] = {
        {0x00000000, CAN_STATE_ACTIVE, 0, 0},
        {0x60600001, CAN_STATE_WARNING, 0x60, 0x60},
        {0x05800003, CAN_STATE_PASSIVE, 0x80, 5},
        {0x00FF0007, CAN_STATE_BUS_OFF, 0xFF, 0},
    };
    start_running();
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        model_set(&can1.esr, cases[i].esr);
        const can_condition_t condition = can_condition(&can);
        TEST_ASSERT_EQUAL_UINT8(cases[i].state, condition.state);
        TEST_ASSERT_EQUAL_UINT8(cases[i].transmit, condition.transmit_errors);
        TEST_ASSERT_EQUAL_UINT8(cases[i].receive, condition.receive_errors);
    }
}

static void test_error_passive_goes_on_sending(void)
{
    start_running();
    model_set(&can1.esr, 0x00800003);
    ticks(10);
    TEST_ASSERT_EQUAL(CAN_RUNNING, can.phase);
    TEST_ASSERT_TRUE(send(0x055));
    TEST_ASSERT_EQUAL_UINT32(4, model_writes());
}

static void test_bus_off_withdraws_holds_off_and_returns(void)
{
    start_running();
    TEST_ASSERT_TRUE(send(0x055));
    set_bus_off(true);
    ticks(1);
    TEST_ASSERT_EQUAL_UINT32(1, can.bus_offs);
    TEST_ASSERT_EQUAL_HEX32(1u << 23, model_written(&can1.tsr, 0));
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_BUS_OFF, can_condition(&can).state);
    ticks(CAN_BUS_OFF_TICKS - 1);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&can1.mcr));
    ticks(1);
    TEST_ASSERT_EQUAL_HEX32(INRQ, model_written(&can1.mcr, 0) & INRQ); // in, and at the next tick out again
    ticks(1);
    TEST_ASSERT_EQUAL_HEX32(0, model_written(&can1.mcr, 1) & INRQ);
    ticks(5);
    TEST_ASSERT_EQUAL(CAN_JOINING, can.phase); // 128 times 11 recessive bits are not over yet
    set_bus_off(false);
    ticks(1);
    TEST_ASSERT_EQUAL(CAN_RUNNING, can.phase);
    TEST_ASSERT_EQUAL_UINT32(1, can.bus_offs);
    TEST_ASSERT_TRUE(send(0x055));
}

static void test_frames_given_off_the_bus_are_dropped_and_counted(void)
{
    start_running();
    set_bus_off(true);
    ticks(1);
    model_forget();
    for (uint32_t i = 0; i < 5; i++) {
        TEST_ASSERT_TRUE(send(0x055));
    }
    TEST_ASSERT_EQUAL_UINT32(5, can.unsent);
    TEST_ASSERT_EQUAL_UINT32(0, model_writes());
}

static void test_controller_that_will_not_restart_waits_without_a_loop(void)
{
    start_running();
    set_bus_off(true);
    answers = false;
    ticks(1 + CAN_BUS_OFF_TICKS);
    model_forget();
    ticks(1000);
    TEST_ASSERT_EQUAL(CAN_RESTARTING, can.phase);
    TEST_ASSERT_EQUAL_UINT32(1000, model_accesses()); // one look a period
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_bit_timing_is_1_Mbit_sampled_at_86_percent);
    RUN_TEST(test_timing_and_filters_are_set_in_initialisation_mode);
    RUN_TEST(test_options_are_priority_by_identifier_and_no_automatic_bus_on);
    RUN_TEST(test_controller_that_does_not_answer_is_absent);
    RUN_TEST(test_another_bus_clock_is_refused_without_an_access);
    RUN_TEST(test_filters_take_our_node_alone_and_the_loop_apart);
    RUN_TEST(test_joining_lasts_until_the_bus_has_been_quiet);
    RUN_TEST(test_frame_is_written_before_it_is_requested);
    RUN_TEST(test_full_mailboxes_make_the_next_frame_wait);
    RUN_TEST(test_frame_does_not_overtake_one_of_its_identifier);
    RUN_TEST(test_frame_that_nobody_acknowledges_is_taken_back);
    RUN_TEST(test_withdraw_aborts_what_is_pending_alone);
    RUN_TEST(test_received_frame_is_read_and_released);
    RUN_TEST(test_length_codes_above_eight_mean_eight);
    RUN_TEST(test_interrupt_without_a_frame_releases_nothing);
    RUN_TEST(test_overrun_of_a_fifo_is_counted_and_cleared);
    RUN_TEST(test_frames_beyond_the_ring_are_counted_and_the_first_kept);
    RUN_TEST(test_error_counters_and_states_are_told);
    RUN_TEST(test_error_passive_goes_on_sending);
    RUN_TEST(test_bus_off_withdraws_holds_off_and_returns);
    RUN_TEST(test_frames_given_off_the_bus_are_dropped_and_counted);
    RUN_TEST(test_controller_that_will_not_restart_waits_without_a_loop);
    return UNITY_END();
}
