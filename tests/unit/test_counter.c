// SPDX-License-Identifier: MIT
// Counters around the largest value that they can hold.
#include "counter.h"

#include "unity.h"

void setUp(void)
{
}

void tearDown(void)
{
}

static void test_sum_is_exact_up_to_the_largest_value(void)
{
    TEST_ASSERT_EQUAL_UINT32(0, counter_sum(0, 0));
    TEST_ASSERT_EQUAL_UINT32(7, counter_sum(3, 4));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX - 1, counter_sum(UINT32_MAX - 3, 2));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, counter_sum(UINT32_MAX - 3, 3));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, counter_sum(0, UINT32_MAX));
}

static void test_sum_past_the_largest_value_stays_there(void)
{
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, counter_sum(UINT32_MAX - 3, 4));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, counter_sum(UINT32_MAX, 1));
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, counter_sum(UINT32_MAX, UINT32_MAX));
}

static void assert_added(uint16_t expected, uint16_t from, uint32_t more)
{
    uint16_t counter = from;
    counter_add(&counter, more);
    TEST_ASSERT_EQUAL_UINT16(expected, counter);
}

static void test_counter_is_exact_up_to_the_largest_value(void)
{
    assert_added(0, 0, 0);
    assert_added(7, 3, 4);
    assert_added(UINT16_MAX - 1, UINT16_MAX - 2, 1);
    assert_added(UINT16_MAX, UINT16_MAX - 2, 2);
}

static void test_counter_past_the_largest_value_stays_there(void)
{
    assert_added(UINT16_MAX, UINT16_MAX - 2, 3);
    assert_added(UINT16_MAX, UINT16_MAX, 1);
    assert_added(UINT16_MAX, 5, UINT32_MAX);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_sum_is_exact_up_to_the_largest_value);
    RUN_TEST(test_sum_past_the_largest_value_stays_there);
    RUN_TEST(test_counter_is_exact_up_to_the_largest_value);
    RUN_TEST(test_counter_past_the_largest_value_stays_there);
    return UNITY_END();
}
