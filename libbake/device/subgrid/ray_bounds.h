/* ray_bounds.h - which nodes of a grid the rays of a piece of the map can come to. */
#ifndef BAKE_DEVICE_SUBGRID_RAY_BOUNDS_H
#define BAKE_DEVICE_SUBGRID_RAY_BOUNDS_H

#include "libbake/device/device.h"
#include "libbake/device/subgrid/leaf_set.h"

/* A rectangle of texels of a tile, relative to it. */
struct bake_rectangle {
    uint32_t x, y, width, height;
};

/* Adds to `set` all nodes that rays of these texels' samples, or the blending around their hits,
 * look up. Conservative: boxes around the rays of a few neighbouring texels. sample_triangles: of
 * the whole tile. */
int bake_reach(struct bsq_ctx *ctx, const struct bake_job *job, const struct bk_tile *tile,
               const uint32_t *sample_triangles, const struct bake_rectangle *rectangle,
               struct bake_leaf_set *set);

#endif
