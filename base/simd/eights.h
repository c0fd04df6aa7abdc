/* eights.h - vectors of eight floats for any instruction set, for code whose width is fixed: a node
 * of a tree has eight children. Functions that take or return `eights` are inlined, because their
 * calling convention depends on the instruction set. */
#ifndef BSQ_SIMD_EIGHTS_H
#define BSQ_SIMD_EIGHTS_H

#include <string.h>

#include "base/simd/lanes.h"
#include "base/simd/rows.h"

typedef float eights __attribute__((vector_size(32)));
typedef int32_t eight_ints __attribute__((vector_size(32)));

/* Without AVX, compilers compare vectors of eight one value at a time, so these are halved. */
#ifndef __AVX2__
/* Shuffles of the compiler would take them apart value by value. */
union eights_halves {
    eights all;
    four_floats half[2];
};
#define EIGHTS_HALF(v, h)      ((union eights_halves){v}.half[h])
#define EIGHTS_JOIN(low, high) ((union eights_halves){.half = {low, high}}.all)

LANES_INLINE uint32_t eights_half_not_above(four_floats a, four_floats b)
{
#ifdef __SSE2__
    return (uint32_t)_mm_movemask_ps(_mm_cmple_ps(a, b));
#else
    const four_ints bits = (a <= b) & (four_ints){1, 2, 4, 8};
    return (uint32_t)(bits[0] | bits[1] | bits[2] | bits[3]);
#endif
}
#endif

/* Returns eight times the same value. Without AVX, the operators on a vector and a number
 * copy the number by way of memory, which takes much longer. */
LANES_INLINE eights eights_splat(float f)
{
#ifdef __AVX2__
    return _mm256_set1_ps(f);
#else
    const four_floats half = f - (four_floats){0};
    return EIGHTS_JOIN(half, half);
#endif
}

/* Returns four values and four more. */
LANES_INLINE eights eights_join(four_floats low, four_floats high)
{
#ifdef __AVX2__
    return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
#else
    return EIGHTS_JOIN(low, high);
#endif
}

/* Converts eight bytes. */
LANES_INLINE eights eights_of_bytes(const uint8_t bytes[8])
{
#ifdef __AVX2__
    const __m128i words = _mm_loadl_epi64((const __m128i *)(const void *)bytes);
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(words));
#elif defined __SSE4_1__
    const __m128i words = _mm_loadl_epi64((const __m128i *)(const void *)bytes);
    const four_floats low = _mm_cvtepi32_ps(_mm_cvtepu8_epi32(words));
    const four_floats high = _mm_cvtepi32_ps(_mm_cvtepu8_epi32(_mm_srli_si128(words, 4)));
    return EIGHTS_JOIN(low, high);
#else
    eights all = {0};
    for (int i = 0; i < 8; i++)
        all[i] = bytes[i];
    return all;
#endif
}

/* eights_min() returns a < b ? a : b for each value, eights_max() a > b ? a : b. */
LANES_INLINE eights eights_min(eights a, eights b)
{
#ifdef __AVX2__
    return _mm256_min_ps(a, b);
#else
    return EIGHTS_JOIN(four_floats_min(EIGHTS_HALF(a, 0), EIGHTS_HALF(b, 0)),
                       four_floats_min(EIGHTS_HALF(a, 1), EIGHTS_HALF(b, 1)));
#endif
}

LANES_INLINE eights eights_max(eights a, eights b)
{
#ifdef __AVX2__
    return _mm256_max_ps(a, b);
#else
    return EIGHTS_JOIN(four_floats_max(EIGHTS_HALF(a, 0), EIGHTS_HALF(b, 0)),
                       four_floats_max(EIGHTS_HALF(a, 1), EIGHTS_HALF(b, 1)));
#endif
}

/* Returns bit i if a[i] <= b[i]. */
LANES_INLINE uint32_t eights_not_above(eights a, eights b)
{
#if defined __AVX512VL__ && defined __AVX512F__
    return _mm256_cmp_ps_mask(a, b, _CMP_LE_OQ);
#elif defined __AVX2__
    return (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_LE_OQ));
#else
    return eights_half_not_above(EIGHTS_HALF(a, 0), EIGHTS_HALF(b, 0)) |
           eights_half_not_above(EIGHTS_HALF(a, 1), EIGHTS_HALF(b, 1)) << 4;
#endif
}

/* Stores base + i for each bit i that is set, in ascending order. May write all eight values; those
 * after the stored ones are arbitrary. */
LANES_INLINE void eights_store_set(uint32_t bits, uint32_t base, uint32_t to[8])
{
#if defined __AVX512VL__ && defined __AVX512F__
    const __m256i all =
        _mm256_add_epi32(_mm256_set1_epi32((int)base), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
    _mm256_storeu_si256((__m256i *)(void *)to, _mm256_maskz_compress_epi32((__mmask8)bits, all));
#elif defined __BMI2__ && defined __AVX2__
    const uint64_t chosen = _pdep_u64(bits, 0x0101010101010101u) * 0xff;
    const uint64_t packed = _pext_u64(0x0706050403020100u, chosen);
    const __m256i numbers = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)packed));
    _mm256_storeu_si256((__m256i *)(void *)to,
                        _mm256_add_epi32(_mm256_set1_epi32((int)base), numbers));
#else
    uint32_t count = 0;
    for (uint32_t i = 0; i < 8; i++) {
        to[count] = base + i;
        count += bits >> i & 1;
    }
#endif
}

#endif
