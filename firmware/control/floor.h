// SPDX-License-Identifier: MIT
// What the floor makes of a wheel: the inverse of the traction curve (4), (7), slip ratio from force.
#ifndef OMNIBOT_CONTROL_FLOOR_H
#define OMNIBOT_CONTROL_FLOOR_H

#include "vec3.h"

#include <stdbool.h>

enum { FLOOR_CURVE_INTERVALS = 64 };

/// The rising branch of the magic formula (4), turned round: g(u) = s / (ε Dp / G0) at u = λ / Dp in equal steps from 0
/// to `force_share_max`. Slope 1 at 0; the same for every ε and Dp.
typedef struct {
    float force_share_max;
    float slip[FLOOR_CURVE_INTERVALS + 1];
} floor_curve_t;

typedef struct {
    const floor_curve_t *curve; // of the magic formula; not used where the floor is linear
    bool linear;                // (7): s = ε λ / G0
    float compliance_per_N;     // ε / G0
    float friction_limit_N;     // Dp, one wheel
} floor_t;

/// Slip ratio that makes a wheel pull with a force; beyond the curve's end that of its end. One look-up, no loop.
float floor_slip_ratio(const floor_t *floor, float force_N);

/// The same for three wheels.
vec3_t floor_slip_ratios(const floor_t *floor, vec3_t force_N);

#endif
