// SPDX-License-Identifier: MIT
// Between the body and its wheels: the constant maps of the theory (J, J⁻¹, Jr⁻¹, Λ, D, Γ⁻¹) and what they cost. Which
// of two forms they have follows from the wheels of the robot file. Three equal wheels at 120°, wheels 1, 2, 3 driving
// along (−√3/2, 1/2), (0, −1) and (√3/2, 1/2) of the body: every map from the body to the wheels is Jr (K1) with three
// gains, four products for nine, and D is diagonal. Any others: 3×3 matrices.
#ifndef OMNIBOT_CONTROL_WHEELS_H
#define OMNIBOT_CONTROL_WHEELS_H

#include "vec3.h"
#include "wheel_layout.h" // OMNIBOT_WHEELS_ALIKE, from the robot file

#if OMNIBOT_WHEELS_ALIKE

/// Gains of a map: √3/2 and 1/2 of the planar one, and that of turning.
typedef struct {
    float ahead, side, turn;
} wheel_map_t;

/// D = (JrᵀJr)⁻¹ Mo: its diagonal, the planar entries alike.
typedef vec3_t slip_mass_t;

/// Γ⁻¹: of what sums to 0 over the wheels, and what it adds to each wheel, of their sum.
typedef struct {
    float of_difference, of_sum;
} contact_map_t;

/// What each wheel has of something of the body: the rows of Jr, scaled.
static inline vec3_t wheels_of_body(const wheel_map_t *map, vec3_t body)
{
    const float ahead = map->ahead * body.x, side = map->side * body.y, turn = map->turn * body.z;
    return (vec3_t){turn + side - ahead, turn - (side + side), turn + side + ahead};
}

/// What the body has of something of its wheels: the columns of Jr, scaled.
static inline vec3_t body_of_wheels(const wheel_map_t *map, vec3_t wheels)
{
    const float outer = wheels.x + wheels.z;
    return (vec3_t){
        map->ahead * (wheels.z - wheels.x),
        map->side * (outer - (wheels.y + wheels.y)),
        map->turn * (outer + wheels.y),
    };
}

/// k Γ⁻¹ a of something of the wheels.
static inline vec3_t wheels_of_wheels(const contact_map_t *map, float k, vec3_t a)
{
    const float alike = k * map->of_sum * vec3_sum(a);
    const float scale = k * map->of_difference;
    return (vec3_t){scale * a.x + alike, scale * a.y + alike, scale * a.z + alike};
}

/// D a
static inline vec3_t slip_mass_times(const slip_mass_t *slip_mass, vec3_t a)
{
    return vec3_gained(*slip_mass, a);
}

/// I + c D A
static inline mat3_t slip_mass_system(const slip_mass_t *slip_mass, float c, const mat3_t *a)
{
    return mat3_identity_plus(vec3_scale(c, *slip_mass), a);
}

/// ρ/c, the largest eigenvalue of −D A with the A of (C7) at rest, which is triangular: of the translation, or of yaw.
static inline float slip_mass_ratio(const slip_mass_t *slip_mass, const mat3_t *a)
{
    const float translation = -slip_mass->y * a->m[1][1], yaw = -slip_mass->z * a->m[2][2];
    return translation > yaw ? translation : yaw;
}

#else

typedef mat3_t wheel_map_t;   // rows: wheels; columns: body
typedef mat3_t slip_mass_t;   // D = (JrᵀJr)⁻¹ Mo
typedef mat3_t contact_map_t; // Γ⁻¹

/// What each wheel has of something of the body.
static inline vec3_t wheels_of_body(const wheel_map_t *map, vec3_t body)
{
    return mat3_times(map, body);
}

/// What the body has of something of its wheels, by the columns of the map.
static inline vec3_t body_of_wheels(const wheel_map_t *map, vec3_t wheels)
{
    return mat3_transposed_times(map, wheels);
}

/// k Γ⁻¹ a of something of the wheels.
static inline vec3_t wheels_of_wheels(const contact_map_t *map, float k, vec3_t a)
{
    return vec3_scale(k, mat3_times(map, a));
}

/// D a
static inline vec3_t slip_mass_times(const slip_mass_t *slip_mass, vec3_t a)
{
    return mat3_times(slip_mass, a);
}

/// I + c D A
static inline mat3_t slip_mass_system(const slip_mass_t *slip_mass, float c, const mat3_t *a)
{
    const mat3_t product = mat3_product(slip_mass, a);
    return mat3_identity_plus((vec3_t){c, c, c}, &product);
}

/// ρ/c, the largest size of an eigenvalue of D A with the A of (C7) at rest.
static inline float slip_mass_ratio(const slip_mass_t *slip_mass, const mat3_t *a)
{
    const mat3_t product = mat3_product(slip_mass, a);
    return mat3_spectral_radius(&product);
}

#endif

#endif
