/* tile_workers.h - what each worker has that goes through a map's tiles, on a grid or on triangles:
 * buffers for one tile, and counts for the report. */
#ifndef BAKE_MAPS_TILE_WORKERS_H
#define BAKE_MAPS_TILE_WORKERS_H

#include "libbake/bake.h"
#include "libbake/kernel/bk_types.h"

struct bake_tile_worker {
    uint32_t *sample_triangles; /* of a tile, as bake_raster_fill() writes them */
    struct bk_texel *texels;    /* as many as were asked for */
    float *resolved;            /* channels of a tile's texels */
    uint64_t covered_texels, samples, hits, overlaps;
};

struct bake_tile_workers {
    struct bake_tile_worker *workers; /* one a thread; NULL: none yet */
    uint32_t channels;                /* of `resolved`, as bake_map_channels(maps) */
    uint32_t maps;                    /* of enum bake_map */
};

/* Zeroed counts and room for tiles of tile_size, with samples x samples samples a texel. *out: also
 * after a failure, to be ended. */
int bake_tile_workers_create(struct bsq_ctx *ctx, uint32_t tile_size, uint32_t samples,
                             uint64_t texel_count, uint32_t maps, struct bake_tile_workers *out);

/* Counts the worker's first `count` texels and turns their sums into what an image stores of them:
 * the share of samples that hit, the unit vector of the normals' sum, the mean colour. */
void bake_tile_worker_resolve(const struct bake_tile_workers *workers,
                              struct bake_tile_worker *worker, uint32_t count, float *out);

/* Adds all counts to the report's covered_texels, samples, hits, misses and overlapping_samples,
 * and frees the buffers. */
void bake_tile_workers_end(struct bsq_ctx *ctx, struct bake_tile_workers *workers,
                           struct bake_report *report);

#endif
