// SPDX-License-Identifier: MIT
// Faults: latched until CLEAR, the first cause kept, each counted. What each is and does: firmware/app/faults.toml.
#ifndef OMNIBOT_APP_FAULTS_H
#define OMNIBOT_APP_FAULTS_H

#include "app.h"

/// A fault is there: the robot brakes or lets go, and says so. One that is latched already changes nothing.
void faults_raise(app_t *app, uint8_t fault);

/// Forgets what is latched, not how often each came.
void faults_clear(app_t *app);

#endif
