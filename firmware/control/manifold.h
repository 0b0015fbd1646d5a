// SPDX-License-Identifier: MIT
// The integral manifold µ = H0 + ε H1 of (21)–(29), in the compact form of theory 'The manifold'. λk = −Γ Hk / κ are
// the wheel forces that belong to each term.
#ifndef OMNIBOT_CONTROL_MANIFOLD_H
#define OMNIBOT_CONTROL_MANIFOLD_H

#include "robot.h"

/// κ = (V + δ) / G0 and its time derivative: how much slip velocity a wheel force costs, per unit of ε.
typedef struct {
    float value;
    float rate;
} mobility_t;

/// H = −κ Γ⁻¹ λ: the manifold of a wheel force λ in N. Theory (M1).
vec3_t manifold_of_force(const robot_t *robot, float mobility, vec3_t force_N);

/// λ0 = Λ (η + v3×v): wheel forces that give the acceleration η at the quasi-velocity v. Paper (28), theory (M2).
vec3_t manifold_force0(const robot_t *robot, vec3_t v, vec3_t eta);

/// Ḣ0 = −κ Γ⁻¹ λ̇0 − κ̇ Γ⁻¹ λ0 along v̇ = η. Theory (M3).
vec3_t manifold_rate0(const robot_t *robot, mobility_t mobility, vec3_t v, vec3_t eta, vec3_t eta_rate);

/// λ1 = Λ (Ω(b·1ᵀH0) v + Ω(v3) Jrᵀ H0 + Jrᵀ Ḣ0). Paper (27), theory (M4).
vec3_t manifold_force1(const robot_t *robot, vec3_t v, vec3_t H0, vec3_t H0_rate);

#endif
