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

/// ∆⁻¹ R, or ∆⁺ R where the output has no heading, of an output acceleration seen from the body. Theory (C2), (C8).
static vec3_t body_acceleration(const robot_t *robot, tracking_output_t output, vec3_t point)
{
    if (output == OUTPUT_POSTURE) {
        return kinematics_twist_of_point(robot, point);
    }
    const float offset_m = robot->tracked_point_offset_m;
    const float share = point.x / (1.0f + offset_m * offset_m);
    return (vec3_t){share, point.y, -offset_m * share};
}

/// a = ÿref − K2 ẏ̃ − K1 ỹ, the acceleration wanted of the output. Theory (C1).
static vec3_t output_acceleration(const tracking_law_t *law, const tracking_t *tracking, vec3_t point_twist)
{
    const vec3_t error_rate = vec3_sub(point_twist, tracking->velocity);
    const vec3_t damped = vec3_sub(tracking->acceleration, vec3_multiply(law->damping_per_s, error_rate));
    return vec3_sub(damped, vec3_multiply(law->stiffness_per_s2, tracking->error));
}

vec3_t tracking_eta(const robot_t *robot, const tracking_law_t *law, const tracking_t *tracking, vec3_t twist)
{
    const vec3_t z = kinematics_point_twist(robot, twist);
    const vec3_t a = output_acceleration(law, tracking, z);
    return body_acceleration(robot, law->output, vec3_sub(a, vec3_turn(twist.z, z)));
}

vec3_t tracking_eta_rate(const robot_t *robot, const tracking_law_t *law, const tracking_t *tracking, vec3_t twist,
                         vec3_t eta)
{
    const vec3_t z = kinematics_point_twist(robot, twist);
    const vec3_t z_rate = kinematics_point_twist(robot, eta);
    const vec3_t a = output_acceleration(law, tracking, z);
    // ȧ = y⃛ref − K2 (a − ÿref) − K1 ẏ̃ (C3)
    const vec3_t damped = vec3_multiply(law->damping_per_s, vec3_sub(a, tracking->acceleration));
    const vec3_t pulled = vec3_multiply(law->stiffness_per_s2, vec3_sub(z, tracking->velocity));
    const vec3_t a_rate = vec3_sub(vec3_sub(tracking->jerk, damped), pulled);
    // ∆ η̇ = Rᵀȧ − ω×a − ω̇×z − ω×ż (C4)
    const vec3_t turned = vec3_add(vec3_turn(twist.z, vec3_add(a, z_rate)), vec3_turn(eta.z, z));
    return body_acceleration(robot, law->output, vec3_sub(a_rate, turned));
}

mat3_t tracking_gradient(const robot_t *robot, const tracking_law_t *law, vec3_t twist)
{
    const float w = twist.z, offset_m = robot->tracked_point_offset_m;
    const vec3_t k = law->damping_per_s;
    // Columns of −∂(K2 z + ω×z)/∂ν, then ∆⁻¹ of each, then ∂(ω×ν)/∂ν.
    const vec3_t by_x = body_acceleration(robot, law->output, (vec3_t){-k.x, -w, 0.0f});
    const vec3_t by_y = body_acceleration(robot, law->output, (vec3_t){w, -k.y, 0.0f});
    const vec3_t by_w =
        body_acceleration(robot, law->output, (vec3_t){k.x * offset_m + twist.y, 2.0f * offset_m * w - twist.x, -k.z});
    return (mat3_t){
        {{by_x.x, by_y.x - w, by_w.x - twist.y}, {by_x.y + w, by_y.y, by_w.y + twist.x}, {by_x.z, by_y.z, by_w.z}}};
}
