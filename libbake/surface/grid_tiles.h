/* grid_tiles.h - traces all tiles of a map into an image. */
#ifndef BAKE_SURFACE_GRID_TILES_H
#define BAKE_SURFACE_GRID_TILES_H

#include "libbake/device/device.h"
#include "libbake/maps/map_image.h"
#include "libbake/raster/raster.h"
#include "libbake/surface/surface.h"

/* Side of the tiles: large where there is work for all threads, small where memory is short. */
uint32_t bake_tile_size(struct bsq_ctx *ctx, uint32_t width, uint32_t height, uint32_t samples);

struct bake_tiles {
    const struct bake_raster *raster;
    struct bake_device *device;
    const struct bake_surface *surface; /* that the device traces; checked after every tile */
    const struct bake_plan *plan;       /* if the device does not hold the grid, else NULL */
    struct bake_image *image;           /* channels as bake_map_channels(maps) */
    uint32_t maps;                      /* of enum bake_map */
    uint32_t samples;                   /* N: N x N a texel */
    uint32_t tile_size;
};

/* Traces and resolves every tile, and adds to the report what bake_tile_workers_end() does. */
int bake_trace_tiles(struct bsq_ctx *ctx, const struct bake_tiles *tiles,
                     struct bake_report *report);

#endif
