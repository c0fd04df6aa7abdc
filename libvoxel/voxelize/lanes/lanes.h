/* lanes.h - private to voxelizing: doubles side by side, on which every operation works alike.
 *
 * As many as the instructions go for which a source is compiled, so that the same source serves
 * several: eight (lanes_avx512.h), four (lanes_avx2.h) or two (lanes_two.h). Lanes never meet in
 * arithmetic: results do not depend on their number. Arithmetic is the compiler's own on vectors;
 * here is what it has no operator for, or, as with comparisons, not the same for all.
 *
 * A mask is what a comparison yields: a bit a lane where the instructions have that, else all bits
 * of a lane or none. The operators ~, & and | serve both. */
#ifndef VOX_VOXELIZE_LANES_LANES_H
#define VOX_VOXELIZE_LANES_LANES_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#if defined __AVX512F__ && defined __AVX512DQ__ && defined __AVX512VL__
#define LANE_COUNT 8
#elif defined __AVX2__
#define LANE_COUNT 4
#else
#define LANE_COUNT 2
#endif

#ifdef __AVX2__
#include <immintrin.h>
#elif defined __SSE4_1__
#include <smmintrin.h>
#elif defined __SSE2__
#include <emmintrin.h>
#endif

typedef double lanes __attribute__((vector_size(8 * LANE_COUNT)));
/* Whole numbers, or the bits of doubles. */
typedef long long lane_ints __attribute__((vector_size(8 * LANE_COUNT)));

/* At any double, or whole number. */
typedef double lanes_in_memory __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));
typedef long long ints_in_memory
    __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));

#define LANES_INLINE static inline __attribute__((always_inline))

LANES_INLINE lanes lanes_all(double x)
{
    return x - (lanes){0.0};
}

LANES_INLINE lane_ints lanes_all_bits(uint64_t x)
{
    return (long long)x - (lane_ints){0};
}

LANES_INLINE lanes lanes_load(const double *from)
{
    return *(const lanes_in_memory *)from;
}

LANES_INLINE lane_ints lanes_load_ints(const long long *from)
{
    return *(const ints_in_memory *)from;
}

LANES_INLINE void lanes_store(lanes x, double *to)
{
    *(lanes_in_memory *)to = x;
}

LANES_INLINE void lanes_store_ints(lane_ints x, long long *to)
{
    *(ints_in_memory *)to = x;
}

/* Two's complement of whole numbers in the low 51 bits, others above. */
LANES_INLINE lane_ints lanes_integer_bits(lanes x)
{
    return (lane_ints)(x + 0x1.8p52);
}

/* Four numbers of one thing, whatever the number of lanes. Not one vector: compilers keep vectors
 * larger than the processor's in memory, where loads wait for smaller stores. */
enum { ROW_LANES = LANE_COUNT < 4 ? LANE_COUNT : 4, ROW_PARTS = 4 / ROW_LANES };
typedef double row_part __attribute__((vector_size(8 * ROW_LANES)));
typedef double row_in_memory __attribute__((vector_size(8 * ROW_LANES), aligned(8), may_alias));
struct row {
    row_part part[ROW_PARTS];
};

LANES_INLINE row_part row_part_min(row_part a, row_part b)
{
#ifdef __AVX2__
    return _mm256_min_pd(a, b);
#elif defined __SSE2__
    return _mm_min_pd(a, b);
#else
    return (row_part){a[0] < b[0] ? a[0] : b[0], a[1] < b[1] ? a[1] : b[1]};
#endif
}

LANES_INLINE row_part row_part_max(row_part a, row_part b)
{
#ifdef __AVX2__
    return _mm256_max_pd(a, b);
#elif defined __SSE2__
    return _mm_max_pd(a, b);
#else
    return (row_part){a[0] > b[0] ? a[0] : b[0], a[1] > b[1] ? a[1] : b[1]};
#endif
}

LANES_INLINE struct row row_load(const double *from)
{
    struct row x;
    for (int i = 0; i < ROW_PARTS; i++)
        x.part[i] = *(const row_in_memory *)(from + i * ROW_LANES);
    return x;
}

LANES_INLINE void row_store(struct row x, double *to)
{
    for (int i = 0; i < ROW_PARTS; i++)
        *(row_in_memory *)(to + i * ROW_LANES) = x.part[i];
}

LANES_INLINE struct row row_sum(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] += b.part[i];
    return a;
}

LANES_INLINE struct row row_difference(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] -= b.part[i];
    return a;
}

LANES_INLINE struct row row_product(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] *= b.part[i];
    return a;
}

LANES_INLINE struct row row_quotient(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] /= b.part[i];
    return a;
}

LANES_INLINE struct row row_times(double factor, struct row x)
{
    for (int i = 0; i < ROW_PARTS; i++)
        x.part[i] *= factor;
    return x;
}

/* Adds x to the four numbers. */
LANES_INLINE void row_add(double *to, struct row x)
{
    row_store(row_sum(row_load(to), x), to);
}

LANES_INLINE struct row row_of(double a, double b, double c, double d)
{
    const double numbers[4] = {a, b, c, d};
    struct row x;
    for (int i = 0; i < 4; i++)
        x.part[i / ROW_LANES][i % ROW_LANES] = numbers[i];
    return x;
}

/* Three numbers, and 0. */
LANES_INLINE struct row row_of_floats(const float from[3])
{
#ifdef __AVX2__
    __m128 two = _mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)(const void *)from));
    return (struct row){{_mm256_cvtps_pd(_mm_movelh_ps(two, _mm_load_ss(from + 2)))}};
#else
    return (struct row){{{(double)from[0], (double)from[1]}, {(double)from[2], 0.0}}};
#endif
}

/* x with another last number */
LANES_INLINE struct row row_with_last(struct row x, double last)
{
    x.part[3 / ROW_LANES][3 % ROW_LANES] = last;
    return x;
}

/* The number with this index. */
LANES_INLINE double row_number(struct row x, int i)
{
    return x.part[i / ROW_LANES][i % ROW_LANES];
}

/* Four whole numbers, whatever the number of lanes: a voxel and a number that does not matter. */
typedef int32_t four_ints __attribute__((vector_size(16)));

LANES_INLINE four_ints four_load(const int32_t from[4])
{
    four_ints x;
    memcpy(&x, from, sizeof x);
    return x;
}

/* Largest whole numbers that are not larger, where these are in the range of int32_t. */
LANES_INLINE four_ints row_floor(struct row x)
{
#ifdef __AVX2__
    return (four_ints)_mm256_cvttpd_epi32(_mm256_floor_pd(x.part[0]));
#elif defined __SSE4_1__
    return (four_ints)_mm_unpacklo_epi64(_mm_cvttpd_epi32(_mm_floor_pd(x.part[0])),
                                         _mm_cvttpd_epi32(_mm_floor_pd(x.part[1])));
#else
    return (four_ints){(int32_t)floor(x.part[0][0]), (int32_t)floor(x.part[0][1]),
                       (int32_t)floor(x.part[1][0]), (int32_t)floor(x.part[1][1])};
#endif
}

#ifdef __SSE4_1__

LANES_INLINE four_ints four_min(four_ints a, four_ints b)
{
    return (four_ints)_mm_min_epi32((__m128i)a, (__m128i)b);
}

LANES_INLINE four_ints four_max(four_ints a, four_ints b)
{
    return (four_ints)_mm_max_epi32((__m128i)a, (__m128i)b);
}

LANES_INLINE bool four_any(four_ints mask)
{
    return _mm_movemask_epi8((__m128i)mask) != 0;
}

#else

LANES_INLINE four_ints four_min(four_ints a, four_ints b)
{
    four_ints less = a < b;
    return (less & a) | (~less & b);
}

LANES_INLINE four_ints four_max(four_ints a, four_ints b)
{
    four_ints more = a > b;
    return (more & a) | (~more & b);
}

LANES_INLINE bool four_any(four_ints mask)
{
    return (mask[0] | mask[1] | mask[2] | mask[3]) != 0;
}

#endif

/* Bit i: number i is not 0. */
LANES_INLINE uint32_t sixteen_bits(const uint32_t from[16])
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

/* a < b ? a : b, and a > b ? a : b */
LANES_INLINE struct row row_min(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] = row_part_min(a.part[i], b.part[i]);
    return a;
}

LANES_INLINE struct row row_max(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] = row_part_max(a.part[i], b.part[i]);
    return a;
}

/* The numbers with indices 1, 2, 0 and 3. */
LANES_INLINE struct row row_turn(struct row x)
{
#ifdef __AVX2__
    x.part[0] = _mm256_permute4x64_pd(x.part[0], 0xc9);
    return x;
#else
    return (struct row){{__builtin_shufflevector(x.part[0], x.part[1], 1, 2),
                         __builtin_shufflevector(x.part[0], x.part[1], 0, 3)}};
#endif
}

#if LANE_COUNT == 8
#include "libvoxel/voxelize/lanes/lanes_avx512.h"
#elif LANE_COUNT == 4
#include "libvoxel/voxelize/lanes/lanes_avx2.h"
#else
#include "libvoxel/voxelize/lanes/lanes_two.h"
#endif

LANES_INLINE lane_mask lanes_none(void)
{
    return lanes_less(lanes_all(0.0), lanes_all(0.0));
}

#endif
