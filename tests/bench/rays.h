/* rays.h - the rays of a map, for programs that time how fast they are traced. */
#ifndef BENCH_RAYS_H
#define BENCH_RAYS_H

#include "libbake/device/device.h"
#include "libbake/raster/raster.h"
#include "libbake/surface/surface.h"

/* A low mesh before a grid, as bisque-bake prepares them with default options. */
struct rays_scene {
    struct bsq_ctx *ctx;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_raster *raster;
    struct bk_triangle *triangles;
    struct bake_job job;
    uint32_t tile_size, tile_count, samples;
    uint64_t count; /* ray pairs */
};

/* What tracing all of them cost. */
struct rays_cost {
    double wall, processor; /* seconds; processor: of all threads */
    uint64_t hits;
    uint64_t checksum; /* of the texels' bytes, tile by tile */
};

/* Opens the files; size: the map's side. Errors as of bake_run(). */
int rays_open(struct bsq_ctx *ctx, const char *scan, const char *mesh, uint32_t size,
              uint32_t samples, struct rays_scene *out);
void rays_close(struct rays_scene *scene);

/* Calls fn for each tile on all threads, with the tile's samples, and adds up what it returns. */
struct rays_tile {
    uint32_t index;
    unsigned worker;
    struct bk_tile tile;
    const uint32_t *sample_triangles;
    struct bk_texel *texels; /* scratch for the tile */
};
int rays_for_tiles(struct rays_scene *scene, int (*fn)(void *arg, const struct rays_tile *tile),
                   void *arg);

/* For tracing: between the two the cost is counted, from 0. */
void rays_cost_begin(struct rays_cost *cost);
void rays_cost_end(struct rays_cost *cost);

/* Traces all rays on an open device. */
int rays_trace(struct rays_scene *scene, struct bake_device *device, struct rays_cost *cost);

/* The same rays against the scan's triangles, with Embree. */
int rays_embree(struct rays_scene *scene, const char *tris, struct rays_cost *build,
                struct rays_cost *cost);

#endif
