// SPDX-License-Identifier: MIT
// Frames on their way out, first in first out.
#ifndef OMNIBOT_APP_OUTBOX_H
#define OMNIBOT_APP_OUTBOX_H

#include "frame.h"

#include <stdbool.h>
#include <stdint.h>

enum { OUTBOX_FRAMES = 16 };

typedef struct {
    frame_t frame[OUTBOX_FRAMES];
    uint8_t first;
    uint8_t count;
} outbox_t;

/// Returns false, and keeps what is there, when the box is full.
static inline bool outbox_push(outbox_t *box, const frame_t *frame)
{
    if (box->count == OUTBOX_FRAMES) {
        return false;
    }
    box->frame[(box->first + box->count) % OUTBOX_FRAMES] = *frame;
    box->count++;
    return true;
}

/// Returns false when there is none.
static inline bool outbox_pop(outbox_t *box, frame_t *frame)
{
    if (box->count == 0) {
        return false;
    }
    *frame = box->frame[box->first];
    box->first = (uint8_t)((box->first + 1) % OUTBOX_FRAMES);
    box->count--;
    return true;
}

#endif
