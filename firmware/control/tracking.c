// SPDX-License-Identifier: MIT
#include "tracking.h"

#include "kinematics.h"

tracking_t tracking_from(const robot_t *robot, vec3_t pose, const reference_t *reference)
{
    const rotation_t heading = rotation_of(pose.z);
    vec3_t error = vec3_sub(kinematics_output(robot, pose, heading), reference->position);
    error.z = angle_wrap(error.z);
    return (tracking_t){
        .error = rotation_to_body(heading, error),
        .velocity = rotation_to_body(heading, reference->velocity),
        .acceleration = rotation_to_body(heading, reference->acceleration),
        .jerk = rotation_to_body(heading, reference->jerk),
    };
}

/// a = ÿref − K2 ẏ̃ − K1 ỹ, the acceleration wanted of the output. Theory (C1).
static vec3_t output_acceleration(const tracking_gains_t *gains, const tracking_t *tracking, vec3_t point_twist)
{
    const vec3_t error_rate = vec3_sub(point_twist, tracking->velocity);
    const vec3_t damped = vec3_sub(tracking->acceleration, vec3_multiply(gains->damping_per_s, error_rate));
    return vec3_sub(damped, vec3_multiply(gains->stiffness_per_s2, tracking->error));
}

vec3_t tracking_eta(const robot_t *robot, const tracking_gains_t *gains, const tracking_t *tracking, vec3_t twist)
{
    const vec3_t z = kinematics_point_twist(robot, twist);
    const vec3_t a = output_acceleration(gains, tracking, z);
    return kinematics_twist_of_point(robot, vec3_sub(a, vec3_turn(twist.z, z)));
}

vec3_t tracking_eta_rate(const robot_t *robot, const tracking_gains_t *gains, const tracking_t *tracking, vec3_t twist,
                         vec3_t eta)
{
    const vec3_t z = kinematics_point_twist(robot, twist);
    const vec3_t z_rate = kinematics_point_twist(robot, eta);
    const vec3_t a = output_acceleration(gains, tracking, z);
    // ȧ = y⃛ref − K2 (a − ÿref) − K1 ẏ̃ (C3)
    const vec3_t a_rate =
        vec3_sub(vec3_sub(tracking->jerk, vec3_multiply(gains->damping_per_s, vec3_sub(a, tracking->acceleration))),
                 vec3_multiply(gains->stiffness_per_s2, vec3_sub(z, tracking->velocity)));
    // T η̇ = Rᵀȧ − ω×a − ω̇×z − ω×ż (C4)
    const vec3_t turned = vec3_add(vec3_turn(twist.z, vec3_add(a, z_rate)), vec3_turn(eta.z, z));
    return kinematics_twist_of_point(robot, vec3_sub(a_rate, turned));
}
