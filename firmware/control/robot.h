// SPDX-License-Identifier: MIT
// The robot's constants and the manifold's constant matrices. tools/generate_constants.py makes the one instance from
// firmware/robot/omnibot.toml, computed in double and rounded once.
#ifndef OMNIBOT_CONTROL_ROBOT_H
#define OMNIBOT_CONTROL_ROBOT_H

#include "floor.h"
#include "vec3.h"
#include "wheels.h"

#include <stdint.h>

typedef struct {
    float tracked_point_offset_m;            // L
    float wheel_radius_m;                    // r
    float wheel_inertia_kgm2;                // Iw
    float normalised_compliance_per_N;       // 1/G0
    float wheel_rate_of_contact_speed_per_m; // 1/r
    float control_period_s;                  // T
    uint32_t control_period_us;              // T
    wheel_map_t wheel_rate_of_twist;         // J = Jr / r, 1/m: φ̇ = J ν without slip
    wheel_map_t inertia_torque_of_accel;     // Iw J
    wheel_map_t twist_of_wheel_rate;         // J⁻¹, m
    wheel_map_t twist_of_contact_speed;      // Jr⁻¹
    wheel_map_t wheel_force_of_specific;     // Λ = Jr⁻ᵀ Mo: wheel forces (N) of a specific force on the body
    slip_mass_t slip_mass;                   // D = Jr⁻¹ Λ = (Jrᵀ Jr)⁻¹ Mo
    contact_map_t slip_mobility_inverse;     // Γ⁻¹, Γ = Jr Jrᵀ + r² I3
    float layer_lag_Ns2_per_m; // over the slowest eigenvalue of M22 Γ²: the layer (18) dies in this times ε (V+δ)/G0
    floor_curve_t floor_curve; // the magic formula's shape, turned round
    float wheel_distance_m;    // b, of the wheel furthest out
    uint32_t file_checksum;    // of the robot file's numbers
} robot_t;

/// The robot of firmware/robot/omnibot.toml.
extern const robot_t omnibot;

#endif
