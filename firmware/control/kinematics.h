// SPDX-License-Identifier: MIT
// Kinematics (1), (2), (12), (14) of the paper; a twist is [νx, νy, ω] in the body frame (m/s, m/s, rad/s).
#ifndef OMNIBOT_CONTROL_KINEMATICS_H
#define OMNIBOT_CONTROL_KINEMATICS_H

#include "robot.h"
#include "trigonometry.h"

/// Twist that the encoders tell: v_odo = J⁻¹ φ̇, with wheel speeds in rad/s. Theory (K3).
vec3_t kinematics_odometry(const robot_t *robot, vec3_t wheel_speed_rad_per_s);

/// Output y = (p1, p2, θ) of a pose (x1, x2, θ): p = x + L (−sin θ, cos θ). Paper (12).
vec3_t kinematics_output(const robot_t *robot, vec3_t pose, rotation_t heading);

/// Velocity of p in the body frame: T ν with T = [1 0 −L; 0 1 0; 0 0 1]. Theory (K4).
vec3_t kinematics_point_twist(const robot_t *robot, vec3_t twist);

/// T⁻¹ of the same.
vec3_t kinematics_twist_of_point(const robot_t *robot, vec3_t point_twist);

/// A pose that many small steps are added to: what rounding took from the sum is kept and added with the next step. A
/// single float would lose up to 0.1 µm a tick at 2 m, always the same way at a steady speed: millimetres a minute.
typedef struct {
    vec3_t value; // x1, x2 (m), θ (rad)
    vec3_t rest;
} pose_sum_t;

/// Adds the way of a time at a twist, in which the robot turns by a small angle; `heading` is the pose's. The position
/// moves along the heading halfway, the heading is wrapped. Theory (K5).
pose_sum_t kinematics_moved_pose(pose_sum_t pose, rotation_t heading, vec3_t twist, float time_s);

/// Speed V = (νx² + νy² + (ℓ ω)²)^½ in m/s. Paper (14).
float kinematics_speed(vec3_t twist, float speed_length_m);

/// The product whose square root of a twist with itself is V: a·b = ax bx + ay by + ℓ² az bz.
float kinematics_speed_product(vec3_t a, vec3_t b, float speed_length_m);

/// V̇ for a twist of speed V that changes at the given rate; 0 at rest, where V has no derivative.
float kinematics_speed_rate(vec3_t twist, float speed_mps, vec3_t acceleration, float speed_length_m);

#endif
