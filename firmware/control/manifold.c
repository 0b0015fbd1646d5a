// SPDX-License-Identifier: MIT
#include "manifold.h"

vec3_t manifold_force(const robot_t *robot, vec3_t twist, vec3_t acceleration)
{
    return mat3_apply(&robot->wheel_force_of_accel, vec3_add(acceleration, vec3_turn(twist.z, twist)));
}

vec3_t manifold_acceleration(const robot_t *robot, vec3_t twist, vec3_t force_N)
{
    return vec3_sub(mat3_apply(&robot->accel_of_wheel_force, force_N), vec3_turn(twist.z, twist));
}

vec3_t manifold_force_rate(const robot_t *robot, vec3_t twist, vec3_t acceleration, vec3_t jerk)
{
    const vec3_t turning = vec3_add(vec3_turn(acceleration.z, twist), vec3_turn(twist.z, acceleration));
    return mat3_apply(&robot->wheel_force_of_accel, vec3_add(jerk, turning));
}

vec3_t manifold_of_force(const robot_t *robot, float mobility, vec3_t force_N)
{
    return vec3_scale(-mobility, mat3_apply(&robot->slip_mobility_inverse, force_N));
}
