// SPDX-License-Identifier: MIT
// Reduction by quarter turns (Cody and Waite), then minimax polynomials on ±π/4.
#include "trigonometry.h"

#include <stdint.h>
#include <string.h>

// π/2 = QUARTER_HIGH + QUARTER_MIDDLE + QUARTER_LOW; the first two have few enough digits that a whole number of
// quarter turns below 2^7 times them is exact.
#define QUARTER_HIGH 1.5703125f
#define QUARTER_MIDDLE 4.837512969970703125e-4f
#define QUARTER_LOW 7.54978995489188216e-8f
#define QUARTERS_PER_RAD 0.636619772f

#define TURN_HIGH 6.28125f
#define TURN_LOW 1.93530717958647693e-3f
#define TURNS_PER_RAD 0.159154943f

// 1.5 · 2^23: a float of this size has no digits behind the point, so that adding it rounds to the nearest whole
// number, which then stands in the float's low bits, negative ones in two's complement.
#define ROUNDING 12582912.0f

static uint32_t bits_of(float value)
{
    uint32_t bits;
    (void)memcpy(&bits, &value, sizeof bits);
    return bits;
}

rotation_t rotation_of(float angle_rad)
{
    const float rounded = angle_rad * QUARTERS_PER_RAD + ROUNDING;
    const uint32_t quarters = bits_of(rounded);
    const float n = rounded - ROUNDING;
    const float x = ((angle_rad - n * QUARTER_HIGH) - n * QUARTER_MIDDLE) - n * QUARTER_LOW;
    const float x2 = x * x;
    const float sine = x + x * x2 * (-1.6666654611e-1f + x2 * (8.3321608736e-3f + x2 * -1.9515295891e-4f));
    const float cosine = 1.0f - 0.5f * x2 +
                         x2 * x2 * (4.166664568298827e-2f + x2 * (-1.388731625493765e-3f + x2 * 2.443315711809948e-5f));
    const float s = (quarters & 1u) != 0 ? cosine : sine;
    const float c = (quarters & 1u) != 0 ? sine : cosine;
    return (rotation_t){
        .cosine = ((quarters + 1u) & 2u) != 0 ? -c : c,
        .sine = (quarters & 2u) != 0 ? -s : s,
    };
}

float angle_wrap(float angle_rad)
{
    const float n = (angle_rad * TURNS_PER_RAD + ROUNDING) - ROUNDING;
    return (angle_rad - n * TURN_HIGH) - n * TURN_LOW;
}
