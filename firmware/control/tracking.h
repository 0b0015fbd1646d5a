// SPDX-License-Identifier: MIT
// The auxiliary control law (33): the acceleration that makes the tracking error obey ÿ̃ + K2 ẏ̃ + K1 ỹ = 0. All in the
// body frame, where ∆ is constant (theory, 'The control law').
#ifndef OMNIBOT_CONTROL_TRACKING_H
#define OMNIBOT_CONTROL_TRACKING_H

#include "robot.h"
#include "trajectory.h"
#include "trigonometry.h"

/// What is to follow the reference.
typedef enum {
    OUTPUT_POSTURE, // y = (p1, p2, θ): ∆ is 3×3
    OUTPUT_POINT,   // y = (p1, p2), the paper's: ∆ is 2×3, η from ∆⁺; nothing holds the heading
} tracking_output_t;

/// The output and the diagonals of K1 and K2. The two planar entries must be equal: only then do the gains look the
/// same from the body.
typedef struct {
    tracking_output_t output;
    vec3_t stiffness_per_s2; // K1
    vec3_t damping_per_s;    // K2
} tracking_law_t;

/// What (33) needs beside the twist, seen from the body but for the error. Rotated as sums: K1 and K2 look the same
/// from the body.
typedef struct {
    rotation_t heading;
    vec3_t error;         // y − yref in the world, heading wrapped to ±π
    vec3_t standing;      // Rᵀ(ÿref + K2 ẏref − K1 ỹ): what the law wants of an output that stands still
    vec3_t standing_rate; // Rᵀ(y⃛ref + K2 ÿref + K1 ẏref): likewise of ȧ
} tracking_t;

tracking_t tracking_from(const robot_t *robot, const tracking_law_t *law, vec3_t pose, const reference_t *reference);

/// η of (33): the body acceleration ν̇ that the law asks for at a twist ν. Theory (C2).
vec3_t tracking_eta(const robot_t *robot, const tracking_law_t *law, const tracking_t *tracking, vec3_t twist);

/// η̇ along the closed loop, where ν̇ = η. Theory (C4).
vec3_t tracking_eta_rate(const robot_t *robot, const tracking_law_t *law, const tracking_t *tracking, vec3_t twist,
                         vec3_t eta);

/// ∂(η + ω×ν)/∂ν at a twist: how the specific force asked for changes with the twist believed. Theory (C7).
mat3_t tracking_gradient(const robot_t *robot, const tracking_law_t *law, vec3_t twist);

#endif
