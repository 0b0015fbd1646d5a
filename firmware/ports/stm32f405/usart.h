// SPDX-License-Identifier: MIT
// A USART with a ring each way (RM0090 30.3): 8 data bits, no parity, one stop bit. The interrupt moves bytes, no more.
#ifndef OMNIBOT_STM32F405_USART_H
#define OMNIBOT_STM32F405_USART_H

#include "registers.h"
#include "ring.h"

// The transmitter takes two bytes in a row, one to shift and one to hold; an emulated one takes any number.
enum { USART_BYTES_PER_INTERRUPT = 256 };

typedef struct {
    usart_registers_t *registers;
    ring_t received, to_send;
    _Atomic uint32_t lost_bytes; // damaged on the line, or come too fast
} usart_t;

/// Starts it; the caller has set up clock and pins. The rate is rounded to a whole sixteenth of a bit.
void usart_start(usart_t *usart, usart_registers_t *registers, uint32_t bus_Hz, uint32_t bits_per_s);

bool usart_has_room(usart_t *usart);

/// Queues a byte; false when there is no room.
bool usart_send(usart_t *usart, uint8_t byte);

/// Takes a byte that came; false when there is none.
bool usart_receive(usart_t *usart, uint8_t *byte);

/// Whether a byte waits to be taken.
bool usart_has_received(usart_t *usart);

/// The interrupt's work: a byte in, and bytes out as long as the transmitter takes them. It may be called from
/// elsewhere while interrupts are masked; QEMU has no interrupt for an empty transmitter, so the main loop does.
void usart_interrupt(usart_t *usart);

#endif
