// SPDX-License-Identifier: MIT
// Both checksums against their published check values and against bit-by-bit references.
#include "crc.h"

#include "unity.h"

#include <stddef.h>

void setUp(void)
{
}

void tearDown(void)
{
}

/// CRC-8 SAE J1850, one bit at a time, straight from its definition.
static uint8_t crc8_bitwise(const uint8_t *byte, size_t count)
{
    uint32_t crc = 0xFFu;
    for (size_t i = 0; i < count; i++) {
        crc ^= byte[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x80u) != 0 ? (crc << 1) ^ 0x1Du : crc << 1;
            crc &= 0xFFu;
        }
    }
    return (uint8_t)(crc ^ 0xFFu);
}

/// CRC-32 ISO-HDLC, one bit at a time, straight from its definition.
static uint32_t crc32_bitwise(const uint8_t *byte, size_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < count; i++) {
        crc ^= byte[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 1u) != 0 ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
        }
    }
    return crc ^ 0xFFFFFFFFu;
}

static uint32_t crc32_of(const uint8_t *byte, size_t count)
{
    uint32_t crc = CRC32_START;
    for (size_t i = 0; i < count; i++) {
        crc = crc32_update(crc, byte[i]);
    }
    return crc32_finish(crc);
}

static uint8_t next_byte(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return (uint8_t)(*state >> 24);
}

static const uint8_t check_text[9] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};

// ---- CRC-8

static void test_crc8_reference_of_the_check_text_is_the_published_value(void)
{
    TEST_ASSERT_EQUAL_HEX8(0x4B, crc8_bitwise(check_text, sizeof check_text));
}

static void test_crc8_of_a_frame_that_spells_the_check_text_is_the_published_value(void)
{
    // The identifier's low byte goes first.
    const frame_t frame = {.id = '2' << 8 | '1', .length = 7, .data = {'3', '4', '5', '6', '7', '8', '9'}};

    TEST_ASSERT_EQUAL_HEX8(0x4B, crc8_frame(&frame, 7));
}

static void test_crc8_of_random_frames_of_every_length_agrees_with_the_reference(void)
{
    uint32_t state = 1;
    for (int round = 0; round < 500; round++) {
        for (uint8_t length = 0; length <= 8; length++) {
            frame_t frame = {.length = length};
            uint8_t text[10];
            for (size_t i = 0; i < sizeof text; i++) {
                text[i] = next_byte(&state);
            }
            frame.id = (uint16_t)(text[0] | text[1] << 8);
            for (size_t i = 0; i < 8; i++) {
                frame.data[i] = text[i + 2];
            }

            TEST_ASSERT_EQUAL_HEX8(crc8_bitwise(text, 2u + length), crc8_frame(&frame, length));
        }
    }
}

static void test_crc8_ignores_data_beyond_the_length(void)
{
    frame_t frame = {.id = 0x123, .length = 8, .data = {1, 2, 3, 4, 5, 6, 7, 8}};
    const uint8_t before = crc8_frame(&frame, 4);
    frame.data[4] = 99;

    TEST_ASSERT_EQUAL_HEX8(before, crc8_frame(&frame, 4));
}

static void test_crc8_depends_on_every_bit_of_the_identifier(void)
{
    frame_t frame = {.id = 0x040, .length = 6, .data = {1, 2, 3, 4, 5}};
    const uint8_t before = crc8_frame(&frame, 5);
    for (int bit = 0; bit < 11; bit++) {
        frame.id = (uint16_t)(0x040u ^ 1u << bit);

        TEST_ASSERT_TRUE(crc8_frame(&frame, 5) != before);
    }
}

// ---- CRC-32

static void test_crc32_of_the_check_text_is_the_published_value(void)
{
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926u, crc32_bitwise(check_text, sizeof check_text));
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926u, crc32_of(check_text, sizeof check_text));
}

static void test_crc32_of_nothing_is_zero(void)
{
    TEST_ASSERT_EQUAL_HEX32(0u, crc32_finish(CRC32_START));
}

static void test_crc32_of_one_letter_is_the_published_value(void)
{
    TEST_ASSERT_EQUAL_HEX32(0xE8B7BE43u, crc32_of((const uint8_t *)"a", 1));
}

static void test_crc32_of_every_single_byte_agrees_with_the_reference(void)
{
    for (uint32_t value = 0; value < 256; value++) {
        const uint8_t byte = (uint8_t)value;

        TEST_ASSERT_EQUAL_HEX32(crc32_bitwise(&byte, 1), crc32_of(&byte, 1));
    }
}

static void test_crc32_of_random_text_agrees_with_the_reference(void)
{
    uint32_t state = 2;
    uint8_t text[1000];
    for (size_t i = 0; i < sizeof text; i++) {
        text[i] = next_byte(&state);
    }
    for (size_t count = 0; count <= sizeof text; count += 37) {
        TEST_ASSERT_EQUAL_HEX32(crc32_bitwise(text, count), crc32_of(text, count));
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_crc8_reference_of_the_check_text_is_the_published_value);
    RUN_TEST(test_crc8_of_a_frame_that_spells_the_check_text_is_the_published_value);
    RUN_TEST(test_crc8_of_random_frames_of_every_length_agrees_with_the_reference);
    RUN_TEST(test_crc8_ignores_data_beyond_the_length);
    RUN_TEST(test_crc8_depends_on_every_bit_of_the_identifier);
    RUN_TEST(test_crc32_of_the_check_text_is_the_published_value);
    RUN_TEST(test_crc32_of_nothing_is_zero);
    RUN_TEST(test_crc32_of_one_letter_is_the_published_value);
    RUN_TEST(test_crc32_of_every_single_byte_agrees_with_the_reference);
    RUN_TEST(test_crc32_of_random_text_agrees_with_the_reference);
    return UNITY_END();
}
