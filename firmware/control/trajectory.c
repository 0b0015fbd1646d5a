// SPDX-License-Identifier: MIT
#include "trajectory.h"

/// Value and scaled derivatives p(s), p'(s), p''(s)/2, p'''(s)/6 of one axis: Horner's rule and its derivatives.
typedef struct {
    float d0, d1, d2, d3;
} taylor_t;

static taylor_t taylor_at(const float *coefficient, float s)
{
    taylor_t t = {coefficient[TRAJECTORY_COEFFICIENTS - 1], 0.0f, 0.0f, 0.0f};
    for (int k = TRAJECTORY_COEFFICIENTS - 2; k >= 0; k--) {
        t.d3 = t.d3 * s + t.d2;
        t.d2 = t.d2 * s + t.d1;
        t.d1 = t.d1 * s + t.d0;
        t.d0 = t.d0 * s + coefficient[k];
    }
    return t;
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

bool trajectory_segment_is_valid(const trajectory_segment_t *segment)
{
    bool valid = segment->duration_us > 0;
    for (int axis = 0; axis < TRAJECTORY_AXES; axis++) {
        valid = valid && coefficients_are_valid(segment->coefficient[axis]);
    }
    return valid;
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

static reference_t reference_in(const trajectory_segment_t *segment, uint32_t time_us)
{
    const float duration_s = (float)segment->duration_us * 1.0e-6f;
    const float rate = 1.0f / duration_s;
    const float s = (float)time_us / (float)segment->duration_us;
    const taylor_t x = taylor_at(segment->coefficient[0], s);
    const taylor_t y = taylor_at(segment->coefficient[1], s);
    const taylor_t z = taylor_at(segment->coefficient[2], s);
    return (reference_t){
        .position = {x.d0, y.d0, z.d0},
        .velocity = vec3_scale(rate, (vec3_t){x.d1, y.d1, z.d1}),
        .acceleration = vec3_scale(2.0f * rate * rate, (vec3_t){x.d2, y.d2, z.d2}),
        .jerk = vec3_scale(6.0f * rate * rate * rate, (vec3_t){x.d3, y.d3, z.d3}),
    };
}

reference_t trajectory_reference(const trajectory_segment_t *segments, uint16_t count,
                                 const trajectory_cursor_t *cursor)
{
    const trajectory_segment_t *segment = &segments[cursor->segment];
    const reference_t reference = reference_in(segment, cursor->time_us);
    const bool at_end = cursor->segment + 1 == count && cursor->time_us == segment->duration_us;
    if (at_end) {
        return (reference_t){.position = reference.position};
    }
    return reference;
}
