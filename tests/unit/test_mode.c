// SPDX-License-Identifier: MIT
// Every event in every mode, against a table written by hand from protocol/README.md; and what follows from it.
#include "mode.h"

#include "messages.h"
#include "unity.h"

void setUp(void)
{
}

void tearDown(void)
{
}

enum { MODES = 6 };

static const uint8_t all_modes[MODES] = {MODE_BOOT, MODE_IDLE, MODE_ARMED, MODE_TRACKING, MODE_STOPPING, MODE_FAULT};

enum { B = MODE_BOOT, I = MODE_IDLE, A = MODE_ARMED, T = MODE_TRACKING, S = MODE_STOPPING, F = MODE_FAULT };

static const struct {
    event_t event;
    uint8_t after[MODES]; // from BOOT, IDLE, ARMED, TRACKING, STOPPING, FAULT
} rows[] = {
    {EVENT_READY, {I, I, A, T, S, F}},           {EVENT_ARM, {B, A, A, T, S, F}},   {EVENT_START, {B, I, T, T, S, F}},
    {EVENT_LAPSE, {B, I, I, T, S, F}},           {EVENT_STOP, {B, I, I, S, S, F}},  {EVENT_REST, {B, I, A, T, I, F}},
    {EVENT_REST_WITH_FAULT, {B, I, A, T, F, F}}, {EVENT_CLEAR, {B, I, A, T, S, I}}, {EVENT_RESTART, {B, I, I, I, I, F}},
    {EVENT_BRAKE, {F, F, F, S, S, F}},           {EVENT_CUT, {F, F, F, F, F, F}},
};

static void test_mode_after_every_event_in_every_mode_is_as_tabled(void)
{
    TEST_ASSERT_EQUAL(EVENT_COUNT, sizeof rows / sizeof rows[0]);
    for (int event = 0; event < EVENT_COUNT; event++) {
        TEST_ASSERT_EQUAL(event, rows[event].event);
        for (int mode = 0; mode < MODES; mode++) {
            TEST_ASSERT_EQUAL_UINT8(rows[event].after[mode], mode_after(all_modes[mode], rows[event].event));
        }
    }
}

static void test_mode_tracking_is_reached_by_start_from_armed_alone(void)
{
    for (int event = 0; event < EVENT_COUNT; event++) {
        for (int mode = 0; mode < MODES; mode++) {
            if (all_modes[mode] != MODE_TRACKING && mode_after(all_modes[mode], (event_t)event) == MODE_TRACKING) {
                TEST_ASSERT_EQUAL(EVENT_START, event);
                TEST_ASSERT_EQUAL_UINT8(MODE_ARMED, all_modes[mode]);
            }
        }
    }
}

static void test_mode_fault_is_left_by_clear_alone(void)
{
    for (int event = 0; event < EVENT_COUNT; event++) {
        TEST_ASSERT_EQUAL(event == EVENT_CLEAR, mode_after(MODE_FAULT, (event_t)event) != MODE_FAULT);
    }
}

static void test_mode_drives_in_tracking_and_stopping_alone(void)
{
    for (int mode = 0; mode < MODES; mode++) {
        const bool drives = all_modes[mode] == MODE_TRACKING || all_modes[mode] == MODE_STOPPING;
        TEST_ASSERT_EQUAL(drives, mode_drives(all_modes[mode]));
    }
}

static void test_mode_is_safe_where_it_neither_drives_nor_may_start_to(void)
{
    for (int mode = 0; mode < MODES; mode++) {
        const bool starts = mode_drives(mode_after(all_modes[mode], EVENT_START));
        TEST_ASSERT_EQUAL(!starts, mode_is_safe(all_modes[mode]));
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_mode_after_every_event_in_every_mode_is_as_tabled);
    RUN_TEST(test_mode_tracking_is_reached_by_start_from_armed_alone);
    RUN_TEST(test_mode_fault_is_left_by_clear_alone);
    RUN_TEST(test_mode_drives_in_tracking_and_stopping_alone);
    RUN_TEST(test_mode_is_safe_where_it_neither_drives_nor_may_start_to);
    return UNITY_END();
}
