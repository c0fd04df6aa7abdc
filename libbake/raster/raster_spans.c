/* raster_spans.c - exact scan conversion.
 *
 * Each edge crosses the centre line of a row at a rational x. A division that rounds upwards gives
 * the first sample at or right of it. A span reaches from the left edge's sample to the right
 * edge's, exclusive, and rows are half open in the same way: this is the top-left rule. Two
 * triangles that share an edge compute the same rational from it, so each sample along the edge
 * belongs to exactly one of them. The next row adds a constant to the numerator, so the quotient is
 * carried along without another division (Bresenham's idea; for polygons see Foley et al.,
 * "Computer Graphics: Principles and Practice", 1990, section 3.6).
 *
 * Numerators are products of two coordinates. They do not overflow 128 bits, even for triangles
 * that extend far beyond the map. */
#include "libbake/raster/raster_internal.h"

#include <math.h>

/* Corners inside the map are below 2^28 steps; a step is at least 2^-16 samples. */
#define MAP_BITS  28
#define MAX_SHIFT 16
/* Largest coordinate in steps: sums and products of differences stay well below 128 bits. */
#define MAX_COORDINATE 0x1p60

struct sample_grid bake_raster_sample_grid(uint32_t columns, uint32_t rows)
{
    uint32_t longest = columns > rows ? columns : rows;
    unsigned shift = MAX_SHIFT;

    while (shift > 0 && ((uint64_t)longest << shift) > (uint64_t)1 << MAP_BITS)
        shift--;
    return (struct sample_grid){.columns = columns, .rows = rows, .shift = shift};
}

bool bake_raster_snap(const struct sample_grid *grid, const float (*texcoords)[2],
                      struct raster_triangle *out)
{
    const double one = (double)((uint32_t)1 << grid->shift);

    for (int i = 0; i < 3; i++) {
        double x = texcoords[i][0] * (grid->columns * one);
        double y = (1.0 - texcoords[i][1]) * (grid->rows * one);
        if (!(fabs(x) < MAX_COORDINATE && fabs(y) < MAX_COORDINATE))
            return false;
        out->x[i] = llrint(x);
        out->y[i] = llrint(y);
    }
    return true;
}

/* Returns twice the signed area; positive if the corners run clockwise on the map (y downwards). */
static __int128 double_area(const struct raster_triangle *t)
{
    return (__int128)(t->x[1] - t->x[0]) * (t->y[2] - t->y[0]) -
           (__int128)(t->x[2] - t->x[0]) * (t->y[1] - t->y[0]);
}

bool bake_raster_has_area(const struct raster_triangle *triangle)
{
    return double_area(triangle) != 0;
}

static __int128 divide_down(__int128 a, __int128 b)
{
    __int128 quotient = a / b;
    return quotient - (a % b < 0);
}

static int64_t clamp64(__int128 value, int64_t low, int64_t high)
{
    return value < low ? low : value > high ? high : (int64_t)value;
}

/* Returns the first sample whose centre is at or beyond a coordinate, clamped to 0 .. limit. */
static uint32_t first_sample(const struct sample_grid *grid, int64_t coordinate, uint32_t limit)
{
    const int64_t one = (int64_t)1 << grid->shift;
    return (uint32_t)clamp64(-divide_down(one / 2 - coordinate, one), 0, limit);
}

struct raster_window bake_raster_bounds(const struct sample_grid *grid,
                                        const struct raster_triangle *triangle)
{
    int64_t low_x = triangle->x[0], high_x = low_x, low_y = triangle->y[0], high_y = low_y;

    for (int i = 1; i < 3; i++) {
        low_x = triangle->x[i] < low_x ? triangle->x[i] : low_x;
        high_x = triangle->x[i] > high_x ? triangle->x[i] : high_x;
        low_y = triangle->y[i] < low_y ? triangle->y[i] : low_y;
        high_y = triangle->y[i] > high_y ? triangle->y[i] : high_y;
    }
    return (struct raster_window){.begin_x = first_sample(grid, low_x, grid->columns),
                                  .begin_y = first_sample(grid, low_y, grid->rows),
                                  .end_x = first_sample(grid, high_x, grid->columns),
                                  .end_y = first_sample(grid, high_y, grid->rows)};
}

/* Sets up the edge from corner a down to corner b for a row. */
static void edge_begin(struct raster_edge *edge, const struct raster_spans *spans, int a, int b,
                       uint32_t row)
{
    const struct raster_triangle *t = &spans->corners;
    const int64_t one = (int64_t)1 << spans->shift;
    const __int128 height = t->y[b] - t->y[a], width = t->x[b] - t->x[a];
    const __int128 centre = (__int128)row * one + one / 2;
    const __int128 numerator = (t->x[a] - one / 2) * height + width * (centre - t->y[a]);

    edge->divisor = height * one;
    edge->sample = (int64_t)-divide_down(-numerator, edge->divisor);
    edge->rest = edge->sample * edge->divisor - numerator;
    edge->step = (int64_t)divide_down(width, height);
    edge->step_rest = width * one - edge->step * edge->divisor;
}

/* Moves an edge to the next row. */
static void edge_step(struct raster_edge *edge)
{
    edge->sample += edge->step;
    edge->rest -= edge->step_rest;
    if (edge->rest < 0) {
        edge->sample++;
        edge->rest += edge->divisor;
    }
}

static void swap_corners(struct raster_triangle *t, int a, int b)
{
    int64_t x = t->x[a], y = t->y[a];
    t->x[a] = t->x[b];
    t->y[a] = t->y[b];
    t->x[b] = x;
    t->y[b] = y;
}

static uint32_t clamp_row(uint32_t row, const struct raster_window *window)
{
    return row < window->begin_y ? window->begin_y : row > window->end_y ? window->end_y : row;
}

void bake_raster_spans_begin(const struct sample_grid *grid, const struct raster_triangle *triangle,
                             struct raster_window window, struct raster_spans *out)
{
    struct raster_triangle *t = &out->corners;

    out->window = window;
    out->corners = *triangle;
    out->shift = grid->shift;
    if (t->y[0] > t->y[1])
        swap_corners(t, 0, 1);
    if (t->y[1] > t->y[2])
        swap_corners(t, 1, 2);
    if (t->y[0] > t->y[1])
        swap_corners(t, 0, 1);
    out->short_is_right = double_area(t) > 0;
    out->row = clamp_row(first_sample(grid, t->y[0], grid->rows), &window);
    out->middle_row = clamp_row(first_sample(grid, t->y[1], grid->rows), &window);
    out->end_row = clamp_row(first_sample(grid, t->y[2], grid->rows), &window);
    if (out->row < out->end_row)
        edge_begin(&out->long_edge, out, 0, 2, out->row);
    if (out->row < out->middle_row)
        edge_begin(&out->short_edge, out, 0, 1, out->row);
}

bool bake_raster_spans_next(struct raster_spans *spans, uint32_t *row, uint32_t *begin,
                            uint32_t *end)
{
    const struct raster_window *window = &spans->window;

    while (spans->row < spans->end_row) {
        if (spans->row == spans->middle_row)
            edge_begin(&spans->short_edge, spans, 1, 2, spans->row);
        const int64_t long_sample = spans->long_edge.sample,
                      short_sample = spans->short_edge.sample;
        const int64_t left = spans->short_is_right ? long_sample : short_sample;
        const int64_t right = spans->short_is_right ? short_sample : long_sample;
        *row = spans->row++;
        *begin = left > window->begin_x ? (uint32_t)(left < window->end_x ? left : window->end_x)
                                        : window->begin_x;
        *end = right < window->end_x ? (uint32_t)(right > window->begin_x ? right : window->begin_x)
                                     : window->end_x;
        edge_step(&spans->long_edge);
        edge_step(&spans->short_edge);
        if (*begin < *end)
            return true;
    }
    return false;
}
