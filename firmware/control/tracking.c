// SPDX-License-Identifier: MIT
#include "tracking.h"

#include "kinematics.h"

tracking_t tracking_from(const robot_t *robot, const tracking_law_t *law, vec3_t pose, const reference_t *reference)
{
    const vec3_t K1 = law->stiffness_per_s2, K2 = law->damping_per_s;
    const rotation_t heading = rotation_of(pose.z);
    vec3_t error = vec3_sub(kinematics_output(robot, pose, heading), reference->position);
    error.z = angle_wrap(error.z);
    const vec3_t driven = vec3_add(reference->acceleration, vec3_gained(K2, reference->velocity));
    const vec3_t driven_rate = vec3_add(reference->jerk, vec3_gained(K2, reference->acceleration));
    return (tracking_t){
        .heading = heading,
        .error = error,
        .standing = rotation_to_body(heading, vec3_sub(driven, vec3_gained(K1, error))),
        .standing_rate = rotation_to_body(heading, vec3_add(driven_rate, vec3_gained(K1, reference->velocity))),
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
    return vec3_sub(tracking->standing, vec3_gained(law->damping_per_s, point_twist));
}

vec3_t tracking_eta(const robot_t *robot, const tracking_law_t *law, const tracking_t *tracking, vec3_t twist)
{
    const vec3_t z = kinematics_point_twist(robot, twist);
    const vec3_t a = output_acceleration(law, tracking, z);
    return body_acceleration(robot, law->output, vec3_add_turn(a, -twist.z, z));
}

vec3_t tracking_eta_rate(const robot_t *robot, const tracking_law_t *law, const tracking_t *tracking, vec3_t twist,
                         vec3_t eta)
{
    const vec3_t z = kinematics_point_twist(robot, twist);
    const vec3_t z_rate = kinematics_point_twist(robot, eta);
    const vec3_t a = output_acceleration(law, tracking, z);
    // ȧ = y⃛ref − K2 (a − ÿref) − K1 ẏ̃ (C3)
    const vec3_t damped = vec3_sub(tracking->standing_rate, vec3_gained(law->damping_per_s, a));
    const vec3_t a_rate = vec3_sub(damped, vec3_gained(law->stiffness_per_s2, z));
    // ∆ η̇ = Rᵀȧ − ω×a − ω̇×z − ω×ż (C4)
    const vec3_t turned = vec3_add_turn(vec3_add_turn(a_rate, -twist.z, vec3_add(a, z_rate)), -eta.z, z);
    return body_acceleration(robot, law->output, turned);
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
