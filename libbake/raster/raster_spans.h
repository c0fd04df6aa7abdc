/* raster_spans.h - one UV triangle as rows of samples, exactly.
 *
 * The map is a lattice of samples, width * N by height * N of them; sample i has its centre at
 * i + 1/2. Corners are snapped to a grid that divides the distance of two samples by 2^shift, and
 * from there on all arithmetic is exact. */
#ifndef BAKE_RASTER_RASTER_SPANS_H
#define BAKE_RASTER_RASTER_SPANS_H

#include <stdbool.h>
#include <stdint.h>

struct raster_lattice {
    uint32_t columns, rows; /* samples of the whole map */
    unsigned shift;
};

/* Corners in steps of 2^-shift samples; y downwards. */
struct raster_triangle {
    int64_t x[3], y[3];
};

/* Samples begin_x <= x < end_x, begin_y <= y < end_y; empty where begin >= end. */
struct raster_window {
    uint32_t begin_x, begin_y, end_x, end_y;
};

/* Lattice of a map with `columns` x `rows` samples: corners are as fine as 64 bits comfortably
 * hold. */
struct raster_lattice bake_raster_lattice_for(uint32_t columns, uint32_t rows);

/* Snaps texture coordinates (v upwards) to the lattice. False where they are not finite or beyond
 * any sensible distance from the map (2^32 maps). */
bool bake_raster_snap(const struct raster_lattice *lattice, const float (*texcoords)[2],
                      struct raster_triangle *out);

/* Twice the area in steps squared is not zero. */
bool bake_raster_has_area(const struct raster_triangle *triangle);

/* The smallest window that holds all samples of the triangle inside the map. */
struct raster_window bake_raster_bounds(const struct raster_lattice *lattice,
                                        const struct raster_triangle *triangle);

/* Where an edge crosses the centre lines of successive rows, as the number of the first sample at
 * or right of it: quotient of an exact division, carried from row to row. */
struct raster_edge {
    int64_t sample;
    __int128 rest; /* sample * divisor - exact numerator, in [0, divisor) */
    __int128 divisor;
    __int128 step_rest; /* remainder of the step from row to row, in [0, divisor) */
    int64_t step;
};

/* Rows of a triangle from top to bottom. */
struct raster_spans {
    struct raster_window window;
    struct raster_triangle corners; /* ordered by y */
    struct raster_edge whole,
        part; /* the edge over the triangle's full height, and one of the others */
    unsigned shift;
    bool part_is_right;
    uint32_t row, middle_row, end_row;
};

/* Starts on the rows of a triangle within a window. A sample belongs to the triangle if its centre
 * is inside, or on a top or left edge: any two triangles that share an edge share no sample and
 * leave none out. The triangle must have area. */
void bake_raster_spans_begin(const struct raster_lattice *lattice,
                             const struct raster_triangle *triangle, struct raster_window window,
                             struct raster_spans *out);

/* The next row that has samples: begin <= x < end. False at the end. */
bool bake_raster_spans_next(struct raster_spans *spans, uint32_t *row, uint32_t *begin,
                            uint32_t *end);

#endif
