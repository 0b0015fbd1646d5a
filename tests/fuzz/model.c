// SPDX-License-Identifier: MIT
#include "model.h"

#include "messages.h"
#include "oracle.h"

#include <math.h>
#include <string.h>

enum { KEY_TICKS = 5000, REQUESTS_LOST_MAX = 2 };
enum { HEARTBEAT_TICKS_MAX = 100, PERIOD_US = 1000, DATA_BYTES = 6, BYTES_PER_ACK = 16 * DATA_BYTES };

static const model_reading_t never_read = {.age_ticks = UINT32_MAX};

static void forget_readings(model_t *model)
{
    model->pose = never_read;
    model->wheel_speed = never_read;
}

void model_init(model_t *model, uint8_t drives, uint8_t drive)
{
    memset(model, 0, sizeof *model);
    model->drives = drives;
    model->drive = drive;
    model->mode = MODE_IDLE;
    model->silent_ticks = UINT32_MAX;
    forget_readings(model);
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        model->parameter[i] = parameter_table[i].initial;
    }
}

bool model_drives(const model_t *model)
{
    return model->mode == MODE_TRACKING || model->mode == MODE_STOPPING;
}

bool model_is_safe(const model_t *model)
{
    return !model_drives(model) && model->mode != MODE_ARMED;
}

// ---- commands

bool model_request(model_t *model, uint8_t counter)
{
    const unsigned ahead = (16u + counter - model->request_counter) % 16u;
    if (model->requests_known && (ahead == 0 || ahead > 1 + REQUESTS_LOST_MAX)) {
        model->replayed++;
        return false;
    }
    model->requests_known = true;
    model->request_counter = counter;
    return true;
}

static uint8_t arm(model_t *model)
{
    if (model->mode != MODE_IDLE) {
        return REFUSAL_WRONG_MODE;
    }
    if (!model->peer_matches) {
        return REFUSAL_UNKNOWN_PEER;
    }
    if (model->held_bytes == 0) {
        return REFUSAL_NO_TRAJECTORY;
    }
    model->mode = MODE_ARMED;
    model->armed_ticks = 0;
    return REFUSAL_NONE;
}

static uint8_t start(model_t *model, bool key_fits)
{
    if (model->mode != MODE_ARMED) {
        return REFUSAL_WRONG_MODE;
    }
    if (!key_fits) {
        model->mode = MODE_IDLE;
        return REFUSAL_WRONG_KEY;
    }
    model->mode = MODE_TRACKING;
    model->tick_known = false;
    model->missed_in_row = 0;
    model->overdue_ticks = 0;
    model->located = false;
    model->stopping_ticks = 0;
    if (model->drive == DRIVE_LOCKSTEP) {
        forget_readings(model);
        model->sync_known = false;
    }
    return REFUSAL_NONE;
}

static uint8_t use(model_t *model, uint8_t drive)
{
    if (model->mode != MODE_IDLE) {
        return REFUSAL_WRONG_MODE;
    }
    if ((model->drives >> drive & 1) == 0) {
        return REFUSAL_UNABLE;
    }
    model->drive = drive;
    model->tick_known = false;
    model->sync_known = false;
    model->silent_ticks = UINT32_MAX;
    forget_readings(model);
    return REFUSAL_NONE;
}

static uint8_t stop(model_t *model)
{
    model->mode = model->mode == MODE_TRACKING ? MODE_STOPPING : model->mode == MODE_ARMED ? MODE_IDLE : model->mode;
    return REFUSAL_NONE;
}

static uint8_t clear(model_t *model)
{
    if (!model_is_safe(model)) {
        return REFUSAL_WRONG_MODE;
    }
    model->mode = MODE_IDLE;
    model->fault = FAULT_NONE;
    model->fault_mask = 0;
    return REFUSAL_NONE;
}

static uint8_t reset_parameters(model_t *model)
{
    if (!model_is_safe(model)) {
        return REFUSAL_WRONG_MODE;
    }
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        model->parameter[i] = parameter_table[i].initial;
    }
    return REFUSAL_NONE;
}

uint8_t model_command(model_t *model, uint8_t operation, bool key_fits)
{
    switch (operation) {
    case OPERATION_ARM:
        return arm(model);
    case OPERATION_START:
        return start(model, key_fits);
    case OPERATION_STOP:
        return stop(model);
    case OPERATION_CLEAR:
        return clear(model);
    case OPERATION_SAVE_PARAMETERS:
        return model_is_safe(model) ? REFUSAL_UNABLE : REFUSAL_WRONG_MODE; // this robot has nothing to keep them in
    case OPERATION_RESET_PARAMETERS:
        return reset_parameters(model);
    case OPERATION_USE_LOCKSTEP:
        return use(model, DRIVE_LOCKSTEP);
    case OPERATION_USE_REALTIME:
        return use(model, DRIVE_REALTIME);
    case OPERATION_USE_MOTORS:
        return use(model, DRIVE_MOTORS);
    default:
        return REFUSAL_UNKNOWN_OPERATION;
    }
}

void model_hello(model_t *model)
{
    model->requests_known = false;
    if (model->drive == DRIVE_LOCKSTEP) {
        model->sync_known = false;
        model->tick_known = false;
        if (!model_is_safe(model)) {
            model->mode = model->fault_mask != 0 ? MODE_FAULT : MODE_IDLE;
        }
    }
}

// ---- readings and ticks

void model_arrive(model_t *model, model_reading_t *reading, uint8_t counter, uint8_t crc, bool available)
{
    if (model->sync_known && counter == model->sync_tick % 16u) {
        model->replayed++;
        return;
    }
    model->replayed += reading->waits ? 1 : 0;
    *reading = (model_reading_t){reading->age_ticks, reading->fresh, true, available, counter, crc};
}

static void vouch(model_t *model, model_reading_t *reading, uint8_t counter, uint8_t crc)
{
    if (!reading->waits) {
        return;
    }
    reading->waits = false;
    if (reading->counter != counter) {
        model->replayed++;
    } else if (reading->crc != crc) {
        model->damaged++;
    } else {
        reading->fresh = reading->fresh || reading->available;
    }
}

model_sync_t model_sync(model_t *model, uint32_t tick, uint8_t pose_crc, uint8_t wheel_speed_crc)
{
    const uint8_t counter = tick % 16u;
    const bool back = model->sync_known && tick - model->sync_tick >= 0x80000000u;
    if (back && model_is_safe(model)) {
        model->sync_known = false;
        model->tick_known = false;
    }
    if (model->sync_known && (back || tick == model->sync_tick)) {
        const bool again = !back && model->drive == DRIVE_LOCKSTEP;
        model->replayed += again ? 0 : 1;
        return again ? SYNC_AGAIN : SYNC_REPLAYED;
    }
    model->sync_known = true;
    model->sync_tick = tick;
    model->silent_ticks = 0;
    vouch(model, &model->pose, counter, pose_crc);
    vouch(model, &model->wheel_speed, counter, wheel_speed_crc);
    return SYNC_NEW;
}

// ---- parameters

uint8_t model_set(model_t *model, uint8_t index, float value)
{
    if (!model_is_safe(model)) {
        return index < PARAMETER_COUNT ? PARAMETER_VALUE_RESULT_IN_MOTION : PARAMETER_VALUE_RESULT_UNKNOWN_INDEX;
    }
    if (index >= PARAMETER_COUNT) {
        return PARAMETER_VALUE_RESULT_UNKNOWN_INDEX;
    }
    const parameter_description_t *description = &parameter_table[index];
    const bool outside = isnan(value) || value < description->minimum || value > description->maximum;
    if (outside || (description->integer && islessgreater(value, floorf(value)))) {
        return PARAMETER_VALUE_RESULT_OUT_OF_RANGE;
    }
    model->parameter[index] = value;
    return PARAMETER_VALUE_RESULT_OK;
}

// ---- upload

model_ack_t model_begin(model_t *model, uint16_t length_bytes, uint32_t crc32)
{
    if (!model_is_safe(model)) {
        return (model_ack_t){true, TRAJECTORY_ACK_RESULT_IN_MOTION};
    }
    if (length_bytes == 0 || length_bytes > MODEL_BYTES_MAX || length_bytes % MODEL_BYTES_PER_SEGMENT != 0) {
        return (model_ack_t){true, TRAJECTORY_ACK_RESULT_WRONG_LENGTH};
    }
    model->length_bytes = length_bytes;
    model->received_bytes = 0;
    model->crc32 = crc32;
    model->receiving = true;
    model->held_bytes = 0;
    return (model_ack_t){true, TRAJECTORY_ACK_RESULT_RECEIVING};
}

static float coefficient_at(const uint8_t *segment, int axis, int power)
{
    float coefficient;
    memcpy(&coefficient, &segment[4 + 32 * axis + 4 * power], sizeof coefficient);
    return coefficient;
}

static bool coefficients_may_be_driven(const uint8_t *segment)
{
    bool good = true;
    for (int place = 0; place < 24; place++) {
        const float coefficient = coefficient_at(segment, place / 8, place % 8);
        good = good && isfinite(coefficient) && coefficient >= -1.0e4f && coefficient <= 1.0e4f;
    }
    return good;
}

static uint32_t duration_us_of(const uint8_t *segment)
{
    uint32_t duration_us;
    memcpy(&duration_us, segment, sizeof duration_us);
    return duration_us;
}

float model_end(const uint8_t *segment, int axis)
{
    float end = 0.0f;
    for (int power = 7; power >= 0; power--) {
        end += coefficient_at(segment, axis, power);
    }
    return end;
}

static bool joins(const uint8_t *segment, const uint8_t *next)
{
    bool good = true;
    for (int axis = 0; axis < 3; axis++) {
        const float gap = coefficient_at(next, axis, 0) - model_end(segment, axis);
        good = good && gap >= -1.0e-3f && gap <= 1.0e-3f;
    }
    return good;
}

/// What is wrong with what was received whole, the worst first, by the table of protocol/README.md.
static uint8_t judge_upload(const model_t *model)
{
    bool coefficients = true, durations = true, joints = true;
    double sum_us = 0.0;
    for (int at = 0; at < model->length_bytes; at += MODEL_BYTES_PER_SEGMENT) {
        const uint8_t *segment = &model->byte[at];
        const double duration_us = (double)duration_us_of(segment);
        coefficients = coefficients && coefficients_may_be_driven(segment);
        durations = durations && duration_us >= 1.0 && duration_us <= 600.0e6;
        joints = joints && (at == 0 || joins(segment - MODEL_BYTES_PER_SEGMENT, segment));
        sum_us += duration_us;
    }
    durations = durations && sum_us <= 3600.0e6;
    return !coefficients ? TRAJECTORY_ACK_RESULT_BAD_SEGMENT
           : !durations  ? TRAJECTORY_ACK_RESULT_BAD_DURATION
           : !joints     ? TRAJECTORY_ACK_RESULT_DISCONTINUOUS
                         : TRAJECTORY_ACK_RESULT_COMPLETE;
}

static uint8_t finish(model_t *model)
{
    model->receiving = false;
    if (oracle_crc32(model->byte, model->length_bytes) != model->crc32) {
        return TRAJECTORY_ACK_RESULT_WRONG_CRC;
    }
    const uint8_t result = judge_upload(model);
    model->held_bytes = result == TRAJECTORY_ACK_RESULT_COMPLETE ? model->length_bytes : 0;
    return result;
}

model_ack_t model_data(model_t *model, uint16_t offset_bytes, const uint8_t data[6])
{
    if (!model_is_safe(model)) {
        return (model_ack_t){true, TRAJECTORY_ACK_RESULT_IN_MOTION};
    }
    if (!model->receiving || offset_bytes != model->received_bytes) {
        return (model_ack_t){true, TRAJECTORY_ACK_RESULT_WRONG_OFFSET};
    }
    const int left = model->length_bytes - model->received_bytes;
    const int taken = left < DATA_BYTES ? left : DATA_BYTES;
    memcpy(&model->byte[model->received_bytes], data, (size_t)taken);
    model->received_bytes = (uint16_t)(model->received_bytes + taken);
    if (taken == left) {
        return (model_ack_t){true, finish(model)};
    }
    return (model_ack_t){model->received_bytes % BYTES_PER_ACK == 0, TRAJECTORY_ACK_RESULT_RECEIVING};
}

// ---- time

static void age(model_reading_t *reading, uint64_t ticks)
{
    reading->age_ticks = reading->fresh ? 0 : reading->age_ticks + ticks;
    reading->fresh = false;
}

/// Adds the fault of a reading. The firmware compares in single precision: at the timeout itself either may be right.
static void judge_age(model_faults_t *faults, const model_reading_t *reading, float timeout_s, uint8_t fault)
{
    const double age_us = (double)reading->age_ticks * PERIOD_US, timeout_us = 1.0e6 * (double)timeout_s;
    const unsigned bit = 1u << fault;
    faults->certain = (uint16_t)(faults->certain | (age_us > timeout_us * 1.000001 ? bit : 0u));
    faults->possible = (uint16_t)(faults->possible | (age_us >= timeout_us * 0.999999 && age_us > 0.0 ? bit : 0u));
}

/// Faults that leave a robot that knows where it is able to brake.
static const uint16_t braking = 1u << FAULT_STALE_POSE | 1u << FAULT_HOST_SILENT | 1u << FAULT_BUS_OFF;

static model_faults_t judge_readings(const model_t *model)
{
    model_faults_t faults = {0, 0};
    judge_age(&faults, &model->pose, model->parameter[PARAMETER_POSE_TIMEOUT_S], FAULT_STALE_POSE);
    judge_age(&faults, &model->wheel_speed, model->parameter[PARAMETER_WHEEL_SPEED_TIMEOUT_S], FAULT_STALE_WHEEL_SPEED);
    if (model->drive != DRIVE_LOCKSTEP && model->silent_ticks > HEARTBEAT_TICKS_MAX) {
        faults.certain |= 1u << FAULT_HOST_SILENT;
    }
    faults.possible |= faults.certain;
    if ((faults.certain & ~braking) == 0) {
        faults.possible |= 1u << FAULT_NOT_FINITE | 1u << FAULT_ERROR_LIMIT; // what drives on computes
    }
    return faults;
}

/// Whether too many ticks have been missed in a row.
static bool is_gap(model_t *model, uint32_t ticks)
{
    model->missed_in_row = ticks > 1 ? model->missed_in_row + (ticks - 1) : 0;
    return (double)model->missed_in_row > (double)model->parameter[PARAMETER_TICK_GAP_MAX];
}

static void lapse(model_t *model, uint32_t ticks)
{
    model->armed_ticks += ticks;
    if (model->mode == MODE_ARMED && model->armed_ticks >= KEY_TICKS) {
        model->mode = MODE_IDLE;
    }
}

model_faults_t model_step(model_t *model, uint32_t tick)
{
    const uint32_t ticks = model->tick_known ? tick - model->tick : 1;
    const bool driving = model_drives(model);
    const bool gap = driving && model->tick_known && is_gap(model, ticks);
    model->tick = tick;
    model->tick_known = true;
    age(&model->pose, ticks);
    age(&model->wheel_speed, ticks);
    lapse(model, ticks);
    if (!driving) {
        return (model_faults_t){0, 0};
    }
    model->stopping_ticks = model->mode == MODE_STOPPING ? model->stopping_ticks + 1 : 0;
    if (gap) {
        const uint16_t bit = (uint16_t)(1u << (model->drive == DRIVE_LOCKSTEP ? FAULT_TICK_GAP : FAULT_OVERRUN));
        return (model_faults_t){bit, bit};
    }
    return judge_readings(model);
}

void model_note_faults(model_t *model, uint8_t fault, uint16_t fault_mask)
{
    const uint16_t new = fault_mask &(uint16_t)~model->fault_mask;
    model->fault = fault;
    model->fault_mask = fault_mask;
    if ((new & ~braking) != 0 || (new != 0 && !model->located)) {
        model->mode = MODE_FAULT;
    } else if (new != 0 && model->mode == MODE_TRACKING) {
        model->mode = MODE_STOPPING;
    }
}

void model_rest(model_t *model)
{
    model->mode = model->fault_mask != 0 ? MODE_FAULT : MODE_IDLE;
}
