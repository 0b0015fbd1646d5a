// SPDX-License-Identifier: MIT
// The robot's constants and the manifold's constant matrices. tools/generate_constants.py makes the one instance from
// firmware/robot/omnibot.toml, computed in double and rounded once.
#ifndef OMNIBOT_CONTROL_ROBOT_H
#define OMNIBOT_CONTROL_ROBOT_H

#include "floor.h"
#include "vec3.h"

#include <stdint.h>

typedef struct {
    float tracked_point_offset_m;  // L
    float wheel_radius_m;          // r
    float wheel_inertia_kgm2;      // Iw
    float normalised_stiffness_N;  // G0
    uint32_t control_period_us;    // T
    mat3_t wheel_rate_of_twist;    // J = Jr / r, 1/m: φ̇ = J ν without slip
    mat3_t twist_of_wheel_rate;    // J⁻¹, m
    mat3_t twist_of_contact_speed; // Jr⁻¹
    mat3_t slip_mobility_inverse;  // Γ⁻¹, Γ = Jr Jrᵀ + r² I3
    mat3_t wheel_force_of_accel;   // Λ = Jr⁻ᵀ Mo: wheel forces (N) of a body acceleration
    mat3_t accel_of_wheel_force;   // Λ⁻¹ = Mo⁻¹ Jrᵀ
    mat3_t slip_twist_of_accel;    // Jr⁻¹ Λ = (Jrᵀ Jr)⁻¹ Mo
    float layer_rate_m_per_Ns2;    // slowest eigenvalue of M22 Γ²: the layer (18) dies at this times G0/(ε (V+δ))
    floor_curve_t floor_curve;     // the magic formula's shape, turned round
} robot_t;

/// The robot of firmware/robot/omnibot.toml.
extern const robot_t omnibot;

#endif
