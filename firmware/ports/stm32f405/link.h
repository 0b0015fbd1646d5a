// SPDX-License-Identifier: MIT
// The robot's two lines to a host: CAN, and the UART framed as SLCAN. It listens to both and answers where it was last
// asked: on the line that last brought a frame for its node or, the UART, was opened. Before that, on CAN where there
// is one. Frames that a closed UART or a bus still to be joined cannot take are kept, in order.
#ifndef OMNIBOT_STM32F405_LINK_H
#define OMNIBOT_STM32F405_LINK_H

#include "can.h"
#include "frame.h"
#include "slcan.h"
#include "usart.h"

typedef enum { LINE_CAN, LINE_UART } line_t;

typedef struct {
    can_t *can;
    usart_t *usart;
    uint8_t node;
    line_t line; // where answers go
    slcan_t slcan;
    uint32_t lost_bytes; // of the UART, as far as SLCAN was told
    frame_t held;        // the next one to be sent
    bool holding;
} link_t;

/// Takes over both lines, started or not.
void link_init(link_t *link, can_t *can, usart_t *usart, uint8_t node);

/// The next frame from either line; false when there is none.
bool link_receive(link_t *link, frame_t *frame);

/// Whether something waits to be received.
bool link_has_input(link_t *link);

/// Whether a frame can be given: ask before taking one from where it can't be put back.
bool link_has_room(const link_t *link);

void link_send(link_t *link, const frame_t *frame);

/// Moves what waits towards the lines; true when it should be called again soon, because there was no room.
bool link_flush(link_t *link);

#endif
