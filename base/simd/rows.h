/* rows.h - four doubles that belong together, whatever LANE_COUNT is, such as a point and a weight;
 * and four 32-bit integers. */
#ifndef BSQ_SIMD_ROWS_H
#define BSQ_SIMD_ROWS_H

#include <stdbool.h>
#include <string.h>

#include "base/simd/lanes.h"

/* A row is two vectors if the processor has no vectors of four. Compilers keep vectors larger than
 * the processor's in memory, where a load has to wait for smaller stores before it. */
enum { ROW_LANES = LANE_COUNT < 4 ? LANE_COUNT : 4, ROW_VECTORS = 4 / ROW_LANES };
typedef double row_vector __attribute__((vector_size(8 * ROW_LANES)));
typedef double row_in_memory __attribute__((vector_size(8 * ROW_LANES), aligned(8), may_alias));
struct row {
    row_vector vector[ROW_VECTORS];
};

/* An intrinsic for a vector of a row. */
#ifdef __AVX2__
#define ROW_CALL(name) _mm256_##name
#elif defined __SSE2__
#define ROW_CALL(name) _mm_##name
#endif

LANES_INLINE struct row row_load(const double *from)
{
    struct row x;
    for (int i = 0; i < ROW_VECTORS; i++)
        x.vector[i] = *(const row_in_memory *)(from + i * ROW_LANES);
    return x;
}

LANES_INLINE void row_store(struct row x, double *to)
{
    for (int i = 0; i < ROW_VECTORS; i++)
        *(row_in_memory *)(to + i * ROW_LANES) = x.vector[i];
}

LANES_INLINE struct row row_sum(struct row a, struct row b)
{
    for (int i = 0; i < ROW_VECTORS; i++)
        a.vector[i] += b.vector[i];
    return a;
}

LANES_INLINE struct row row_difference(struct row a, struct row b)
{
    for (int i = 0; i < ROW_VECTORS; i++)
        a.vector[i] -= b.vector[i];
    return a;
}

LANES_INLINE struct row row_product(struct row a, struct row b)
{
    for (int i = 0; i < ROW_VECTORS; i++)
        a.vector[i] *= b.vector[i];
    return a;
}

LANES_INLINE struct row row_quotient(struct row a, struct row b)
{
    for (int i = 0; i < ROW_VECTORS; i++)
        a.vector[i] /= b.vector[i];
    return a;
}

LANES_INLINE struct row row_sqrt(struct row a)
{
    for (int i = 0; i < ROW_VECTORS; i++)
#ifdef ROW_CALL
        a.vector[i] = ROW_CALL(sqrt_pd)(a.vector[i]);
#else
        a.vector[i] = (row_vector){sqrt(a.vector[i][0]), sqrt(a.vector[i][1])};
#endif
    return a;
}

LANES_INLINE struct row row_times(double factor, struct row x)
{
    for (int i = 0; i < ROW_VECTORS; i++)
        x.vector[i] *= factor;
    return x;
}

/* Adds x to the four numbers at `to`. */
LANES_INLINE void row_add(double *to, struct row x)
{
    row_store(row_sum(row_load(to), x), to);
}

LANES_INLINE struct row row_of(double a, double b, double c, double d)
{
    const double numbers[4] = {a, b, c, d};
    return row_load(numbers);
}

/* Returns three numbers and 0. */
LANES_INLINE struct row row_of_floats(const float from[3])
{
#ifdef __AVX2__
    __m128 two = _mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)(const void *)from));
    return (struct row){{_mm256_cvtps_pd(_mm_movelh_ps(two, _mm_load_ss(from + 2)))}};
#else
    return (struct row){{{(double)from[0], (double)from[1]}, {(double)from[2], 0.0}}};
#endif
}

/* Four floats. */
typedef float four_floats __attribute__((vector_size(16)));

typedef float four_floats_in_memory __attribute__((vector_size(16), aligned(4), may_alias));

LANES_INLINE four_floats four_floats_load(const float *from)
{
    return *(const four_floats_in_memory *)from;
}

/* Returns a < b ? a : b for each number; four_floats_max(): a > b ? a : b. */
LANES_INLINE four_floats four_floats_min(four_floats a, four_floats b)
{
#ifdef __SSE2__
    return _mm_min_ps(a, b);
#else
    for (int i = 0; i < 4; i++)
        a[i] = a[i] < b[i] ? a[i] : b[i];
    return a;
#endif
}

LANES_INLINE four_floats four_floats_max(four_floats a, four_floats b)
{
#ifdef __SSE2__
    return _mm_max_ps(a, b);
#else
    for (int i = 0; i < 4; i++)
        a[i] = a[i] > b[i] ? a[i] : b[i];
    return a;
#endif
}

/* Exchanges rows and columns. */
LANES_INLINE void four_floats_transpose(four_floats v[4])
{
    const four_floats low01 = __builtin_shufflevector(v[0], v[1], 0, 4, 1, 5);
    const four_floats low23 = __builtin_shufflevector(v[2], v[3], 0, 4, 1, 5);
    const four_floats high01 = __builtin_shufflevector(v[0], v[1], 2, 6, 3, 7);
    const four_floats high23 = __builtin_shufflevector(v[2], v[3], 2, 6, 3, 7);
    v[0] = __builtin_shufflevector(low01, low23, 0, 1, 4, 5);
    v[1] = __builtin_shufflevector(low01, low23, 2, 3, 6, 7);
    v[2] = __builtin_shufflevector(high01, high23, 0, 1, 4, 5);
    v[3] = __builtin_shufflevector(high01, high23, 2, 3, 6, 7);
}

/* Returns x with number i replaced. */
LANES_INLINE struct row row_with(struct row x, int i, double number)
{
    x.vector[i / ROW_LANES][i % ROW_LANES] = number;
    return x;
}

/* Returns x with its fourth number replaced. */
LANES_INLINE struct row row_with_last(struct row x, double last)
{
#ifdef __AVX2__
    return (struct row){{_mm256_blend_pd(x.vector[0], _mm256_set1_pd(last), 8)}};
#else
    return row_with(x, 3, last);
#endif
}

/* Returns number i. */
LANES_INLINE double row_number(struct row x, int i)
{
    return x.vector[i / ROW_LANES][i % ROW_LANES];
}

/* Four 32-bit integers. */
typedef int32_t four_ints __attribute__((vector_size(16)));

LANES_INLINE four_ints four_load(const int32_t from[4])
{
    four_ints x;
    memcpy(&x, from, sizeof x);
    return x;
}

/* Rounds down. The results must be in the range of int32_t. */
LANES_INLINE four_ints row_floor(struct row x)
{
#ifdef __AVX2__
    return (four_ints)_mm256_cvttpd_epi32(_mm256_floor_pd(x.vector[0]));
#elif defined __SSE4_1__
    return (four_ints)_mm_unpacklo_epi64(_mm_cvttpd_epi32(_mm_floor_pd(x.vector[0])),
                                         _mm_cvttpd_epi32(_mm_floor_pd(x.vector[1])));
#else
    return (four_ints){(int32_t)floor(x.vector[0][0]), (int32_t)floor(x.vector[0][1]),
                       (int32_t)floor(x.vector[1][0]), (int32_t)floor(x.vector[1][1])};
#endif
}

LANES_INLINE four_ints four_min(four_ints a, four_ints b)
{
    for (int i = 0; i < 4; i++)
        a[i] = a[i] < b[i] ? a[i] : b[i];
    return a;
}

LANES_INLINE bool four_any(four_ints mask)
{
#ifdef __SSE2__
    return _mm_movemask_epi8((__m128i)mask) != 0;
#else
    return (mask[0] | mask[1] | mask[2] | mask[3]) != 0;
#endif
}

/* Returns a mask: bit i is set if from[i] is not 0. */
LANES_INLINE uint32_t bits_of_sixteen(const uint32_t from[16])
{
#ifdef __SSE2__
    const __m128i zero = _mm_setzero_si128();
    __m128i is_zero[4];
    for (int i = 0; i < 4; i++)
        is_zero[i] =
            _mm_cmpeq_epi32(_mm_loadu_si128((const __m128i *)(const void *)(from + 4 * i)), zero);
    __m128i half[2] = {_mm_packs_epi32(is_zero[0], is_zero[1]),
                       _mm_packs_epi32(is_zero[2], is_zero[3])};
    return (uint32_t)_mm_movemask_epi8(_mm_packs_epi16(half[0], half[1])) ^ 0xffff;
#else
    uint32_t bits = 0;
    for (int i = 0; i < 16; i++)
        bits |= (uint32_t)(from[i] != 0) << i;
    return bits;
#endif
}

/* Returns a < b ? a : b for each number; row_max(): a > b ? a : b. */
LANES_INLINE struct row row_min(struct row a, struct row b)
{
    for (int i = 0; i < ROW_VECTORS; i++)
#ifdef ROW_CALL
        a.vector[i] = ROW_CALL(min_pd)(a.vector[i], b.vector[i]);
#else
        a.vector[i] =
            (row_vector){a.vector[i][0] < b.vector[i][0] ? a.vector[i][0] : b.vector[i][0],
                         a.vector[i][1] < b.vector[i][1] ? a.vector[i][1] : b.vector[i][1]};
#endif
    return a;
}

LANES_INLINE struct row row_max(struct row a, struct row b)
{
    for (int i = 0; i < ROW_VECTORS; i++)
#ifdef ROW_CALL
        a.vector[i] = ROW_CALL(max_pd)(a.vector[i], b.vector[i]);
#else
        a.vector[i] =
            (row_vector){a.vector[i][0] > b.vector[i][0] ? a.vector[i][0] : b.vector[i][0],
                         a.vector[i][1] > b.vector[i][1] ? a.vector[i][1] : b.vector[i][1]};
#endif
    return a;
}

/* Returns the numbers 1, 2, 0 and 3 of x. */
LANES_INLINE struct row row_rotate(struct row x)
{
#ifdef __AVX2__
    x.vector[0] = _mm256_permute4x64_pd(x.vector[0], 0xc9);
    return x;
#else
    return (struct row){{__builtin_shufflevector(x.vector[0], x.vector[1], 1, 2),
                         __builtin_shufflevector(x.vector[0], x.vector[1], 0, 3)}};
#endif
}

/* Returns a mask: bit i is the sign bit of number i, for the first three numbers. */
LANES_INLINE uint32_t row_signs(struct row x)
{
#ifdef __AVX2__
    return (uint32_t)_mm256_movemask_pd(x.vector[0]) & 7;
#elif defined __SSE2__
    return (uint32_t)(_mm_movemask_pd(x.vector[0]) | (_mm_movemask_pd(x.vector[1]) & 1) << 2);
#else
    uint64_t bits[3];
    for (int i = 0; i < 3; i++) {
        double number = row_number(x, i);
        memcpy(&bits[i], &number, sizeof bits[i]);
    }
    return (uint32_t)(bits[0] >> 63 | bits[1] >> 63 << 1 | bits[2] >> 63 << 2);
#endif
}

#endif
