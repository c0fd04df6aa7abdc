/* bk_line.h - a line prepared for tests against boxes, in float, and against triangles, in double.
 *
 * Triangles are tested by Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1),
 * 2013: corners are sheared so that the line becomes an axis, and the signs of three edge functions
 * decide. A corner is sheared alike for all its triangles, and the direction of an edge changes
 * only the sign of its edge function. So no line passes between two triangles that share an edge,
 * even if they are in different chunks. A line through an edge hits both triangles. Processors and
 * devices decide by the same functions here, so they find the same hits. Devices without double
 * precision have none of this. */
#ifndef BAKE_KERNEL_BK_LINE_H
#define BAKE_KERNEL_BK_LINE_H

#include "bk_vec.h"

#ifdef BK_DOUBLE

/* ---- boxes ---- */

/* A line prepared for tests against boxes. Its origin and direction are taken as exact. */
typedef struct bk_line {
    float near_origin[3], far_origin[3]; /* for the planes where the line enters and leaves a box */
    float inverse[3];                    /* of the direction */
    bk_uint near[3], far[3];             /* which planes of a box these are: 0 lower, 1 upper */
} bk_line;

/* Returns a component of a unit vector, or 0 if it is so small that its reciprocal could overflow.
 */
BK_FN float bk_component(float d)
{
    return bk_abs(d) < 1e-18f ? 0.0f : d;
}

/* Prepares a line. Returns 0 if it has no direction or is not finite. */
BK_FN bk_uint bk_line_set(bk_line *line, const float origin[3], const float direction[3])
{
    const float most = 3.402823466e38f;
    bk_uint any = 0;
    int k;

    for (k = 0; k < 3; k++) {
        const float d = bk_component(direction[k]), o = origin[k];
        /* A line parallel to a pair of planes lies between them or not. A step outwards keeps it
         * from lying exactly on one, where the product would have no sign. */
        const float step = d != 0.0f ? 0.0f : bk_max(bk_abs(o) * 2.4e-7f, 1e-19f);
        if (!(bk_abs(o) <= most && bk_abs(d) <= most))
            return 0u;
        any |= d != 0.0f ? 1u : 0u;
        line->near_origin[k] = o + step;
        line->far_origin[k] = o - step;
        line->inverse[k] = d != 0.0f ? 1.0f / d : 3e38f;
        line->near[k] = d < 0.0f ? 1u : 0u;
        line->far[k] = 1u - line->near[k];
    }
    return any;
}

/* Factors that widen the parameters where a line enters and leaves a box: subtraction, reciprocal
 * and product are each rounded once, so parameters are off by less than 3 * 2^-24 of their size
 * (Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013). */
#define BK_LINE_LESS (1.0f - 4.8e-7f)
#define BK_LINE_MORE (1.0f + 4.8e-7f)

/* Twice the relative error of rounding a parameter to float. */
#define BK_LINE_ROUNDING 1.2e-7

/* ---- triangles ---- */

/* A line prepared for tests against triangles: the shear that turns it into an axis. */
typedef struct bk_shear {
    double origin[3], s[3]; /* along the axes kx, ky, kz */
    bk_uint k[3];           /* the axes; the direction is longest along the last */
} bk_shear;

/* Returns component k of a vector. An index known only at run time would put it into memory. */
BK_FN float bk_pick(const float v[3], bk_uint k)
{
    return k == 0u ? v[0] : k == 1u ? v[1] : v[2];
}

BK_FN void bk_shear_set(bk_shear *shear, const float origin[3], const float direction[3])
{
    const float x = bk_abs(bk_component(direction[0])), y = bk_abs(bk_component(direction[1])),
                z = bk_abs(bk_component(direction[2]));
    const bk_uint kz = z > bk_max(x, y) ? 2u : y > x ? 1u : 0u;
    const bk_uint next = kz == 2u ? 0u : kz + 1u, last = next == 2u ? 0u : next + 1u;
    const double along = (double)bk_component(bk_pick(direction, kz));
    const bk_uint back = along < 0.0 ? 1u : 0u; /* keeps the winding of triangles */

    shear->k[0] = back ? last : next;
    shear->k[1] = back ? next : last;
    shear->k[2] = kz;
    shear->origin[0] = (double)bk_pick(origin, shear->k[0]);
    shear->origin[1] = (double)bk_pick(origin, shear->k[1]);
    shear->origin[2] = (double)bk_pick(origin, kz);
    shear->s[0] = (double)bk_component(bk_pick(direction, shear->k[0])) / along;
    shear->s[1] = (double)bk_component(bk_pick(direction, shear->k[1])) / along;
    shear->s[2] = 1.0 / along;
}

typedef struct bk_line_hit {
    double t;
    float w1, w2;  /* barycentric weights of the second and third corner */
    bk_uint along; /* not 0: the triangle's normal points along the line, not against it */
} bk_line_hit;

/* Intersects the line with a triangle, whose corners are given along the axes of the shear. Returns
 * 0 if they do not meet, or if the triangle is seen edge-on. */
BK_FN bk_uint bk_cross_triangle(const bk_shear *s, bk_vec3 a, bk_vec3 b, bk_vec3 c,
                                bk_line_hit *out)
{
    const double az = (double)a.z - s->origin[2], bz = (double)b.z - s->origin[2],
                 cz = (double)c.z - s->origin[2];
    const double ax = ((double)a.x - s->origin[0]) - s->s[0] * az,
                 ay = ((double)a.y - s->origin[1]) - s->s[1] * az,
                 bx = ((double)b.x - s->origin[0]) - s->s[0] * bz,
                 by = ((double)b.y - s->origin[1]) - s->s[1] * bz,
                 cx = ((double)c.x - s->origin[0]) - s->s[0] * cz,
                 cy = ((double)c.y - s->origin[1]) - s->s[1] * cz;
    const double u = bx * cy - by * cx, v = cx * ay - cy * ax, w = ax * by - ay * bx;
    const double sum = u + v + w;

    if ((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0))
        return 0u;
    if (sum == 0.0)
        return 0u;
    out->t = s->s[2] * (u * az + v * bz + w * cz) / sum;
    out->w1 = (float)(v / sum);
    out->w2 = (float)(w / sum);
    out->along = sum > 0.0 ? 1u : 0u;
    return 1u;
}

/* ---- hits of first rays ---- */

/* Returns the absolute value of a parameter of a line. */
BK_FN double bk_size(double t)
{
    return t < 0.0 ? -t : t;
}

/* Returns how far a hit is on the way of a ray, which is in the unit of t: from t = reach inwards,
 * against its direction, and from there outwards. So up to its reach the outermost hit counts, and
 * beyond, on either side, the one with the smallest |t|. */
BK_FN double bk_ray_cost(double t, double reach)
{
    return t <= reach ? reach - t : reach + t;
}

/* Returns whether a hit wins over another: that with the lower bk_ray_cost(), then the outer one,
 * then the one with the lower triangle number. */
BK_FN bk_uint bk_wins(double t, bk_ulong triangle, double other_t, bk_ulong other_triangle,
                      double reach)
{
    const double cost = bk_ray_cost(t, reach), other_cost = bk_ray_cost(other_t, reach);

    if (cost != other_cost)
        return cost < other_cost ? 1u : 0u;
    return (t != other_t ? t > other_t : triangle < other_triangle) ? 1u : 0u;
}

/* Narrows a range of parameters to those of hits that may win over one at t. */
BK_FN void bk_narrow(double t, double reach, double *begin, double *end)
{
    const double least = t <= reach ? t : -t;
    const double most = t > reach || -t > reach ? bk_size(t) : reach;

    *begin = *begin > least ? *begin : least;
    *end = *end < most ? *end : most;
}

#endif

#endif
