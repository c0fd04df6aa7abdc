/* surface_rays.c - traces batches of rays against the scans of a surface. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/kernel/bk_trace.h"

enum { RAYS_A_TASK = 256, MOVED_RAYS_A_TASK = 4096, MAX_GRID_RAYS = 1 << 18 };

/* ---- one scan ---- */

struct grid_trace {
    const struct bake_scan *scan;
    const struct bake_ray_batch *batch;
    struct bk_params params;
};

static int trace_grid_rays(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct grid_trace *trace = arg;
    const struct bake_ray_batch *batch = trace->batch;
    const double count = (double)batch->count;
    bake_trace_rays(&trace->scan->grid, &trace->params, trace->scan->unit, batch, begin, end);
    bsq_progress_add_share(trace->scan->ctx, batch->progress, (double)begin / count,
                           (double)end / count);
    return 0;
}

/* Traces rays in the index space of a scan. */
static int trace_scan(const struct bake_scan *scan, const struct bake_ray_batch *batch)
{
    if (scan->exact)
        return bake_exact_trace(scan->exact, batch);
    struct grid_trace trace = {scan, batch, scan->params};
    trace.params.flags &= ~(bk_uint)(batch->best ? BK_NEAREST : 0);
    return bsq_parallel_ranges(scan->ctx, batch->count, RAYS_A_TASK, trace_grid_rays, &trace);
}

/* ---- several scans ---- */

struct scans_trace {
    const struct bake_surface *surface;
    const struct bake_ray_batch *batch;
    uint32_t scan; /* the current one */
    /* Of this scan, in its index space: */
    struct bake_ray *own_rays;
    struct bake_hit *own_hits;
    float *own_channels;
};

/* Moves rays to the index space of the scan. Those that do not see it get no direction. */
static int move_rays(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct scans_trace *trace = arg;
    const struct bake_surface *surface = trace->surface;
    const struct bake_scan *scan = &surface->scans[trace->scan];
    for (uint64_t i = begin; i < end; i++) {
        const bool seen = bake_surface_sees(surface, trace->batch->objects, i, trace->scan);
        struct bake_ray *ray = &trace->own_rays[i];
        *ray = trace->batch->rays[i];
        for (int k = 0; k < 3; k++) {
            const double shift = surface->translation[k] - scan->translation[k];
            ray->origin[k] = (float)(((double)ray->origin[k] * surface->unit + shift) / scan->unit);
            ray->direction[k] = seen ? ray->direction[k] : 0.0f;
        }
    }
    return 0;
}

_Static_assert(offsetof(struct bake_hit, facet) - offsetof(struct bake_hit, normal) ==
                   6 * sizeof(float) + sizeof(uint32_t),
               "what a hit carries is compared as bytes");

/* Returns whether a hit of a ray comes before another one, as bk_wins() does. Of hits in the
 * same place, any is as good, but it must not depend on the order of scans. size: of channels. */
static bool comes_before(const struct bake_hit *hit, const float *channels,
                         const struct bake_hit *other, const float *other_channels, size_t size,
                         double reach)
{
    const double cost = bk_ray_cost(hit->t, reach), other_cost = bk_ray_cost(other->t, reach);
    if (hit->triangle == BAKE_NO_HIT || other->triangle == BAKE_NO_HIT)
        return hit->triangle != BAKE_NO_HIT;
    if (cost != other_cost)
        return cost < other_cost;
    if (hit->t != other->t)
        return hit->t > other->t;
    const int order =
        /* NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): any order of bits will do */
        memcmp(hit->normal, other->normal,
               offsetof(struct bake_hit, reversed) - offsetof(struct bake_hit, normal));
    return order ? order < 0 : size > 0 && memcmp(channels, other_channels, size) < 0;
}

static int keep_best(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct scans_trace *trace = arg;
    const struct bake_ray_batch *batch = trace->batch;
    const uint64_t floats =
        trace->own_channels ? BK_TRANSFER_VALUES * bk_transfers(trace->surface->params.maps) : 0;
    for (uint64_t i = begin; i < end; i++) {
        const float *own = floats > 0 ? trace->own_channels + i * floats : NULL;
        float *channels = floats > 0 ? batch->channels + i * floats : NULL;
        const double reach = batch->reaches ? (double)batch->reaches[i] : 0;
        if (trace->scan > 0 && !comes_before(&trace->own_hits[i], own, &batch->hits[i], channels,
                                             floats * sizeof *own, reach))
            continue;
        batch->hits[i] = trace->own_hits[i];
        batch->hits[i].scan = trace->scan;
        if (floats > 0)
            memcpy(channels, own, floats * sizeof *own);
    }
    return 0;
}

/* Traces the current scan, and keeps its hits that come before those of the others. */
static int trace_next(const struct scans_trace *trace)
{
    const struct bake_surface *surface = trace->surface;
    const uint32_t n = surface->scan_count, s = trace->scan;
    const uint64_t count = trace->batch->count, progress = trace->batch->progress;
    void *arg = (void *)(uintptr_t)trace;
    struct bake_ray_batch own = *trace->batch;
    own.rays = trace->own_rays;
    own.hits = trace->own_hits;
    own.channels = trace->own_channels;
    own.progress = progress * (s + 1) / n - progress * s / n;
    BSQ_PASS(bsq_parallel_ranges(surface->ctx, count, MOVED_RAYS_A_TASK, move_rays, arg));
    BSQ_PASS(trace_scan(&surface->scans[s], &own));
    return bsq_parallel_ranges(surface->ctx, count, MOVED_RAYS_A_TASK, keep_best, arg);
}

static int trace_scans(const struct bake_surface *surface, const struct bake_ray_batch *batch)
{
    const uint64_t floats = BK_TRANSFER_VALUES * bk_transfers(surface->params.maps);
    const uint64_t count = batch->count;
    struct scans_trace trace = {.surface = surface, .batch = batch};
    struct bsq_ctx *ctx = surface->ctx;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "rays", count, &trace.own_rays));
    BSQ_TRY(BSQ_ALLOC(ctx, "hits", count, &trace.own_hits));
    if (batch->channels)
        BSQ_TRY(bsq_alloc(ctx, "hits", count, floats * sizeof(float), &trace.own_channels));
    for (; trace.scan < surface->scan_count; trace.scan++)
        BSQ_TRY(trace_next(&trace));
done:
    BSQ_FREE(ctx, trace.own_channels, trace.own_hits, trace.own_rays);
    return status;
}

int bake_surface_trace(const struct bake_surface *surface, const struct bake_ray_batch *batch)
{
    return surface->scan_count == 1 ? trace_scan(surface->scans, batch)
                                    : trace_scans(surface, batch);
}

static uint64_t scan_capacity(const struct bake_scan *scan, uint64_t more_bytes)
{
    if (scan->exact)
        return bake_exact_capacity(scan->exact, more_bytes);
    const uint64_t channels = BK_TRANSFER_VALUES * bk_transfers(scan->params.maps) * sizeof(float);
    const uint64_t ray = sizeof(struct bake_ray) + sizeof(struct bake_hit) + channels + more_bytes;
    const uint64_t most = bsq_memory_left(scan->ctx) / 8 / ray;
    return most < MAX_GRID_RAYS ? most : MAX_GRID_RAYS;
}

uint64_t bake_surface_capacity(const struct bake_surface *surface, uint64_t more_bytes)
{
    uint64_t least = UINT64_MAX;
    for (uint32_t s = 0; s < surface->scan_count; s++) {
        const uint64_t rays = scan_capacity(&surface->scans[s], more_bytes);
        least = rays < least ? rays : least;
    }
    /* The rays and hits of each scan take as much as the caller's, and tracing needs the rest. */
    least = surface->scan_count > 1 ? least / 3 : least;
    return least < 1 ? 1 : least;
}

uint64_t bake_surface_curve_index(const struct bake_surface *surface, const float point[3])
{
    float low[3];
    double side = 0;
    for (int k = 0; k < 3; k++) {
        low[k] = (float)((surface->scan_min[k] - surface->translation[k]) / surface->unit);
        side = fmax(side, (surface->scan_max[k] - surface->scan_min[k]) / surface->unit);
    }
    return bake_exact_curve_index(point, low, side);
}
