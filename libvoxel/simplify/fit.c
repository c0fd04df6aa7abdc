/* fit.c - see fit.h.
 *
 * A point of a triangle moves by the weighted sum of its corners' moves. The square of that is at
 * most the weighted sum of squares, so each vertex can minimise its own share, and the whole falls
 * all the same: there is no system of equations. Such steps are short, so there are several rounds.
 * The closest triangle is looked for around the one of the round before, and at first around the
 * vertex that a point's own one collapsed into, so a point stays on its side of a thin wall. */
#include "libvoxel/simplify/fit.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"
#include "libvoxel/simplify/folds.h"

enum { FIT_ROUNDS = 6 };
/* Weight of a triangle's middle, beside its area at each of its corners: then the squares of a
 * distance that is linear in the triangle sum up to their integral. Corners lie outside of what is
 * round, so with less the mesh would, too, and its silhouette grow. */
static const double middle_weight = 9;
/* Factor of steps: shares are minimised as if all corners moved alike, which is less than needed.
 */
static const double fit_stride = 1.5;
/* Pull towards the old place, in parts of the quadric's trace, inside and at borders. */
static const double fit_pull = 3e-3, border_pull = 0.3;
/* A point that is farther away than the surface has gone has the wrong triangle, unless its squared
 * distance is below this share of its area, where drifts are rounding. */
static const double rounding_share = 1e-6;
/* A vertex counts as much as all points around it if its squared distance from the old mesh is this
 * many times the mean square of all points' distances; a nearer one counts far less. So does the
 * farthest point whose foot is at the vertex, as at a corner that was cut off. */
static const double far_factor = 100;
/* Most that a vertex counts more than the points around it; and such a point. */
static const double most_weight = 1e4, most_weight_point = 1;
/* Least share of a vertex in a foot that is at it. */
static const double at_vertex = 0.9;

/* What points say about where a vertex should go. */
struct advice {
    double a[6], b[3];   /* of the quadric x A x - 2 b x, with x from the vertex */
    double squares;      /* of distances, weighted */
    double way[3];       /* from the closest point of the old mesh, as far as it was found */
    double square;       /* of that */
    double point_way[3]; /* to the farthest point whose foot is at the vertex */
    double point_square; /* of the vertex's share of that */
};

struct fit {
    struct vox_rings *r;
    const struct vox_fit_from *from;
    uint32_t *near; /* of old vertices, then of old triangles: a corner of the closest triangle */
    double *areas;  /* of old vertices: of the triangles around them */
    struct advice *advice;  /* of vertices */
    double squares, weight; /* of all points of a round */
};

/* The point of a triangle that is closest to another one. */
struct foot {
    uint32_t corner;
    double shares[3]; /* of the triangle's corners, that one first */
    double way[3];    /* from it to the other point */
    double square;
};

/* Finds the closest point of a triangle (Ericson, "Real-Time Collision Detection", 2005, section
 * 5.1.5). Its square is not a number if two corners are at the same place. */
static void find_foot(const float *const corners[3], const double p[3], struct foot *foot)
{
    double ab[3], ac[3], ap[3], v = 0, w = 0;
    for (int k = 0; k < 3; k++) {
        ab[k] = (double)corners[1][k] - (double)corners[0][k];
        ac[k] = (double)corners[2][k] - (double)corners[0][k];
        ap[k] = p[k] - (double)corners[0][k];
    }
    const double bc = bsq_dotd(ab, ac), b = bsq_dotd(ab, ap), c = bsq_dotd(ac, ap);
    const double b_at_b = b - bsq_dotd(ab, ab), c_at_b = c - bc, b_at_c = b - bc,
                 c_at_c = c - bsq_dotd(ac, ac);
    const double to_ab = b * c_at_b - b_at_b * c, to_ac = b_at_c * c - b * c_at_c,
                 to_bc = b_at_b * c_at_c - b_at_c * c_at_b;
    if (b <= 0 && c <= 0) {
        v = w = 0;
    } else if (b_at_b >= 0 && c_at_b <= b_at_b) {
        v = 1;
    } else if (c_at_c >= 0 && b_at_c <= c_at_c) {
        w = 1;
    } else if (to_ab <= 0 && b >= 0 && b_at_b <= 0) {
        v = b / (b - b_at_b);
    } else if (to_ac <= 0 && c >= 0 && c_at_c <= 0) {
        w = c / (c - c_at_c);
    } else if (to_bc <= 0) {
        w = (c_at_b - b_at_b) / (c_at_b - b_at_b + b_at_c - c_at_c);
        v = 1 - w;
    } else {
        v = to_ac / (to_ab + to_ac + to_bc);
        w = to_ab / (to_ab + to_ac + to_bc);
    }
    foot->shares[0] = 1 - v - w;
    foot->shares[1] = v;
    foot->shares[2] = w;
    for (int k = 0; k < 3; k++)
        foot->way[k] = ap[k] - v * ab[k] - w * ac[k];
    foot->square = bsq_dotd(foot->way, foot->way);
}

/* The corners of a corner's triangle, that one first. */
static void list_corners(const struct vox_rings *r, uint32_t corner, uint32_t corners[3])
{
    corners[0] = r->words[corner];
    corners[1] = vox_after(r, corner);
    corners[2] = vox_before(r, corner);
}

static void find_foot_at(const struct vox_rings *r, uint32_t corner, const double p[3],
                         struct foot *foot)
{
    const float(*at)[3] = (const float(*)[3])r->mesh->positions;
    uint32_t v[3];
    list_corners(r, corner, v);
    find_foot((const float *const[3]){at[v[0]], at[v[1]], at[v[2]]}, p, foot);
    foot->corner = corner;
}

static bool is_inside(const struct foot *foot)
{
    return foot->shares[0] > 0 && foot->shares[1] > 0 && foot->shares[2] > 0;
}

/* Walks from a triangle to the one that is closest to a point, over the corners that its foot is
 * next to. */
static void walk_to_foot(struct vox_rings *r, uint32_t start, const double p[3], struct foot *best)
{
    double before = INFINITY;
    find_foot_at(r, start, p, best);
    while (best->square < before && !is_inside(best)) {
        const struct foot from = *best;
        uint32_t v[3];
        list_corners(r, from.corner, v);
        before = from.square;
        for (int i = 0; i < 3; i++) {
            if (!(from.shares[i] > 0))
                continue;
            for (VOX_EACH_CORNER(r, v[i], k)) {
                struct foot foot;
                find_foot_at(r, k, p, &foot);
                if (foot.square < best->square)
                    *best = foot;
            }
        }
    }
}

/* Adds w n n^T and w along n. */
static void add_advice(struct advice *advice, const double n[3], double along, double w)
{
    advice->a[0] += w * n[0] * n[0];
    advice->a[1] += w * n[0] * n[1];
    advice->a[2] += w * n[0] * n[2];
    advice->a[3] += w * n[1] * n[1];
    advice->a[4] += w * n[1] * n[2];
    advice->a[5] += w * n[2] * n[2];
    for (int k = 0; k < 3; k++)
        advice->b[k] += w * along * n[k];
}

/* Advises the corners of a point's foot. What lies beyond a border says nothing. */
static void advise_corners(struct fit *f, const struct foot *foot, double weight)
{
    const struct vox_rings *r = f->r;
    uint32_t v[3];
    double n[3];
    memcpy(n, foot->way, sizeof n);
    list_corners(r, foot->corner, v);
    if (is_inside(foot))
        vox_triangle_normal((const float(*)[3])r->mesh->positions, v, n);
    for (int i = 0; i < 3; i++)
        if (!is_inside(foot) && foot->shares[i] > 0 && (r->flags[v[i]] & VOX_BORDER))
            return;
    const double length = sqrt(bsq_dotd(n, n));
    if (!(length > 0))
        return;
    for (int k = 0; k < 3; k++)
        n[k] /= length;
    const double along = bsq_dotd(n, foot->way);
    for (int i = 0; i < 3; i++) {
        const double w = weight * foot->shares[i];
        struct advice *advice = &f->advice[v[i]];
        add_advice(advice, n, along, w);
        advice->squares += w * along * along;
        const double square = foot->shares[i] * foot->shares[i] * foot->square;
        if (foot->shares[i] > at_vertex && square > advice->point_square) {
            advice->point_square = square;
            memcpy(advice->point_way, foot->way, sizeof advice->point_way);
        }
    }
}

/* Finds the foot of a point. Returns whether it is near enough to count. */
static bool add_point(struct fit *f, uint32_t point, const double p[3], double weight,
                      struct foot *foot)
{
    uint32_t v[3];
    double drift = 0;
    if (f->near[point] == VOX_NONE)
        return false;
    walk_to_foot(f->r, f->near[point], p, foot);
    f->near[point] = foot->corner;
    list_corners(f->r, foot->corner, v);
    for (int i = 0; i < 3; i++)
        drift = fmax(drift, (double)f->from->drifts[v[i]]);
    if (!(foot->square <= fmax(drift * drift, rounding_share * weight)))
        return false;
    f->squares += weight * foot->square;
    f->weight += weight;
    advise_corners(f, foot, weight);
    return true;
}

/* Notes how far a vertex is from an old triangle, if none was nearer. area: of its square root, the
 * corners are at most about twice as far from its middle. */
static void look_at(struct fit *f, uint32_t v, const float *const corners[3],
                    const double middle[3], double area)
{
    struct advice *advice = &f->advice[v];
    struct foot foot;
    double at[3], way[3];
    for (int k = 0; k < 3; k++) {
        at[k] = (double)f->r->mesh->positions[v][k];
        way[k] = at[k] - middle[k];
    }
    if (bsq_dotd(way, way) > 2 * advice->square + 8 * area)
        return;
    find_foot(corners, at, &foot);
    if (!(foot.square < advice->square))
        return;
    advice->square = foot.square;
    memcpy(advice->way, foot.way, sizeof advice->way);
}

/* Adds the middle of an old triangle, and looks how far the corners of its foot are from it. */
static void add_triangle(struct fit *f, uint32_t t)
{
    const struct vox_rings *r = f->r;
    const uint32_t *old = r->mesh->triangles[t];
    const float *const corners[3] = {f->from->positions[old[0]], f->from->positions[old[1]],
                                     f->from->positions[old[2]]};
    struct foot foot;
    double n[3], middle[3];
    uint32_t v[3];
    vox_triangle_normal(f->from->positions, old, n);
    const double area = sqrt(bsq_dotd(n, n));
    for (int k = 0; k < 3; k++)
        middle[k] = ((double)corners[0][k] + (double)corners[1][k] + (double)corners[2][k]) / 3;
    if (!add_point(f, r->mesh->vertex_count + t, middle, middle_weight * area, &foot))
        return;
    list_corners(r, foot.corner, v);
    for (int i = 0; i < 3; i++)
        look_at(f, v[i], corners, middle, area);
}

/* Sums up what the points of the old mesh say: its vertices, and the middles of its triangles. */
static int take_advice(struct fit *f)
{
    const struct vox_mesh *mesh = f->r->mesh;
    struct foot foot;
    f->squares = f->weight = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        f->advice[v] = (struct advice){.square = INFINITY};
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const float *at = f->from->positions[v];
        if (v % VOX_CHECK_EVERY == 0 && bsq_check(f->r->ctx) < 0)
            return BSQ_EINTR;
        add_point(f, v, (const double[3]){(double)at[0], (double)at[1], (double)at[2]}, f->areas[v],
                  &foot);
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        if (t % VOX_CHECK_EVERY == 0 && bsq_check(f->r->ctx) < 0)
            return BSQ_EINTR;
        add_triangle(f, t);
    }
    return 0;
}

/* Adds what is far away, beside points of this weight. square: of a way, as far as it counts; that
 * of the way itself goes along it, or against it (sign -1). */
static void add_far(const struct fit *f, struct advice *advice, double weight, const double way[3],
                    double sign, double square, double most)
{
    const double ratio = square / (far_factor * f->squares / f->weight), all = bsq_dotd(way, way);
    if (square > 0 && square < INFINITY)
        add_advice(advice, way, sign * all,
                   weight * fmin(ratio * ratio, most) * (square / all) / all);
}

/* Moves a vertex as it was advised, by the distance of the points around it at most, unless that
 * would fold the surface. */
static void move_vertex(struct fit *f, uint32_t v)
{
    struct vox_rings *r = f->r;
    struct advice *advice = &f->advice[v];
    double *a = advice->a, x[3];
    float p[3];
    const double weight = a[0] + a[3] + a[5];
    if ((r->flags[v] & VOX_LOCKED) || !(weight > 0))
        return;
    add_far(f, advice, weight, advice->way, -1, advice->square, most_weight);
    add_far(f, advice, weight, advice->point_way, 1, advice->point_square, most_weight_point);
    const double pull = weight * (r->flags[v] & VOX_BORDER ? border_pull : fit_pull);
    a[0] += pull;
    a[3] += pull;
    a[5] += pull;
    if (!vox_solve(a, advice->b, x))
        return;
    const double most = sqrt(advice->squares / weight / bsq_dotd(x, x));
    for (int k = 0; k < 3; k++)
        p[k] = (float)((double)r->mesh->positions[v][k] + fmin(fit_stride, most) * x[k]);
    if (!isfinite(p[0] + p[1] + p[2]) || vox_makes_fold(r, v, VOX_NONE, p))
        return;
    if (f->from->limits) {
        if (!vox_limits_allow(f->from->limits, r, v, VOX_NONE, p))
            return;
        vox_limits_change(f->from->limits);
    }
    memcpy(r->mesh->positions[v], p, sizeof p);
}

int vox_fit(struct vox_rings *r, const struct vox_fit_from *from)
{
    static const char what[] = "fitting a mesh";
    const struct vox_mesh *mesh = r->mesh;
    const uint64_t points = (uint64_t)mesh->vertex_count + mesh->triangle_count;
    struct fit f = {.r = r, .from = from};
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(r->ctx, what, points, &f.near));
    BSQ_TRY(BSQ_CALLOC(r->ctx, what, mesh->vertex_count, &f.areas));
    BSQ_TRY(BSQ_ALLOC(r->ctx, what, mesh->vertex_count, &f.advice));
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        f.near[v] = vox_first_corner(r, vox_find_root(from->into, v));
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        double n[3];
        vox_triangle_normal(from->positions, mesh->triangles[t], n);
        f.near[mesh->vertex_count + t] = f.near[mesh->triangles[t][0]];
        for (int k = 0; k < 3; k++)
            f.areas[mesh->triangles[t][k]] += sqrt(bsq_dotd(n, n));
    }
    for (int round = 0; round < FIT_ROUNDS; round++) {
        BSQ_TRY(take_advice(&f));
        for (uint32_t v = 0; v < mesh->vertex_count; v++) {
            if (v % VOX_CHECK_EVERY == 0)
                BSQ_TRY(bsq_check(r->ctx));
            move_vertex(&f, v);
        }
    }
done:
    BSQ_FREE(r->ctx, f.advice, f.areas, f.near);
    return status;
}
