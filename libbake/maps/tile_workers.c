/* tile_workers.c - see tile_workers.h. */
#include "libbake/maps/tile_workers.h"

#include "base/parallel.h"
#include "base/vec.h"
#include "libbake/maps/map_image.h"
#include "libbake/maps/map_files.h"

int bake_tile_workers_create(struct bsq_ctx *ctx, uint32_t tile_size, uint32_t samples,
                             uint64_t texel_count, uint32_t maps, struct bake_tile_workers *out)
{
    const uint64_t side = tile_size;
    *out = (struct bake_tile_workers){.channels = bake_map_channels(maps), .maps = maps};
    int status = bsq_calloc(ctx, "workers", bsq_threads(ctx), sizeof *out->workers, &out->workers);
    for (unsigned w = 0; status == 0 && w < bsq_threads(ctx); w++) {
        struct bake_tile_worker *worker = &out->workers[w];
        status = bsq_alloc(ctx, "samples of a tile", side * side * samples,
                           samples * sizeof(uint32_t), &worker->sample_triangles);
        if (status == 0)
            status = bsq_alloc(ctx, "texels of a tile", texel_count, sizeof *worker->texels,
                               &worker->texels);
        if (status == 0)
            status = bsq_alloc(ctx, "texels of a tile", side * side, out->channels * sizeof(float),
                               &worker->resolved);
    }
    return status;
}

static void resolve_texel(const struct bk_texel *texel, uint32_t maps, float *out)
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

void bake_tile_worker_resolve(const struct bake_tile_workers *workers,
                              struct bake_tile_worker *worker, uint32_t count, float *out)
{
    for (uint32_t i = 0; i < count; ++i, out += workers->channels) {
        const struct bk_texel *texel = &worker->texels[i];
        worker->covered_texels += texel->covered > 0;
        worker->samples += texel->covered;
        worker->hits += texel->hits;
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
}
