/* triangle_area.h - finds triangles without area. */
#ifndef VOX_CHUNK_TRIANGLE_AREA_H
#define VOX_CHUNK_TRIANGLE_AREA_H

#include <math.h>
#include <stdbool.h>

/* Returns whether x - y, a component of u x v, is not zero in spite of float32 rounding. */
static inline bool area_differs(float x, float y)
{
    float size = fabsf(x) + fabsf(y);
    return fabsf(x - y) > 1e-5f * size && size > 1e-30f;
}

/* Returns whether float32 is enough to see that the triangle has an area. */
static inline bool area_is_sure(const float *a, const float *b, const float *c)
{
    float u0 = b[0] - a[0], u1 = b[1] - a[1], u2 = b[2] - a[2];
    float v0 = c[0] - a[0], v1 = c[1] - a[1], v2 = c[2] - a[2];
    return area_differs(u1 * v2, u2 * v1) || area_differs(u2 * v0, u0 * v2) ||
           area_differs(u0 * v1, u1 * v0);
}

/* Returns whether the corners are repeated or collinear. Exact for coordinates of similar size:
 * products of their differences are exact in double. */
static inline bool area_is_zero(const float *a, const float *b, const float *c)
{
    if (area_is_sure(a, b, c))
        return false;
    double u[3], v[3];
    for (int i = 0; i < 3; i++) {
        u[i] = (double)b[i] - a[i];
        v[i] = (double)c[i] - a[i];
    }
    return u[1] * v[2] == u[2] * v[1] && u[2] * v[0] == u[0] * v[2] && u[0] * v[1] == u[1] * v[0];
}

#endif
