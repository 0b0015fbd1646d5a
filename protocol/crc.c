// SPDX-License-Identifier: MIT
// Checksums by nibble tables: 16 entries each, two look-ups a byte.
#include "crc.h"

static const uint8_t crc8_nibble[16] = {0x00, 0x1D, 0x3A, 0x27, 0x74, 0x69, 0x4E, 0x53,
                                        0xE8, 0xF5, 0xD2, 0xCF, 0x9C, 0x81, 0xA6, 0xBB};

static const uint32_t crc32_nibble[16] = {0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
                                          0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
                                          0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};

static uint8_t crc8_update(uint8_t crc, uint8_t byte)
{
    uint8_t value = crc ^ byte;
    value = (uint8_t)(value << 4) ^ crc8_nibble[value >> 4];
    return (uint8_t)(value << 4) ^ crc8_nibble[value >> 4];
}

uint8_t crc8_frame(const frame_t *frame, uint8_t length)
{
    uint8_t crc = crc8_update(0xFFu, (uint8_t)frame->id);
    crc = crc8_update(crc, (uint8_t)(frame->id >> 8));
    for (uint8_t i = 0; i < length; i++) {
        crc = crc8_update(crc, frame->data[i]);
    }
    return crc ^ 0xFFu;
}

uint32_t crc32_update(uint32_t crc, uint8_t byte)
{
    uint32_t value = crc ^ byte;
    value = (value >> 4) ^ crc32_nibble[value & 0xFu];
    return (value >> 4) ^ crc32_nibble[value & 0xFu];
}

uint32_t crc32_finish(uint32_t crc)
{
    return crc ^ 0xFFFFFFFFu;
}
