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

/* Loads the four words at an offset of bytes from each of SIMD_FLOATS places: word w of place i
 * becomes lane i of out[w]. */
LANES_INLINE void floats_load_rows(const void *const from[SIMD_FLOATS], size_t offset,
                                   floats out[4])
{
#if defined FLOATS_CALL
    floats rows[4]; /* places r, r + 4, ... */
    for (int r = 0; r < 4; r++) {
#define FLOATS_FOUR(i) _mm_loadu_ps((const float *)((const char *)from[r + 4 * (i)] + offset))
#if SIMD_FLOATS == 4
        rows[r] = FLOATS_FOUR(0);
#define FLOATS_INDICES(a, b, c, d) a, b, c, d
#else
        const __m256 low =
            _mm256_insertf128_ps(_mm256_castps128_ps256(FLOATS_FOUR(0)), FLOATS_FOUR(1), 1);
#define FLOATS_INDICES_8(a, b, c, d) a, b, c, d, (a) + 4, (b) + 4, (c) + 4, (d) + 4
#if SIMD_FLOATS == 8
        rows[r] = low;
#define FLOATS_INDICES(a, b, c, d) FLOATS_INDICES_8(a, b, c, d)
#else
        rows[r] = _mm512_insertf32x4(
            _mm512_insertf32x4(_mm512_castps256_ps512(low), FLOATS_FOUR(2), 2), FLOATS_FOUR(3), 3);
#define FLOATS_INDICES(a, b, c, d)                                                                 \
    FLOATS_INDICES_8(a, b, c, d), FLOATS_INDICES_8((a) + 8, (b) + 8, (c) + 8, (d) + 8)
#endif
#endif
    }
#define FLOATS_MIX(x, y, a, b, c, d) __builtin_shufflevector(x, y, FLOATS_INDICES(a, b, c, d))
    enum { Y = SIMD_FLOATS };
    const floats low01 = FLOATS_MIX(rows[0], rows[1], 0, Y + 0, 1, Y + 1);
    const floats low23 = FLOATS_MIX(rows[2], rows[3], 0, Y + 0, 1, Y + 1);
    const floats high01 = FLOATS_MIX(rows[0], rows[1], 2, Y + 2, 3, Y + 3);
    const floats high23 = FLOATS_MIX(rows[2], rows[3], 2, Y + 2, 3, Y + 3);
    out[0] = FLOATS_MIX(low01, low23, 0, 1, Y + 0, Y + 1);
    out[1] = FLOATS_MIX(low01, low23, 2, 3, Y + 2, Y + 3);
    out[2] = FLOATS_MIX(high01, high23, 0, 1, Y + 0, Y + 1);
    out[3] = FLOATS_MIX(high01, high23, 2, 3, Y + 2, Y + 3);
#else
    for (int i = 0; i < SIMD_FLOATS; i++) {
        float words[4];
        memcpy(words, (const char *)from[i] + offset, sizeof words);
        for (int w = 0; w < 4; w++)
            out[w][i] = words[w];
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
