/* floats.h - vectors of SIMD_FLOATS floats, and 32-bit integers and masks of the same width.
 *
 * SIMD_FLOATS is twice LANE_COUNT, unless the including source defines it before it includes
 * simd.h. A lane of a mask has all bits set, or none, whatever the instruction set. */
#ifndef BSQ_SIMD_FLOATS_H
#define BSQ_SIMD_FLOATS_H

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
