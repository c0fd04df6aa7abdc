/* patches.c - patch size, workers and resolving of a map's patches, for grids and for triangles. */
#include <string.h>

#include "base/parallel.h"
#include "libbake/maps/maps.h"

/* Sides in texels, and the patches that each thread should at least get. */
enum { LARGEST_PATCH = 256, USUAL_PATCH = 64, SMALLEST_PATCH = 8, PATCHES_A_THREAD = 16 };

/* Returns the largest size of a worker's buffers, which is that with all rows of the table. */
static uint64_t patch_bytes(uint64_t side, uint64_t samples, uint32_t maps)
{
    maps |= (1u << BK_MAP_COUNT) - 1u;
    uint64_t most_floats = bk_texel_floats(maps) + bake_image_channels_for(maps);
    return side * side * (2 * samples * samples * sizeof(uint32_t) + most_floats * sizeof(float));
}

uint32_t bake_patch_side(struct bsq_ctx *ctx, uint32_t width, uint32_t height, uint32_t samples,
                         uint32_t maps)
{
    uint64_t threads = bsq_threads(ctx);
    uint64_t share = bsq_memory_left(ctx) / 8 / threads;
    uint64_t texels = (uint64_t)width * height;
    uint32_t side = LARGEST_PATCH;
    while (side > USUAL_PATCH && texels / side / side < PATCHES_A_THREAD * threads)
        side /= 2;
    while (side > SMALLEST_PATCH && patch_bytes(side, samples, maps) > share)
        side /= 2;
    return side;
}

static uint64_t map_patches_count_texels(const struct bake_raster *raster)
{
    uint64_t texels = 0;
    for (uint32_t i = 0; i < bake_raster_patch_count(raster); ++i) {
        struct bk_patch patch = bake_raster_patch(raster, i);
        texels += (uint64_t)patch.width * patch.height;
    }
    return texels;
}

int bake_patch_workers_begin(struct bsq_ctx *ctx, const struct bake_patches *patches,
                             uint64_t texel_count, struct bake_patch_workers *out)
{
    const uint64_t texels = (uint64_t)patches->patch_side * patches->patch_side;
    const uint32_t maps = patches->params->maps;
    *out = (struct bake_patch_workers){
        .channels = patches->image->channels, .texel_floats = bk_texel_floats(maps), .maps = maps};
    out->more = out->channels - bake_image_channels_for(maps);
    out->texel_floats += out->more;
    bsq_progress_begin(ctx, "tracing", "texels", map_patches_count_texels(patches->raster));
    BSQ_PASS(BSQ_CALLOC(ctx, "workers", bsq_threads(ctx), &out->workers));
    for (unsigned w = 0; w < bsq_threads(ctx); w++) {
        struct bake_patch_worker *worker = &out->workers[w];
        BSQ_PASS(bsq_alloc(ctx, "samples of a patch",
                           texels * bake_raster_texel_entries(patches->params), sizeof(uint32_t),
                           &worker->sample_triangles));
        BSQ_PASS(bsq_alloc(ctx, "texels of a patch", texel_count, out->texel_floats * sizeof(float),
                           &worker->texels));
        BSQ_PASS(bsq_alloc(ctx, "texels of a patch", texels, out->channels * sizeof(float),
                           &worker->resolved));
    }
    return 0;
}

/* Writes a texel of the image: its share of hits, the values of the selected maps, and `more`
 * values that stay as they are. */
static void resolve_texel(const float *texel, uint32_t maps, uint32_t more, float *out)
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
    const uint32_t transfers = BK_TRANSFER_VALUES * bk_transfers(maps);
    for (uint32_t i = 0; i < transfers; ++i)
        out[i] = sums[i] * weight;
    memcpy(out + transfers, sums + transfers, more * sizeof *out);
}

void bake_patch_worker_resolve(const struct bake_patch_workers *workers,
                               struct bake_patch_worker *worker, uint32_t count, float *out)
{
    for (uint32_t i = 0; i < count; ++i, out += workers->channels) {
        const float *texel = worker->texels + (size_t)i * workers->texel_floats;
        worker->covered_texels += texel[BK_COVERED] > 0;
        worker->samples += (uint64_t)texel[BK_COVERED];
        worker->hits += (uint64_t)texel[BK_HITS];
        resolve_texel(texel, workers->maps, workers->more, out);
    }
}

void bake_patch_workers_end(struct bsq_ctx *ctx, struct bake_patch_workers *workers,
                            struct bake_report *report)
{
    for (unsigned w = 0; workers->workers && w < bsq_threads(ctx); w++) {
        const struct bake_patch_worker *worker = &workers->workers[w];
        report->covered_texels += worker->covered_texels;
        report->samples += worker->samples;
        report->hits += worker->hits;
        report->misses += worker->samples - worker->hits;
        report->overlapping_samples += worker->overlaps;
        BSQ_FREE(ctx, worker->sample_triangles, worker->texels, worker->resolved);
    }
    bsq_free(ctx, workers->workers);
    workers->workers = NULL;
    bsq_progress_end(ctx);
}
