/* raster_fill.c - finds the triangle of each sample of a tile.
 *
 * The first triangle in the order of the mesh takes a sample. Painting only detects whether any
 * samples overlap. A second pass counts them, for the few tiles that have some: it needs a mark for
 * each sample. Both stop as soon as no triangle can change the result, so that thousands of
 * triangles over the same texels cost no more than a few. */
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

/* Paints the triangles of a tile in the order of the mesh. Sets *overlap if any samples overlap. */
static int paint_tile(const struct bake_raster *raster, uint32_t index, uint32_t *samples,
                      bool *overlap)
{
    const struct raster_window window = tile_window(raster, index);
    const uint64_t stride = window.end_x - window.begin_x;
    struct raster_triangle snapped;
    struct raster_spans spans;
    uint64_t free = stride * (window.end_y - window.begin_y);
    uint32_t row, begin, end;
    int rc = 0;

    *overlap = false;
    for (uint64_t k = raster->starts[index];
         k < raster->starts[index + 1] && !(free == 0 && *overlap) && rc == 0; k++) {
        rc = bsq_check(raster->ctx);
        if (!raster_snap_triangle(raster, raster->triangles[k], &snapped))
            continue;
        bake_raster_spans_begin(&raster->grid, &snapped, window, &spans);
        while (bake_raster_spans_next(&spans, &row, &begin, &end)) {
            uint32_t *first = samples + (row - window.begin_y) * stride + (begin - window.begin_x);
            uint32_t taken = paint_span(first, end - begin, raster->triangles[k]);
            free -= end - begin - taken;
            *overlap |= taken > 0;
        }
    }
    return rc;
}

/* ---- overlaps ---- */

#define MARK_SIDE 256 /* samples; their marks, one bit each, fit 8 KiB */

/* Marks the samples x, begin <= x < end, that another triangle owns. Returns how many were not
 * marked before. */
static uint32_t mark_span(const uint32_t *owners, uint64_t *bits, uint32_t begin, uint32_t end,
                          uint32_t triangle)
{
    uint32_t count = 0;

    for (uint32_t x = begin; x < end; x++) {
        const uint64_t overlapped = owners[x] != triangle, unmarked = ~bits[x / 64] >> x % 64;
        bits[x / 64] |= overlapped << x % 64;
        count += (uint32_t)(overlapped & unmarked);
    }
    return count;
}

/* Adds to *count the samples of a painted tile that lie inside more than one triangle: those inside
 * a triangle that does not own them. The window has at most MARK_SIDE x MARK_SIDE samples. */
static int count_overlaps_in(const struct bake_raster *raster, uint32_t index,
                             const uint32_t *samples, struct raster_window window, uint64_t *count)
{
    const struct raster_window tile = tile_window(raster, index);
    const uint64_t stride = tile.end_x - tile.begin_x;
    uint64_t marks[MARK_SIDE][MARK_SIDE / 64] = {{0}};
    uint64_t unmarked = (uint64_t)(window.end_x - window.begin_x) * (window.end_y - window.begin_y);
    struct raster_triangle snapped;
    struct raster_spans spans;
    uint32_t row, begin, end;
    int rc = 0;

    for (uint64_t k = raster->starts[index];
         k < raster->starts[index + 1] && unmarked > 0 && rc == 0; k++) {
        rc = bsq_check(raster->ctx);
        if (!raster_snap_triangle(raster, raster->triangles[k], &snapped))
            continue;
        bake_raster_spans_begin(&raster->grid, &snapped, window, &spans);
        while (bake_raster_spans_next(&spans, &row, &begin, &end)) {
            const uint32_t *owners = samples + (row - tile.begin_y) * stride;
            uint32_t added =
                mark_span(owners + (window.begin_x - tile.begin_x), marks[row - window.begin_y],
                          begin - window.begin_x, end - window.begin_x, raster->triangles[k]);
            unmarked -= added;
            *count += added;
        }
    }
    return rc;
}

static int count_overlaps(const struct bake_raster *raster, uint32_t index, const uint32_t *samples,
                          uint64_t *count)
{
    const struct raster_window tile = tile_window(raster, index);
    int rc = 0;

    for (uint32_t y = tile.begin_y; y < tile.end_y && rc == 0; y += MARK_SIDE) {
        for (uint32_t x = tile.begin_x; x < tile.end_x && rc == 0; x += MARK_SIDE) {
            struct raster_window window = {x, y, tile.end_x, tile.end_y};
            if (tile.end_x - x > MARK_SIDE)
                window.end_x = x + MARK_SIDE;
            if (tile.end_y - y > MARK_SIDE)
                window.end_y = y + MARK_SIDE;
            rc = count_overlaps_in(raster, index, samples, window, count);
        }
    }
    return rc;
}

/* ---- skews ---- */

/* Writes the skews of the samples that have triangles. */
static int fill_skews(const struct bake_raster *raster, const struct raster_window *window,
                      const uint32_t *samples, uint32_t *skews)
{
    const struct bake_raster_options *o = &raster->options;
    const float du = 1.0F / (float)(o->width * o->samples);
    const float dv = 1.0F / (float)(o->height * o->samples);
    const uint32_t columns = window->end_x - window->begin_x;
    const size_t count = (size_t)columns * (window->end_y - window->begin_y);
    int status = 0;
    for (size_t i = 0; i < count && status == 0; i++) {
        const float x = (float)(window->begin_x + (uint32_t)(i % columns)) + 0.5F;
        const float y = (float)(window->begin_y + (uint32_t)(i / columns)) + 0.5F;
        skews[i] = 0;
        if (samples[i] != BK_NO_TRIANGLE)
            status = bake_skew_sample(&o->skew, x * du, 1.0F - y * dv, du, dv, &skews[i]);
    }
    return status;
}

int bake_raster_fill(const struct bake_raster *raster, uint32_t index, uint32_t *sample_triangles,
                     uint64_t *overlaps)
{
    const struct raster_window window = tile_window(raster, index);
    const size_t count = (size_t)(window.end_x - window.begin_x) * (window.end_y - window.begin_y);

    memset(sample_triangles, 0xff, count * sizeof(*sample_triangles)); /* BK_NO_TRIANGLE */
    *overlaps = 0;
    bool overlap;
    int rc = paint_tile(raster, index, sample_triangles, &overlap);
    if (rc == 0 && overlap)
        rc = count_overlaps(raster, index, sample_triangles, overlaps);
    if (rc == 0 && raster->options.skew.skew)
        rc = fill_skews(raster, &window, sample_triangles, sample_triangles + count);
    return rc;
}
