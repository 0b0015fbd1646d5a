// SPDX-License-Identifier: MIT
// The integral manifold of (21)–(29) in resummed form (theory, 'The manifold, resummed'): with ν̇ as the acceleration
// the law asks for, the series of the paper is the series of a fixed point, and no term needs more than one derivative.
#ifndef OMNIBOT_CONTROL_MANIFOLD_H
#define OMNIBOT_CONTROL_MANIFOLD_H

#include "robot.h"

/// λ = Λ (ν̇ + ω×ν): the wheel forces (N) that accelerate the body so. Theory (M2); (28) of the paper is its order 0.
vec3_t manifold_force(const robot_t *robot, vec3_t twist, vec3_t acceleration);

/// ν̇ = Λ⁻¹ λ − ω×ν: the same turned round.
vec3_t manifold_acceleration(const robot_t *robot, vec3_t twist, vec3_t force_N);

/// λ̇ = Λ (ν̈ + Ω(ν̇3) ν + Ω(ν3) ν̇). Theory (M3).
vec3_t manifold_force_rate(const robot_t *robot, vec3_t twist, vec3_t acceleration, vec3_t jerk);

/// µ = −κ Γ⁻¹ λ, κ = (V + δ)/G0: the fast variable that belongs to the forces λ. Theory (M1).
vec3_t manifold_of_force(const robot_t *robot, float mobility, vec3_t force_N);

#endif
