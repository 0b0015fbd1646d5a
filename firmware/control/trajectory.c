// SPDX-License-Identifier: MIT
#include "trajectory.h"

/// Value and scaled derivatives p(s), p'(s), p''(s)/2, p'''(s)/6 of one axis: Horner's rule and its derivatives.
typedef struct {
    float d0, d1, d2, d3;
} taylor_t;

static inline taylor_t horner(taylor_t t, float s, float coefficient)
{
    return (taylor_t){t.d0 * s + coefficient, t.d1 * s + t.d0, t.d2 * s + t.d1, t.d3 * s + t.d2};
}

/// Written out, so that nothing is multiplied that is still zero.
static inline taylor_t taylor_at(const float *c, float s)
{
    const float linear = c[7] * s + c[6];
    const float slope = c[7] * s + linear;
    const float square = linear * s + c[5];
    taylor_t t = {square * s + c[4], slope * s + square, c[7] * s + slope, c[7]};
    t = horner(t, s, c[3]);
    t = horner(t, s, c[2]);
    t = horner(t, s, c[1]);
    return horner(t, s, c[0]);
}

static bool coefficients_are_valid(const float *coefficient)
{
    bool valid = true;
    for (int k = 0; k < TRAJECTORY_COEFFICIENTS; k++) {
        // Written so that NaN fails.
        valid = valid && fabsf(coefficient[k]) <= TRAJECTORY_COEFFICIENT_MAX;
    }
    return valid;
}

bool trajectory_coefficients_are_valid(const trajectory_segment_t *segments, uint16_t count)
{
    bool valid = true;
    for (uint16_t i = 0; i < count; i++) {
        for (int axis = 0; axis < TRAJECTORY_AXES; axis++) {
            valid = valid && coefficients_are_valid(segments[i].coefficient[axis]);
        }
    }
    return valid;
}

bool trajectory_durations_are_valid(const trajectory_segment_t *segments, uint16_t count)
{
    bool valid = true;
    uint64_t sum_us = 0;
    for (uint16_t i = 0; i < count; i++) {
        const uint32_t duration_us = segments[i].duration_us;
        valid = valid && duration_us > 0 && duration_us <= TRAJECTORY_SEGMENT_DURATION_MAX_US;
        sum_us += duration_us;
    }
    return valid && sum_us <= TRAJECTORY_DURATION_MAX_US;
}

/// Value at the end of a segment, s = 1, added up in the order in which the reference is.
static float end_of(const float *coefficient)
{
    float sum = coefficient[TRAJECTORY_COEFFICIENTS - 1];
    for (int k = TRAJECTORY_COEFFICIENTS - 2; k >= 0; k--) {
        sum += coefficient[k];
    }
    return sum;
}

static bool follows(const trajectory_segment_t *next, const trajectory_segment_t *segment)
{
    static const float jump_max[TRAJECTORY_AXES] = {TRAJECTORY_JUMP_MAX_M, TRAJECTORY_JUMP_MAX_M,
                                                    TRAJECTORY_JUMP_MAX_RAD};
    bool near = true;
    for (int axis = 0; axis < TRAJECTORY_AXES; axis++) {
        near = near && fabsf(next->coefficient[axis][0] - end_of(segment->coefficient[axis])) <= jump_max[axis];
    }
    return near;
}

bool trajectory_is_continuous(const trajectory_segment_t *segments, uint16_t count)
{
    bool continuous = true;
    for (uint16_t i = 1; i < count; i++) {
        continuous = continuous && follows(&segments[i], &segments[i - 1]);
    }
    return continuous;
}

void trajectory_advance(const trajectory_segment_t *segments, uint16_t count, trajectory_cursor_t *cursor,
                        uint32_t step_us)
{
    uint32_t left_us = step_us;
    while (left_us >= segments[cursor->segment].duration_us - cursor->time_us && cursor->segment + 1 < count) {
        left_us -= segments[cursor->segment].duration_us - cursor->time_us;
        cursor->segment++;
        cursor->time_us = 0;
    }
    const uint32_t rest_us = segments[cursor->segment].duration_us - cursor->time_us;
    cursor->time_us += left_us < rest_us ? left_us : rest_us;
}

reference_t trajectory_reference(const trajectory_segment_t *segments, uint16_t count,
                                 const trajectory_cursor_t *cursor)
{
    const trajectory_segment_t *segment = &segments[cursor->segment];
    const bool at_end = cursor->segment + 1 == count && cursor->time_us == segment->duration_us;
    const float inverse_per_us = 1.0f / (float)segment->duration_us;
    const float s = (float)cursor->time_us * inverse_per_us;
    const float rate = at_end ? 0.0f : 1.0e6f * inverse_per_us, rate2 = rate * rate;
    const taylor_t x = taylor_at(segment->coefficient[0], s);
    const taylor_t y = taylor_at(segment->coefficient[1], s);
    const taylor_t z = taylor_at(segment->coefficient[2], s);
    return (reference_t){
        .position = {x.d0, y.d0, z.d0},
        .velocity = vec3_scale(rate, (vec3_t){x.d1, y.d1, z.d1}),
        .acceleration = vec3_scale(rate2 + rate2, (vec3_t){x.d2, y.d2, z.d2}),
        .jerk = vec3_scale(6.0f * rate * rate2, (vec3_t){x.d3, y.d3, z.d3}),
    };
}
