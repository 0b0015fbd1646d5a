// SPDX-License-Identifier: MIT
// Time and what it brings: one control step a tick, whoever counts the ticks, and the faults of missing ticks and data.
#ifndef OMNIBOT_APP_PACE_H
#define OMNIBOT_APP_PACE_H

#include "app.h"
#include "mode.h"

/// True where the port's timer makes the ticks, not the host's SYNC.
bool pace_is_timer(const app_t *app);

/// A SYNC of the host: a step in lockstep, elsewhere its heartbeat.
void pace_on_sync(app_t *app, uint32_t tick);

/// Forgets how long ago things were heard: what was read before a pause without ticks is of unknown age.
void pace_forget_readings(app_t *app);

/// Time starts anew with the next tick, whatever its number.
void pace_start(app_t *app);

/// Changes the mode by an event that no COMMAND asked for, and tells of it.
void pace_handle_event(app_t *app, event_t event);

#endif
