// SPDX-License-Identifier: MIT
#include "store.h"

#include "crc.h"
#include "messages.h"
#include "wire.h"

store_answer_t store_begin(store_t *store, uint16_t length_bytes, uint32_t crc32)
{
    const uint16_t segments = length_bytes / STORE_BYTES_PER_SEGMENT;
    const bool whole = length_bytes % STORE_BYTES_PER_SEGMENT == 0;
    if (!whole || segments == 0 || segments > STORE_SEGMENTS_MAX) {
        return (store_answer_t){true, TRAJECTORY_ACK_RESULT_WRONG_LENGTH};
    }
    store->segment_count = 0;
    store->length_bytes = length_bytes;
    store->received_bytes = 0;
    store->announced_crc32 = crc32;
    store->running_crc32 = CRC32_START;
    store->receiving = true;
    return (store_answer_t){true, TRAJECTORY_ACK_RESULT_RECEIVING};
}

/// Puts the word-th word of the upload where it belongs.
static void put_word(store_t *store, uint16_t word, uint32_t bits)
{
    trajectory_segment_t *segment = &store->segment[word / STORE_WORDS_PER_SEGMENT];
    const uint16_t place = word % STORE_WORDS_PER_SEGMENT;
    if (place == 0) {
        segment->duration_us = bits;
        return;
    }
    const uint16_t coefficient = place - 1;
    segment->coefficient[coefficient / TRAJECTORY_COEFFICIENTS][coefficient % TRAJECTORY_COEFFICIENTS] =
        wire_float(bits);
}

static void put_byte(store_t *store, uint8_t byte)
{
    store->running_crc32 = crc32_update(store->running_crc32, byte);
    store->word = (store->word >> 8) | (uint32_t)byte << 24;
    store->received_bytes++;
    if (store->received_bytes % 4 == 0) {
        put_word(store, (uint16_t)(store->received_bytes / 4 - 1), store->word);
    }
}

/// The first thing that is wrong with what was received: no check need cope with what an earlier one refuses.
static uint8_t judge(const store_t *store, uint16_t segments)
{
    if (crc32_finish(store->running_crc32) != store->announced_crc32) {
        return TRAJECTORY_ACK_RESULT_WRONG_CRC;
    }
    if (!trajectory_coefficients_are_valid(store->segment, segments)) {
        return TRAJECTORY_ACK_RESULT_BAD_SEGMENT;
    }
    if (!trajectory_durations_are_valid(store->segment, segments)) {
        return TRAJECTORY_ACK_RESULT_BAD_DURATION;
    }
    if (!trajectory_is_continuous(store->segment, segments)) {
        return TRAJECTORY_ACK_RESULT_DISCONTINUOUS;
    }
    return TRAJECTORY_ACK_RESULT_COMPLETE;
}

static store_answer_t finish(store_t *store)
{
    const uint16_t segments = store->length_bytes / STORE_BYTES_PER_SEGMENT;
    const uint8_t result = judge(store, segments);
    store->receiving = false;
    store->segment_count = result == TRAJECTORY_ACK_RESULT_COMPLETE ? segments : 0;
    return (store_answer_t){true, result};
}

store_answer_t store_data(store_t *store, uint16_t offset_bytes, const uint8_t data[STORE_BYTES_PER_FRAME])
{
    if (!store->receiving || offset_bytes != store->received_bytes) {
        return (store_answer_t){true, TRAJECTORY_ACK_RESULT_WRONG_OFFSET};
    }
    for (int i = 0; i < STORE_BYTES_PER_FRAME && store->received_bytes < store->length_bytes; i++) {
        put_byte(store, data[i]);
    }
    if (store->received_bytes == store->length_bytes) {
        return finish(store);
    }
    const bool acknowledge = store->received_bytes % (STORE_BYTES_PER_FRAME * STORE_FRAMES_PER_ACK) == 0;
    return (store_answer_t){acknowledge, TRAJECTORY_ACK_RESULT_RECEIVING};
}
