// SPDX-License-Identifier: MIT
// The integral manifold of (21)–(29) in resummed form (theory, 'The manifold, resummed'): with ν̇ as the acceleration
// the law asks for, the series of the paper is the series of a fixed point, and no term needs more than one derivative.
#ifndef OMNIBOT_CONTROL_MANIFOLD_H
#define OMNIBOT_CONTROL_MANIFOLD_H

#include "robot.h"

/// λ = Λ (ν̇ + ω×ν): the wheel forces (N) of a specific force on the body (m/s², m/s², rad/s²), which is ν̇ + ω×ν.
/// Theory (M2); (28) of the paper is its order 0.
vec3_t manifold_force(const robot_t *robot, vec3_t specific_force);

/// d/dt (ν̇ + ω×ν) = ν̈ + Ω(ν̇3) ν + Ω(ν3) ν̇, the rate of the specific force: λ̇ is Λ times it. Theory (M3).
vec3_t manifold_specific_force_rate(vec3_t twist, vec3_t acceleration, vec3_t jerk);

/// µ = −κ Γ⁻¹ λ, κ = (V + δ)/G0: the fast variable that belongs to the forces λ. Theory (M1).
vec3_t manifold_of_force(const robot_t *robot, float mobility, vec3_t force_N);

#endif
