/* exact_triangle.h - where does a line meet a triangle?
 *
 * Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013, in double: corners
 * are sheared so that the line becomes an axis, and the signs of three edge functions decide. A
 * corner is sheared alike for all triangles that have it, and an edge function changes nothing but
 * its sign with the edge's direction, so no line passes between two triangles that share an edge,
 * whichever chunks they are in. Lines through an edge meet both triangles. */
#ifndef BAKE_EXACT_EXACT_TRIANGLE_H
#define BAKE_EXACT_EXACT_TRIANGLE_H

#include <math.h>
#include <stdbool.h>

#include "libbake/exact/exact_tree.h"

struct exact_shear {
    double origin[3];
    int kx, ky, kz; /* axes; z is the one that the line follows most */
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
    if (d[kz] < 0.0) { /* keeps the sense of rotation */
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
    bool along;   /* the triangle's normal points along the line, not against it */
};

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
