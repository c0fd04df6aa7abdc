/* thin.c - see steps.h.
 *
 * A vertex goes to the neighbour where its own quadric is least; only then is the best place of
 * both computed. So most of the work is one walk around each vertex in each pass, in the order of
 * memory. The threshold of a pass is the quantile of the costs that would lead to the target. */
#include "libvoxel/simplify/steps.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"
#include "libvoxel/simplify/rings.h"

enum { SAMPLE_STEP = 8, BIN_SHIFT = 20, BINS = 1 << (31 - BIN_SHIFT) };
/* As in collapse.c. */
static const double pull = 1e-6;
static const float length_share = 1e-6F;

struct thinning {
    struct vox_rings rings;
    /* Of vertices: position, and the quadric there, in one place of memory. */
    float (*places)[4];
    /* Of vertices: the least cost of a step to a neighbour. UNKNOWN: neighbours have changed.
     * INFINITY: vertices that are gone or stay. */
    float *costs;
};
static const float unknown = -1;

static float value_at(const struct vox_quadric *q, float x, float y, float z)
{
    const float *a = q->a, *b = q->b;
    return x * (a[0] * x + 2 * (a[1] * y + a[2] * z + b[0])) +
           y * (a[3] * y + 2 * (a[4] * z + b[1])) + z * (a[5] * z + 2 * b[2]) + q->c;
}

/* Finds the neighbour that a vertex can go to at the least cost. Returns the cost; INFINITY if
 * there is none. */
static float find_target(struct thinning *thinning, uint32_t v, uint32_t *target)
{
    struct vox_rings *r = &thinning->rings;
    const float(*places)[4] = (const float(*)[4])thinning->places, *p = places[v];
    const struct vox_quadric *q = &r->mesh->quadrics[v];
    const float share = length_share * (q->a[0] + q->a[3] + q->a[5]);
    float least = INFINITY;
    uint32_t best = VOX_NONE;
    for (VOX_EACH_CORNER(r, v, k)) {
        const uint32_t u = vox_after(r, k);
        const float *to = places[u], x = to[0] - p[0], y = to[1] - p[1], z = to[2] - p[2];
        const float value = value_at(q, x, y, z);
        const float cost = (value > 0 ? value : 0) + to[3] + share * (x * x + y * y + z * z);
        best = cost < least ? u : best; /* no branch, which would be hard to predict */
        least = cost < least ? cost : least;
    }
    *target = best;
    thinning->costs[v] = fminf(least, FLT_MAX);
    return least;
}

/* Adds up two quadrics relative to a place. */
static void add_shifted(const struct vox_mesh *mesh, uint32_t u, uint32_t v, const double at[3],
                        double a[6], double b[3], double *c)
{
    double su[3], sv[3], a2[6], b2[3], c2;
    for (int k = 0; k < 3; k++) {
        su[k] = at[k] - (double)mesh->positions[u][k];
        sv[k] = at[k] - (double)mesh->positions[v][k];
    }
    vox_quadric_shift(&mesh->quadrics[u], su, a, b, c);
    vox_quadric_shift(&mesh->quadrics[v], sv, a2, b2, &c2);
    for (int i = 0; i < 6; i++)
        a[i] += a2[i];
    for (int k = 0; k < 3; k++)
        b[k] += b2[k];
    *c += c2;
}

/* Computes where (u, v) collapses to: the best place, or u if that is locked. */
static void place(const struct vox_rings *r, uint32_t u, uint32_t v, float p[3])
{
    const struct vox_mesh *mesh = r->mesh;
    double middle[3], a[6], b[3], c, x[3];
    memcpy(p, mesh->positions[u], 3 * sizeof *p);
    if (r->flags[u] & VOX_LOCKED)
        return;
    for (int k = 0; k < 3; k++)
        middle[k] = 0.5 * ((double)p[k] + (double)mesh->positions[v][k]);
    add_shifted(mesh, u, v, middle, a, b, &c);
    const double trace = a[0] + a[3] + a[5];
    a[0] += pull * trace;
    a[3] += pull * trace;
    a[5] += pull * trace;
    const bool solved = vox_solve(a, (double[3]){-b[0], -b[1], -b[2]}, x);
    for (int k = 0; k < 3; k++)
        p[k] = (float)(middle[k] + (solved ? x[k] : 0));
}

static void set_place(struct thinning *thinning, uint32_t v)
{
    const struct vox_mesh *mesh = thinning->rings.mesh;
    memcpy(thinning->places[v], mesh->positions[v], sizeof *mesh->positions);
    thinning->places[v][3] = mesh->quadrics[v].c;
}

static void try_collapse(struct thinning *thinning, uint32_t u, uint32_t v)
{
    struct vox_rings *r = &thinning->rings;
    struct vox_mesh *mesh = r->mesh;
    double at[3], a[6], b[3], c;
    float p[3], *costs = thinning->costs;
    if (!vox_rings_keep_topology(r, v, u))
        return;
    place(r, u, v, p);
    if (!isfinite(p[0] + p[1] + p[2]) || !vox_rings_keep_orientation(r, v, u, p) ||
        (!(r->flags[u] & VOX_LOCKED) && !vox_rings_keep_orientation(r, u, v, p)))
        return;
    for (int k = 0; k < 3; k++)
        at[k] = (double)p[k];
    add_shifted(mesh, u, v, at, a, b, &c);
    struct vox_quadric *q = &mesh->quadrics[u];
    for (int i = 0; i < 6; i++)
        q->a[i] = (float)a[i];
    for (int k = 0; k < 3; k++)
        q->b[k] = (float)b[k];
    q->c = c > 0 ? (float)c : 0;
    vox_rings_join(r, u, v, p);
    set_place(thinning, u);
    costs[v] = INFINITY;
    costs[u] = costs[u] < INFINITY ? unknown : INFINITY;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t ends[2] = {vox_after(r, k), vox_before(r, k)};
        for (int i = 0; i < 2; i++)
            costs[ends[i]] = costs[ends[i]] < INFINITY ? unknown : INFINITY;
    }
}

static bool is_free(struct vox_rings *r, uint32_t v)
{
    return !(r->flags[v] & VOX_LOCKED) && vox_first_corner(r, v) != VOX_NONE;
}

/* Returns a cost that about this share of free vertices is below, or a negative number if none is
 * left. Bits of floats above 0 are in the order of the floats. */
static float find_threshold(struct thinning *thinning, double share, uint32_t *bins)
{
    uint64_t count = 0, below = 0;
    uint32_t target, bin = 0;
    memset(bins, 0, BINS * sizeof *bins);
    for (uint32_t v = 0; v < thinning->rings.mesh->vertex_count; v += SAMPLE_STEP) {
        float cost = thinning->costs[v];
        if (!(cost < INFINITY))
            continue;
        if (cost < 0)
            cost = find_target(thinning, v, &target);
        uint32_t bits;
        memcpy(&bits, &cost, sizeof bits);
        bins[bits >> BIN_SHIFT]++;
        count++;
    }
    while (bin < BINS - 1 && (double)(below += bins[bin]) < share * (double)count)
        bin++;
    const uint32_t bits = (bin + 1) << BIN_SHIFT;
    float threshold;
    memcpy(&threshold, &bits, sizeof threshold);
    return count > 0 ? threshold : unknown;
}

/* Returns the triangles that a pass took away. */
static uint32_t run_pass(struct thinning *thinning, float threshold, uint32_t target)
{
    const struct vox_rings *r = &thinning->rings;
    const uint32_t before = r->alive;
    for (uint32_t v = 0; v < r->mesh->vertex_count && r->alive > target; v++) {
        uint32_t u = 0;
        if (bsq_check(r->ctx) < 0)
            break;
        if (thinning->costs[v] < threshold && find_target(thinning, v, &u) < threshold)
            try_collapse(thinning, u, v);
    }
    return before - r->alive;
}

int vox_thin(struct bsq_ctx *ctx, uint32_t target, struct vox_mesh *mesh)
{
    static const char what[] = "an edge collapse";
    struct thinning thinning = {.rings = {.ctx = ctx}};
    struct vox_rings *rings = &thinning.rings;
    uint32_t *bins = NULL, gone = UINT32_MAX;
    int status = 0;
    if (mesh->triangle_count <= target)
        return 0;
    BSQ_TRY(vox_rings_build(ctx, mesh, true, rings));
    BSQ_TRY(BSQ_ALLOC(ctx, what, BINS, &bins));
    BSQ_TRY(BSQ_ALLOC(ctx, what, mesh->vertex_count, &thinning.places));
    BSQ_TRY(BSQ_ALLOC(ctx, what, mesh->vertex_count, &thinning.costs));
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        set_place(&thinning, v);
        thinning.costs[v] = is_free(rings, v) ? unknown : INFINITY;
    }
    while (rings->alive > target && gone > rings->alive / 512) {
        const double share = 1 - (double)target / rings->alive;
        const float threshold = find_threshold(&thinning, share, bins);
        gone = run_pass(&thinning, threshold, target);
        BSQ_TRY(bsq_check(ctx));
    }
    vox_rings_compact(rings);
done:
    BSQ_FREE(ctx, thinning.costs, thinning.places, bins);
    vox_rings_free(rings);
    return status;
}
