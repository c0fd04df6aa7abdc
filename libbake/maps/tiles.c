/* tiles.c - tile size, workers and resolving of a map's tiles, for grids and for triangles. */
#include "base/parallel.h"
#include "libbake/maps/maps.h"

/* Sides in texels, and the tiles that each thread should at least get. */
enum { LARGEST_TILE = 256, USUAL_TILE = 64, SMALLEST_TILE = 8, TILES_A_THREAD = 16 };

/* Returns the largest size of a worker's buffers, which is that with all rows of the table. */
static uint64_t tile_bytes(uint64_t side, uint64_t samples, uint32_t maps)
{
    maps |= (1u << BK_MAP_COUNT) - 1u;
    uint64_t most_floats = bk_texel_floats(maps) + bake_image_channels_for(maps);
    return side * side * (2 * samples * samples * sizeof(uint32_t) + most_floats * sizeof(float));
}

uint32_t bake_tile_size(struct bsq_ctx *ctx, uint32_t width, uint32_t height, uint32_t samples,
                        uint32_t maps)
{
    uint64_t threads = bsq_threads(ctx);
    uint64_t share = bsq_memory_share(ctx, "tiles that are traced", 8) / threads;
    uint64_t texels = (uint64_t)width * height;
    uint32_t side = LARGEST_TILE;
    while (side > USUAL_TILE && texels / side / side < TILES_A_THREAD * threads)
        side /= 2;
    while (side > SMALLEST_TILE && tile_bytes(side, samples, maps) > share)
        side /= 2;
    return side;
}

static uint64_t count_texels(const struct bake_raster *raster)
{
    uint64_t texels = 0;
    for (uint32_t i = 0; i < bake_raster_tile_count(raster); ++i) {
        struct bk_tile tile = bake_raster_tile(raster, i);
        texels += (uint64_t)tile.width * tile.height;
    }
    return texels;
}

int bake_tile_workers_begin(struct bsq_ctx *ctx, const struct bake_tiles *tiles,
                            uint64_t texel_count, struct bake_tile_workers *out)
{
    const uint64_t texels = (uint64_t)tiles->tile_size * tiles->tile_size;
    const uint32_t maps = tiles->params->maps;
    int status;
    *out = (struct bake_tile_workers){.channels = bake_image_channels_for(maps),
                                      .texel_floats = bk_texel_floats(maps),
                                      .maps = maps};
    bsq_progress_begin(ctx, "tracing", "texels", count_texels(tiles->raster));
    BSQ_TRY(bsq_calloc(ctx, "workers", bsq_threads(ctx), sizeof *out->workers, &out->workers));
    for (unsigned w = 0; w < bsq_threads(ctx); w++) {
        struct bake_tile_worker *worker = &out->workers[w];
        BSQ_TRY(bsq_alloc(ctx, "samples of a tile",
                          texels * bake_raster_texel_entries(tiles->params), sizeof(uint32_t),
                          &worker->sample_triangles));
        BSQ_TRY(bsq_alloc(ctx, "texels of a tile", texel_count, out->texel_floats * sizeof(float),
                          &worker->texels));
        BSQ_TRY(bsq_alloc(ctx, "texels of a tile", texels, out->channels * sizeof(float),
                          &worker->resolved));
    }
done:
    return status;
}

/* Writes a texel of the image: its share of hits and the values of the selected maps. */
static void resolve_texel(const float *texel, uint32_t maps, float *out)
{
    const float covered = texel[BK_COVERED], hits = texel[BK_HITS];
    const float weight = hits > 0 ? 1.0f / hits : 0.0f;
    const float *sums = texel + BK_SUMS;
    float *share = out++;
    *share = covered == 0 ? BAKE_OUTSIDE : hits == 0 ? BAKE_MISSED : hits / covered;
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i) {
        const struct bake_map_row *row = &bake_map_table[i];
        if (!(maps & 1u << i))
            continue;
        if (row->resolve) {
            if (!row->resolve(sums, row->channels, weight, out) && *share > 0.0f)
                *share = BAKE_MISSED;
            out += bake_map_values(i);
        }
        sums += bake_map_sums[i];
    }
    for (uint32_t i = 0; i < BK_TRANSFER_VALUES * bk_transfers(maps); ++i)
        out[i] = sums[i] * weight;
}

void bake_tile_worker_resolve(const struct bake_tile_workers *workers,
                              struct bake_tile_worker *worker, uint32_t count, float *out)
{
    for (uint32_t i = 0; i < count; ++i, out += workers->channels) {
        const float *texel = worker->texels + (size_t)i * workers->texel_floats;
        worker->covered_texels += texel[BK_COVERED] > 0;
        worker->samples += (uint64_t)texel[BK_COVERED];
        worker->hits += (uint64_t)texel[BK_HITS];
        resolve_texel(texel, workers->maps, out);
    }
}

void bake_tile_workers_end(struct bsq_ctx *ctx, struct bake_tile_workers *workers,
                           struct bake_report *report)
{
    for (unsigned w = 0; workers->workers && w < bsq_threads(ctx); w++) {
        const struct bake_tile_worker *worker = &workers->workers[w];
        report->covered_texels += worker->covered_texels;
        report->samples += worker->samples;
        report->hits += worker->hits;
        report->misses += worker->samples - worker->hits;
        report->overlapping_samples += worker->overlaps;
        bsq_free(ctx, worker->sample_triangles);
        bsq_free(ctx, worker->texels);
        bsq_free(ctx, worker->resolved);
    }
    bsq_free(ctx, workers->workers);
    workers->workers = NULL;
    bsq_progress_end(ctx);
}
