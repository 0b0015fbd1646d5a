// SPDX-License-Identifier: MIT
#include "app.h"

#include "messages.h"
#include "mode.h"

#include <string.h>

static void count(uint16_t *counter, uint32_t more)
{
    const uint32_t sum = *counter + (more < UINT16_MAX ? more : UINT16_MAX);
    *counter = sum < UINT16_MAX ? (uint16_t)sum : UINT16_MAX;
}

static void send(app_t *app, const frame_t *frame)
{
    if (!outbox_push(&app->outbox, frame)) {
        count(&app->dropped_frames, 1);
    }
}

// ---- mode and faults

static void send_status(app_t *app)
{
    const status_message_t status = {
        .mode = app->mode,
        .refusal = app->refusal,
        .fault = app->fault,
        .fault_mask = app->fault_mask,
        .dropped_frames = app->dropped_frames,
        .missed_ticks = app->missed_ticks,
    };
    frame_t frame;
    status_encode(&frame, app->node, &status);
    send(app, &frame);
}

/// For events that are not a COMMAND: it has its one STATUS anyway, and the host takes the first for the answer.
static void handle_event(app_t *app, event_t event)
{
    const uint8_t mode = mode_after(app->mode, event);
    if (mode != app->mode) {
        app->mode = mode;
        send_status(app);
    }
}

static void raise_fault(app_t *app, uint8_t fault)
{
    if (app->fault == FAULT_NONE) {
        app->fault = fault;
    }
    app->fault_mask |= (uint16_t)(1u << fault);
    handle_event(app, EVENT_FAULT);
}

static void clear_faults(app_t *app)
{
    app->fault = FAULT_NONE;
    app->fault_mask = 0;
    app->mode = mode_after(app->mode, EVENT_CLEAR);
}

// ---- one tick

static void age(reading_t *reading, uint32_t ticks)
{
    const uint32_t room = UINT32_MAX - reading->age_ticks;
    reading->age_ticks = reading->fresh ? 0 : reading->age_ticks + (ticks < room ? ticks : room);
    reading->fresh = false;
}

/// Raises the faults of missing data. What the controller needs must be there before it is asked.
static void check_readings(app_t *app)
{
    if ((float)app->pose.age_ticks * (float)app->robot->control_period_us >
        app->parameters.value[PARAMETER_POSE_TIMEOUT_S] * 1.0e6f) {
        raise_fault(app, FAULT_STALE_POSE);
    }
    if (app->wheel_speed.age_ticks > APP_STALE_TICKS_MAX) {
        raise_fault(app, FAULT_STALE_WHEEL_SPEED);
    }
}

/// The torque of this tick; zeros when the mode does not drive or a fault comes up.
static control_output_t drive(app_t *app)
{
    control_output_t output = {0};
    if (!mode_drives(app->mode)) {
        return output;
    }
    const control_input_t input = {
        .pose_is_new = app->pose.age_ticks == 0,
        .pose = app->pose.value,
        .wheel_speed_rad_per_s = app->wheel_speed.value,
        .reference = trajectory_reference(app->store.segment, app->store.segment_count, &app->cursor),
    };
    if (!control_step(&app->control, &app->state, &input, &output)) {
        raise_fault(app, FAULT_NOT_FINITE);
    }
    return output;
}

static void compose_answers(app_t *app, const control_output_t *output)
{
    const uint8_t counter = (uint8_t)(app->tick & 0xFu);
    const torque_message_t torque = {
        .wheel1_Nm = output->torque_Nm.x,
        .wheel2_Nm = output->torque_Nm.y,
        .wheel3_Nm = output->torque_Nm.z,
        .counter = counter,
        .mode = app->mode,
    };
    const slip_message_t slip = {
        .mu1_m_per_s = output->mu_mps.x,
        .mu2_m_per_s = output->mu_mps.y,
        .mu3_m_per_s = output->mu_mps.z,
        .counter = counter,
    };
    torque_encode(&app->torque_answer, app->node, &torque);
    slip_encode(&app->slip_answer, app->node, &slip);
}

static void send_answers(app_t *app)
{
    send(app, &app->torque_answer);
    send(app, &app->slip_answer);
}

/// Moves time on to a tick; a long gap while driving is a fault.
static void advance_to(app_t *app, uint32_t tick)
{
    const uint32_t ticks = app->tick_known ? tick - app->tick : 1;
    if (app->tick_known && mode_drives(app->mode)) {
        count(&app->missed_ticks, ticks - 1);
        if (ticks - 1 > APP_TICK_GAP_MAX) {
            raise_fault(app, FAULT_TICK_GAP);
        }
        // A gap that is no fault is at most a few periods: the product cannot overflow.
        const uint32_t steps = ticks <= APP_TICK_GAP_MAX + 1 ? ticks : 0;
        trajectory_advance(app->store.segment, app->store.segment_count, &app->cursor,
                           steps * app->robot->control_period_us);
        for (uint32_t missed = 1; missed < steps; missed++) {
            control_coast(&app->control, &app->state);
        }
    }
    age(&app->pose, ticks);
    age(&app->wheel_speed, ticks);
    app->tick = tick;
    app->tick_known = true;
}

static void on_tick(app_t *app, uint32_t tick)
{
    advance_to(app, tick);
    if (mode_drives(app->mode)) {
        check_readings(app);
    }
    const control_output_t output = drive(app);
    compose_answers(app, &output);
    send_answers(app);
    if (tick % APP_STATUS_EVERY_TICKS == 0) {
        send_status(app);
    }
}

static decode_result_t on_sync(app_t *app, const frame_t *frame)
{
    sync_message_t sync;
    const decode_result_t result = sync_decode(&sync, frame);
    if (result != DECODE_OK) {
        return result;
    }
    if (app->tick_known && sync.tick == app->tick) {
        if (!mode_drives(app->mode)) {
            compose_answers(app, &(control_output_t){0}); // it may have driven when the tick came first
        }
        send_answers(app);
        return result;
    }
    if (app->tick_known && sync.tick < app->tick) {
        app->tick_known = false;
        handle_event(app, EVENT_RESTART);
    }
    on_tick(app, sync.tick);
    return result;
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
    if (result == DECODE_OK) {
        app->wheel_speed.value = (vec3_t){speed.wheel1_rad_per_s, speed.wheel2_rad_per_s, speed.wheel3_rad_per_s};
        app->wheel_speed.fresh = true;
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
    // The pause before had no ticks to tell its length: what was read then is of unknown age.
    app->pose = (reading_t){.age_ticks = UINT32_MAX};
    app->wheel_speed = (reading_t){.age_ticks = UINT32_MAX};
    app->tick_known = false;
    app->missed_ticks = 0;
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
        send_status(app);
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
    send(app, &frame);
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
    send(app, &frame);
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
    };
    frame_t answer;
    identity_encode(&answer, app->node, &identity);
    send(app, &answer);
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

void app_init(app_t *app, const robot_t *robot, uint8_t node)
{
    memset(app, 0, sizeof *app);
    app->robot = robot;
    app->node = node & FRAME_NODE_MASK;
    app->mode = MODE_BOOT;
    app->pose.age_ticks = UINT32_MAX;
    app->wheel_speed.age_ticks = UINT32_MAX;
    parameters_reset(&app->parameters);
    app->control = parameters_for_control(&app->parameters, robot);
    handle_event(app, EVENT_READY);
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
                count(&app->dropped_frames, 1);
            }
            return;
        }
    }
}

bool app_transmit(app_t *app, frame_t *frame)
{
    return outbox_pop(&app->outbox, frame);
}
