// SPDX-License-Identifier: MIT
// A classic CAN data frame with an 11-bit identifier, as every part of the firmware passes it around.
#ifndef OMNIBOT_PROTOCOL_FRAME_H
#define OMNIBOT_PROTOCOL_FRAME_H

#include <stdint.h>

enum { FRAME_DATA_BYTES = 8, FRAME_NODE_BITS = 4, FRAME_NODE_MASK = 0xF, FRAME_NODE_COUNT = 16 };

typedef struct {
    uint16_t id;    // function << FRAME_NODE_BITS | node
    uint8_t length; // bytes of data in use, 0 … 8
    uint8_t data[FRAME_DATA_BYTES];
} frame_t;

#endif
