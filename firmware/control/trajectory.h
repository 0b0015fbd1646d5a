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

/// True for a positive duration and finite coefficients within TRAJECTORY_COEFFICIENT_MAX.
bool trajectory_segment_is_valid(const trajectory_segment_t *segment);

/// Moves the cursor on by a time; it stays at the end of the last segment. Work: at most `count` steps.
void trajectory_advance(const trajectory_segment_t *segments, uint16_t count, trajectory_cursor_t *cursor,
                        uint32_t step_us);

/// The reference at the cursor; at rest at the last point from the end on. `count` ≥ 1.
reference_t trajectory_reference(const trajectory_segment_t *segments, uint16_t count,
                                 const trajectory_cursor_t *cursor);

#endif
