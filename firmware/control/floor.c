// SPDX-License-Identifier: MIT
#include "floor.h"

void floor_prepare(floor_t *floor)
{
    floor->intervals_per_N = 0.0f;
    if (!floor->linear) {
        const float end_N = floor->curve->force_share_max * floor->friction_limit_N;
        floor->intervals_per_N = (float)FLOOR_CURVE_INTERVALS / end_N;
    }
}

/// The curve at a place counted in intervals, by straight lines; its end's value beyond it.
static float softening_at(const floor_curve_t *curve, float place)
{
    const float last = (float)FLOOR_CURVE_INTERVALS * (1.0f - 1.0e-6f); // still in the last interval
    const float inside = place < last ? place : last;
    const int32_t index = (int32_t)inside;
    const float low = curve->softening[index];
    return low + (inside - (float)index) * (curve->softening[index + 1] - low);
}

static float magic_slip_ratio(const floor_t *floor, float force_N)
{
    const float softening = softening_at(floor->curve, fabsf(force_N) * floor->intervals_per_N);
    return softening * (floor->compliance_per_N * force_N);
}

float floor_slip_ratio(const floor_t *floor, float force_N)
{
    return floor->linear ? floor->compliance_per_N * force_N : magic_slip_ratio(floor, force_N);
}

vec3_t floor_slip_ratios(const floor_t *floor, vec3_t force_N)
{
    if (floor->linear) {
        return vec3_scale(floor->compliance_per_N, force_N);
    }
    return (vec3_t){magic_slip_ratio(floor, force_N.x), magic_slip_ratio(floor, force_N.y),
                    magic_slip_ratio(floor, force_N.z)};
}
