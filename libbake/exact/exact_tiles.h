/* exact_tiles.h - traces all tiles of a map against the scan's triangles into an image. */
#ifndef BAKE_EXACT_EXACT_TILES_H
#define BAKE_EXACT_EXACT_TILES_H

#include "libbake/exact/exact.h"
#include "libbake/maps/map_image.h"
#include "libbake/raster/raster.h"

struct bake_exact_tiles {
    struct bake_exact *exact;
    const struct bake_raster *raster;
    const struct bk_triangle *triangles; /* relative to the scan's origin, in its units */
    uint32_t triangle_count;
    bool object_space;
    double front, back;
    struct bake_image *image; /* channels as bake_map_channels(maps) */
    uint32_t maps;            /* of enum bake_map */
    uint32_t samples;         /* N: N x N a texel */
    uint32_t tile_size;
};

/* As bake_trace_tiles(). */
int bake_exact_trace_tiles(struct bsq_ctx *ctx, const struct bake_exact_tiles *tiles,
                           struct bake_report *report);

#endif
