/* bk_vec.h - three floats. Evaluation order is written out, so that every compiler rounds alike. */
#ifndef BK_VEC_H
#define BK_VEC_H

#include "bk_compat.h"

typedef struct bk_vec3 {
    float x, y, z;
} bk_vec3;

BK_FN bk_vec3 bk_v3(float x, float y, float z)
{
    bk_vec3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

BK_FN bk_vec3 bk_scale(bk_vec3 a, float s)
{
    return bk_v3(a.x * s, a.y * s, a.z * s);
}

/* a + s b */
BK_FN bk_vec3 bk_add_scaled(bk_vec3 a, float s, bk_vec3 b)
{
    return bk_v3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

BK_FN float bk_dot(bk_vec3 a, bk_vec3 b)
{
    return (a.x * b.x + a.y * b.y) + a.z * b.z;
}

BK_FN bk_vec3 bk_cross(bk_vec3 a, bk_vec3 b)
{
    return bk_v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

/* Unit vector, or zero where the length is zero or not a number. */
BK_FN bk_vec3 bk_unit(bk_vec3 a)
{
    float square = bk_dot(a, a);
    if (!(square > 0.0f))
        return bk_v3(0.0f, 0.0f, 0.0f);
    return bk_scale(a, 1.0f / bk_sqrt(square));
}

BK_FN float bk_min(float a, float b)
{
    return a < b ? a : b;
}

BK_FN float bk_max(float a, float b)
{
    return a > b ? a : b;
}

BK_FN bk_int bk_clamp_int(bk_int v, bk_int low, bk_int high)
{
    return v < low ? low : v > high ? high : v;
}

#endif
