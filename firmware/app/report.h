// SPDX-License-Identifier: MIT
// What the robot says of itself: STATUS, FAULT_RECORD, and every so many ticks DROPS, TIMING, HEALTH and CRASH.
#ifndef OMNIBOT_APP_REPORT_H
#define OMNIBOT_APP_REPORT_H

#include "app.h"
#include "mode.h"

/// Counts a frame that was dropped, by its reason: one of app->drops.
void report_drop(app_t *app, uint16_t *reason);

/// Puts a frame into the outbox; one that finds no room is counted as dropped.
void report_send(app_t *app, const frame_t *frame);

/// Sends STATUS; where it finds no room, as soon as there is some.
void report_status(app_t *app);

/// Changes the mode by an event that no COMMAND asked for, and sends STATUS of it. A COMMAND has its one STATUS anyway,
/// and the host takes the first for the answer.
void report_event(app_t *app, event_t event);

/// Sends what is due at the present tick.
void report_due(app_t *app);

#endif
