/* bk_vec.h - vectors of three floats. Parentheses fix the order of evaluation, so that every
 * compiler rounds alike. */
#ifndef BAKE_KERNEL_BK_VEC_H
#define BAKE_KERNEL_BK_VEC_H

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

/* Returns a + s b. */
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

/* Returns the unit vector, or zero if the length is zero or NaN. */
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

/* ---- BK_WIDTH vectors at a time ---- */

typedef struct bk_vec3w {
    bk_fw x, y, z;
} bk_vec3w;

BK_FN bk_vec3w bk_v3w(bk_fw x, bk_fw y, bk_fw z)
{
    bk_vec3w v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

/* Returns a vector with the same value in all lanes. */
BK_FN bk_vec3w bk_splat3(bk_vec3 a)
{
    return bk_v3w(bk_splat(a.x), bk_splat(a.y), bk_splat(a.z));
}

BK_FN bk_vec3 bk_lane3(const bk_vec3w *v, bk_uint lane)
{
    (void)lane;
    return bk_v3(bk_lane(v->x, lane), bk_lane(v->y, lane), bk_lane(v->z, lane));
}

BK_FN void bk_set_lane3(bk_vec3w *v, bk_uint lane, bk_vec3 a)
{
    (void)lane;
    bk_set_lane(v->x, lane, a.x);
    bk_set_lane(v->y, lane, a.y);
    bk_set_lane(v->z, lane, a.z);
}

BK_FN bk_fw bk_absw(bk_fw a)
{
    return bk_maxw(a, 0.0f - a);
}

BK_FN bk_vec3w bk_scalew(bk_vec3w a, bk_fw s)
{
    return bk_v3w(a.x * s, a.y * s, a.z * s);
}

BK_FN bk_vec3w bk_add_scaledw(bk_vec3w a, bk_fw s, bk_vec3w b)
{
    return bk_v3w(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

BK_FN bk_fw bk_dotw(bk_vec3w a, bk_vec3w b)
{
    return (a.x * b.x + a.y * b.y) + a.z * b.z;
}

BK_FN bk_vec3w bk_crossw(bk_vec3w a, bk_vec3w b)
{
    return bk_v3w(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

/* Returns bk_unit() of each lane. */
BK_FN bk_vec3w bk_unitw(bk_vec3w a)
{
    const bk_fw square = bk_dotw(a, a);
    const bk_mask some = bk_less(bk_splat(0.0f), square);
    const bk_fw s = 1.0f / bk_sqrtw(square);

    return bk_v3w(bk_keep(some, a.x * s), bk_keep(some, a.y * s), bk_keep(some, a.z * s));
}

BK_FN bk_vec3w bk_select3(bk_mask mask, bk_vec3w a, bk_vec3w b)
{
    return bk_v3w(bk_select(mask, a.x, b.x), bk_select(mask, a.y, b.y), bk_select(mask, a.z, b.z));
}

#endif
