// SPDX-License-Identifier: MIT
// One control step of the paper: wheel speeds and pose in, motor torques out.
//
//   odometry → slip from the manifold → body velocity → η (33) → manifold of order N (27)–(29) → bounds → torque (22)
//
// Pure: no clock, no bus, no state. Frames: pose and reference in the world, twists in the body, forces and torques a
// wheel.
#ifndef OMNIBOT_CONTROL_CONTROL_H
#define OMNIBOT_CONTROL_CONTROL_H

#include "robot.h"
#include "tracking.h"
#include "trajectory.h"

enum { CONTROL_ORDER_MAX = 1 };

typedef struct {
    const robot_t *robot;
    int32_t order;          // N of (22), 0 … CONTROL_ORDER_MAX
    float epsilon_per_N;    // ε
    float delta_mps;        // δ
    float speed_length_m;   // ℓ of (14)
    tracking_gains_t gains; // K1, K2
    float force_bound_N;    // no wheel is asked for more
    float torque_bound_Nm;  // no motor is asked for more
} control_params_t;

typedef struct {
    vec3_t pose;                  // x1, x2 (m), θ (rad, |θ| ≤ 100)
    vec3_t wheel_speed_rad_per_s; // φ̇
    reference_t reference;        // yref and its derivatives
} control_input_t;

typedef struct {
    vec3_t torque_Nm;
    vec3_t mu_mps;        // µ of (2): Hε of order N
    vec3_t wheel_force_N; // λ asked of the floor, after the bound
    vec3_t twist;         // ν, corrected by the manifold
    vec3_t eta;           // η of (33)
    vec3_t error;         // Rᵀ(y − yref) in the body frame
    bool force_bounded;
    bool torque_bounded;
} control_output_t;

/// One step. Returns false, with an output of zeros, when an input or a result is not finite. The bounds scale all
/// three wheels alike: the direction of the force on the body is kept, its size is not.
bool control_step(const control_params_t *params, const control_input_t *input, control_output_t *output);

#endif
