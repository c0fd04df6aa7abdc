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

/* Returns x | bits in lanes whose mask is set, x in the others. */
LANES_INLINE lane_ints lanes_set_bits(lane_mask mask, lane_ints x, lane_ints bits)
{
    return x | (mask & bits);
}

/* Returns x + y in lanes whose mask is set, x in the others. */
LANES_INLINE lane_ints lanes_add_ints(lane_mask mask, lane_ints x, lane_ints y)
{
    return x + (mask & y);
}

LANES_INLINE doubles lanes_abs(doubles x)
{
    return (doubles)((lane_ints)x & INT64_MAX);
}

#endif

/* ---- two lanes, for any processor ---- */

#if LANE_COUNT == 2

/* Returns bit i for lane i of the mask. */
LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)(mask[0] & 1) | (unsigned)(mask[1] & 2);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return (doubles)((mask & (lane_ints)yes) | (~mask & (lane_ints)no));
}

/* Sets lane i of out[k] to from[i][k]. */
LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], doubles out[4])
{
    for (int k = 0; k < 4; k++)
        out[k] = (doubles){from[0][k], from[1][k]};
}

/* Sets lane i of out[k] to from[i][k]. Reads four numbers from each from[i]. */
LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], doubles out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (doubles){(double)from[0][k], (double)from[1][k]};
}

/* Sets lane i of out[k] to from[i][k]. */
LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], doubles out[4])
{
    for (int k = 0; k < 4; k++)
        out[k] = (doubles){(double)from[0][k], (double)from[1][k]};
}

/* Sets to[i][k] to lane i of in[k]. */
LANES_INLINE void lanes_scatter(const doubles in[4], double *const to[LANE_COUNT])
{
    /* The analyzer does not follow single lanes.
     * NOLINTBEGIN(clang-analyzer-core.uninitialized.Assign) */
    for (int k = 0; k < 4; k++) {
        to[0][k] = in[k][0];
        to[1][k] = in[k][1];
    }
    /* NOLINTEND(clang-analyzer-core.uninitialized.Assign) */
}

/* Does the same for six numbers. Each to[i] must have space for eight; the last two are arbitrary.
 */
LANES_INLINE void lanes_scatter_six(const doubles in[6], double *const to[LANE_COUNT])
{
    for (int k = 0; k < 6; k++) {
        to[0][k] = in[k][0];
        to[1][k] = in[k][1];
    }
}

/* ---- four lanes, for AVX2 ---- */

#elif LANE_COUNT == 4

LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)_mm256_movemask_pd((__m256d)mask);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return _mm256_blendv_pd(no, yes, (__m256d)mask);
}

/* Transposes: lane i of out[k] is lane k of in[i]. */
LANES_INLINE void lanes_transpose(const doubles in[4], doubles out[4])
{
    doubles a = _mm256_unpacklo_pd(in[0], in[1]), b = _mm256_unpackhi_pd(in[0], in[1]);
    doubles c = _mm256_unpacklo_pd(in[2], in[3]), d = _mm256_unpackhi_pd(in[2], in[3]);
    out[0] = _mm256_permute2f128_pd(a, c, 0x20);
    out[1] = _mm256_permute2f128_pd(b, d, 0x20);
    out[2] = _mm256_permute2f128_pd(a, c, 0x31);
    out[3] = _mm256_permute2f128_pd(b, d, 0x31);
}

LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_loadu_pd(from[i]);
    lanes_transpose(in, out);
}

LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], doubles out[3])
{
    doubles in[4], turned[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_cvtepi32_pd(_mm_loadu_si128((const __m128i *)(const void *)from[i]));
    lanes_transpose(in, turned);
    for (int k = 0; k < 3; k++)
        out[k] = turned[k];
}

LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_cvtps_pd(_mm_loadu_ps(from[i]));
    lanes_transpose(in, out);
}

LANES_INLINE void lanes_scatter(const doubles in[4], double *const to[LANE_COUNT])
{
    doubles turned[4];
    lanes_transpose(in, turned);
    for (int i = 0; i < 4; i++)
        _mm256_storeu_pd(to[i], turned[i]);
}

LANES_INLINE void lanes_scatter_six(const doubles in[6], double *const to[LANE_COUNT])
{
    doubles even = _mm256_unpacklo_pd(in[4], in[5]), odd = _mm256_unpackhi_pd(in[4], in[5]);
    lanes_scatter(in, to);
    _mm_storeu_pd(to[0] + 4, _mm256_castpd256_pd128(even));
    _mm_storeu_pd(to[1] + 4, _mm256_castpd256_pd128(odd));
    _mm_storeu_pd(to[2] + 4, _mm256_extractf128_pd(even, 1));
    _mm_storeu_pd(to[3] + 4, _mm256_extractf128_pd(odd, 1));
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

LANES_INLINE lane_ints lanes_set_bits(lane_mask mask, lane_ints x, lane_ints bits)
{
    return (lane_ints)_mm512_mask_or_epi64((__m512i)x, mask, (__m512i)x, (__m512i)bits);
}

LANES_INLINE lane_ints lanes_add_ints(lane_mask mask, lane_ints x, lane_ints y)
{
    return (lane_ints)_mm512_mask_add_epi64((__m512i)x, mask, (__m512i)x, (__m512i)y);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return _mm512_mask_mov_pd(no, mask, yes);
}

LANES_INLINE doubles lanes_abs(doubles x)
{
    return _mm512_abs_pd(x);
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

LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++) {
        const double *const *pair = &from[i / 2 * 4 + i % 2];
        in[i] = _mm512_insertf64x4(_mm512_castpd256_pd512(_mm256_loadu_pd(pair[0])),
                                   _mm256_loadu_pd(pair[2]), 1);
    }
    doubles a = _mm512_unpacklo_pd(in[0], in[1]), b = _mm512_unpackhi_pd(in[0], in[1]);
    doubles c = _mm512_unpacklo_pd(in[2], in[3]), d = _mm512_unpackhi_pd(in[2], in[3]);
    out[0] = _mm512_shuffle_f64x2(a, c, 0x88);
    out[1] = _mm512_shuffle_f64x2(b, d, 0x88);
    out[2] = _mm512_shuffle_f64x2(a, c, 0xdd);
    out[3] = _mm512_shuffle_f64x2(b, d, 0xdd);
}

/* Returns four 32-bit words from each address. */
LANES_INLINE __m512i lanes_four_rows(const void *const from[4])
{
    __m512i rows = _mm512_castsi128_si512(_mm_loadu_si128((const __m128i *)from[0]));
    rows = _mm512_inserti32x4(rows, _mm_loadu_si128((const __m128i *)from[1]), 1);
    rows = _mm512_inserti32x4(rows, _mm_loadu_si128((const __m128i *)from[2]), 2);
    return _mm512_inserti32x4(rows, _mm_loadu_si128((const __m128i *)from[3]), 3);
}

/* Returns columns `first` and first + 1 of eight rows of four words. */
LANES_INLINE __m512i lanes_two_columns(__m512i rows, __m512i more_rows, int first)
{
    const __m512i places =
        _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
    return _mm512_permutex2var_epi32(rows, _mm512_add_epi32(places, _mm512_set1_epi32(first)),
                                     more_rows);
}

LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], doubles out[3])
{
    __m512i rows = lanes_four_rows((const void *const *)from);
    __m512i more_rows = lanes_four_rows((const void *const *)from + 4);
    __m512i xy = lanes_two_columns(rows, more_rows, 0), z = lanes_two_columns(rows, more_rows, 2);
    out[0] = _mm512_cvtepi32_pd(_mm512_castsi512_si256(xy));
    out[1] = _mm512_cvtepi32_pd(_mm512_extracti64x4_epi64(xy, 1));
    out[2] = _mm512_cvtepi32_pd(_mm512_castsi512_si256(z));
}

LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], doubles out[4])
{
    __m512i rows = lanes_four_rows((const void *const *)from);
    __m512i more_rows = lanes_four_rows((const void *const *)from + 4);
    __m512i xy = lanes_two_columns(rows, more_rows, 0), zw = lanes_two_columns(rows, more_rows, 2);
    out[0] = _mm512_cvtps_pd((__m256)_mm512_castsi512_si256(xy));
    out[1] = _mm512_cvtps_pd((__m256)_mm512_extracti64x4_epi64(xy, 1));
    out[2] = _mm512_cvtps_pd((__m256)_mm512_castsi512_si256(zw));
    out[3] = _mm512_cvtps_pd((__m256)_mm512_extracti64x4_epi64(zw, 1));
}

LANES_INLINE void lanes_scatter(const doubles in[4], double *const to[LANE_COUNT])
{
    const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11);
    const __m512i high = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
    for (int odd = 0; odd < 2; odd++) {
        doubles first = odd ? _mm512_unpackhi_pd(in[0], in[1]) : _mm512_unpacklo_pd(in[0], in[1]);
        doubles last = odd ? _mm512_unpackhi_pd(in[2], in[3]) : _mm512_unpacklo_pd(in[2], in[3]);
        doubles a = _mm512_permutex2var_pd(first, low, last);
        doubles b = _mm512_permutex2var_pd(first, high, last);
        _mm256_storeu_pd(to[odd], _mm512_castpd512_pd256(a));
        _mm256_storeu_pd(to[odd + 2], _mm512_extractf64x4_pd(a, 1));
        _mm256_storeu_pd(to[odd + 4], _mm512_castpd512_pd256(b));
        _mm256_storeu_pd(to[odd + 6], _mm512_extractf64x4_pd(b, 1));
    }
}

LANES_INLINE void lanes_scatter_six(const doubles in[6], double *const to[LANE_COUNT])
{
    for (int odd = 0; odd < 2; odd++) {
        doubles pair[3];
        for (int k = 0; k < 3; k++)
            pair[k] = odd ? _mm512_unpackhi_pd(in[2 * k], in[2 * k + 1])
                          : _mm512_unpacklo_pd(in[2 * k], in[2 * k + 1]);
        doubles a = _mm512_shuffle_f64x2(pair[0], pair[1], 0x88);
        doubles b = _mm512_shuffle_f64x2(pair[0], pair[1], 0xdd);
        _mm512_storeu_pd(to[odd], _mm512_shuffle_f64x2(a, pair[2], 0x08));
        _mm512_storeu_pd(to[odd + 2], _mm512_shuffle_f64x2(b, pair[2], 0x18));
        _mm512_storeu_pd(to[odd + 4], _mm512_shuffle_f64x2(a, pair[2], 0x2d));
        _mm512_storeu_pd(to[odd + 6], _mm512_shuffle_f64x2(b, pair[2], 0x3d));
    }
}

#endif

/* ---- all instruction sets ---- */

#ifdef LANES_CALL
/* Returns a < b ? a : b for each lane; lanes_max(): a > b ? a : b. */
LANES_INLINE doubles lanes_min(doubles a, doubles b)
{
    return LANES_CALL(min_pd)(a, b);
}

LANES_INLINE doubles lanes_max(doubles a, doubles b)
{
    return LANES_CALL(max_pd)(a, b);
}

LANES_INLINE doubles lanes_sqrt(doubles x)
{
    return LANES_CALL(sqrt_pd)(x);
}
#else
LANES_INLINE doubles lanes_min(doubles a, doubles b)
{
    return lanes_select(a < b, a, b);
}

LANES_INLINE doubles lanes_max(doubles a, doubles b)
{
    return lanes_select(a > b, a, b);
}

LANES_INLINE doubles lanes_sqrt(doubles x)
{
    return (doubles){sqrt(x[0]), sqrt(x[1])};
}
#endif

/* Returns an empty mask. */
LANES_INLINE lane_mask lanes_none(void)
{
    return lanes_less(lanes_all(0.0), lanes_all(0.0));
}

#endif
