// SPDX-License-Identifier: MIT
#include "oracle.h"

#include "message_list.h"
#include "messages.h"

#include <stdio.h>
#include <stdlib.h>

#define DESCRIPTION(NAME, name, robot_takes, crc, ...)                                                                 \
    {.function = NAME##_FUNCTION,                                                                                      \
     .length = NAME##_LENGTH,                                                                                          \
     .to_robot = (robot_takes) != 0,                                                                                   \
     .has_crc = (crc) != 0,                                                                                            \
     .used = {__VA_ARGS__}},

const message_t oracle_messages[] = {MESSAGE_LIST(DESCRIPTION)};
const size_t oracle_message_count = sizeof oracle_messages / sizeof oracle_messages[0];

_Noreturn void oracle_fail(const char *expectation, const char *file, int line)
{
    (void)fprintf(stderr, "%s:%d: broken expectation: %s\n", file, line, expectation);
    abort();
}

const message_t *oracle_message(const frame_t *frame)
{
    for (size_t i = 0; i < oracle_message_count; i++) {
        if (oracle_messages[i].function == frame->id >> FRAME_NODE_BITS) {
            return &oracle_messages[i];
        }
    }
    return NULL;
}

static uint8_t crc8_of(uint8_t crc, uint8_t byte)
{
    crc ^= byte;
    for (int bit = 0; bit < 8; bit++) {
        crc = (uint8_t)((crc & 0x80u) != 0 ? crc << 1 ^ 0x1D : crc << 1);
    }
    return crc;
}

uint8_t oracle_crc8(const frame_t *frame, uint8_t length)
{
    uint8_t crc = crc8_of(crc8_of(0xFF, (uint8_t)frame->id), (uint8_t)(frame->id >> 8));
    for (uint8_t i = 0; i < length; i++) {
        crc = crc8_of(crc, frame->data[i]);
    }
    return (uint8_t)~crc;
}

uint32_t oracle_crc32(const uint8_t *byte, size_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < count; i++) {
        crc ^= byte[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 1u) != 0 ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
        }
    }
    return ~crc;
}

bool oracle_is_whole(const message_t *message, const frame_t *frame)
{
    if (frame->length != message->length) {
        return false;
    }
    const uint8_t last = (uint8_t)(message->length - 1);
    return !message->has_crc || frame->data[last] == oracle_crc8(frame, last);
}
