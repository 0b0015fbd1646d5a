// SPDX-License-Identifier: MIT
#include "usart.h"

void usart_start(usart_t *usart, usart_registers_t *registers, uint32_t bus_Hz, uint32_t bits_per_s)
{
    usart->registers = registers;
    reg_write(&registers->brr, (bus_Hz + bits_per_s / 2u) / bits_per_s); // sixteen samples a bit: in sixteenths
    reg_write(&registers->cr1, USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE);
}

bool usart_has_room(usart_t *usart)
{
    return ring_room(&usart->to_send) > 0;
}

bool usart_send(usart_t *usart, uint8_t byte)
{
    const bool fits = ring_put(&usart->to_send, byte);
    reg_set(&usart->registers->cr1, USART_CR1_TXEIE);
    return fits;
}

bool usart_has_received(usart_t *usart)
{
    return ring_room(&usart->received) < RING_BYTES;
}

bool usart_receive(usart_t *usart, uint8_t *byte)
{
    return ring_take(&usart->received, byte);
}

/// An overrun without RXNE leaves the last byte in the data register once more: it is read and not kept.
static void take_in(usart_t *usart, uint32_t status)
{
    const uint8_t byte = (uint8_t)reg_read(&usart->registers->dr); // clears RXNE and the errors
    const bool whole = (status & (USART_SR_FE | USART_SR_NF | USART_SR_PE)) == 0;
    const bool kept = (status & USART_SR_RXNE) != 0 && whole && ring_put(&usart->received, byte);
    if (!kept || (status & USART_SR_ORE) != 0) {
        atomic_fetch_add_explicit(&usart->lost_bytes, 1u, memory_order_relaxed);
    }
}

static bool send_one(usart_t *usart)
{
    usart_registers_t *registers = usart->registers;
    const uint32_t control = reg_read(&registers->cr1);
    if ((control & USART_CR1_TXEIE) == 0 || (reg_read(&registers->sr) & USART_SR_TXE) == 0) {
        return false;
    }
    uint8_t byte;
    if (!ring_take(&usart->to_send, &byte)) {
        reg_write(&registers->cr1, control & ~USART_CR1_TXEIE);
        return false;
    }
    reg_write(&registers->dr, byte);
    return true;
}

void usart_interrupt(usart_t *usart)
{
    const uint32_t status = reg_read(&usart->registers->sr);
    if ((status & (USART_SR_RXNE | USART_SR_ORE)) != 0) {
        take_in(usart, status);
    }
    bool sent = true;
    for (uint32_t byte = 0; sent && byte < USART_BYTES_PER_INTERRUPT; byte++) {
        sent = send_one(usart);
    }
}
