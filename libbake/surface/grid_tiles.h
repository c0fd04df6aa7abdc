/* grid_tiles.h - traces all tiles of a map into an image. */
#ifndef BAKE_SURFACE_GRID_TILES_H
#define BAKE_SURFACE_GRID_TILES_H

#include "libbake/device/device.h"
#include "libbake/maps/maps.h"
#include "libbake/raster/raster.h"
#include "libbake/surface/surface.h"

struct bake_grid_tiles {
    struct bake_tiles tiles;
    struct bake_device *device;
    const struct bake_surface *surface; /* that the device traces; checked after every tile */
    const struct bake_plan *plan;       /* NULL: the device holds the grid */
};

/* Traces and resolves every tile, and adds to the report what bake_tile_workers_end() does. */
int bake_trace_grid_tiles(struct bsq_ctx *ctx, const struct bake_grid_tiles *grid,
                          struct bake_report *report);

#endif
