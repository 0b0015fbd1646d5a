// SPDX-License-Identifier: MIT
#include "app.h"

#include "counter.h"
#include "messages.h"
#include "pace.h"
#include "report.h"

#include <string.h>

static void clear_faults(app_t *app)
{
    app->fault = FAULT_NONE;
    app->fault_mask = 0;
    app->mode = mode_after(app->mode, EVENT_CLEAR);
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
        app->pose.value = (vec3_t){pose.x1_m, pose.x2_m, pose.heading_rad};
        app->pose.fresh = true;
    }
    return result;
}

static decode_result_t on_wheel_speed(app_t *app, const frame_t *frame)
{
    wheel_speed_message_t speed;
    const decode_result_t result = wheel_speed_decode(&speed, frame);
    if (result == DECODE_OK && app->port.drive != DRIVE_MOTORS) {
        app->wheel_speed.value = (vec3_t){speed.wheel1_rad_per_s, speed.wheel2_rad_per_s, speed.wheel3_rad_per_s};
        app->wheel_speed.fresh = true;
    }
    return result;
}

static decode_result_t on_sync(app_t *app, const frame_t *frame)
{
    sync_message_t sync;
    const decode_result_t result = sync_decode(&sync, frame);
    if (result == DECODE_OK) {
        pace_on_sync(app, sync.tick);
    }
    return result;
}

/// Starts at the trajectory's beginning with the next tick, whatever its number.
static uint8_t start(app_t *app)
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
    app->cursor = (trajectory_cursor_t){0, 0};
    app->state = (control_state_t){0};
    app->torque_Nm = (vec3_t){0}; // of a drive before: the motors wait for the first step of this one
    pace_start(app);
    app->mode = mode_after(app->mode, EVENT_START);
    return REFUSAL_NONE;
}

static uint8_t perform(app_t *app, uint8_t operation)
{
    switch (operation) {
    case OPERATION_START:
        return start(app);
    case OPERATION_STOP:
        app->mode = mode_after(app->mode, EVENT_STOP);
        return REFUSAL_NONE;
    case OPERATION_CLEAR:
        clear_faults(app);
        return REFUSAL_NONE;
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
    if (result == DECODE_OK) {
        app->refusal = perform(app, command.operation);
        report_status(app);
    }
    return result;
}

static void send_parameter(app_t *app, uint8_t index, uint8_t result)
{
    const parameter_value_message_t answer = {
        .index = index,
        .result = result,
        .value = index < PARAMETER_COUNT ? app->parameters.value[index] : NAN,
    };
    frame_t frame;
    parameter_value_encode(&frame, app->node, &answer);
    report_send(app, &frame);
}

static decode_result_t on_parameter_set(app_t *app, const frame_t *frame)
{
    parameter_set_message_t set;
    const decode_result_t result = parameter_set_decode(&set, frame);
    if (result != DECODE_OK) {
        return result;
    }
    uint8_t outcome = PARAMETER_VALUE_RESULT_IN_MOTION;
    if (!mode_drives(app->mode)) {
        outcome = parameters_set(&app->parameters, set.index, set.value);
        app->control = parameters_for_control(&app->parameters, app->robot);
    }
    send_parameter(app, set.index, outcome);
    return result;
}

static decode_result_t on_parameter_get(app_t *app, const frame_t *frame)
{
    parameter_get_message_t get;
    const decode_result_t result = parameter_get_decode(&get, frame);
    if (result == DECODE_OK) {
        const bool known = get.index < PARAMETER_COUNT;
        send_parameter(app, get.index, known ? PARAMETER_VALUE_RESULT_OK : PARAMETER_VALUE_RESULT_UNKNOWN_INDEX);
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
    if (result == DECODE_OK) {
        send_trajectory_ack(app, mode_drives(app->mode) ? refused_in_motion
                                                        : store_begin(&app->store, begin.length_bytes, begin.crc32));
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
        send_trajectory_ack(app, mode_drives(app->mode) ? refused_in_motion
                                                        : store_data(&app->store, data.offset_bytes, byte));
    }
    return result;
}

static decode_result_t on_hello(app_t *app, const frame_t *frame)
{
    hello_message_t hello;
    const decode_result_t result = hello_decode(&hello, frame);
    if (result != DECODE_OK) {
        return result;
    }
    app->peer_matches = hello.protocol_hash == PROTOCOL_HASH;
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
    return result;
}

// ---- the outside

static const struct {
    uint8_t function;
    decode_result_t (*handle)(app_t *app, const frame_t *frame);
} handlers[] = {
    {POSE_FUNCTION, on_pose},
    {WHEEL_SPEED_FUNCTION, on_wheel_speed},
    {SYNC_FUNCTION, on_sync},
    {COMMAND_FUNCTION, on_command},
    {PARAMETER_SET_FUNCTION, on_parameter_set},
    {PARAMETER_GET_FUNCTION, on_parameter_get},
    {TRAJECTORY_BEGIN_FUNCTION, on_trajectory_begin},
    {TRAJECTORY_DATA_FUNCTION, on_trajectory_data},
    {HELLO_FUNCTION, on_hello},
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
    app->control = parameters_for_control(&app->parameters, robot);
    pace_handle_event(app, EVENT_READY);
}

void app_receive(app_t *app, const frame_t *frame)
{
    if ((frame->id & FRAME_NODE_MASK) != app->node) {
        return;
    }
    const uint16_t function = frame->id >> FRAME_NODE_BITS;
    for (size_t i = 0; i < sizeof handlers / sizeof handlers[0]; i++) {
        if (handlers[i].function == function) {
            if (handlers[i].handle(app, frame) != DECODE_OK) {
                counter_add(&app->dropped_frames, 1);
            }
            return;
        }
    }
}

bool app_transmit(app_t *app, frame_t *frame)
{
    return outbox_pop(&app->outbox, frame);
}
