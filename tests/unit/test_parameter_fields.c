// SPDX-License-Identifier: MIT
// What PARAMETER_GET may ask for: each field of each kind of parameter against firmware/robot/omnibot.toml, read by
// eye, and texts in parts of six characters.
#include "app.h"

#include "messages.h"
#include "unity.h"

#include <string.h>

enum { NODE = 3 };

static app_t app;
static parameter_value_message_t value;
static parameter_text_message_t text;
static int values, texts;

void setUp(void)
{
    const app_port_t port = {.drives = 1u << DRIVE_LOCKSTEP, .drive = DRIVE_LOCKSTEP};
    app_init(&app, &omnibot, NODE, port);
}

void tearDown(void)
{
}

static void look(void)
{
    frame_t frame;
    values = texts = 0;
    while (app_transmit(&app, &frame)) {
        if (frame.id >> FRAME_NODE_BITS == PARAMETER_VALUE_FUNCTION) {
            values++;
            TEST_ASSERT_EQUAL(DECODE_OK, parameter_value_decode(&value, &frame));
        } else if (frame.id >> FRAME_NODE_BITS == PARAMETER_TEXT_FUNCTION) {
            texts++;
            TEST_ASSERT_EQUAL(DECODE_OK, parameter_text_decode(&text, &frame));
        }
    }
}

static void get(uint8_t index, uint8_t field, uint8_t part)
{
    frame_t frame;
    parameter_get_encode(&frame, NODE, &(parameter_get_message_t){.index = index, .field = field, .part = part});
    app_receive(&app, &frame);
    look();
}

static void assert_value(uint8_t index, uint8_t field, float expected)
{
    get(index, field, 0);
    TEST_ASSERT_EQUAL(1, values);
    TEST_ASSERT_EQUAL(0, texts);
    TEST_ASSERT_EQUAL_UINT8(index, value.index);
    TEST_ASSERT_EQUAL_UINT8(field, value.field);
    TEST_ASSERT_EQUAL_UINT8(PARAMETER_VALUE_RESULT_OK, value.result);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, expected, value.value);
}

static void test_get_tells_value_default_and_range_of_a_number(void)
{
    assert_value(PARAMETER_DELTA_M_PER_S, FIELD_DEFAULT, 1e-3f);
    assert_value(PARAMETER_DELTA_M_PER_S, FIELD_MINIMUM, 1e-6f);
    assert_value(PARAMETER_DELTA_M_PER_S, FIELD_MAXIMUM, 1.0f);
    assert_value(PARAMETER_DELTA_M_PER_S, FIELD_TYPE, 0.0f);
    assert_value(PARAMETER_DELTA_M_PER_S, FIELD_VALUE, 1e-3f);
}

static void test_get_tells_value_default_and_range_of_a_whole_number(void)
{
    assert_value(PARAMETER_ORDER, FIELD_DEFAULT, 5.0f);
    assert_value(PARAMETER_ORDER, FIELD_MINIMUM, 0.0f);
    assert_value(PARAMETER_ORDER, FIELD_MAXIMUM, 5.0f);
    assert_value(PARAMETER_ORDER, FIELD_TYPE, 1.0f);
}

static void test_get_of_the_last_parameter_is_answered(void)
{
    assert_value(PARAMETER_COUNT - 1, FIELD_VALUE, parameter_table[PARAMETER_COUNT - 1].initial);
}

static void test_set_is_answered_with_the_value_field_and_does_not_move_the_default(void)
{
    frame_t frame;
    const parameter_set_message_t set = {.index = PARAMETER_SPEED_LENGTH_M, .value = 0.5f, .counter = 1};
    parameter_set_encode(&frame, NODE, &set);
    app_receive(&app, &frame);
    look();
    TEST_ASSERT_EQUAL(1, values);
    TEST_ASSERT_EQUAL_UINT8(FIELD_VALUE, value.field);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.5f, value.value);

    assert_value(PARAMETER_SPEED_LENGTH_M, FIELD_VALUE, 0.5f);
    assert_value(PARAMETER_SPEED_LENGTH_M, FIELD_DEFAULT, 1.0f);
}

static void assert_refused(uint8_t index, uint8_t field, uint8_t result)
{
    get(index, field, 0);
    TEST_ASSERT_EQUAL(1, values);
    TEST_ASSERT_EQUAL(0, texts);
    TEST_ASSERT_EQUAL_UINT8(result, value.result);
    TEST_ASSERT_TRUE(isnan(value.value));
}

static void test_get_of_a_field_that_there_is_not_gives_nan(void)
{
    assert_refused(PARAMETER_ORDER, FIELD_UNIT + 1, PARAMETER_VALUE_RESULT_UNKNOWN_FIELD);
}

static void test_get_of_any_field_of_an_unknown_parameter_gives_nan(void)
{
    for (uint8_t field = FIELD_VALUE; field <= FIELD_UNIT; field++) {
        assert_refused(PARAMETER_COUNT, field, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX);
    }
}

static void assert_text(uint8_t index, uint8_t field, uint8_t part, const char expected[6])
{
    get(index, field, part);
    TEST_ASSERT_EQUAL(0, values);
    TEST_ASSERT_EQUAL(1, texts);
    TEST_ASSERT_EQUAL_UINT8(index, text.index);
    TEST_ASSERT_EQUAL_UINT8(field, text.field);
    TEST_ASSERT_EQUAL_UINT8(part, text.part);
    const uint8_t got[6] = {text.char0, text.char1, text.char2, text.char3, text.char4, text.char5};
    TEST_ASSERT_EQUAL_MEMORY(expected, got, 6);
}

static void test_get_tells_a_name_in_parts_of_six_characters(void)
{
    assert_text(PARAMETER_DELTA_M_PER_S, FIELD_NAME, 0, "delta_");
    assert_text(PARAMETER_DELTA_M_PER_S, FIELD_NAME, 1, "m_per_");
    assert_text(PARAMETER_DELTA_M_PER_S, FIELD_NAME, 2, "s\0\0\0\0");
    assert_text(PARAMETER_ORDER, FIELD_NAME, 0, "order");
}

static void test_get_tells_a_unit(void)
{
    assert_text(PARAMETER_DELTA_M_PER_S, FIELD_UNIT, 0, "m/s\0\0");
    assert_text(PARAMETER_POSITION_STIFFNESS_PER_S2, FIELD_UNIT, 0, "1/s^2");
}

static void test_get_of_a_part_behind_the_text_is_empty(void)
{
    assert_text(PARAMETER_ORDER, FIELD_NAME, 1, "\0\0\0\0\0");
    assert_text(PARAMETER_DELTA_M_PER_S, FIELD_NAME, 3, "\0\0\0\0\0");
    assert_text(PARAMETER_DELTA_M_PER_S, FIELD_UNIT, 1, "\0\0\0\0\0");
}

static void test_text_of_exactly_six_characters_needs_no_end(void)
{
    assert_text(PARAMETER_OUTPUT, FIELD_NAME, 0, "output");
    assert_text(PARAMETER_OUTPUT, FIELD_NAME, 1, "\0\0\0\0\0");
}

static void test_text_is_put_where_it_is_wanted_and_no_further(void)
{
    char place[PARAMETER_TEXT_CHARACTERS + 2];
    memset(place, '#', sizeof place);
    parameters_text(PARAMETER_OUTPUT, FIELD_NAME, 0, &place[1]);
    TEST_ASSERT_EQUAL_MEMORY("#output#", place, sizeof place);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_get_tells_value_default_and_range_of_a_number);
    RUN_TEST(test_get_tells_value_default_and_range_of_a_whole_number);
    RUN_TEST(test_get_of_the_last_parameter_is_answered);
    RUN_TEST(test_set_is_answered_with_the_value_field_and_does_not_move_the_default);
    RUN_TEST(test_get_of_a_field_that_there_is_not_gives_nan);
    RUN_TEST(test_get_of_any_field_of_an_unknown_parameter_gives_nan);
    RUN_TEST(test_get_tells_a_name_in_parts_of_six_characters);
    RUN_TEST(test_get_tells_a_unit);
    RUN_TEST(test_get_of_a_part_behind_the_text_is_empty);
    RUN_TEST(test_text_of_exactly_six_characters_needs_no_end);
    RUN_TEST(test_text_is_put_where_it_is_wanted_and_no_further);
    return UNITY_END();
}
