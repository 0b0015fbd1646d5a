// SPDX-License-Identifier: MIT
// Every decoder on any frame: it takes what length and CRC allow and nothing else, what it takes comes back bit for
// bit but for the bits of no signal, what it refuses leaves the message as it was, and it stays inside both.
#include "message_list.h"
#include "messages.h"
#include "oracle.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { UNTOUCHED = 0xA5 };

/// The frame that a right codec makes of what it has read: unused bits are zero, under a CRC of their own.
static frame_t canonical(const message_t *message, const frame_t *frame)
{
    frame_t made = {.id = frame->id, .length = frame->length};
    for (int i = 0; i < FRAME_DATA_BYTES; i++) {
        made.data[i] = frame->data[i] & message->used[i];
    }
    if (message->has_crc) {
        const uint8_t last = (uint8_t)(message->length - 1);
        made.data[last] = oracle_crc8(&made, last);
    }
    return made;
}

static bool is_same(const frame_t *a, const frame_t *b)
{
    return a->id == b->id && a->length == b->length && memcmp(a->data, b->data, sizeof a->data) == 0;
}

static bool is_untouched(const void *memory, size_t size)
{
    const uint8_t *byte = memory;
    for (size_t i = 0; i < size; i++) {
        if (byte[i] != UNTOUCHED) {
            return false;
        }
    }
    return true;
}

static void *claim(size_t size)
{
    void *memory = malloc(size); // on the heap a byte beside it is found
    REQUIRE(memory != NULL, "memory");
    memset(memory, UNTOUCHED, size);
    return memory;
}

/// Decodes, encodes and decodes again.
#define TRIP(NAME, name, ...)                                                                                          \
    static void trip_##name(const message_t *message, const frame_t *frame)                                            \
    {                                                                                                                  \
        name##_message_t *read = claim(sizeof *read);                                                                  \
        const decode_result_t result = name##_decode(read, frame);                                                     \
        REQUIRE((result == DECODE_OK) == oracle_is_whole(message, frame), #NAME ": length and CRC decide");            \
        if (result != DECODE_OK) {                                                                                     \
            REQUIRE(is_untouched(read, sizeof *read), #NAME ": what is refused is not half used");                     \
        } else {                                                                                                       \
            const frame_t expected = canonical(message, frame);                                                        \
            frame_t *made = claim(sizeof *made);                                                                       \
            name##_encode(made, (uint8_t)(frame->id & FRAME_NODE_MASK), read);                                         \
            REQUIRE(is_same(made, &expected), #NAME ": encoding gives back what was decoded");                         \
            REQUIRE(name##_decode(read, made) == DECODE_OK, #NAME ": what was encoded can be decoded");                \
            name##_encode(made, (uint8_t)(frame->id & FRAME_NODE_MASK), read);                                         \
            REQUIRE(is_same(made, &expected), #NAME ": a second round changes nothing");                               \
            free(made);                                                                                                \
        }                                                                                                              \
        free(read);                                                                                                    \
    }

MESSAGE_LIST(TRIP)

#define POINTER(NAME, name, ...) trip_##name,

static void (*const trips[])(const message_t *message, const frame_t *frame) = {MESSAGE_LIST(POINTER)};

/// Byte 0: message; 1: node, and whether length and CRC are put right; 2: length; then data.
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    uint8_t byte[3 + FRAME_DATA_BYTES] = {0};
    memcpy(byte, data, size < sizeof byte ? size : sizeof byte);
    const size_t i = byte[0] % oracle_message_count;
    const message_t *message = &oracle_messages[i];
    frame_t *frame = claim(sizeof *frame);
    frame->id = (uint16_t)(message->function << FRAME_NODE_BITS | (byte[1] & FRAME_NODE_MASK));
    frame->length = byte[2];
    memcpy(frame->data, &byte[3], sizeof frame->data);
    if ((byte[1] & 0x80u) == 0) {
        const uint8_t last = (uint8_t)(message->length - 1);
        frame->length = message->length;
        frame->data[last] = message->has_crc ? oracle_crc8(frame, last) : frame->data[last];
    }
    trips[i](message, frame);
    free(frame);
    return 0;
}
