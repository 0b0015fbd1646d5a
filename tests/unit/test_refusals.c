// SPDX-License-Identifier: MIT
// What holds for each message of the DBC, whichever there are. Lengths from the list that cantools makes of the DBC: a
// message ends with the last byte that a signal uses.
#include "frame.h"
#include "message_list.h"
#include "messages.h"
#include "unity.h"

#include <string.h>

void setUp(void)
{
}

void tearDown(void)
{
}

#define DECODER(NAME, name, ...)                                                                                       \
    static decode_result_t decode_##name(const frame_t *frame, bool *untouched)                                        \
    {                                                                                                                  \
        name##_message_t message;                                                                                      \
        uint8_t before[sizeof message];                                                                                \
        memset(&message, 0xA5, sizeof message);                                                                        \
        memset(before, 0xA5, sizeof before);                                                                           \
        const decode_result_t result = name##_decode(&message, frame);                                                 \
        *untouched = memcmp(&message, before, sizeof before) == 0;                                                     \
        return result;                                                                                                 \
    }
#define ROW(NAME, name, robot_takes, crc, ...)                                                                         \
    {.label = #NAME, .id = NAME##_FUNCTION * FRAME_NODE_COUNT, .decode = decode_##name, .used = {__VA_ARGS__}},

MESSAGE_LIST(DECODER)

static const struct {
    const char *label;
    uint16_t id;
    decode_result_t (*decode)(const frame_t *frame, bool *untouched);
    uint8_t used[FRAME_DATA_BYTES];
} messages[] = {MESSAGE_LIST(ROW)};

enum { MESSAGES = sizeof messages / sizeof messages[0] };

static uint8_t length_of(int message)
{
    uint8_t length = FRAME_DATA_BYTES;
    while (length > 0 && messages[message].used[length - 1] == 0) {
        length--;
    }
    return length;
}

static void test_decode_of_any_length_but_its_own_is_refused_untouched(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        for (int length = 0; length <= FRAME_DATA_BYTES + 1; length++) {
            const frame_t frame = {.id = messages[i].id, .length = (uint8_t)length};
            bool untouched = false;

            const decode_result_t result = messages[i].decode(&frame, &untouched);

            const bool right = length == length_of(i);
            TEST_ASSERT_EQUAL_MESSAGE(!right, result == DECODE_WRONG_LENGTH, messages[i].label);
            TEST_ASSERT_TRUE_MESSAGE(right || untouched, messages[i].label);
        }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_decode_of_any_length_but_its_own_is_refused_untouched);
    return UNITY_END();
}
