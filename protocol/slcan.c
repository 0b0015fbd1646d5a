// SPDX-License-Identifier: MIT
#include "slcan.h"

enum {
    FLAG_DATA_LOST = 1u << 3,
    ID_BITS = 11,
    ID_DIGITS = 3,
    FRAME_HEAD_CHARS = 1 + ID_DIGITS + 1,                          // t iii l
    FRAME_CHARS_MAX = FRAME_HEAD_CHARS + 2 * FRAME_DATA_BYTES + 1, // and CR
    ANSWER_RESERVE = 16,                                           // room that frames leave to answers
};

static const char CR = '\r';

void slcan_init(slcan_t *slcan)
{
    *slcan = (slcan_t){.channel = SLCAN_CLOSED};
}

// ---- the queue

static uint16_t room(const slcan_t *slcan)
{
    return (uint16_t)(SLCAN_QUEUE_BYTES - slcan->count);
}

static void push(slcan_t *slcan, char byte)
{
    slcan->queue[(slcan->head + slcan->count) % SLCAN_QUEUE_BYTES] = (uint8_t)byte;
    slcan->count++;
}

bool slcan_next(slcan_t *slcan, uint8_t *byte)
{
    if (slcan->count == 0) {
        return false;
    }
    *byte = slcan->queue[slcan->head];
    slcan->head = (uint16_t)((slcan->head + 1u) % SLCAN_QUEUE_BYTES);
    slcan->count--;
    return true;
}

/// An answer goes out whole or not at all.
static void answer(slcan_t *slcan, const char *text, uint8_t chars)
{
    if (chars > room(slcan)) {
        slcan->flags |= FLAG_DATA_LOST;
        return;
    }
    for (uint8_t i = 0; i < chars; i++) {
        push(slcan, text[i]);
    }
}

static void answer_whether(slcan_t *slcan, bool done)
{
    answer(slcan, done ? "\r" : "\a", 1);
}

// ---- hexadecimal

static char hex_digit(uint32_t value)
{
    return "0123456789ABCDEF"[value & 0xFu];
}

/// Reads digits, upper or lower case; false at anything else.
static bool parse_hex(const char *text, uint8_t digits, uint16_t *value)
{
    *value = 0;
    for (uint8_t i = 0; i < digits; i++) {
        const char c = text[i];
        uint8_t digit;
        if (c >= '0' && c <= '9') {
            digit = (uint8_t)(c - '0');
        } else if (c >= 'A' && c <= 'F') {
            digit = (uint8_t)(c - 'A' + 10);
        } else if (c >= 'a' && c <= 'f') {
            digit = (uint8_t)(c - 'a' + 10);
        } else {
            return false;
        }
        *value = (uint16_t)(*value << 4 | digit);
    }
    return true;
}

// ---- frames

bool slcan_has_room(const slcan_t *slcan)
{
    return room(slcan) >= FRAME_CHARS_MAX + ANSWER_RESERVE;
}

bool slcan_put(slcan_t *slcan, const frame_t *frame)
{
    const bool is_classic = frame->id >> ID_BITS == 0 && frame->length <= FRAME_DATA_BYTES;
    if (slcan->channel == SLCAN_CLOSED || !slcan_has_room(slcan) || !is_classic) {
        return false;
    }
    push(slcan, 't');
    for (uint32_t shift = 4u * ID_DIGITS; shift > 0u; shift -= 4u) {
        push(slcan, hex_digit((uint32_t)frame->id >> (shift - 4u)));
    }
    push(slcan, hex_digit(frame->length));
    for (uint8_t i = 0; i < frame->length; i++) {
        push(slcan, hex_digit((uint32_t)frame->data[i] >> 4));
        push(slcan, hex_digit(frame->data[i]));
    }
    push(slcan, CR);
    return true;
}

/// tiiildd…: the line must be exactly as long as its length digit says, so that a lost or doubled byte is noticed.
static bool parse_frame(const slcan_t *slcan, frame_t *frame)
{
    uint16_t id, length, byte;
    if (slcan->line[0] != 't' || !parse_hex(&slcan->line[1], ID_DIGITS, &id) || id >> ID_BITS != 0 ||
        !parse_hex(&slcan->line[1 + ID_DIGITS], 1, &length) || length > FRAME_DATA_BYTES ||
        slcan->line_chars != FRAME_HEAD_CHARS + 2 * length) {
        return false;
    }
    *frame = (frame_t){.id = id, .length = (uint8_t)length};
    for (uint8_t i = 0; i < frame->length; i++) {
        if (!parse_hex(&slcan->line[FRAME_HEAD_CHARS + 2 * i], 2, &byte)) {
            return false;
        }
        frame->data[i] = (uint8_t)byte;
    }
    return true;
}

// ---- commands

/// Goes to a state of the channel, which only leads from closed to one of the others and back.
static bool set_channel(slcan_t *slcan, slcan_channel_t wanted)
{
    const bool allowed = (slcan->channel == SLCAN_CLOSED) != (wanted == SLCAN_CLOSED);
    if (allowed) {
        slcan->channel = wanted;
    }
    return allowed;
}

static void answer_flags(slcan_t *slcan)
{
    const char text[] = {'F', hex_digit((uint32_t)slcan->flags >> 4), hex_digit(slcan->flags), CR};
    slcan->flags = 0;
    answer(slcan, text, sizeof text);
}

/// The commands of one letter.
static void act_on_letter(slcan_t *slcan, char letter)
{
    switch (letter) {
    case 'O':
        answer_whether(slcan, set_channel(slcan, SLCAN_OPEN));
        break;
    case 'L':
        answer_whether(slcan, set_channel(slcan, SLCAN_LISTENING));
        break;
    case 'C':
        answer_whether(slcan, set_channel(slcan, SLCAN_CLOSED));
        break;
    case 'V':
        answer(slcan, "V0100\r", 6); // hardware 1, software 0
        break;
    case 'N':
        answer(slcan, "NOMNI\r", 6);
        break;
    case 'F':
        answer_flags(slcan);
        break;
    default:
        answer_whether(slcan, false);
        break;
    }
}

/// S0 … S8 and Z0, while closed.
static bool is_setting(const slcan_t *slcan)
{
    const char name = slcan->line[0], value = slcan->line[1];
    return slcan->channel == SLCAN_CLOSED && slcan->line_chars == 2 &&
           ((name == 'S' && value >= '0' && value <= '8') || (name == 'Z' && value == '0'));
}

/// Does what a line without a frame says, and answers.
static void act_on_command(slcan_t *slcan)
{
    if (slcan->line_chars == 1) {
        act_on_letter(slcan, slcan->line[0]);
    } else {
        answer_whether(slcan, slcan->line_chars == 0 || is_setting(slcan));
    }
}

/// Does what the line says; true when it is a frame for us.
static bool act_on_line(slcan_t *slcan, frame_t *frame)
{
    if (slcan->spoilt) {
        answer_whether(slcan, false);
        return false;
    }
    if (slcan->channel != SLCAN_OPEN || !parse_frame(slcan, frame)) {
        act_on_command(slcan);
        return false;
    }
    answer(slcan, "z\r", 2);
    return true;
}

bool slcan_feed(slcan_t *slcan, uint8_t byte, frame_t *frame)
{
    if (byte == (uint8_t)CR) {
        const bool is_frame = act_on_line(slcan, frame);
        slcan->line_chars = 0;
        slcan->spoilt = false;
        return is_frame;
    }
    if (slcan->line_chars < SLCAN_LINE_CHARS) {
        slcan->line[slcan->line_chars] = (char)byte;
        slcan->line_chars++;
    } else {
        slcan->spoilt = true;
    }
    return false;
}

void slcan_note_lost_byte(slcan_t *slcan)
{
    slcan->spoilt = true;
    slcan->flags |= FLAG_DATA_LOST;
}
