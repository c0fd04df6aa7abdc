/* raster_internal.h - the triangles of each patch, and triangles in texture space as spans of
 * samples; private to this folder.
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

/* Returns the grid of a map with columns x rows samples. Large maps get fewer fractional bits. */
struct sample_grid bake_raster_sample_grid(uint32_t columns, uint32_t rows);

/* Snaps texture coordinates (v upwards) to the grid. Returns false if they are not finite or about
 * 2^32 maps or more away. */
bool bake_raster_snap(const struct sample_grid *grid, const float (*texcoords)[2],
                      struct raster_triangle *out);

/* Checks that the area is not zero. */
bool bake_raster_has_area(const struct raster_triangle *triangle);

/* Returns the smallest window that holds all samples of the triangle inside the map. */
struct raster_window bake_raster_bounds(const struct sample_grid *grid,
                                        const struct raster_triangle *triangle);

/* The first sample at or right of an edge on successive rows: the quotient of an exact division,
 * carried from row to row. */
struct raster_edge {
    int64_t sample;
    __int128 rest; /* sample * divisor - numerator, in [0, divisor) */
    __int128 divisor;
    __int128 step_rest; /* remainder of the step from row to row, in [0, divisor) */
    int64_t step;
};

/* The spans of a triangle from top to bottom. */
struct raster_spans {
    struct raster_window window;
    struct raster_triangle corners; /* ordered by y */
    struct raster_edge long_edge;   /* over the full height of the triangle */
    struct raster_edge short_edge;  /* the upper or lower one of the others */
    unsigned shift;
    bool short_is_right;
    uint32_t row, middle_row, end_row;
};

/* Starts the sequence of spans of a triangle within a window. A sample belongs to the triangle if
 * its centre is inside, or on a top or left edge: two triangles that share an edge share no sample
 * and leave none out. The triangle must have area. */
void bake_raster_spans_begin(const struct sample_grid *grid, const struct raster_triangle *triangle,
                             struct raster_window window, struct raster_spans *out);

/* Finds the next row that has samples, begin <= x < end. Returns false after the last one. */
bool bake_raster_spans_next(struct raster_spans *spans, uint32_t *row, uint32_t *begin,
                            uint32_t *end);

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
static inline bool raster_snap_triangle(const struct bake_raster *raster, uint64_t triangle,
                                        struct raster_triangle *out)
{
    return bake_raster_snap(&raster->grid, (const float(*)[2])raster->mesh->texcoords[triangle],
                            out) &&
           bake_raster_has_area(out);
}

#endif
