/* morton.h - Morton (Z-order) keys of points in a scan's bounding cube. */
#ifndef VOX_PARTITION_MORTON_H
#define VOX_PARTITION_MORTON_H

#ifdef __SSE2__
#include <emmintrin.h>
#endif

#include "base/geometry/space_curve.h"

#define MORTON_AXIS_BITS 21
#define MORTON_KEY_BITS  63

/* A cube of 2^21 cells along each axis, with the scan's minimum as its corner. */
struct morton_cube {
    double min[3];
    double scale; /* cells per unit of length; 0 if the bounds are a point */
};

/* Returns the cube of these bounds; max >= min. */
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

/* Finds the cell of a point. Points outside of the cube are clamped into its border cells. */
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

/* Returns the first 3 * levels bits of a point's key; levels <= 5. */
static inline uint32_t morton_cell(const struct morton_cube *cube, uint32_t levels, const float *p)
{
    uint32_t cell[3] = {0}; /* for static analysers, which miss vector stores */
    morton_cells(cube, p, cell);
    for (int k = 0; k < 3; k++)
        cell[k] >>= MORTON_AXIS_BITS - levels;
    return bsq_morton_short_key(cell);
}

/* Returns the key of a point, of MORTON_KEY_BITS bits. */
static inline uint64_t morton_point_key(const struct morton_cube *cube, const float *p)
{
    uint32_t cell[3] = {0}; /* for static analysers, which miss vector stores */
    morton_cells(cube, p, cell);
    return bsq_morton_key(cell);
}

#endif
