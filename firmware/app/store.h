// SPDX-License-Identifier: MIT
// The trajectory store: receives a trajectory over the bus byte by byte and holds it while it is driven. The bytes of a
// segment are those of protocol/README.md: duration in µs, then three axes of eight coefficients, each four bytes,
// little-endian.
#ifndef OMNIBOT_APP_STORE_H
#define OMNIBOT_APP_STORE_H

#include "trajectory.h"

#include <stdbool.h>
#include <stdint.h>

enum {
    STORE_SEGMENTS_MAX = 128,
    STORE_WORDS_PER_SEGMENT = 1 + TRAJECTORY_AXES * TRAJECTORY_COEFFICIENTS,
    STORE_BYTES_PER_SEGMENT = 4 * STORE_WORDS_PER_SEGMENT,
    STORE_BYTES_PER_FRAME = 6,
    STORE_FRAMES_PER_ACK = 16
};

typedef struct {
    trajectory_segment_t segment[STORE_SEGMENTS_MAX];
    uint16_t segment_count; // 0 until a whole upload has passed every check
    uint16_t length_bytes;  // announced
    uint16_t received_bytes;
    uint32_t announced_crc32;
    uint32_t running_crc32;
    uint32_t word; // bytes of the word that is not complete yet
    bool receiving;
} store_t;

/// What the sender is to be told, if anything.
typedef struct {
    bool send;
    uint8_t result; // TRAJECTORY_ACK_RESULT_…
} store_answer_t;

/// Starts an upload; the trajectory held before is gone, so that what was to be replaced is never driven instead of
/// what was refused, and one store is enough: a second one would take more RAM than all the rest. Refused, with
/// everything left as it is, unless it is 1 … STORE_SEGMENTS_MAX whole segments.
store_answer_t store_begin(store_t *store, uint16_t length_bytes, uint32_t crc32);

/// Takes the next bytes; those past the announced length are padding. Acknowledges every STORE_FRAMES_PER_ACK frames,
/// at the end, and at an offset that is not the next. The last byte is answered by what is wrong with the whole, CRC
/// first, or by COMPLETE; only then is there a trajectory.
store_answer_t store_data(store_t *store, uint16_t offset_bytes, const uint8_t data[STORE_BYTES_PER_FRAME]);

#endif
