/* surface_parts.c - opens several scans, and finds the nearest hit of rays on all of them.
 *
 * Each scan has an index space of its own. Rays are given in the space of the scan with the least
 * origin, which does not depend on the order of scans. */
#include "libbake/surface/surface_parts.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"

enum { RAYS_A_TASK = 4096 };

/* ---- opening ---- */

/* Returns whether the index space of a scan comes before another's. */
static bool comes_first(const struct bake_surface *a, const struct bake_surface *b)
{
    for (int k = 0; k < 3; k++)
        if (a->translation[k] != b->translation[k])
            return a->translation[k] < b->translation[k];
    return a->unit < b->unit;
}

/* Sets what is known of all scans from what is known of each. */
static void join_parts(struct bake_surface *surface)
{
    const struct bake_surface *first = &surface->parts[0];
    surface->has_color = true;
    surface->ids = first->ids;
    for (int k = 0; k < 3; k++) {
        surface->scan_min[k] = INFINITY;
        surface->scan_max[k] = -INFINITY;
    }
    for (uint32_t p = 0; p < surface->part_count; p++) {
        const struct bake_surface *part = &surface->parts[p];
        surface->has_color &= part->has_color;
        if (part->ids != surface->ids)
            surface->ids = BSQ_IDS_NONE;
        surface->detail = fmax(surface->detail, part->detail);
        for (int k = 0; k < 3; k++) {
            surface->scan_min[k] = fmin(surface->scan_min[k], part->scan_min[k]);
            surface->scan_max[k] = fmax(surface->scan_max[k], part->scan_max[k]);
        }
        if (comes_first(part, first))
            first = part;
    }
    memcpy(surface->translation, first->translation, sizeof surface->translation);
    surface->unit = first->unit;
}

int bake_surface_open_parts(struct bake_surface *surface, const struct bake_options *options)
{
    struct bake_options one = *options;
    const uint32_t count = options->more_scan_count + 1;
    one.more_scan_count = 0;
    int status = bsq_calloc(surface->ctx, "scans", count, sizeof *surface->parts, &surface->parts);
    for (uint32_t p = 0; p < count && status == 0; p++) {
        if (p > 0)
            one.scan_path = options->more_scan_paths[p - 1];
        status = bake_surface_open(surface->ctx, &one, &surface->parts[p]);
        surface->part_count += status == 0;
    }
    if (status < 0)
        bake_surface_close(surface);
    else
        join_parts(surface);
    return status;
}

void bake_surface_close_parts(struct bake_surface *surface)
{
    for (uint32_t p = 0; p < surface->part_count; p++)
        bake_surface_close(&surface->parts[p]);
    bsq_free(surface->ctx, surface->parts);
}

bool bake_surface_has_triangles(const struct bake_surface *surface)
{
    bool some = surface->exact != NULL;
    for (uint32_t p = 0; p < surface->part_count; p++)
        some |= surface->parts[p].exact != NULL;
    return some;
}

/* ---- rays ---- */

struct parts_trace {
    const struct bake_surface *surface;
    const struct bake_surface_rays *rays;
    uint32_t part;
    struct bake_exact_ray *part_rays; /* in the part's index space */
    struct bake_exact_hit *part_hits;
};

static uint64_t task_end(const struct parts_trace *trace, uint64_t task)
{
    const uint64_t end = (task + 1) * RAYS_A_TASK;
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
    const uint64_t end = task_end(trace, task);
    for (uint64_t i = task * RAYS_A_TASK; i < end; i++) {
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
    const uint64_t end = task_end(trace, task);
    for (uint64_t i = task * RAYS_A_TASK; i < end; i++)
        if (trace->part == 0 || is_nearer(&trace->part_hits[i], &trace->rays->hits[i]))
            trace->rays->hits[i] = trace->part_hits[i];
    return 0;
}

static int trace_part(struct parts_trace *trace, const struct bk_params *params)
{
    const struct bake_surface *part = &trace->surface->parts[trace->part];
    const uint64_t tasks = (trace->rays->count + RAYS_A_TASK - 1) / RAYS_A_TASK;
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

int bake_surface_trace_parts(const struct bake_surface *surface, const struct bk_params *params,
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
uint64_t bake_surface_parts_capacity(const struct bake_surface *surface)
{
    uint64_t least = UINT64_MAX;
    for (uint32_t p = 0; p < surface->part_count; p++) {
        const uint64_t rays = bake_surface_capacity(&surface->parts[p]) / 3;
        least = rays < least ? rays : least;
    }
    return least < 1 ? 1 : least;
}
