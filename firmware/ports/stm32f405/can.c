// SPDX-License-Identifier: MIT
#include "can.h"

#include "messages.h"

// Bit timing (RM0090 32.7.7): a bit is 1 + TS1 + TS2 quanta, sampled after 1 + TS1 of them.
enum { BUS_Hz = 42000000, BIT_RATE = 1000000, PRESCALER = 3, TS1 = 11, TS2 = 2, SJW = 2, QUANTA = 1 + TS1 + TS2 };
static_assert(BIT_RATE * PRESCALER * QUANTA == BUS_Hz, "not 1 Mbit/s");
static_assert(1000 * (1 + TS1) / QUANTA >= 840 && 1000 * (1 + TS1) / QUANTA <= 880, "sample point not about 85 %");
static_assert(TS1 <= 16 && TS2 <= 8 && SJW <= 4 && SJW <= TS2 && PRESCALER <= 1024, "out of the register's range");

// Out of reset the controller sleeps and has no frame to finish: it acknowledges within a few of its clocks.
#define INITIALISATION_POLLS WAIT_POLLS(1000, 168)

enum { SET_UP_FILTERS = 3 };
#define SET_UP_BANKS (((1u << (uint32_t)SET_UP_FILTERS) - 1u) << 1) // bank 0 is the control loop's
#define BANKS_IN_USE (SET_UP_BANKS | 1u)

// ---- set-up

static void set_filter(can_registers_t *registers, uint32_t bank, uint16_t id, uint16_t id_mask)
{
    reg_write(&registers->filter[bank].r1, CAN_IR_STID(id));
    reg_write(&registers->filter[bank].r2, CAN_IR_STID(id_mask) | CAN_IR_IDE | CAN_IR_RTR); // data frames, 11 bits
}

/// The frames of the control loop and COMMAND, identifiers below 0x100, come through FIFO 0, those of set-up through
/// FIFO 1: an upload cannot push a stop out. No identifier passes two banks, so no rule of precedence is needed.
static void set_filters(can_registers_t *registers, uint8_t node)
{
    reg_set(&registers->fmr, CAN_FMR_FINIT);
    reg_write(&registers->fa1r, 0);
    reg_write(&registers->fm1r, 0); // identifier and mask
    reg_write(&registers->fs1r, BANKS_IN_USE);
    reg_write(&registers->ffa1r, SET_UP_BANKS);
    set_filter(registers, 0, node, 0x700u | FRAME_NODE_MASK);
    for (uint32_t bank = 1; bank <= SET_UP_FILTERS; bank++) {
        const uint16_t highest = (uint16_t)(0x800u >> bank); // the highest bit that is set: 0x400, 0x200, 0x100
        set_filter(registers, bank, highest | node, (uint16_t)((0x800u - highest) | FRAME_NODE_MASK));
    }
    reg_write(&registers->fa1r, BANKS_IN_USE);
    reg_clear(&registers->fmr, CAN_FMR_FINIT);
}

static void enter_phase(can_t *can, can_phase_t phase)
{
    can->phase = phase;
    can->phase_ticks = 0;
}

/// Out of the initialisation mode, with the mailboxes in order of their identifiers (TXFP 0), and no automatic return
/// from a bus-off (ABOM 0).
static void join(can_t *can)
{
    reg_write(&can->registers->mcr, CAN_MCR_DBF);
    enter_phase(can, CAN_JOINING);
}

bool can_start(can_t *can, can_registers_t *registers, uint32_t bus_Hz, uint8_t node)
{
    can->registers = registers;
    enter_phase(can, CAN_ABSENT);
    if (bus_Hz != BUS_Hz) {
        return false;
    }
    reg_write(&registers->mcr, CAN_MCR_DBF | CAN_MCR_INRQ); // and out of sleep
    if (!wait_until(&registers->msr, CAN_MSR_INAK | CAN_MSR_SLAK, CAN_MSR_INAK, INITIALISATION_POLLS)) {
        return false;
    }
    reg_write(&registers->btr, CAN_BTR_BRP(PRESCALER) | CAN_BTR_TS1(TS1) | CAN_BTR_TS2(TS2) | CAN_BTR_SJW(SJW));
    set_filters(registers, node);
    reg_write(&registers->ier, CAN_IER_FMPIE0 | CAN_IER_FMPIE1);
    join(can);
    return true;
}

// ---- sending

static bool is_free(const can_t *can, uint32_t mailbox)
{
    return (reg_read(&can->registers->tsr) & CAN_TSR_TME(mailbox)) != 0;
}

/// The mailbox to take; CAN_MAILBOXES when the frame must wait.
static uint32_t mailbox_for(const can_t *can, uint16_t id)
{
    uint32_t chosen = CAN_MAILBOXES;
    for (uint32_t mailbox = 0; mailbox < CAN_MAILBOXES; mailbox++) {
        const bool free = is_free(can, mailbox);
        if (!free && can->pending_id[mailbox] == id) {
            return CAN_MAILBOXES;
        }
        chosen = free ? mailbox : chosen;
    }
    return chosen;
}

static uint32_t word_of(const uint8_t *byte)
{
    return (uint32_t)byte[0] | (uint32_t)byte[1] << 8 | (uint32_t)byte[2] << 16 | (uint32_t)byte[3] << 24;
}

static void fill(can_mailbox_registers_t *mailbox, const frame_t *frame)
{
    reg_write(&mailbox->dtr, frame->length);
    reg_write(&mailbox->dlr, word_of(frame->data));
    reg_write(&mailbox->dhr, word_of(&frame->data[4]));
    reg_write(&mailbox->ir, CAN_IR_STID(frame->id) | CAN_IR_TXRQ);
}

bool can_send(can_t *can, const frame_t *frame)
{
    if (can->phase == CAN_JOINING) {
        return false;
    }
    if (can->phase != CAN_RUNNING) {
        can->unsent++;
        return true;
    }
    const uint32_t mailbox = mailbox_for(can, frame->id);
    if (mailbox == CAN_MAILBOXES) {
        return false;
    }
    can->pending_id[mailbox] = frame->id;
    can->pending_ticks[mailbox] = 0;
    fill(&can->registers->tx[mailbox], frame);
    return true;
}

static void withdraw(can_t *can, uint32_t mailbox)
{
    reg_write(&can->registers->tsr, CAN_TSR_ABRQ(mailbox));
    can->unsent++;
}

void can_withdraw(can_t *can)
{
    for (uint32_t mailbox = 0; can->phase != CAN_ABSENT && mailbox < CAN_MAILBOXES; mailbox++) {
        if (!is_free(can, mailbox)) {
            withdraw(can, mailbox);
        }
    }
}

static void withdraw_old(can_t *can)
{
    for (uint32_t mailbox = 0; mailbox < CAN_MAILBOXES; mailbox++) {
        if (!is_free(can, mailbox) && can->pending_ticks[mailbox]++ == CAN_SEND_TICKS_MAX) {
            withdraw(can, mailbox);
        }
    }
}

// ---- the bus

static uint8_t state_of(const can_t *can, uint32_t errors)
{
    if (can->phase != CAN_RUNNING || (errors & CAN_ESR_BOFF) != 0) {
        return CAN_STATE_BUS_OFF;
    }
    if ((errors & CAN_ESR_EPVF) != 0) {
        return CAN_STATE_PASSIVE;
    }
    return (errors & CAN_ESR_EWGF) != 0 ? CAN_STATE_WARNING : CAN_STATE_ACTIVE;
}

can_condition_t can_condition(const can_t *can)
{
    if (can->phase == CAN_ABSENT) {
        return (can_condition_t){.state = CAN_STATE_ABSENT};
    }
    const uint32_t errors = reg_read(&can->registers->esr);
    return (can_condition_t){
        .state = state_of(can, errors),
        .transmit_errors = CAN_ESR_TEC(errors),
        .receive_errors = CAN_ESR_REC(errors),
    };
}

static bool is_off_bus(const can_t *can)
{
    return (reg_read(&can->registers->esr) & CAN_ESR_BOFF) != 0;
}

static bool in_initialisation(const can_t *can)
{
    return (reg_read(&can->registers->msr) & CAN_MSR_INAK) != 0;
}

static void leave_bus(can_t *can)
{
    can->bus_offs++;
    can_withdraw(can);
    enter_phase(can, CAN_BUS_OFF);
}

void can_tick(can_t *can)
{
    can->phase_ticks++;
    switch (can->phase) {
    case CAN_JOINING:
        if (!in_initialisation(can) && !is_off_bus(can)) {
            enter_phase(can, CAN_RUNNING);
        }
        break;
    case CAN_RUNNING:
        if (is_off_bus(can)) {
            leave_bus(can);
        } else {
            withdraw_old(can);
        }
        break;
    case CAN_BUS_OFF:
        if (can->phase_ticks >= CAN_BUS_OFF_TICKS) {
            reg_write(&can->registers->mcr, CAN_MCR_DBF | CAN_MCR_INRQ);
            enter_phase(can, CAN_RESTARTING);
        }
        break;
    case CAN_RESTARTING:
        if (in_initialisation(can)) {
            join(can);
        }
        break;
    case CAN_ABSENT:
    default:
        break;
    }
}

// ---- receiving

static void lose(can_t *can)
{
    atomic_fetch_add_explicit(&can->lost, 1u, memory_order_relaxed);
}

static void put(can_t *can, const frame_t *frame)
{
    can_ring_t *ring = &can->received;
    const uint32_t count = atomic_load_explicit(&ring->put, memory_order_relaxed);
    if (count - atomic_load_explicit(&ring->taken, memory_order_acquire) == CAN_RECEIVED_FRAMES) {
        lose(can);
        return;
    }
    ring->frame[count % CAN_RECEIVED_FRAMES] = *frame;
    atomic_store_explicit(&ring->put, count + 1u, memory_order_release);
}

bool can_has_received(can_t *can)
{
    return atomic_load_explicit(&can->received.taken, memory_order_relaxed) !=
           atomic_load_explicit(&can->received.put, memory_order_acquire);
}

bool can_receive(can_t *can, frame_t *frame)
{
    if (!can_has_received(can)) {
        return false;
    }
    can_ring_t *ring = &can->received;
    const uint32_t count = atomic_load_explicit(&ring->taken, memory_order_relaxed);
    *frame = ring->frame[count % CAN_RECEIVED_FRAMES];
    atomic_store_explicit(&ring->taken, count + 1u, memory_order_release);
    return true;
}

static frame_t read_mailbox(const can_mailbox_registers_t *mailbox)
{
    const uint32_t length = reg_read(&mailbox->dtr) & CAN_DTR_DLC_MASK;
    const uint32_t word[2] = {reg_read(&mailbox->dlr), reg_read(&mailbox->dhr)};
    frame_t frame = {
        .id = CAN_IR_STID_OF(reg_read(&mailbox->ir)),
        .length = (uint8_t)(length <= FRAME_DATA_BYTES ? length : FRAME_DATA_BYTES), // 9 … 15 mean 8 on the wire
    };
    for (uint32_t i = 0; i < frame.length; i++) {
        frame.data[i] = (uint8_t)(word[i / 4u] >> (8u * (i % 4u)));
    }
    return frame;
}

void can_interrupt(can_t *can, uint32_t fifo)
{
    reg_t *status = &can->registers->rfr[fifo];
    const uint32_t state = reg_read(status);
    if ((state & CAN_RFR_FOVR) != 0) {
        lose(can);
        reg_write(status, CAN_RFR_FOVR); // cleared by writing it
    }
    if ((state & CAN_RFR_FMP_MASK) != 0) {
        const frame_t frame = read_mailbox(&can->registers->rx[fifo]);
        put(can, &frame);
        reg_write(status, CAN_RFR_RFOM);
    }
}
