// SPDX-License-Identifier: MIT
// The robot's line to its host: the UART, framed as SLCAN.
#ifndef OMNIBOT_STM32F405_LINK_H
#define OMNIBOT_STM32F405_LINK_H

#include "frame.h"
#include "slcan.h"
#include "usart.h"

typedef struct {
    usart_t *usart;
    slcan_t slcan;
    uint32_t lost_bytes; // of the UART, as far as SLCAN was told
} link_t;

void link_init(link_t *link, usart_t *usart);

/// The next frame from the host; false when there is none.
bool link_receive(link_t *link, frame_t *frame);

/// Whether a frame can be sent now: ask before taking one from where it can't be put back.
bool link_has_room(const link_t *link);

void link_send(link_t *link, const frame_t *frame);

/// Moves what waits towards the line.
void link_flush(link_t *link);

#endif
