/* raster.c - sorts triangles into patches, and finds the triangle of each sample of a patch.
 *
 * One array holds the lists of all patches, each in the order of the mesh. One pass counts, a
 * second one writes the lists. Snapped triangles are not stored: computing them again costs less
 * than the memory traffic.
 *
 * The first triangle in the order of the mesh takes a sample, and the next one there marks it. This
 * stops as soon as all samples are marked, so that thousands of triangles over the same texels cost
 * no more than a few. */
#include "libbake/raster/raster_internal.h"

#include <math.h>
#include <string.h>

/* Samples along a side of the map. Corners are then snapped to 1/16 of the distance of two samples.
 */
#define MAX_SAMPLES_A_SIDE (UINT32_C(1) << 24)

/* Of a sample that is in several triangles: added to the number of its own. */
#define OVERLAPPED (UINT32_C(1) << 31)

/* Triangles between two checks for an interruption. One triangle may overlap all patches. */
enum { TRIANGLES_A_CHECK = 64 };

/* ---- spans ----
 *
 * Each edge crosses the centre line of a row at a rational x. A division that rounds upwards gives
 * the first sample at or right of it. A span reaches from the left edge's sample to the right
 * edge's, exclusive, and rows are half open in the same way: this is the top-left rule. Two
 * triangles that share an edge compute the same rational from it, so each sample along the edge
 * belongs to exactly one of them.
 *
 * Numerators are products of two coordinates. They do not overflow 128 bits, even for triangles
 * that extend far beyond the map. */

/* Corners inside the map are below 2^28 steps; a step is at least 2^-16 samples. */
#define MAP_BITS  28
#define MAX_SHIFT 16
/* Largest coordinate in steps: sums and products of differences stay well below 128 bits. */
#define MAX_COORDINATE 0x1p60

/* Returns the grid of a map with columns x rows samples. Large maps get fewer fractional bits. */
static struct sample_grid sample_grid_of(uint32_t columns, uint32_t rows)
{
    uint32_t longest = columns > rows ? columns : rows;
    unsigned shift = MAX_SHIFT;
    while (shift > 0 && ((uint64_t)longest << shift) > (uint64_t)1 << MAP_BITS)
        shift--;
    return (struct sample_grid){.columns = columns, .rows = rows, .shift = shift};
}

/* Snaps texture coordinates (v upwards) to the grid. Returns false if they are not finite or about
 * 2^32 maps or more away. */
static bool snap(const struct sample_grid *grid, const float (*texcoords)[2],
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

static bool has_area(const struct raster_triangle *triangle)
{
    return double_area(triangle) != 0;
}

bool bake_raster_snap(const struct bake_raster *raster, uint64_t triangle,
                      struct raster_triangle *out)
{
    return snap(&raster->grid, (const float(*)[2])raster->mesh->texcoords[triangle], out) &&
           has_area(out);
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

/* Returns the first sample at or right of the edge from corner a down to corner b, in a row whose
 * centre lies between them. */
static int64_t sample_at_edge(const struct sample_grid *grid, const struct raster_triangle *t,
                              int a, int b, int64_t centre)
{
    const int64_t one = (int64_t)1 << grid->shift;
    const __int128 height = t->y[b] - t->y[a], width = t->x[b] - t->x[a];
    const __int128 numerator = (t->x[a] - one / 2) * height + width * (centre - t->y[a]);
    return (int64_t)-divide_down(-numerator, height * one);
}

/* Finds the samples of a triangle in a row of a window, begin <= x < end. A sample belongs to the
 * triangle if its centre is inside, or on a top or left edge: two triangles that share an edge
 * share no sample and leave none out. Returns false if there are none. */
static bool find_span(const struct sample_grid *grid, const struct raster_triangle *t,
                      const struct raster_window *window, uint32_t row, uint32_t *begin,
                      uint32_t *end)
{
    const int64_t one = (int64_t)1 << grid->shift, centre = row * one + one / 2;
    int64_t left = INT64_MAX, right = INT64_MIN;
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, a = t->y[i] <= t->y[j] ? i : j, b = a == i ? j : i;
        if (centre < t->y[a] || centre >= t->y[b])
            continue;
        const int64_t sample = sample_at_edge(grid, t, a, b, centre);
        left = sample < left ? sample : left;
        right = sample > right ? sample : right;
    }
    *begin = left > window->begin_x ? (uint32_t)(left < window->end_x ? left : window->end_x)
                                    : window->begin_x;
    *end = right < window->end_x ? (uint32_t)(right > window->begin_x ? right : window->begin_x)
                                 : window->end_x;
    return *begin < *end;
}

/* Returns the part of a window with the rows that a triangle may have samples in. */
static struct raster_window raster_rows(const struct sample_grid *grid,
                                        const struct raster_triangle *t,
                                        struct raster_window window)
{
    const struct raster_window bounds = bake_raster_bounds(grid, t);
    if (bounds.begin_y > window.begin_y)
        window.begin_y = bounds.begin_y;
    if (bounds.end_y < window.end_y)
        window.end_y = bounds.end_y;
    return window;
}

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
    if (!bake_raster_snap(raster, triangle, &snapped))
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
    *y = blocks->places[block] * blocks->side + *y % blocks->side;
}

/* Returns whether a patch lies in a block to bake. */
static bool is_selected(const struct bake_raster *raster, uint32_t column, uint32_t row)
{
    const struct bake_blocks *blocks = raster->options.blocks;
    const uint64_t size = raster->options.patch_side;
    if (!blocks)
        return true;
    return blocks->places[row * size / blocks->side * blocks->columns +
                          column * size / blocks->side] != BAKE_NO_PLACE;
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
    for (uint64_t t = raster->options.first; t < triangles_end(raster); t++) {
        if (t % TRIANGLES_A_CHECK == 0)
            BSQ_PASS(bsq_check(raster->ctx));
        if (!overlapped_patches(raster, t, &patches))
            continue;
        for (uint32_t y = patches.begin_y; y < patches.end_y; y++) {
            BSQ_PASS(bsq_check(raster->ctx)); /* first entries touch all memory of the lists */
            for (uint32_t x = patches.begin_x; x < patches.end_x; x++) {
                if (!is_selected(raster, x, y))
                    continue;
                const uint64_t entry = cursors[(uint64_t)y * raster->patch_columns + x]++;
                if (raster->triangles)
                    raster->triangles[entry] = (uint32_t)t;
            }
        }
    }
    return 0;
}

/* Fails because triangles cover so much of the map that their lists do not fit. */
static int fail_lists(const struct bake_raster *raster, uint64_t entries)
{
    const uint64_t mib = 1 << 20, bytes = entries * sizeof *raster->triangles;
    return bsq_fail(raster->ctx, BSQ_ENOMEM,
                    "the memory budget is too small: low-poly triangles cover each other on the "
                    "map, on average %.0f in each patch of %u x %u texels; lists of them need %llu "
                    "MiB, %llu MiB are left: a smaller --size needs less",
                    (double)entries / raster->patch_count, raster->options.patch_side,
                    raster->options.patch_side, (unsigned long long)(bytes / mib + 1),
                    (unsigned long long)(bsq_memory_left(raster->ctx) / mib));
}

/* Lists the patches that have triangles, and turns counts[] into the start of each patch's list. */
static int number_patches(struct bake_raster *raster, uint64_t *counts)
{
    const uint64_t places = (uint64_t)raster->patch_columns * raster->patch_rows;
    uint64_t sum = 0;
    uint32_t patch = 0;
    for (uint64_t p = 0; p < places; p++)
        raster->patch_count += counts[p] > 0;
    BSQ_PASS(BSQ_ALLOC(raster->ctx, "patch numbers", raster->patch_count, &raster->patch_numbers));
    BSQ_PASS(
        BSQ_ALLOC(raster->ctx, "patch lists", (uint64_t)raster->patch_count + 1, &raster->starts));
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
    if (sum > bsq_memory_left(raster->ctx) / sizeof *raster->triangles)
        BSQ_PASS(fail_lists(raster, sum));
    return BSQ_ALLOC(raster->ctx, "patch lists", sum, &raster->triangles);
}

static int sort_into_patches(struct bake_raster *raster)
{
    uint64_t *counts = NULL;
    int status;
    BSQ_TRY(BSQ_CALLOC(raster->ctx, "patch counts",
                       (uint64_t)raster->patch_columns * raster->patch_rows, &counts));
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
        bool fits = snap(&raster->grid, uv, &snapped);
        if (fits && !(has_uv_area(uv) && has_area(&snapped)))
            report->degenerate_triangles++;
    }
}

static int raster_check_options(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
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
    if (mesh->triangle_count >= OVERLAPPED)
        return bsq_fail(ctx, BSQ_EDATA, "low-poly mesh has %llu triangles, %u are supported",
                        (unsigned long long)mesh->triangle_count, OVERLAPPED - 1);
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
    raster->grid = sample_grid_of(o->width * o->samples, o->height * o->samples);
    return 0;
}

int bake_raster_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                       const struct bake_raster_options *options, struct bake_raster_report *report,
                       struct bake_raster **out)
{
    struct bake_raster *raster = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(raster_check_options(ctx, mesh, options));
    BSQ_TRY(BSQ_CALLOC(ctx, "raster", 1, &raster));
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
    BSQ_FREE(ctx, raster->triangles, raster->starts, raster->patch_numbers, raster);
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

/* Gives the free samples of a span to a triangle, and marks the others. Returns how many were not
 * marked before. */
static uint32_t paint_span(uint32_t *samples, uint32_t count, uint32_t triangle)
{
    uint32_t marked = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t owner = samples[i];
        marked += !(owner & OVERLAPPED);
        samples[i] = owner == BK_NO_TRIANGLE ? triangle : owner | OVERLAPPED;
    }
    return marked;
}

/* Paints the triangles of a patch in the order of the mesh. *overlaps: how many samples are marked.
 */
static int paint_patch(const struct bake_raster *raster, uint32_t index, uint32_t *samples,
                       uint64_t *overlaps)
{
    const struct raster_window window = patch_window(raster, index);
    const uint64_t stride = window.end_x - window.begin_x;
    const uint64_t count = stride * (window.end_y - window.begin_y);
    struct raster_triangle snapped;
    uint32_t begin, end;
    *overlaps = 0;
    for (uint64_t k = raster->starts[index]; k < raster->starts[index + 1] && *overlaps < count;
         k++) {
        BSQ_PASS(bsq_check(raster->ctx));
        if (!bake_raster_snap(raster, raster->triangles[k], &snapped))
            continue;
        const struct raster_window rows = raster_rows(&raster->grid, &snapped, window);
        for (uint32_t row = rows.begin_y; row < rows.end_y; row++)
            if (find_span(&raster->grid, &snapped, &rows, row, &begin, &end))
                *overlaps +=
                    paint_span(samples + (row - window.begin_y) * stride + (begin - window.begin_x),
                               end - begin, raster->triangles[k]);
    }
    return 0;
}

/* ---- skews ---- */

/* Sets *out to the mean of the first channel over a box around (u, v) in the tile, with v upwards
 * and sides du and dv: from 0 to BK_SKEW_ONE. */
static int sample_skew(const struct bake_raster_options *o, float u, float v, float du, float dv,
                       uint32_t *out)
{
    static const uint8_t wrap[2] = {FMT_WRAP_CLAMP, FMT_WRAP_CLAMP};
    float rgb[3];
    const int status = fmt_texture_sample(o->skew, o->skew_number, wrap, u, v, du, dv, rgb);
    const float value = rgb[0] > 0 ? fminf(rgb[0], 1.0F) : 0; /* not a number: 0 */
    *out = status == 0 ? (uint32_t)(value * (float)BK_SKEW_ONE + 0.5F) : 0;
    return status;
}

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
            status = sample_skew(o, x * du, 1.0F - y * dv, du, dv, &skews[i]);
    }
    return status;
}

int bake_raster_fill(const struct bake_raster *raster, uint32_t index, uint32_t *sample_triangles,
                     uint64_t *overlaps)
{
    const struct raster_window window = patch_window(raster, index);
    const size_t count = (size_t)(window.end_x - window.begin_x) * (window.end_y - window.begin_y);
    memset(sample_triangles, 0xff, count * sizeof *sample_triangles); /* BK_NO_TRIANGLE */
    BSQ_PASS(paint_patch(raster, index, sample_triangles, overlaps));
    for (size_t i = 0; i<count && * overlaps> 0; i++)
        if (sample_triangles[i] != BK_NO_TRIANGLE)
            sample_triangles[i] &= ~OVERLAPPED;
    if (raster->options.skew)
        return fill_skews(raster, &window, sample_triangles, sample_triangles + count);
    return 0;
}
