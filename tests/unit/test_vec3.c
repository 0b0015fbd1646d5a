// SPDX-License-Identifier: MIT
// Triplets and matrices against small whole numbers by hand, and against their literal forms in double.
#include "vec3.h"

#include "unity.h"

#include <stdint.h>

void setUp(void)
{
}

void tearDown(void)
{
}

static float noise(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (float)(int32_t)*seed / 2147483648.0f;
}

static vec3_t random_vec3(uint32_t *seed)
{
    const float x = noise(seed), y = noise(seed);
    return (vec3_t){x, y, noise(seed)};
}

static void assert_vec3(double x, double y, double z, vec3_t actual, double tolerance)
{
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)x, actual.x);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)y, actual.y);
    TEST_ASSERT_FLOAT_WITHIN((float)tolerance, (float)z, actual.z);
}

static void test_cross_of_the_axes_is_the_third(void)
{
    const vec3_t x = {1.0f, 0.0f, 0.0f}, y = {0.0f, 1.0f, 0.0f}, z = {0.0f, 0.0f, 1.0f};
    assert_vec3(0.0, 0.0, 1.0, vec3_cross(x, y), 0.0);
    assert_vec3(1.0, 0.0, 0.0, vec3_cross(y, z), 0.0);
    assert_vec3(0.0, 1.0, 0.0, vec3_cross(z, x), 0.0);
    assert_vec3(0.0, 0.0, -1.0, vec3_cross(y, x), 0.0);
    assert_vec3(-1.0, 0.0, 0.0, vec3_cross(z, y), 0.0);
    assert_vec3(0.0, -1.0, 0.0, vec3_cross(x, z), 0.0);
}

static void test_cross_of_whole_numbers_is_the_hand_computed_one(void)
{
    assert_vec3(-3.0, 6.0, -3.0, vec3_cross((vec3_t){1.0f, 2.0f, 3.0f}, (vec3_t){4.0f, 5.0f, 6.0f}), 0.0);
}

static void test_dot_of_whole_numbers_is_the_hand_computed_one(void)
{
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 16.0f, vec3_dot((vec3_t){1.0f, 2.0f, -3.0f}, (vec3_t){5.0f, 7.0f, 1.0f}));
}

static void test_max_abs_finds_the_largest_in_each_place(void)
{
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 3.0f, vec3_max_abs((vec3_t){-3.0f, 2.0f, 1.0f}));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 3.0f, vec3_max_abs((vec3_t){1.0f, -3.0f, 2.0f}));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 3.0f, vec3_max_abs((vec3_t){2.0f, 1.0f, -3.0f}));
}

static void test_identity_plus_scales_each_row_by_its_own_number(void)
{
    const mat3_t a = {{{1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}, {7.0f, 8.0f, 9.0f}}};
    const mat3_t sum = mat3_identity_plus((vec3_t){2.0f, -3.0f, 5.0f}, &a);
    const float expected[3][3] = {{3.0f, 4.0f, 6.0f}, {-12.0f, -14.0f, -18.0f}, {35.0f, 40.0f, 46.0f}};
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++) {
            TEST_ASSERT_FLOAT_WITHIN(0.0f, expected[row][column], sum.m[row][column]);
        }
    }
}

// ---- matrices

static const mat3_t digits = {{{1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}, {7.0f, 8.0f, 9.0f}}};
static const mat3_t others = {{{2.0f, -1.0f, 3.0f}, {0.0f, 4.0f, -2.0f}, {5.0f, 1.0f, -3.0f}}};

static void assert_mat3(const double expected[3][3], mat3_t actual)
{
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++) {
            TEST_ASSERT_FLOAT_WITHIN(0.0f, (float)expected[row][column], actual.m[row][column]);
        }
    }
}

static void test_matrix_times_vector_takes_its_rows(void)
{
    assert_vec3(31.0, 76.0, 121.0, mat3_times(&digits, (vec3_t){2.0f, 10.0f, 3.0f}), 0.0);
}

static void test_transposed_matrix_times_vector_takes_its_columns(void)
{
    assert_vec3(63.0, 78.0, 93.0, mat3_transposed_times(&digits, (vec3_t){2.0f, 10.0f, 3.0f}), 0.0);
}

static void test_product_of_whole_numbers_is_the_hand_computed_one(void)
{
    const double expected[3][3] = {{17.0, 10.0, -10.0}, {38.0, 22.0, -16.0}, {59.0, 34.0, -22.0}};
    assert_mat3(expected, mat3_product(&digits, &others));
}

static void test_scale_takes_every_entry(void)
{
    const double expected[3][3] = {{-2.0, -4.0, -6.0}, {-8.0, -10.0, -12.0}, {-14.0, -16.0, -18.0}};
    assert_mat3(expected, mat3_scale(-2.0f, &digits));
}

static void test_norm_is_the_root_of_the_sum_of_squares(void)
{
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, sqrtf(285.0f), mat3_norm(&digits));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-6f, sqrtf(69.0f), mat3_norm(&others));
}

/// The radius as it is said to be: not too small, and at most 2 % too large.
static void assert_spectral_radius(double expected, mat3_t a)
{
    const double actual = (double)mat3_spectral_radius(&a);
    TEST_ASSERT_TRUE(actual >= expected * (1.0 - 1.0e-5));
    TEST_ASSERT_TRUE(actual <= expected * 1.02);
}

static void test_spectral_radius_is_the_largest_size_of_an_eigenvalue(void)
{
    const mat3_t turning = {{{0.0f, -5.0f, 0.0f}, {5.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 3.0f}}}; // ±5i, 3
    const mat3_t negative = {{{1.0f, 0.0f, 0.0f}, {0.0f, -7.0f, 0.0f}, {0.0f, 0.0f, 6.9f}}};
    const mat3_t triangular = {{{2.0f, 9.0f, -4.0f}, {0.0f, 1.0f, 8.0f}, {0.0f, 0.0f, 0.5f}}};
    // Along (1, 1, 1) 6, across it 0.
    const mat3_t alike = {{{2.0f, 2.0f, 2.0f}, {2.0f, 2.0f, 2.0f}, {2.0f, 2.0f, 2.0f}}};
    assert_spectral_radius(5.0, turning);
    assert_spectral_radius(7.0, negative);
    assert_spectral_radius(2.0, triangular);
    assert_spectral_radius(6.0, alike);
    assert_spectral_radius(16.116843969807043, digits); // (15 + 3 √33)/2
}

static void test_spectral_radius_of_large_and_small_matrices_stays_in_range(void)
{
    assert_spectral_radius(16.116843969807043e18, mat3_scale(1.0e18f, &digits));
    assert_spectral_radius(16.116843969807043e-18, mat3_scale(1.0e-18f, &digits));
}

static void test_spectral_radius_of_nothing_and_of_what_vanishes_is_0(void)
{
    const mat3_t nilpotent = {{{0.0f, 1.0f, 2.0f}, {0.0f, 0.0f, 3.0f}, {0.0f, 0.0f, 0.0f}}};
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, mat3_spectral_radius(&(mat3_t){0}));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, mat3_spectral_radius(&nilpotent));
}

static void test_solution_of_random_equations_solves_them(void)
{
    uint32_t seed = 11;
    for (int i = 0; i < 1000; i++) {
        const mat3_t a =
            mat3_identity_plus(random_vec3(&seed), &(mat3_t){{{noise(&seed), noise(&seed), noise(&seed)},
                                                              {noise(&seed), noise(&seed), noise(&seed)},
                                                              {noise(&seed), noise(&seed), noise(&seed)}}});
        const vec3_t b = random_vec3(&seed);
        const vec3_t x = mat3_solve(&a, b);
        double left[3];
        for (int row = 0; row < 3; row++) {
            left[row] = (double)a.m[row][0] * (double)x.x + (double)a.m[row][1] * (double)x.y +
                        (double)a.m[row][2] * (double)x.z;
        }
        assert_vec3(left[0], left[1], left[2], b, 1e-5 * (1.0 + (double)vec3_max_abs(x)));
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_cross_of_the_axes_is_the_third);
    RUN_TEST(test_cross_of_whole_numbers_is_the_hand_computed_one);
    RUN_TEST(test_dot_of_whole_numbers_is_the_hand_computed_one);
    RUN_TEST(test_max_abs_finds_the_largest_in_each_place);
    RUN_TEST(test_identity_plus_scales_each_row_by_its_own_number);
    RUN_TEST(test_matrix_times_vector_takes_its_rows);
    RUN_TEST(test_transposed_matrix_times_vector_takes_its_columns);
    RUN_TEST(test_product_of_whole_numbers_is_the_hand_computed_one);
    RUN_TEST(test_scale_takes_every_entry);
    RUN_TEST(test_norm_is_the_root_of_the_sum_of_squares);
    RUN_TEST(test_spectral_radius_is_the_largest_size_of_an_eigenvalue);
    RUN_TEST(test_spectral_radius_of_large_and_small_matrices_stays_in_range);
    RUN_TEST(test_spectral_radius_of_nothing_and_of_what_vanishes_is_0);
    RUN_TEST(test_solution_of_random_equations_solves_them);
    return UNITY_END();
}
