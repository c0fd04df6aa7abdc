/* space_curve.h - numbers the cells of a cube along curves that keep neighbours close together. */
#ifndef BSQ_SPACE_CURVE_H
#define BSQ_SPACE_CURVE_H

#include <stdint.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

/* ---- the Z-order curve: Morton keys ----
 *
 * A key interleaves the bits of three coordinates. Its highest bit triple is the octant of the
 * cube, with x in the highest bit; the next one is the octant in that octant, and so on. So the
 * first 3 n bits of a key name a cell of a grid of 2^n cells an axis. */

/* Spreads the low 21 bits so that two zero bits follow each. */
static inline uint64_t bsq_morton_spread(uint64_t x)
{
    x = (x | x << 32) & 0x001f00000000ffffu;
    x = (x | x << 16) & 0x001f0000ff0000ffu;
    x = (x | x << 8) & 0x100f00f00f00f00fu;
    x = (x | x << 4) & 0x10c30c30c30c30c3u;
    return (x | x << 2) & 0x1249249249249249u;
}

/* Returns the key of a cell with coordinates below 2^21. With SSE2 it spreads x and y side by side;
 * the result is the same. */
static inline uint64_t bsq_morton_key(const uint32_t cell[3])
{
#ifdef __SSE2__
    __m128i two = _mm_loadl_epi64((const __m128i *)(const void *)cell);
    two = _mm_unpacklo_epi32(two, _mm_setzero_si128());
    two = _mm_or_si128(two, _mm_slli_epi64(two, 32));
    two = _mm_and_si128(two, _mm_set1_epi64x(0x001f00000000ffff));
    two = _mm_or_si128(two, _mm_slli_epi64(two, 16));
    two = _mm_and_si128(two, _mm_set1_epi64x(0x001f0000ff0000ff));
    two = _mm_or_si128(two, _mm_slli_epi64(two, 8));
    two = _mm_and_si128(two, _mm_set1_epi64x(0x100f00f00f00f00f));
    two = _mm_or_si128(two, _mm_slli_epi64(two, 4));
    two = _mm_and_si128(two, _mm_set1_epi64x(0x10c30c30c30c30c3));
    two = _mm_or_si128(two, _mm_slli_epi64(two, 2));
    two = _mm_and_si128(two, _mm_set1_epi64x(0x1249249249249249));
    /* x goes two places up and y one. */
    two = _mm_slli_epi64(two, 1);
    two = _mm_or_si128(_mm_add_epi64(two, two), _mm_unpackhi_epi64(two, two));
    return (uint64_t)_mm_cvtsi128_si64(two) | bsq_morton_spread(cell[2]);
#else
    return bsq_morton_spread(cell[0]) << 2 | bsq_morton_spread(cell[1]) << 1 |
           bsq_morton_spread(cell[2]);
#endif
}

/* Returns the same key for coordinates below 32, from a table. */
static inline uint32_t bsq_morton_short_key(const uint32_t cell[3])
{
#define SPREAD2(x) (x), (x) + 1
#define SPREAD4(x) SPREAD2(x), SPREAD2((x) + 8)
#define SPREAD8(x) SPREAD4(x), SPREAD4((x) + 64)
    static const uint16_t spread[32] = {SPREAD8(0), SPREAD8(512), SPREAD8(4096), SPREAD8(4608)};
#undef SPREAD2
#undef SPREAD4
#undef SPREAD8
    return (uint32_t)spread[cell[0]] << 2 | (uint32_t)spread[cell[1]] << 1 | spread[cell[2]];
}

/* ---- Hilbert's curve ---- */

/* Returns the place on Hilbert's curve of a cell with coordinates below 2^bits; bits <= 21. Any two
 * cells that follow each other on the curve share a face. */
uint64_t bsq_hilbert_place(const uint32_t cell[3], unsigned bits);

#endif
