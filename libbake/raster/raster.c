/* raster.c - sorts triangles into tiles.
 *
 * One array holds the lists of all tiles, each in the order of the mesh. One pass counts, a second
 * one writes the lists. Snapped triangles are not stored: computing them again costs less than the
 * memory traffic. */
#include "libbake/raster/raster_index.h"

#include <string.h>

/* Samples along a side of the map. Corners are then snapped to 1/16 of the distance of two samples.
 */
#define MAX_SAMPLES_A_SIDE (UINT32_C(1) << 24)

/* Triangles between two checks for an interruption. One triangle may overlap all tiles. */
enum { TRIANGLES_A_CHECK = 64 };

/* ---- lists ---- */

/* Differences and products of floats are exact in double unless their magnitudes are far apart. */
static bool has_uv_area(const float (*uv)[2])
{
    double ax = (double)uv[1][0] - uv[0][0], ay = (double)uv[1][1] - uv[0][1];
    double bx = (double)uv[2][0] - uv[0][0], by = (double)uv[2][1] - uv[0][1];
    return ax * by != ay * bx;
}

/* Finds the range of tiles that the samples of a triangle may lie in. Returns false if it has none.
 */
static bool overlapped_tiles(const struct bake_raster *raster, uint64_t triangle,
                             struct raster_window *tiles)
{
    const uint32_t size = raster->options.tile_size * raster->options.samples;
    struct raster_triangle snapped;

    if (!raster_snap_triangle(raster, triangle, &snapped))
        return false;
    struct raster_window samples = bake_raster_bounds(&raster->grid, &snapped);
    if (samples.begin_x >= samples.end_x || samples.begin_y >= samples.end_y)
        return false;
    *tiles = (struct raster_window){samples.begin_x / size, samples.begin_y / size,
                                    (samples.end_x - 1) / size + 1, (samples.end_y - 1) / size + 1};
    return true;
}

void bake_blocks_to_image(const struct bake_blocks *blocks, uint32_t *x, uint32_t *y)
{
    const uint64_t block = (uint64_t)(*y / blocks->side) * blocks->columns + *x / blocks->side;
    *x %= blocks->side;
    *y = blocks->slots[block] * blocks->side + *y % blocks->side;
}

void bake_blocks_to_map(const struct bake_blocks *blocks, uint32_t *x, uint32_t *y)
{
    const uint64_t count = (uint64_t)blocks->columns * blocks->rows;
    const uint32_t slot = *y / blocks->side;
    uint64_t block = 0;
    while (block < count && blocks->slots[block] != slot)
        block++;
    *x += (uint32_t)(block % blocks->columns) * blocks->side;
    *y = (uint32_t)(block / blocks->columns) * blocks->side + *y % blocks->side;
}

/* Returns whether a tile lies in a block to bake. */
static bool is_selected(const struct bake_raster *raster, uint32_t column, uint32_t row)
{
    const struct bake_blocks *blocks = raster->options.blocks;
    const uint64_t size = raster->options.tile_size;
    if (!blocks)
        return true;
    return blocks->slots[row * size / blocks->side * blocks->columns +
                         column * size / blocks->side] != BAKE_NO_SLOT;
}

static uint64_t triangles_end(const struct bake_raster *raster)
{
    return raster->options.first + raster->options.count;
}

/* Counts the triangles that may have samples in each tile. */
static int count_triangles(const struct bake_raster *raster, uint64_t *counts)
{
    struct raster_window tiles;
    int rc = 0;

    for (uint64_t t = raster->options.first; t < triangles_end(raster) && rc == 0; t++) {
        if (t % TRIANGLES_A_CHECK == 0)
            rc = bsq_check(raster->ctx);
        if (!overlapped_tiles(raster, t, &tiles))
            continue;
        for (uint32_t y = tiles.begin_y; y < tiles.end_y; y++) {
            for (uint32_t x = tiles.begin_x; x < tiles.end_x; x++)
                counts[(uint64_t)y * raster->tile_columns + x] += is_selected(raster, x, y);
        }
    }
    return rc;
}

/* Lists the tiles that have triangles, and turns counts[] into the start of each tile's list. */
static int number_tiles(struct bake_raster *raster, uint64_t *counts)
{
    const uint64_t places = (uint64_t)raster->tile_columns * raster->tile_rows;

    for (uint64_t p = 0; p < places; p++)
        raster->tile_count += counts[p] > 0;
    int rc = bsq_alloc(raster->ctx, "tile numbers", raster->tile_count,
                       sizeof(*raster->tile_numbers), &raster->tile_numbers);
    if (rc == 0)
        rc = bsq_alloc(raster->ctx, "tile lists", (uint64_t)raster->tile_count + 1,
                       sizeof(*raster->starts), &raster->starts);
    if (rc < 0)
        return rc;
    uint64_t sum = 0;
    uint32_t tile = 0;
    for (uint64_t p = 0; p < places; p++) {
        uint64_t count = counts[p];
        counts[p] = sum;
        if (count > 0) {
            raster->tile_numbers[tile] = (uint32_t)p;
            raster->starts[tile++] = sum;
        }
        sum += count;
    }
    raster->starts[tile] = sum;
    return bsq_alloc(raster->ctx, "tile lists", sum, sizeof(*raster->triangles),
                     &raster->triangles);
}

/* Writes the lists. cursors[tile]: index of its next entry. */
static int place_triangles(struct bake_raster *raster, uint64_t *cursors)
{
    struct raster_window tiles;
    int rc = 0;

    for (uint64_t t = raster->options.first; t < triangles_end(raster) && rc == 0; t++) {
        if (t % TRIANGLES_A_CHECK == 0)
            rc = bsq_check(raster->ctx);
        if (!overlapped_tiles(raster, t, &tiles))
            continue;
        for (uint32_t y = tiles.begin_y; y < tiles.end_y; y++) {
            for (uint32_t x = tiles.begin_x; x < tiles.end_x; x++) {
                if (!is_selected(raster, x, y))
                    continue;
                uint64_t *cursor = &cursors[(uint64_t)y * raster->tile_columns + x];
                raster->triangles[(*cursor)++] = (uint32_t)t;
            }
        }
    }
    return rc;
}

static int sort_into_tiles(struct bake_raster *raster)
{
    uint64_t *counts = NULL;

    int rc =
        bsq_calloc(raster->ctx, "tile counts", (uint64_t)raster->tile_columns * raster->tile_rows,
                   sizeof(*counts), &counts);
    if (rc < 0)
        return rc;
    rc = count_triangles(raster, counts);
    if (rc == 0)
        rc = number_tiles(raster, counts);
    if (rc == 0)
        rc = place_triangles(raster, counts);
    bsq_free(raster->ctx, counts);
    return rc;
}

/* ---- creation ---- */

/* Counts triangles without area. */
static void inspect(const struct bake_raster *raster, struct bake_raster_report *report)
{
    struct raster_triangle snapped;

    memset(report, 0, sizeof(*report));
    for (uint64_t t = raster->options.first; t < triangles_end(raster); t++) {
        const float(*uv)[2] = (const float(*)[2])raster->mesh->texcoords[t];
        bool fits = bake_raster_snap(&raster->grid, uv, &snapped);
        if (fits && !(has_uv_area(uv) && bake_raster_has_area(&snapped)))
            report->degenerate_triangles++;
    }
}

static int check_options(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                         const struct bake_raster_options *o)
{
    if (o->width == 0 || o->height == 0 || o->samples == 0 || o->tile_size == 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "a map of %u x %u texels, %u x %u samples each, is empty",
                        o->width, o->height, o->samples, o->samples);
    if ((uint64_t)(o->width > o->height ? o->width : o->height) * o->samples > MAX_SAMPLES_A_SIDE)
        return bsq_fail(
            ctx, BSQ_EUSAGE,
            "a map of %u x %u texels with %u x %u samples each is too large: %u samples "
            "a side are supported",
            o->width, o->height, o->samples, o->samples, MAX_SAMPLES_A_SIDE);
    if (mesh->triangle_count >= BK_NO_TRIANGLE)
        return bsq_fail(ctx, BSQ_EDATA, "low-poly mesh has %llu triangles, %u are supported",
                        (unsigned long long)mesh->triangle_count, BK_NO_TRIANGLE - 1);
    return 0;
}

static int lay_out_tiles(struct bake_raster *raster)
{
    struct bake_raster_options *o = &raster->options;
    const uint32_t longest = o->width > o->height ? o->width : o->height;

    if (o->tile_size > longest)
        o->tile_size = longest;
    raster->tile_columns = (o->width - 1) / o->tile_size + 1;
    raster->tile_rows = (o->height - 1) / o->tile_size + 1;
    if ((uint64_t)raster->tile_columns * raster->tile_rows > UINT32_MAX)
        return bsq_fail(raster->ctx, BSQ_EUSAGE, "tiles of %u texels are too small for %u x %u",
                        o->tile_size, o->width, o->height);
    raster->grid = bake_raster_sample_grid(o->width * o->samples, o->height * o->samples);
    return 0;
}

int bake_raster_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                       const struct bake_raster_options *options, struct bake_raster_report *report,
                       struct bake_raster **out)
{
    struct bake_raster *raster = NULL;

    *out = NULL;
    int rc = check_options(ctx, mesh, options);
    if (rc == 0)
        rc = bsq_calloc(ctx, "raster", 1, sizeof(*raster), &raster);
    if (rc)
        return rc;
    raster->ctx = ctx;
    raster->mesh = mesh;
    raster->options = *options;
    rc = lay_out_tiles(raster);
    if (rc == 0) {
        inspect(raster, report);
        rc = bsq_check(ctx);
        if (rc == 0)
            rc = sort_into_tiles(raster);
    }
    if (rc < 0) {
        bake_raster_free(raster);
        return rc;
    }
    *out = raster;
    return 0;
}

void bake_raster_free(struct bake_raster *raster)
{
    if (raster == NULL)
        return;
    struct bsq_ctx *ctx = raster->ctx;
    bsq_free(ctx, raster->triangles);
    bsq_free(ctx, raster->starts);
    bsq_free(ctx, raster->tile_numbers);
    bsq_free(ctx, raster);
}
