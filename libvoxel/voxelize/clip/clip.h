/* clip.h - clips a triangle to each voxel that it touches.
 *
 * This is box-triangle overlap test and clipping in one. The triangle is a closed set and a voxel
 * is a box that is half-open upwards; the fragment is their intersection. So every point of the
 * triangle belongs to one voxel: nothing that a triangle enters is missed, and a point on the
 * border of two voxels belongs to the upper one.
 *
 * The triangle is cut into slabs along x, these into rows along y, these into voxels. Cutting with
 * one plane at a time (Sutherland & Hodgman, "Reentrant Polygon Clipping", CACM 1974, keeping both
 * sides) visits only the touched voxels and yields the clipped polygon of each. A separating-axis
 * test for each voxel would find the same voxels and cost more.
 *
 * The lower side of a cut is closed in the arithmetic, but half-open by definition. Vertices
 * remember the upper faces that a cut put them on (their "open" faces, which are not part of the
 * voxel). A voxel that is met in such points only is not touched.
 *
 * This takes any triangle. Most triangles are small, and divide_lanes.h divides them at a fraction
 * of the cost.
 *
 * The code is in this header so that it is inlined into its one caller: a call for each fragment
 * costs more than the work on most fragments. */
#ifndef VOX_VOXELIZE_CLIP_CLIP_H
#define VOX_VOXELIZE_CLIP_CLIP_H

#include <math.h>

#include "libvoxel/voxelize/plan/plan.h"

#define CLIP_INLINE static inline __attribute__((always_inline))

/* A fragment: the part of a triangle inside one voxel. b: weights of the second and third corner at
 * the centroid; the first has 1 - b[0] - b[1]. */
struct vox_fragment {
    int32_t cell[3];
    double fraction; /* of the triangle's area; 0 if they share only a point or an edge */
    double b[2];
    double uv_extent[2]; /* size of the fragment in texture space, if the triangle has texture
                            coordinates */
};

struct vox_clip_triangle {
    const double *corner[3];     /* in index space */
    const struct vox_box *cells; /* voxels of its bounds, clamped to the grid */
    const double (*uv)[2];       /* texture coordinates of the corners, or NULL */
};

/* Takes a fragment. A result other than 0 ends the clipping, which returns it. */
typedef int vox_fragment_sink(void *arg, const struct vox_fragment *fragment);

struct clip_vertex {
    double p[3];
    double b[2];   /* weights of the second and third corner */
    uint64_t open; /* bit a: on an open upper face across axis a */
};

/* A plane adds at most one vertex to a convex polygon, so six of the region and six of the voxel
 * make 15. Rounding may make a polygon slightly concave, hence the check in clip_split(). */
enum { CLIP_MAX_VERTICES = 20 };

struct clip_polygon {
    uint32_t count;
    struct clip_vertex v[CLIP_MAX_VERTICES];
};

struct clip_state {
    const struct vox_clip_triangle *triangle;
    const struct vox_box *window;
    struct vox_box cells; /* of the triangle's bounds, inside the region */
    int32_t cell[3];
    void *arg; /* of the sink */
};

/* ---- fragments ---- */

static inline void clip_uv_extent(const struct clip_polygon *p, const double (*uv)[2],
                                  double extent[2])
{
    for (int k = 0; k < 2; k++) {
        double d1 = uv[1][k] - uv[0][k], d2 = uv[2][k] - uv[0][k];
        double min = INFINITY, max = -INFINITY;
        for (uint32_t i = 0; i < p->count; i++) {
            double at = p->v[i].b[0] * d1 + p->v[i].b[1] * d2;
            min = at < min ? at : min;
            max = at > max ? at : max;
        }
        extent[k] = max - min;
    }
}

static inline void clip_mean_of_vertices(const struct clip_polygon *p, double b[2])
{
    b[0] = b[1] = 0.0;
    for (uint32_t i = 0; i < p->count; i++) {
        b[0] += p->v[i].b[0];
        b[1] += p->v[i].b[1];
    }
    b[0] /= p->count;
    b[1] /= p->count;
}

/* Computes area and centroid in the plane of the corner weights, where the triangle has area 1/2.
 * This is well conditioned however thin the triangle is. */
CLIP_INLINE void clip_measure(const struct clip_polygon *p, struct vox_fragment *fragment)
{
    const double *b0 = p->v[0].b;
    double area2 = 0.0, absolute = 0.0, m0 = 0.0, m1 = 0.0;
    double d0 = p->v[1].b[0] - b0[0], d1 = p->v[1].b[1] - b0[1];
    for (uint32_t i = 2; i < p->count; i++) {
        double e0 = p->v[i].b[0] - b0[0], e1 = p->v[i].b[1] - b0[1];
        double a2 = d0 * e1 - d1 * e0;
        area2 += a2;
        absolute += fabs(a2);
        m0 += a2 * (d0 + e0);
        m1 += a2 * (d1 + e1);
        d0 = e0;
        d1 = e1;
    }
    /* If signs differ, the area is rounding noise and gives no centroid. */
    if (area2 > 0.5 * absolute) {
        double scale = 1.0 / (3.0 * area2);
        fragment->fraction = area2;
        fragment->b[0] = b0[0] + m0 * scale;
        fragment->b[1] = b0[1] + m1 * scale;
    } else {
        fragment->fraction = area2 > 0.0 ? area2 : 0.0;
        clip_mean_of_vertices(p, fragment->b);
    }
}

CLIP_INLINE int clip_emit(struct clip_state *c, const struct clip_polygon *p,
                          vox_fragment_sink *sink)
{
    struct vox_fragment fragment;
    for (int a = 0; a < 3; a++)
        fragment.cell[a] = c->cell[a];
    clip_measure(p, &fragment);
    if (c->triangle->uv)
        clip_uv_extent(p, c->triangle->uv, fragment.uv_extent);
    return sink(c->arg, &fragment);
}

/* ---- cutting ----
 *
 * Axes are cut in the order x, y, z. So the results of a cut need no coordinates of earlier axes,
 * and the side below the plane does not need its own. */

/* Computes where the edge from l (below) to r (not below) crosses the plane. Always computed from
 * below, so that triangles that share an edge share the crossing. */
CLIP_INLINE void clip_cross(const struct clip_vertex *l, const struct clip_vertex *r, int axis,
                            double plane, struct clip_vertex *above, struct clip_vertex *below)
{
    double t = (plane - l->p[axis]) / (r->p[axis] - l->p[axis]);
    for (int k = axis + 1; k < 3; k++)
        below->p[k] = above->p[k] = l->p[k] + t * (r->p[k] - l->p[k]);
    for (int k = 0; k < 2; k++)
        below->b[k] = above->b[k] = l->b[k] + t * (r->b[k] - l->b[k]);
    above->p[axis] = plane;
    above->open = l->open & r->open;
    below->open = above->open | UINT64_C(1) << axis;
}

CLIP_INLINE void clip_copy_vertex(struct clip_vertex *to, const struct clip_vertex *from,
                                  int first_axis)
{
    for (int k = first_axis; k < 3; k++)
        to->p[k] = from->p[k];
    for (int k = 0; k < 2; k++)
        to->b[k] = from->b[k];
    to->open = from->open;
}

/* Returns a mask: bit i is set if vertex i is not below the plane. */
CLIP_INLINE uint32_t clip_above_mask(const struct clip_polygon *p, int axis, double plane)
{
    uint32_t mask = 0;
    for (uint32_t i = 0; i < p->count; i++)
        mask |= (uint32_t)(p->v[i].p[axis] >= plane) << i;
    return mask;
}

/* Splits any polygon, even one that rounding made concave so that it crosses more than twice. Keeps
 * all coordinates on both sides. */
static inline void clip_split_any(const struct clip_polygon *in, int axis, double plane,
                                  struct clip_polygon *below, struct clip_polygon *above)
{
    uint32_t nb = 0, na = 0;
    const struct clip_vertex *previous = &in->v[in->count - 1];
    for (uint32_t i = 0; i < in->count; i++) {
        const struct clip_vertex *v = &in->v[i];
        bool is_above = v->p[axis] >= plane, was_above = previous->p[axis] >= plane;
        if (is_above != was_above && na < CLIP_MAX_VERTICES && nb < CLIP_MAX_VERTICES) {
            const struct clip_vertex *l = is_above ? previous : v, *r = is_above ? v : previous;
            struct clip_vertex *x = &above->v[na++], *y = &below->v[nb++];
            clip_cross(l, r, axis, plane, x, y);
            double t = (plane - l->p[axis]) / (r->p[axis] - l->p[axis]);
            for (int k = 0; k < axis; k++)
                y->p[k] = x->p[k] = l->p[k] + t * (r->p[k] - l->p[k]);
            y->p[axis] = plane;
        }
        if (is_above && na < CLIP_MAX_VERTICES)
            above->v[na++] = *v;
        else if (!is_above && nb < CLIP_MAX_VERTICES)
            below->v[nb++] = *v;
        previous = v;
    }
    below->count = nb;
    above->count = na;
}

/* Copies `count` consecutive vertices from `first` on, cyclically. */
CLIP_INLINE void clip_copy_run(struct clip_vertex *to, const struct clip_polygon *from,
                               uint32_t first, uint32_t count, int first_axis)
{
    for (uint32_t i = 0; i < count; i++) {
        clip_copy_vertex(&to[i], &from->v[first], first_axis);
        first = first + 1 < from->count ? first + 1 : 0;
    }
}

/* Cuts a polygon that has vertices on both sides of the plane. The part below loses its coordinates
 * on this axis and on earlier ones, the part above those on earlier ones. */
CLIP_INLINE void clip_split(const struct clip_polygon *in, int axis, double plane,
                            struct clip_polygon *below, struct clip_polygon *above)
{
    uint32_t n = in->count, mask = clip_above_mask(in, axis, plane);
    if (n == 0)
        __builtin_unreachable();
    uint32_t previous = (mask << 1 | mask >> (n - 1)) & ((1u << n) - 1);
    uint32_t enters = mask & ~previous, leaves = ~mask & previous;
    if ((enters & (enters - 1)) != 0 || n == CLIP_MAX_VERTICES) {
        clip_split_any(in, axis, plane, below, above);
        return;
    }
    uint32_t enter = (uint32_t)__builtin_ctz(enters), leave = (uint32_t)__builtin_ctz(leaves);
    uint32_t na = (uint32_t)__builtin_popcount(mask), nb = n - na;
    clip_cross(&in->v[enter > 0 ? enter - 1 : n - 1], &in->v[enter], axis, plane, &above->v[0],
               &below->v[nb + 1]);
    clip_cross(&in->v[leave], &in->v[leave > 0 ? leave - 1 : n - 1], axis, plane, &above->v[na + 1],
               &below->v[0]);
    clip_copy_run(&above->v[1], in, enter, na, axis);
    clip_copy_run(&below->v[1], in, leave, nb, axis + 1);
    below->count = nb + 2;
    above->count = na + 2;
}

/* Returns whether the points at the polygon's upper end, `max` on this axis, belong to it: not if
 * all of them lie on one open face. */
static inline bool clip_top_belongs(const struct clip_polygon *p, int axis, double max)
{
    uint64_t open = ~UINT64_C(0);
    for (uint32_t i = 0; i < p->count; i++)
        if (p->v[i].p[axis] == max)
            open &= p->v[i].open;
    return open == 0;
}

/* Narrows lo to hi to the voxels that the polygon touches. */
CLIP_INLINE void clip_cell_range(const struct clip_polygon *p, int axis, int32_t *lo, int32_t *hi)
{
    double min = p->v[0].p[axis], max = min;
    for (uint32_t i = 1; i < p->count; i++) {
        double x = p->v[i].p[axis];
        min = x < min ? x : min;
        max = x > max ? x : max;
    }
    int32_t first = (int32_t)floor(min), last = (int32_t)floor(max);
    if (last < *hi)
        *hi = last;
    if (first > *lo)
        *lo = first < *hi ? first : *hi;
    if (*hi > *lo && max == *hi && !clip_top_belongs(p, axis, max))
        --*hi;
}

typedef int clip_next(struct clip_state *c, const struct clip_polygon *p, vox_fragment_sink *sink);

CLIP_INLINE int clip_cut(struct clip_state *c, const struct clip_polygon *p, int axis,
                         clip_next *next, vox_fragment_sink *sink)
{
    int32_t lo = c->cells.lo[axis], hi = c->cells.hi[axis];
    int32_t from = c->window->lo[axis], to = c->window->hi[axis];
    struct clip_polygon fragment, rest[2];
    if (lo < hi)
        clip_cell_range(p, axis, &lo, &hi);
    for (int32_t i = lo; i <= hi && i <= to; i++) {
        const struct clip_polygon *current = p;
        if (i < hi) {
            struct clip_polygon *above = &rest[i & 1];
            clip_split(p, axis, i + 1, &fragment, above);
            current = &fragment;
            p = above;
        }
        if (i < from)
            continue;
        c->cell[axis] = i;
        int status = next(c, current, sink);
        if (status != 0)
            return status;
    }
    return 0;
}

CLIP_INLINE int clip_cut_row(struct clip_state *c, const struct clip_polygon *p,
                             vox_fragment_sink *sink)
{
    return clip_cut(c, p, 2, clip_emit, sink);
}

CLIP_INLINE int clip_cut_slab(struct clip_state *c, const struct clip_polygon *p,
                              vox_fragment_sink *sink)
{
    return clip_cut(c, p, 1, clip_cut_row, sink);
}

CLIP_INLINE int clip_cut_triangle(struct clip_state *c, const struct clip_polygon *p,
                                  vox_fragment_sink *sink)
{
    return clip_cut(c, p, 0, clip_cut_slab, sink);
}

/* ---- the region ---- */

static inline bool clip_reaches(const struct clip_polygon *p, int axis, double plane)
{
    double max = -INFINITY;
    for (uint32_t i = 0; i < p->count; i++)
        max = p->v[i].p[axis] > max ? p->v[i].p[axis] : max;
    return max > plane || (max == plane && clip_top_belongs(p, axis, max));
}

static inline bool clip_begins_below(const struct clip_polygon *p, int axis, double plane)
{
    for (uint32_t i = 0; i < p->count; i++)
        if (p->v[i].p[axis] < plane)
            return true;
    return false;
}

/* Cuts the polygon to the region. Returns false if nothing is left. Cutting a large triangle first
 * keeps the work in proportion to its share of the region. */
static inline bool clip_cut_to_region(struct clip_polygon *p, const struct vox_box *cells,
                                      const struct vox_box *region)
{
    struct clip_polygon below, above;
    for (int a = 0; a < 3; a++) {
        if (cells->lo[a] < region->lo[a]) {
            if (!clip_reaches(p, a, region->lo[a]))
                return false;
            if (clip_begins_below(p, a, region->lo[a])) {
                clip_split_any(p, a, region->lo[a], &below, &above);
                *p = above;
            }
        }
        if (cells->hi[a] > region->hi[a]) {
            double plane = region->hi[a] + 1.0;
            if (!clip_begins_below(p, a, plane))
                return false;
            if (clip_reaches(p, a, plane)) {
                clip_split_any(p, a, plane, &below, &above);
                *p = below;
            }
        }
    }
    return true;
}

/* ---- the whole ---- */

static inline void clip_first_polygon(const struct vox_clip_triangle *triangle,
                                      struct clip_polygon *p)
{
    p->count = 3;
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < 3; a++)
            p->v[i].p[a] = triangle->corner[i][a];
        p->v[i].b[0] = i == 1;
        p->v[i].b[1] = i == 2;
        p->v[i].open = 0;
    }
}

/* Passes the fragments inside `window` to the sink, in ascending (x, y, z) order. region: a fixed
 * division of the grid that contains the window. A fragment is the same bit for bit for every
 * window of its region. */
CLIP_INLINE int vox_clip(const struct vox_clip_triangle *triangle, const struct vox_box *region,
                         const struct vox_box *window, vox_fragment_sink *sink, void *arg)
{
    struct clip_state c = {.triangle = triangle, .window = window, .arg = arg};
    struct clip_polygon p;
    bool inside = true;
    for (int a = 0; a < 3; a++) {
        int32_t lo = triangle->cells->lo[a], hi = triangle->cells->hi[a];
        inside = inside && lo >= region->lo[a] && hi <= region->hi[a];
        c.cells.lo[a] = lo > region->lo[a] ? lo : region->lo[a];
        c.cells.hi[a] = hi < region->hi[a] ? hi : region->hi[a];
    }
    clip_first_polygon(triangle, &p);
    if (!inside && !clip_cut_to_region(&p, triangle->cells, region))
        return 0;
    return clip_cut_triangle(&c, &p, sink);
}

#undef CLIP_INLINE
#endif
