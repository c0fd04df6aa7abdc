/* limits.c - see limits.h. */
#include "libvoxel/simplify/limits.h"

#include "libvoxel/simplify/distance_lanes.h"

/* What a change makes, and the points that are looked at together. */
struct limited_change {
    const float *corners[VOX_LIMITS_MOST][3]; /* the vertex that changes first */
    uint32_t numbers[VOX_LIMITS_MOST];
    unsigned count;
    struct vox_batch batch;
    double squares[VOX_CLOSEST_BATCH];
    uint32_t points[VOX_CLOSEST_BATCH];
    double least; /* share of all points */
};

static uint64_t count_limits(const struct vox_limits *l)
{
    return (uint64_t)l->mesh->vertex_count + l->mesh->triangle_count;
}

int vox_limits_begin(struct bsq_ctx *ctx, const struct vox_mesh *mesh, double most,
                     struct vox_limits *l)
{
    static const char what[] = "limits of points";
    *l = (struct vox_limits){.ctx = ctx, .mesh = mesh, .most = most};
    const uint64_t count = count_limits(l);
    BSQ_PASS(BSQ_ALLOC(ctx, what, count, &l->shares));
    BSQ_PASS(BSQ_ALLOC(ctx, what, count, &l->owners));
    BSQ_PASS(BSQ_ALLOC(ctx, what, count, &l->owners_then));
    BSQ_PASS(BSQ_ALLOC(ctx, what, count, &l->next));
    BSQ_PASS(BSQ_ALLOC(ctx, what, mesh->triangle_count, &l->first));
    for (uint64_t i = 0; i < count; i++)
        l->shares[i] = 1;
    return vox_closest_build(ctx, (const float(*)[3])mesh->positions,
                             (const uint32_t(*)[3])mesh->triangles, mesh->triangle_count, false,
                             &l->tree);
}

void vox_limits_free(struct vox_limits *l)
{
    if (!l->ctx)
        return;
    vox_closest_free(l->ctx, &l->tree);
    BSQ_FREE(l->ctx, l->first, l->next, l->owners_then, l->owners, l->shares);
}

static void own_point(struct vox_limits *l, uint32_t point, uint32_t owner)
{
    l->owners[point] = owner;
    l->next[point] = l->first[owner];
    l->first[owner] = point;
}

void vox_limits_restart(struct vox_limits *l)
{
    memset(l->owners, 0xff, count_limits(l) * sizeof *l->owners);
    for (uint32_t t = 0; t < l->mesh->triangle_count; t++) {
        l->first[t] = VOX_NONE;
        for (int k = 0; k < 3; k++)
            if (l->owners[l->mesh->triangles[t][k]] == VOX_NONE)
                own_point(l, l->mesh->triangles[t][k], t);
        own_point(l, l->mesh->vertex_count + t, t);
    }
}

/* Lists the triangles of u: those that go, unless `other` has listed them, and those with u at p
 * that stay without v. Returns false if they are too many. */
static bool list_limited(struct vox_limits *l, struct vox_rings *r, uint32_t u, uint32_t v,
                         const float p[3], bool again, struct limited_change *change)
{
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t a = vox_after(r, k), b = vox_before(r, k), number = k / VOX_RING_WORDS;
        const bool both = a == v || b == v;
        if (l->changed_count == 2 * VOX_LIMITS_MOST || change->count == VOX_LIMITS_MOST)
            return false;
        if (!both || !again)
            l->changed[l->changed_count++] = number;
        if (both)
            continue;
        const float *corners[3] = {p, positions[a], positions[b]};
        memcpy(change->corners[change->count], corners, sizeof corners);
        change->numbers[change->count++] = number;
    }
    return true;
}

/* Adds a point to the batch. */
static void add_limited(const struct vox_limits *l, uint32_t point, struct limited_change *change)
{
    const struct vox_mesh *mesh = l->mesh;
    const float(*at)[3] = (const float(*)[3])mesh->positions;
    struct vox_batch *batch = &change->batch;
    const double share = (double)l->shares[point], limit = l->most * share;
    const uint32_t i = batch->count++;
    change->least = share < change->least ? share : change->least;
    for (int k = 0; k < 3; k++)
        if (point < mesh->vertex_count) {
            batch->points[k][i] = (double)at[point][k];
        } else {
            const uint32_t *t = mesh->triangles[point - mesh->vertex_count];
            batch->points[k][i] =
                ((double)at[t[0]][k] + (double)at[t[1]][k] + (double)at[t[2]][k]) / 3;
        }
    change->squares[i] = limit * limit;
    batch->owners[i] = -1;
    change->points[i] = point;
}

/* Finds the closest new triangles of a batch. Returns whether all points are within their limits.
 */
static bool place_limited(struct vox_limits *l, struct limited_change *change)
{
    struct vox_batch *batch = &change->batch;
    for (unsigned j = 0; j < change->count; j++)
        BSQ_SIMD_PICK(l->tree.level, vox_try_triangle)
    (change->corners[j], (double)change->numbers[j], batch);
    for (unsigned i = 0; i < batch->count; i++) {
        if (batch->owners[i] < 0)
            return false;
        l->owners_then[change->points[i]] = (uint32_t)batch->owners[i];
    }
    batch->count = 0;
    return true;
}

static bool is_near_old(const struct vox_limits *l, const float a[3], const float b[3],
                        double limit)
{
    double middle[3], square = limit * limit;
    for (int k = 0; k < 3; k++)
        middle[k] = 0.5 * ((double)a[k] + (double)b[k]);
    return vox_closest_point(&l->tree, middle, &square) != UINT32_MAX;
}

bool vox_limits_allow(struct vox_limits *l, struct vox_rings *r, uint32_t u, uint32_t v,
                      const float p[3])
{
    struct limited_change change;
    change.count = change.batch.count = l->changed_count = 0;
    change.batch.squares = change.squares;
    change.least = 1;
    if (!list_limited(l, r, u, v, p, false, &change) ||
        (v != VOX_NONE && !list_limited(l, r, v, u, p, true, &change)))
        return false;
    for (unsigned i = 0; i < l->changed_count; i++)
        for (uint32_t at = l->first[l->changed[i]]; at != VOX_NONE; at = l->next[at]) {
            add_limited(l, at, &change);
            if (change.batch.count == VOX_CLOSEST_BATCH && !place_limited(l, &change))
                return false;
        }
    const double limit = l->most * change.least;
    if (!place_limited(l, &change) || !is_near_old(l, p, p, limit))
        return false;
    for (unsigned j = 0; j < change.count; j++)
        if (!is_near_old(l, p, change.corners[j][1], limit))
            return false;
    return true;
}

void vox_limits_change(struct vox_limits *l)
{
    uint32_t points = VOX_NONE;
    for (unsigned i = 0; i < l->changed_count; i++) {
        uint32_t *first = &l->first[l->changed[i]];
        for (uint32_t at = *first, next; at != VOX_NONE; at = next) {
            next = l->next[at];
            l->next[at] = points;
            points = at;
        }
        *first = VOX_NONE;
    }
    for (uint32_t next; points != VOX_NONE; points = next) {
        next = l->next[points];
        own_point(l, points, l->owners_then[points]);
    }
}

void vox_limits_number(struct vox_limits *l, const struct vox_rings *r)
{
    uint32_t kept = 0;
    for (uint32_t t = 0; t < l->mesh->triangle_count; t++)
        l->first[t] = vox_is_gone(r, VOX_RING_WORDS * t + 1) ? VOX_NONE : kept++;
    for (uint64_t i = 0; i < count_limits(l); i++)
        l->owners[i] = l->first[l->owners[i]];
}

void vox_limits_tighten(struct vox_limits *l, const struct vox_mesh *mesh,
                        const _Atomic uint8_t *marks, float share)
{
    uint32_t *around = l->owners_then; /* of vertices: whether a triangle is marked there */
    memset(around, 0, mesh->vertex_count * sizeof *around);
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            around[mesh->triangles[t][k]] |= marks[t];
    for (uint64_t i = 0; i < count_limits(l); i++) {
        const uint32_t *v = mesh->triangles[l->owners[i]];
        if (marks[l->owners[i]])
            l->shares[i] *= share;
        else if (around[v[0]] | around[v[1]] | around[v[2]])
            l->shares[i] *= 0.5f * (1 + share);
    }
}
