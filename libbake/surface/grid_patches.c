/* grid_patches.c - traces the patches of a map on a grid.
 *
 * Patches are independent: each worker rasterises, traces, resolves and stores one patch after the
 * other in its own buffers. A GPU has started the next patch before a worker waits for one. A texel
 * does not depend on its patch, so the map is the same for any patch size and number of threads. */
#include "libbake/surface/surface.h"

#include "base/parallel.h"
#include "libbake/raster/raster.h"

/* Patches that a worker has started: the numbers of the last ones. */
struct started {
    uint32_t patches[BAKE_WINDOWS_MAX];
    uint64_t begun, ended;
};

struct trace {
    struct bsq_ctx *ctx;
    const struct bake_surface *surface;
    struct bake_device *device;
    const struct bake_patches *patches;
    struct bake_patch_workers workers;
    struct started *started; /* of each worker */
};

/* Stores a patch that was traced. */
static int store_patch(struct trace *trace, const struct bk_patch *patch,
                       struct bake_patch_worker *worker)
{
    const uint32_t count = patch->width * patch->height;
    BSQ_PASS(bake_surface_check(trace->surface));
    bake_patch_worker_resolve(&trace->workers, worker, count, worker->resolved);
    bsq_progress_add(trace->ctx, count);
    return bake_image_write_patch(trace->patches->image, patch, worker->resolved);
}

/* Waits for the first patch that a worker has started. If the device was lost, its samples are made
 * again. */
static int end_first_patch(struct trace *trace, unsigned number)
{
    struct bake_patch_worker *worker = &trace->workers.workers[number];
    struct started *started = &trace->started[number];
    const unsigned window = (unsigned)(started->ended++ % bake_device_windows(trace->device));
    const struct bake_raster *raster = trace->patches->raster;
    const uint32_t index = started->patches[window];
    const struct bk_patch patch = bake_raster_patch(raster, index);
    uint64_t counted;
    int status = bake_device_end(trace->device, &patch, worker->texels, number, window);
    if (status == BSQ_RETRY) {
        BSQ_PASS(bake_raster_fill(raster, index, worker->sample_triangles, &counted));
        status = bake_device_trace(trace->device, &patch, worker->sample_triangles, worker->texels,
                                   number);
    }
    BSQ_PASS(status);
    return store_patch(trace, &patch, worker);
}

static int grid_trace_patch(void *arg, uint64_t index, unsigned number)
{
    struct trace *trace = arg;
    const struct bake_patches *patches = trace->patches;
    struct bake_patch_worker *worker = &trace->workers.workers[number];
    struct started *started = &trace->started[number];
    const struct bk_patch patch = bake_raster_patch(patches->raster, (uint32_t)index);
    const unsigned windows = bake_device_windows(trace->device);
    const unsigned window = (unsigned)(started->begun % windows);
    uint64_t overlaps = 0;
    BSQ_PASS(
        bake_raster_fill(patches->raster, (uint32_t)index, worker->sample_triangles, &overlaps));
    worker->overlaps += overlaps;
    const int status =
        bake_device_begin(trace->device, &patch, worker->sample_triangles, number, window);
    if (status == BSQ_RETRY) {
        BSQ_PASS(bake_device_trace(trace->device, &patch, worker->sample_triangles, worker->texels,
                                   number));
        return store_patch(trace, &patch, worker);
    }
    BSQ_PASS(status);
    started->patches[window] = (uint32_t)index;
    started->begun++;
    return started->begun - started->ended < windows ? 0 : end_first_patch(trace, number);
}

static int end_patches(void *arg, uint64_t number, unsigned worker)
{
    struct trace *trace = arg;
    const struct started *started = &trace->started[number];
    int status = 0;
    (void)worker;
    while (started->ended < started->begun && status == 0)
        status = end_first_patch(trace, (unsigned)number);
    return status;
}

int bake_trace_grid_patches(const struct bake_surface *surface, struct bake_device *device,
                            const struct bake_patches *patches, struct bake_report *report)
{
    struct bsq_ctx *ctx = surface->ctx;
    struct trace trace = {.ctx = ctx, .surface = surface, .device = device, .patches = patches};
    const uint64_t side = patches->patch_side, count = bake_raster_patch_count(patches->raster);
    int status;
    BSQ_TRY(bake_patch_workers_begin(ctx, patches, side * side, &trace.workers));
    BSQ_TRY(BSQ_CALLOC(ctx, "workers", bsq_threads(ctx), &trace.started));
    BSQ_TRY(bsq_parallel_for(ctx, count, grid_trace_patch, &trace));
    status = bsq_parallel_for(ctx, bsq_threads(ctx), end_patches, &trace);
done:
    bsq_free(ctx, trace.started);
    bake_patch_workers_end(ctx, &trace.workers, report);
    return status;
}
