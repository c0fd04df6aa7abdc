/* floats.h - vectors of SIMD_FLOATS floats, and 32-bit integers and masks of the same width.
 *
 * SIMD_FLOATS is twice LANE_COUNT, unless the including source defines it before it includes
 * simd.h. A lane of a mask has all bits set, or none, whatever the instruction set. */
#ifndef BSQ_SIMD_FLOATS_H
#define BSQ_SIMD_FLOATS_H

#include <stddef.h>
#include <string.h>

#include "base/simd/lanes.h"

#ifndef SIMD_FLOATS
#define SIMD_FLOATS (2 * LANE_COUNT)
#endif

typedef float floats __attribute__((vector_size(4 * SIMD_FLOATS)));
typedef int32_t float_ints __attribute__((vector_size(4 * SIMD_FLOATS)));

/* Compilers do not find these instructions by themselves. */
#if SIMD_FLOATS == 4 && defined __SSE4_1__
#define FLOATS_CALL(name) _mm_##name
typedef __m128i floats_bits_register;
#elif SIMD_FLOATS == 8 && defined __AVX2__
#define FLOATS_CALL(name) _mm256_##name
typedef __m256i floats_bits_register;
#elif SIMD_FLOATS == 16 && defined __AVX512DQ__
#define FLOATS_CALL(name) _mm512_##name
typedef __m512i floats_bits_register;
#endif

/* Returns mask ? a : b for each lane. */
LANES_INLINE floats floats_select(float_ints mask, floats a, floats b)
{
#if !defined FLOATS_CALL
    return (floats)((mask & (float_ints)a) | (~mask & (float_ints)b));
#elif SIMD_FLOATS == 16
    return _mm512_mask_blend_ps(_mm512_movepi32_mask((__m512i)mask), b, a);
#else
    return FLOATS_CALL(blendv_ps)(b, a, (floats)mask);
#endif
}

/* floats_min() returns a < b ? a : b for each lane, floats_max() a > b ? a : b. */
#ifdef FLOATS_CALL
LANES_INLINE floats floats_min(floats a, floats b)
{
    return FLOATS_CALL(min_ps)(a, b);
}
LANES_INLINE floats floats_max(floats a, floats b)
{
    return FLOATS_CALL(max_ps)(a, b);
}
LANES_INLINE float_ints floats_min_ints(float_ints a, float_ints b)
{
    return (float_ints)FLOATS_CALL(min_epi32)((floats_bits_register)a, (floats_bits_register)b);
}
LANES_INLINE float_ints floats_max_ints(float_ints a, float_ints b)
{
    return (float_ints)FLOATS_CALL(max_epi32)((floats_bits_register)a, (floats_bits_register)b);
}
LANES_INLINE floats floats_sqrt(floats x)
{
    return FLOATS_CALL(sqrt_ps)(x);
}
LANES_INLINE floats floats_floor(floats x)
{
#if SIMD_FLOATS == 16
    return _mm512_roundscale_ps(x, 9);
#else
    return FLOATS_CALL(floor_ps)(x);
#endif
}
#else
LANES_INLINE floats floats_min(floats a, floats b)
{
    return floats_select(a < b, a, b);
}
LANES_INLINE floats floats_max(floats a, floats b)
{
    return floats_select(a > b, a, b);
}
LANES_INLINE float_ints floats_min_ints(float_ints a, float_ints b)
{
    return (float_ints)floats_select(a < b, (floats)a, (floats)b);
}
LANES_INLINE float_ints floats_max_ints(float_ints a, float_ints b)
{
    return (float_ints)floats_select(a > b, (floats)a, (floats)b);
}
LANES_INLINE floats floats_sqrt(floats x)
{
    for (int i = 0; i < SIMD_FLOATS; i++)
        x[i] = sqrtf(x[i]);
    return x;
}
LANES_INLINE floats floats_floor(floats x)
{
    for (int i = 0; i < SIMD_FLOATS; i++)
        x[i] = floorf(x[i]);
    return x;
}
#endif

LANES_INLINE floats floats_abs(floats x)
{
    return (floats)((float_ints)x & INT32_MAX);
}

/* Returns bit i for lane i of the mask. */
LANES_INLINE uint32_t floats_bits(float_ints mask)
{
#if SIMD_FLOATS == 4 && defined __SSE4_1__
    return (uint32_t)_mm_movemask_ps((__m128)mask);
#elif SIMD_FLOATS == 8 && defined __AVX2__
    return (uint32_t)_mm256_movemask_ps((__m256)mask);
#elif SIMD_FLOATS == 16 && defined __AVX512DQ__
    return (uint32_t)_mm512_movepi32_mask((__m512i)mask);
#else
    uint32_t bits = 0;
    for (int i = 0; i < SIMD_FLOATS; i++)
        bits |= ((uint32_t)mask[i] & 1u) << i;
    return bits;
#endif
}

/* Returns the mask that has lane i set for bit i. */
LANES_INLINE float_ints floats_mask_of(uint32_t bits)
{
#if SIMD_FLOATS == 16 && defined __AVX512DQ__
    return (float_ints)_mm512_movm_epi32((__mmask16)bits);
#else
    float_ints each = {0};
    for (int i = 0; i < SIMD_FLOATS; i++)
        each[i] = 1 << i;
    return (each & (int32_t)bits) != 0;
#endif
}

/* Rows are four words of each of SIMD_FLOATS places in memory. Word w of place i is lane i of
 * vector w. */
#if defined FLOATS_CALL || SIMD_FLOATS == 4
#if SIMD_FLOATS == 4
#define FLOATS_INDICES(a, b, c, d) a, b, c, d
#elif SIMD_FLOATS == 8
#define FLOATS_INDICES(a, b, c, d) a, b, c, d, (a) + 4, (b) + 4, (c) + 4, (d) + 4
#else
#define FLOATS_INDICES(a, b, c, d)                                                                 \
    a, b, c, d, (a) + 4, (b) + 4, (c) + 4, (d) + 4, (a) + 8, (b) + 8, (c) + 8, (d) + 8, (a) + 12,  \
        (b) + 12, (c) + 12, (d) + 12
#endif
/* Takes four words for each four lanes, as _mm_shuffle_ps() does: those of y are 4 to 7. */
#define FLOATS_MIX(x, y, a, b, c, d)                                                               \
    __builtin_shufflevector(                                                                       \
        x, y,                                                                                      \
        FLOATS_INDICES((a) < 4 ? (a) : (a)-4 + SIMD_FLOATS, (b) < 4 ? (b) : (b)-4 + SIMD_FLOATS,   \
                       (c) < 4 ? (c) : (c)-4 + SIMD_FLOATS, (d) < 4 ? (d) : (d)-4 + SIMD_FLOATS))

/* Transposes each four lanes of four vectors. */
LANES_INLINE void floats_transpose_fours(floats v[4])
{
    const floats low01 = FLOATS_MIX(v[0], v[1], 0, 4, 1, 5);
    const floats low23 = FLOATS_MIX(v[2], v[3], 0, 4, 1, 5);
    const floats high01 = FLOATS_MIX(v[0], v[1], 2, 6, 3, 7);
    const floats high23 = FLOATS_MIX(v[2], v[3], 2, 6, 3, 7);
    v[0] = FLOATS_MIX(low01, low23, 0, 1, 4, 5);
    v[1] = FLOATS_MIX(low01, low23, 2, 3, 6, 7);
    v[2] = FLOATS_MIX(high01, high23, 0, 1, 4, 5);
    v[3] = FLOATS_MIX(high01, high23, 2, 3, 6, 7);
}
#endif

/* Loads the rows at an offset of bytes from these places. */
LANES_INLINE void floats_load_rows(const void *const from[SIMD_FLOATS], size_t offset,
                                   floats out[4])
{
#if SIMD_FLOATS == 4
    for (int r = 0; r < 4; r++)
        memcpy(&out[r], (const char *)from[r] + offset, sizeof out[r]);
    floats_transpose_fours(out);
#elif defined FLOATS_CALL
    for (int r = 0; r < 4; r++) { /* places r, r + 4, ... */
#define FLOATS_ROW(i) _mm_loadu_ps((const float *)((const char *)from[r + 4 * (i)] + offset))
        const __m256 low =
            _mm256_insertf128_ps(_mm256_castps128_ps256(FLOATS_ROW(0)), FLOATS_ROW(1), 1);
#if SIMD_FLOATS == 8
        out[r] = low;
#else
        out[r] = _mm512_insertf32x4(
            _mm512_insertf32x4(_mm512_castps256_ps512(low), FLOATS_ROW(2), 2), FLOATS_ROW(3), 3);
#endif
#undef FLOATS_ROW
    }
    floats_transpose_fours(out);
#else
    for (int i = 0; i < SIMD_FLOATS; i++) {
        float words[4];
        memcpy(words, (const char *)from[i] + offset, sizeof words);
        for (int w = 0; w < 4; w++)
            out[w][i] = words[w];
    }
#endif
}

/* Stores rows at an offset of bytes from these places, in their order. */
LANES_INLINE void floats_store_rows(void *const to[SIMD_FLOATS], size_t offset, floats a, floats b,
                                    floats c, floats d)
{
    floats rows[4] = {a, b, c, d};
#if defined FLOATS_CALL || SIMD_FLOATS == 4
    floats_transpose_fours(rows);
    for (int i = 0; i < SIMD_FLOATS; i++)
        memcpy((char *)to[i] + offset, (const char *)&rows[i % 4] + 16 * (i / 4), 16);
#else
    for (int i = 0; i < SIMD_FLOATS; i++) {
        float words[4];
        for (int w = 0; w < 4; w++)
            words[w] = rows[w][i];
        memcpy((char *)to[i] + offset, words, sizeof words);
    }
#endif
}

/* Returns the 32-bit words at indices that are not negative. Defined only if the processor has an
 * instruction for it. */
#if SIMD_FLOATS == 8 && defined __AVX2__
#define floats_gather(words, index)                                                                \
    ((float_ints)_mm256_i32gather_epi32((const int *)(const void *)(words), (__m256i)(index), 4))
#elif SIMD_FLOATS == 16 && defined __AVX512DQ__
#define floats_gather(words, index)                                                                \
    ((float_ints)_mm512_i32gather_epi32((__m512i)(index), (const void *)(words), 4))
#endif

#endif
