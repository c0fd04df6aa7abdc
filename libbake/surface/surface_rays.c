/* surface_rays.c - traces rays against a surface: primary and secondary ones, against grids,
 * triangles or several scans. */
#include "libbake/surface/surface.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/kernel/bk_grid.h"
#include "libbake/kernel/bk_secondary.h"
#include "libbake/secondary/secondary.h"

enum { RAYS_A_TASK = 256, MOVED_RAYS_A_TASK = 4096, PLACES_A_TASK = 64, MAX_GRID_RAYS = 1 << 18 };

/* ---- one scan ---- */

struct grid_trace {
    const struct bake_surface *surface;
    const struct bk_params *params;
    const struct bake_surface_rays *rays;
};

_Static_assert(sizeof(struct bake_exact_ray) == 6 * sizeof(float), "rays are read as floats");

static int trace_grid_rays(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct grid_trace *trace = arg;
    const struct bake_surface_rays *rays = trace->rays;
    const double unit = trace->surface->unit;
    const uint64_t begin = task * RAYS_A_TASK, left = rays->count - begin;
    struct bake_ray_batch lines = {
        .rays = (const float(*)[6])(const void *)(rays->rays + begin),
        .count = left < RAYS_A_TASK ? left : RAYS_A_TASK,
        .t_min = (float)(rays->t_min / unit),
        .t_max = (float)(rays->t_max / unit),
        .facing = rays->facing_origin ? -1.0f : 1.0f,
    };
    float starts[RAYS_A_TASK];
    struct bk_hit hits[RAYS_A_TASK];
    if (rays->starts) {
        for (uint64_t i = 0; i < lines.count; i++)
            starts[i] = (float)((double)rays->starts[begin + i] / unit);
        lines.starts = starts;
    }
    bake_trace_rays(&trace->surface->grid, trace->params, &lines, hits);
    for (uint64_t i = 0; i < lines.count; i++) {
        struct bake_exact_hit *out = &rays->hits[begin + i];
        *out = (struct bake_exact_hit){.triangle = hits[i].found ? 0 : BAKE_EXACT_NONE,
                                       .t = (double)hits[i].t * unit};
        memcpy(out->normal, hits[i].normal, sizeof out->normal);
        memcpy(out->color, hits[i].color, sizeof out->color);
    }
    return 0;
}

static int trace_exact(const struct bake_surface *surface, const struct bake_surface_rays *rays)
{
    int status = 0;
    for (uint64_t at = 0; status == 0 && at < rays->count;) {
        const uint64_t most = bake_exact_capacity(surface->exact, 0), left = rays->count - at;
        const struct bake_exact_batch batch = {.rays = rays->rays + at,
                                               .hits = rays->hits + at,
                                               .count = left < most ? left : most,
                                               .t_min = rays->t_min,
                                               .t_max = rays->t_max,
                                               .distances_only = rays->distances_only,
                                               .facing_origin = rays->facing_origin};
        status = bake_exact_trace(surface->exact, &batch);
        at += batch.count;
    }
    return status;
}

/* ---- several scans ---- */

struct parts_trace {
    const struct bake_surface *surface;
    const struct bake_surface_rays *rays;
    uint32_t part;
    struct bake_exact_ray *part_rays; /* in the part's index space */
    struct bake_exact_hit *part_hits;
};

static uint64_t moved_end(const struct parts_trace *trace, uint64_t task)
{
    const uint64_t end = (task + 1) * MOVED_RAYS_A_TASK;
    return end < trace->rays->count ? end : trace->rays->count;
}

/* Returns whether a part is hidden from a ray. */
static bool is_hidden(const struct parts_trace *trace, uint64_t ray)
{
    const struct bake_surface_rays *rays = trace->rays;
    return rays->objects &&
           !rays->sees[(uint64_t)trace->surface->part_count * rays->objects[ray] + trace->part];
}

/* Moves rays to the index space of a part. Those that do not see it get no direction. */
static int move_rays(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct parts_trace *trace = arg;
    const struct bake_surface *whole = trace->surface, *part = &whole->parts[trace->part];
    const uint64_t end = moved_end(trace, task);
    for (uint64_t i = task * MOVED_RAYS_A_TASK; i < end; i++) {
        struct bake_exact_ray *ray = &trace->part_rays[i];
        *ray = trace->rays->rays[i];
        for (int k = 0; k < 3; k++) {
            const double shift = whole->translation[k] - part->translation[k];
            ray->origin[k] = (float)(((double)ray->origin[k] * whole->unit + shift) / part->unit);
            ray->direction[k] = is_hidden(trace, i) ? 0.0f : ray->direction[k];
        }
    }
    return 0;
}

/* Returns whether a hit is nearer than another. */
static bool is_nearer(const struct bake_exact_hit *hit, const struct bake_exact_hit *other)
{
    if (hit->triangle == BAKE_EXACT_NONE || other->triangle == BAKE_EXACT_NONE)
        return hit->triangle != BAKE_EXACT_NONE;
    if (fabs(hit->t) != fabs(other->t))
        return fabs(hit->t) < fabs(other->t);
    return hit->t > other->t;
}

static int keep_nearest(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct parts_trace *trace = arg;
    const uint64_t end = moved_end(trace, task);
    for (uint64_t i = task * MOVED_RAYS_A_TASK; i < end; i++)
        if (trace->part == 0 || is_nearer(&trace->part_hits[i], &trace->rays->hits[i]))
            trace->rays->hits[i] = trace->part_hits[i];
    return 0;
}

static int trace_part(struct parts_trace *trace, const struct bk_params *params)
{
    const struct bake_surface *part = &trace->surface->parts[trace->part];
    const uint64_t tasks = (trace->rays->count + MOVED_RAYS_A_TASK - 1) / MOVED_RAYS_A_TASK;
    struct bk_params own = *params;
    struct bake_surface_rays rays = *trace->rays;
    rays.rays = trace->part_rays;
    rays.hits = trace->part_hits;
    rays.objects = NULL;
    own.unit = (float)part->unit;
    if (!part->exact)
        bake_params_from_grid(&part->grid, &own);
    int status = 0;
    BSQ_TRY(bsq_parallel_for(part->ctx, tasks, move_rays, trace));
    BSQ_TRY(bake_surface_trace(part, &own, &rays));
    BSQ_TRY(bsq_parallel_for(part->ctx, tasks, keep_nearest, trace));
done:
    return status;
}

static int trace_parts(const struct bake_surface *surface, const struct bk_params *params,
                       const struct bake_surface_rays *rays)
{
    struct parts_trace trace = {.surface = surface, .rays = rays};
    struct bsq_ctx *ctx = surface->ctx;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "rays", rays->count, sizeof *trace.part_rays, &trace.part_rays));
    BSQ_TRY(bsq_alloc(ctx, "hits", rays->count, sizeof *trace.part_hits, &trace.part_hits));
    for (; trace.part < surface->part_count; trace.part++)
        BSQ_TRY(trace_part(&trace, params));
done:
    bsq_free(ctx, trace.part_hits);
    bsq_free(ctx, trace.part_rays);
    return status;
}

/* The rays and hits of a part take as much as the caller's, and tracing needs the rest. */
static uint64_t parts_capacity(const struct bake_surface *surface)
{
    uint64_t least = UINT64_MAX;
    for (uint32_t p = 0; p < surface->part_count; p++) {
        const uint64_t rays = bake_surface_capacity(&surface->parts[p]) / 3;
        least = rays < least ? rays : least;
    }
    return least < 1 ? 1 : least;
}

/* ---- all kinds ---- */

int bake_surface_trace(const struct bake_surface *surface, const struct bk_params *params,
                       const struct bake_surface_rays *rays)
{
    struct grid_trace trace = {surface, params, rays};
    if (surface->parts)
        return trace_parts(surface, params, rays);
    if (surface->exact)
        return trace_exact(surface, rays);
    return bsq_parallel_for(surface->ctx, (rays->count + RAYS_A_TASK - 1) / RAYS_A_TASK,
                            trace_grid_rays, &trace);
}

uint64_t bake_surface_capacity(const struct bake_surface *surface)
{
    if (surface->parts)
        return parts_capacity(surface);
    if (surface->exact)
        return bake_exact_capacity(surface->exact, 0);
    const uint64_t ray = sizeof(struct bake_exact_ray) + sizeof(struct bake_exact_hit);
    const uint64_t most = bsq_memory_share(surface->ctx, "rays of a batch", 8) / ray;
    return most < 1 ? 1 : most > MAX_GRID_RAYS ? MAX_GRID_RAYS : most;
}

/* ---- secondary rays ---- */

struct look {
    const struct bake_surface *surface;
    const struct bk_params *params;
    const struct bake_places *places;
    struct bake_ray_states *states;
};

static int look_task(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct look *look = arg;
    const struct bake_places *places = look->places;
    const uint64_t begin = task * PLACES_A_TASK, left = places->count - begin;
    const uint64_t end = begin + (left < PLACES_A_TASK ? left : PLACES_A_TASK);
    const double each = (double)places->progress / (double)places->count;
    bake_trace_places(&look->surface->grid, look->params, places, begin, end, look->states);
    bsq_progress_add(look->surface->ctx,
                     (uint64_t)(each * (double)end) - (uint64_t)(each * (double)begin));
    return 0;
}

static int look_exact(const struct look *look, uint64_t *chunk_loads)
{
    struct bake_exact_look *exact;
    int status = bake_exact_look_create(look->surface->exact, look->params, 0, &exact);
    if (status < 0)
        return status;
    status = bake_exact_look_from(exact, look->places, look->states);
    *chunk_loads += bake_exact_look_loads(exact);
    bake_exact_look_free(exact);
    return status;
}

int bake_surface_look(const struct bake_surface *surface, const struct bk_params *params,
                      const struct bake_places *places, struct bake_ray_states *states,
                      uint64_t *chunk_loads)
{
    struct look look = {surface, params, places, states};
    if (surface->exact)
        return look_exact(&look, chunk_loads);
    int status = bsq_parallel_for(surface->ctx, (places->count + PLACES_A_TASK - 1) / PLACES_A_TASK,
                                  look_task, &look);
    return status < 0 ? status : bake_surface_check(surface);
}

/* Positions of hits on triangles were rounded again, so they get four times the distance. */
double bake_surface_lift(const struct bake_surface *surface)
{
    return surface->exact ? 4 * (double)bake_exact_lift(surface->exact)
                          : (double)BK_LIFT * surface->unit;
}

/* ---- occupied blocks ---- */

struct blocks {
    const struct bake_surface *part;
    bake_surface_visit *visit;
    void *arg;
};

static int visit_node(void *arg, uint32_t lower, const int32_t origin[3])
{
    const struct blocks *blocks = arg;
    const struct bake_surface *part = blocks->part;
    double corner[3];
    for (int k = 0; k < 3; k++)
        corner[k] = part->translation[k] + (origin[k] - 0.5) * part->unit;
    blocks->visit(blocks->arg, corner, part->unit, bake_lower_children(&part->grid, lower));
    return 0;
}

void bake_surface_each_block(const struct bake_surface *surface, bake_surface_visit *visit,
                             void *arg)
{
    const uint32_t count = surface->parts ? surface->part_count : 1;
    assert(!bake_surface_has_triangles(surface));
    for (uint32_t p = 0; p < count; p++) {
        struct blocks blocks = {surface->parts ? &surface->parts[p] : surface, visit, arg};
        const struct fmt_nvdb_grid *grid = &blocks.part->grid;
        (void)bake_visit_nodes(grid, grid->index_min, grid->index_max, visit_node, &blocks);
    }
}
