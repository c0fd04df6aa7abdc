/* shade_lanes.h - what the pieces of triangles add to their voxels.
 *
 * What takes roots and quotients is found for several triangles, or pieces of several, at once.
 * What a piece adds is then a sum of rows of four, its triangle's, times numbers that are its own.
 * So it comes out in the form of the sums.
 *
 * Where a value is q at the first corner and differs by d and e at the others, a piece's area times
 * the mean of that value over the piece is area * q + moment[0] * d + moment[1] * e. */
#ifndef VOX_VOXELIZE_CLIP_SHADE_LANES_H
#define VOX_VOXELIZE_CLIP_SHADE_LANES_H

#include "libvoxel/voxelize/clip/fragment_block.h"
#include "libvoxel/voxelize/clip/divide_lanes.h"

/* What the weights of a triangle's pieces follow from. */
struct shade_weights {
    doubles squares[3];    /* of the corners' normals */
    doubles gaps[3];       /* of corners 01, 12, 20: squares of their normals' distances */
    doubles agreements[3]; /* of the corners' normals with the plane's */
    doubles rise[3];       /* of the surface they describe above the corners, in voxels */
    /* Of corners 01, 12, 20: 4 times the height of the arc over the edge that has the corners'
     * normals. */
    doubles arc[3];
};

/* Triangles side by side, in voxels from the lower corner of a cell of each. */
struct shade_triangles {
    doubles p[3][3];    /* corner, axis */
    doubles edge[2][3]; /* from the first corner to the others */
    doubles flat[3];    /* unit normal of the plane, zero where there is no area */
    doubles area;       /* in voxel faces, VOX_NO_AREA at least */
    double grain_share; /* grain of a triangle with edges of a voxel, were it not 1 at most */
    doubles grain;
    bool has_normals;
    bool curved;       /* so large that planes differ from the surface that the normals describe */
    double lift_limit; /* highest arc and rise, in voxels */
    bool marked;       /* normals have grain, or planes that do not go with them are to be marked */
    doubles normal[3][3]; /* corner, axis; unit */
    struct shade_weights weights;
    lane_mask facet; /* the plane does not go with the normals, or is too far from that surface */
    bool has_color;
    doubles rgb[3][3]; /* corner, channel; linear light */
    doubles colored;   /* 1 where the triangle has a colour, else 0 */
};

/* ---- triangles ---- */

LANES_INLINE doubles shade_dot(const doubles a[3], const doubles b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Edges, plane, area and grain, from the corners. */
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
    /* The mean square of the edges: the third is f - e. */
    doubles square = 2.0 / 3.0 * (shade_dot(e, e) + shade_dot(f, f) - shade_dot(e, f));
    t->grain = lanes_min(t->grain_share * square, lanes_all(1.0));
    for (int k = 0; k < 3; k++)
        t->flat[k] = n[k] * scale;
}

/* A corner without a normal has the triangle's own. Normals are believed even where the winding
 * says otherwise. */
LANES_INLINE void shade_settle_normals(struct shade_triangles *t)
{
    for (int i = 0; i < 3; i++) {
        lane_mask has = lanes_less(lanes_all(0.0), shade_dot(t->normal[i], t->normal[i]));
        for (int k = 0; k < 3; k++)
            t->normal[i][k] = lanes_select(has, t->normal[i][k], t->flat[k]);
    }
}

/* What the lengths of interpolated normals follow from, and their agreement with the plane. */
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

/* Highest arc over an edge, and highest rise above a corner, onto which pieces are lifted, in
 * voxels: they have to stay with their voxel. Close to the size of a voxel triangles need their
 * planes, as blended normals alone lose detail: waves of 10 triangles, each 1.6 voxels and with
 * slopes of 20 degrees, err by 0.32 degrees with the lower limit and by 0.11 with the higher one.
 */
#define SHADE_LIFT_LIMIT       0.1
#define SHADE_LIFT_LIMIT_CLOSE 0.2

/* Measures how far the surface that the corners' normals describe lies from the triangle's plane.
 * Limited edge by edge and corner by corner, as what two triangles share must not depend on either.
 */
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

/* What follows from corners and their normals. */
LANES_INLINE void shade_prepare(struct shade_triangles *t)
{
    shade_measure(t);
    if (t->has_normals) {
        shade_settle_normals(t);
        shade_measure_normals(t);
    }
    if (t->curved)
        shade_measure_arcs(t);
}

/* ---- facts ---- */

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

/* What the triangles' pieces have in common. */
LANES_INLINE void shade_put_facts(const struct shade_triangles *t,
                                  struct block_facts *const facts[LANE_COUNT])
{
    const doubles zero = lanes_all(0.0), none[3] = {zero, zero, zero};
    const doubles corner[3] = {t->p[0][0] - 0.5, t->p[0][1] - 0.5, t->p[0][2] - 0.5};
    shade_put_row(facts, ROW_CORNER, corner, lanes_all(1.0));
    shade_put_row(facts, ROW_EDGE1, t->edge[0], zero);
    shade_put_row(facts, ROW_EDGE2, t->edge[1], zero);
    shade_put_row(facts, ROW_FLAT, t->flat, t->grain);
    if (t->has_normals) {
        shade_put_row(facts, ROW_NORMAL, t->normal[0], zero);
        shade_put_difference(facts, ROW_TURN1, t->normal[1], t->normal[0]);
        shade_put_difference(facts, ROW_TURN2, t->normal[2], t->normal[0]);
    }
    if (t->marked)
        shade_put_row(facts, ROW_GRAIN, none,
                      lanes_select(t->facet, lanes_all(VOX_SHADED), t->grain));
    if (t->has_color)
        shade_put_colors(t, facts);
}

/* ---- pieces ---- */

#if LANE_COUNT == 8
/* Those of the triangles with these indices, of whose bits only the lowest matter. */
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

/* Directions count as far as they agree with the triangle's: then coverage tells how well a voxel's
 * plane stands for its surface.
 *
 * Centres are moved from the triangle's plane onto the curved surface, so that the plane of a voxel
 * goes with its normal. At weights w the tangent plane of corner i is (p_i - p) . n_i away, and
 * half the mean of these is the height of a surface of constant curvature (Boubekeur & Alexa,
 * "Phong Tessellation", 2008, blend the same planes). With p = sum of w_i p_i that is half the sum
 * of w_i w_j (p_i - p_j) . (n_i - n_j) over the edges. Corners that are not on that surface take
 * their neighbourhood along.
 *
 * The square of the interpolated normal is the sum of w_i n_i^2 less that of w_i w_j (n_i - n_j)^2.
 * All is computed with weights times area. */
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

/* A row, and the two that follow it. */
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

/* Area times mean over the piece of what is the first row at the first corner, and differs by the
 * others at the others. */
LANES_INLINE struct row shade_mean(struct shade_rows rows, const struct block_piece *piece)
{
    return row_sum(
        row_sum(row_times(piece->area, rows.row[0]), row_times(piece->moment[0], rows.row[1])),
        row_times(piece->moment[1], rows.row[2]));
}

/* Corners of cells from that of the lowest, by block_piece's number. */
#define SHADE_CELLS_Z(x, y)                                                                        \
    {x, y, 0, 0}, {x, y, 1, 0}, {x, y, 2, 0},                                                      \
    {                                                                                              \
        x, y, 3, 0                                                                                 \
    }
#define SHADE_CELLS_Y(x)                                                                           \
    SHADE_CELLS_Z(x, 0), SHADE_CELLS_Z(x, 1), SHADE_CELLS_Z(x, 2), SHADE_CELLS_Z(x, 3)
static const double shade_cells[64][4] = {SHADE_CELLS_Y(0), SHADE_CELLS_Y(1), SHADE_CELLS_Y(2),
                                          SHADE_CELLS_Y(3)};

/* Area times centroid, from the centre of the cell, whose lower corner is `cell`. */
LANES_INLINE struct row shade_center(const struct block_facts *facts,
                                     const struct block_piece *piece, const double cell[4])
{
    struct shade_rows rows = shade_rows(facts, ROW_CORNER);
    rows.row[0] = row_difference(rows.row[0], row_load(cell));
    return shade_mean(rows, piece);
}

/* The sums for a piece that has the triangle's own normal. */
LANES_INLINE void shade_flat(const struct block_facts *facts, const struct block_piece *piece,
                             const double cell[4], struct vox_piece_sum *sum)
{
    sum->normal = row_times(piece->area, shade_row(facts, ROW_FLAT));
    sum->center = shade_center(facts, piece, cell);
}

/* And for one with a normal that is interpolated. */
LANES_INLINE void shade_smooth(const struct block_facts *facts, const struct block_piece *piece,
                               const double cell[4], bool marked, bool curved,
                               struct vox_piece_sum *sum)
{
    struct row normal = shade_mean(shade_rows(facts, ROW_NORMAL), piece);
    sum->normal = row_times(piece->normal_weight, normal);
    sum->center = shade_center(facts, piece, cell);
    if (marked)
        sum->normal = row_sum(sum->normal, row_times(piece->area, shade_row(facts, ROW_GRAIN)));
    if (curved)
        sum->center = row_sum(sum->center, row_times(piece->center_weight, normal));
}

#endif
