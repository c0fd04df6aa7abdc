/* lanes_two.h - lanes.h with two lanes, for any processor; and, with lanes_masked.h, what its
 * functions do. */
#ifndef VOX_VOXELIZE_LANES_LANES_TWO_H
#define VOX_VOXELIZE_LANES_LANES_TWO_H

#include "libvoxel/voxelize/lanes/lanes_masked.h"

/* Bit i: lane i of the mask. */
LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)(mask[0] & 1) | (unsigned)(mask[1] & 2);
}

LANES_INLINE lanes lanes_select(lane_mask mask, lanes yes, lanes no)
{
    return (lanes)((mask & (lane_ints)yes) | (~mask & (lane_ints)no));
}

/* a < b ? a : b */
LANES_INLINE lanes lanes_min(lanes a, lanes b)
{
#ifdef __SSE2__
    return _mm_min_pd(a, b);
#else
    return lanes_select(a < b, a, b);
#endif
}

/* a > b ? a : b */
LANES_INLINE lanes lanes_max(lanes a, lanes b)
{
#ifdef __SSE2__
    return _mm_max_pd(a, b);
#else
    return lanes_select(a > b, a, b);
#endif
}

LANES_INLINE lanes lanes_sqrt(lanes x)
{
    return (lanes){sqrt(x[0]), sqrt(x[1])};
}

/* Lane i of out[k] becomes from[i][k]. */
LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], lanes out[4])
{
    for (int k = 0; k < 4; k++)
        out[k] = (lanes){from[0][k], from[1][k]};
}

/* Lane i of out[k] becomes from[i][k]. from[i] has four readable numbers. */
LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], lanes out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (lanes){(double)from[0][k], (double)from[1][k]};
}

/* Lane i of out[k] becomes from[i][k]. */
LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], lanes out[4])
{
    for (int k = 0; k < 4; k++)
        out[k] = (lanes){(double)from[0][k], (double)from[1][k]};
}

/* to[i][k] becomes lane i of in[k]. */
LANES_INLINE void lanes_scatter(const lanes in[4], double *const to[LANE_COUNT])
{
    for (int k = 0; k < 4; k++) {
        to[0][k] = in[k][0];
        to[1][k] = in[k][1];
    }
}

/* The same of six; to[i] has room for eight. */
LANES_INLINE void lanes_scatter_six(const lanes in[6], double *const to[LANE_COUNT])
{
    for (int k = 0; k < 6; k++) {
        to[0][k] = in[k][0];
        to[1][k] = in[k][1];
    }
}

#endif
