/* raster.h - which triangle does each sample of the map lie in? */
#ifndef BAKE_RASTER_RASTER_H
#define BAKE_RASTER_RASTER_H

#include "libbake/kernel/bk_types.h"
#include "libbake/lowpoly/lowpoly.h"

/* Prepared UV triangles with an index by tile. */
struct bake_raster;

struct bake_raster_options {
    uint32_t width, height; /* of the map in texels */
    uint32_t samples;       /* N x N a texel */
    uint32_t tile_size;     /* tiles of tile_size x tile_size texels, the last ones smaller */
};

struct bake_raster_report {
    uint64_t degenerate_triangles; /* no area in UV space */
    uint64_t outside_triangles; /* wholly or partly outside 0..1: the part outside is not baked */
};

/* Prepares; mesh must outlive the raster. Sorts triangles into tiles once: O(triangles + tiles
 * touched). */
int bake_raster_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                       const struct bake_raster_options *options, struct bake_raster_report *report,
                       struct bake_raster **out);
void bake_raster_free(struct bake_raster *raster);

/* Tiles in row order. Tiles that no triangle touches are left out. */
uint32_t bake_raster_tile_count(const struct bake_raster *raster);
struct bk_tile bake_raster_tile(const struct bake_raster *raster, uint32_t index);

/* Fills height * N rows of width * N entries for a tile (see bk_tile). Where triangles overlap, the
 * one that comes first in the mesh wins, and *overlaps is set to the number of samples concerned.
 * Edges shared by two triangles belong to exactly one of them (top-left rule on exact fixed-point
 * coordinates). Thread-safe. */
void bake_raster_fill(const struct bake_raster *raster, uint32_t index, uint32_t *sample_triangles,
                      uint64_t *overlaps);

/* Fills bk_triangles for the kernel: index = (world - translation) / voxel_size. `out` has one
 * entry per triangle; those without UV area are zeroed (no sample refers to them). */
void bake_raster_kernel_triangles(const struct bake_raster *raster, const double translation[3],
                                  double voxel_size, struct bk_triangle *out);

#endif
