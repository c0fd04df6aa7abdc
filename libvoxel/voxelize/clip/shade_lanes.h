/* shade_lanes.h - what the fragments of triangles add to their voxels.
 *
 * Roots and quotients are computed for several triangles, or fragments of several triangles, side
 * by side. What a fragment adds to its voxel's sums is then the sum of the triangle's rows of four,
 * each multiplied by a number of the fragment.
 *
 * Let a value be q at the first corner, q + d at the second and q + e at the third. Its integral
 * over a fragment is then area * q + moment[0] * d + moment[1] * e. */
#ifndef VOX_VOXELIZE_CLIP_SHADE_LANES_H
#define VOX_VOXELIZE_CLIP_SHADE_LANES_H

#include "libvoxel/voxelize/clip/fragment_block.h"
#include "libvoxel/voxelize/clip/divide_lanes.h"

/* Values from which the weights of a triangle's fragments are computed. */
struct shade_weights {
    doubles squares[3];    /* squared lengths of the corners' normals */
    doubles gaps[3];       /* for corners 01, 12, 20: squared distances of their normals */
    doubles agreements[3]; /* dot products of the corners' normals with the plane's */
    doubles
        rise[3]; /* height of the surface that the normals describe above the corners, in voxels */
    /* For corners 01, 12, 20: 4 times the height of the arc over the edge that has the corners'
     * normals. */
    doubles arc[3];
};

/* Triangles side by side, in voxels relative to the lower corner of the lowest voxel of each. */
struct shade_triangles {
    doubles p[3][3];    /* corner, axis */
    doubles edge[2][3]; /* vectors from the first corner to the others */
    doubles flat[3];    /* unit normal of the plane; zero without an area */
    doubles area;       /* in voxel faces, VOX_NO_AREA at least */
    double noise_share; /* facet-noise weight of a triangle with edges of one voxel, before the
                           limit of 1 */
    doubles noise;
    bool has_normals;
    bool curved;       /* so large that planes differ from the surface that the normals describe */
    double lift_limit; /* highest arc and rise, in voxels */
    bool marked; /* normals have a facet-noise weight, or some planes are inconsistent with them */
    doubles normal[3][3]; /* corner, axis; unit */
    struct shade_weights weights;
    lane_ints class_bits; /* class of the fragments' normals, as in a link of the sums */
    lane_mask facet; /* the plane is inconsistent with the normals, or too far from their surface */
    bool has_color;
    doubles rgb[3][3]; /* corner, channel; linear light */
    doubles colored;   /* 1 if the triangle has a colour, else 0 */
};

/* ---- triangles ---- */

LANES_INLINE doubles shade_dot(const doubles a[3], const doubles b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Computes edges, plane, area and facet-noise weight from the corners. */
LANES_INLINE void shade_measure(struct shade_triangles *t)
{
    doubles n[3], *e = t->edge[0], *f = t->edge[1];
    for (int k = 0; k < 3; k++) {
        e[k] = t->p[1][k] - t->p[0][k];
        f[k] = t->p[2][k] - t->p[0][k];
    }
    n[0] = e[1] * f[2] - e[2] * f[1];
    n[1] = e[2] * f[0] - e[0] * f[2];
    n[2] = e[0] * f[1] - e[1] * f[0];
    doubles length = lanes_sqrt(shade_dot(n, n));
    doubles scale = lanes_keep(lanes_less(lanes_all(0.0), length), 1.0 / length);
    t->area = lanes_max(0.5 * length, lanes_all(VOX_NO_AREA));
    /* The mean square of the edges. The third edge is f - e. */
    doubles square = 2.0 / 3.0 * (shade_dot(e, e) + shade_dot(f, f) - shade_dot(e, f));
    t->noise = lanes_min(t->noise_share * square, lanes_all(1.0));
    for (int k = 0; k < 3; k++)
        t->flat[k] = n[k] * scale;
}

/* Gives corners without a normal the triangle's own. A normal is believed even if the winding
 * contradicts it. */
LANES_INLINE void shade_settle_normals(struct shade_triangles *t)
{
    for (int i = 0; i < 3; i++) {
        lane_mask has = lanes_less(lanes_all(0.0), shade_dot(t->normal[i], t->normal[i]));
        for (int k = 0; k < 3; k++)
            t->normal[i][k] = lanes_select(has, t->normal[i][k], t->flat[k]);
    }
}

/* Computes the values that give the lengths of interpolated normals and their agreement with the
 * plane. */
LANES_INLINE void shade_measure_normals(struct shade_triangles *t)
{
    for (int i = 0; i < 3; i++) {
        const doubles *n = t->normal[i], *next = t->normal[(i + 1) % 3];
        const doubles turn[3] = {next[0] - n[0], next[1] - n[1], next[2] - n[2]};
        t->weights.squares[i] = shade_dot(n, n);
        t->weights.gaps[i] = shade_dot(turn, turn);
        t->weights.agreements[i] = shade_dot(n, t->flat);
    }
}

/* Limits of the arc over an edge and of the rise above a corner, in voxels, so that lifted
 * fragments stay with their voxel. The second one holds for triangles close to the size of a voxel
 * (docs/decisions/0009-when-vertex-normals-count.md). */
#define SHADE_LIFT_LIMIT       0.1
#define SHADE_LIFT_LIMIT_CLOSE 0.2

/* Measures how far the surface that the corners' normals describe lies from the triangle's plane.
 * The limits hold for single edges and corners, because what two triangles share must not depend on
 * either of them. */
LANES_INLINE void shade_measure_arcs(struct shade_triangles *t)
{
    const doubles limit = lanes_all(4.0 * t->lift_limit), highest = lanes_all(t->lift_limit);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3;
        doubles arc = lanes_all(0.0), rise = t->weights.rise[i];
        for (int a = 0; a < 3; a++)
            arc += (t->p[i][a] - t->p[j][a]) * (t->normal[i][a] - t->normal[j][a]);
        arc *= 0.5;
        t->facet |= lanes_less(limit, lanes_abs(arc)) | lanes_less(highest, lanes_abs(rise));
        t->weights.arc[i] = lanes_min(lanes_max(arc, -limit), limit);
        t->weights.rise[i] = lanes_min(lanes_max(rise, -highest), highest);
    }
}

/* Finds the class of direction of the mean of the corners' normals. */
LANES_INLINE void shade_find_class(struct shade_triangles *t)
{
    doubles n[3];
    for (int k = 0; k < 3; k++)
        n[k] = t->has_normals ? t->normal[0][k] + t->normal[1][k] + t->normal[2][k] : t->flat[k];
    t->class_bits = lanes_all_bits(0);
    for (int k = 0; k < 3; k++) {
        const doubles turned =
            VOX_TURN_0 * n[k] + VOX_TURN_1 * n[(k + 1) % 3] + VOX_TURN_2 * n[(k + 2) % 3];
        t->class_bits = lanes_set_bits(lanes_less(turned, lanes_all(0.0)), t->class_bits,
                                       lanes_all_bits(UINT64_C(1) << (VOX_LINK_CLASS + k)));
    }
}

/* Computes all that follows from corners, after shade_measure(), and their normals. */
LANES_INLINE void shade_prepare(struct shade_triangles *t)
{
    if (t->has_normals) {
        shade_settle_normals(t);
        shade_measure_normals(t);
    }
    if (t->curved)
        shade_measure_arcs(t);
    shade_find_class(t);
}

/* ---- rows ---- */

LANES_INLINE void shade_put_row(struct block_facts *const facts[LANE_COUNT], enum block_row row,
                                const doubles first[3], doubles fourth)
{
    const doubles in[4] = {first[0], first[1], first[2], fourth};
    double *to[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++)
        to[l] = facts[l]->row[row];
    lanes_scatter(in, to);
}

LANES_INLINE void shade_put_difference(struct block_facts *const facts[LANE_COUNT],
                                       enum block_row row, const doubles to[3],
                                       const doubles from[3])
{
    const doubles difference[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
    shade_put_row(facts, row, difference, lanes_all(0.0));
}

LANES_INLINE void shade_put_colors(const struct shade_triangles *t,
                                   struct block_facts *const facts[LANE_COUNT])
{
    doubles rgb[3][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            rgb[i][k] = t->colored * t->rgb[i][k];
    shade_put_row(facts, ROW_COLOR, rgb[0], t->colored);
    shade_put_difference(facts, ROW_COLOR_CHANGE1, rgb[1], rgb[0]);
    shade_put_difference(facts, ROW_COLOR_CHANGE2, rgb[2], rgb[0]);
}

/* Writes the rows that each triangle's fragments share. */
LANES_INLINE void shade_put_facts(const struct shade_triangles *t,
                                  struct block_facts *const facts[LANE_COUNT])
{
    const doubles zero = lanes_all(0.0), none[3] = {zero, zero, zero};
    const doubles corner[3] = {t->p[0][0] - 0.5, t->p[0][1] - 0.5, t->p[0][2] - 0.5};
    shade_put_row(facts, ROW_CORNER, corner, lanes_all(1.0));
    shade_put_row(facts, ROW_EDGE1, t->edge[0], zero);
    shade_put_row(facts, ROW_EDGE2, t->edge[1], zero);
    shade_put_row(facts, ROW_FLAT, t->flat, t->noise);
    if (t->has_normals) {
        shade_put_row(facts, ROW_NORMAL, t->normal[0], zero);
        shade_put_difference(facts, ROW_TURN1, t->normal[1], t->normal[0]);
        shade_put_difference(facts, ROW_TURN2, t->normal[2], t->normal[0]);
    }
    if (t->marked)
        shade_put_row(facts, ROW_NOISE, none,
                      lanes_select(t->facet, lanes_all(VOX_INCONSISTENT), t->noise));
    if (t->has_color)
        shade_put_colors(t, facts);
}

/* ---- fragments ---- */

#if LANE_COUNT == 8
/* Returns the weights of the triangles whose indices are in the low three bits of `which`. */
LANES_INLINE struct shade_weights shade_pick(const struct shade_weights *from, bool curved,
                                             lane_ints which)
{
    struct shade_weights to;
    for (int i = 0; i < 3; i++) {
        to.squares[i] = lanes_pick(from->squares[i], which);
        to.gaps[i] = lanes_pick(from->gaps[i], which);
        to.agreements[i] = lanes_pick(from->agreements[i], which);
        to.rise[i] = curved ? lanes_pick(from->rise[i], which) : lanes_all(0.0);
        to.arc[i] = curved ? lanes_pick(from->arc[i], which) : lanes_all(0.0);
    }
    return to;
}
#endif

/* Computes the weights of fragments in the sums of normals and of centroids.
 *
 * A direction counts as far as it agrees with the triangle's plane. So coverage says how well a
 * voxel's plane stands for its surface.
 *
 * Centroids are moved from the triangle's plane onto the curved surface, so that the plane of a
 * voxel agrees with its normal. At corner weights w, the tangent plane of corner i is (p_i - p) .
 * n_i away. Half the mean of these is the height of a surface of constant curvature; Boubekeur &
 * Alexa, "Phong Tessellation", 2008, blend the same planes. With p = sum of w_i p_i it equals half
 * the sum of w_i w_j (p_i - p_j) . (n_i - n_j) over the edges. The rise of the corners above their
 * vertices is added.
 *
 * The squared length of the interpolated normal is the sum of w_i n_i^2 less the sum of w_i w_j
 * (n_i - n_j)^2. All weights here are multiplied by the area. */
LANES_INLINE void shade_weigh(const struct shade_weights *of, bool curved, doubles area,
                              const doubles moment[2], doubles *normal, doubles *center,
                              lane_mask *cancels)
{
    const doubles w[3] = {area - moment[0] - moment[1], moment[0], moment[1]};
    const doubles pairs[3] = {w[0] * w[1], w[1] * w[2], w[2] * w[0]};
    doubles square = area * shade_dot(w, of->squares) - shade_dot(pairs, of->gaps);
    doubles inverse = 1.0 / (area * lanes_sqrt(square)), across = area * inverse;
    *cancels = ~lanes_less(1e-12 * (area * area), square);
    *normal = area * lanes_abs(shade_dot(w, of->agreements)) * (across * across);
    if (curved)
        *center = (shade_dot(pairs, of->arc) + area * shade_dot(w, of->rise)) * inverse;
}

/* Three consecutive rows: a value at the first corner and its changes. */
struct shade_rows {
    struct row row[3];
};

LANES_INLINE struct row shade_row(const struct block_facts *facts, enum block_row row)
{
    return row_load(facts->row[row]);
}

LANES_INLINE struct shade_rows shade_rows(const struct block_facts *facts, enum block_row row)
{
    return (struct shade_rows){
        {shade_row(facts, row), shade_row(facts, row + 1), shade_row(facts, row + 2)}};
}

/* Returns the area times the mean over the fragment of a value: the first row at the first corner,
 * changed by the others at the others. */
LANES_INLINE struct row shade_mean(struct shade_rows rows, const struct block_fragment *fragment)
{
    return row_sum(row_sum(row_times(fragment->area, rows.row[0]),
                           row_times(fragment->moment[0], rows.row[1])),
                   row_times(fragment->moment[1], rows.row[2]));
}

/* Lower corners of voxels relative to the lowest voxel, four numbers each. */
#define SHADE_CELLS_Z(x, y) x, y, 0, 0, x, y, 1, 0, x, y, 2, 0, x, y, 3, 0
#define SHADE_CELLS_Y(x)                                                                           \
    SHADE_CELLS_Z(x, 0), SHADE_CELLS_Z(x, 1), SHADE_CELLS_Z(x, 2), SHADE_CELLS_Z(x, 3)
static const double shade_cells[64 * 4] = {SHADE_CELLS_Y(0), SHADE_CELLS_Y(1), SHADE_CELLS_Y(2),
                                           SHADE_CELLS_Y(3)};

/* Returns the area times the centroid, relative to the centre of the voxel with the lower corner
 * `cell`. */
LANES_INLINE struct row shade_center(const struct block_facts *facts,
                                     const struct block_fragment *fragment, const double cell[4])
{
    struct shade_rows rows = shade_rows(facts, ROW_CORNER);
    rows.row[0] = row_difference(rows.row[0], row_load(cell));
    return shade_mean(rows, fragment);
}

/* Computes the sums of a fragment that has the triangle's own normal. */
LANES_INLINE void shade_flat(const struct block_facts *facts, const struct block_fragment *fragment,
                             const double cell[4], struct vox_fragment_sum *sum)
{
    sum->normal = row_times(fragment->area, shade_row(facts, ROW_FLAT));
    sum->center = shade_center(facts, fragment, cell);
}

/* Computes the sums of a fragment with an interpolated normal. */
LANES_INLINE void shade_smooth(const struct block_facts *facts,
                               const struct block_fragment *fragment, const double cell[4],
                               bool marked, bool curved, struct vox_fragment_sum *sum)
{
    struct row normal = shade_mean(shade_rows(facts, ROW_NORMAL), fragment);
    sum->normal = row_times(fragment->normal_weight, normal);
    sum->center = shade_center(facts, fragment, cell);
    if (marked)
        sum->normal = row_sum(sum->normal, row_times(fragment->area, shade_row(facts, ROW_NOISE)));
    if (curved)
        sum->center = row_sum(sum->center, row_times(fragment->center_weight, normal));
}

#endif
