// SPDX-License-Identifier: MIT
// Single-precision sine and cosine of our own: the libraries of host and target differ in the last bit, these do not.
#ifndef OMNIBOT_CONTROL_TRIGONOMETRY_H
#define OMNIBOT_CONTROL_TRIGONOMETRY_H

#include "vec3.h"

/// A planar rotation R(angle) = [cosine, −sine; sine, cosine].
typedef struct {
    float cosine, sine;
} rotation_t;

/// Rotation by an angle in rad, |angle| ≤ 100; error of each entry below 1.2e-7. No loops.
rotation_t rotation_of(float angle_rad);

/// The angle minus the nearest whole number of turns: −π … π.
float angle_wrap(float angle_rad);

/// The rotation by a small angle more; error of each entry below angle³/6, 2e-8 for 0.005 rad.
static inline rotation_t rotation_turned(rotation_t r, float angle_rad)
{
    const float cosine = 1.0f - 0.5f * angle_rad * angle_rad;
    return (rotation_t){r.cosine * cosine - r.sine * angle_rad, r.sine * cosine + r.cosine * angle_rad};
}

/// R(angle)ᵀ ⊕ 1: world to body; the third entry is left as it is.
static inline vec3_t rotation_to_body(rotation_t r, vec3_t world)
{
    return (vec3_t){r.cosine * world.x + r.sine * world.y, r.cosine * world.y - r.sine * world.x, world.z};
}

/// R(angle) ⊕ 1: body to world.
static inline vec3_t rotation_to_world(rotation_t r, vec3_t body)
{
    return (vec3_t){r.cosine * body.x - r.sine * body.y, r.sine * body.x + r.cosine * body.y, body.z};
}

#endif
