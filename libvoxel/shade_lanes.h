/* shade_lanes.h - what the pieces of triangles say of their voxels, several pieces side by side. */
#ifndef VOX_SHADE_LANES_H
#define VOX_SHADE_LANES_H

#include "libvoxel/divide_lanes.h"
#include "libvoxel/shade.h"

/* Triangles side by side, in voxels from the lower corner of a cell of each. */
struct shade_triangles {
    lanes p[3][3];    /* corner, axis */
    lanes edge[2][3]; /* from the first corner to the others */
    lanes flat[3];    /* unit normal of the plane, zero where there is no area */
    lanes area;       /* in voxel faces */
    bool has_normals;
    bool curved;        /* so large that planes differ from the surface that the normals describe */
    bool detached;      /* and no surface through facets of this size belongs to the normals */
    lanes normal[3][3]; /* corner, axis; unit */
    lanes rise[3];      /* of the surface they describe above the corners, in voxels */
    /* Of corners 01, 12, 20: 8 times the height of the arc over the edge that has the corners'
     * normals. */
    lanes arc[3];
    lane_mask facet; /* the plane is too far from that surface to go with the normals */
    bool has_color;
    lanes rgb[3][3]; /* corner, channel; linear light */
    lanes colored;   /* 1 where the triangle has a colour, else 0 */
};

/* ---- triangles ---- */

LANES_INLINE lanes shade_dot(const lanes a[3], const lanes b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Edges, plane and area, from the corners. */
LANES_INLINE void shade_measure(struct shade_triangles *t)
{
    lanes n[3], *e = t->edge[0], *f = t->edge[1];
    for (int k = 0; k < 3; k++) {
        e[k] = t->p[1][k] - t->p[0][k];
        f[k] = t->p[2][k] - t->p[0][k];
    }
    n[0] = e[1] * f[2] - e[2] * f[1];
    n[1] = e[2] * f[0] - e[0] * f[2];
    n[2] = e[0] * f[1] - e[1] * f[0];
    lanes length = lanes_sqrt(shade_dot(n, n));
    lanes scale = lanes_keep(length > 0.0, 1.0 / length);
    t->area = 0.5 * length;
    for (int k = 0; k < 3; k++)
        t->flat[k] = n[k] * scale;
}

/* A corner without a normal has the triangle's own. Normals are believed even where the winding
 * says otherwise. */
LANES_INLINE void shade_settle_normals(struct shade_triangles *t)
{
    for (int i = 0; i < 3; i++) {
        lane_mask has = shade_dot(t->normal[i], t->normal[i]) > 0.0;
        for (int k = 0; k < 3; k++)
            t->normal[i][k] = lanes_select(has, t->normal[i][k], t->flat[k]);
    }
}

/* Highest arc over an edge, and highest rise above a corner, onto which pieces are lifted, in
 * voxels: they have to stay with their voxel. */
#define SHADE_LIFT_LIMIT 0.1

/* Measures how far the surface that the corners' normals describe lies from the triangle's plane.
 * Limited edge by edge and corner by corner, as what two triangles share must not depend on either.
 */
LANES_INLINE void shade_measure_arcs(struct shade_triangles *t)
{
    const lanes limit = lanes_all(8.0 * SHADE_LIFT_LIMIT), highest = lanes_all(SHADE_LIFT_LIMIT);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3;
        lanes arc = lanes_all(0.0);
        for (int a = 0; a < 3; a++)
            arc += (t->p[i][a] - t->p[j][a]) * (t->normal[i][a] - t->normal[j][a]);
        t->facet |= lanes_abs(arc) > limit;
        t->arc[i] = lanes_min(lanes_max(arc, -limit), limit);
        t->facet |= lanes_abs(t->rise[i]) > highest;
        t->rise[i] = lanes_min(lanes_max(t->rise[i], -highest), highest);
    }
}

/* What follows from corners and their normals. */
LANES_INLINE void shade_prepare(struct shade_triangles *t)
{
    shade_measure(t);
    t->facet = (lane_mask){0};
    if (t->has_normals)
        shade_settle_normals(t);
    if (t->curved)
        shade_measure_arcs(t);
    if (t->detached)
        t->facet = lanes_all(0.0) < 1.0;
}

/* ---- pieces ---- */

LANES_INLINE lanes shade_blend(lanes first, lanes second, lanes third, const lanes b[2])
{
    return first + b[0] * (second - first) + b[1] * (third - first);
}

/* Interpolated unit normal; normals that cancel say less than the triangle itself. */
LANES_INLINE void shade_normal(const struct shade_triangles *t, const lanes b[2], lanes normal[3])
{
    for (int k = 0; k < 3; k++)
        normal[k] = shade_blend(t->normal[0][k], t->normal[1][k], t->normal[2][k], b);
    lanes square = shade_dot(normal, normal), scale = 1.0 / lanes_sqrt(square);
    for (int k = 0; k < 3; k++)
        normal[k] = lanes_select(square > 1e-12, normal[k] * scale, t->flat[k]);
}

/* Moves a piece from the triangle's plane onto the curved surface, so that the plane of a voxel
 * goes with its normal. At weights w the tangent plane of corner i is (p_i - p) . n_i away, and
 * half the mean of these is the height of a surface of constant curvature (Boubekeur & Alexa,
 * "Phong Tessellation", 2008, blend the same planes). With p = sum of w_i p_i that is half the sum
 * of w_i w_j (p_i - p_j) . (n_i - n_j) over the edges. Corners that are not on that surface take
 * their neighbourhood along. */
LANES_INLINE void shade_lift(const struct shade_triangles *t, const lanes b[2],
                             const lanes normal[3], lanes center[3])
{
    lanes w = 1.0 - b[0] - b[1];
    lanes height = 0.5 * (w * b[0] * t->arc[0] + b[0] * b[1] * t->arc[1] + b[1] * w * t->arc[2]);
    height += w * t->rise[0] + b[0] * t->rise[1] + b[1] * t->rise[2];
    for (int k = 0; k < 3; k++)
        center[k] += height * normal[k];
}

/* The sums that pieces add to: as struct vox_sum, and as its colour where t->has_color and the
 * colour does not come from a texture. `share` of the triangle's area, centroids at weights b, in
 * the cell whose lower corner is `cell`. */
LANES_INLINE void shade_pieces(const struct shade_triangles *t, lanes share, const lanes b[2],
                               const lanes cell[3], lanes sample[8], lanes color[4])
{
    lanes area = lanes_max(t->area * share, lanes_all(VOX_NO_AREA));
    lanes center[3], normal[3];
    for (int k = 0; k < 3; k++) {
        center[k] = t->p[0][k] + b[0] * t->edge[0][k] + b[1] * t->edge[1][k] - (cell[k] + 0.5);
        normal[k] = t->flat[k];
    }
    sample[7] = lanes_all(0.0);
    if (t->has_normals) {
        shade_normal(t, b, normal);
        if (t->curved) {
            shade_lift(t, b, normal, center);
            sample[7] = lanes_keep(t->facet, area);
        }
        /* Directions count as far as they agree with the triangle's: then coverage tells how well a
         * voxel's plane stands for its surface. */
        lanes agreement = lanes_abs(shade_dot(normal, t->flat));
        for (int k = 0; k < 3; k++)
            normal[k] = agreement * normal[k];
    }
    for (int k = 0; k < 3; k++) {
        sample[k] = area * normal[k];
        sample[4 + k] = area * center[k];
    }
    sample[3] = area;
    if (t->has_color) {
        color[3] = area * t->colored;
        for (int k = 0; k < 3; k++)
            color[k] = color[3] * shade_blend(t->rgb[0][k], t->rgb[1][k], t->rgb[2][k], b);
    }
}

#endif
