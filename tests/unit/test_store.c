// SPDX-License-Identifier: MIT
// Uploads: whole ones of every size, and each way in which one can go wrong. Bytes and CRC are made here, not by the
// store.
#include "store.h"

#include "messages.h"
#include "unity.h"

#include <string.h>

enum { BYTES_MAX = 100 * 128 };

static store_t store;
static uint8_t upload[BYTES_MAX];

void setUp(void)
{
    memset(&store, 0, sizeof store);
}

void tearDown(void)
{
}

/// CRC-32 ISO-HDLC, one bit at a time.
static uint32_t crc32_bitwise(const uint8_t *byte, uint32_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (uint32_t i = 0; i < count; i++) {
        crc ^= byte[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 1u) != 0 ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
        }
    }
    return crc ^ 0xFFFFFFFFu;
}

static void write_word(uint8_t *byte, uint32_t word)
{
    for (int i = 0; i < 4; i++) {
        byte[i] = (uint8_t)(word >> 8 * i);
    }
}

static void write_float(uint8_t *byte, float value)
{
    uint32_t word;
    memcpy(&word, &value, sizeof word);
    write_word(byte, word);
}

static uint32_t duration_of(uint32_t segment)
{
    return 1000u + 65537u * segment;
}

static float coefficient_of(uint32_t segment, uint32_t axis, uint32_t power)
{
    return (float)segment * 10.0f - (float)axis * 0.5f + (float)power * 0.0625f;
}

/// Fills the upload with segments that are all different; returns their bytes.
static uint16_t make_segments(uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        write_word(&upload[100 * i], duration_of(i));
        for (uint32_t axis = 0; axis < 3; axis++) {
            for (uint32_t power = 0; power < 8; power++) {
                write_float(&upload[100 * i + 4 + 32 * axis + 4 * power], coefficient_of(i, axis, power));
            }
        }
    }
    return (uint16_t)(100 * count);
}

static void assert_answer(uint8_t result, store_answer_t answer)
{
    TEST_ASSERT_TRUE(answer.send);
    TEST_ASSERT_EQUAL_UINT8(result, answer.result);
}

static store_answer_t send_frame(uint16_t offset, uint16_t length, uint8_t padding)
{
    uint8_t data[6];
    for (uint32_t i = 0; i < 6; i++) {
        data[i] = offset + i < length ? upload[offset + i] : padding;
    }
    return store_data(&store, offset, data);
}

static store_answer_t begin(uint16_t length)
{
    return store_begin(&store, length, crc32_bitwise(upload, length));
}

/// Sends frames from an offset to one, the last not included; the last answer.
static store_answer_t send_frames(uint16_t from, uint16_t to, uint16_t length)
{
    store_answer_t answer = {false, 0};
    for (uint32_t offset = from; offset < to; offset += 6) {
        answer = send_frame((uint16_t)offset, length, 0);
    }
    return answer;
}

static void assert_holds(uint32_t count)
{
    TEST_ASSERT_EQUAL_UINT16(count, store.segment_count);
    for (uint32_t i = 0; i < count; i++) {
        TEST_ASSERT_EQUAL_UINT32(duration_of(i), store.segment[i].duration_us);
        for (uint32_t place = 0; place < 24; place++) {
            TEST_ASSERT_FLOAT_WITHIN(0.0f, coefficient_of(i, place / 8, place % 8),
                                     store.segment[i].coefficient[place / 8][place % 8]);
        }
    }
}

static void upload_segments(uint32_t count)
{
    const uint16_t length = make_segments(count);
    assert_answer(TRAJECTORY_ACK_RESULT_RECEIVING, begin(length));
    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frames(0, length, length));
}

// ---- whole uploads

static void test_store_at_first_holds_nothing(void)
{
    TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);
}

static void test_upload_of_one_segment_is_held(void)
{
    upload_segments(1);
    assert_holds(1);
}

static void test_upload_of_two_segments_is_held(void)
{
    upload_segments(2);
    assert_holds(2);
}

static void test_upload_of_the_most_segments_is_held(void)
{
    upload_segments(128);
    assert_holds(128);
    TEST_ASSERT_EQUAL_UINT16(12800, store.received_bytes);
}

static void test_upload_of_every_count_is_held(void)
{
    for (uint32_t count = 1; count <= 128; count++) {
        setUp();
        upload_segments(count);
        assert_holds(count);
    }
}

static void test_padding_of_the_last_frame_is_not_looked_at(void)
{
    const uint16_t length = make_segments(1); // 100 = 16 · 6 + 4
    (void)begin(length);
    (void)send_frames(0, 96, length);

    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frame(96, length, 0xFF));
    assert_holds(1);
}

static void test_upload_after_another_replaces_it(void)
{
    upload_segments(5);
    upload_segments(2);
    assert_holds(2);
}

static void test_upload_is_not_held_before_its_last_byte(void)
{
    const uint16_t length = make_segments(3); // 300 = 50 · 6
    (void)begin(length);
    (void)send_frames(0, 294, length);
    TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);

    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frame(294, length, 0));
    assert_holds(3);
}

// ---- acknowledgements

static void test_data_is_acknowledged_every_16_frames_and_at_the_end(void)
{
    const uint16_t length = make_segments(4); // 400: 66 frames and 4 bytes
    (void)begin(length);
    for (uint32_t frame = 1; frame <= 67; frame++) {
        const store_answer_t answer = send_frame((uint16_t)(6 * (frame - 1)), length, 0);

        TEST_ASSERT_EQUAL(frame % 16 == 0 || frame == 67, answer.send);
        TEST_ASSERT_EQUAL_UINT16(frame < 67 ? 6 * frame : 400, store.received_bytes);
        if (answer.send) {
            TEST_ASSERT_EQUAL_UINT8(frame == 67 ? TRAJECTORY_ACK_RESULT_COMPLETE : TRAJECTORY_ACK_RESULT_RECEIVING,
                                    answer.result);
        }
    }
}

static void test_upload_that_ends_with_a_sixteenth_frame_is_acknowledged_once_as_complete(void)
{
    const uint16_t length = make_segments(24); // 2400 = 25 · 96
    (void)begin(length);
    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frames(0, length, length));
    assert_holds(24);
}

// ---- wrong lengths

static void test_begin_of_a_wrong_length_is_refused(void)
{
    static const uint16_t wrong[] = {0, 1, 6, 99, 101, 150, 12799, 12801, 12900, 65500, 65535};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_answer(TRAJECTORY_ACK_RESULT_WRONG_LENGTH, store_begin(&store, wrong[i], 0));
        assert_answer(TRAJECTORY_ACK_RESULT_WRONG_OFFSET, store_data(&store, 0, upload));
    }
}

static void test_begin_refused_keeps_the_trajectory_held(void)
{
    upload_segments(2);

    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_LENGTH, store_begin(&store, 0, 0));

    assert_holds(2);
}

static void test_begin_taken_drops_the_trajectory_held(void)
{
    upload_segments(2);

    (void)begin(100);

    TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);
}

// ---- wrong contents

static void test_upload_with_any_byte_wrong_is_refused(void)
{
    for (uint32_t i = 0; i < 100; i++) {
        const uint16_t length = make_segments(1);
        (void)begin(length);
        upload[i] ^= 0x10;

        assert_answer(TRAJECTORY_ACK_RESULT_WRONG_CRC, send_frames(0, length, length));
        TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);
    }
}

static void test_upload_with_a_wrong_crc_announced_is_refused(void)
{
    const uint16_t length = make_segments(2);
    (void)store_begin(&store, length, crc32_bitwise(upload, length) ^ 1u);

    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_CRC, send_frames(0, length, length));

    TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);
    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_OFFSET, send_frame(0, length, 0)); // it is over
}

static void assert_bad_segment(uint16_t length)
{
    (void)begin(length);
    assert_answer(TRAJECTORY_ACK_RESULT_BAD_SEGMENT, send_frames(0, length, length));
    TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);
}

static void test_upload_with_a_segment_of_no_duration_is_refused(void)
{
    const uint16_t length = make_segments(3);
    write_word(&upload[200], 0);

    assert_bad_segment(length);
}

static void test_upload_with_a_coefficient_that_is_no_number_is_refused(void)
{
    const uint32_t bad[] = {0x7FC00000u, 0x7F800001u, 0x7F800000u, 0xFF800000u, 0xFFFFFFFFu}; // NaNs and infinities
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const uint16_t length = make_segments(2);
        write_word(&upload[196], bad[i]); // the very last
        assert_bad_segment(length);
    }
}

static void test_upload_with_a_coefficient_too_large_is_refused(void)
{
    const uint16_t length = make_segments(2);
    write_float(&upload[4], -10001.0f);

    assert_bad_segment(length);
}

static void test_upload_after_a_bad_one_is_held(void)
{
    const uint16_t length = make_segments(2);
    write_float(&upload[4], NAN);
    assert_bad_segment(length);

    upload_segments(2);

    assert_holds(2);
}

// ---- wrong offsets

static void assert_next_is(uint16_t offset, store_answer_t answer)
{
    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_OFFSET, answer);
    TEST_ASSERT_EQUAL_UINT16(offset, store.received_bytes);
}

static void test_data_without_begin_is_refused(void)
{
    assert_next_is(0, store_data(&store, 0, upload));
}

static void test_data_behind_a_gap_is_refused_and_the_upload_goes_on_from_before(void)
{
    const uint16_t length = make_segments(2);
    (void)begin(length);
    (void)send_frames(0, 60, length);

    assert_next_is(60, send_frame(66, length, 0));
    assert_next_is(60, send_frame(72, length, 0));

    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frames(60, length, length));
    assert_holds(2);
}

static void test_data_repeated_is_refused_and_not_taken_twice(void)
{
    const uint16_t length = make_segments(2);
    (void)begin(length);
    (void)send_frames(0, 60, length);

    assert_next_is(60, send_frame(54, length, 0));

    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frames(60, length, length));
    assert_holds(2);
}

static void test_data_at_an_offset_inside_a_frame_is_refused(void)
{
    const uint16_t length = make_segments(2);
    (void)begin(length);
    (void)send_frames(0, 60, length);

    assert_next_is(60, send_frame(61, length, 0));
    assert_next_is(60, send_frame(59, length, 0));
}

static void test_data_after_the_end_is_refused_and_the_trajectory_stays(void)
{
    upload_segments(2);

    assert_next_is(200, send_frame(198, 200, 0));
    assert_next_is(200, send_frame(200, 200, 0));

    assert_holds(2);
}

static void test_begin_in_the_middle_restarts(void)
{
    const uint16_t length = make_segments(3);
    (void)begin(length);
    (void)send_frames(0, 150, length); // leaves a word half filled

    upload_segments(2);

    assert_holds(2);
}

static void test_begin_refused_in_the_middle_lets_the_upload_go_on(void)
{
    const uint16_t length = make_segments(2);
    (void)begin(length);
    (void)send_frames(0, 60, length);

    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_LENGTH, store_begin(&store, 7, 0));

    assert_answer(TRAJECTORY_ACK_RESULT_COMPLETE, send_frames(60, length, length));
    assert_holds(2);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_store_at_first_holds_nothing);
    RUN_TEST(test_upload_of_one_segment_is_held);
    RUN_TEST(test_upload_of_two_segments_is_held);
    RUN_TEST(test_upload_of_the_most_segments_is_held);
    RUN_TEST(test_upload_of_every_count_is_held);
    RUN_TEST(test_padding_of_the_last_frame_is_not_looked_at);
    RUN_TEST(test_upload_after_another_replaces_it);
    RUN_TEST(test_upload_is_not_held_before_its_last_byte);
    RUN_TEST(test_data_is_acknowledged_every_16_frames_and_at_the_end);
    RUN_TEST(test_upload_that_ends_with_a_sixteenth_frame_is_acknowledged_once_as_complete);
    RUN_TEST(test_begin_of_a_wrong_length_is_refused);
    RUN_TEST(test_begin_refused_keeps_the_trajectory_held);
    RUN_TEST(test_begin_taken_drops_the_trajectory_held);
    RUN_TEST(test_upload_with_any_byte_wrong_is_refused);
    RUN_TEST(test_upload_with_a_wrong_crc_announced_is_refused);
    RUN_TEST(test_upload_with_a_segment_of_no_duration_is_refused);
    RUN_TEST(test_upload_with_a_coefficient_that_is_no_number_is_refused);
    RUN_TEST(test_upload_with_a_coefficient_too_large_is_refused);
    RUN_TEST(test_upload_after_a_bad_one_is_held);
    RUN_TEST(test_data_without_begin_is_refused);
    RUN_TEST(test_data_behind_a_gap_is_refused_and_the_upload_goes_on_from_before);
    RUN_TEST(test_data_repeated_is_refused_and_not_taken_twice);
    RUN_TEST(test_data_at_an_offset_inside_a_frame_is_refused);
    RUN_TEST(test_data_after_the_end_is_refused_and_the_trajectory_stays);
    RUN_TEST(test_begin_in_the_middle_restarts);
    RUN_TEST(test_begin_refused_in_the_middle_lets_the_upload_go_on);
    return UNITY_END();
}
