// SPDX-License-Identifier: MIT
#include "pace.h"

#include "counter.h"
#include "messages.h"
#include "report.h"

void pace_forget_readings(app_t *app)
{
    app->pose = (reading_t){.age_ticks = UINT32_MAX};
    app->wheel_speed = (reading_t){.age_ticks = UINT32_MAX};
}

void pace_start(app_t *app)
{
    if (!pace_is_timer(app)) {
        pace_forget_readings(app);
    }
    app->tick_known = false;
    app->missed_ticks = 0;
    app->overruns = 0;
    app->missed_in_row = 0;
    app->overdue_ticks = 0;
}

// A COMMAND has its one STATUS anyway, and the host takes the first for the answer.
void pace_handle_event(app_t *app, event_t event)
{
    const uint8_t mode = mode_after(app->mode, event);
    if (mode != app->mode) {
        app->mode = mode;
        report_status(app);
    }
}

static void raise_fault(app_t *app, uint8_t fault)
{
    if (app->fault == FAULT_NONE) {
        app->fault = fault;
    }
    app->fault_mask |= (uint16_t)(1u << fault);
    pace_handle_event(app, EVENT_FAULT);
}

bool pace_is_timer(const app_t *app)
{
    return app->port.drive != DRIVE_LOCKSTEP;
}

static bool host_is_there(const app_t *app)
{
    return app->sync_age_ticks <= APP_HEARTBEAT_TICKS_MAX;
}

static void age(reading_t *reading, uint32_t ticks)
{
    reading->age_ticks = reading->fresh ? 0 : counter_sum(reading->age_ticks, ticks);
    reading->fresh = false;
}

static bool is_stale(const app_t *app, const reading_t *reading, float timeout_s)
{
    return (float)reading->age_ticks * (float)app->robot->control_period_us > timeout_s * 1.0e6f;
}

/// Raises the faults of missing data. What the controller needs must be there before it is asked.
static void check_readings(app_t *app)
{
    if (is_stale(app, &app->pose, app->parameters.value[PARAMETER_POSE_TIMEOUT_S])) {
        raise_fault(app, FAULT_STALE_POSE);
    }
    if (is_stale(app, &app->wheel_speed, app->parameters.value[PARAMETER_WHEEL_SPEED_TIMEOUT_S])) {
        raise_fault(app, FAULT_STALE_WHEEL_SPEED);
    }
    if (pace_is_timer(app) && !host_is_there(app)) {
        raise_fault(app, FAULT_HOST_SILENT);
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
        raise_fault(app, pace_is_timer(app) ? FAULT_OVERRUN : FAULT_TICK_GAP);
    }
}

/// Moves the reference and what is dead-reckoned on by some ticks, all but the last of them without a step.
static void move_on(app_t *app, uint32_t ticks)
{
    // A gap that is no fault is at most a few periods: the product cannot overflow.
    trajectory_advance(app->store.segment, app->store.segment_count, &app->cursor,
                       ticks * app->robot->control_period_us);
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
    age(&app->pose, ticks);
    age(&app->wheel_speed, ticks);
    app->tick = tick;
    app->tick_known = true;
}

static void step(app_t *app, uint32_t tick)
{
    advance_to(app, tick);
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

static void on_lockstep(app_t *app, uint32_t tick)
{
    if (app->tick_known && tick == app->tick) {
        if (!mode_drives(app->mode)) {
            compose_answers(app, &(control_output_t){0}); // it may have driven when the tick came first
        }
        send_answers(app);
        return;
    }
    if (app->tick_known && tick < app->tick) {
        app->tick_known = false;
        pace_handle_event(app, EVENT_RESTART);
    }
    on_host_tick(app, tick);
}

void pace_on_sync(app_t *app, uint32_t tick)
{
    app->sync_tick = tick;
    app->sync_age_ticks = 0;
    if (!pace_is_timer(app)) {
        on_lockstep(app, tick);
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
    if (app->port.drive == DRIVE_MOTORS) {
        app->wheel_speed.value = rad_per_s;
        app->wheel_speed.fresh = true;
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
        raise_fault(app, fault);
    }
}
