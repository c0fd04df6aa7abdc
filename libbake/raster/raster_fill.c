/* raster_fill.c - finds the triangle of each sample of a tile.
 *
 * The first triangle in the order of the mesh takes a sample. Painting only detects whether any
 * samples overlap. A second pass counts them, for the few tiles that have some: it needs a mark for
 * each sample. */
#include "libbake/raster/raster_index.h"

#include <string.h>

/* ---- tiles ---- */

uint32_t bake_raster_tile_count(const struct bake_raster *raster)
{
    return raster->tile_count;
}

struct bk_tile bake_raster_tile(const struct bake_raster *raster, uint32_t index)
{
    const struct bake_raster_options *o = &raster->options;
    const uint32_t number = raster->tile_numbers[index];
    const uint32_t x = number % raster->tile_columns * o->tile_size;
    const uint32_t y = number / raster->tile_columns * o->tile_size;
    struct bk_tile tile = {.x = x, .y = y};

    tile.width = o->width - x < o->tile_size ? o->width - x : o->tile_size;
    tile.height = o->height - y < o->tile_size ? o->height - y : o->tile_size;
    return tile;
}

static struct raster_window tile_window(const struct bake_raster *raster, uint32_t index)
{
    const struct bk_tile tile = bake_raster_tile(raster, index);
    const uint32_t n = raster->options.samples;
    return (struct raster_window){tile.x * n, tile.y * n, (tile.x + tile.width) * n,
                                  (tile.y + tile.height) * n};
}

/* Gives the free samples of a span to a triangle. Returns the number of those that are not free. */
static uint32_t paint_span(uint32_t *samples, uint32_t count, uint32_t triangle)
{
    uint32_t taken = 0;

    for (uint32_t i = 0; i < count; i++) {
        uint32_t owner = samples[i];
        taken += owner != BK_NO_TRIANGLE;
        samples[i] = owner == BK_NO_TRIANGLE ? triangle : owner;
    }
    return taken;
}

/* Paints the triangles of a tile in the order of the mesh. Returns whether any samples overlap. */
static bool paint_tile(const struct bake_raster *raster, uint32_t index, uint32_t *samples)
{
    const struct raster_window window = tile_window(raster, index);
    const uint64_t stride = window.end_x - window.begin_x;
    struct raster_triangle snapped;
    struct raster_spans spans;
    uint32_t row, begin, end;
    bool overlap = false;

    for (uint64_t k = raster->starts[index]; k < raster->starts[index + 1]; k++) {
        if (!raster_snap_triangle(raster, raster->triangles[k], &snapped))
            continue;
        bake_raster_spans_begin(&raster->grid, &snapped, window, &spans);
        while (bake_raster_spans_next(&spans, &row, &begin, &end)) {
            uint32_t *first = samples + (row - window.begin_y) * stride + (begin - window.begin_x);
            overlap |= paint_span(first, end - begin, raster->triangles[k]) > 0;
        }
    }
    return overlap;
}

/* ---- overlaps ---- */

#define MARK_SIDE 256 /* samples; their marks, one bit each, fit 8 KiB */

/* Counts the samples of a painted tile that lie inside more than one triangle: those inside a
 * triangle that does not own them. The window has at most MARK_SIDE x MARK_SIDE samples. */
static uint64_t count_overlaps_in(const struct bake_raster *raster, uint32_t index,
                                  const uint32_t *samples, struct raster_window window)
{
    const struct raster_window tile = tile_window(raster, index);
    const uint64_t stride = tile.end_x - tile.begin_x;
    uint64_t marks[MARK_SIDE][MARK_SIDE / 64] = {{0}}, count = 0;
    struct raster_triangle snapped;
    struct raster_spans spans;
    uint32_t row, begin, end;

    for (uint64_t k = raster->starts[index]; k < raster->starts[index + 1]; k++) {
        if (!raster_snap_triangle(raster, raster->triangles[k], &snapped))
            continue;
        bake_raster_spans_begin(&raster->grid, &snapped, window, &spans);
        while (bake_raster_spans_next(&spans, &row, &begin, &end)) {
            const uint32_t *owners = samples + (row - tile.begin_y) * stride;
            uint64_t *bits = marks[row - window.begin_y];
            for (uint32_t x = begin; x < end; x++) {
                uint64_t overlapped = owners[x - tile.begin_x] != raster->triangles[k];
                bits[(x - window.begin_x) / 64] |= overlapped << (x - window.begin_x) % 64;
            }
        }
    }
    for (int y = 0; y < MARK_SIDE; y++) {
        for (int x = 0; x < MARK_SIDE / 64; x++)
            count += (uint64_t)__builtin_popcountll(marks[y][x]);
    }
    return count;
}

static uint64_t count_overlaps(const struct bake_raster *raster, uint32_t index,
                               const uint32_t *samples)
{
    const struct raster_window tile = tile_window(raster, index);
    uint64_t count = 0;

    for (uint32_t y = tile.begin_y; y < tile.end_y; y += MARK_SIDE) {
        for (uint32_t x = tile.begin_x; x < tile.end_x; x += MARK_SIDE) {
            struct raster_window window = {x, y, tile.end_x, tile.end_y};
            if (tile.end_x - x > MARK_SIDE)
                window.end_x = x + MARK_SIDE;
            if (tile.end_y - y > MARK_SIDE)
                window.end_y = y + MARK_SIDE;
            count += count_overlaps_in(raster, index, samples, window);
        }
    }
    return count;
}

void bake_raster_fill(const struct bake_raster *raster, uint32_t index, uint32_t *sample_triangles,
                      uint64_t *overlaps)
{
    const struct raster_window window = tile_window(raster, index);
    const size_t count = (size_t)(window.end_x - window.begin_x) * (window.end_y - window.begin_y);

    memset(sample_triangles, 0xff, count * sizeof(*sample_triangles)); /* BK_NO_TRIANGLE */
    *overlaps = 0;
    if (paint_tile(raster, index, sample_triangles))
        *overlaps = count_overlaps(raster, index, sample_triangles);
}
