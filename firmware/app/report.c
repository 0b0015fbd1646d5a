// SPDX-License-Identifier: MIT
#include "report.h"

#include "counter.h"
#include "faults.h"
#include "messages.h"

void report_drop(app_t *app, uint16_t *reason)
{
    counter_add(reason, 1);
    counter_add(&app->drops.all, 1);
}

void report_send(app_t *app, const frame_t *frame)
{
    if (!outbox_push(&app->outbox, frame)) {
        report_drop(app, &app->drops.unsent);
    }
}

void report_status(app_t *app)
{
    const status_message_t status = {
        .mode = app->mode,
        .refusal = app->refusal,
        .fault = app->fault,
        .fault_mask = app->fault_mask,
        .dropped_frames = app->drops.all,
        .missed_ticks = app->missed_ticks,
    };
    frame_t frame;
    status_encode(&frame, app->node, &status);
    app->status_owed = !outbox_push(&app->outbox, &frame);
}

void report_event(app_t *app, event_t event)
{
    const uint8_t mode = mode_after(app->mode, event);
    if (mode != app->mode) {
        app->mode = mode;
        report_status(app);
    }
}

static void send_drops(app_t *app)
{
    const drops_message_t drops = {
        .damaged = app->drops.damaged,
        .replayed = app->drops.replayed,
        .masqueraded = app->drops.masqueraded,
        .unsent = app->drops.unsent,
    };
    frame_t frame;
    drops_encode(&frame, app->node, &drops);
    report_send(app, &frame);
}

/// Without a step time there is nothing to say.
static void send_timing(app_t *app)
{
    const step_times_t *times = &app->step_times;
    if (times->count == 0) {
        return;
    }
    const timing_message_t timing = {
        .step_min_us = 1.0e-3f * (float)times->min_ns,
        .step_mean_us = 1.0e-3f * (float)times->sum_ns / (float)times->count,
        .step_max_us = 1.0e-3f * (float)times->max_ns,
        .overruns = app->overruns,
    };
    frame_t frame;
    timing_encode(&frame, app->node, &timing);
    report_send(app, &frame);
    app->step_times = (step_times_t){0};
}

static void send_crash(app_t *app)
{
    const crash_message_t crash = {.pc = app->crash_pc, .lr = app->crash_lr};
    frame_t frame;
    crash_encode(&frame, app->node, &crash);
    report_send(app, &frame);
    app->crash_known = false;
}

static void send_health(app_t *app)
{
    if (!app->health_known) {
        return;
    }
    const health_message_t health = {
        .reset_cause = app->health.reset_cause,
        .clock_source = app->health.clock_source,
        .can_state = app->health.can_state,
        .bridges = app_motor_torque(app, &(vec3_t){0}) ? 1 : 0,
        .can_tx_errors = app->health.can_tx_errors,
        .can_rx_errors = app->health.can_rx_errors,
        .can_bus_offs = app->health.can_bus_offs,
        .can_rx_lost = app->health.can_rx_lost,
        .supply_V = app->health.supply_V,
    };
    frame_t frame;
    health_encode(&frame, app->node, &health);
    report_send(app, &frame);
    if (app->crash_known) {
        send_crash(app);
    }
}

static void send_record(app_t *app, uint8_t fault)
{
    const fault_record_message_t record = {
        .fault = fault,
        .reaction = fault_table[fault].reaction,
        .count = app->fault_count[fault],
        .tick = app->fault_tick[fault],
    };
    frame_t frame;
    fault_record_encode(&frame, app->node, &record);
    report_send(app, &frame);
}

/// One a tick, and not in the tick of the fault itself: that has enough to do.
static void send_owed_record(app_t *app)
{
    for (uint32_t fault = 1; fault < FAULT_COUNT; fault++) {
        if (((uint32_t)app->records_owed >> fault & 1u) != 0) {
            app->records_owed &= (uint16_t) ~(1u << fault);
            send_record(app, (uint8_t)fault);
            return;
        }
    }
}

void report_due(app_t *app)
{
    const uint32_t phase = app->tick % APP_STATUS_EVERY_TICKS;
    if (phase == 0) {
        report_status(app);
        send_timing(app);
        send_health(app);
        return;
    }
    if (phase == APP_STATUS_EVERY_TICKS / 2) { // the work of a tick stays small
        send_drops(app);
        app->records_owed = (uint16_t)(app->records_owed | (app->fault == FAULT_NONE ? 0u : 1u << app->fault));
        return;
    }
    if (app->records_owed != 0 && app->fault_tick[app->fault] != app->tick) {
        send_owed_record(app);
    }
}

void app_note_step_time(app_t *app, uint32_t step_ns)
{
    step_times_t *times = &app->step_times;
    times->min_ns = times->count == 0 || step_ns < times->min_ns ? step_ns : times->min_ns;
    times->max_ns = step_ns > times->max_ns ? step_ns : times->max_ns;
    times->sum_ns = counter_sum(times->sum_ns, step_ns);
    times->count = counter_sum(times->count, 1);
}

void app_note_health(app_t *app, const app_health_t *health)
{
    app->health = *health;
    app->health_known = true;
    if (health->can_state == CAN_STATE_BUS_OFF && mode_drives(app->mode)) {
        faults_raise(app, FAULT_BUS_OFF);
    }
}

void app_note_crash(app_t *app, uint32_t pc, uint32_t lr)
{
    app->crash_pc = pc;
    app->crash_lr = lr;
    app->crash_known = true;
}
