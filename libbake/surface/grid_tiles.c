/* grid_tiles.c - tiles are independent: each worker rasterises, traces, resolves and stores one at
 * a time in buffers of its own. A grid that the device does not hold is traced in passes: while one
 * runs, a worker uploads what the next needs. Texels do not depend on the tile that they are in, so
 * the map is the same for any tile size and number of threads. */
#include "libbake/surface/grid_tiles.h"

#include "base/parallel.h"
#include "libbake/surface/surface.h"
#include "libbake/maps/tile_workers.h"

#include <string.h>

enum { LARGEST_TILE = 256, USUAL_TILE = 64, SMALLEST_TILE = 8, TILES_A_THREAD = 16 };

struct trace {
    struct bsq_ctx *ctx;
    const struct bake_tiles *tiles;
    struct bake_tile_workers workers;
    uint64_t pass; /* that runs; 0 without a plan */
};

static uint64_t tile_bytes(uint64_t side, uint64_t samples)
{
    uint64_t most_channels = 7;
    return side * side *
           (samples * samples * sizeof(uint32_t) + sizeof(struct bk_texel) +
            most_channels * sizeof(float));
}

uint32_t bake_tile_size(struct bsq_ctx *ctx, uint32_t width, uint32_t height, uint32_t samples)
{
    uint64_t threads = bsq_threads(ctx);
    uint64_t share = bsq_memory_left(ctx) / 8 / threads;
    uint64_t texels = (uint64_t)width * height;
    uint32_t side = LARGEST_TILE;
    while (side > USUAL_TILE && texels / side / side < TILES_A_THREAD * threads)
        side /= 2;
    while (side > SMALLEST_TILE && tile_bytes(side, samples) > share)
        side /= 2;
    return side;
}

/* Moves the samples of a rectangle of a tile's texels to the front, row after row. */
static void crop_samples(uint32_t *samples, const struct bk_tile *tile, uint32_t n,
                         const struct bake_rectangle *texels)
{
    const uint64_t row = (uint64_t)tile->width * n, kept = (uint64_t)texels->width * n;
    const uint32_t *from = samples + (uint64_t)texels->y * n * row + (uint64_t)texels->x * n;
    for (uint64_t j = 0; j < (uint64_t)texels->height * n; j++)
        memmove(samples + j * kept, from + j * row, kept * sizeof *samples);
}

static int trace_piece(struct trace *trace, const struct bake_piece *piece, unsigned number)
{
    const struct bake_tiles *tiles = trace->tiles;
    struct bake_tile_worker *worker = &trace->workers.workers[number];
    const struct bk_tile whole = bake_raster_tile(tiles->raster, piece->tile);
    const struct bake_rectangle *texels = &piece->texels;
    const struct bk_tile tile = {whole.x + texels->x, whole.y + texels->y, texels->width,
                                 texels->height};
    uint64_t overlaps = 0;
    bake_raster_fill(tiles->raster, piece->tile, worker->sample_triangles, &overlaps);
    /* They are of the whole tile, and counted with its first piece. */
    worker->overlaps += texels->x == 0 && texels->y == 0 ? overlaps : 0;
    crop_samples(worker->sample_triangles, &whole, tiles->samples, texels);
    int status =
        bake_device_trace(tiles->device, &tile, worker->sample_triangles, worker->texels, number);
    if (status == 0)
        status = bake_surface_check(tiles->surface);
    if (status < 0)
        return status;
    const uint32_t count = tile.width * tile.height;
    bake_tile_worker_resolve(&trace->workers, worker, count, worker->resolved);
    bsq_progress_add(trace->ctx, count);
    return bake_image_write(tiles->image, tile.x, tile.y, tile.width, tile.height,
                            worker->resolved);
}

static int trace_tile(void *arg, uint64_t index, unsigned number)
{
    struct trace *trace = arg;
    const struct bk_tile tile = bake_raster_tile(trace->tiles->raster, (uint32_t)index);
    const struct bake_piece piece = {(uint32_t)index, {0, 0, tile.width, tile.height}};
    return trace_piece(trace, &piece, number);
}

static int load_pass(const struct trace *trace, uint64_t pass)
{
    return bake_device_load(trace->tiles->device, pass % BAKE_SLOTS,
                            &trace->tiles->plan->passes[pass].subgrid);
}

/* A step of a pass: the first uploads for the next pass, the others trace; a single thread does one
 * after the other. */
static int do_step(void *arg, uint64_t index, unsigned number)
{
    struct trace *trace = arg;
    const struct bake_plan *plan = trace->tiles->plan;
    if (index > 0)
        return trace_piece(trace, &plan->pieces[plan->passes[trace->pass].first_piece + index - 1],
                           number);
    return trace->pass + 1 < plan->pass_count ? load_pass(trace, trace->pass + 1) : 0;
}

static int run_passes(struct trace *trace)
{
    const struct bake_plan *plan = trace->tiles->plan;
    int status = plan->pass_count > 0 ? load_pass(trace, 0) : 0;
    for (trace->pass = 0; trace->pass < plan->pass_count && status == 0; trace->pass++) {
        bake_device_use(trace->tiles->device, trace->pass % BAKE_SLOTS);
        status =
            bsq_parallel_for(trace->ctx, plan->passes[trace->pass].piece_count + 1, do_step, trace);
    }
    return status;
}

int bake_trace_tiles(struct bsq_ctx *ctx, const struct bake_tiles *tiles,
                     struct bake_report *report)
{
    struct trace trace = {.ctx = ctx, .tiles = tiles};
    int status = bake_tile_workers_create(ctx, tiles->tile_size, tiles->samples,
                                          (uint64_t)tiles->tile_size * tiles->tile_size,
                                          tiles->maps, &trace.workers);
    if (status == 0) {
        uint32_t count = bake_raster_tile_count(tiles->raster);
        uint64_t texels = 0;
        for (uint32_t i = 0; i < count; ++i) {
            struct bk_tile tile = bake_raster_tile(tiles->raster, i);
            texels += (uint64_t)tile.width * tile.height;
        }
        bsq_progress_begin(ctx, "tracing", "texels", texels);
        status =
            tiles->plan ? run_passes(&trace) : bsq_parallel_for(ctx, count, trace_tile, &trace);
        bsq_progress_end(ctx);
    }
    bake_tile_workers_end(ctx, &trace.workers, report);
    return status;
}
