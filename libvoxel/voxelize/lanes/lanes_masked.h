/* lanes_masked.h - what of lanes.h needs masks that are lanes themselves: all bits set, or none.
 * For processors without registers for masks. */
#ifndef VOX_VOXELIZE_LANES_LANES_MASKED_H
#define VOX_VOXELIZE_LANES_LANES_MASKED_H

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

LANES_INLINE lanes lanes_abs(lanes x)
{
    return (lanes)((lane_ints)x & INT64_MAX);
}

#endif
