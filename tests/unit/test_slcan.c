// SPDX-License-Identifier: MIT
// The device's side of SLCAN against Lawicel's text, character by character.
#include "slcan.h"

#include "unity.h"

#include <stdio.h>
#include <string.h>

#define BELL "\a"

static slcan_t slcan;
static frame_t frame;
static int frames_fed;
static char said[4 * SLCAN_QUEUE_BYTES];

void setUp(void)
{
    slcan_init(&slcan);
    frame = (frame_t){0};
    frames_fed = 0;
}

void tearDown(void)
{
}

static void feed(const char *text)
{
    for (const char *c = text; *c != '\0'; c++) {
        frames_fed += slcan_feed(&slcan, (uint8_t)*c, &frame);
    }
}

static const char *drain(void)
{
    size_t count = 0;
    uint8_t byte;
    while (slcan_next(&slcan, &byte)) {
        said[count++] = (char)byte;
    }
    said[count] = '\0';
    return said;
}

static const char *answer_to(const char *text)
{
    feed(text);
    return drain();
}

static void open_channel(void)
{
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("O\r"));
}

static void assert_refused(const char *line)
{
    const int before = frames_fed;
    TEST_ASSERT_EQUAL_STRING_MESSAGE(BELL, answer_to(line), line);
    TEST_ASSERT_EQUAL_INT_MESSAGE(before, frames_fed, line);
}

// ---- the channel

static void test_open_and_close_lead_back_and_forth_alone(void)
{
    assert_refused("C\r");
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("O\r"));
    assert_refused("O\r");
    assert_refused("L\r");
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("C\r"));
    assert_refused("C\r");
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("L\r"));
    assert_refused("O\r");
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("C\r"));
}

static void test_frame_while_closed_is_refused_both_ways(void)
{
    const frame_t ours = {.id = 0x050, .length = 0};

    assert_refused("t0500\r");
    TEST_ASSERT_FALSE(slcan_put(&slcan, &ours));
    TEST_ASSERT_EQUAL_STRING("", drain());
}

static void test_listening_sends_to_the_host_and_takes_nothing(void)
{
    const frame_t ours = {.id = 0x050, .length = 1, .data = {0xA5}};
    answer_to("L\r");

    assert_refused("t0500\r");
    TEST_ASSERT_TRUE(slcan_put(&slcan, &ours));
    TEST_ASSERT_EQUAL_STRING("t0501A5\r", drain());
}

static void test_frame_queued_before_close_goes_out_before_its_answer(void)
{
    const frame_t ours = {.id = 0x123, .length = 0};
    open_channel();
    slcan_put(&slcan, &ours);

    TEST_ASSERT_EQUAL_STRING("t1230\r\r", answer_to("C\r"));
    TEST_ASSERT_FALSE(slcan_put(&slcan, &ours));
}

static void test_bit_rates_of_the_manual_are_taken_while_closed_alone(void)
{
    char line[] = "S0\r";
    for (char digit = '0'; digit <= '8'; digit++) {
        line[1] = digit;
        TEST_ASSERT_EQUAL_STRING_MESSAGE("\r", answer_to(line), line);
    }
    assert_refused("S9\r");
    assert_refused("S/\r");
    assert_refused("S\r");
    assert_refused("S88\r");
    open_channel();
    assert_refused("S8\r");
}

static void test_time_stamps_are_off_and_stay_off(void)
{
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("Z0\r"));
    assert_refused("Z1\r");
    open_channel();
    assert_refused("Z0\r");
}

// ---- who it is, and how it is

static void test_version_is_two_decimal_pairs_and_serial_number_four_characters_in_any_state(void)
{
    TEST_ASSERT_EQUAL_STRING("V0100\r", answer_to("V\r"));
    TEST_ASSERT_EQUAL_STRING("NOMNI\r", answer_to("N\r"));
    open_channel();
    TEST_ASSERT_EQUAL_STRING("V0100\rNOMNI\r", answer_to("V\rN\r"));
}

static void test_flags_are_told_once(void)
{
    TEST_ASSERT_EQUAL_STRING("F00\r", answer_to("F\r"));
    slcan_note_lost_byte(&slcan);
    TEST_ASSERT_EQUAL_STRING(BELL "F08\rF00\r", answer_to("\rF\rF\r"));
}

static void test_line_that_lost_a_byte_is_refused_and_the_next_taken(void)
{
    open_channel();
    feed("t050");
    slcan_note_lost_byte(&slcan);
    TEST_ASSERT_EQUAL_STRING(BELL, answer_to("1A5\r"));
    TEST_ASSERT_EQUAL_INT(0, frames_fed);
    TEST_ASSERT_EQUAL_STRING("z\r", answer_to("t0501A5\r"));
    TEST_ASSERT_EQUAL_INT(1, frames_fed);
}

// ---- frames from the host

static void test_frame_of_every_length_arrives_as_it_was_written(void)
{
    const uint8_t bytes[FRAME_DATA_BYTES] = {0x00, 0xFF, 0x12, 0xAB, 0xCD, 0xEF, 0x90, 0x7E};
    open_channel();
    for (uint8_t length = 0; length <= FRAME_DATA_BYTES; length++) {
        char line[64];
        int used = snprintf(line, sizeof line, "t7F3%u", (unsigned)length);
        for (uint8_t i = 0; i < length; i++) {
            used += snprintf(line + used, sizeof line - (size_t)used, "%02X", (unsigned)bytes[i]);
        }
        (void)snprintf(line + used, sizeof line - (size_t)used, "\r");

        TEST_ASSERT_EQUAL_STRING_MESSAGE("z\r", answer_to(line), line);
        TEST_ASSERT_EQUAL_INT(length + 1, frames_fed);
        TEST_ASSERT_EQUAL_HEX16(0x7F3, frame.id);
        TEST_ASSERT_EQUAL_UINT8(length, frame.length);
        TEST_ASSERT_EQUAL_HEX8_ARRAY(bytes, frame.data, length == 0 ? 1 : length);
    }
}

static void test_frame_is_there_at_its_end_of_line_and_not_before(void)
{
    open_channel();
    feed("t0402BEEF");
    TEST_ASSERT_EQUAL_INT(0, frames_fed);
    feed("\r");
    TEST_ASSERT_EQUAL_INT(1, frames_fed);
}

static void test_small_letters_are_hexadecimal_too(void)
{
    open_channel();
    TEST_ASSERT_EQUAL_STRING("z\r", answer_to("t7af2c0De\r"));
    TEST_ASSERT_EQUAL_HEX16(0x7AF, frame.id);
    TEST_ASSERT_EQUAL_HEX8(0xC0, frame.data[0]);
    TEST_ASSERT_EQUAL_HEX8(0xDE, frame.data[1]);
}

static void test_highest_identifier_is_taken_and_the_next_refused(void)
{
    open_channel();
    TEST_ASSERT_EQUAL_STRING("z\r", answer_to("t7FF0\r"));
    TEST_ASSERT_EQUAL_HEX16(0x7FF, frame.id);
    assert_refused("t8000\r");
    assert_refused("tFFF0\r");
}

static void test_frame_of_a_length_other_than_it_says_is_refused(void)
{
    open_channel();
    assert_refused("t\r");
    assert_refused("t040\r");
    assert_refused("t0401\r");
    assert_refused("t0401A\r");
    assert_refused("t0401ABC\r");
    assert_refused("t0401ABCD\r");
    assert_refused("t0400A\r");
    assert_refused("t0409001122334455667788\r");
    assert_refused("t040A00112233445566778899\r");
}

static void test_every_character_that_is_no_hexadecimal_digit_is_refused_at_every_place(void)
{
    open_channel();
    for (int c = 1; c < 256; c++) {
        const bool is_digit = strchr("0123456789abcdefABCDEF", c) != NULL;
        for (size_t place = 1; place < 7 && !is_digit && c != '\r'; place++) {
            char line[] = "t0401A5\r";
            line[place] = (char)c;
            assert_refused(line);
        }
    }
}

// ---- what we do not speak

static void test_remote_and_extended_frames_are_refused(void)
{
    open_channel();
    assert_refused("r0400\r");
    assert_refused("T000000400\r");
    assert_refused("T0000004080011223344556677\r");
    assert_refused("R000000400\r");
}

static void test_unknown_commands_are_refused_in_every_state(void)
{
    static const char *const lines[] = {"s031C\r", "M00000000\r", "mFFFFFFFF\r", "X1\r", "W0\r", "Q1\r",
                                        "P\r",     "A\r",         "U1\r",        "o\r",  "?\r",  "OO\r",
                                        "Cx\r",    "V1\r",        "\n\r",        "Z\r",  "Z2\r", "z\r"};
    for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
        assert_refused(lines[i]);
    }
    open_channel();
    for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
        assert_refused(lines[i]);
    }
}

static void test_empty_lines_do_nothing(void)
{
    TEST_ASSERT_EQUAL_STRING("\r\r\r", answer_to("\r\r\r"));
    assert_refused("C\r");
}

static void test_line_too_long_is_refused_once_and_the_next_taken(void)
{
    open_channel();
    for (size_t excess = 1; excess <= 600; excess += 23) {
        char line[SLCAN_LINE_CHARS + 1] = {0};
        memset(line, '0', SLCAN_LINE_CHARS);
        line[0] = 't';
        feed(line);
        for (size_t i = 0; i < excess; i++) {
            feed("0");
        }
        TEST_ASSERT_EQUAL_STRING("", drain());
        TEST_ASSERT_EQUAL_STRING(BELL "z\r", answer_to("\rt0400\r"));
    }
}

static void test_random_bytes_never_give_a_frame_that_was_not_written(void)
{
    static const char alphabet[] = "tt000011122AFfTS\r\r\r\a\n";
    uint32_t state = 1;
    char line[64] = {0};
    size_t length = 0;
    open_channel();
    for (int i = 0; i < 200000; i++) {
        state = state * 1664525u + 1013904223u;
        const char c = alphabet[(state >> 16) % (sizeof alphabet - 1)];
        if (slcan_feed(&slcan, (uint8_t)c, &frame)) {
            unsigned id, dlc;
            TEST_ASSERT_EQUAL_CHAR('t', line[0]);
            TEST_ASSERT_EQUAL_INT(2, sscanf(line, "t%3x%1u", &id, &dlc));
            TEST_ASSERT_EQUAL_HEX16(id, frame.id);
            TEST_ASSERT_EQUAL_UINT8(dlc, frame.length);
            TEST_ASSERT_EQUAL_size_t(5 + 2 * (size_t)frame.length, length);
            frames_fed++;
        }
        length = c == '\r' ? 0 : length + 1;
        if (length > 0 && length < sizeof line) {
            line[length - 1] = c;
            line[length] = '\0';
        }
        drain();
    }
    TEST_ASSERT_GREATER_THAN_INT(10, frames_fed);
}

// ---- frames to the host

static void test_put_writes_the_text_of_the_manual(void)
{
    const frame_t full = {.id = 0x050, .length = 8, .data = {0x01, 0x23, 0x45, 0x67, 0x89, 0xAB, 0xCD, 0xEF}};
    const frame_t empty = {.id = 0x7FF, .length = 0};
    open_channel();

    TEST_ASSERT_TRUE(slcan_put(&slcan, &full));
    TEST_ASSERT_TRUE(slcan_put(&slcan, &empty));
    TEST_ASSERT_EQUAL_STRING("t05080123456789ABCDEF\rt7FF0\r", drain());
}

static void test_put_of_what_is_no_classic_frame_is_refused(void)
{
    const frame_t long_frame = {.id = 0x050, .length = 9}, extended = {.id = 0x800, .length = 0};
    open_channel();

    TEST_ASSERT_FALSE(slcan_put(&slcan, &long_frame));
    TEST_ASSERT_FALSE(slcan_put(&slcan, &extended));
    TEST_ASSERT_EQUAL_STRING("", drain());
}

static void test_put_until_full_queues_whole_frames_and_leaves_room_for_answers(void)
{
    const frame_t full = {.id = 0x050, .length = 8};
    open_channel();
    for (int start = 0; start < SLCAN_QUEUE_BYTES; start++) { // wherever in the ring it begins
        int count = 0;
        while (slcan_has_room(&slcan)) {
            TEST_ASSERT_TRUE(slcan_put(&slcan, &full));
            count++;
        }
        TEST_ASSERT_FALSE(slcan_put(&slcan, &full));
        TEST_ASSERT_GREATER_OR_EQUAL_INT(10, count);
        feed("\r\r\r\r\r\r\r\r\r\r\r\r\r\r\r\r"); // as many as sixteen answers fit
        const char *text = drain();
        for (int i = 0; i < count; i++, text += 22) {
            TEST_ASSERT_EQUAL_STRING_LEN("t05080000000000000000\r", text, 22);
        }
        TEST_ASSERT_EQUAL_STRING("\r\r\r\r\r\r\r\r\r\r\r\r\r\r\r\r", text);
        answer_to("\r"); // one place on
    }
}

static void test_answers_that_do_not_fit_are_dropped_whole_and_told(void)
{
    for (int i = 0; i < SLCAN_QUEUE_BYTES; i++) {
        feed("V\r");
    }
    const char *text = drain();
    TEST_ASSERT_EQUAL_size_t(SLCAN_QUEUE_BYTES / 6 * 6, strlen(text));
    for (; *text != '\0'; text += 6) {
        TEST_ASSERT_EQUAL_STRING_LEN("V0100\r", text, 6);
    }
    TEST_ASSERT_EQUAL_STRING("F08\rF00\r", answer_to("F\rF\r"));
}

static void test_queue_fills_to_its_last_byte_and_no_further(void)
{
    for (int i = 0; i < SLCAN_QUEUE_BYTES; i++) {
        feed("\r");
    }
    feed("V\r\r");
    TEST_ASSERT_EQUAL_size_t(SLCAN_QUEUE_BYTES, strlen(drain()));
    TEST_ASSERT_EQUAL_STRING("F08\r", answer_to("F\r"));
}

// ---- hosts

static void test_session_of_python_can_is_answered_as_it_tolerates(void)
{
    // Close, bit rate, no data bit rate, open, and open once more.
    TEST_ASSERT_EQUAL_STRING(BELL "\r\r\r" BELL, answer_to("C\rS8\r\rO\rO\r"));
    TEST_ASSERT_EQUAL_STRING("z\r", answer_to("t04060000000000AA\r"));
    TEST_ASSERT_EQUAL_INT(1, frames_fed);
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("C\r"));
}

static void test_session_of_slcand_is_answered(void)
{
    TEST_ASSERT_EQUAL_STRING(BELL "\rF00\r\r", answer_to("C\rS8\rF\rO\r"));
    TEST_ASSERT_EQUAL_STRING("z\r", answer_to("t0400\r"));
    TEST_ASSERT_EQUAL_STRING("\r", answer_to("C\r"));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_open_and_close_lead_back_and_forth_alone);
    RUN_TEST(test_frame_while_closed_is_refused_both_ways);
    RUN_TEST(test_listening_sends_to_the_host_and_takes_nothing);
    RUN_TEST(test_frame_queued_before_close_goes_out_before_its_answer);
    RUN_TEST(test_bit_rates_of_the_manual_are_taken_while_closed_alone);
    RUN_TEST(test_time_stamps_are_off_and_stay_off);
    RUN_TEST(test_version_is_two_decimal_pairs_and_serial_number_four_characters_in_any_state);
    RUN_TEST(test_flags_are_told_once);
    RUN_TEST(test_line_that_lost_a_byte_is_refused_and_the_next_taken);
    RUN_TEST(test_frame_of_every_length_arrives_as_it_was_written);
    RUN_TEST(test_frame_is_there_at_its_end_of_line_and_not_before);
    RUN_TEST(test_small_letters_are_hexadecimal_too);
    RUN_TEST(test_highest_identifier_is_taken_and_the_next_refused);
    RUN_TEST(test_frame_of_a_length_other_than_it_says_is_refused);
    RUN_TEST(test_every_character_that_is_no_hexadecimal_digit_is_refused_at_every_place);
    RUN_TEST(test_remote_and_extended_frames_are_refused);
    RUN_TEST(test_unknown_commands_are_refused_in_every_state);
    RUN_TEST(test_empty_lines_do_nothing);
    RUN_TEST(test_line_too_long_is_refused_once_and_the_next_taken);
    RUN_TEST(test_random_bytes_never_give_a_frame_that_was_not_written);
    RUN_TEST(test_put_writes_the_text_of_the_manual);
    RUN_TEST(test_put_of_what_is_no_classic_frame_is_refused);
    RUN_TEST(test_put_until_full_queues_whole_frames_and_leaves_room_for_answers);
    RUN_TEST(test_answers_that_do_not_fit_are_dropped_whole_and_told);
    RUN_TEST(test_queue_fills_to_its_last_byte_and_no_further);
    RUN_TEST(test_session_of_python_can_is_answered_as_it_tolerates);
    RUN_TEST(test_session_of_slcand_is_answered);
    return UNITY_END();
}
