/* lanes_two.h - two lanes, for any processor. The comments here and in lanes_masked.h hold for the
 * functions of the same names in lanes_avx2.h and lanes_avx512.h. */
#ifndef BSQ_SIMD_LANES_TWO_H
#define BSQ_SIMD_LANES_TWO_H

#include "base/simd/lanes_masked.h"

/* Returns bit i for lane i of the mask. */
LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)(mask[0] & 1) | (unsigned)(mask[1] & 2);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return (doubles)((mask & (lane_ints)yes) | (~mask & (lane_ints)no));
}

/* Returns a < b ? a : b. */
LANES_INLINE doubles lanes_min(doubles a, doubles b)
{
#ifdef __SSE2__
    return _mm_min_pd(a, b);
#else
    return lanes_select(a < b, a, b);
#endif
}

/* Returns a > b ? a : b. */
LANES_INLINE doubles lanes_max(doubles a, doubles b)
{
#ifdef __SSE2__
    return _mm_max_pd(a, b);
#else
    return lanes_select(a > b, a, b);
#endif
}

LANES_INLINE doubles lanes_sqrt(doubles x)
{
    return (doubles){sqrt(x[0]), sqrt(x[1])};
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

#endif
