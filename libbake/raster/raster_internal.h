/* raster_internal.h - the triangles of each patch, and triangles on the grid of samples;
 * private to this folder.
 *
 * A map has width * N by height * N samples; sample i has its centre at i + 1/2. Corners are
 * snapped to fixed-point coordinates with `shift` fractional bits. From there on all arithmetic is
 * exact. */
#ifndef BAKE_RASTER_RASTER_INTERNAL_H
#define BAKE_RASTER_RASTER_INTERNAL_H

#include "libbake/raster/raster.h"

struct sample_grid {
    uint32_t columns, rows; /* samples of the whole map */
    unsigned shift;         /* fractional bits of a coordinate */
};

/* Corners in steps of 2^-shift samples, y downwards. */
struct raster_triangle {
    int64_t x[3], y[3];
};

/* Samples begin_x <= x < end_x, begin_y <= y < end_y; empty if begin >= end. */
struct raster_window {
    uint32_t begin_x, begin_y, end_x, end_y;
};

/* Returns the smallest window that holds all samples of the triangle inside the map. */
struct raster_window bake_raster_bounds(const struct sample_grid *grid,
                                        const struct raster_triangle *triangle);

struct bake_raster {
    struct bsq_ctx *ctx;
    const struct bake_lowmesh *mesh;
    struct bake_raster_options options;
    struct sample_grid grid;
    uint32_t patch_columns, patch_rows;
    uint32_t patch_count;    /* patches that a triangle overlaps */
    uint32_t *patch_numbers; /* of each of them: row * patch_columns + column */
    uint64_t *starts;        /* patch_count + 1; where the list of each begins in `triangles` */
    uint32_t *triangles;
};

/* Snaps a triangle of the mesh to the sample grid. Returns false if it can cover no sample. */
bool bake_raster_snap(const struct bake_raster *raster, uint64_t triangle,
                      struct raster_triangle *out);

#endif
