/* lanes_masked.h - masks for processors without mask registers: each lane of a mask has all bits
 * set, or none. */
#ifndef BSQ_SIMD_LANES_MASKED_H
#define BSQ_SIMD_LANES_MASKED_H

typedef lane_ints lane_mask;

LANES_INLINE lane_mask lanes_less(doubles a, doubles b)
{
    return a < b;
}

LANES_INLINE lane_mask lanes_equal(doubles a, doubles b)
{
    return a == b;
}

/* Returns the lanes whose sign bit is set; -0 has it too. */
LANES_INLINE lane_mask lanes_signs(doubles x)
{
    return (lane_ints)x < 0;
}

/* Returns x in lanes whose mask is set, 0 in the others. */
LANES_INLINE doubles lanes_keep(lane_mask mask, doubles x)
{
    return (doubles)(mask & (lane_ints)x);
}

/* Returns x | bits in lanes whose mask is set, x in the others. */
LANES_INLINE lane_ints lanes_set_bits(lane_mask mask, lane_ints x, lane_ints bits)
{
    return x | (mask & bits);
}

/* Returns x + y in lanes whose mask is set, x in the others. */
LANES_INLINE lane_ints lanes_add_ints(lane_mask mask, lane_ints x, lane_ints y)
{
    return x + (mask & y);
}

LANES_INLINE doubles lanes_abs(doubles x)
{
    return (doubles)((lane_ints)x & INT64_MAX);
}

#endif
