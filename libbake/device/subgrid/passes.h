/* passes.h - a grid that does not fit a device is baked in passes: each traces some tiles
 * with only those nodes of the grid that their rays can come to. */
#ifndef BAKE_DEVICE_SUBGRID_PASSES_H
#define BAKE_DEVICE_SUBGRID_PASSES_H

#include "libbake/device/subgrid/subgrid.h"
#include "libbake/raster/raster.h"
#include "libbake/device/subgrid/ray_bounds.h"

/* Texels that are traced together: mostly a tile, less where a tile's nodes are too many. */
struct bake_piece {
    uint32_t tile; /* of the raster */
    struct bake_rectangle texels;
};

struct bake_pass {
    uint64_t first_piece, piece_count;
    struct bake_part part;
};

struct bake_plan {
    struct bake_piece *pieces;
    struct bake_pass *passes;
    uint64_t piece_count, pass_count, piece_capacity, pass_capacity;
};

struct bake_plan_options {
    const struct bake_raster *raster;
    const struct bake_job *job;
    /* What the arrays of one pass may take, together and each. */
    uint64_t part_bytes, buffer_bytes;
    uint64_t other_bytes; /* of the device's memory that the job uses besides; for messages */
};

/* Plans passes over all tiles. Fails with
 * BSQ_ENODEVICE where not even the nodes of a single texel fit. Free with bake_plan_free(), also
 * after a failure. */
int bake_plan_passes(struct bsq_ctx *ctx, const struct bake_plan_options *options,
                     struct bake_plan *out);
void bake_plan_free(struct bsq_ctx *ctx, struct bake_plan *plan);

#endif
