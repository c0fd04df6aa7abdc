/* morton.h - Morton (Z-order) keys of points: three coordinates of 21 bits, interleaved.
 *
 * The highest bit triple of a key is the octant of the cube, the next one the octant in it, and so
 * on; the first 3 n bits of a key name the cell of a grid of 2^n cells an axis. */
#ifndef VOX_MORTON_H
#define VOX_MORTON_H

#include <stdint.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

#define MORTON_AXIS_BITS 21
#define MORTON_KEY_BITS  63

/* Spreads the low 21 bits so that two zero bits follow each. Here and below x and y go side by side
 * where the compiler knows SSE2, with the same results. */
static inline uint64_t morton_spread(uint64_t x)
{
    x = (x | x << 32) & 0x001f00000000ffffu;
    x = (x | x << 16) & 0x001f0000ff0000ffu;
    x = (x | x << 8) & 0x100f00f00f00f00fu;
    x = (x | x << 4) & 0x10c30c30c30c30c3u;
    return (x | x << 2) & 0x1249249249249249u;
}

static inline uint64_t morton_key(const uint32_t cell[3])
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
    return (uint64_t)_mm_cvtsi128_si64(two) | morton_spread(cell[2]);
#else
    return morton_spread(cell[0]) << 2 | morton_spread(cell[1]) << 1 | morton_spread(cell[2]);
#endif
}

/* The same of coordinates below 32. */
static inline uint32_t morton_short_key(const uint32_t cell[3])
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

/* A cube with 2^21 cells an axis over the bounds of a scan. */
struct morton_cube {
    double min[3];
    double scale; /* cells per unit of length; 0 where the bounds are a point */
};

/* max >= min */
static inline struct morton_cube morton_cube_over(const float min[3], const float max[3])
{
    struct morton_cube cube = {{min[0], min[1], min[2]}, 0.0};
    double side = 0.0;
    for (int axis = 0; axis < 3; axis++)
        if ((double)max[axis] - min[axis] > side)
            side = (double)max[axis] - min[axis];
    if (side > 0.0)
        cube.scale = (double)(1u << MORTON_AXIS_BITS) / side;
    return cube;
}

#ifdef __SSE2__
/* A cube's cells of two sums of three coordinates each. */
static inline __m128i morton_two_cells(__m128d sums, __m128d min, __m128d scale)
{
    const __m128d last = _mm_set1_pd((double)((1u << MORTON_AXIS_BITS) - 1));
    __m128d at = _mm_sub_pd(_mm_mul_pd(sums, _mm_set1_pd(1.0 / 3.0)), min);
    at = _mm_max_pd(_mm_mul_pd(at, scale), _mm_setzero_pd());
    return _mm_cvttpd_epi32(_mm_min_pd(at, last));
}

static inline __m128d morton_two(const float *p)
{
    return _mm_cvtps_pd(_mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)(const void *)p)));
}

static inline __m128d morton_one(const float *p)
{
    return _mm_cvtps_pd(_mm_load_ss(p));
}
#endif

/* Cells of a triangle's centroid. Points outside of the cube count as on its border. */
static inline void morton_cells(const struct morton_cube *cube, const float *a, const float *b,
                                const float *c, uint32_t cell[3])
{
#ifdef __SSE2__
    const __m128d scale = _mm_set1_pd(cube->scale);
    __m128d xy = _mm_add_pd(_mm_add_pd(morton_two(a), morton_two(b)), morton_two(c));
    __m128d z = _mm_add_pd(_mm_add_pd(morton_one(a + 2), morton_one(b + 2)), morton_one(c + 2));
    __m128i two = morton_two_cells(xy, _mm_loadu_pd(cube->min), scale);
    _mm_storel_epi64((__m128i *)(void *)cell, two);
    cell[2] = (uint32_t)_mm_cvtsi128_si32(morton_two_cells(z, _mm_load_sd(cube->min + 2), scale));
#else
    const double last = (double)((1u << MORTON_AXIS_BITS) - 1);
    for (int axis = 0; axis < 3; axis++) {
        double centre = ((double)a[axis] + b[axis] + c[axis]) * (1.0 / 3.0);
        double at = (centre - cube->min[axis]) * cube->scale;
        at = at < 0.0 ? 0.0 : at;
        at = at > last ? last : at;
        cell[axis] = (uint32_t)(int32_t)at;
    }
#endif
}

#endif
