/* raster.c - sorts triangles into patches, and finds the triangle of each sample of a patch.
 *
 * One array holds the lists of all patches, each in the order of the mesh. One pass counts, a
 * second one writes the lists. Snapped triangles are not stored: computing them again costs less
 * than the memory traffic.
 *
 * The first triangle in the order of the mesh takes a sample. Painting only detects whether any
 * samples overlap. A second pass counts them, for the few patches that have some: it needs a mark
 * for each sample. Both stop as soon as no triangle can change the result, so that thousands of
 * triangles over the same texels cost no more than a few. */
#include "libbake/raster/raster_internal.h"

#include <string.h>

/* Samples along a side of the map. Corners are then snapped to 1/16 of the distance of two samples.
 */
#define MAX_SAMPLES_A_SIDE (UINT32_C(1) << 24)

/* Triangles between two checks for an interruption. One triangle may overlap all patches. */
enum { TRIANGLES_A_CHECK = 64 };

/* ---- lists ---- */

/* Differences and products of floats are exact in double unless their magnitudes are far apart. */
static bool has_uv_area(const float (*uv)[2])
{
    double ax = (double)uv[1][0] - uv[0][0], ay = (double)uv[1][1] - uv[0][1];
    double bx = (double)uv[2][0] - uv[0][0], by = (double)uv[2][1] - uv[0][1];
    return ax * by != ay * bx;
}

/* Finds the range of patches that the samples of a triangle may lie in. Returns false if it has
 * none.
 */
static bool overlapped_patches(const struct bake_raster *raster, uint64_t triangle,
                               struct raster_window *patches)
{
    const uint32_t size = raster->options.patch_side * raster->options.samples;
    struct raster_triangle snapped;

    if (!raster_snap_triangle(raster, triangle, &snapped))
        return false;
    struct raster_window samples = bake_raster_bounds(&raster->grid, &snapped);
    if (samples.begin_x >= samples.end_x || samples.begin_y >= samples.end_y)
        return false;
    *patches =
        (struct raster_window){samples.begin_x / size, samples.begin_y / size,
                               (samples.end_x - 1) / size + 1, (samples.end_y - 1) / size + 1};
    return true;
}

void bake_blocks_to_image(const struct bake_blocks *blocks, uint32_t *x, uint32_t *y)
{
    const uint64_t block = (uint64_t)(*y / blocks->side) * blocks->columns + *x / blocks->side;
    *x %= blocks->side;
    *y = blocks->slots[block] * blocks->side + *y % blocks->side;
}

/* Returns whether a patch lies in a block to bake. */
static bool is_selected(const struct bake_raster *raster, uint32_t column, uint32_t row)
{
    const struct bake_blocks *blocks = raster->options.blocks;
    const uint64_t size = raster->options.patch_side;
    if (!blocks)
        return true;
    return blocks->slots[row * size / blocks->side * blocks->columns +
                         column * size / blocks->side] != BAKE_NO_SLOT;
}

static uint64_t triangles_end(const struct bake_raster *raster)
{
    return raster->options.first + raster->options.count;
}

/* Counts the triangles that may have samples in each patch or, after number_patches(), writes the
 * lists. cursors[patch]: the count, or the index of the next entry of its list. */
static int sort_triangles(struct bake_raster *raster, uint64_t *cursors)
{
    struct raster_window patches;
    int status = 0;

    for (uint64_t t = raster->options.first; t < triangles_end(raster); t++) {
        if (t % TRIANGLES_A_CHECK == 0)
            BSQ_TRY(bsq_check(raster->ctx));
        if (!overlapped_patches(raster, t, &patches))
            continue;
        for (uint32_t y = patches.begin_y; y < patches.end_y; y++)
            for (uint32_t x = patches.begin_x; x < patches.end_x; x++) {
                if (!is_selected(raster, x, y))
                    continue;
                const uint64_t entry = cursors[(uint64_t)y * raster->patch_columns + x]++;
                if (raster->triangles)
                    raster->triangles[entry] = (uint32_t)t;
            }
    }
done:
    return status;
}

/* Lists the patches that have triangles, and turns counts[] into the start of each patch's list. */
static int number_patches(struct bake_raster *raster, uint64_t *counts)
{
    const uint64_t places = (uint64_t)raster->patch_columns * raster->patch_rows;
    uint64_t sum = 0;
    uint32_t patch = 0;
    int status;

    for (uint64_t p = 0; p < places; p++)
        raster->patch_count += counts[p] > 0;
    BSQ_TRY(bsq_alloc(raster->ctx, "patch numbers", raster->patch_count,
                      sizeof *raster->patch_numbers, &raster->patch_numbers));
    BSQ_TRY(bsq_alloc(raster->ctx, "patch lists", (uint64_t)raster->patch_count + 1,
                      sizeof *raster->starts, &raster->starts));
    for (uint64_t p = 0; p < places; p++) {
        uint64_t count = counts[p];
        counts[p] = sum;
        if (count > 0) {
            raster->patch_numbers[patch] = (uint32_t)p;
            raster->starts[patch++] = sum;
        }
        sum += count;
    }
    raster->starts[patch] = sum;
    status =
        bsq_alloc(raster->ctx, "patch lists", sum, sizeof *raster->triangles, &raster->triangles);
done:
    return status;
}

static int sort_into_patches(struct bake_raster *raster)
{
    uint64_t *counts = NULL;
    int status;

    BSQ_TRY(bsq_calloc(raster->ctx, "patch counts",
                       (uint64_t)raster->patch_columns * raster->patch_rows, sizeof *counts,
                       &counts));
    BSQ_TRY(sort_triangles(raster, counts));
    BSQ_TRY(number_patches(raster, counts));
    status = raster->patch_count > 0 ? sort_triangles(raster, counts) : 0;
done:
    bsq_free(raster->ctx, counts);
    return status;
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
    if (o->width == 0 || o->height == 0 || o->samples == 0 || o->patch_side == 0)
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

static int lay_out_patches(struct bake_raster *raster)
{
    struct bake_raster_options *o = &raster->options;
    const uint32_t longest = o->width > o->height ? o->width : o->height;

    if (o->patch_side > longest)
        o->patch_side = longest;
    raster->patch_columns = (o->width - 1) / o->patch_side + 1;
    raster->patch_rows = (o->height - 1) / o->patch_side + 1;
    if ((uint64_t)raster->patch_columns * raster->patch_rows > UINT32_MAX)
        return bsq_fail(raster->ctx, BSQ_EUSAGE, "patches of %u texels are too small for %u x %u",
                        o->patch_side, o->width, o->height);
    raster->grid = bake_raster_sample_grid(o->width * o->samples, o->height * o->samples);
    return 0;
}

int bake_raster_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                       const struct bake_raster_options *options, struct bake_raster_report *report,
                       struct bake_raster **out)
{
    struct bake_raster *raster = NULL;
    int status;

    *out = NULL;
    BSQ_TRY(check_options(ctx, mesh, options));
    BSQ_TRY(bsq_calloc(ctx, "raster", 1, sizeof *raster, &raster));
    raster->ctx = ctx;
    raster->mesh = mesh;
    raster->options = *options;
    BSQ_TRY(lay_out_patches(raster));
    inspect(raster, report);
    BSQ_TRY(bsq_check(ctx));
    BSQ_TRY(sort_into_patches(raster));
    *out = raster;
    raster = NULL;
done:
    bake_raster_free(raster);
    return status;
}

void bake_raster_free(struct bake_raster *raster)
{
    if (raster == NULL)
        return;
    struct bsq_ctx *ctx = raster->ctx;
    bsq_free(ctx, raster->triangles);
    bsq_free(ctx, raster->starts);
    bsq_free(ctx, raster->patch_numbers);
    bsq_free(ctx, raster);
}

/* ---- patches ---- */

uint32_t bake_raster_patch_count(const struct bake_raster *raster)
{
    return raster->patch_count;
}

struct bk_patch bake_raster_patch(const struct bake_raster *raster, uint32_t index)
{
    const struct bake_raster_options *o = &raster->options;
    const uint32_t number = raster->patch_numbers[index];
    const uint32_t x = number % raster->patch_columns * o->patch_side;
    const uint32_t y = number / raster->patch_columns * o->patch_side;
    struct bk_patch patch = {.x = x, .y = y};

    patch.width = o->width - x < o->patch_side ? o->width - x : o->patch_side;
    patch.height = o->height - y < o->patch_side ? o->height - y : o->patch_side;
    return patch;
}

static struct raster_window patch_window(const struct bake_raster *raster, uint32_t index)
{
    const struct bk_patch patch = bake_raster_patch(raster, index);
    const uint32_t n = raster->options.samples;
    return (struct raster_window){patch.x * n, patch.y * n, (patch.x + patch.width) * n,
                                  (patch.y + patch.height) * n};
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

/* Paints the triangles of a patch in the order of the mesh. Sets *overlap if any samples overlap.
 */
static int paint_patch(const struct bake_raster *raster, uint32_t index, uint32_t *samples,
                       bool *overlap)
{
    const struct raster_window window = patch_window(raster, index);
    const uint64_t stride = window.end_x - window.begin_x;
    struct raster_triangle snapped;
    struct raster_spans spans;
    uint64_t free = stride * (window.end_y - window.begin_y);
    uint32_t row, begin, end;
    int status = 0;

    *overlap = false;
    for (uint64_t k = raster->starts[index];
         k < raster->starts[index + 1] && !(free == 0 && *overlap); k++) {
        BSQ_TRY(bsq_check(raster->ctx));
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
done:
    return status;
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

/* Adds to *count the samples of a painted patch that lie inside more than one triangle: those
 * inside a triangle that does not own them. The window has at most MARK_SIDE x MARK_SIDE samples.
 */
static int count_overlaps_in(const struct bake_raster *raster, uint32_t index,
                             const uint32_t *samples, struct raster_window window, uint64_t *count)
{
    const struct raster_window patch = patch_window(raster, index);
    const uint64_t stride = patch.end_x - patch.begin_x;
    uint64_t marks[MARK_SIDE][MARK_SIDE / 64] = {{0}};
    uint64_t unmarked = (uint64_t)(window.end_x - window.begin_x) * (window.end_y - window.begin_y);
    struct raster_triangle snapped;
    struct raster_spans spans;
    uint32_t row, begin, end;
    int status = 0;

    for (uint64_t k = raster->starts[index]; k < raster->starts[index + 1] && unmarked > 0; k++) {
        BSQ_TRY(bsq_check(raster->ctx));
        if (!raster_snap_triangle(raster, raster->triangles[k], &snapped))
            continue;
        bake_raster_spans_begin(&raster->grid, &snapped, window, &spans);
        while (bake_raster_spans_next(&spans, &row, &begin, &end)) {
            const uint32_t *owners = samples + (row - patch.begin_y) * stride;
            uint32_t added =
                mark_span(owners + (window.begin_x - patch.begin_x), marks[row - window.begin_y],
                          begin - window.begin_x, end - window.begin_x, raster->triangles[k]);
            unmarked -= added;
            *count += added;
        }
    }
done:
    return status;
}

static int count_overlaps(const struct bake_raster *raster, uint32_t index, const uint32_t *samples,
                          uint64_t *count)
{
    const struct raster_window patch = patch_window(raster, index);
    int status = 0;

    for (uint32_t y = patch.begin_y; y < patch.end_y; y += MARK_SIDE)
        for (uint32_t x = patch.begin_x; x < patch.end_x; x += MARK_SIDE) {
            struct raster_window window = {x, y, patch.end_x, patch.end_y};
            if (patch.end_x - x > MARK_SIDE)
                window.end_x = x + MARK_SIDE;
            if (patch.end_y - y > MARK_SIDE)
                window.end_y = y + MARK_SIDE;
            BSQ_TRY(count_overlaps_in(raster, index, samples, window, count));
        }
done:
    return status;
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
    const struct raster_window window = patch_window(raster, index);
    const size_t count = (size_t)(window.end_x - window.begin_x) * (window.end_y - window.begin_y);

    bool overlap;
    int status;

    memset(sample_triangles, 0xff, count * sizeof *sample_triangles); /* BK_NO_TRIANGLE */
    *overlaps = 0;
    BSQ_TRY(paint_patch(raster, index, sample_triangles, &overlap));
    if (overlap)
        BSQ_TRY(count_overlaps(raster, index, sample_triangles, overlaps));
    if (raster->options.skew.skew)
        status = fill_skews(raster, &window, sample_triangles, sample_triangles + count);
done:
    return status;
}
