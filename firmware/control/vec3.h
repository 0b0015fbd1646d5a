// SPDX-License-Identifier: MIT
// Triplets and 3×3 matrices by value. A triplet is either a twist or pose (two planar parts and a heading) or one
// number a wheel; the field names follow the first use.
#ifndef OMNIBOT_CONTROL_VEC3_H
#define OMNIBOT_CONTROL_VEC3_H

#include <math.h>
#include <stdbool.h>

typedef struct {
    float x, y, z;
} vec3_t;

typedef struct {
    float m[3][3]; // row by row
} mat3_t;

static inline vec3_t vec3_add(vec3_t a, vec3_t b)
{
    return (vec3_t){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline vec3_t vec3_sub(vec3_t a, vec3_t b)
{
    return (vec3_t){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline vec3_t vec3_scale(float k, vec3_t a)
{
    return (vec3_t){k * a.x, k * a.y, k * a.z};
}

/// a + k b
static inline vec3_t vec3_add_scaled(vec3_t a, float k, vec3_t b)
{
    return (vec3_t){a.x + k * b.x, a.y + k * b.y, a.z + k * b.z};
}

/// A diagonal matrix whose planar entries are alike times a vector.
static inline vec3_t vec3_gained(vec3_t gains, vec3_t a)
{
    return (vec3_t){gains.x * a.x, gains.x * a.y, gains.z * a.z};
}

static inline float vec3_sum(vec3_t a)
{
    return a.x + a.y + a.z;
}

static inline float vec3_max_abs(vec3_t a)
{
    const float x = fabsf(a.x), y = fabsf(a.y), z = fabsf(a.z);
    const float xy = x > y ? x : y;
    return xy > z ? xy : z;
}

static inline vec3_t vec3_cross(vec3_t a, vec3_t b)
{
    return (vec3_t){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline float vec3_dot(vec3_t a, vec3_t b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline vec3_t mat3_column(const mat3_t *a, int column)
{
    return (vec3_t){a->m[0][column], a->m[1][column], a->m[2][column]};
}

/// A b
static inline vec3_t mat3_times(const mat3_t *a, vec3_t b)
{
    const float(*m)[3] = a->m;
    return (vec3_t){
        m[0][0] * b.x + m[0][1] * b.y + m[0][2] * b.z,
        m[1][0] * b.x + m[1][1] * b.y + m[1][2] * b.z,
        m[2][0] * b.x + m[2][1] * b.y + m[2][2] * b.z,
    };
}

/// Aᵀ b
static inline vec3_t mat3_transposed_times(const mat3_t *a, vec3_t b)
{
    const float(*m)[3] = a->m;
    return (vec3_t){
        m[0][0] * b.x + m[1][0] * b.y + m[2][0] * b.z,
        m[0][1] * b.x + m[1][1] * b.y + m[2][1] * b.z,
        m[0][2] * b.x + m[1][2] * b.y + m[2][2] * b.z,
    };
}

/// A B
static inline mat3_t mat3_product(const mat3_t *a, const mat3_t *b)
{
    mat3_t product;
    for (int column = 0; column < 3; column++) {
        const vec3_t result = mat3_times(a, mat3_column(b, column));
        product.m[0][column] = result.x;
        product.m[1][column] = result.y;
        product.m[2][column] = result.z;
    }
    return product;
}

/// k A
static inline mat3_t mat3_scale(float k, const mat3_t *a)
{
    const float(*m)[3] = a->m;
    return (mat3_t){{
        {k * m[0][0], k * m[0][1], k * m[0][2]},
        {k * m[1][0], k * m[1][1], k * m[1][2]},
        {k * m[2][0], k * m[2][1], k * m[2][2]},
    }};
}

/// Square root of the sum of all squares.
static inline float mat3_norm(const mat3_t *a)
{
    const vec3_t c0 = mat3_column(a, 0), c1 = mat3_column(a, 1), c2 = mat3_column(a, 2);
    return sqrtf(vec3_dot(c0, c0) + vec3_dot(c1, c1) + vec3_dot(c2, c2));
}

enum { SPECTRAL_SQUARINGS = 8 };

/// The largest size of an eigenvalue, not too small and at most 2 % too large where the eigenvectors are not nearly
/// parallel: |A^256|^(1/256) (Gelfand), scaled at each squaring so that no power leaves the range of a float.
static inline float mat3_spectral_radius(const mat3_t *a)
{
    mat3_t power = *a;
    float norm[SPECTRAL_SQUARINGS + 1];
    for (int i = 0; i <= SPECTRAL_SQUARINGS; i++) {
        norm[i] = mat3_norm(&power);
        if (!(norm[i] > 0.0f)) {
            return 0.0f;
        }
        const mat3_t scaled = mat3_scale(1.0f / norm[i], &power);
        power = mat3_product(&scaled, &scaled);
    }
    float radius = norm[SPECTRAL_SQUARINGS];
    for (int i = SPECTRAL_SQUARINGS - 1; i >= 0; i--) {
        radius = norm[i] * sqrtf(radius);
    }
    return radius;
}

/// The x of A x = b by Cramer's rule; not finite where A is singular.
static inline vec3_t mat3_solve(const mat3_t *a, vec3_t b)
{
    const vec3_t c0 = mat3_column(a, 0), c1 = mat3_column(a, 1), c2 = mat3_column(a, 2);
    const vec3_t c12 = vec3_cross(c1, c2);
    const float inverse = 1.0f / vec3_dot(c0, c12);
    const vec3_t determinants = {vec3_dot(b, c12), vec3_dot(c0, vec3_cross(b, c2)), vec3_dot(c0, vec3_cross(c1, b))};
    return vec3_scale(inverse, determinants);
}

/// I + diag(k) A
static inline mat3_t mat3_identity_plus(vec3_t k, const mat3_t *a)
{
    return (mat3_t){{
        {1.0f + k.x * a->m[0][0], k.x * a->m[0][1], k.x * a->m[0][2]},
        {k.y * a->m[1][0], 1.0f + k.y * a->m[1][1], k.y * a->m[1][2]},
        {k.z * a->m[2][0], k.z * a->m[2][1], 1.0f + k.z * a->m[2][2]},
    }};
}

/// a + Ω(turn_rate) b, Ω(ω) b = ω×b: with what a turning frame adds to the derivative of a planar vector.
static inline vec3_t vec3_add_turn(vec3_t a, float turn_rate, vec3_t b)
{
    return (vec3_t){a.x - turn_rate * b.y, a.y + turn_rate * b.x, a.z};
}

#endif
