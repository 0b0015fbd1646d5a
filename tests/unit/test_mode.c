// SPDX-License-Identifier: MIT
// Every mode and event against a table of its own: what moves, by name; everything else stays.
#include "mode.h"

#include "messages.h"
#include "unity.h"

#include <stddef.h>
#include <stdio.h>

enum { MODES = 4 };

static const char *const mode_name[MODES] = {"BOOT", "IDLE", "TRACKING", "FAULT"};
static const char *const event_name[EVENT_COUNT] = {"READY", "START", "STOP", "CLEAR", "RESTART", "FAULT"};

/// All the moves there are.
static const struct {
    uint8_t from;
    event_t event;
    uint8_t to;
} moves[] = {
    {MODE_BOOT, EVENT_READY, MODE_IDLE},      {MODE_IDLE, EVENT_START, MODE_TRACKING},
    {MODE_TRACKING, EVENT_STOP, MODE_IDLE},   {MODE_TRACKING, EVENT_RESTART, MODE_IDLE},
    {MODE_BOOT, EVENT_FAULT, MODE_FAULT},     {MODE_IDLE, EVENT_FAULT, MODE_FAULT},
    {MODE_TRACKING, EVENT_FAULT, MODE_FAULT}, {MODE_FAULT, EVENT_CLEAR, MODE_IDLE},
};

void setUp(void)
{
}

void tearDown(void)
{
}

static uint8_t expected_after(uint8_t mode, event_t event)
{
    for (size_t i = 0; i < sizeof moves / sizeof moves[0]; i++) {
        if (moves[i].from == mode && moves[i].event == event) {
            return moves[i].to;
        }
    }
    return mode;
}

static void test_mode_numbers_are_those_of_the_wire(void)
{
    TEST_ASSERT_EQUAL_UINT8(0, MODE_BOOT);
    TEST_ASSERT_EQUAL_UINT8(1, MODE_IDLE);
    TEST_ASSERT_EQUAL_UINT8(2, MODE_TRACKING);
    TEST_ASSERT_EQUAL_UINT8(3, MODE_FAULT);
}

static void test_mode_after_every_event_in_every_mode_is_as_tabled(void)
{
    for (uint8_t mode = 0; mode < MODES; mode++) {
        for (int event = 0; event < EVENT_COUNT; event++) {
            char message[48];
            (void)snprintf(message, sizeof message, "%s after %s", mode_name[mode], event_name[event]);

            TEST_ASSERT_EQUAL_UINT8_MESSAGE(expected_after(mode, (event_t)event), mode_after(mode, (event_t)event),
                                            message);
        }
    }
}

static void test_mode_fault_is_left_by_clear_alone(void)
{
    for (int event = 0; event < EVENT_COUNT; event++) {
        if (event != EVENT_CLEAR) {
            TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, mode_after(MODE_FAULT, (event_t)event));
        }
    }
}

static void test_mode_tracking_is_reached_by_start_from_idle_alone(void)
{
    for (uint8_t mode = 0; mode < MODES; mode++) {
        for (int event = 0; event < EVENT_COUNT; event++) {
            const bool reached = mode != MODE_TRACKING && mode_after(mode, (event_t)event) == MODE_TRACKING;
            TEST_ASSERT_EQUAL(mode == MODE_IDLE && event == EVENT_START, reached);
        }
    }
}

static void test_mode_drives_in_tracking_alone(void)
{
    for (uint32_t mode = 0; mode < 256; mode++) {
        TEST_ASSERT_EQUAL(mode == MODE_TRACKING, mode_drives((uint8_t)mode));
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_mode_numbers_are_those_of_the_wire);
    RUN_TEST(test_mode_after_every_event_in_every_mode_is_as_tabled);
    RUN_TEST(test_mode_fault_is_left_by_clear_alone);
    RUN_TEST(test_mode_tracking_is_reached_by_start_from_idle_alone);
    RUN_TEST(test_mode_drives_in_tracking_alone);
    return UNITY_END();
}
