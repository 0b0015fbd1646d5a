// SPDX-License-Identifier: MIT
#include "manifold.h"

vec3_t manifold_of_force(const robot_t *robot, float mobility, vec3_t force_N)
{
    return vec3_scale(-mobility, mat3_apply(&robot->slip_mobility_inverse, force_N));
}

vec3_t manifold_force0(const robot_t *robot, vec3_t v, vec3_t eta)
{
    return mat3_apply(&robot->wheel_force_of_accel, vec3_add(eta, vec3_turn(v.z, v)));
}

vec3_t manifold_rate0(const robot_t *robot, mobility_t mobility, vec3_t v, vec3_t eta, vec3_t eta_rate)
{
    const vec3_t force = manifold_force0(robot, v, eta);
    const vec3_t turning = vec3_add(vec3_turn(eta.z, v), vec3_turn(v.z, eta));
    const vec3_t force_rate = mat3_apply(&robot->wheel_force_of_accel, vec3_add(eta_rate, turning));
    return vec3_add(manifold_of_force(robot, mobility.value, force_rate),
                    manifold_of_force(robot, mobility.rate, force));
}

vec3_t manifold_force1(const robot_t *robot, vec3_t v, vec3_t H0, vec3_t H0_rate)
{
    const vec3_t slip_twist = mat3_apply(&robot->body_force_of_wheels, H0);
    const vec3_t slip_accel = mat3_apply(&robot->body_force_of_wheels, H0_rate);
    const vec3_t turning = vec3_add(vec3_turn(robot->wheel_distance_m * vec3_sum(H0), v), vec3_turn(v.z, slip_twist));
    return mat3_apply(&robot->wheel_force_of_accel, vec3_add(turning, slip_accel));
}
