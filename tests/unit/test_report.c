// SPDX-License-Identifier: MIT
#include "app.h"
#include "report.h"
#include "unity.h"

static app_t app;

void setUp(void)
{
    app = (app_t){0};
}

void tearDown(void)
{
}

static void test_step_times_keep_the_least_and_the_most_in_any_order(void)
{
    static const uint32_t step_ns[] = {9000, 7000, 20000, 8000};

    for (int i = 0; i < 4; i++) {
        app_note_step_time(&app, step_ns[i]);
    }

    TEST_ASSERT_EQUAL_UINT32(7000, app.step_times.min_ns);
    TEST_ASSERT_EQUAL_UINT32(20000, app.step_times.max_ns);
    TEST_ASSERT_EQUAL_UINT32(44000, app.step_times.sum_ns);
    TEST_ASSERT_EQUAL_UINT32(4, app.step_times.count);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_step_times_keep_the_least_and_the_most_in_any_order);
    return UNITY_END();
}
