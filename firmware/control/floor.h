// SPDX-License-Identifier: MIT
// What the floor makes of a wheel: the inverse of the traction curve (4), (7), slip ratio from force.
#ifndef OMNIBOT_CONTROL_FLOOR_H
#define OMNIBOT_CONTROL_FLOOR_H

#include "vec3.h"

#include <stdbool.h>
#include <stdint.h>

enum { FLOOR_CURVE_INTERVALS = 64 };

/// The rising branch of the magic formula (4), turned round: by how much the slip ratio s is more than the linear
/// floor's ε λ / G0, at u = λ / Dp in equal steps from 0 to `force_share_max`. 1 at 0; the same for every ε and Dp.
typedef struct {
    float force_share_max;
    float softening[FLOOR_CURVE_INTERVALS + 1];
} floor_curve_t;

typedef struct {
    const floor_curve_t *curve; // of the magic formula; not looked at where the floor is linear
    bool linear;                // (7): s = ε λ / G0
    float compliance_per_N;     // ε / G0
    float friction_limit_N;     // Dp, one wheel
    float intervals_per_N;      // of the curve; by floor_prepare
} floor_t;

/// Fills in what follows from the other fields; to be called whenever one of them has changed.
void floor_prepare(floor_t *floor);

/// Slip ratio that makes a wheel pull with a force; beyond the curve's end it grows with the force as at its end. One
/// look-up, no loop.
float floor_slip_ratio(const floor_t *floor, float force_N);

/// The same for three wheels.
vec3_t floor_slip_ratios(const floor_t *floor, vec3_t force_N);

#endif
