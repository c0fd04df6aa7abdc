/* filter.c - weighted means over texels that are near each other on the scan.
 *
 * The weight of a texel at the distance d falls as (1 - d^2 / r^2)^2, the biweight kernel. It also
 * falls with the angle between the normals, and with the distance from the plane of the other one,
 * so that edges stay and opposite sheets keep apart (cross-bilateral filtering: Eisemann & Durand,
 * "Flash photography enhancement via intrinsic relighting", 2004; with geometry as the guide:
 * McCool, "Anisotropic diffusion for Monte Carlo noise reduction", 1999).
 *
 * Where values differ by more than their noise does, a texel keeps that share of its difference
 * from the mean which is not noise (Lee, "Digital image enhancement and noise filtering by use of
 * local statistics", 1980): relief and contact shadows as fine as texels stay.
 *
 * Texels are sorted into cells of the width of r: into layers along the longest axis of their
 * bounds, and by the other two axes within a layer. Neighbours of a texel are then in nine runs of
 * cells. A window of layers is in memory at a time. */
#include "libbake/filter/filter.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "base/geometry/vec.h"

enum { NORMAL = 3, RESULT = 6, BAND_ROWS = 64, MOST_LAYERS = 1 << 20, MOST_VALUES = 2 };

/* In texels: what counts as near, and how far from the plane of the other one. */
#define RADIUS 3.0
#define DEPTH  0.5

struct point {
    struct bsq_vec3 at, normal;
    float values[MOST_VALUES], results[MOST_VALUES];
    uint64_t cell; /* in its layer */
};

struct work {
    struct bsq_ctx *ctx;
    const struct bake_filter *filter;
    uint32_t width, channels;
    int axis;     /* of the layers */
    float low[3]; /* the least corner of the texels' bounds */
    float high[3];
    double cell; /* width of cells and layers */
    float radius, depth;
    uint32_t layer_count;
    uint64_t *ends;        /* number of valid texels up to and with each layer */
    uint32_t first, last;  /* layers of the window that get results */
    uint32_t begin, end;   /* all layers of the window */
    uint64_t *next;        /* index of the next texel of each layer in the window */
    struct point *points;  /* of the window: by layer, and in a layer in the order of the image */
    struct point **sorted; /* the same, in a layer by cell */
    uint64_t capacity;
};

/* ---- texels ---- */

typedef void texel_fn(struct work *work, float *texel);

struct visit {
    struct work *work;
    texel_fn *fn;
};

static int visit_band(void *arg, uint32_t first_row, uint32_t rows, float *texels)
{
    const struct visit *visit = arg;
    const uint32_t channels = visit->work->channels;
    const float *end = texels + (size_t)rows * visit->work->width * channels;
    (void)first_row;
    for (float *texel = texels; texel < end; texel += channels)
        if (texel[0] > 0.0f)
            visit->fn(visit->work, texel);
    return bsq_check(visit->work->ctx);
}

/* Calls fn for all valid texels, in the order of the image. */
static int visit_texels(struct work *work, bool change, texel_fn *fn)
{
    struct visit visit = {work, fn};
    return bake_image_bands(work->ctx, work->filter->image, BAND_ROWS, change, visit_band, &visit);
}

/* ---- layers ---- */

static void widen_bounds(struct work *work, float *texel)
{
    for (int k = 0; k < 3; k++) {
        work->low[k] = fminf(work->low[k], texel[work->filter->guide + (uint32_t)k]);
        work->high[k] = fmaxf(work->high[k], texel[work->filter->guide + (uint32_t)k]);
    }
}

static uint32_t cell_along(const struct work *work, const float *guide, int axis)
{
    return (uint32_t)(((double)guide[axis] - work->low[axis]) / work->cell);
}

static uint32_t layer_of(const struct work *work, const float *texel)
{
    return cell_along(work, texel + work->filter->guide, work->axis);
}

static uint64_t filter_cell_of(const struct work *work, const float *guide)
{
    const uint32_t row = cell_along(work, guide, (work->axis + 1) % 3);
    return (uint64_t)row << 32 | cell_along(work, guide, (work->axis + 2) % 3);
}

static void count_layers(struct work *work, float *texel)
{
    work->ends[layer_of(work, texel)]++;
}

/* Chooses the layers, and counts the texels in them. */
static int make_layers(struct work *work)
{
    const double least = work->filter->texel * RADIUS;
    for (int k = 0; k < 3; k++) {
        work->low[k] = INFINITY;
        work->high[k] = -INFINITY;
    }
    BSQ_PASS(visit_texels(work, false, widen_bounds));
    for (int k = 1; k < 3; k++)
        if (work->high[k] - work->low[k] > work->high[work->axis] - work->low[work->axis])
            work->axis = k;
    const double extent = (double)work->high[work->axis] - work->low[work->axis];
    if (!(extent >= 0))
        return 0; /* no texel is valid */
    work->cell = fmax(least, extent / MOST_LAYERS);
    work->layer_count = (uint32_t)(extent / work->cell) + 1;
    BSQ_PASS(BSQ_CALLOC(work->ctx, "layers of texels", work->layer_count, &work->ends));
    BSQ_PASS(BSQ_CALLOC(work->ctx, "layers of texels", work->layer_count, &work->next));
    BSQ_PASS(visit_texels(work, false, count_layers));
    for (uint32_t i = 1; i < work->layer_count; i++)
        work->ends[i] += work->ends[i - 1];
    return 0;
}

/* Returns the number of texels in the layers before one. */
static uint64_t before(const struct work *work, uint32_t layer)
{
    return layer > 0 ? work->ends[layer - 1] : 0;
}

/* ---- a window ---- */

static bool is_in_window(const struct work *work, const float *texel, uint32_t *layer)
{
    *layer = layer_of(work, texel);
    return *layer >= work->begin && *layer < work->end;
}

static void filter_begin_reading(struct work *work)
{
    for (uint32_t i = work->begin; i < work->end; i++)
        work->next[i] = before(work, i) - before(work, work->begin);
}

static void take_points(struct work *work, float *texel)
{
    const float *guide = texel + work->filter->guide;
    uint32_t layer;
    if (!is_in_window(work, texel, &layer))
        return;
    struct point *point = &work->points[work->next[layer]];
    *point = (struct point){.at = bsq_load3(guide),
                            .normal = bsq_load3(guide + NORMAL),
                            .cell = filter_cell_of(work, guide)};
    for (uint32_t i = 0; i < work->filter->count; i++)
        point->values[i] = texel[work->filter->offsets[i]];
    work->sorted[work->next[layer]++] = point;
}

/* Puts the results where the filter has room in the image. */
static void put_results(struct work *work, float *texel)
{
    uint32_t layer;
    if (!is_in_window(work, texel, &layer))
        return;
    const struct point *point = &work->points[work->next[layer]++];
    if (layer >= work->first && layer < work->last)
        memcpy(texel + work->filter->guide + RESULT, point->results, sizeof point->results);
}

/* Makes the results of all texels their values. */
static void take_results(struct work *work, float *texel)
{
    for (uint32_t i = 0; i < work->filter->count; i++)
        texel[work->filter->offsets[i]] = texel[work->filter->guide + RESULT + i];
}

/* By cell, and in a cell in the order of the image. */
static int compare_points(const void *a, const void *b)
{
    const struct point *x = *(struct point *const *)a, *y = *(struct point *const *)b;
    return x->cell != y->cell ? (x->cell > y->cell) - (x->cell < y->cell) : (x > y) - (x < y);
}

static int sort_layer(void *arg, uint64_t index, unsigned worker)
{
    const struct work *work = arg;
    const uint32_t layer = work->begin + (uint32_t)index;
    const uint64_t start = before(work, work->begin), first = before(work, layer) - start;
    (void)worker;
    bsq_sort(work->sorted + first, work->ends[layer] - start - first, sizeof(void *),
             compare_points);
    return 0;
}

/* ---- means ---- */

/* Neighbours in a layer and a row of cells: from `at` on, and before `end`. Both only move
 * forwards, as the cells of the texels that ask do. */
struct run {
    struct point *const *at, *const *end;
};

struct sums {
    double weight, values[MOST_VALUES], squares[MOST_VALUES];
};

/* Returns x to the power of 32: normals that differ by 12 degrees have half of the weight. */
static float sharpen(float x)
{
    for (int i = 0; i < 5; i++)
        x *= x;
    return x;
}

static void filter_add_run(const struct work *work, const struct point *to, uint64_t row,
                           uint64_t column, struct run *run, struct sums *sums)
{
    const uint64_t first = row << 32 | (column > 0 ? column - 1 : 0),
                   last = row << 32 | (column + 1);
    const float reach = 1.0f / (work->radius * work->radius);
    const float flat = 1.0f / (work->depth * work->depth);
    while (run->at < run->end && (*run->at)->cell < first)
        run->at++;
    for (struct point *const *p = run->at; p < run->end && (*p)->cell <= last; p++) {
        const struct bsq_vec3 d = bsq_sub3((*p)->at, to->at);
        const float near = 1.0f - bsq_dot3(d, d) * reach;
        const float facing = bsq_dot3((*p)->normal, to->normal);
        const float height = bsq_dot3(to->normal, d), other = bsq_dot3((*p)->normal, d);
        const float level = 1.0f - fmaxf(height * height, other * other) * flat;
        if (!(near > 0.0f) || !(facing > 0.0f) || !(level > 0.0f))
            continue;
        const double weight = (double)(near * near * sharpen(facing) * level);
        sums->weight += weight;
        for (uint32_t i = 0; i < MOST_VALUES; i++) {
            const double value = (double)(*p)->values[i];
            sums->values[i] += weight * value;
            sums->squares[i] += weight * value * value;
        }
    }
}

/* Returns the result of a value, from the sums of those near it. */
static float filter_value(const struct sums *sums, uint32_t k, double value, double noise)
{
    if (!(sums->weight > 0))
        return (float)value;
    const double mean = sums->values[k] / sums->weight,
                 spread = sums->squares[k] / sums->weight - mean * mean,
                 share = noise * mean * (1 - mean);
    return (float)(noise > 0 && spread > share ? mean + (value - mean) * (1 - share / spread)
                                               : mean);
}

static int filter_layer(void *arg, uint64_t index, unsigned worker)
{
    const struct work *work = arg;
    const uint32_t layer = work->first + (uint32_t)index;
    const uint64_t start = before(work, work->begin);
    struct run runs[3][3];
    (void)worker;
    for (uint32_t l = 0; l < 3; l++)
        for (int r = 0; r < 3; r++) {
            const bool exists = layer + l >= work->begin + 1 && layer + l <= work->end;
            const uint32_t number = layer + l - 1;
            runs[l][r].at = work->sorted + (exists ? before(work, number) - start : 0);
            runs[l][r].end = exists ? work->sorted + (work->ends[number] - start) : runs[l][r].at;
        }
    for (uint64_t i = before(work, layer); i < work->ends[layer]; i++) {
        struct point *to = work->sorted[i - start];
        const uint64_t row = to->cell >> 32, column = to->cell & UINT32_MAX;
        struct sums sums = {0};
        for (uint32_t l = 0; l < 3; l++)
            for (uint64_t r = row > 0 ? 0 : 1; r < 3; r++)
                filter_add_run(work, to, row + r - 1, column, &runs[l][r], &sums);
        for (uint32_t k = 0; k < MOST_VALUES; k++)
            to->results[k] = filter_value(&sums, k, (double)to->values[k], work->filter->noise[k]);
    }
    bsq_progress_add(work->ctx, work->ends[layer] - before(work, layer));
    return bsq_check(work->ctx);
}

/* ---- windows ---- */

/* Makes the window as many layers from `first` on as fit, at least one. */
static int choose_window(struct work *work, uint32_t first, uint64_t most)
{
    uint64_t count;
    work->first = first;
    work->begin = first > 0 ? first - 1 : 0;
    work->last = first + 1;
    while (work->last < work->layer_count) {
        const uint32_t end =
            work->last + 2 < work->layer_count ? work->last + 2 : work->layer_count;
        if (before(work, end) - before(work, work->begin) > most)
            break;
        work->last++;
    }
    work->end = work->last < work->layer_count ? work->last + 1 : work->last;
    count = before(work, work->end) - before(work, work->begin);
    if (count <= work->capacity)
        return 0;
    BSQ_FREE(work->ctx, work->points, work->sorted);
    work->points = NULL;
    work->sorted = NULL;
    work->capacity = count;
    int status = BSQ_ALLOC(work->ctx, "texels to filter", count, &work->points);
    return status < 0
               ? status
               : bsq_alloc(work->ctx, "texels to filter", count, sizeof(void *), &work->sorted);
}

static int filter_window(struct work *work)
{
    filter_begin_reading(work);
    BSQ_PASS(visit_texels(work, false, take_points));
    BSQ_PASS(bsq_parallel_for(work->ctx, work->end - work->begin, sort_layer, work));
    BSQ_PASS(bsq_parallel_for(work->ctx, work->last - work->first, filter_layer, work));
    filter_begin_reading(work);
    return visit_texels(work, true, put_results);
}

int bake_filter(struct bsq_ctx *ctx, const struct bake_filter *filter)
{
    struct work work = {.ctx = ctx,
                        .filter = filter,
                        .width = filter->image->width,
                        .channels = filter->image->channels,
                        .radius = (float)(filter->texel * RADIUS),
                        .depth = (float)(filter->texel * DEPTH)};
    const uint64_t most = bsq_memory_left(ctx) / 2 / (sizeof(struct point) + sizeof(void *));
    int status = 0;
    if (!(filter->texel > 0))
        return 0;
    BSQ_TRY(make_layers(&work));
    bsq_progress_begin(ctx, "filtering", "texels",
                       work.layer_count > 0 ? work.ends[work.layer_count - 1] : 0);
    for (uint32_t first = 0; first < work.layer_count; first = work.last) {
        BSQ_TRY(choose_window(&work, first, most));
        BSQ_TRY(filter_window(&work));
    }
    if (work.layer_count > 0)
        BSQ_TRY(visit_texels(&work, true, take_results));
done:
    bsq_progress_end(ctx);
    BSQ_FREE(ctx, work.points, work.sorted, work.next, work.ends);
    return status;
}
