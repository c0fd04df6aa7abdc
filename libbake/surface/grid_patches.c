/* grid_patches.c - traces the patches of a map on a grid.
 *
 * Patches are independent: each worker rasterises, traces, resolves and stores one patch at a time
 * in its own buffers. A texel does not depend on its patch, so the map is the same for any patch
 * size and number of threads. */
#include "libbake/surface/surface.h"

#include "base/parallel.h"
#include "libbake/raster/raster.h"

struct trace {
    struct bsq_ctx *ctx;
    const struct bake_surface *surface;
    struct bake_device *device;
    const struct bake_patches *patches;
    struct bake_patch_workers workers;
};

static int grid_trace_patch(void *arg, uint64_t index, unsigned number)
{
    struct trace *trace = arg;
    const struct bake_patches *patches = trace->patches;
    struct bake_patch_worker *worker = &trace->workers.workers[number];
    const struct bk_patch patch = bake_raster_patch(patches->raster, (uint32_t)index);
    const uint32_t count = patch.width * patch.height;
    uint64_t overlaps = 0;
    BSQ_PASS(
        bake_raster_fill(patches->raster, (uint32_t)index, worker->sample_triangles, &overlaps));
    worker->overlaps += overlaps;
    if (patches->seen)
        bake_seen_mark_patch(trace->surface, patches, &patch, worker->sample_triangles);
    BSQ_PASS(
        bake_device_trace(trace->device, &patch, worker->sample_triangles, worker->texels, number));
    BSQ_PASS(bake_surface_check(trace->surface));
    bake_patch_worker_resolve(&trace->workers, worker, count, worker->resolved);
    bsq_progress_add(trace->ctx, count);
    return bake_image_write_patch(patches->image, &patch, worker->resolved);
}

int bake_trace_grid_patches(const struct bake_surface *surface, struct bake_device *device,
                            const struct bake_patches *patches, struct bake_report *report)
{
    struct bsq_ctx *ctx = surface->ctx;
    struct trace trace = {.ctx = ctx, .surface = surface, .device = device, .patches = patches};
    const uint64_t side = patches->patch_side;
    int status = bake_patch_workers_begin(ctx, patches, side * side, &trace.workers);
    if (status == 0)
        status = bsq_parallel_for(ctx, bake_raster_patch_count(patches->raster), grid_trace_patch,
                                  &trace);
    bake_patch_workers_end(ctx, &trace.workers, report);
    return status;
}
