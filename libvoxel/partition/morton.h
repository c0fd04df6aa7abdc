/* morton.h - Morton (Z-order) keys of points: three coordinates of 21 bits, interleaved.
 *
 * The highest bit triple of a key is the octant of the cube, the next one the octant in it, and so
 * on; the first 3 n bits of a key name the cell of a grid of 2^n cells an axis. */
#ifndef VOX_PARTITION_MORTON_H
#define VOX_PARTITION_MORTON_H

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

/* Cells of a point. Points outside of the cube count as on its border. */
static inline void morton_cells(const struct morton_cube *cube, const float *p, uint32_t cell[3])
{
    const double last = (double)((1u << MORTON_AXIS_BITS) - 1);
#ifdef __SSE2__
    const __m128d scale = _mm_set1_pd(cube->scale), most = _mm_set1_pd(last);
    __m128d xy = _mm_cvtps_pd(_mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)(const void *)p)));
    __m128d z = _mm_cvtps_pd(_mm_load_ss(p + 2));
    xy = _mm_mul_pd(_mm_sub_pd(xy, _mm_loadu_pd(cube->min)), scale);
    z = _mm_mul_pd(_mm_sub_pd(z, _mm_load_sd(cube->min + 2)), scale);
    xy = _mm_min_pd(_mm_max_pd(xy, _mm_setzero_pd()), most);
    z = _mm_min_pd(_mm_max_pd(z, _mm_setzero_pd()), most);
    _mm_storel_epi64((__m128i *)(void *)cell, _mm_cvttpd_epi32(xy));
    cell[2] = (uint32_t)_mm_cvtsi128_si32(_mm_cvttpd_epi32(z));
#else
    for (int axis = 0; axis < 3; axis++) {
        double at = ((double)p[axis] - cube->min[axis]) * cube->scale;
        at = at < 0.0 ? 0.0 : at;
        at = at > last ? last : at;
        cell[axis] = (uint32_t)(int32_t)at;
    }
#endif
}

/* The first 3 * levels bits of a point's key; levels at most 5. */
static inline uint32_t morton_cell(const struct morton_cube *cube, uint32_t levels, const float *p)
{
    uint32_t cell[3] = {0}; /* for checkers that do not know what vectors store */
    morton_cells(cube, p, cell);
    for (int k = 0; k < 3; k++)
        cell[k] >>= MORTON_AXIS_BITS - levels;
    return morton_short_key(cell);
}

/* The key of a point. */
static inline uint64_t morton_point_key(const struct morton_cube *cube, const float *p)
{
    uint32_t cell[3] = {0}; /* for checkers that do not know what vectors store */
    morton_cells(cube, p, cell);
    return morton_key(cell);
}

#endif
