// SPDX-License-Identifier: MIT
// The two checksums of the wire (protocol/README.md).
#ifndef OMNIBOT_PROTOCOL_CRC_H
#define OMNIBOT_PROTOCOL_CRC_H

#include "frame.h"

#include <stdint.h>

/// CRC-8 SAE J1850 (polynomial 0x1D, start 0xFF, final 0xFF) of a frame: identifier, low byte first, then the first
/// `length` data bytes. The identifier is in it so that a frame from elsewhere under a wrong name is noticed.
uint8_t crc8_frame(const frame_t *frame, uint8_t length);

/// CRC-32 (ISO-HDLC, as zlib): start with `CRC32_START`, feed the bytes one by one, end with `crc32_finish`.
#define CRC32_START 0xFFFFFFFFu
uint32_t crc32_update(uint32_t crc, uint8_t byte);
uint32_t crc32_finish(uint32_t crc);

#endif
