// SPDX-License-Identifier: MIT
// The device's side of SLCAN, Lawicel's CAN over a serial line in ASCII: what makes a plain UART a CAN adapter for
// python-can's `slcan` and Linux' slcand. Data frames with 11-bit identifiers; no I/O, no heap. Work a call: one line
// at most. Not for two contexts at once: feed, put and take from one.
//
//   line        does                                             answer
//   tiiildd…    a data frame for us, while open                  z CR
//   O  L        opens the channel; L listens only, t is refused  CR; BELL while open
//   C           closes it                                        CR; BELL while closed
//   S0 … S8     bit rate: taken, since there is no bus behind    CR; BELL while open
//   V  N        version, serial number                           V0100 CR, NOMNI CR
//   F           flags since the last F; bit 3: data were lost    Fxx CR
//   Z0          no time stamps, the only way                     CR; BELL while open
//   (nothing)                                                    CR
//   the rest    r, T, R, s, M, m, Z1, too long, not hex …        BELL, and the next line is a new start
#ifndef OMNIBOT_PROTOCOL_SLCAN_H
#define OMNIBOT_PROTOCOL_SLCAN_H

#include "frame.h"

#include <stdbool.h>

// A line holds the longest command that we take, a full frame; a queue some ten frames.
enum { SLCAN_LINE_CHARS = 21, SLCAN_QUEUE_BYTES = 256 };

typedef enum { SLCAN_CLOSED, SLCAN_OPEN, SLCAN_LISTENING } slcan_channel_t;

typedef struct {
    slcan_channel_t channel;
    uint8_t flags;        // for F, since it was asked last
    bool spoilt;          // this line is no good; wait for its end
    uint8_t line_chars;   // of the line so far
    uint16_t head, count; // of the queue
    char line[SLCAN_LINE_CHARS];
    uint8_t queue[SLCAN_QUEUE_BYTES]; // for the line, a ring
} slcan_t;

/// Closed, nothing queued.
void slcan_init(slcan_t *slcan);

/// Takes a byte from the line; true when it ended a data frame, which is then in `frame`. Answers are queued.
bool slcan_feed(slcan_t *slcan, uint8_t byte, frame_t *frame);

/// The UART has lost or damaged a byte: the line that it was part of is refused, and F tells.
void slcan_note_lost_byte(slcan_t *slcan);

/// The next byte for the line; false when there is none.
bool slcan_next(slcan_t *slcan, uint8_t *byte);

/// Whether any frame would fit: ask before taking one from where it can't be put back.
bool slcan_has_room(const slcan_t *slcan);

/// Queues the text of a frame; false when it does not fit, is no classic frame, or the channel is closed: then
/// nothing of it is queued.
bool slcan_put(slcan_t *slcan, const frame_t *frame);

#endif
