// SPDX-License-Identifier: MIT
#include "subject.h"

#include "messages.h"
#include "oracle.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

enum { HEARTBEAT_TICKS_MAX = 100, STOPPING_TICKS_MAX = 2600 }; // 2 s of braking at most, half a second at rest

#define HALF_TORQUE_STEP_NM 0.5e-5f
#define TORQUE_OF_WIRE_MAX_NM 0.32767f
#define ROUNDING 1.000001f
#define TINY_TORQUE_NM 1.0e-9f // the factor that holds huge torques to a tiny bound is subnormal, and so coarse

/// What came out.
typedef struct {
    frame_t frame[OUTBOX_FRAMES + 1]; // a STATUS that was owed comes on top
    int count, torques, slips, statuses, challenges;
    torque_message_t torque;
    slip_message_t slip;
    status_message_t status;
} outcome_t;

// ---- frames out

static bool is_within(float value, float bound)
{
    return isfinite(value) && fabsf(value) <= bound;
}

static float torque_bound_Nm(const subject_t *subject)
{
    return subject->model.parameter[PARAMETER_TORQUE_BOUND_NM];
}

static bool drives(uint8_t mode)
{
    return mode == MODE_TRACKING || mode == MODE_STOPPING;
}

static void judge_torque(const subject_t *subject, const torque_message_t *torque)
{
    // One that waits in the outbox is of the time when it was made.
    const bool held = subject->holding;
    const float bound = held ? TORQUE_OF_WIRE_MAX_NM : torque_bound_Nm(subject) * ROUNDING + HALF_TORQUE_STEP_NM;
    const float most = drives(torque->mode) ? bound : 0.0f;
    REQUIRE(is_within(torque->wheel1_Nm, most),
            "torque of wheel 1 finite, within its bound, zero unless TRACKING or STOPPING");
    REQUIRE(is_within(torque->wheel2_Nm, most),
            "torque of wheel 2 finite, within its bound, zero unless TRACKING or STOPPING");
    REQUIRE(is_within(torque->wheel3_Nm, most),
            "torque of wheel 3 finite, within its bound, zero unless TRACKING or STOPPING");
    // A tick that is answered again may have been one of TRACKING, before a STOP.
    const bool again = drives(torque->mode) && drives(subject->app.mode);
    REQUIRE(held || again || torque->mode == subject->app.mode, "TORQUE tells the mode");
    REQUIRE(held || torque->counter == subject->model.sync_tick % 16u, "TORQUE counts as the last SYNC");
}

static void judge_slip(const subject_t *subject, const slip_message_t *slip)
{
    const bool zero = !subject->holding && !drives(subject->app.mode);
    const float most = zero ? 0.0f : FLT_MAX;
    REQUIRE(is_within(slip->mu1_m_per_s, most) && is_within(slip->mu2_m_per_s, most) &&
                is_within(slip->mu3_m_per_s, most),
            "SLIP finite, zero unless TRACKING or STOPPING");
    REQUIRE(subject->holding || slip->counter == subject->model.sync_tick % 16u, "SLIP counts as the last SYNC");
}

static void judge_status(const subject_t *subject, const status_message_t *status)
{
    const bool may_have = status->mode == MODE_FAULT || status->mode == MODE_STOPPING;
    REQUIRE(may_have || status->fault == FAULT_NONE, "STATUS: a fault in FAULT and STOPPING and nowhere else");
    REQUIRE(status->mode != MODE_FAULT || status->fault != FAULT_NONE, "STATUS: FAULT has a cause");
    REQUIRE((status->fault_mask != 0) == (status->fault != FAULT_NONE), "STATUS: fault and mask agree");
    REQUIRE(subject->holding || status->dropped_frames == subject->app.drops.all, "STATUS tells the drops");
}

/// Whatever leaves the robot is a whole frame of its own.
static void judge_frame(const frame_t *frame)
{
    const message_t *message = oracle_message(frame);
    REQUIRE(frame->id <= 0x7FF && (frame->id & FRAME_NODE_MASK) == SUBJECT_NODE, "frames out are of the robot's node");
    REQUIRE(message != NULL && !message->to_robot, "frames out are messages of the robot");
    REQUIRE(oracle_is_whole(message, frame), "frames out have their length and CRC");
    for (int i = 0; i < FRAME_DATA_BYTES; i++) {
        REQUIRE((frame->data[i] & ~message->used[i]) == 0, "bits of no signal are zero");
    }
}

static void sort_frame(const subject_t *subject, outcome_t *outcome, const frame_t *frame)
{
    switch (frame->id >> FRAME_NODE_BITS) {
    case TORQUE_FUNCTION:
        (void)torque_decode(&outcome->torque, frame);
        judge_torque(subject, &outcome->torque);
        outcome->torques++;
        break;
    case SLIP_FUNCTION:
        (void)slip_decode(&outcome->slip, frame);
        judge_slip(subject, &outcome->slip);
        outcome->slips++;
        break;
    case CHALLENGE_FUNCTION:
        outcome->challenges++;
        break;
    case STATUS_FUNCTION:
        (void)status_decode(&outcome->status, frame);
        judge_status(subject, &outcome->status);
        outcome->statuses++;
        break;
    default:
        break;
    }
}

static void drain(subject_t *subject, outcome_t *outcome)
{
    outcome->count = outcome->torques = outcome->slips = outcome->statuses = outcome->challenges = 0;
    frame_t frame;
    while (app_transmit(&subject->app, &frame)) {
        REQUIRE(outcome->count <= OUTBOX_FRAMES, "no more frames than the outbox holds");
        judge_frame(&frame);
        sort_frame(subject, outcome, &frame);
        outcome->frame[outcome->count++] = frame;
    }
}

/// Takes the answers; false when nobody takes them now.
static bool look(subject_t *subject, outcome_t *outcome)
{
    if (subject->holding) {
        return false;
    }
    drain(subject, outcome);
    return true;
}

// ---- what must hold at any time
//
// The law's own state is not among it: dead reckoning may overflow on speeds that no wheel has, and the step that would
// use it is then the fault NOT_FINITE. What must be finite is what leaves the robot.

static void judge_motors(const subject_t *subject)
{
    vec3_t torque;
    const bool on = app_motor_torque(&subject->app, &torque);
    const model_t *model = &subject->model;
    REQUIRE(on == (model->drive == DRIVE_MOTORS && model_drives(model)),
            "bridges on in MOTORS while TRACKING or STOPPING");
    const bool stepped = model->tick_known; // since START
    const float most = on && stepped ? torque_bound_Nm(subject) * ROUNDING + TINY_TORQUE_NM : 0.0f;
    REQUIRE(is_within(torque.x, most) && is_within(torque.y, most) && is_within(torque.z, most),
            "torque of the motors finite, within its bound, zero before the first step");
}

static void judge_store(const subject_t *subject)
{
    const app_t *app = &subject->app;
    const model_t *model = &subject->model;
    static_assert(sizeof app->store.segment[0] == MODEL_BYTES_PER_SEGMENT, "a segment has no padding");
    REQUIRE(app->store.segment_count * MODEL_BYTES_PER_SEGMENT == model->held_bytes, "whole uploads are held");
    REQUIRE(memcmp(app->store.segment, model->byte, model->held_bytes) == 0, "what is held is what was sent");
    if (model_drives(model)) {
        const trajectory_cursor_t *cursor = &app->cursor;
        REQUIRE(cursor->segment < app->store.segment_count, "the cursor is on the trajectory");
        REQUIRE(cursor->time_us <= app->store.segment[cursor->segment].duration_us, "the cursor is in its segment");
    }
}

static uint16_t saturated(uint64_t count)
{
    return count < UINT16_MAX ? (uint16_t)count : UINT16_MAX;
}

static void judge_drops(const drops_t *drops, const model_t *model)
{
    REQUIRE(drops->damaged == saturated(model->damaged), "damaged frames are counted");
    REQUIRE(drops->replayed == saturated(model->replayed), "replayed frames are counted");
    REQUIRE(drops->masqueraded == saturated(model->masqueraded), "masqueraded frames are counted");
    const uint64_t all = model->damaged + model->replayed + model->masqueraded + drops->unsent;
    REQUIRE(drops->unsent == UINT16_MAX || drops->all == saturated(all), "every drop is counted once");
}

static void judge(const subject_t *subject)
{
    const app_t *app = &subject->app;
    const model_t *model = &subject->model;
    REQUIRE(app->mode == model->mode, "the mode changes along its table, and for a reason");
    REQUIRE(app->fault == model->fault && app->fault_mask == model->fault_mask, "faults latch until CLEAR");
    REQUIRE(model->mode != MODE_FAULT || model->fault_mask != 0, "FAULT has a cause");
    REQUIRE(model->fault_mask == 0 || model->mode == MODE_FAULT || model->mode == MODE_STOPPING,
            "a robot with a fault stops or has stopped");
    REQUIRE(model->stopping_ticks <= STOPPING_TICKS_MAX, "braking comes to its end");
    judge_drops(&app->drops, model);
    REQUIRE(app->port.drive == model->drive, "the drive changes by COMMAND alone");
    REQUIRE(app->peer_matches == model->peer_matches, "the peer is known by its last HELLO");
    REQUIRE(memcmp(app->parameters.value, model->parameter, sizeof model->parameter) == 0, "parameters as set");
    judge_motors(subject);
    judge_store(subject);
}

// ---- nothing happens

enum {
    BEFORE_TRAJECTORY = offsetof(app_t, store.segment),
    AFTER_TRAJECTORY = offsetof(app_t, store.segment_count),
    REST = sizeof(app_t) - AFTER_TRAJECTORY
};

static void remember(subject_t *subject)
{
    memcpy(&subject->before, &subject->app, BEFORE_TRAJECTORY);
    memcpy((uint8_t *)&subject->before + AFTER_TRAJECTORY, (uint8_t *)&subject->app + AFTER_TRAJECTORY, REST);
}

/// The trajectory is looked at by judge_store.
static bool is_unchanged(const subject_t *subject)
{
    return memcmp(&subject->before, &subject->app, BEFORE_TRAJECTORY) == 0 &&
           memcmp((const uint8_t *)&subject->before + AFTER_TRAJECTORY,
                  (const uint8_t *)&subject->app + AFTER_TRAJECTORY, REST) == 0;
}

static void receive_foreign(subject_t *subject, const frame_t *frame)
{
    remember(subject);
    app_receive(&subject->app, frame);
    REQUIRE(is_unchanged(subject), "frames of other nodes and functions change nothing");
}

static void receive_damaged(subject_t *subject, const frame_t *frame)
{
    remember(subject);
    app_receive(&subject->app, frame);
    subject->model.damaged++;
    subject->before.drops = subject->app.drops; // judge_drops looks at them
    REQUIRE(is_unchanged(subject), "a damaged frame is counted and changes nothing else");
}

static void receive_masqueraded(subject_t *subject, const frame_t *frame)
{
    remember(subject);
    app_receive(&subject->app, frame);
    subject->model.masqueraded++;
    subject->before.drops = subject->app.drops;
    REQUIRE(is_unchanged(subject), "a frame under the robot's own name is counted and changes nothing else");
}

// ---- whole frames for this robot

/// The one answer to a request; NULL when nobody takes it.
static const frame_t *only_answer(subject_t *subject, outcome_t *outcome, uint16_t function)
{
    if (!look(subject, outcome)) {
        return NULL;
    }
    REQUIRE(outcome->count == 1, "one answer to a request");
    REQUIRE(outcome->frame[0].id >> FRAME_NODE_BITS == function, "the answer is of its kind");
    return &outcome->frame[0];
}

static void expect_silence(subject_t *subject)
{
    outcome_t outcome;
    REQUIRE(!look(subject, &outcome) || outcome.count == 0, "no answer where nothing was asked");
}

static void after_command(subject_t *subject, const frame_t *frame)
{
    command_message_t command;
    (void)command_decode(&command, frame);
    model_t *model = &subject->model;
    if (!model_request(model, command.counter) && command.operation != OPERATION_STOP) {
        expect_silence(subject);
        return;
    }
    const uint8_t before = model->mode;
    const uint8_t refusal = model_command(model, command.operation, command.key == subject->app.key);
    const int challenges = before == MODE_IDLE && model->mode == MODE_ARMED ? 1 : 0;
    outcome_t outcome;
    if (look(subject, &outcome)) {
        const bool stores =
            command.operation == OPERATION_SAVE_PARAMETERS || command.operation == OPERATION_RESET_PARAMETERS;
        REQUIRE(outcome.count == 1 + challenges + (stores ? 1 : 0) && outcome.statuses == 1,
                "one STATUS for a COMMAND");
        REQUIRE(outcome.challenges == challenges, "a key for ARM and for nothing else");
        REQUIRE(outcome.status.refusal == refusal, "STATUS: the refusal that fits");
        REQUIRE(outcome.status.mode == model->mode, "STATUS: the mode after the COMMAND");
    }
}

static bool has_value(vec3_t reading)
{
    return isfinite(reading.x) && isfinite(reading.y) && isfinite(reading.z);
}

static void after_pose(subject_t *subject, const frame_t *frame)
{
    pose_message_t pose;
    (void)pose_decode(&pose, frame);
    const bool available = has_value((vec3_t){pose.x1_m, pose.x2_m, pose.heading_rad});
    model_arrive(&subject->model, &subject->model.pose, pose.counter, oracle_crc8(frame, 8), available);
    expect_silence(subject);
}

static void after_wheel_speed(subject_t *subject, const frame_t *frame)
{
    wheel_speed_message_t speed;
    (void)wheel_speed_decode(&speed, frame);
    if (subject->model.drive != DRIVE_MOTORS) {
        const bool available =
            has_value((vec3_t){speed.wheel1_rad_per_s, speed.wheel2_rad_per_s, speed.wheel3_rad_per_s});
        model_arrive(&subject->model, &subject->model.wheel_speed, speed.counter, oracle_crc8(frame, 8), available);
    }
    expect_silence(subject);
}

/// A step while STOPPING may be the one that finds the robot at rest: then it drives no more.
static bool came_to_rest(subject_t *subject, uint8_t before)
{
    const app_t *app = &subject->app;
    model_t *model = &subject->model;
    const uint8_t at_rest = model->fault_mask != 0 ? MODE_FAULT : MODE_IDLE;
    const bool rests = before == MODE_STOPPING && app->mode == at_rest && app->fault_mask == model->fault_mask;
    if (rests) {
        model_rest(model);
    }
    return rests;
}

/// The faults of a step against those of the model.
static void judge_faults(subject_t *subject, uint8_t before, model_faults_t faults)
{
    const app_t *app = &subject->app;
    model_t *model = &subject->model;
    if (!drives(before) || came_to_rest(subject, before)) {
        return;
    }
    const uint16_t latched = model->fault_mask, new = app->fault_mask &(uint16_t)~latched;
    REQUIRE((latched & ~app->fault_mask) == 0, "a fault stays");
    REQUIRE((faults.certain & ~app->fault_mask) == 0, "a fault that is there comes up");
    REQUIRE((new & ~faults.possible) == 0, "a fault comes up for a reason");
    REQUIRE(app->fault_mask == 0 || (app->fault_mask >> app->fault & 1) != 0, "the first fault is one of them");
    REQUIRE(latched == 0 || app->fault == model->fault, "the first fault stays the first");
    model_note_faults(model, app->fault, app->fault_mask);
    model->located = model->located || model_drives(model) || (new &(1u << FAULT_ERROR_LIMIT)) != 0;
    subject->steps += model_drives(model) ? 1 : 0;
}

static void expect_step_answers(subject_t *subject, bool answered)
{
    outcome_t outcome;
    if (look(subject, &outcome)) {
        REQUIRE(outcome.torques == (answered ? 1 : 0), "one TORQUE a tick");
        REQUIRE(outcome.slips == (answered ? 1 : 0), "one SLIP a tick");
        REQUIRE(outcome.statuses <= 3, "a STATUS for each change of mode, and one that is due");
    }
}

static void after_sync(subject_t *subject, const frame_t *frame)
{
    sync_message_t sync;
    (void)sync_decode(&sync, frame);
    model_t *model = &subject->model;
    const uint8_t before = model->mode;
    const model_sync_t kind = model_sync(model, sync.tick, sync.pose_crc, sync.wheel_speed_crc);
    if (model->drive != DRIVE_LOCKSTEP || kind == SYNC_REPLAYED) {
        expect_silence(subject);
        return;
    }
    if (kind == SYNC_NEW) {
        judge_faults(subject, before, model_step(model, sync.tick));
    }
    expect_step_answers(subject, true);
}

static float field_of(const model_t *model, uint8_t index, uint8_t field)
{
    const parameter_description_t *description = &parameter_table[index];
    const float of_field[] = {model->parameter[index], description->initial, description->minimum, description->maximum,
                              description->integer ? 1.0f : 0.0f};
    return of_field[field];
}

static void expect_value(subject_t *subject, uint8_t index, uint8_t field, uint8_t result)
{
    outcome_t outcome;
    const frame_t *answer = only_answer(subject, &outcome, PARAMETER_VALUE_FUNCTION);
    if (answer == NULL) {
        return;
    }
    parameter_value_message_t value;
    (void)parameter_value_decode(&value, answer);
    REQUIRE(value.index == index && value.field == field, "PARAMETER_VALUE: the index and field asked for");
    REQUIRE(value.result == result, "PARAMETER_VALUE: the result that fits");
    const bool known = index < PARAMETER_COUNT && field <= FIELD_TYPE;
    const float wanted = known ? field_of(&subject->model, index, field) : NAN;
    REQUIRE(known ? memcmp(&value.value, &wanted, sizeof wanted) == 0 : isnan(value.value),
            "PARAMETER_VALUE: the value of the field, NaN where there is none");
}

static void expect_text(subject_t *subject, const parameter_get_message_t *get)
{
    outcome_t outcome;
    const frame_t *answer = only_answer(subject, &outcome, PARAMETER_TEXT_FUNCTION);
    if (answer == NULL) {
        return;
    }
    const parameter_description_t *description = &parameter_table[get->index];
    char wanted[16 * PARAMETER_TEXT_CHARACTERS] = {0};
    (void)strncpy(wanted, get->field == FIELD_NAME ? description->name : description->unit, sizeof wanted - 1);
    const char *part = &wanted[get->part * PARAMETER_TEXT_CHARACTERS];
    REQUIRE(answer->data[0] == get->index, "PARAMETER_TEXT: the index asked for");
    REQUIRE(memcmp(part, &answer->data[2], PARAMETER_TEXT_CHARACTERS) == 0, "PARAMETER_TEXT: the part asked for");
}

static void after_parameter_set(subject_t *subject, const frame_t *frame)
{
    parameter_set_message_t set;
    (void)parameter_set_decode(&set, frame);
    if (!model_request(&subject->model, set.counter)) {
        expect_silence(subject);
        return;
    }
    expect_value(subject, set.index, FIELD_VALUE, model_set(&subject->model, set.index, set.value));
}

static void after_parameter_get(subject_t *subject, const frame_t *frame)
{
    parameter_get_message_t get;
    (void)parameter_get_decode(&get, frame);
    if (get.index >= PARAMETER_COUNT) {
        expect_value(subject, get.index, get.field, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX);
    } else if (get.field == FIELD_NAME || get.field == FIELD_UNIT) {
        expect_text(subject, &get);
    } else {
        const bool known = get.field <= FIELD_TYPE;
        expect_value(subject, get.index, get.field,
                     known ? PARAMETER_VALUE_RESULT_OK : PARAMETER_VALUE_RESULT_UNKNOWN_FIELD);
    }
}

static void expect_ack(subject_t *subject, model_ack_t expected)
{
    if (!expected.is_due) {
        expect_silence(subject);
        return;
    }
    outcome_t outcome;
    const frame_t *answer = only_answer(subject, &outcome, TRAJECTORY_ACK_FUNCTION);
    if (answer == NULL) {
        return;
    }
    trajectory_ack_message_t ack;
    (void)trajectory_ack_decode(&ack, answer);
    REQUIRE(ack.result == expected.result, "TRAJECTORY_ACK: the result that fits");
    REQUIRE(ack.offset_bytes == subject->model.received_bytes, "TRAJECTORY_ACK: the next offset");
}

static void after_trajectory_begin(subject_t *subject, const frame_t *frame)
{
    trajectory_begin_message_t begin;
    (void)trajectory_begin_decode(&begin, frame);
    if (!model_request(&subject->model, begin.counter)) {
        expect_silence(subject);
        return;
    }
    expect_ack(subject, model_begin(&subject->model, begin.length_bytes, begin.crc32));
}

static void after_trajectory_data(subject_t *subject, const frame_t *frame)
{
    const uint16_t offset_bytes = (uint16_t)(frame->data[0] | frame->data[1] << 8);
    expect_ack(subject, model_data(&subject->model, offset_bytes, &frame->data[2]));
}

static void after_hello(subject_t *subject, const frame_t *frame)
{
    hello_message_t hello;
    (void)hello_decode(&hello, frame);
    model_t *model = &subject->model;
    const uint8_t before = model->mode;
    model->peer_matches = hello.protocol_hash == PROTOCOL_HASH;
    if (model->peer_matches) {
        model_hello(model);
    }
    const int told = model->mode != before ? 1 : 0;
    outcome_t outcome;
    if (!look(subject, &outcome)) {
        return;
    }
    REQUIRE(outcome.count == 2 + told && outcome.statuses == told,
            "HELLO: a STATUS if it ends the motion, two answers");
    const frame_t *answer = &outcome.frame[told];
    REQUIRE(answer[0].id >> FRAME_NODE_BITS == IDENTITY_FUNCTION, "HELLO: IDENTITY first");
    REQUIRE(answer[1].id >> FRAME_NODE_BITS == PARAMETER_STORE_FUNCTION, "HELLO: then PARAMETER_STORE");
    identity_message_t identity;
    (void)identity_decode(&identity, answer);
    REQUIRE(identity.protocol_hash == PROTOCOL_HASH, "IDENTITY: the robot's hash");
    REQUIRE(identity.peer_matches == (model->peer_matches ? 1 : 0), "IDENTITY: whether the hashes agree");
    REQUIRE(identity.drive == model->drive, "IDENTITY: the drive");
    parameter_store_message_t store;
    (void)parameter_store_decode(&store, &answer[1]);
    REQUIRE(store.robot_checksum == omnibot.file_checksum, "PARAMETER_STORE: the robot file");
}

static const struct {
    uint16_t function;
    void (*judge)(subject_t *subject, const frame_t *frame);
} aftermath[] = {
    {SYNC_FUNCTION, after_sync},
    {POSE_FUNCTION, after_pose},
    {WHEEL_SPEED_FUNCTION, after_wheel_speed},
    {COMMAND_FUNCTION, after_command},
    {PARAMETER_SET_FUNCTION, after_parameter_set},
    {PARAMETER_GET_FUNCTION, after_parameter_get},
    {TRAJECTORY_BEGIN_FUNCTION, after_trajectory_begin},
    {TRAJECTORY_DATA_FUNCTION, after_trajectory_data},
    {HELLO_FUNCTION, after_hello},
};

static void receive_whole(subject_t *subject, const frame_t *frame)
{
    app_receive(&subject->app, frame);
    for (size_t i = 0; i < sizeof aftermath / sizeof aftermath[0]; i++) {
        if (aftermath[i].function == frame->id >> FRAME_NODE_BITS) {
            aftermath[i].judge(subject, frame);
            return;
        }
    }
    REQUIRE(false, "every message to the robot has its expectations here");
}

// ---- the calls of app.h

void subject_init(subject_t *subject, app_port_t port)
{
    app_init(&subject->app, &omnibot, SUBJECT_NODE, port);
    model_init(&subject->model, port.drives, port.drive);
    subject->holding = false;
    outcome_t outcome;
    (void)only_answer(subject, &outcome, STATUS_FUNCTION);
    judge(subject);
}

void subject_receive(subject_t *subject, const frame_t *frame)
{
    subject->frames++;
    const message_t *message = oracle_message(frame);
    const bool ours = (frame->id & FRAME_NODE_MASK) == SUBJECT_NODE && message != NULL;
    if (!ours) {
        receive_foreign(subject, frame);
    } else if (!message->to_robot) {
        receive_masqueraded(subject, frame);
    } else if (!oracle_is_whole(message, frame)) {
        receive_damaged(subject, frame);
    } else {
        receive_whole(subject, frame);
    }
    judge(subject);
}

static void tick_of_timer(subject_t *subject)
{
    model_t *model = &subject->model;
    const uint32_t overdue = model->overdue_ticks < UINT16_MAX ? (uint32_t)model->overdue_ticks : UINT16_MAX;
    const uint8_t before = model->mode;
    model->overdue_ticks = 0;
    model->silent_ticks += 1 + overdue;
    app_tick(&subject->app);
    judge_faults(subject, before, model_step(model, model->tick_known ? model->tick + 1 + overdue : 0));
    expect_step_answers(subject, drives(before) || model->silent_ticks <= HEARTBEAT_TICKS_MAX);
}

void subject_tick(subject_t *subject)
{
    if (subject->model.drive == DRIVE_LOCKSTEP) {
        remember(subject);
        app_tick(&subject->app);
        REQUIRE(is_unchanged(subject), "the port's timer does nothing in lockstep");
    } else {
        tick_of_timer(subject);
    }
    judge(subject);
}

void subject_note_overrun(subject_t *subject, uint32_t periods)
{
    app_note_overrun(&subject->app, periods);
    subject->model.overdue_ticks += periods;
    expect_silence(subject);
    judge(subject);
}

void subject_set_wheel_speed(subject_t *subject, vec3_t rad_per_s)
{
    const bool possible =
        fabsf(rad_per_s.x) <= 1000.0f && fabsf(rad_per_s.y) <= 1000.0f && fabsf(rad_per_s.z) <= 1000.0f;
    app_set_wheel_speed(&subject->app, rad_per_s);
    subject->model.wheel_speed.fresh |= subject->model.drive == DRIVE_MOTORS && possible;
    expect_silence(subject);
    judge(subject);
}

void subject_note_motor_fault(subject_t *subject, uint8_t fault)
{
    const bool driven = subject->model.drive == DRIVE_MOTORS && model_drives(&subject->model);
    model_t *model = &subject->model;
    app_note_motor_fault(&subject->app, fault);
    if (driven) {
        const uint8_t first = model->fault_mask == 0 ? fault : model->fault;
        model_note_faults(model, first, (uint16_t)(model->fault_mask | 1u << fault));
    }
    outcome_t outcome;
    if (look(subject, &outcome)) {
        REQUIRE(outcome.count == (driven ? 1 : 0) && outcome.statuses == outcome.count, "a motor fault is told");
    }
    judge(subject);
}

void subject_note_step_time(subject_t *subject, uint32_t step_ns)
{
    app_note_step_time(&subject->app, step_ns);
    expect_silence(subject);
    judge(subject);
}

void subject_note_health(subject_t *subject, const app_health_t *health)
{
    model_t *model = &subject->model;
    const uint8_t before = model->mode;
    app_note_health(&subject->app, health);
    if (health->can_state == CAN_STATE_BUS_OFF && model_drives(model)) {
        const uint8_t first = model->fault_mask == 0 ? FAULT_BUS_OFF : model->fault;
        model_note_faults(model, first, (uint16_t)(model->fault_mask | 1u << FAULT_BUS_OFF));
    }
    outcome_t outcome;
    if (look(subject, &outcome)) {
        const int told = model->mode != before ? 1 : 0;
        REQUIRE(outcome.count == told && outcome.statuses == told, "a bus that is lost is told");
    }
    judge(subject);
}

void subject_note_crash(subject_t *subject, uint32_t pc, uint32_t lr)
{
    app_note_crash(&subject->app, pc, lr);
    expect_silence(subject);
    judge(subject);
}

void subject_hold(subject_t *subject, bool holding)
{
    if (subject->holding && !holding) {
        outcome_t outcome;
        drain(subject, &outcome); // judged as what was made earlier
    }
    subject->holding = holding;
    judge(subject);
}
