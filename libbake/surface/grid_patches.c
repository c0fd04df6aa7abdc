/* grid_patches.c - traces the patches of a map on a grid.
 *
 * Patches are independent: each worker rasterises, traces, resolves and stores one patch at a time
 * in its own buffers. A grid that does not fit the device is traced in passes; during a pass, one
 * worker uploads the subgrid of the next. A texel does not depend on its patch, so the map is the
 * same for any patch size and number of threads. */
#include "libbake/surface/surface.h"

#include <string.h>

#include "base/parallel.h"
#include "libbake/raster/raster.h"

struct trace {
    struct bsq_ctx *ctx;
    const struct bake_surface *surface;
    struct bake_device *device;
    const struct bake_patches *patches;
    struct bake_plan plan; /* without passes: the device holds the grid */
    struct bake_patch_workers workers;
    uint64_t pass; /* the current pass; 0 without a plan */
};

/* Moves the entries of a rectangle of texels to `to`, row by row. from: entries of the samples of a
 * patch. */
static void crop_samples(const uint32_t *from, const struct bk_patch *patch, uint32_t n,
                         const struct bake_rectangle *texels, uint32_t *to)
{
    const uint64_t row = (uint64_t)patch->width * n, kept = (uint64_t)texels->width * n;
    from += (uint64_t)texels->y * n * row + (uint64_t)texels->x * n;
    for (uint64_t j = 0; j < (uint64_t)texels->height * n; j++)
        memmove(to + j * kept, from + j * row, kept * sizeof *to);
}

/* Moves the samples of a rectangle of texels, and their skews, to the front of the patch's. */
static void crop(const struct bk_params *params, uint32_t *samples, const struct bk_patch *patch,
                 const struct bake_rectangle *texels)
{
    const uint64_t n = params->samples, square = n * n;
    crop_samples(samples, patch, params->samples, texels, samples);
    if (params->flags & BK_SKEW)
        crop_samples(samples + square * patch->width * patch->height, patch, params->samples,
                     texels, samples + square * texels->width * texels->height);
}

static int trace_piece(struct trace *trace, const struct bake_piece *piece, unsigned number)
{
    const struct bake_patches *patches = trace->patches;
    struct bake_patch_worker *worker = &trace->workers.workers[number];
    const struct bk_patch whole = bake_raster_patch(patches->raster, piece->patch);
    const struct bake_rectangle *texels = &piece->texels;
    const struct bk_patch patch = {whole.x + texels->x, whole.y + texels->y, texels->width,
                                   texels->height};
    uint64_t overlaps = 0;
    int status =
        bake_raster_fill(patches->raster, piece->patch, worker->sample_triangles, &overlaps);
    if (status < 0)
        return status;
    /* The overlaps of the whole patch are counted with its first piece. */
    worker->overlaps += texels->x == 0 && texels->y == 0 ? overlaps : 0;
    crop(patches->params, worker->sample_triangles, &whole, texels);
    if (patches->seen)
        bake_seen_mark_patch(trace->surface, patches, &patch, worker->sample_triangles);
    status =
        bake_device_trace(trace->device, &patch, worker->sample_triangles, worker->texels, number);
    if (status == 0)
        status = bake_surface_check(trace->surface);
    if (status < 0)
        return status;
    const uint32_t count = patch.width * patch.height;
    bake_patch_worker_resolve(&trace->workers, worker, count, worker->resolved);
    bsq_progress_add(trace->ctx, count);
    return bake_image_write_patch(patches->image, &patch, worker->resolved);
}

static int trace_patch(void *arg, uint64_t index, unsigned number)
{
    struct trace *trace = arg;
    const struct bk_patch patch = bake_raster_patch(trace->patches->raster, (uint32_t)index);
    const struct bake_piece piece = {(uint32_t)index, {0, 0, patch.width, patch.height}};
    return trace_piece(trace, &piece, number);
}

static int load_pass(const struct trace *trace, uint64_t pass)
{
    return bake_device_load(trace->device, pass % BAKE_SLOTS, &trace->plan.passes[pass].subgrid);
}

/* Does one step of a pass. Step 0 uploads the subgrid of the next pass, each other step traces a
 * piece. */
static int do_step(void *arg, uint64_t index, unsigned number)
{
    struct trace *trace = arg;
    const struct bake_plan *plan = &trace->plan;
    if (index > 0)
        return trace_piece(trace, &plan->pieces[plan->passes[trace->pass].first_piece + index - 1],
                           number);
    return trace->pass + 1 < plan->pass_count ? load_pass(trace, trace->pass + 1) : 0;
}

static int run_passes(struct trace *trace)
{
    const struct bake_plan *plan = &trace->plan;
    int status = load_pass(trace, 0);
    for (trace->pass = 0; trace->pass < plan->pass_count && status == 0; trace->pass++) {
        bake_device_use(trace->device, trace->pass % BAKE_SLOTS);
        status =
            bsq_parallel_for(trace->ctx, plan->passes[trace->pass].piece_count + 1, do_step, trace);
    }
    return status;
}

int bake_trace_grid_patches(const struct bake_surface *surface, struct bake_device *device,
                            const struct bake_patches *patches, struct bake_report *report)
{
    struct bsq_ctx *ctx = surface->ctx;
    struct trace trace = {.ctx = ctx, .surface = surface, .device = device, .patches = patches};
    const uint64_t side = patches->patch_side;
    int status = bake_device_plan(device, patches->raster, &trace.plan);
    const uint64_t passes = trace.plan.pass_count;
    if (report->passes < (passes > 0 ? passes : 1))
        report->passes = passes > 0 ? passes : 1;
    if (status == 0) {
        status = bake_patch_workers_begin(ctx, patches, side * side, &trace.workers);
        if (status == 0)
            status = passes > 0 ? run_passes(&trace)
                                : bsq_parallel_for(ctx, bake_raster_patch_count(patches->raster),
                                                   trace_patch, &trace);
        bake_patch_workers_end(ctx, &trace.workers, report);
    }
    bake_plan_free(ctx, &trace.plan);
    return status;
}
