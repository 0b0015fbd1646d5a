// SPDX-License-Identifier: MIT
#include "program.h"

#include "messages.h"
#include "oracle.h"

#include <float.h>
#include <math.h>
#include <string.h>

// ---- bytes

bool source_is_empty(const source_t *source)
{
    return source->data != NULL && source->size == 0;
}

/// SplitMix64.
static uint64_t next_random(source_t *source)
{
    source->random += 0x9E3779B97F4A7C15u;
    uint64_t z = source->random;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

static uint8_t take(source_t *source)
{
    if (source->data == NULL) {
        if (source->bytes_left == 0) {
            source->word = next_random(source);
            source->bytes_left = 8;
        }
        source->bytes_left--;
        const uint8_t byte = (uint8_t)source->word;
        source->word >>= 8;
        return byte;
    }
    if (source->size == 0) {
        return 0;
    }
    source->size--;
    return *source->data++;
}

static uint16_t take16(source_t *source)
{
    const uint8_t low = take(source);
    return (uint16_t)(low | take(source) << 8);
}

static uint32_t take32(source_t *source)
{
    const uint32_t low = take16(source);
    return low | (uint32_t)take16(source) << 16;
}

static float take_any_float(source_t *source)
{
    const uint32_t bits = take32(source);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/// −1 … 1 in 255 steps, times a size.
static float take_float(source_t *source, float size)
{
    return size * (float)(int8_t)take(source) / 128.0f;
}

/// Numbers that break arithmetic, or any other.
static float take_nasty_float(source_t *source)
{
    static const float nasty[] = {0.0f,    -0.0f,    NAN,  INFINITY, -INFINITY, FLT_MAX, -FLT_MAX,
                                  FLT_MIN, 1.0e-45f, 1.0f, -1.0f,    1.0e4f,    -1.0e4f, 1.0e9f};
    const size_t count = sizeof nasty / sizeof nasty[0];
    const size_t which = take(source) % (2 * count);
    return which < count ? nasty[which] : take_any_float(source);
}

// ---- frames

/// Any frame, most of them for nobody.
static void any_frame(subject_t *subject, source_t *source)
{
    frame_t frame = {.id = take16(source), .length = take(source)};
    for (int i = 0; i < FRAME_DATA_BYTES; i++) {
        frame.data[i] = take(source);
    }
    subject_receive(subject, &frame);
}

static void put_crc_right(const message_t *message, frame_t *frame)
{
    if (message->has_crc) {
        const uint8_t last = (uint8_t)(message->length - 1);
        frame->data[last] = oracle_crc8(frame, last);
    }
}

static frame_t whole_frame(source_t *source)
{
    const message_t *message = &oracle_messages[take(source) % oracle_message_count];
    const uint8_t node = take(source);
    frame_t frame = {.length = message->length};
    // one in four for a neighbour
    frame.id = (uint16_t)(message->function << FRAME_NODE_BITS | (node < 0x40 ? node & FRAME_NODE_MASK : SUBJECT_NODE));
    for (int i = 0; i < message->length; i++) {
        frame.data[i] = take(source);
    }
    put_crc_right(message, &frame);
    return frame;
}

static void any_whole_frame(subject_t *subject, source_t *source)
{
    const frame_t frame = whole_frame(source);
    subject_receive(subject, &frame);
}

/// A frame of another length, or with a bit turned over.
static void damaged_frame(subject_t *subject, source_t *source)
{
    frame_t frame = whole_frame(source);
    const uint8_t damage = take(source);
    if ((damage & 0x80u) != 0) {
        frame.length = damage & 0xFu;
    } else {
        frame.data[damage >> 3 & 7u] ^= (uint8_t)(1u << (damage & 7u));
    }
    subject_receive(subject, &frame);
}

// ---- set-up

static void send_hello(subject_t *subject, uint32_t hash)
{
    frame_t frame;
    hello_encode(&frame, SUBJECT_NODE, &(hello_message_t){hash});
    subject_receive(subject, &frame);
}

static uint8_t next_request(const subject_t *subject)
{
    return (uint8_t)((subject->model.request_counter + 1u) & 0xFu);
}

/// With the key of the last CHALLENGE, as a host that has read it.
static void send_command(subject_t *subject, uint8_t operation)
{
    frame_t frame;
    const command_message_t command = {operation, next_request(subject), subject->app.key};
    command_encode(&frame, SUBJECT_NODE, &command);
    subject_receive(subject, &frame);
}

/// Any key, and a counter that may be that of a replay or of a loss.
static void strange_command(subject_t *subject, source_t *source)
{
    frame_t frame;
    const uint8_t operation = take(source) % (OPERATION_RESET_PARAMETERS + 2), counter = take(source);
    command_encode(&frame, SUBJECT_NODE, &(command_message_t){operation, counter, take16(source)});
    subject_receive(subject, &frame);
}

static void hello(subject_t *subject, source_t *source)
{
    const uint8_t wrong = take(source);
    send_hello(subject, wrong < 0xF0 ? PROTOCOL_HASH : PROTOCOL_HASH ^ wrong);
}

static void command(subject_t *subject, source_t *source)
{
    send_command(subject, take(source) % (OPERATION_ARM + 2));
}

/// In range, at its ends, just outside, or anything.
static float parameter_value(source_t *source, const parameter_description_t *description)
{
    const uint8_t kind = take(source) % 8;
    const float low = description->minimum, high = description->maximum;
    switch (kind) {
    case 0:
        return low;
    case 1:
        return high;
    case 2:
        return description->initial;
    case 3:
        return nextafterf(high, INFINITY);
    case 4:
        return take_nasty_float(source);
    default: {
        const float value = low + (high - low) * (float)take(source) / 255.0f;
        return description->integer && kind != 5 ? floorf(value) : value;
    }
    }
}

static void parameter_set(subject_t *subject, source_t *source)
{
    const uint8_t index = take(source) % (PARAMETER_COUNT + 2);
    const float value = parameter_value(source, &parameter_table[index < PARAMETER_COUNT ? index : 0]);
    frame_t frame;
    parameter_set_encode(&frame, SUBJECT_NODE, &(parameter_set_message_t){index, value, next_request(subject)});
    subject_receive(subject, &frame);
}

static void parameter_get(subject_t *subject, source_t *source)
{
    frame_t frame;
    const uint8_t index = take(source), field = take(source);
    parameter_get_encode(&frame, SUBJECT_NODE, &(parameter_get_message_t){index, field, take(source)});
    subject_receive(subject, &frame);
}

// ---- upload

static void send_begin(subject_t *subject, uint16_t length_bytes, uint32_t crc32)
{
    frame_t frame;
    trajectory_begin_encode(&frame, SUBJECT_NODE,
                            &(trajectory_begin_message_t){length_bytes, crc32, next_request(subject)});
    subject_receive(subject, &frame);
}

static void send_data(subject_t *subject, uint16_t offset, const uint8_t b[6])
{
    frame_t frame;
    trajectory_data_encode(&frame, SUBJECT_NODE,
                           &(trajectory_data_message_t){offset, b[0], b[1], b[2], b[3], b[4], b[5]});
    subject_receive(subject, &frame);
}

static void begin(subject_t *subject, source_t *source)
{
    const uint8_t segments = take(source);
    const uint16_t length = segments < 0xE0 ? (uint16_t)(MODEL_BYTES_PER_SEGMENT * segments) : take16(source);
    send_begin(subject, length, take32(source));
}

static void data(subject_t *subject, source_t *source)
{
    const uint8_t kind = take(source);
    const uint16_t offset = kind < 0xE0 ? subject->model.received_bytes : take16(source);
    uint8_t byte[6];
    for (int i = 0; i < 6; i++) {
        byte[i] = take(source);
    }
    send_data(subject, offset, byte);
}

static uint32_t take_duration_us(source_t *source)
{
    static const uint32_t duration_us[] = {1, 999, 1000, 1001, 20000, 300000, 600000000};
    const uint8_t kind = take(source);
    return kind < 0xE0 ? duration_us[kind % 7] : kind < 0xF0 ? take32(source) : kind < 0xF8 ? 600000001u : 0;
}

/// One segment: mostly smooth and short, some at the ends of what is allowed, some outside.
static void make_segment(source_t *source, uint8_t *byte)
{
    const uint32_t duration_us = take_duration_us(source);
    const uint8_t kind = take(source);
    memcpy(byte, &duration_us, sizeof duration_us);
    for (int i = 0; i < 24; i++) {
        const float size = kind < 0x80 ? 0.02f : kind < 0xC0 ? 1.0f : 1.0e4f;
        const float value = kind < 0xF0 ? take_float(source, i % 8 < 4 ? size : 0.1f * size) : take_nasty_float(source);
        memcpy(&byte[4 + 4 * i], &value, sizeof value);
    }
}

static void send_upload(subject_t *subject, const uint8_t *byte, uint16_t length, uint32_t crc32)
{
    send_begin(subject, length, crc32);
    for (uint16_t at = 0; at < length; at = (uint16_t)(at + 6)) {
        uint8_t part[6] = {0};
        memcpy(part, &byte[at], length - at < 6 ? (size_t)(length - at) : 6);
        send_data(subject, at, part);
    }
}

/// Starts a segment where the one before it ends, or seldom a step from there.
static void join_segment(uint8_t kind, uint8_t *byte)
{
    const float step = kind < 0xE0 ? 0.0f : kind < 0xF0 ? 0.9e-3f : 1.1e-3f;
    for (int axis = 0; axis < 3; axis++) {
        const float start = model_end(byte - MODEL_BYTES_PER_SEGMENT, axis) + (kind % 4 == axis ? step : 0.0f);
        memcpy(&byte[4 + 32 * axis], &start, sizeof start);
    }
}

/// A whole upload, seldom the longest, seldom with a wrong CRC.
static void upload(subject_t *subject, source_t *source)
{
    uint8_t byte[MODEL_BYTES_MAX];
    const uint8_t kind = take(source);
    const int segments = kind == 0xFF ? MODEL_SEGMENTS_MAX : 1 + kind % 3;
    for (int i = 0; i < segments; i++) {
        uint8_t *segment = &byte[MODEL_BYTES_PER_SEGMENT * i];
        if (i < 4) {
            make_segment(source, segment);
        } else {
            memcpy(segment, segment - 4 * MODEL_BYTES_PER_SEGMENT, MODEL_BYTES_PER_SEGMENT);
        }
        if (i > 0) {
            join_segment(i < 4 ? take(source) : 0, segment);
        }
    }
    const uint16_t length = (uint16_t)(MODEL_BYTES_PER_SEGMENT * segments);
    send_upload(subject, byte, length, oracle_crc32(byte, length) ^ (take(source) < 0xF0 ? 0u : 1u));
}

/// All that START asks for, and START: the bytes of a program rarely come upon it by chance.
static void make_ready(subject_t *subject, source_t *source)
{
    static const uint8_t use[] = {OPERATION_USE_LOCKSTEP, OPERATION_USE_REALTIME, OPERATION_USE_MOTORS, OPERATION_NONE};
    send_command(subject, OPERATION_STOP);
    send_command(subject, OPERATION_CLEAR);
    send_command(subject, use[take(source) & 3u]);
    send_hello(subject, PROTOCOL_HASH);
    if (subject->model.held_bytes == 0 || take(source) < 0x40) {
        upload(subject, source);
    }
    send_command(subject, OPERATION_ARM);
    send_command(subject, OPERATION_START);
}

// ---- time

/// A sensor frame of a tick goes in; SYNC vouches for it by what is returned.
static uint8_t send_sensor(subject_t *subject, const frame_t *frame)
{
    subject_receive(subject, frame);
    return oracle_crc8(frame, frame->length);
}

static uint8_t send_pose(subject_t *subject, vec3_t pose, uint32_t tick)
{
    frame_t frame;
    pose_encode(&frame, SUBJECT_NODE, &(pose_message_t){pose.x, pose.y, pose.z, tick & 0xFu});
    return send_sensor(subject, &frame);
}

static uint8_t send_wheel_speed(subject_t *subject, vec3_t rad_per_s, uint32_t tick)
{
    frame_t frame;
    const wheel_speed_message_t speed = {rad_per_s.x, rad_per_s.y, rad_per_s.z, tick & 0xFu};
    wheel_speed_encode(&frame, SUBJECT_NODE, &speed);
    return send_sensor(subject, &frame);
}

static void send_sync(subject_t *subject, uint32_t tick, uint8_t pose_crc, uint8_t wheel_speed_crc)
{
    frame_t frame;
    sync_encode(&frame, SUBJECT_NODE, &(sync_message_t){tick, pose_crc, wheel_speed_crc});
    subject_receive(subject, &frame);
}

static vec3_t take_vector(source_t *source)
{
    const uint8_t kind = take(source);
    if (kind >= 0xF0) {
        const float x = take_nasty_float(source), y = take_nasty_float(source), z = take_nasty_float(source);
        return (vec3_t){x, y, z};
    }
    const float size = kind < 0x80 ? 0.1f : kind < 0xC0 ? 3.0f : 300.0f;
    const float x = take_float(source, size), y = take_float(source, size), z = take_float(source, size);
    return (vec3_t){x, y, z};
}

static void pose(subject_t *subject, source_t *source)
{
    const vec3_t at = take_vector(source);
    (void)send_pose(subject, at, subject->model.sync_tick + 1 + take(source) / 0xF0);
}

static void wheel_speed(subject_t *subject, source_t *source)
{
    const vec3_t speed = take_vector(source);
    (void)send_wheel_speed(subject, speed, subject->model.sync_tick + 1 + take(source) / 0xF0);
}

static void motor_speed(subject_t *subject, source_t *source)
{
    subject_set_wheel_speed(subject, take_vector(source));
}

/// The next tick, the same, some ahead, some back, any.
static void sync(subject_t *subject, source_t *source)
{
    const uint8_t kind = take(source);
    const uint32_t last = subject->model.sync_tick;
    const uint32_t tick = kind < 0x80   ? last + 1
                          : kind < 0xA0 ? last
                          : kind < 0xE0 ? last + (kind & 0x1Fu)
                          : kind < 0xF0 ? last - (kind & 0xFu)
                                        : take32(source);
    // Mostly it vouches for what waits.
    const uint8_t wrong = take(source) / 0xF0;
    send_sync(subject, tick, subject->model.pose.crc ^ wrong, subject->model.wheel_speed.crc);
}

static void timer_tick(subject_t *subject, source_t *source)
{
    for (int left = 1 + (take(source) & 7); left > 0; left--) {
        subject_tick(subject);
    }
}

/// Ticks as they should be: sensors, SYNC, and the timer where it makes the steps.
static void drive(subject_t *subject, source_t *source)
{
    const vec3_t at = take_vector(source), speed = take_vector(source);
    for (int left = 1 + (take(source) & 15); left > 0; left--) {
        const uint32_t tick = subject->model.sync_tick + 1;
        const uint8_t pose_crc = send_pose(subject, at, tick);
        send_sync(subject, tick, pose_crc, send_wheel_speed(subject, speed, tick));
        subject_set_wheel_speed(subject, speed);
        subject_tick(subject);
    }
}

/// Time without a host.
static void silence(subject_t *subject, source_t *source)
{
    for (int left = take(source); left > 0; left--) {
        subject_tick(subject);
    }
}

/// Ticks as they should be, for as long as it takes to brake.
static void settle(subject_t *subject, source_t *source)
{
    if (take(source) >= 0x20 || subject->model.mode != MODE_STOPPING) {
        return;
    }
    for (int left = 2600; left > 0 && subject->model.mode == MODE_STOPPING; left--) {
        const uint32_t tick = subject->model.sync_tick + 1;
        const uint8_t pose_crc = send_pose(subject, subject->app.state.pose.value, tick);
        send_sync(subject, tick, pose_crc, send_wheel_speed(subject, (vec3_t){0}, tick));
        subject_set_wheel_speed(subject, (vec3_t){0});
        subject_tick(subject);
    }
}

static void overrun(subject_t *subject, source_t *source)
{
    const uint8_t periods = take(source);
    subject_note_overrun(subject, periods < 0xF0 ? periods & 0xFu : take32(source));
}

// ---- what the board tells

static void motor_fault(subject_t *subject, source_t *source)
{
    subject_note_motor_fault(subject, (take(source) & 1u) != 0 ? FAULT_SUPPLY : FAULT_BRIDGE);
}

static void step_time(subject_t *subject, source_t *source)
{
    const uint8_t kind = take(source);
    subject_note_step_time(subject, kind < 0x80 ? 1000u * kind : take32(source));
}

static void health(subject_t *subject, source_t *source)
{
    app_health_t health = {.reset_cause = take(source), .clock_source = take(source), .can_state = take(source)};
    health.can_tx_errors = take(source);
    health.can_rx_errors = take(source);
    health.can_bus_offs = take(source);
    health.can_rx_lost = take(source);
    health.supply_V = take_nasty_float(source);
    subject_note_health(subject, &health);
}

static void crash(subject_t *subject, source_t *source)
{
    const uint32_t pc = take32(source);
    subject_note_crash(subject, pc, take32(source));
}

static void hold(subject_t *subject, source_t *source)
{
    subject_hold(subject, (take(source) & 3u) == 0);
}

// ---- programs

typedef void instruction_t(subject_t *subject, source_t *source);

static instruction_t *const instructions[] = {
    any_frame, any_whole_frame, damaged_frame, hello, command,     parameter_set, parameter_get, begin,
    data,      upload,          make_ready,    pose,  wheel_speed, motor_speed,   sync,          sync,
    sync,      timer_tick,      timer_tick,    drive, drive,       drive,         drive,         silence,
    overrun,   step_time,       health,        crash, hold,        settle,        motor_fault,   strange_command,
};

static instruction_t *const setup_instructions[] = {
    parameter_set, parameter_get, begin, data, data, data, upload, command, hello, any_whole_frame, damaged_frame, sync,
};

void program_start(subject_t *subject, source_t *source)
{
    const uint8_t byte = take(source);
    const uint8_t drives = byte & 7u, drive = (uint8_t)((byte >> 3) % 3);
    subject_init(subject, (app_port_t){.drives = (uint8_t)(drives | 1u << drive), .drive = drive});
}

void program_step(subject_t *subject, source_t *source)
{
    instructions[take(source) % (sizeof instructions / sizeof instructions[0])](subject, source);
}

void program_step_setup(subject_t *subject, source_t *source)
{
    const size_t count = sizeof setup_instructions / sizeof setup_instructions[0];
    setup_instructions[take(source) % count](subject, source);
}
