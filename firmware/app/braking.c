// SPDX-License-Identifier: MIT
#include "braking.h"

/// The closed loop's slower pole is 3.6/s with the paper's gains: what is left of an error of 1 cm is below 2 mm.
enum { REST_US = 500000 };

/// In a bend the path may leave nothing for braking; then this share of the acceleration is used all the same.
#define SHARE_MIN 0.25f

/// A trajectory that stands already is stopped within this time.
#define STANDSTILL_S 0.05f

/// Size of a velocity or acceleration where the wheels stand: what turns the body counts with their distance.
static float size_at_wheels(vec3_t a, float wheel_distance_m)
{
    const float turn = wheel_distance_m * a.z;
    return sqrtf(a.x * a.x + a.y * a.y + turn * turn);
}

/// σ̇ by the friction circle: what the path's own acceleration leaves of the allowed one is for braking.
static float braking_rate(float rate, const robot_t *robot, float acceleration_mps2, const reference_t *reference)
{
    const float speed_mps = size_at_wheels(reference->velocity, robot->wheel_distance_m);
    const float bend = rate * rate * size_at_wheels(reference->acceleration, robot->wheel_distance_m);
    const float left = acceleration_mps2 * acceleration_mps2 - bend * bend;
    const float least = SHARE_MIN * acceleration_mps2;
    const float along = left > least * least ? sqrtf(left) : least;
    const float slowest_mps = along * STANDSTILL_S;
    const float wanted = -along / (speed_mps > slowest_mps ? speed_mps : slowest_mps);
    return wanted < -1.0f / BRAKING_TIME_MAX_S ? wanted : -1.0f / BRAKING_TIME_MAX_S;
}

/// y and its derivatives by time.
static void slow_down(reference_t *reference, float rate, float rate_change)
{
    const vec3_t velocity = reference->velocity, acceleration = reference->acceleration, jerk = reference->jerk;
    reference->velocity = vec3_scale(rate, velocity);
    reference->acceleration = vec3_add_scaled(vec3_scale(rate * rate, acceleration), rate_change, velocity);
    reference->jerk = vec3_add_scaled(vec3_scale(rate * rate * rate, jerk), 3.0f * rate * rate_change, acceleration);
}

void braking_reset(braking_t *braking)
{
    *braking = (braking_t){.rate = 1.0f, .rest_us = 0};
}

uint32_t braking_step(braking_t *braking, const robot_t *robot, float acceleration_mps2, reference_t *reference)
{
    const float period_s = robot->control_period_s, rate = braking->rate;
    if (!(rate > 0.0f)) {
        braking->rest_us += robot->control_period_us;
        slow_down(reference, 0.0f, 0.0f);
        return 0;
    }
    const float wanted = braking_rate(rate, robot, acceleration_mps2, reference);
    const float change = rate + wanted * period_s > 0.0f ? wanted : -rate / period_s;
    slow_down(reference, rate, change);
    const float next = rate + wanted * period_s;
    braking->rate = next > 0.0f ? next : 0.0f;
    return (uint32_t)(0.5f * (rate + braking->rate) * (float)robot->control_period_us + 0.5f);
}

bool braking_is_over(const braking_t *braking)
{
    return braking->rest_us >= REST_US;
}
