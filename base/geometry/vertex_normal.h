/* vertex_normal.h - the normal of a vertex, and how far the surface rises above it, in 64 bits.
 *
 * Bits 0 to 21 and 22 to 43 are x and y of the unfolded octahedron (base/geometry/vec.h), each plus
 * 2^21, in units of 1 / (2^21 - 1). Bits 44 to 63 are the upper bits of the rise as a float. A
 * normal errs by at most 0.00003 degrees, a rise by 1/8192 of it. */
#ifndef BSQ_VERTEX_NORMAL_H
#define BSQ_VERTEX_NORMAL_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

enum { BSQ_VERTEX_NORMAL_BITS = 22, BSQ_VERTEX_RISE_SHIFT = 2 * BSQ_VERTEX_NORMAL_BITS };

/* A vertex for whose triangles no normal stands. */
#define BSQ_VERTEX_NORMAL_NONE UINT64_C(0)

/* Returns a coordinate from its bits. */
static inline float bsq_vertex_normal_coordinate(uint64_t packed)
{
    const int32_t zero = 1 << (BSQ_VERTEX_NORMAL_BITS - 1), mask = 2 * zero - 1;
    return (float)((int32_t)((uint32_t)packed & (uint32_t)mask) - zero) / (float)(zero - 1);
}

/* Unpacks a unit normal, or zero without one. Any value is valid. */
static inline void bsq_vertex_normal_unpack(uint64_t packed, float normal[3])
{
    float x = bsq_vertex_normal_coordinate(packed);
    float y = bsq_vertex_normal_coordinate(packed >> BSQ_VERTEX_NORMAL_BITS);
    const float z = 1.0f - fabsf(x) - fabsf(y);
    const float fold = z < 0.0f ? z : 0.0f;
    x -= copysignf(fold, x);
    y -= copysignf(fold, y);
    const float one = packed == BSQ_VERTEX_NORMAL_NONE ? 0.0f : 1.0f / sqrtf(x * x + y * y + z * z);
    normal[0] = x * one;
    normal[1] = y * one;
    normal[2] = z * one;
}

/* Returns the rise. */
static inline float bsq_vertex_rise(uint64_t packed)
{
    const uint32_t bits = (uint32_t)(packed >> BSQ_VERTEX_RISE_SHIFT) << 12;
    float rise;
    memcpy(&rise, &bits, sizeof rise);
    return rise;
}

/* Returns whether a writer writes this value: no coordinate is below -1, and the rise is finite. */
static inline bool bsq_vertex_normal_valid(uint64_t packed)
{
    const uint64_t mask = (UINT64_C(1) << BSQ_VERTEX_NORMAL_BITS) - 1;
    return packed == BSQ_VERTEX_NORMAL_NONE ||
           ((packed & mask) != 0 && (packed >> BSQ_VERTEX_NORMAL_BITS & mask) != 0 &&
            isfinite(bsq_vertex_rise(packed)));
}

#endif
