/* lanes.h - vectors of LANE_COUNT doubles, and masks of lanes.
 *
 * LANE_COUNT follows the instruction set that a source is compiled for: eight lanes, four or two.
 * Arithmetic uses the compiler's operators on vectors. This header adds only what has no operator,
 * and comparisons, which yield different masks on different instruction sets.
 *
 * A mask has one bit for each lane with AVX-512, else a whole lane of equal bits. The operators ~,
 * & and | work on both. */
#ifndef BSQ_SIMD_LANES_H
#define BSQ_SIMD_LANES_H

#include <math.h>
#include <stdint.h>
#include <string.h>

/* LANES_CALL() is an intrinsic for vectors of this width. */
#if defined __AVX512F__ && defined __AVX512DQ__ && defined __AVX512VL__
#define LANE_COUNT       8
#define LANES_CALL(name) _mm512_##name
#elif defined __AVX2__
#define LANE_COUNT       4
#define LANES_CALL(name) _mm256_##name
#else
#define LANE_COUNT 2
#ifdef __SSE2__
#define LANES_CALL(name) _mm_##name
#endif
#endif

#ifdef __AVX2__
#include <immintrin.h>
#elif defined __SSE4_1__
#include <smmintrin.h>
#elif defined __SSE2__
#include <emmintrin.h>
#endif

typedef double doubles __attribute__((vector_size(8 * LANE_COUNT)));
/* 64-bit integers, or the bits of doubles. */
typedef long long lane_ints __attribute__((vector_size(8 * LANE_COUNT)));

/* The same in memory that is aligned for one lane only. */
typedef double lanes_in_memory __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));
typedef long long ints_in_memory
    __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));

#define LANES_INLINE static inline __attribute__((always_inline))

LANES_INLINE doubles lanes_all(double x)
{
    return x - (doubles){0.0};
}

LANES_INLINE lane_ints lanes_all_bits(uint64_t x)
{
    return (long long)x - (lane_ints){0};
}

LANES_INLINE doubles lanes_load(const double *from)
{
    return *(const lanes_in_memory *)from;
}

LANES_INLINE lane_ints lanes_load_ints(const long long *from)
{
    return *(const ints_in_memory *)from;
}

LANES_INLINE void lanes_store(doubles x, double *to)
{
    *(lanes_in_memory *)to = x;
}

LANES_INLINE void lanes_store_ints(lane_ints x, long long *to)
{
    *(ints_in_memory *)to = x;
}

/* Returns integers whose low 51 bits are those of the integral values of x in two's complement; the
 * bits above are arbitrary. */
LANES_INLINE lane_ints lanes_integer_bits(doubles x)
{
    return (lane_ints)(x + 0x1.8p52);
}

LANES_INLINE doubles lanes_abs(doubles x)
{
    return (doubles)((lane_ints)x & INT64_MAX);
}

/* ---- masks ----
 *
 * Comments at the first of several functions of one name hold for all. */

#if LANE_COUNT != 8

typedef lane_ints lane_mask;

LANES_INLINE lane_mask lanes_less(doubles a, doubles b)
{
    return a < b;
}

LANES_INLINE lane_mask lanes_equal(doubles a, doubles b)
{
    return a == b;
}

/* Returns the lanes whose sign bit is set; -0 has it too. */
LANES_INLINE lane_mask lanes_signs(doubles x)
{
    return (lane_ints)x < 0;
}

/* Returns x in lanes whose mask is set, 0 in the others. */
LANES_INLINE doubles lanes_keep(lane_mask mask, doubles x)
{
    return (doubles)(mask & (lane_ints)x);
}

/* Returns bit i for lane i of the mask. */
LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
#ifdef LANES_CALL
    return (unsigned)LANES_CALL(movemask_pd)((doubles)mask);
#else
    return (unsigned)(mask[0] & 1) | (unsigned)(mask[1] & 2);
#endif
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
#ifdef __SSE4_1__
    return LANES_CALL(blendv_pd)(no, yes, (doubles)mask);
#else
    return (doubles)((mask & (lane_ints)yes) | (~mask & (lane_ints)no));
#endif
}

/* ---- eight lanes, for AVX-512: a mask has one bit for each lane ---- */

#else

typedef __mmask8 lane_mask;

LANES_INLINE lane_mask lanes_less(doubles a, doubles b)
{
    return _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ);
}

LANES_INLINE lane_mask lanes_equal(doubles a, doubles b)
{
    return _mm512_cmp_pd_mask(a, b, _CMP_EQ_OQ);
}

LANES_INLINE lane_mask lanes_signs(doubles x)
{
    return _mm512_movepi64_mask((__m512i)x);
}

LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return mask;
}

LANES_INLINE doubles lanes_keep(lane_mask mask, doubles x)
{
    return _mm512_maskz_mov_pd(mask, x);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return _mm512_mask_mov_pd(no, mask, yes);
}

/* Sets lane i to the lane of x whose index is in the low three bits of which[i]. */
LANES_INLINE doubles lanes_pick(doubles x, lane_ints which)
{
    return _mm512_permutexvar_pd((__m512i)which, x);
}

/* Returns the lanes of the mask one after the other, then zeros. */
LANES_INLINE doubles lanes_pack(lane_mask mask, doubles x)
{
    return _mm512_maskz_compress_pd(mask, x);
}

#endif

/* ---- all instruction sets ---- */

/* Returns x | bits in lanes whose mask is set, x in the others. */
LANES_INLINE lane_ints lanes_set_bits(lane_mask mask, lane_ints x, lane_ints bits)
{
    return x | (lane_ints)lanes_keep(mask, (doubles)bits);
}

/* Returns x + y in lanes whose mask is set, x in the others. */
LANES_INLINE lane_ints lanes_add_ints(lane_mask mask, lane_ints x, lane_ints y)
{
    return x + (lane_ints)lanes_keep(mask, (doubles)y);
}

/* Returns a < b ? a : b for each lane; lanes_max(): a > b ? a : b. */
LANES_INLINE doubles lanes_min(doubles a, doubles b)
{
#ifdef LANES_CALL
    return LANES_CALL(min_pd)(a, b);
#else
    return lanes_select(a < b, a, b);
#endif
}

LANES_INLINE doubles lanes_max(doubles a, doubles b)
{
#ifdef LANES_CALL
    return LANES_CALL(max_pd)(a, b);
#else
    return lanes_select(a > b, a, b);
#endif
}

LANES_INLINE doubles lanes_sqrt(doubles x)
{
#ifdef LANES_CALL
    return LANES_CALL(sqrt_pd)(x);
#else
    return (doubles){sqrt(x[0]), sqrt(x[1])};
#endif
}

/* ---- rows of four numbers, one row for each lane ---- */

/* Returns the even lanes of a and b in turns, or the odd ones. */
LANES_INLINE doubles lanes_zip(doubles a, doubles b, int odd)
{
#ifdef LANES_CALL
    return odd ? LANES_CALL(unpackhi_pd)(a, b) : LANES_CALL(unpacklo_pd)(a, b);
#else
    return (doubles){a[odd], b[odd]};
#endif
}

#if LANE_COUNT == 2

/* Defines a function that sets lane i of out[k] to from[i][k]. Reads four numbers from each
 * from[i]. */
#define LANES_GATHER(name, number)                                                                 \
    LANES_INLINE void name(const number *const from[LANE_COUNT], doubles out[4])                   \
    {                                                                                              \
        for (int k = 0; k < 4; k++)                                                                \
            out[k] = (doubles){(double)from[0][k], (double)from[1][k]};                            \
    }

#else

typedef double lanes_row __attribute__((vector_size(32)));
typedef double lanes_row_in_memory __attribute__((vector_size(32), aligned(8), may_alias));

/* Sets lane i of out[k] to number k of rows[i]. */
LANES_INLINE void lanes_of_rows(const lanes_row rows[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++) {
#if LANE_COUNT == 4
        in[i] = rows[i];
#else
        const lanes_row *pair = &rows[i / 2 * 4 + i % 2];
        in[i] = _mm512_insertf64x4(_mm512_castpd256_pd512(pair[0]), pair[2], 1);
#endif
    }
    for (int odd = 0; odd < 2; odd++) {
        const doubles a = lanes_zip(in[0], in[1], odd), b = lanes_zip(in[2], in[3], odd);
#if LANE_COUNT == 4
        out[odd] = _mm256_permute2f128_pd(a, b, 0x20);
        out[odd + 2] = _mm256_permute2f128_pd(a, b, 0x31);
#else
        out[odd] = _mm512_shuffle_f64x2(a, b, 0x88);
        out[odd + 2] = _mm512_shuffle_f64x2(a, b, 0xdd);
#endif
    }
}

#define LANES_GATHER(name, number)                                                                 \
    LANES_INLINE void name(const number *const from[LANE_COUNT], doubles out[4])                   \
    {                                                                                              \
        lanes_row rows[LANE_COUNT];                                                                \
        for (int i = 0; i < LANE_COUNT; i++)                                                       \
            rows[i] = (lanes_row){(double)from[i][0], (double)from[i][1], (double)from[i][2],      \
                                  (double)from[i][3]};                                             \
        lanes_of_rows(rows, out);                                                                  \
    }

#endif

LANES_GATHER(lanes_gather_four, double)
LANES_GATHER(lanes_gather_integers, int32_t)
LANES_GATHER(lanes_gather_floats, float)

/* Sets to[i][k] to lane i of in[k]. */
LANES_INLINE void lanes_scatter(const doubles in[4], double *const to[LANE_COUNT])
{
    for (int odd = 0; odd < 2; odd++) {
        const doubles a = lanes_zip(in[0], in[1], odd), b = lanes_zip(in[2], in[3], odd);
#if LANE_COUNT == 2
        lanes_store(a, to[odd]);
        lanes_store(b, to[odd] + 2);
#elif LANE_COUNT == 4
        lanes_store(_mm256_permute2f128_pd(a, b, 0x20), to[odd]);
        lanes_store(_mm256_permute2f128_pd(a, b, 0x31), to[odd + 2]);
#else
        for (int half = 0; half < 2; half++) {
            const doubles rows = half ? __builtin_shufflevector(a, b, 4, 5, 12, 13, 6, 7, 14, 15)
                                      : __builtin_shufflevector(a, b, 0, 1, 8, 9, 2, 3, 10, 11);
            *(lanes_row_in_memory *)to[4 * half + odd] = _mm512_castpd512_pd256(rows);
            *(lanes_row_in_memory *)to[4 * half + odd + 2] = _mm512_extractf64x4_pd(rows, 1);
        }
#endif
    }
}

/* Does the same for six numbers. */
LANES_INLINE void lanes_scatter_six(const doubles in[6], double *const to[LANE_COUNT])
{
    const doubles pairs[2] = {lanes_zip(in[4], in[5], 0), lanes_zip(in[4], in[5], 1)};
    lanes_scatter(in, to);
    for (int i = 0; i < LANE_COUNT; i++)
        memcpy(to[i] + 4, (const double *)&pairs[i % 2] + i / 2 * 2, 2 * sizeof(double));
}

/* Returns an empty mask. */
LANES_INLINE lane_mask lanes_none(void)
{
    return lanes_less(lanes_all(0.0), lanes_all(0.0));
}

#endif
