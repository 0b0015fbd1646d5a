// SPDX-License-Identifier: MIT
// Time and what it brings: one control step a tick, whoever counts the ticks, and the faults of missing ticks and data.
#ifndef OMNIBOT_APP_PACE_H
#define OMNIBOT_APP_PACE_H

#include "app.h"
#include "messages.h"

/// True where the port's timer makes the ticks, not the host's SYNC.
bool pace_is_timer(const app_t *app);

/// A SYNC of the host: vouches for the readings of its tick; a step in lockstep, elsewhere the host's heartbeat.
void pace_on_sync(app_t *app, const sync_message_t *sync);

/// Forgets how long ago things were heard: what was read before a pause without ticks is of unknown age.
void pace_forget_readings(app_t *app);

/// Time starts anew with the next tick, whatever its number.
void pace_start(app_t *app);

#endif
