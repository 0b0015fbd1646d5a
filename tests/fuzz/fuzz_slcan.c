// SPDX-License-Identifier: MIT
// SLCAN on any bytes of the line, beside Lawicel's text read a second time: every answer and frame, none besides. The
// input goes in as it is; 0xFF and a number do something else, see `act`.
#include "oracle.h"
#include "slcan.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { ESCAPE = 0xFF, FRAME_TEXT_MAX = 22, KEPT_FOR_ANSWERS = 16 };

/// What the line should have by now.
typedef struct {
    char channel; // C closed, O open, L listening
    bool spoilt, lost;
    char line[SLCAN_LINE_CHARS + 1];
    size_t chars;
    char queue[SLCAN_QUEUE_BYTES];
    size_t queued;
} expected_t;

typedef struct {
    slcan_t slcan;
    expected_t expected;
} line_t;

static void expect_answer(expected_t *expected, const char *text)
{
    const size_t chars = strlen(text);
    if (expected->queued + chars > SLCAN_QUEUE_BYTES) {
        expected->lost = true;
        return;
    }
    memcpy(&expected->queue[expected->queued], text, chars);
    expected->queued += chars;
}

static bool is_hex(const char *text)
{
    for (; *text != '\0'; text++) {
        if (isxdigit((unsigned char)*text) == 0) {
            return false;
        }
    }
    return true;
}

/// A frame's text: t, three digits of an identifier below 800, a length up to 8, as many bytes.
static bool is_frame(const expected_t *expected)
{
    const char *line = expected->line;
    const size_t chars = expected->chars;
    return chars >= 5 && strlen(line) == chars && line[0] == 't' && is_hex(&line[1]) && line[1] <= '7' &&
           line[4] <= '8' && chars == 5 + 2 * (size_t)(line[4] - '0');
}

static void write_frame(char text[FRAME_TEXT_MAX + 1], const frame_t *frame)
{
    int at = snprintf(text, FRAME_TEXT_MAX + 1, "t%03X%d", frame->id, frame->length);
    for (int i = 0; i < frame->length; i++) {
        at += snprintf(&text[at], (size_t)(FRAME_TEXT_MAX + 1 - at), "%02X", frame->data[i]);
    }
    (void)snprintf(&text[at], (size_t)(FRAME_TEXT_MAX + 1 - at), "\r");
}

static bool is_one_of(const expected_t *expected, const char *lines)
{
    // Each word of the list ends in a space, the last one too.
    for (const char *word = lines; *word != '\0'; word = strchr(word, ' ') + 1) {
        const size_t chars = (size_t)(strchr(word, ' ') - word);
        if (chars == expected->chars && memcmp(word, expected->line, chars) == 0) {
            return true;
        }
    }
    return false;
}

/// Does what a line without a frame says; returns its answer.
static const char *command(expected_t *expected)
{
    static char flags[5];
    const bool closed = expected->channel == 'C';
    if (expected->chars == 0) {
        return "\r";
    }
    if (closed && is_one_of(expected, "S0 S1 S2 S3 S4 S5 S6 S7 S8 Z0 ")) {
        return "\r";
    }
    if (is_one_of(expected, closed ? "O L " : "C ")) {
        expected->channel = expected->line[0];
        return "\r";
    }
    if (is_one_of(expected, "V ")) {
        return "V0100\r";
    }
    if (is_one_of(expected, "N ")) {
        return "NOMNI\r";
    }
    if (is_one_of(expected, "F ")) {
        (void)snprintf(flags, sizeof flags, "F%02X\r", expected->lost ? 8 : 0);
        expected->lost = false;
        return flags;
    }
    return "\a";
}

/// Whether the line was a frame for the robot.
static bool end_line(expected_t *expected)
{
    const bool frame = !expected->spoilt && expected->channel == 'O' && is_frame(expected);
    expected->line[expected->spoilt ? 0 : expected->chars] = '\0';
    expect_answer(expected, frame ? "z\r" : expected->spoilt ? "\a" : command(expected));
    return frame;
}

static void start_line(expected_t *expected)
{
    memset(expected->line, 0, sizeof expected->line);
    expected->chars = 0;
    expected->spoilt = false;
}

static void judge_frame(const expected_t *expected, const frame_t *frame)
{
    char text[FRAME_TEXT_MAX + 1];
    REQUIRE(frame->id <= 0x7FF && frame->length <= FRAME_DATA_BYTES, "a classic frame");
    write_frame(text, frame);
    for (size_t i = 1; i < expected->chars; i++) {
        REQUIRE(text[i] == toupper((unsigned char)expected->line[i]), "the frame of the line");
    }
    REQUIRE(text[expected->chars] == '\r', "all of the line");
}

static void feed(line_t *line, uint8_t byte)
{
    expected_t *expected = &line->expected;
    frame_t *frame = malloc(sizeof *frame); // on the heap a byte beside it is found
    REQUIRE(frame != NULL, "memory");
    const bool given = slcan_feed(&line->slcan, byte, frame);
    if (byte != '\r') {
        REQUIRE(!given, "a frame ends with its line");
        if (expected->chars < SLCAN_LINE_CHARS) {
            expected->line[expected->chars++] = (char)byte;
        } else {
            expected->spoilt = true;
        }
    } else {
        REQUIRE(given == end_line(expected), "a frame is given where one is, to an open channel");
        if (given) {
            judge_frame(expected, frame);
        }
        start_line(expected);
    }
    free(frame);
}

static void drain(line_t *line)
{
    uint8_t byte;
    for (size_t i = 0; i < line->expected.queued; i++) {
        REQUIRE(slcan_next(&line->slcan, &byte), "what is queued comes out");
        REQUIRE(byte == (uint8_t)line->expected.queue[i], "the answer that fits");
    }
    REQUIRE(!slcan_next(&line->slcan, &byte), "nothing else comes out");
    line->expected.queued = 0;
}

static void put(line_t *line, const frame_t *frame)
{
    expected_t *expected = &line->expected;
    const bool room = SLCAN_QUEUE_BYTES - expected->queued >= FRAME_TEXT_MAX + KEPT_FOR_ANSWERS;
    const bool taken = room && expected->channel != 'C' && frame->id <= 0x7FF && frame->length <= FRAME_DATA_BYTES;
    REQUIRE(slcan_has_room(&line->slcan) == room, "room for a frame and the answers");
    REQUIRE(slcan_put(&line->slcan, frame) == taken, "classic frames go out while not closed");
    if (taken) {
        char text[FRAME_TEXT_MAX + 1];
        write_frame(text, frame);
        expect_answer(expected, text);
    }
}

/// After ESCAPE: 0 a byte is lost, 1 the queue is taken, 2 the next eleven bytes are a frame of the robot.
static size_t act(line_t *line, const uint8_t *data, size_t size)
{
    const uint8_t kind = size > 0 ? data[0] % 3 : 0;
    if (kind == 0) {
        slcan_note_lost_byte(&line->slcan);
        line->expected.spoilt = line->expected.lost = true;
    } else if (kind == 1) {
        drain(line);
    } else if (size >= 12) {
        frame_t frame = {.id = (uint16_t)(data[1] | data[2] << 8), .length = data[3]};
        memcpy(frame.data, &data[4], sizeof frame.data);
        put(line, &frame);
        return 12;
    }
    return size > 0 ? 1 : 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static line_t line;
    line = (line_t){.expected = {.channel = 'C'}};
    slcan_init(&line.slcan);
    for (size_t at = 0; at < size;) {
        const uint8_t byte = data[at++];
        if (byte == ESCAPE) {
            at += act(&line, &data[at], size - at);
        } else {
            feed(&line, byte);
        }
    }
    drain(&line);
    return 0;
}
