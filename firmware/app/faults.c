// SPDX-License-Identifier: MIT
#include "faults.h"

#include "counter.h"
#include "messages.h"
#include "mode.h"
#include "report.h"

/// A robot that has never known where it is has no path to brake along.
static event_t event_of(const app_t *app, uint8_t fault)
{
    return fault_table[fault].reaction == REACTION_BRAKE && app->located ? EVENT_BRAKE : EVENT_CUT;
}

void faults_raise(app_t *app, uint8_t fault)
{
    const uint16_t bit = (uint16_t)(1u << fault);
    if ((app->fault_mask & bit) != 0) {
        return;
    }
    if (app->fault == FAULT_NONE) {
        app->fault = fault;
    }
    app->fault_mask |= bit;
    app->fault_tick[fault] = app->tick;
    counter_add(&app->fault_count[fault], 1);
    app->records_owed |= bit;
    report_event(app, event_of(app, fault));
}

void faults_clear(app_t *app)
{
    app->fault = FAULT_NONE;
    app->fault_mask = 0;
}
