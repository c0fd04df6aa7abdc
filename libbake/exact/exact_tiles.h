/* exact_tiles.h - traces all tiles of a map against the scan's triangles into an image. */
#ifndef BAKE_EXACT_EXACT_TILES_H
#define BAKE_EXACT_EXACT_TILES_H

#include "libbake/exact/exact.h"
#include "libbake/maps/maps.h"

struct bake_exact_tiles {
    struct bake_tiles tiles; /* index space: the scan's units, relative to its origin */
    struct bake_exact *exact;
    double front, back; /* ray lengths */
};

/* As bake_trace_grid_tiles(). */
int bake_exact_trace_tiles(struct bsq_ctx *ctx, const struct bake_exact_tiles *tiles,
                           struct bake_report *report);

#endif
