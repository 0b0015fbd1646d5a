// SPDX-License-Identifier: MIT
#include "manifold.h"

vec3_t manifold_force(const robot_t *robot, vec3_t specific_force)
{
    return wheels_of_body(&robot->wheel_force_of_specific, specific_force);
}

vec3_t manifold_specific_force_rate(vec3_t twist, vec3_t acceleration, vec3_t jerk)
{
    return vec3_add_turn(vec3_add_turn(jerk, acceleration.z, twist), twist.z, acceleration);
}

vec3_t manifold_of_force(const robot_t *robot, float mobility, vec3_t force_N)
{
    return wheels_of_wheels(&robot->slip_mobility_inverse, -mobility, force_N);
}
