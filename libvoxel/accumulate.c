/* accumulate.c - the loop over triangles.
 *
 * Runs of triangles that miss the window are passed over by their bounds. Of the rest, many are
 * smaller than a voxel, and those that lie inside one go straight to its record. */
#include "libvoxel/accumulate.h"

#include <math.h>
#include <string.h>

/* What the pieces of one triangle share. */
struct target {
    const struct vox_shading *shading;
    struct vox_accumulator *accumulator;
    const struct vox_box *region;
    const double *corner[3];
    double edge[2][3]; /* from the first corner to the others */
    double area;       /* of the triangle, in voxel faces */
    struct vox_corners corners;
    /* Of corners 01, 12, 20: 8 times the height of the arc over the edge that has the corners' normals. */
    double arc[3];
    bool facet; /* the plane is too far from that surface to go with the normals */
};

static bool overlap(const struct vox_box *a, const struct vox_box *b)
{
    bool apart = false;
    for (int k = 0; k < 3; k++)
        apart |= (a->lo[k] > b->hi[k]) | (a->hi[k] < b->lo[k]);
    return !apart;
}

static bool contains(const struct vox_box *box, const int32_t cell[3])
{
    bool outside = false;
    for (int k = 0; k < 3; k++)
        outside |= (cell[k] < box->lo[k]) | (cell[k] > box->hi[k]);
    return !outside;
}

static inline double min3(double a, double b, double c)
{
    double m = b < a ? b : a;
    return c < m ? c : m;
}

static inline double max3(double a, double b, double c)
{
    double m = b > a ? b : a;
    return c > m ? c : m;
}

/* Cells of the triangle's bounds. They are not below the lattice, but what lies on its upper bounds
 * has its cell just above. */
static inline struct vox_box cells_of(const struct vox_lattice *lattice, const double *p0,
                                      const double *p1, const double *p2)
{
    struct vox_box cells;
    for (int a = 0; a < 3; a++) {
        int32_t lo = (int32_t)floor(min3(p0[a], p1[a], p2[a]));
        int32_t hi = (int32_t)floor(max3(p0[a], p1[a], p2[a]));
        int32_t last = lattice->voxels.hi[a];
        cells.lo[a] = lo < last ? lo : last;
        cells.hi[a] = hi < last ? hi : last;
    }
    return cells;
}

/* Edges, plane and area, from the corners. */
static inline void measure(struct target *t)
{
    double n[3], *e = t->edge[0], *f = t->edge[1];
    for (int k = 0; k < 3; k++) {
        e[k] = t->corner[1][k] - t->corner[0][k];
        f[k] = t->corner[2][k] - t->corner[0][k];
    }
    n[0] = e[1] * f[2] - e[2] * f[1];
    n[1] = e[2] * f[0] - e[0] * f[2];
    n[2] = e[0] * f[1] - e[1] * f[0];
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    double scale = length > 0.0 ? 1.0 / length : 0.0;
    t->area = 0.5 * length;
    for (int k = 0; k < 3; k++)
        t->corners.flat[k] = n[k] * scale;
}

/* Highest arc over an edge onto which pieces are lifted, in voxels: they have to stay with their voxel. */
static const double lift_limit = 0.1;

/* Measures how far the surface that the corners' normals describe bulges from the triangle's plane. Limited edge by
 * edge, as what two triangles share must not depend on either. */
static void measure_arcs(struct target *t)
{
    t->facet = false;
    if (!t->corners.curved)
        return;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3;
        double arc = 0.0;
        for (int k = 0; k < 3; k++)
            arc += (t->corner[i][k] - t->corner[j][k]) *
                   (t->corners.normal[i][k] - t->corners.normal[j][k]);
        t->facet |= fabs(arc) > 8.0 * lift_limit;
        t->arc[i] = fmin(fmax(arc, -8.0 * lift_limit), 8.0 * lift_limit);
    }
}

/* Moves a piece from the triangle's plane onto that surface, so that the plane of a voxel goes with its normal. At
 * weights w the tangent plane of corner i is (p_i - p) . n_i away, and half the mean of these is the height of a
 * surface of constant curvature (Boubekeur & Alexa, "Phong Tessellation", 2008, blend the same planes). With
 * p = sum of w_i p_i that is half the sum of w_i w_j (p_i - p_j) . (n_i - n_j) over the edges. */
static void lift(const struct target *t, const double b[2], const double normal[3],
                 struct vox_sample *sample)
{
    const double w[3] = {1.0 - b[0] - b[1], b[0], b[1]};
    double height =
        0.5 * (w[0] * w[1] * t->arc[0] + w[1] * w[2] * t->arc[1] + w[2] * w[0] * t->arc[2]);
    for (int k = 0; k < 3; k++)
        sample->center[k] += height * normal[k];
}

static inline int add_piece(void *arg, const struct vox_piece *piece)
{
    const struct target *t = arg;
    struct vox_sample sample;
    sample.area = t->area * piece->fraction;
    for (int k = 0; k < 3; k++) {
        double at = t->corner[0][k] + piece->b[0] * t->edge[0][k] + piece->b[1] * t->edge[1][k];
        sample.center[k] = at - (piece->cell[k] + 0.5);
        sample.voxel[k] = (uint32_t)(piece->cell[k] - t->region->lo[k]);
    }
    for (int k = 0; k < 3; k++)
        sample.normal[k] = t->corners.flat[k];
    if (t->corners.has_normals) {
        double normal[3];
        vox_shade_normal(&t->corners, piece->b, normal);
        /* Directions count as far as they agree with the triangle's: then coverage tells how well a voxel's
         * plane stands for its surface. */
        double agreement = fabs(vox_dot(normal, t->corners.flat));
        for (int k = 0; k < 3; k++)
            sample.normal[k] = agreement * normal[k];
        if (t->corners.curved)
            lift(t, piece->b, normal, &sample);
    }
    sample.shaded = t->facet;
    sample.has_color = t->corners.color_source != VOX_COLOR_NONE;
    if (sample.has_color) {
        double rgb[3];
        int status = vox_shade_color(t->shading, &t->corners, piece->b, piece->uv_extent, rgb);
        if (status < 0)
            return status;
        for (int k = 0; k < 3; k++)
            sample.rgb[k] = rgb[k];
    }
    return vox_accumulator_add(t->accumulator, &sample);
}

/* The triangle as its only piece. */
static int add_whole(struct target *t, const struct vox_box *cells)
{
    struct vox_piece piece = {.fraction = 1.0, .b = {1.0 / 3.0, 1.0 / 3.0}};
    memcpy(piece.cell, cells->lo, sizeof piece.cell);
    if (t->corners.color_source == VOX_COLOR_TEXTURE)
        for (int k = 0; k < 2; k++) {
            const double(*uv)[2] = (const double(*)[2])t->corners.uv;
            piece.uv_extent[k] =
                max3(uv[0][k], uv[1][k], uv[2][k]) - min3(uv[0][k], uv[1][k], uv[2][k]);
        }
    return add_piece(t, &piece);
}

static inline int add_pieces(struct target *t, const struct vox_box *cells,
                             const struct vox_box *window)
{
    struct vox_clip_triangle triangle = {
        .corner = {t->corner[0], t->corner[1], t->corner[2]},
        .cells = cells,
    };
    if (t->corners.color_source == VOX_COLOR_TEXTURE)
        triangle.uv = (const double(*)[2])t->corners.uv;
    return vox_clip(&triangle, t->region, window, add_piece, t);
}

/* A corner without a normal has the triangle's own. Normals are believed even where the winding says otherwise. */
static void settle_normals(struct target *t)
{
    for (int i = 0; i < 3; i++)
        if (!(vox_dot(t->corners.normal[i], t->corners.normal[i]) > 0.0))
            memcpy(t->corners.normal[i], t->corners.flat, sizeof t->corners.flat);
}

static int add_group(struct target *t, const struct vox_lattice *lattice,
                     const struct vox_chunk *chunk, const struct vox_box *window, uint32_t begin,
                     uint32_t end)
{
    int status = 0;
    for (uint32_t i = begin; i < end && status == 0; i++) {
        const uint32_t *v = chunk->source.triangles[i];
        const double *p0 = chunk->points[v[0]], *p1 = chunk->points[v[1]];
        const double *p2 = chunk->points[v[2]];
        struct vox_box cells = cells_of(lattice, p0, p1, p2);
        if (!overlap(&cells, window))
            continue;
        t->corner[0] = p0;
        t->corner[1] = p1;
        t->corner[2] = p2;
        measure(t);
        vox_shade_corners(t->shading, chunk, i, &t->corners);
        if (t->corners.has_normals)
            settle_normals(t);
        measure_arcs(t);
        bool one = true;
        for (int a = 0; a < 3; a++)
            one &= cells.lo[a] == cells.hi[a];
        status = one ? add_whole(t, &cells) : add_pieces(t, &cells, window);
    }
    return status;
}

int vox_accumulate_chunk(const struct vox_shading *shading, const struct vox_lattice *lattice,
                         const struct vox_chunk *chunk, const struct vox_box *region,
                         const struct vox_box *window, struct vox_accumulator *accumulator,
                         uint64_t *counted)
{
    struct target target = {.shading = shading, .accumulator = accumulator, .region = region};
    uint32_t count = chunk->source.triangle_count;
    for (uint32_t g = 0; g < chunk->group_count; g++) {
        const struct vox_box *bounds = &chunk->groups[g];
        if (!overlap(bounds, window))
            continue;
        uint32_t begin = g * VOX_GROUP_TRIANGLES;
        uint32_t end = count - begin < VOX_GROUP_TRIANGLES ? count : begin + VOX_GROUP_TRIANGLES;
        int status = add_group(&target, lattice, chunk, window, begin, end);
        if (status != 0)
            return status;
        if (contains(window, bounds->lo))
            *counted += end - begin;
    }
    return 0;
}
