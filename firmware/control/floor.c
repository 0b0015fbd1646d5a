// SPDX-License-Identifier: MIT
#include "floor.h"

/// g(u) between the table's points, by straight lines.
static float curve_at(const floor_curve_t *curve, float force_share)
{
    const float share = force_share < curve->force_share_max ? force_share : curve->force_share_max;
    const float place = share * ((float)FLOOR_CURVE_INTERVALS / curve->force_share_max);
    const int whole = (int)place;
    const int index = whole < FLOOR_CURVE_INTERVALS ? whole : FLOOR_CURVE_INTERVALS - 1;
    const float low = curve->slip[index];
    return low + (place - (float)index) * (curve->slip[index + 1] - low);
}

float floor_slip_ratio(const floor_t *floor, float force_N)
{
    if (floor->linear) {
        return floor->compliance_per_N * force_N;
    }
    const float magnitude = curve_at(floor->curve, fabsf(force_N) / floor->friction_limit_N);
    return copysignf(floor->compliance_per_N * floor->friction_limit_N * magnitude, force_N);
}

vec3_t floor_slip_ratios(const floor_t *floor, vec3_t force_N)
{
    return (vec3_t){floor_slip_ratio(floor, force_N.x), floor_slip_ratio(floor, force_N.y),
                    floor_slip_ratio(floor, force_N.z)};
}
