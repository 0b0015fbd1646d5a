// SPDX-License-Identifier: MIT
// bxCAN at 1 Mbit/s (RM0090 32). Nothing here waits for the bus: what takes the bus' time is a state that can_tick
// moves on, once a period. Receiving is the interrupts' work, all else the main loop's.
//
//   ABSENT     the controller did not answer, or the clock is not the crystal's 42 MHz: no CAN, for good
//   JOINING    waits for 11 recessive bits in a row, after a bus-off for 128 times as many
//   RUNNING
//   BUS_OFF    holds off for CAN_BUS_OFF_TICKS: a node that disturbs the bus does not come back at once
//   RESTARTING goes through the initialisation mode, which is how software ends a bus-off (32.7.6; ABOM is 0)
#ifndef OMNIBOT_STM32F405_CAN_H
#define OMNIBOT_STM32F405_CAN_H

#include "frame.h"
#include "registers.h"

#include <stdatomic.h>

enum {
    CAN_MAILBOXES = 3,
    CAN_RECEIVED_FRAMES = 32, // a power of two
    CAN_SEND_TICKS_MAX = 50,  // a frame that nobody has acknowledged for longer is taken back
    CAN_BUS_OFF_TICKS = 100
};

typedef enum { CAN_ABSENT, CAN_JOINING, CAN_RUNNING, CAN_BUS_OFF, CAN_RESTARTING } can_phase_t;

/// Frames between the interrupts and the main loop; the counts run freely and wrap.
typedef struct {
    _Atomic uint32_t put, taken;
    frame_t frame[CAN_RECEIVED_FRAMES];
} can_ring_t;

typedef struct {
    can_registers_t *registers;
    can_phase_t phase;
    uint32_t phase_ticks;                  // since it began
    uint32_t pending_ticks[CAN_MAILBOXES]; // since the mailbox was filled
    uint16_t pending_id[CAN_MAILBOXES];
    uint32_t unsent; // frames taken back, or given while off the bus
    uint32_t bus_offs;
    _Atomic uint32_t lost; // frames received and overwritten, here or in the controller
    can_ring_t received;
} can_t;

/// How the bus is doing.
typedef struct {
    uint8_t state; // CAN_STATE_… of the wire; BUS_OFF until it has been joined
    uint8_t transmit_errors, receive_errors;
} can_condition_t;

/// Sets the controller up for the frames of one node and lets it join the bus; false: ABSENT. bus_Hz is APB1's clock.
bool can_start(can_t *can, can_registers_t *registers, uint32_t bus_Hz, uint8_t node);

/// A period has passed.
void can_tick(can_t *can);

/// Gives a frame to the controller; false when it must wait: no mailbox is free, one with the same identifier is on its
/// way (two of them could overtake each other), or the bus is still being joined. Off the bus frames are dropped and
/// counted: nobody is served by old ones later.
bool can_send(can_t *can, const frame_t *frame);

/// Takes back what has not been sent.
void can_withdraw(can_t *can);

/// Takes a frame that came; false when there is none.
bool can_receive(can_t *can, frame_t *frame);

can_condition_t can_condition(const can_t *can);

/// Whether a frame waits to be taken.
bool can_has_received(can_t *can);

/// The work of the interrupts of receive FIFO 0 and 1: one frame; the interrupt comes again for the next. Both must
/// have one priority, so that neither interrupts the other.
void can_interrupt(can_t *can, uint32_t fifo);

#endif
