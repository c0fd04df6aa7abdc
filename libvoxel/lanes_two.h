/* lanes_two.h - lanes.h with two lanes, for any processor; and what its functions do. */
#ifndef VOX_LANES_TWO_H
#define VOX_LANES_TWO_H

typedef lane_ints lane_mask;

LANES_INLINE lane_mask lanes_less(lanes a, lanes b)
{
    return a < b;
}

LANES_INLINE lane_mask lanes_equal(lanes a, lanes b)
{
    return a == b;
}

/* Where the sign is set, that of zero too. */
LANES_INLINE lane_mask lanes_signs(lanes x)
{
    return (lane_ints)x < 0;
}

/* Bit i: lane i of the mask. */
LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)(mask[0] & 1) | (unsigned)(mask[1] & 2);
}

/* x where the mask is set, 0 elsewhere */
LANES_INLINE lanes lanes_keep(lane_mask mask, lanes x)
{
    return (lanes)(mask & (lane_ints)x);
}

/* x | bits where the mask is set, x elsewhere */
LANES_INLINE lane_ints lanes_set_bits(lane_mask mask, lane_ints x, lane_ints bits)
{
    return x | (mask & bits);
}

/* x + y where the mask is set, x elsewhere */
LANES_INLINE lane_ints lanes_add_ints(lane_mask mask, lane_ints x, lane_ints y)
{
    return x + (mask & y);
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

LANES_INLINE lanes lanes_abs(lanes x)
{
    return (lanes)((lane_ints)x & INT64_MAX);
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
