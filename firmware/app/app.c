// SPDX-License-Identifier: MIT
#include "app.h"

#include "counter.h"
#include "crc.h"
#include "faults.h"
#include "messages.h"
#include "mode.h"
#include "pace.h"
#include "report.h"

#include <string.h>

// ---- what a frame must be to be taken

/// Requests count up by one a frame. One that repeats the last, or is further on than loss explains, is a replay.
static bool request_follows(app_t *app, uint8_t counter)
{
    const uint8_t ahead = (uint8_t)((counter - app->request_counter) & 0xFu);
    const bool follows = !app->requests_known || (ahead >= 1 && ahead <= 1 + APP_REQUESTS_LOST_MAX);
    if (follows) {
        app->requests_known = true;
        app->request_counter = counter;
    } else {
        report_drop(app, &app->drops.replayed);
    }
    return follows;
}

/// A frame of the tick before, or the second of this one, is late or a replay; what comes last may be whole.
static void arrive(app_t *app, reading_t *reading, vec3_t value, uint8_t counter, const frame_t *frame)
{
    const bool late = app->sync_known && counter == (app->sync_tick & 0xFu);
    if (late || !reading_arrive(reading, value, counter, crc8_frame(frame, frame->length))) {
        report_drop(app, &app->drops.replayed);
    }
}

// ---- what paces and moves the robot

static uint8_t use(app_t *app, uint8_t drive)
{
    if (app->mode != MODE_IDLE) {
        return REFUSAL_WRONG_MODE;
    }
    if ((app->port.drives & 1u << drive) == 0) {
        return REFUSAL_UNABLE;
    }
    app->port.drive = drive;
    app->tick_known = false;
    app->sync_known = false;
    app->sync_age_ticks = UINT32_MAX;
    pace_forget_readings(app);
    return REFUSAL_NONE;
}

// ---- the other messages

static decode_result_t on_pose(app_t *app, const frame_t *frame)
{
    pose_message_t pose;
    const decode_result_t result = pose_decode(&pose, frame);
    if (result == DECODE_OK) {
        arrive(app, &app->pose, (vec3_t){pose.x1_m, pose.x2_m, pose.heading_rad}, pose.counter, frame);
    }
    return result;
}

static decode_result_t on_wheel_speed(app_t *app, const frame_t *frame)
{
    wheel_speed_message_t speed;
    const decode_result_t result = wheel_speed_decode(&speed, frame);
    if (result == DECODE_OK && app->port.drive != DRIVE_MOTORS) {
        const vec3_t value = {speed.wheel1_rad_per_s, speed.wheel2_rad_per_s, speed.wheel3_rad_per_s};
        arrive(app, &app->wheel_speed, value, speed.counter, frame);
    }
    return result;
}

static decode_result_t on_sync(app_t *app, const frame_t *frame)
{
    sync_message_t sync;
    const decode_result_t result = sync_decode(&sync, frame);
    if (result == DECODE_OK) {
        pace_on_sync(app, &sync);
    }
    return result;
}

/// Motion takes two steps: ARM is answered by a new key, and START must bring it. So no single frame, repeated or made
/// by chance, can start it; and a recording of a start does so once in 65536 times where the port stirs the keys.
static uint8_t arm(app_t *app)
{
    if (app->mode != MODE_IDLE) {
        return REFUSAL_WRONG_MODE;
    }
    if (!app->peer_matches) {
        return REFUSAL_UNKNOWN_PEER;
    }
    if (app->store.segment_count == 0) {
        return REFUSAL_NO_TRAJECTORY;
    }
    app->key_state = app->key_state * 1664525u + 1013904223u;
    app->key = (uint16_t)(app->key_state >> 16); // the lower bits of such a sequence repeat soon
    app->key_age_ticks = 0;
    app->mode = mode_after(app->mode, EVENT_ARM);
    const challenge_message_t challenge = {.key = app->key, .ticks = APP_KEY_TICKS};
    frame_t frame;
    challenge_encode(&frame, app->node, &challenge);
    report_send(app, &frame);
    return REFUSAL_NONE;
}

/// Starts at the trajectory's beginning with the next tick, whatever its number.
static uint8_t start(app_t *app, uint16_t key)
{
    if (app->mode != MODE_ARMED) {
        return REFUSAL_WRONG_MODE;
    }
    if (key != app->key) {
        app->mode = mode_after(app->mode, EVENT_LAPSE);
        return REFUSAL_WRONG_KEY;
    }
    app->cursor = (trajectory_cursor_t){0, 0};
    app->state = (control_state_t){0};
    app->torque_Nm = (vec3_t){0}; // of a drive before: the motors wait for the first step of this one
    pace_start(app);
    app->mode = mode_after(app->mode, EVENT_START);
    return REFUSAL_NONE;
}

static uint8_t clear(app_t *app)
{
    if (!mode_is_safe(app->mode)) {
        return REFUSAL_WRONG_MODE;
    }
    faults_clear(app);
    app->mode = mode_after(app->mode, EVENT_CLEAR);
    return REFUSAL_NONE;
}

static uint8_t count_unsaved(const app_t *app)
{
    uint8_t unsaved = 0;
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        if (islessgreater(app->parameters.value[i], app->kept.value[i])) {
            unsaved++;
        }
    }
    return unsaved;
}

static void send_parameter_store(app_t *app)
{
    const parameter_store_message_t store = {
        .origin = app->parameter_origin,
        .count = PARAMETER_COUNT,
        .unsaved = count_unsaved(app),
        .robot_checksum = app->robot->file_checksum,
    };
    frame_t frame;
    parameter_store_encode(&frame, app->node, &store);
    report_send(app, &frame);
}

/// Keeps what is in force. The port may take its time over it: nothing moves meanwhile.
static uint8_t save_parameters(app_t *app)
{
    if (!mode_is_safe(app->mode)) {
        return REFUSAL_WRONG_MODE;
    }
    if (app->settings == NULL) {
        return REFUSAL_UNABLE;
    }
    if (!settings_save(app->settings, &app->parameters)) {
        return REFUSAL_NOT_SAVED;
    }
    app->kept = app->parameters;
    app->parameter_origin = ORIGIN_KEPT;
    return REFUSAL_NONE;
}

/// Puts the defaults in force; what is kept stays until the next save.
static uint8_t reset_parameters(app_t *app)
{
    if (!mode_is_safe(app->mode)) {
        return REFUSAL_WRONG_MODE;
    }
    parameters_reset(&app->parameters);
    app->control = parameters_for_control(&app->parameters, app->robot);
    return REFUSAL_NONE;
}

static uint8_t perform(app_t *app, const command_message_t *command)
{
    switch (command->operation) {
    case OPERATION_ARM:
        return arm(app);
    case OPERATION_START:
        return start(app, command->key);
    case OPERATION_STOP:
        app->mode = mode_after(app->mode, EVENT_STOP);
        return REFUSAL_NONE;
    case OPERATION_CLEAR:
        return clear(app);
    case OPERATION_SAVE_PARAMETERS:
        return save_parameters(app);
    case OPERATION_RESET_PARAMETERS:
        return reset_parameters(app);
    case OPERATION_USE_LOCKSTEP:
        return use(app, DRIVE_LOCKSTEP);
    case OPERATION_USE_REALTIME:
        return use(app, DRIVE_REALTIME);
    case OPERATION_USE_MOTORS:
        return use(app, DRIVE_MOTORS);
    default:
        return REFUSAL_UNKNOWN_OPERATION;
    }
}

static decode_result_t on_command(app_t *app, const frame_t *frame)
{
    command_message_t command;
    const decode_result_t result = command_decode(&command, frame);
    if (result != DECODE_OK) {
        return result;
    }
    // A stop is a stop, whoever repeats it: it can do no harm.
    if (request_follows(app, command.counter) || command.operation == OPERATION_STOP) {
        app->refusal = perform(app, &command);
        report_status(app);
        if (command.operation == OPERATION_SAVE_PARAMETERS || command.operation == OPERATION_RESET_PARAMETERS) {
            send_parameter_store(app);
        }
    }
    return result;
}

static void send_value(app_t *app, uint8_t index, uint8_t field, uint8_t result)
{
    const parameter_value_message_t answer = {
        .index = index,
        .result = result,
        .field = field,
        .value = result == PARAMETER_VALUE_RESULT_UNKNOWN_INDEX || result == PARAMETER_VALUE_RESULT_UNKNOWN_FIELD
                     ? NAN
                     : parameters_field(&app->parameters, index, field),
    };
    frame_t frame;
    parameter_value_encode(&frame, app->node, &answer);
    report_send(app, &frame);
}

static void send_text(app_t *app, uint8_t index, uint8_t field, uint8_t part)
{
    char text[PARAMETER_TEXT_CHARACTERS];
    parameters_text(index, field, part, text);
    const parameter_text_message_t answer = {
        .index = index,
        .field = field,
        .part = part,
        .char0 = (uint8_t)text[0],
        .char1 = (uint8_t)text[1],
        .char2 = (uint8_t)text[2],
        .char3 = (uint8_t)text[3],
        .char4 = (uint8_t)text[4],
        .char5 = (uint8_t)text[5],
    };
    frame_t frame;
    parameter_text_encode(&frame, app->node, &answer);
    report_send(app, &frame);
}

static decode_result_t on_parameter_set(app_t *app, const frame_t *frame)
{
    parameter_set_message_t set;
    const decode_result_t result = parameter_set_decode(&set, frame);
    if (result != DECODE_OK || !request_follows(app, set.counter)) {
        return result;
    }
    uint8_t outcome =
        set.index < PARAMETER_COUNT ? PARAMETER_VALUE_RESULT_IN_MOTION : PARAMETER_VALUE_RESULT_UNKNOWN_INDEX;
    if (mode_is_safe(app->mode)) {
        outcome = parameters_set(&app->parameters, set.index, set.value);
        app->control = parameters_for_control(&app->parameters, app->robot);
    }
    send_value(app, set.index, FIELD_VALUE, outcome);
    return result;
}

static decode_result_t on_parameter_get(app_t *app, const frame_t *frame)
{
    parameter_get_message_t get;
    const decode_result_t result = parameter_get_decode(&get, frame);
    if (result != DECODE_OK) {
        return result;
    }
    if (get.index >= PARAMETER_COUNT) {
        send_value(app, get.index, get.field, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX);
    } else if (get.field == FIELD_NAME || get.field == FIELD_UNIT) {
        send_text(app, get.index, get.field, get.part);
    } else {
        const bool known = get.field <= FIELD_TYPE;
        send_value(app, get.index, get.field, known ? PARAMETER_VALUE_RESULT_OK : PARAMETER_VALUE_RESULT_UNKNOWN_FIELD);
    }
    return result;
}

static void send_trajectory_ack(app_t *app, store_answer_t answer)
{
    if (!answer.send) {
        return;
    }
    const trajectory_ack_message_t ack = {.offset_bytes = app->store.received_bytes, .result = answer.result};
    frame_t frame;
    trajectory_ack_encode(&frame, app->node, &ack);
    report_send(app, &frame);
}

static const store_answer_t refused_in_motion = {true, TRAJECTORY_ACK_RESULT_IN_MOTION};

static decode_result_t on_trajectory_begin(app_t *app, const frame_t *frame)
{
    trajectory_begin_message_t begin;
    const decode_result_t result = trajectory_begin_decode(&begin, frame);
    if (result == DECODE_OK && request_follows(app, begin.counter)) {
        send_trajectory_ack(app, mode_is_safe(app->mode) ? store_begin(&app->store, begin.length_bytes, begin.crc32)
                                                         : refused_in_motion);
    }
    return result;
}

static decode_result_t on_trajectory_data(app_t *app, const frame_t *frame)
{
    trajectory_data_message_t data;
    const decode_result_t result = trajectory_data_decode(&data, frame);
    if (result == DECODE_OK) {
        const uint8_t byte[STORE_BYTES_PER_FRAME] = {data.byte0, data.byte1, data.byte2,
                                                     data.byte3, data.byte4, data.byte5};
        send_trajectory_ack(app, mode_is_safe(app->mode) ? store_data(&app->store, data.offset_bytes, byte)
                                                         : refused_in_motion);
    }
    return result;
}

/// A host that begins: its requests and, in lockstep, its ticks are counted anew. A robot that moves in lockstep has
/// lost the world that it moved in; one that moves by its own timer goes on until it is told to stop.
static void begin_session(app_t *app)
{
    app->requests_known = false;
    if (!pace_is_timer(app)) {
        app->sync_known = false;
        app->tick_known = false;
        report_event(app, app->fault_mask == 0 ? EVENT_RESTART : EVENT_CUT);
    }
}

static decode_result_t on_hello(app_t *app, const frame_t *frame)
{
    hello_message_t hello;
    const decode_result_t result = hello_decode(&hello, frame);
    if (result != DECODE_OK) {
        return result;
    }
    app->peer_matches = hello.protocol_hash == PROTOCOL_HASH;
    if (app->peer_matches) {
        begin_session(app);
    }
    const identity_message_t identity = {
        .protocol_hash = PROTOCOL_HASH,
        .major = APP_VERSION_MAJOR,
        .minor = APP_VERSION_MINOR,
        .patch = APP_VERSION_PATCH,
        .peer_matches = app->peer_matches ? 1 : 0,
        .drive = app->port.drive,
    };
    frame_t answer;
    identity_encode(&answer, app->node, &identity);
    report_send(app, &answer);
    send_parameter_store(app);
    return result;
}

// ---- the outside

/// Identifiers that only this robot may use: whoever else does takes its part.
static decode_result_t on_own_message(app_t *app, const frame_t *frame)
{
    (void)frame;
    report_drop(app, &app->drops.masqueraded);
    return DECODE_OK;
}

enum { FUNCTIONS = 0x800 >> FRAME_NODE_BITS };

static decode_result_t (*const handlers[FUNCTIONS])(app_t *app, const frame_t *frame) = {
    [POSE_FUNCTION] = on_pose,
    [WHEEL_SPEED_FUNCTION] = on_wheel_speed,
    [SYNC_FUNCTION] = on_sync,
    [COMMAND_FUNCTION] = on_command,
    [PARAMETER_SET_FUNCTION] = on_parameter_set,
    [PARAMETER_GET_FUNCTION] = on_parameter_get,
    [TRAJECTORY_BEGIN_FUNCTION] = on_trajectory_begin,
    [TRAJECTORY_DATA_FUNCTION] = on_trajectory_data,
    [HELLO_FUNCTION] = on_hello,
    [TORQUE_FUNCTION] = on_own_message,
    [SLIP_FUNCTION] = on_own_message,
    [STATUS_FUNCTION] = on_own_message,
    [TIMING_FUNCTION] = on_own_message,
    [HEALTH_FUNCTION] = on_own_message,
    [CRASH_FUNCTION] = on_own_message,
    [DROPS_FUNCTION] = on_own_message,
    [FAULT_RECORD_FUNCTION] = on_own_message,
    [CHALLENGE_FUNCTION] = on_own_message,
    [PARAMETER_VALUE_FUNCTION] = on_own_message,
    [PARAMETER_TEXT_FUNCTION] = on_own_message,
    [PARAMETER_STORE_FUNCTION] = on_own_message,
    [TRAJECTORY_ACK_FUNCTION] = on_own_message,
    [IDENTITY_FUNCTION] = on_own_message,
};

void app_init(app_t *app, const robot_t *robot, uint8_t node, app_port_t port)
{
    memset(app, 0, sizeof *app);
    app->robot = robot;
    app->port = port;
    app->node = node & FRAME_NODE_MASK;
    app->mode = MODE_BOOT;
    app->sync_age_ticks = UINT32_MAX;
    pace_forget_readings(app);
    parameters_reset(&app->parameters);
    app->kept = app->parameters;
    app->parameter_origin = ORIGIN_NO_MEMORY;
    app->control = parameters_for_control(&app->parameters, robot);
    report_event(app, EVENT_READY);
}

void app_use_settings(app_t *app, const settings_memory_t *memory)
{
    static const uint8_t origin[SETTINGS_LOST + 1] = {
        [SETTINGS_OK] = ORIGIN_KEPT, [SETTINGS_EMPTY] = ORIGIN_DEFAULTS, [SETTINGS_LOST] = ORIGIN_LOST};
    app->settings = memory;
    app->parameter_origin = origin[settings_load(memory, &app->parameters)];
    app->kept = app->parameters;
    app->control = parameters_for_control(&app->parameters, app->robot);
    if (app->parameter_origin == ORIGIN_LOST) {
        faults_raise(app, FAULT_PARAMETERS_LOST);
    }
}

void app_receive(app_t *app, const frame_t *frame)
{
    if ((frame->id & FRAME_NODE_MASK) != app->node) {
        return;
    }
    const uint16_t function = frame->id >> FRAME_NODE_BITS;
    if (function < FUNCTIONS && handlers[function] != NULL && handlers[function](app, frame) != DECODE_OK) {
        report_drop(app, &app->drops.damaged);
    }
}

bool app_transmit(app_t *app, frame_t *frame)
{
    if (outbox_pop(&app->outbox, frame)) {
        return true;
    }
    if (!app->status_owed) {
        return false;
    }
    report_status(app); // there is room now
    return outbox_pop(&app->outbox, frame);
}

void app_stir(app_t *app, uint32_t bits)
{
    app->key_state ^= bits;
}
