/* tiles.c - tiles are independent: each worker rasterises, traces, resolves and stores one at a
 * time in buffers of its own. A grid that the device does not
 * hold is traced in passes: while one runs, a worker uploads what the next needs. Texels do not
 * depend on the tile that they are in, so the map is the same for any tile size and number of
 * threads. */
#include "libbake/tiles_internal.h"

#include "base/parallel.h"
#include "base/vec.h"
#include "libbake/surface_internal.h"

#include <string.h>

enum { LARGEST_TILE = 256, USUAL_TILE = 64, SMALLEST_TILE = 8, TILES_A_THREAD = 16 };

struct worker {
    uint32_t *sample_triangles;
    struct bk_texel *texels;
    float *resolved;
    /* Counts of this worker, joined at the end. */
    uint64_t covered_texels, samples, hits, overlaps;
};

struct trace {
    struct bsq_ctx *ctx;
    const struct bake_tiles *tiles;
    uint32_t channels;
    struct worker *workers;
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
    uint64_t limit = bsq_memory_limit(ctx), used = bsq_memory_used(ctx);
    uint64_t share = used < limit ? (limit - used) / 8 / threads : 0;
    uint64_t texels = (uint64_t)width * height;
    uint32_t side = LARGEST_TILE;
    while (side > USUAL_TILE && texels / side / side < TILES_A_THREAD * threads)
        side /= 2;
    while (side > SMALLEST_TILE && tile_bytes(side, samples) > share)
        side /= 2;
    return side;
}

void bake_resolve_texel(const struct bk_texel *texel, uint32_t maps, float *out)
{
    float *share = out++;
    float weight = texel->hits > 0 ? 1.0f / (float)texel->hits : 0.0f;
    *share = texel->covered == 0 ? BAKE_OUTSIDE
             : texel->hits == 0  ? BAKE_MISSED
                                 : (float)texel->hits / (float)texel->covered;
    if (maps & BAKE_MAP_NORMAL) {
        struct bsq_vec3 n = bsq_unit3(bsq_v3(texel->normal[0], texel->normal[1], texel->normal[2]));
        if (*share > 0.0f && !(bsq_dot3(n, n) > 0.0f))
            *share = BAKE_MISSED; /* the samples cancel each other: there is no direction */
        *out++ = n.x;
        *out++ = n.y;
        *out++ = n.z;
    }
    for (uint32_t c = 0; maps & BAKE_MAP_COLOR && c < 3; ++c)
        *out++ = texel->color[c] * weight;
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
    struct worker *worker = &trace->workers[number];
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
    uint32_t count = tile.width * tile.height;
    for (uint32_t i = 0; i < count; ++i) {
        const struct bk_texel *texel = &worker->texels[i];
        worker->covered_texels += texel->covered > 0;
        worker->samples += texel->covered;
        worker->hits += texel->hits;
        bake_resolve_texel(texel, tiles->maps, worker->resolved + (size_t)i * trace->channels);
    }
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
                            &trace->tiles->plan->passes[pass].part);
}

/* A step of a pass: the first uploads for the next pass, the others trace. */
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

static int allocate_worker(const struct trace *trace, struct worker *worker)
{
    struct bsq_ctx *ctx = trace->ctx;
    uint64_t side = trace->tiles->tile_size, samples = trace->tiles->samples;
    int status = bsq_alloc(ctx, "samples of a tile", side * side * samples,
                           samples * sizeof(uint32_t), &worker->sample_triangles);
    if (status == 0)
        status = bsq_alloc(ctx, "texels of a tile", side * side, sizeof *worker->texels,
                           &worker->texels);
    if (status == 0)
        status = bsq_alloc(ctx, "texels of a tile", side * side, trace->channels * sizeof(float),
                           &worker->resolved);
    return status;
}

static void end_worker(struct bsq_ctx *ctx, const struct worker *worker, struct bake_report *report)
{
    report->covered_texels += worker->covered_texels;
    report->samples += worker->samples;
    report->hits += worker->hits;
    report->misses += worker->samples - worker->hits;
    report->overlapping_samples += worker->overlaps;
    bsq_free(ctx, worker->sample_triangles);
    bsq_free(ctx, worker->texels);
    bsq_free(ctx, worker->resolved);
}

int bake_trace_tiles(struct bsq_ctx *ctx, const struct bake_tiles *tiles,
                     struct bake_report *report)
{
    struct trace trace = {
        .ctx = ctx, .tiles = tiles, .channels = bake_image_channels(tiles->image)};
    unsigned threads = bsq_threads(ctx);
    int status = bsq_calloc(ctx, "workers", threads, sizeof *trace.workers, &trace.workers);
    if (status < 0)
        return status;
    for (unsigned w = 0; status == 0 && w < threads; ++w)
        status = allocate_worker(&trace, &trace.workers[w]);
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
    for (unsigned w = 0; w < threads; ++w)
        end_worker(ctx, &trace.workers[w], report);
    bsq_free(ctx, trace.workers);
    return status;
}
