/* resolve.c - see measure.h.
 *
 * What one pass does not bound (cover.h) is a few triangles: at borders, holes and sharp edges, and
 * where the distance is largest. The triangles of the scan around them are collected, as many as
 * the mesh has times a factor, and bound them exactly (bound.h). */
#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "libvoxel/simplify/distance_lanes.h"
#include "libvoxel/simplify/measure.h"

enum { NEAR_LEAST = 131072, NEAR_FACTOR = 4, LOOK_TOGETHER = 32 };

struct open_triangle {
    double reach; /* its bound so far: nothing farther away matters */
    uint32_t number;
    struct vox_bound bound;
};

/* A triangle of the scan: its corners, and its number in place of a fourth one, so that they are an
 * array of positions. */
typedef float near_triangle[4][3];

struct resolving {
    struct vox_measuring *m;
    struct open_triangle *open;
    bool *done;
    uint32_t open_count, chosen_count; /* the chosen ones are looked at together */
    uint32_t (*chosen)[3];             /* their vertices */
    struct vox_closest chosen_tree, near_tree;
    double most; /* the largest reach of these */
    near_triangle *near;
    uint64_t near_most;
    _Atomic uint64_t near_count;
    uint32_t (*triangles)[3]; /* corners of near triangles */
};

static int compare_near(const void *a_, const void *b_)
{
    uint64_t a, b;
    memcpy(&a, (*(const near_triangle *)a_)[3], sizeof a);
    memcpy(&b, (*(const near_triangle *)b_)[3], sizeof b);
    return a < b ? -1 : 1;
}

static bool is_within_reach(void *arg, uint32_t chosen, double square)
{
    const struct resolving *r = arg;
    return square <= r->open[chosen].reach * r->open[chosen].reach;
}

static bool is_near(struct resolving *r, const float low[3], const float high[3])
{
    return vox_closest_near(&r->chosen_tree, low, high, r->most * r->most, is_within_reach, r);
}

static bool are_near(struct resolving *r, const struct fmt_tris_chunk *chunk, uint32_t begin,
                     uint32_t end)
{
    struct vox_fours box = vox_no_box;
    for (uint32_t t = begin; t < end; t++)
        for (int i = 0; i < 3; i++)
            vox_grow_by_position(&box, chunk->positions[chunk->triangles[t][i]]);
    return is_near(r, (const float *)&box.low, (const float *)&box.high);
}

/* Collects the triangles of a chunk that are near chosen ones. Only counts them once there are too
 * many. */
static int gather_chunk(void *arg, uint64_t index, unsigned worker)
{
    struct resolving *r = arg;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(r->m->file)[index];
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    int status = 0;
    (void)worker;
    if (!is_near(r, info->bounds_min, info->bounds_max))
        return 0;
    BSQ_TRY(vox_load_chunk(r->m, index, &scratch, &chunk));
    for (uint32_t begin = 0, end; begin < chunk.triangle_count; begin = end) {
        end = begin + LOOK_TOGETHER;
        end = end < chunk.triangle_count ? end : chunk.triangle_count;
        if (!are_near(r, &chunk, begin, end))
            continue;
        BSQ_TRY(bsq_check(r->m->ctx));
        for (uint32_t t = begin; t < end; t++) {
            if (!are_near(r, &chunk, t, t + 1))
                continue;
            const uint64_t at = atomic_fetch_add(&r->near_count, 1);
            if (at >= r->near_most)
                continue;
            const uint64_t number = info->first_triangle + t;
            for (int i = 0; i < 3; i++)
                memcpy(r->near[at][i], chunk.positions[chunk.triangles[t][i]],
                       sizeof r->near[at][i]);
            memcpy(r->near[at][3], &number, sizeof number);
        }
    }
done:
    bsq_free(r->m->ctx, scratch);
    return status;
}

static int gather_near(struct resolving *r)
{
    struct bsq_ctx *ctx = r->m->ctx;
    int status = 0;
    r->most = 0;
    r->near_count = 0;
    for (uint32_t i = 0; i < r->chosen_count; i++) {
        memcpy(r->chosen[i], r->m->mesh->triangles[r->open[i].number], sizeof *r->chosen);
        r->most = fmax(r->most, r->open[i].reach);
    }
    BSQ_TRY(vox_closest_build(ctx, (const float(*)[3])r->m->mesh->positions,
                              (const uint32_t(*)[3])r->chosen, r->chosen_count, false,
                              &r->chosen_tree));
    status = vox_visit_chunks(r->m, gather_chunk, r);
done:
    vox_closest_free(ctx, &r->chosen_tree);
    return status;
}

static int resolve_one(void *arg, uint64_t index, unsigned worker)
{
    struct resolving *r = arg;
    struct open_triangle *open = &r->open[index];
    const float *corners[3];
    (void)worker;
    vox_closest_corners(&r->m->tree, open->number, corners);
    /* A little less, so that a point which is as far is noted. */
    open->bound = (struct vox_bound){.low = r->m->low.low * (1 - 1e-12), .slack = r->m->low.slack};
    if (r->m->marks)
        open->bound = vox_limit_bound(r->m);
    vox_bound_triangle(&r->near_tree, corners, &open->bound);
    return bsq_check(r->m->ctx);
}

/* Bounds the chosen triangles by those near them. */
static int resolve_chosen(struct resolving *r)
{
    struct vox_measuring *m = r->m;
    const bool all = r->near_count <= r->near_most;
    const uint32_t count = (uint32_t)(all ? r->near_count : r->near_most);
    int status = 0;
    bsq_sort(r->near, count, sizeof *r->near, compare_near);
    for (uint32_t i = 0; i < count; i++)
        for (uint32_t k = 0; k < 3; k++)
            r->triangles[i][k] = 4 * i + k;
    BSQ_TRY(vox_closest_build(m->ctx, (const float(*)[3])r->near,
                              (const uint32_t(*)[3])r->triangles, count, true, &r->near_tree));
    BSQ_TRY(bsq_parallel_for(m->ctx, r->chosen_count, resolve_one, r));
    for (uint32_t i = 0; i < r->chosen_count; i++) {
        const struct open_triangle *open = &r->open[i];
        r->done[open->number] = true;
        m->bounds[open->number] = fmin(m->bounds[open->number], open->bound.high);
        if (m->marks)
            m->marks[open->number] |= fmax(open->bound.low, open->bound.high) > m->limit;
        else if (all)
            vox_bound_note(&m->low, open->bound.where, open->bound.low);
    }
done:
    vox_closest_free(m->ctx, &r->near_tree);
    return status;
}

/* Lists the triangles whose bounds are too high. Neighbours mostly follow each other, as in the
 * chunks of the scan. */
static void list_open(struct resolving *r)
{
    const double allowed = vox_bound_allowed(&r->m->low);
    r->open_count = 0;
    for (uint32_t t = 0; t < r->m->mesh->triangle_count; t++)
        if (r->m->bounds[t] > allowed && !r->done[t])
            r->open[r->open_count++] =
                (struct open_triangle){.reach = r->m->bounds[t], .number = t};
}

/* Chooses the first open triangles, as many as probably have few enough near ones. */
static void choose_open(struct resolving *r)
{
    const struct vox_measuring *m = r->m;
    const double scan = (double)fmt_tris_get_header(m->file)->triangle_count,
                 density = scan / m->area;
    double expected = 0;
    for (r->chosen_count = 0; r->chosen_count < r->open_count; r->chosen_count++) {
        const struct open_triangle *open = &r->open[r->chosen_count];
        const float *corners[3];
        vox_closest_corners(&m->tree, open->number, corners);
        const double side = vox_longest_edge(corners) + 2 * open->reach;
        expected += density * side * side;
        if (r->chosen_count > 0 && expected > (double)r->near_most)
            break;
    }
}

int vox_resolve_bounds(struct vox_measuring *m)
{
    struct bsq_ctx *ctx = m->ctx;
    const uint32_t count = m->mesh->triangle_count;
    struct resolving r = {.m = m, .near_most = NEAR_LEAST + NEAR_FACTOR * (uint64_t)count};
    int status = 0;
    BSQ_TRY(BSQ_CALLOC(ctx, "triangles", count, &r.done));
    BSQ_TRY(BSQ_ALLOC(ctx, "triangles", count, &r.open));
    BSQ_TRY(BSQ_ALLOC(ctx, "triangles", count, &r.chosen));
    BSQ_TRY(BSQ_ALLOC(ctx, "near triangles", r.near_most, &r.near));
    BSQ_TRY(BSQ_ALLOC(ctx, "near triangles", r.near_most, &r.triangles));
    for (list_open(&r); r.open_count > 0; list_open(&r)) {
        choose_open(&r);
        BSQ_TRY(gather_near(&r));
        for (; r.near_count > r.near_most && r.chosen_count > 1;) {
            r.chosen_count /= 2;
            BSQ_TRY(gather_near(&r));
        }
        BSQ_TRY(resolve_chosen(&r));
    }
    for (uint32_t t = 0; t < count; t++)
        m->low.high = fmax(m->low.high, m->bounds[t]);
done:
    BSQ_FREE(ctx, r.triangles, r.near, r.chosen, r.open, r.done);
    return status;
}
