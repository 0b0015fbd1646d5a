// SPDX-License-Identifier: MIT
// Stopping along the path: the reference keeps its course, and the time of the trajectory runs ever slower until it
// stands. With the rate σ of that time, y(t) = yref(τ) and τ̇ = σ, so
//
//   ẏ = σ yref',  ÿ = σ² yref'' + σ̇ yref',  y⃛ = σ³ yref''' + 3 σ σ̇ yref''   (σ̈ = 0 but where braking begins and ends)
//
// σ̇ < 0 is chosen so that path and braking together ask for no more than a given acceleration of a point at the wheels.
#ifndef OMNIBOT_APP_BRAKING_H
#define OMNIBOT_APP_BRAKING_H

#include "robot.h"
#include "trajectory.h"

/// Braking never takes longer, however fast the trajectory is: the force bounds then decide how the robot follows.
#define BRAKING_TIME_MAX_S 2.0f

typedef struct {
    float rate;       // σ: 1 before the braking, 0 at rest
    uint32_t rest_us; // for how long it has been 0
} braking_t;

/// As it is while nobody brakes.
void braking_reset(braking_t *braking);

/// The reference of this step, and the trajectory's time that passes in the period after it, in µs.
///
/// `reference` is yref and its derivatives by trajectory time, and becomes y and its own. `acceleration_mps2` > 0.
uint32_t braking_step(braking_t *braking, const robot_t *robot, float acceleration_mps2, reference_t *reference);

/// Whether the reference has stood long enough for the robot to have come to rest on it.
bool braking_is_over(const braking_t *braking);

#endif
