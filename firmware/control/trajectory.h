// SPDX-License-Identifier: MIT
// Piecewise polynomials of degree 7 for the output y = (p1, p2, θ), and their time derivatives.
#ifndef OMNIBOT_CONTROL_TRAJECTORY_H
#define OMNIBOT_CONTROL_TRAJECTORY_H

#include "vec3.h"

#include <stdbool.h>
#include <stdint.h>

enum { TRAJECTORY_AXES = 3, TRAJECTORY_COEFFICIENTS = 8 };

/// No coefficient may be larger: metres or radians far outside what the wire can say.
#define TRAJECTORY_COEFFICIENT_MAX 1.0e4f

/// A segment may last no longer: rounding of its time to single precision is then below 0.1 ms, a tenth of a tick.
#define TRAJECTORY_SEGMENT_DURATION_MAX_US 600000000u

/// Nor may they all together: an hour in µs fits 32 bits.
#define TRAJECTORY_DURATION_MAX_US 3600000000u

/// Between two segments the output may jump no further: rounding of coefficients is well below, what a robot could
/// be asked to leap over well above. Velocity may jump, as at a sharp corner.
#define TRAJECTORY_JUMP_MAX_M 1.0e-3f
#define TRAJECTORY_JUMP_MAX_RAD 1.0e-3f

/// y_axis = Σ c_k s^k with s = t / duration in 0 … 1. Durations are whole microseconds so that no time is lost to
/// rounding over a long path; a normalised s keeps the coefficients of one size.
typedef struct {
    uint32_t duration_us;
    float coefficient[TRAJECTORY_AXES][TRAJECTORY_COEFFICIENTS];
} trajectory_segment_t;

/// The reference: y (m, m, rad) and its first three time derivatives, in the world frame.
typedef struct {
    vec3_t position;
    vec3_t velocity;
    vec3_t acceleration;
    vec3_t jerk;
} reference_t;

/// Where in the trajectory we are.
typedef struct {
    uint16_t segment;
    uint32_t time_us; // since the segment's start
} trajectory_cursor_t;

/// True if every coefficient is a number within ±TRAJECTORY_COEFFICIENT_MAX. Work: 24 comparisons a segment.
bool trajectory_coefficients_are_valid(const trajectory_segment_t *segments, uint16_t count);

/// True if each segment lasts 1 … TRAJECTORY_SEGMENT_DURATION_MAX_US and all together TRAJECTORY_DURATION_MAX_US at
/// most.
bool trajectory_durations_are_valid(const trajectory_segment_t *segments, uint16_t count);

/// True if no segment starts further from the end of the one before it than TRAJECTORY_JUMP_MAX_…, a full turn of
/// heading included: the heading is not wrapped. Coefficients must be valid. Work: 21 additions a segment.
bool trajectory_is_continuous(const trajectory_segment_t *segments, uint16_t count);

/// Moves the cursor on by a time; it stays at the end of the last segment. Work: at most `count` steps.
void trajectory_advance(const trajectory_segment_t *segments, uint16_t count, trajectory_cursor_t *cursor,
                        uint32_t step_us);

/// The reference at the cursor; at rest at the last point from the end on. `count` ≥ 1.
reference_t trajectory_reference(const trajectory_segment_t *segments, uint16_t count,
                                 const trajectory_cursor_t *cursor);

#endif
