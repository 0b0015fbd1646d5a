// SPDX-License-Identifier: MIT
// What the robot says of itself: STATUS, and every so many ticks TIMING, HEALTH and CRASH.
#ifndef OMNIBOT_APP_REPORT_H
#define OMNIBOT_APP_REPORT_H

#include "app.h"

/// Puts a frame into the outbox; one that finds no room is counted as dropped.
void report_send(app_t *app, const frame_t *frame);

/// Sends STATUS.
void report_status(app_t *app);

/// Sends what is due at the present tick.
void report_due(app_t *app);

#endif
