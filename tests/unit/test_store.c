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

/// Sixteenths within ±2, so that every sum of them is exact.
static float slope_of(uint32_t segment, uint32_t axis, uint32_t power)
{
    return 0.0625f * ((float)((31u * segment + 7u * axis + 13u * power) % 64u) - 32.0f);
}

/// Each segment starts where the one before it ends.
static float coefficient_of(uint32_t segment, uint32_t axis, uint32_t power)
{
    if (power > 0) {
        return slope_of(segment, axis, power);
    }
    float start = -0.5f * (float)axis;
    for (uint32_t i = 0; i < segment; i++) {
        for (uint32_t k = 1; k < 8; k++) {
            start += slope_of(i, axis, k);
        }
    }
    return start;
}

static uint8_t *coefficient_at(uint32_t segment, uint32_t axis, uint32_t power)
{
    return &upload[100 * segment + 4 + 32 * axis + 4 * power];
}

/// Fills the upload with segments that are all different; returns their bytes.
static uint16_t make_segments(uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        write_word(&upload[100 * i], duration_of(i));
        for (uint32_t axis = 0; axis < 3; axis++) {
            for (uint32_t power = 0; power < 8; power++) {
                write_float(coefficient_at(i, axis, power), coefficient_of(i, axis, power));
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

static void assert_refused(uint8_t result, uint16_t length)
{
    (void)begin(length);
    assert_answer(result, send_frames(0, length, length));
    TEST_ASSERT_EQUAL_UINT16(0, store.segment_count);
    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_OFFSET, send_frame(0, length, 0)); // it is over
}

static void test_upload_with_a_bad_duration_in_any_segment_is_refused(void)
{
    static const uint32_t bad_us[] = {0, 600000001u, 3600000000u, UINT32_MAX};
    for (size_t i = 0; i < sizeof bad_us / sizeof bad_us[0]; i++) {
        for (uint32_t segment = 0; segment < 128; segment++) {
            const uint16_t length = make_segments(128);
            write_word(&upload[100 * segment], bad_us[i]);
            assert_refused(TRAJECTORY_ACK_RESULT_BAD_DURATION, length);
        }
    }
}

static void test_upload_with_any_coefficient_that_is_no_number_or_too_large_is_refused(void)
{
    // NaNs, infinities, and the numbers next to ±10⁴.
    static const uint32_t bad[] = {0x7FC00000u, 0x7F800001u, 0x7F800000u, 0xFF800000u,
                                   0xFFFFFFFFu, 0x461C4001u, 0xC61C4001u};
    for (uint32_t place = 0; place < 5 * 24; place++) {
        const uint16_t length = make_segments(5);
        write_word(coefficient_at(place / 24, place % 24 / 8, place % 8), bad[place % 7]);
        assert_refused(TRAJECTORY_ACK_RESULT_BAD_SEGMENT, length);
    }
}

static void test_upload_with_a_jump_at_any_joint_is_refused(void)
{
    for (uint32_t joint = 1; joint < 128; joint++) {
        for (uint32_t axis = 0; axis < 3; axis++) {
            const uint16_t length = make_segments(128);
            write_float(coefficient_at(joint, axis, 0), coefficient_of(joint, axis, 0) + 0.0625f);
            assert_refused(TRAJECTORY_ACK_RESULT_DISCONTINUOUS, length);
        }
    }
}

static void test_upload_with_several_flaws_is_refused_for_the_first_to_be_looked_at(void)
{
    const uint16_t length = make_segments(3);
    write_float(coefficient_at(1, 0, 0), 900.0f);
    assert_refused(TRAJECTORY_ACK_RESULT_DISCONTINUOUS, length);
    write_word(&upload[0], 0);
    assert_refused(TRAJECTORY_ACK_RESULT_BAD_DURATION, length);
    write_float(coefficient_at(2, 2, 7), NAN);
    assert_refused(TRAJECTORY_ACK_RESULT_BAD_SEGMENT, length);

    (void)store_begin(&store, length, 1u);
    assert_answer(TRAJECTORY_ACK_RESULT_WRONG_CRC, send_frames(0, length, length));
}

static void test_upload_after_a_bad_one_is_held(void)
{
    const uint16_t length = make_segments(2);
    write_float(&upload[4], NAN);
    assert_refused(TRAJECTORY_ACK_RESULT_BAD_SEGMENT, length);

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

// ---- attacks

enum { STEPS = 20000, SEGMENTS_OF_AN_ATTACK = 4 };

/// What an upload must come to, told by the sender's own books: bytes sent in order, and whether they are good.
typedef struct {
    uint8_t verdict; // on the whole, made when the bytes were
    uint32_t length, sent, held;
    bool under_way;
} books_t;

static uint32_t draw(uint32_t *state, uint32_t below)
{
    *state = *state * 1664525u + 1013904223u;
    return (*state >> 8) % below;
}

/// Makes good segments, spoils them in one way or none; returns what the robot must say to it.
static uint8_t make_attack(uint32_t *state, uint32_t count)
{
    static const uint8_t verdict[] = {TRAJECTORY_ACK_RESULT_BAD_SEGMENT, TRAJECTORY_ACK_RESULT_BAD_DURATION,
                                      TRAJECTORY_ACK_RESULT_DISCONTINUOUS, TRAJECTORY_ACK_RESULT_COMPLETE};
    (void)make_segments(count);
    const uint32_t segment = draw(state, count), axis = draw(state, 3);
    const uint32_t flaw = draw(state, 4);
    if (flaw == 0) {
        write_word(coefficient_at(segment, axis, draw(state, 8)), 0x7F800000u | draw(state, 1u << 23));
    } else if (flaw == 1) {
        write_word(&upload[100 * segment], draw(state, 2) == 0 ? 0 : 600000001u + draw(state, 1u << 24));
    } else if (flaw == 2 && segment > 0) {
        write_float(coefficient_at(segment, axis, 0), coefficient_of(segment, axis, 0) - 0.0625f);
    } else {
        return TRAJECTORY_ACK_RESULT_COMPLETE;
    }
    return verdict[flaw];
}

static void attack_begin(uint32_t *state, books_t *books)
{
    const uint32_t count = 1 + draw(state, SEGMENTS_OF_AN_ATTACK);
    const bool lawful = draw(state, 4) > 0;
    if (!lawful) {
        const uint16_t wrong = (uint16_t)(100 * count + 1 + draw(state, 99));
        assert_answer(TRAJECTORY_ACK_RESULT_WRONG_LENGTH, store_begin(&store, wrong, 0));
        return;
    }
    *books = (books_t){.verdict = make_attack(state, count), .length = 100 * count, .under_way = true};
    const bool damaged = draw(state, 8) == 0;
    const uint32_t crc32 = crc32_bitwise(upload, books->length) ^ (damaged ? 1u << draw(state, 32) : 0u);
    books->verdict = damaged ? TRAJECTORY_ACK_RESULT_WRONG_CRC : books->verdict;
    assert_answer(TRAJECTORY_ACK_RESULT_RECEIVING, store_begin(&store, (uint16_t)books->length, crc32));
}

/// A frame at the next offset or, seldom, at another: an overlap, a gap, a repetition.
static void attack_data(uint32_t *state, books_t *books)
{
    const uint32_t offset = draw(state, 16) > 0 ? books->sent : draw(state, 1u << 16);
    const store_answer_t answer = send_frame((uint16_t)offset, (uint16_t)books->length, (uint8_t)draw(state, 256));
    if (!books->under_way || offset != books->sent) {
        assert_answer(TRAJECTORY_ACK_RESULT_WRONG_OFFSET, answer);
        return;
    }
    books->sent = books->sent + 6 < books->length ? books->sent + 6 : books->length;
    if (books->sent < books->length) {
        TEST_ASSERT_EQUAL(books->sent % 96 == 0, answer.send);
        TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_RECEIVING, answer.result);
        return;
    }
    assert_answer(books->verdict, answer);
    books->under_way = false;
    books->held = books->verdict == TRAJECTORY_ACK_RESULT_COMPLETE ? books->length / 100 : 0;
}

static void test_store_under_random_attacks_holds_whole_good_uploads_or_nothing(void)
{
    uint32_t state = 2014, uploads_held = 0;
    books_t books = {0};
    for (int step = 0; step < STEPS; step++) {
        if (draw(&state, books.under_way ? 400 : 4) == 0) {
            attack_begin(&state, &books);
        } else {
            attack_data(&state, &books);
        }
        TEST_ASSERT_EQUAL_UINT16(books.sent, store.received_bytes);
        TEST_ASSERT_EQUAL_UINT16(books.held, store.segment_count);
        TEST_ASSERT_EQUAL(books.under_way, store.receiving);
        if (books.held > 0 && books.sent == books.length) {
            assert_holds(books.held);
            uploads_held++;
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT32(100, uploads_held); // good ones came through
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
    RUN_TEST(test_upload_with_a_bad_duration_in_any_segment_is_refused);
    RUN_TEST(test_upload_with_any_coefficient_that_is_no_number_or_too_large_is_refused);
    RUN_TEST(test_upload_with_a_jump_at_any_joint_is_refused);
    RUN_TEST(test_upload_with_several_flaws_is_refused_for_the_first_to_be_looked_at);
    RUN_TEST(test_upload_after_a_bad_one_is_held);
    RUN_TEST(test_data_without_begin_is_refused);
    RUN_TEST(test_data_behind_a_gap_is_refused_and_the_upload_goes_on_from_before);
    RUN_TEST(test_data_repeated_is_refused_and_not_taken_twice);
    RUN_TEST(test_data_at_an_offset_inside_a_frame_is_refused);
    RUN_TEST(test_data_after_the_end_is_refused_and_the_trajectory_stays);
    RUN_TEST(test_begin_in_the_middle_restarts);
    RUN_TEST(test_begin_refused_in_the_middle_lets_the_upload_go_on);
    RUN_TEST(test_store_under_random_attacks_holds_whole_good_uploads_or_nothing);
    return UNITY_END();
}
