// SPDX-License-Identifier: MIT
#include "pace.h"

#include "counter.h"
#include "faults.h"
#include "messages.h"
#include "mode.h"
#include "report.h"

/// No wheel turns faster; what an encoder says beyond is no speed. 1000 rad/s are 35 m/s.
#define WHEEL_SPEED_MAX_RAD_PER_S 1000.0f

void pace_forget_readings(app_t *app)
{
    reading_forget(&app->pose);
    reading_forget(&app->wheel_speed);
}

void pace_start(app_t *app)
{
    if (!pace_is_timer(app)) {
        pace_forget_readings(app);
        app->sync_known = false;
    }
    app->tick_known = false;
    app->missed_ticks = 0;
    app->overruns = 0;
    app->missed_in_row = 0;
    app->overdue_ticks = 0;
    app->located = false;
    app->advance_us = app->robot->control_period_us;
    braking_reset(&app->braking);
}

bool pace_is_timer(const app_t *app)
{
    return app->port.drive != DRIVE_LOCKSTEP;
}

static bool host_is_there(const app_t *app)
{
    return app->sync_age_ticks <= APP_HEARTBEAT_TICKS_MAX;
}

static bool is_stale(const app_t *app, const reading_t *reading, float timeout_s)
{
    return (float)reading->age_ticks * (float)app->robot->control_period_us > timeout_s * 1.0e6f;
}

/// Raises the faults of missing data. What the controller needs must be there before it is asked.
static void check_readings(app_t *app)
{
    if (is_stale(app, &app->pose, app->parameters.value[PARAMETER_POSE_TIMEOUT_S])) {
        faults_raise(app, FAULT_STALE_POSE);
    }
    if (is_stale(app, &app->wheel_speed, app->parameters.value[PARAMETER_WHEEL_SPEED_TIMEOUT_S])) {
        faults_raise(app, FAULT_STALE_WHEEL_SPEED);
    }
    if (pace_is_timer(app) && !host_is_there(app)) {
        faults_raise(app, FAULT_HOST_SILENT);
    }
}

/// Where the robot should be: on its trajectory, ever slower in STOPPING. Theory of the latter: braking.h.
static reference_t reference_now(app_t *app)
{
    reference_t reference = trajectory_reference(app->store.segment, app->store.segment_count, &app->cursor);
    if (app->mode == MODE_STOPPING) {
        const float acceleration_mps2 = app->parameters.value[PARAMETER_BRAKING_M_PER_S2];
        app->advance_us = braking_step(&app->braking, app->robot, acceleration_mps2, &reference);
    }
    return reference;
}

static bool is_lost(const app_t *app, vec3_t error)
{
    const float limit_m = app->parameters.value[PARAMETER_ERROR_LIMIT_M];
    return error.x * error.x + error.y * error.y > limit_m * limit_m;
}

/// The torque of this tick; zeros when the mode does not drive or a fault ends it.
static control_output_t drive(app_t *app)
{
    control_output_t output = {0};
    if (!mode_drives(app->mode)) {
        return output;
    }
    const control_input_t input = {
        .pose_is_new = app->pose.age_ticks == 0 || !app->located, // the first may be from shortly before START
        .pose = app->pose.value,
        .wheel_speed_rad_per_s = app->wheel_speed.value,
        .reference = reference_now(app),
    };
    app->located = true;
    if (!control_step(&app->control, &app->state, &input, &output)) {
        faults_raise(app, FAULT_NOT_FINITE);
        return output;
    }
    if (is_lost(app, output.error)) {
        faults_raise(app, FAULT_ERROR_LIMIT);
        return (control_output_t){0};
    }
    return output;
}

static void compose_answers(app_t *app, const control_output_t *output)
{
    const uint8_t counter = (uint8_t)(app->sync_tick & 0xFu);
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
    report_send(app, &app->torque_answer);
    report_send(app, &app->slip_answer);
}

/// Counts ticks that a driving robot has missed; too many without one on time between them are a fault.
static void note_missed(app_t *app, uint32_t missed)
{
    counter_add(&app->missed_ticks, missed);
    app->missed_in_row = missed > 0 ? counter_sum(app->missed_in_row, missed) : 0;
    if ((float)app->missed_in_row > app->parameters.value[PARAMETER_TICK_GAP_MAX]) {
        faults_raise(app, pace_is_timer(app) ? FAULT_OVERRUN : FAULT_TICK_GAP);
    }
}

/// Moves the reference and what is dead-reckoned on by some ticks, all but the last of them without a step.
static void move_on(app_t *app, uint32_t ticks)
{
    // A gap that is no fault is at most a few periods: the product cannot overflow.
    trajectory_advance(app->store.segment, app->store.segment_count, &app->cursor, ticks * app->advance_us);
    for (uint32_t missed = 1; missed < ticks; missed++) {
        control_coast(&app->control, &app->state);
    }
}

/// Moves time on to a tick; a long gap while driving is a fault.
static void advance_to(app_t *app, uint32_t tick)
{
    const uint32_t ticks = app->tick_known ? tick - app->tick : 1;
    if (app->tick_known && mode_drives(app->mode)) {
        note_missed(app, ticks - 1);
        if (mode_drives(app->mode)) {
            move_on(app, ticks);
        }
    }
    reading_age(&app->pose, ticks);
    reading_age(&app->wheel_speed, ticks);
    app->key_age_ticks = counter_sum(app->key_age_ticks, ticks);
    app->tick = tick;
    app->tick_known = true;
}

/// What ends by time alone: the key of ARM, and braking.
static void check_time(app_t *app)
{
    if (app->mode == MODE_ARMED && app->key_age_ticks >= APP_KEY_TICKS) {
        report_event(app, EVENT_LAPSE);
    }
    if (app->mode == MODE_STOPPING && braking_is_over(&app->braking)) {
        report_event(app, app->fault_mask == 0 ? EVENT_REST : EVENT_REST_WITH_FAULT);
    }
}

static void step(app_t *app, uint32_t tick)
{
    advance_to(app, tick);
    check_time(app);
    if (mode_drives(app->mode)) {
        check_readings(app);
    }
    const control_output_t output = drive(app);
    app->torque_Nm = output.torque_Nm;
    compose_answers(app, &output);
}

static void on_host_tick(app_t *app, uint32_t tick)
{
    step(app, tick);
    send_answers(app);
    report_due(app);
}

/// A tick that has come before: the host has missed the answer.
static void answer_again(app_t *app)
{
    if (!mode_drives(app->mode)) {
        compose_answers(app, &(control_output_t){0}); // it may have driven when the tick came first
    }
    send_answers(app);
}

static void confirm(app_t *app, reading_t *reading, uint8_t counter, uint8_t crc)
{
    const reading_verdict_t verdict = reading_confirm(reading, counter, crc);
    if (verdict == READING_OF_ANOTHER_TICK) {
        report_drop(app, &app->drops.replayed);
    }
    if (verdict == READING_DAMAGED) {
        report_drop(app, &app->drops.damaged);
    }
}

/// Ticks of a host go forward, by any number; only where nothing moves may they begin anew.
static bool is_new_tick(app_t *app, uint32_t tick)
{
    if (app->sync_known && (int32_t)(tick - app->sync_tick) < 0 && mode_is_safe(app->mode)) {
        app->sync_known = false;
        app->tick_known = false;
    }
    return !app->sync_known || (int32_t)(tick - app->sync_tick) > 0;
}

void pace_on_sync(app_t *app, const sync_message_t *sync)
{
    const uint8_t counter = sync->tick & 0xFu;
    if (is_new_tick(app, sync->tick)) {
        app->sync_tick = sync->tick;
        app->sync_known = true;
        app->sync_age_ticks = 0;
        confirm(app, &app->pose, counter, sync->pose_crc);
        confirm(app, &app->wheel_speed, counter, sync->wheel_speed_crc);
        if (!pace_is_timer(app)) {
            on_host_tick(app, sync->tick);
        }
    } else if (sync->tick == app->sync_tick && !pace_is_timer(app)) {
        answer_again(app);
    } else {
        report_drop(app, &app->drops.replayed);
    }
}

void app_tick(app_t *app)
{
    if (!pace_is_timer(app)) {
        return;
    }
    const uint32_t overdue = app->overdue_ticks;
    app->overdue_ticks = 0;
    app->sync_age_ticks = counter_sum(app->sync_age_ticks, 1 + overdue);
    // A host that is gone gets no answers; but one that goes now is told that the torque ends.
    const bool answered = host_is_there(app) || mode_drives(app->mode);
    step(app, app->tick_known ? app->tick + 1 + overdue : 0);
    if (answered) {
        send_answers(app);
    }
    report_due(app);
}

void app_note_overrun(app_t *app, uint32_t periods)
{
    counter_add(&app->overruns, periods);
    counter_add(&app->overdue_ticks, periods);
}

void app_set_wheel_speed(app_t *app, vec3_t rad_per_s)
{
    if (app->port.drive == DRIVE_MOTORS && vec3_max_abs(rad_per_s) <= WHEEL_SPEED_MAX_RAD_PER_S) {
        reading_take(&app->wheel_speed, rad_per_s);
    }
}

bool app_motor_torque(const app_t *app, vec3_t *torque_Nm)
{
    const bool on = app->port.drive == DRIVE_MOTORS && mode_drives(app->mode);
    *torque_Nm = on ? app->torque_Nm : (vec3_t){0};
    return on;
}

void app_note_motor_fault(app_t *app, uint8_t fault)
{
    if (app_motor_torque(app, &(vec3_t){0})) {
        faults_raise(app, fault);
    }
}
