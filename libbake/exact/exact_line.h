/* exact_line.h - tests of a line against boxes and triangles; private to this folder.
 *
 * Boxes are tested in float, eight at a time, and never missed. Triangles are tested in double by
 * Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013: corners are
 * sheared so that the line becomes an axis, and the signs of three edge functions decide. A corner
 * is sheared alike for all its triangles, and the direction of an edge changes only the sign of its
 * edge function. So no line passes between two triangles that share an edge, even if they are in
 * different chunks. A line through an edge hits both triangles. */
#ifndef BAKE_EXACT_EXACT_LINE_H
#define BAKE_EXACT_EXACT_LINE_H

#include <math.h>
#include <stdbool.h>

#include "base/simd/simd.h"
#include "libbake/exact/exact_tree.h"

/* ---- boxes ---- */

/* A line prepared for tests against boxes. Its origin and direction are taken as exact. */
struct exact_line {
    float near_origin[3], far_origin[3]; /* for the planes where the line enters and leaves a box */
    float inverse[3];                    /* of the direction */
    uint32_t near[3], far[3];            /* which planes of a box these are: 0 lower, 1 upper */
};

/* Returns a component of a unit vector, or 0 if it is so small that its reciprocal could overflow.
 */
static inline float exact_component(float d)
{
    return fabsf(d) < 1e-18f ? 0.0f : d;
}

/* Prepares a line. Returns false if it has no direction or is not finite. */
static inline bool exact_line_set(struct exact_line *line, const float origin[3],
                                  const float direction[3])
{
    bool any = false;
    for (int k = 0; k < 3; k++) {
        float d = exact_component(direction[k]), o = origin[k];
        if (!isfinite(o) || !isfinite(d))
            return false;
        any |= d != 0.0f;
        /* A line parallel to a pair of planes lies between them or not. A rounding step keeps it
         * from lying exactly on one, where the product would have no sign. */
        line->near_origin[k] = d != 0.0f ? o : nextafterf(o, INFINITY);
        line->far_origin[k] = d != 0.0f ? o : nextafterf(o, -INFINITY);
        line->inverse[k] = d != 0.0f ? 1.0f / d : 3e38f;
        line->near[k] = d < 0.0f;
        line->far[k] = !line->near[k];
    }
    return any;
}

/* A part of a line: parameters from `begin` to `end`. */
struct exact_span {
    float begin, end;
};

/* Returns the span between two parameters, rounded outwards. */
static inline struct exact_span exact_span_of(double begin, double end)
{
    const double widen = 1.2e-7; /* twice the rounding error of the conversion */
    return (struct exact_span){(float)(begin - fabs(begin) * widen),
                               (float)(end + fabs(end) * widen)};
}

/* Sets the parameters where the line enters and leaves boxes, up to rounding. */
LANES_INLINE void exact_line_slabs(const struct exact_line *line, const struct exact_box8 *boxes,
                                   eights *in, eights *out)
{
    *in = eights_splat(-INFINITY);
    *out = eights_splat(INFINITY);
    for (int k = 0; k < 3; k++) {
        const eights near = *(const eights *)(const void *)boxes->planes[line->near[k]][k];
        const eights far = *(const eights *)(const void *)boxes->planes[line->far[k]][k];
        const eights inverse = eights_splat(line->inverse[k]);
        *in = eights_max((near - eights_splat(line->near_origin[k])) * inverse, *in);
        *out = eights_min((far - eights_splat(line->far_origin[k])) * inverse, *out);
    }
}

/* Returns a bit mask of the boxes that the line crosses within the span, and sets distances[] to
 * the smallest |t - from| inside each. Never misses a box: subtraction, reciprocal and product are
 * each rounded once, so parameters are off by less than 3 * 2^-24 of their size, and are widened by
 * more (Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013). */
static inline unsigned exact_line_crosses(const struct exact_line *line,
                                          const struct exact_box8 *boxes, struct exact_span span,
                                          float from, eights *distances)
{
    const eights less = eights_splat(1.0f - 4.8e-7f), more = eights_splat(1.0f + 4.8e-7f);
    eights in, out;
    exact_line_slabs(line, boxes, &in, &out);
    in = eights_max(eights_min(in * less, in * more), eights_splat(span.begin));
    out = eights_min(eights_max(out * less, out * more), eights_splat(span.end));
    const eights origin = eights_splat(from);
    *distances = eights_max(eights_max(in - origin, origin - out), eights_splat(0.0f));
    return eights_not_above(in, out);
}

/* Likewise between 0 and `end`, with distances from 0. What rounding could do to boxes behind does
 * not matter: a parameter has its right sign. */
LANES_INLINE unsigned exact_line_crosses_ahead(const struct exact_line *line,
                                               const struct exact_box8 *boxes, float end,
                                               eights *distances)
{
    eights in, out;
    exact_line_slabs(line, boxes, &in, &out);
    *distances = eights_max(in * eights_splat(1.0f - 4.8e-7f), eights_splat(0.0f));
    return eights_not_above(*distances,
                            eights_min(out * eights_splat(1.0f + 4.8e-7f), eights_splat(end)));
}

/* ---- triangles ---- */

/* A line prepared for tests against triangles: the shear that turns it into an axis. */
struct exact_shear {
    double origin[3];
    int kx, ky, kz; /* axes; kz is the axis along which the direction is longest */
    double sx, sy, sz;
};

static inline void exact_shear_set(struct exact_shear *shear, const float origin[3],
                                   const float direction[3])
{
    double d[3];
    int kz = 0;
    for (int k = 0; k < 3; k++) {
        shear->origin[k] = (double)origin[k];
        d[k] = (double)exact_component(direction[k]);
        kz = fabs(d[k]) > fabs(d[kz]) ? k : kz;
    }
    shear->kz = kz;
    shear->kx = (kz + 1) % 3;
    shear->ky = (kz + 2) % 3;
    if (d[kz] < 0.0) { /* keeps the winding of triangles */
        int swap = shear->kx;
        shear->kx = shear->ky;
        shear->ky = swap;
    }
    shear->sx = d[shear->kx] / d[kz];
    shear->sy = d[shear->ky] / d[kz];
    shear->sz = 1.0 / d[kz];
}

struct exact_crossing {
    double t;
    float w1, w2; /* barycentric weights of the second and third corner */
    bool along;   /* the normal of the triangle points along the line, not against it */
};

/* Intersects the line with a triangle. Returns false if they do not meet, or if the triangle is
 * seen edge-on. */
static inline bool exact_cross_triangle(const struct exact_shear *s, const float *a, const float *b,
                                        const float *c, struct exact_crossing *out)
{
    const int kx = s->kx, ky = s->ky, kz = s->kz;
    const double az = (double)a[kz] - s->origin[kz], bz = (double)b[kz] - s->origin[kz],
                 cz = (double)c[kz] - s->origin[kz];
    const double ax = ((double)a[kx] - s->origin[kx]) - s->sx * az,
                 ay = ((double)a[ky] - s->origin[ky]) - s->sy * az,
                 bx = ((double)b[kx] - s->origin[kx]) - s->sx * bz,
                 by = ((double)b[ky] - s->origin[ky]) - s->sy * bz,
                 cx = ((double)c[kx] - s->origin[kx]) - s->sx * cz,
                 cy = ((double)c[ky] - s->origin[ky]) - s->sy * cz;
    const double u = bx * cy - by * cx, v = cx * ay - cy * ax, w = ax * by - ay * bx;

    if ((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0))
        return false;
    const double sum = u + v + w;
    if (sum == 0.0)
        return false;
    out->t = s->sz * (u * az + v * bz + w * cz) / sum;
    out->w1 = (float)(v / sum);
    out->w2 = (float)(w / sum);
    out->along = sum > 0.0;
    return true;
}

#endif
