// SPDX-License-Identifier: MIT
// The USART against a transmitter that is busy, and bytes that come damaged or too fast. Bits are those of RM0090 30.6.
#include "usart.h"

#include "model.h"
#include "unity.h"

#include <string.h>

enum { RXNE = 1 << 5, TXE = 1 << 7, ORE = 1 << 3, FE = 1 << 1, NF = 1 << 2, PE = 1 << 0, TXEIE = 1 << 7 };

static usart_t usart;
static uint32_t takes; // bytes that the transmitter takes before it is full

static uint32_t hardware(reg_t *reg, uint32_t value)
{
    if (reg == &usart1.dr && --takes == 0) {
        model_set(&usart1.sr, model_get(&usart1.sr) & ~(uint32_t)TXE);
    }
    return value;
}

void setUp(void)
{
    model_reset();
    model_on_write(hardware);
    memset(&usart, 0, sizeof usart);
    usart_start(&usart, &usart1, 84000000, 1000000);
    model_set(&usart1.sr, TXE);
    takes = 1;
}

void tearDown(void)
{
    static const char *const own[] = {"usart1", NULL};
    model_assert_wrote_only(own);
}

static void arrive(uint8_t byte, uint32_t status)
{
    model_set(&usart1.sr, status);
    model_set(&usart1.dr, byte);
    usart_interrupt(&usart);
}

/// The divider counts sixteenths of a sample at sixteen samples a bit: 84 MHz / 84 and 16 MHz / 16 are 1 Mbit/s.
static void test_rate_and_form_are_set(void)
{
    TEST_ASSERT_EQUAL_UINT32(84, model_get(&usart1.brr));
    TEST_ASSERT_EQUAL_HEX32(1u << 13 | 1u << 5 | 1u << 3 | 1u << 2, model_get(&usart1.cr1)); // 8 bits, no parity
    usart_start(&usart, &usart1, 16000000, 1000000);
    TEST_ASSERT_EQUAL_UINT32(16, model_get(&usart1.brr));
    usart_start(&usart, &usart1, 84000000, 115200);
    TEST_ASSERT_EQUAL_UINT32(729, model_get(&usart1.brr)); // 729.17
}

static void test_bytes_come_through_in_order(void)
{
    uint8_t byte;
    for (uint32_t i = 0; i < 256; i++) {
        arrive((uint8_t)i, RXNE);
    }
    for (uint32_t i = 0; i < 256; i++) {
        TEST_ASSERT_TRUE(usart_receive(&usart, &byte));
        TEST_ASSERT_EQUAL_HEX8(i, byte);
    }
    TEST_ASSERT_FALSE(usart_receive(&usart, &byte));
    TEST_ASSERT_EQUAL_UINT32(0, usart.lost_bytes);
}

static void test_damaged_bytes_are_counted_and_not_kept(void)
{
    static const uint32_t damage[] = {FE, NF, PE};
    for (uint32_t i = 0; i < 3; i++) {
        arrive(0x55, RXNE | damage[i]);
        TEST_ASSERT_EQUAL_UINT32(i + 1, usart.lost_bytes);
        TEST_ASSERT_FALSE(usart_has_received(&usart));
    }
}

static void test_overrun_keeps_the_byte_before_it_and_counts_the_lost_one(void)
{
    uint8_t byte;
    arrive(0x55, RXNE | ORE);
    TEST_ASSERT_EQUAL_UINT32(1, usart.lost_bytes);
    TEST_ASSERT_TRUE(usart_receive(&usart, &byte));
    TEST_ASSERT_EQUAL_HEX8(0x55, byte);
}

static void test_overrun_without_a_byte_keeps_nothing(void)
{
    arrive(0x55, ORE);
    TEST_ASSERT_EQUAL_UINT32(1, usart.lost_bytes);
    TEST_ASSERT_FALSE(usart_has_received(&usart));
    TEST_ASSERT_EQUAL_UINT32(1, model_reads_of(&usart1.dr)); // which clears it
}

static void test_full_ring_keeps_the_first_and_counts_the_rest(void)
{
    uint8_t byte;
    for (uint32_t i = 0; i < RING_BYTES + 7; i++) {
        arrive((uint8_t)(i % 251), RXNE);
    }
    TEST_ASSERT_EQUAL_UINT32(7, usart.lost_bytes);
    for (uint32_t i = 0; i < RING_BYTES; i++) {
        TEST_ASSERT_TRUE(usart_receive(&usart, &byte));
        TEST_ASSERT_EQUAL_HEX8(i % 251, byte);
    }
}

static void test_sending_asks_for_the_interrupt_which_asks_no_more_when_all_is_sent(void)
{
    TEST_ASSERT_TRUE(usart_send(&usart, 0x41));
    TEST_ASSERT_BITS_HIGH(TXEIE, model_get(&usart1.cr1));
    takes = 2;
    usart_interrupt(&usart);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&usart1.dr));
    TEST_ASSERT_EQUAL_HEX32(0x41, model_written(&usart1.dr, 0));
    TEST_ASSERT_BITS_LOW(TXEIE, model_get(&usart1.cr1));
    TEST_ASSERT_BITS_HIGH(1u << 5, model_get(&usart1.cr1)); // receiving goes on
}

static void test_busy_transmitter_gets_no_byte(void)
{
    usart_send(&usart, 0x41);
    usart_send(&usart, 0x42);
    usart_interrupt(&usart);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&usart1.dr));
    usart_interrupt(&usart);
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&usart1.dr));
    model_set(&usart1.sr, TXE);
    takes = 1;
    usart_interrupt(&usart);
    TEST_ASSERT_EQUAL_HEX32(0x42, model_written(&usart1.dr, 1));
}

static void test_interrupt_is_bounded_even_if_the_transmitter_takes_all(void)
{
    takes = UINT32_MAX;
    for (uint32_t i = 0; i < RING_BYTES; i++) {
        usart_send(&usart, 0x41);
    }
    usart_interrupt(&usart);
    TEST_ASSERT_EQUAL_UINT32(USART_BYTES_PER_INTERRUPT, model_writes_to(&usart1.dr));
}

static void test_full_output_ring_refuses(void)
{
    for (uint32_t i = 0; i < RING_BYTES; i++) {
        TEST_ASSERT_TRUE(usart_has_room(&usart));
        TEST_ASSERT_TRUE(usart_send(&usart, (uint8_t)i));
    }
    TEST_ASSERT_FALSE(usart_has_room(&usart));
    TEST_ASSERT_FALSE(usart_send(&usart, 0));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_rate_and_form_are_set);
    RUN_TEST(test_bytes_come_through_in_order);
    RUN_TEST(test_damaged_bytes_are_counted_and_not_kept);
    RUN_TEST(test_overrun_keeps_the_byte_before_it_and_counts_the_lost_one);
    RUN_TEST(test_overrun_without_a_byte_keeps_nothing);
    RUN_TEST(test_full_ring_keeps_the_first_and_counts_the_rest);
    RUN_TEST(test_sending_asks_for_the_interrupt_which_asks_no_more_when_all_is_sent);
    RUN_TEST(test_busy_transmitter_gets_no_byte);
    RUN_TEST(test_interrupt_is_bounded_even_if_the_transmitter_takes_all);
    RUN_TEST(test_full_output_ring_refuses);
    return UNITY_END();
}
