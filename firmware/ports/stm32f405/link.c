// SPDX-License-Identifier: MIT
#include "link.h"

void link_init(link_t *link, usart_t *usart)
{
    link->usart = usart;
    slcan_init(&link->slcan);
}

/// SLCAN refuses the line that a lost byte was part of.
static void pass_on_losses(link_t *link)
{
    const uint32_t lost = atomic_load_explicit(&link->usart->lost_bytes, memory_order_relaxed);
    if (lost != link->lost_bytes) {
        link->lost_bytes = lost;
        slcan_note_lost_byte(&link->slcan);
    }
}

bool link_receive(link_t *link, frame_t *frame)
{
    uint8_t byte;
    while (usart_receive(link->usart, &byte)) {
        pass_on_losses(link);
        if (slcan_feed(&link->slcan, byte, frame)) {
            return true;
        }
    }
    return false;
}

bool link_has_room(const link_t *link)
{
    return link->slcan.channel != SLCAN_CLOSED && slcan_has_room(&link->slcan);
}

void link_send(link_t *link, const frame_t *frame)
{
    slcan_put(&link->slcan, frame);
}

void link_flush(link_t *link)
{
    uint8_t byte;
    while (usart_has_room(link->usart) && slcan_next(&link->slcan, &byte)) {
        usart_send(link->usart, byte);
    }
}
