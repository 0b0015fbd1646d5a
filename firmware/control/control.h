// SPDX-License-Identifier: MIT
// One control step of the paper: wheel speeds and pose in, motor torques out.
//
//   odometry → slip from the manifold or the observer → body velocity → η (33) → wheel forces (28) → bounds → torque
//   (32)
//
// Pure: no clock, no bus; what is remembered is in control_state_t. Frames: pose and reference in the world, twists in
// the body, forces and torques a wheel.
#ifndef OMNIBOT_CONTROL_CONTROL_H
#define OMNIBOT_CONTROL_CONTROL_H

#include "floor.h"
#include "kinematics.h"
#include "robot.h"
#include "tracking.h"
#include "trajectory.h"

/// How the slip is predicted: order N of the expansion (22), its limit, or the observer.
enum {
    CONTROL_ORDER_MAX = 3,
    CONTROL_EXACT = 4,    // N → ∞: a linear solve
    CONTROL_OBSERVER = 5, // from the forces of the past, on the traction curve itself
};

typedef struct {
    const robot_t *robot;
    int32_t order;                  // 0 … CONTROL_ORDER_MAX, CONTROL_EXACT or CONTROL_OBSERVER
    floor_t floor;                  // ε and the traction curve
    float delta_mps;                // δ
    float speed_length_m;           // ℓ of (14)
    tracking_law_t law;             // output, K1, K2
    float series_ratio_max;         // ρ is held below it: past one half the sampled series is unstable
    float observer_lag_s;           // Tf, on top of the boundary layer's own
    float force_bound_N;            // no wheel is asked for more
    float torque_bound_Nm;          // no motor is asked for more
    float compliance_max_mps_per_N; // where ρ reaches series_ratio_max (C9); by control_prepare
    float layer_s_per_mps;          // time constant of the boundary layer (18) over V + δ; by control_prepare
} control_params_t;

/// Fills in what follows from the other fields, the floor's too; to be called whenever one of them has changed.
void control_prepare(control_params_t *params);

typedef struct {
    vec3_t force_estimate_N; // λ̂, the observer's
    pose_sum_t pose;         // dead-reckoned to the next tick
    vec3_t twist;            // ν expected then
    vec3_t wheel_force_N;    // λ asked for last
    vec3_t specific_force;   // ν̇ + ω×ν that goes with it
} control_state_t;

typedef struct {
    bool pose_is_new;             // else the state's pose is taken
    vec3_t pose;                  // x1, x2 (m), θ (rad, |θ| ≤ 100)
    vec3_t wheel_speed_rad_per_s; // φ̇
    reference_t reference;        // yref and its derivatives
} control_input_t;

typedef struct {
    vec3_t torque_Nm;
    vec3_t mu_mps;         // µ of (2): Hε
    vec3_t wheel_force_N;  // λ asked of the floor, after the bounds
    vec3_t specific_force; // ν̇ + ω×ν that goes with it
    vec3_t twist;          // ν, corrected for slip
    vec3_t eta;            // η of (33)
    vec3_t error;          // y − yref in the world
    bool force_bounded;
    bool torque_bounded;
} control_output_t;

/// Moves the state on by a period in which no step was asked for and the last torque was held.
void control_coast(const control_params_t *params, control_state_t *state);

/// One step. Returns false, with an output of zeros and the state as it was, when a result, or an input that it follows
/// from, is not finite. The bounds scale all three wheels alike: the direction of the force on the body is kept, its
/// size is not.
bool control_step(const control_params_t *params, control_state_t *state, const control_input_t *input,
                  control_output_t *output);

#endif
