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

/// Entry by entry: a diagonal matrix times a vector.
static inline vec3_t vec3_multiply(vec3_t a, vec3_t b)
{
    return (vec3_t){a.x * b.x, a.y * b.y, a.z * b.z};
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

static inline bool vec3_is_finite(vec3_t a)
{
    return isfinite(a.x) && isfinite(a.y) && isfinite(a.z);
}

static inline vec3_t mat3_apply(const mat3_t *a, vec3_t b)
{
    return (vec3_t){
        a->m[0][0] * b.x + a->m[0][1] * b.y + a->m[0][2] * b.z,
        a->m[1][0] * b.x + a->m[1][1] * b.y + a->m[1][2] * b.z,
        a->m[2][0] * b.x + a->m[2][1] * b.y + a->m[2][2] * b.z,
    };
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

/// The x of A x = b by Cramer's rule; not finite where A is singular.
static inline vec3_t mat3_solve(const mat3_t *a, vec3_t b)
{
    const vec3_t c0 = mat3_column(a, 0), c1 = mat3_column(a, 1), c2 = mat3_column(a, 2);
    const vec3_t c12 = vec3_cross(c1, c2);
    const float inverse = 1.0f / vec3_dot(c0, c12);
    const vec3_t determinants = {vec3_dot(b, c12), vec3_dot(c0, vec3_cross(b, c2)), vec3_dot(c0, vec3_cross(c1, b))};
    return vec3_scale(inverse, determinants);
}

/// I + k A B
static inline mat3_t mat3_identity_plus(float k, const mat3_t *a, const mat3_t *b)
{
    mat3_t sum;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            const float product = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
            sum.m[i][j] = (i == j ? 1.0f : 0.0f) + k * product;
        }
    }
    return sum;
}

/// Ω(turn_rate) a = ω×a of theory 'Full model': what a turning frame adds to the derivative of a planar vector.
static inline vec3_t vec3_turn(float turn_rate, vec3_t a)
{
    return (vec3_t){-turn_rate * a.y, turn_rate * a.x, 0.0f};
}

#endif
