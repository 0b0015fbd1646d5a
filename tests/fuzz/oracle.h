// SPDX-License-Identifier: MIT
// What the fuzz targets judge by: broken expectations end the process, frames are read without the codec under test.
#ifndef OMNIBOT_FUZZ_ORACLE_H
#define OMNIBOT_FUZZ_ORACLE_H

#include "frame.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// Ends the process with what was expected and where, unless it holds.
#define REQUIRE(holds, expectation)                                                                                    \
    do {                                                                                                               \
        if (!(holds)) {                                                                                                \
            oracle_fail(expectation, __FILE__, __LINE__);                                                              \
        }                                                                                                              \
    } while (0)

_Noreturn void oracle_fail(const char *expectation, const char *file, int line);

/// A message as protocol/omnibot.dbc has it.
typedef struct {
    uint16_t function;
    uint8_t length;
    bool to_robot;                  // else from it
    bool has_crc;                   // in its last byte
    uint8_t used[FRAME_DATA_BYTES]; // bits that belong to a signal
} message_t;

extern const message_t oracle_messages[];
extern const size_t oracle_message_count;

/// The message of a frame; NULL when there is none.
const message_t *oracle_message(const frame_t *frame);

/// CRC-8 SAE J1850 of identifier and data, bit by bit.
uint8_t oracle_crc8(const frame_t *frame, uint8_t length);

/// CRC-32 as zlib's, bit by bit.
uint32_t oracle_crc32(const uint8_t *byte, size_t count);

/// The right length and CRC for its message.
bool oracle_is_whole(const message_t *message, const frame_t *frame);

#endif
