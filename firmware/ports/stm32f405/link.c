// SPDX-License-Identifier: MIT
#include "link.h"

void link_init(link_t *link, can_t *can, usart_t *usart, uint8_t node)
{
    link->can = can;
    link->usart = usart;
    link->node = node;
    link->line = can->phase == CAN_ABSENT ? LINE_UART : LINE_CAN;
    link->holding = false;
    link->lost_bytes = 0;
    slcan_init(&link->slcan);
}

// ---- receiving

/// What CAN has not sent is for a host that is elsewhere now.
static void answer_on(link_t *link, line_t line)
{
    if (link->line == LINE_CAN && line == LINE_UART) {
        can_withdraw(link->can);
    }
    link->line = line;
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

static bool feed(link_t *link, uint8_t byte, frame_t *frame)
{
    const bool was_closed = link->slcan.channel == SLCAN_CLOSED;
    pass_on_losses(link);
    const bool whole = slcan_feed(&link->slcan, byte, frame);
    if (was_closed && link->slcan.channel != SLCAN_CLOSED) {
        answer_on(link, LINE_UART);
    }
    return whole;
}

static bool receive_by_uart(link_t *link, frame_t *frame)
{
    uint8_t byte;
    for (uint32_t taken = 0; taken < RING_BYTES && usart_receive(link->usart, &byte); taken++) {
        if (feed(link, byte, frame)) {
            return true;
        }
    }
    return false;
}

bool link_receive(link_t *link, frame_t *frame)
{
    line_t line = LINE_CAN;
    if (!can_receive(link->can, frame)) {
        line = LINE_UART;
        if (!receive_by_uart(link, frame)) {
            return false;
        }
    }
    if ((frame->id & FRAME_NODE_MASK) == link->node) {
        answer_on(link, line);
    }
    return true;
}

bool link_has_input(link_t *link)
{
    return can_has_received(link->can) || usart_has_received(link->usart);
}

// ---- sending

bool link_has_room(const link_t *link)
{
    return !link->holding;
}

static bool pass_on(link_t *link)
{
    return link->line == LINE_CAN ? can_send(link->can, &link->held) : slcan_put(&link->slcan, &link->held);
}

void link_send(link_t *link, const frame_t *frame)
{
    link->held = *frame;
    link->holding = !pass_on(link);
}

bool link_flush(link_t *link)
{
    if (link->holding) {
        link->holding = !pass_on(link);
    }
    uint8_t byte;
    for (uint32_t moved = 0; moved < SLCAN_QUEUE_BYTES && usart_has_room(link->usart); moved++) {
        if (!slcan_next(&link->slcan, &byte)) {
            break;
        }
        (void)usart_send(link->usart, byte);
    }
    return link->holding && (link->line == LINE_CAN || link->slcan.channel != SLCAN_CLOSED);
}
