/* eights.h - vectors of eight floats for any instruction set, for code whose width is fixed: a node
 * of a tree has eight children. Functions that take or return `eights` are inlined, because their
 * calling convention depends on the instruction set. */
#ifndef BSQ_SIMD_EIGHTS_H
#define BSQ_SIMD_EIGHTS_H

#include <string.h>

#include "base/simd/lanes.h"

typedef float eights __attribute__((vector_size(32)));
typedef int32_t eight_ints __attribute__((vector_size(32)));

LANES_INLINE eights eights_splat(float f)
{
    return f - (eights){0};
}

/* Converts eight bytes. */
LANES_INLINE eights eights_of_bytes(const uint8_t bytes[8])
{
#ifdef __AVX2__
    const __m128i words = _mm_loadl_epi64((const __m128i *)(const void *)bytes);
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(words));
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
    const eight_ints less = a < b;
    return (eights)((less & (eight_ints)a) | (~less & (eight_ints)b));
#endif
}

LANES_INLINE eights eights_max(eights a, eights b)
{
#ifdef __AVX2__
    return _mm256_max_ps(a, b);
#else
    const eight_ints more = a > b;
    return (eights)((more & (eight_ints)a) | (~more & (eight_ints)b));
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
    const eight_ints mask = a <= b;
    uint32_t bits = 0;
    for (int i = 0; i < 8; i++)
        bits |= ((uint32_t)mask[i] & 1) << i;
    return bits;
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
