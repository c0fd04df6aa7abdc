/* divide_lanes.h - divides small triangles among the voxels they touch, several side by side.
 *
 * The triangles of a batch span the same number of voxels along each axis, so all take the same
 * steps. No polygon is built. Area and centroid of a fragment are sums over its border (Green's
 * theorem). The border lies on the triangle's edges and on the lines where voxel planes cut the
 * triangle. The part of such a line inside a voxel has a closed form: the overlap of the spans in
 * which the line is within the voxel along the other axes. Each part counts for the fragment below
 * the plane and, with the opposite sign, for the fragment above.
 *
 * Everything is measured in the plane of the corner weights with the first corner as origin, where
 * the two edges from the origin contribute nothing.
 *
 * If a corner or a crossing lies exactly on a plane, half-open boxes decide what is touched. If a
 * fragment is tiny or lines are nearly parallel, digits are lost. Such triangles are marked
 * doubtful and left to clip.h, which is slower and has no such limits. */
#ifndef VOX_VOXELIZE_CLIP_DIVIDE_LANES_H
#define VOX_VOXELIZE_CLIP_DIVIDE_LANES_H

#include "base/simd/simd.h"

/* Most planes that cut a triangle along an axis, and most voxels that it spans. */
enum {
    DIVIDE_MAX_PLANES = 3,
    DIVIDE_MAX_CELLS = (DIVIDE_MAX_PLANES + 1) * (DIVIDE_MAX_PLANES + 1) * (DIVIDE_MAX_PLANES + 1)
};

/* Least share of the triangle's area that a fragment may have, and least change of a coordinate
 * along a line that crosses a plane. Below, too many digits get lost. With both at these limits, a
 * fragment's centroid is exact to some millionths of the triangle's size. */
#define DIVIDE_LEAST_SHARE 1e-7
#define DIVIDE_LEAST_SLOPE 1e-3

/* Sums over a fragment's border: twice its area, and its moments, in the plane of corner
 * weights. */
struct divide_fragment {
    doubles share; /* of the triangle's area */
    doubles
        moment[2]; /* 3 times share times weight of the second and third corner at the centroid */
};

/* The spans of a line's parameter, from 0 to 1, inside each voxel along an axis. */
struct divide_spans {
    doubles from[DIVIDE_MAX_PLANES + 1], to[DIVIDE_MAX_PLANES + 1];
    doubles crossing[DIVIDE_MAX_PLANES]; /* parameters at the planes */
};

/* Computes the spans of a line whose coordinate is at + slope * parameter. Planes 1 to `planes`
 * separate the voxels. */
LANES_INLINE void divide_line(doubles at, doubles slope, int planes, struct divide_spans *spans,
                              lane_mask *doubtful)
{
    const doubles zero = lanes_all(0.0), one = lanes_all(1.0);
    if (planes == 0) {
        spans->from[0] = zero;
        spans->to[0] = one;
        return;
    }
    /* A constant coordinate crosses nothing. Then the signs of zero distinguish below from
     * above. */
    lane_mask down = lanes_signs(slope);
    lane_mask flat = lanes_less(lanes_abs(slope), lanes_all(DIVIDE_LEAST_SLOPE));
    doubles inverse = 1.0 / slope, before = lanes_keep(down, one), end = one - before;
    for (int i = 0; i < planes; i++) {
        doubles s = ((double)(i + 1) - at) * inverse;
        *doubtful |= lanes_equal(s, zero) | lanes_equal(s, one);
        *doubtful |= flat & ~(lanes_less(s, lanes_all(-0.1)) | lanes_less(lanes_all(1.1), s));
        spans->crossing[i] = s;
        s = lanes_min(lanes_max(s, zero), one);
        spans->from[i] = lanes_min(before, s);
        spans->to[i] = lanes_max(before, s);
        before = s;
    }
    spans->from[planes] = lanes_min(before, end);
    spans->to[planes] = lanes_max(before, end);
}

/* Corner weights of the points where the border, followed from corner to corner, rises through a
 * plane and where it falls through it. */
struct divide_cut {
    doubles rise[2], fall[2];
};

/* Finds these points. p: the corners' coordinates across the plane; inverse: of p[i] - p[i + 1]. */
LANES_INLINE void divide_border(const doubles p[3], const doubles inverse[3], double plane,
                                struct divide_cut *cut, lane_mask *doubtful)
{
    const doubles zero = lanes_all(0.0);
    doubles d[3], t[3];
    lane_mask below[3], rises[3], falls[3];
    for (int i = 0; i < 3; i++) {
        d[i] = p[i] - plane;
        below[i] = lanes_less(d[i], zero);
        t[i] = d[i] * inverse[i];
        *doubtful |= lanes_equal(d[i], zero);
    }
    for (int i = 0; i < 3; i++) {
        rises[i] = below[i] & ~below[(i + 1) % 3];
        falls[i] = ~below[i] & below[(i + 1) % 3];
    }
    /* Weights (t, 0) on the first edge, (1 - t, t) on the second, (0, 1 - t) on the third. */
    doubles rest1 = 1.0 - t[1], rest2 = 1.0 - t[2];
    cut->rise[0] = lanes_select(rises[1], rest1, lanes_keep(rises[0], t[0]));
    cut->rise[1] = lanes_select(rises[1], t[1], lanes_keep(rises[2], rest2));
    cut->fall[0] = lanes_select(falls[1], rest1, lanes_keep(falls[0], t[0]));
    cut->fall[1] = lanes_select(falls[1], t[1], lanes_keep(falls[2], rest2));
}

/* Adds the line in which one plane cuts the triangle. below: the first voxel of the layer below the
 * plane. stride: steps to the next voxel across the plane, along q and along r. */
LANES_INLINE void divide_add_cut(const struct divide_cut *cut, const struct divide_spans *q,
                                 int q_cells, const struct divide_spans *r, int r_cells,
                                 struct divide_fragment *below, const int stride[3])
{
    doubles cross = cut->rise[0] * cut->fall[1] - cut->rise[1] * cut->fall[0];
    doubles twice[2], delta[2];
    for (int k = 0; k < 2; k++) {
        twice[k] = cut->rise[k] + cut->rise[k];
        delta[k] = cut->fall[k] - cut->rise[k];
    }
    for (int j = 0; j < q_cells; j++)
        for (int k = 0; k < r_cells; k++) {
            struct divide_fragment *lower = below + j * stride[1] + k * stride[2];
            struct divide_fragment *upper = lower + stride[0];
            doubles from = lanes_max(q->from[j], r->from[k]), to = lanes_min(q->to[j], r->to[k]);
            doubles share = lanes_max(to - from, lanes_all(0.0)) * cross, sum = from + to;
            lower->share += share;
            upper->share -= share;
            for (int c = 0; c < 2; c++) {
                doubles moment = share * (twice[c] + sum * delta[c]);
                lower->moment[c] += moment;
                upper->moment[c] -= moment;
            }
        }
}

/* Starts the sums with the edge that does not touch the origin: from (1, 0) to (0, 1). */
LANES_INLINE void divide_edge(const struct divide_spans spans[3], const int cells[3],
                              struct divide_fragment *fragments)
{
    for (int i = 0; i < cells[0]; i++)
        for (int j = 0; j < cells[1]; j++) {
            doubles low = lanes_max(spans[0].from[i], spans[1].from[j]);
            doubles high = lanes_min(spans[0].to[i], spans[1].to[j]);
            for (int k = 0; k < cells[2]; k++) {
                doubles from = lanes_max(low, spans[2].from[k]);
                doubles to = lanes_min(high, spans[2].to[k]);
                doubles share = lanes_max(to - from, lanes_all(0.0)), sum = from + to;
                fragments->share = share;
                fragments->moment[0] = share * (2.0 - sum);
                fragments->moment[1] = share * sum;
                fragments++;
            }
        }
}

/* Marks triangles in which lines of two kinds meet on a line of the third: a voxel may be touched
 * in that point only. */
LANES_INLINE void divide_check_meeting(const struct divide_spans *q, int q_planes,
                                       const struct divide_spans *r, int r_planes,
                                       lane_mask *doubtful)
{
    for (int j = 0; j < q_planes; j++)
        for (int k = 0; k < r_planes; k++)
            *doubtful |= lanes_equal(q->crossing[j], r->crossing[k]);
}

/* Adds the lines of all planes across an axis. */
LANES_INLINE void divide_axis(const doubles p[3][3], int axis, const int planes[3],
                              const int stride[3], struct divide_fragment *fragments,
                              lane_mask *doubtful)
{
    const int q = (axis + 1) % 3, r = (axis + 2) % 3;
    const int strides[3] = {stride[axis], stride[q], stride[r]};
    doubles across[3], inverse[3];
    if (planes[axis] == 0)
        return;
    for (int i = 0; i < 3; i++)
        across[i] = p[i][axis];
    for (int i = 0; i < 3; i++)
        inverse[i] = 1.0 / (across[i] - across[(i + 1) % 3]);
    for (int i = 0; i < planes[axis]; i++) {
        struct divide_cut cut;
        struct divide_spans spans[2];
        divide_border(across, inverse, i + 1, &cut, doubtful);
        doubles d0 = cut.fall[0] - cut.rise[0], d1 = cut.fall[1] - cut.rise[1];
        for (int k = 0; k < 2; k++) {
            int other = k == 0 ? q : r;
            doubles e = p[1][other] - p[0][other], f = p[2][other] - p[0][other];
            divide_line(p[0][other] + cut.rise[0] * e + cut.rise[1] * f, d0 * e + d1 * f,
                        planes[other], &spans[k], doubtful);
        }
        if (axis == 0)
            divide_check_meeting(&spans[0], planes[q], &spans[1], planes[r], doubtful);
        divide_add_cut(&cut, &spans[0], planes[q] + 1, &spans[1], planes[r] + 1,
                       fragments + i * stride[axis], strides);
    }
}

/* Divides triangles whose corners p[corner][axis] lie in voxels 0 to planes[axis], relative to the
 * lowest voxel that each touches. Voxel (x, y, z) becomes fragments[(x * (planes[1] + 1) + y) *
 * (planes[2] + 1) + z]; divide_touching() returns which triangles touch it. Returns a mask of
 * triangles that lie too close to a voxel plane for this path; the caller clips them exactly.
 * divide_touching() may add to it. */
LANES_INLINE lane_mask divide_small(const doubles p[3][3], const int planes[3],
                                    struct divide_fragment *fragments)
{
    const int cells[3] = {planes[0] + 1, planes[1] + 1, planes[2] + 1};
    const int stride[3] = {cells[1] * cells[2], cells[2], 1};
    lane_mask doubtful = lanes_none();
    struct divide_spans edge[3];
    for (int a = 0; a < 3; a++)
        divide_line(p[1][a], p[2][a] - p[1][a], planes[a], &edge[a], &doubtful);
    divide_edge(edge, cells, fragments);
    /* Written out, so that the axis is a constant. */
    divide_axis(p, 0, planes, stride, fragments, &doubtful);
    divide_axis(p, 1, planes, stride, fragments, &doubtful);
    divide_axis(p, 2, planes, stride, fragments, &doubtful);
    return doubtful;
}

/* Returns the triangles that touch the voxel. Adds those for which this is uncertain to
 * `doubtful`. */
LANES_INLINE lane_mask divide_touching(const struct divide_fragment *fragment, lane_mask *doubtful)
{
    lane_mask touching = lanes_less(lanes_all(DIVIDE_LEAST_SHARE), fragment->share);
    *doubtful |= ~(touching | lanes_equal(fragment->share, lanes_all(0.0)));
    return touching;
}

#endif
