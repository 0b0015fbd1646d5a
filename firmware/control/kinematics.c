// SPDX-License-Identifier: MIT
#include "kinematics.h"

vec3_t kinematics_odometry(const robot_t *robot, vec3_t wheel_speed_rad_per_s)
{
    return body_of_wheels(&robot->twist_of_wheel_rate, wheel_speed_rad_per_s);
}

vec3_t kinematics_output(const robot_t *robot, vec3_t pose, rotation_t heading)
{
    const float offset_m = robot->tracked_point_offset_m;
    return (vec3_t){pose.x - offset_m * heading.sine, pose.y + offset_m * heading.cosine, pose.z};
}

vec3_t kinematics_point_twist(const robot_t *robot, vec3_t twist)
{
    return (vec3_t){twist.x - robot->tracked_point_offset_m * twist.z, twist.y, twist.z};
}

vec3_t kinematics_twist_of_point(const robot_t *robot, vec3_t point_twist)
{
    return (vec3_t){point_twist.x + robot->tracked_point_offset_m * point_twist.z, point_twist.y, point_twist.z};
}

pose_sum_t kinematics_moved_pose(pose_sum_t pose, rotation_t heading, vec3_t twist, float time_s)
{
    const vec3_t way = vec3_scale(time_s, twist);
    const rotation_t halfway = rotation_turned(heading, 0.5f * way.z);
    const vec3_t step = vec3_add(rotation_to_world(halfway, way), pose.rest);
    const vec3_t sum = vec3_add(pose.value, step);
    const vec3_t rest = vec3_sub(step, vec3_sub(sum, pose.value));
    return (pose_sum_t){.value = {sum.x, sum.y, angle_wrap(sum.z)}, .rest = rest};
}

float kinematics_speed_product(vec3_t a, vec3_t b, float speed_length_m)
{
    return a.x * b.x + a.y * b.y + speed_length_m * speed_length_m * (a.z * b.z);
}

float kinematics_speed(vec3_t twist, float speed_length_m)
{
    return sqrtf(kinematics_speed_product(twist, twist, speed_length_m));
}

float kinematics_speed_rate(vec3_t twist, float speed_mps, vec3_t acceleration, float speed_length_m)
{
    const float product = kinematics_speed_product(twist, acceleration, speed_length_m);
    return speed_mps > 0.0f ? product / speed_mps : 0.0f;
}
