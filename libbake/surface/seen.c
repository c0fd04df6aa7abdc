/* seen.c - how much of the scans the rays of a bake reached.
 *
 * Some of the hits are marked in cubic cells, in a hash table without locks: a word has the place
 * of a cell and the axes along which surfaces that were hit there look. What the table holds does
 * not depend on the order of marks. Points that stand for the area of the scans are looked up in
 * the eight cells around them, which reach one and a half marks far or farther. So surfaces that
 * look the same way and are nearer to each other than a cell are not told apart. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/kernel/bk_sample.h"

/* Of all samples, one in so many is marked; on a device, the processor traces these again. Small
 * maps mark more of them. */
enum { RAY_SHARE = 8, RAY_LEAST = 16384, DEVICE_SHARE = 400, DEVICE_LEAST = 2048 };
/* Cells; the table has some for each that a low-poly mesh of this area crosses. */
enum { MOST_CELLS = 1 << 16, WORDS_A_CELL = 8, LEAST_WORDS_LOG2 = 10, MOST_STEPS = 64 };
/* Leaves of a grid whose voxels are looked up; samples that are traced at a time. */
enum { LEAVES = 4096, VOXELS_A_LEAF = 2, LINES = 64 };

enum { HITS_A_TASK = 4096 };

struct bake_seen {
    struct bsq_ctx *ctx;
    double side;             /* of a cell, world units */
    float cells_a_length;    /* its inverse */
    uint32_t stride;         /* between samples that are traced again, along the axes of the map */
    uint64_t lot;            /* hits of rays below it, of 2^24, are marked */
    _Atomic uint64_t *words; /* the table */
    unsigned words_log2;
    atomic_bool full;
};

/* Hits to mark. */
struct hits {
    struct bake_seen *seen;
    const struct bake_ray_batch *batch;
    float unit;
    bool both_sides;
};

/* ---- marks ---- */

/* Returns the axes along which a normal looks by more than `least`: one bit for each direction. */
static uint64_t axes_of(const float normal[3], float least)
{
    uint64_t axes = 0;
    for (int k = 0; k < 3; k++)
        axes |= (uint64_t)(normal[k] > least) << 2 * k | (uint64_t)(normal[k] < -least)
                                                             << (2 * k + 1);
    return axes;
}

/* Returns the bits of a cell in a word, without axes; `corner` adds half a cell or takes it. */
static uint64_t seen_cell_of(const struct bake_seen *seen, const float p[3], int corner)
{
    uint64_t cell = 0;
    for (int k = 0; k < 3; k++) {
        const float half = corner < 0 ? 0.0f : corner >> k & 1 ? 0.5f : -0.5f;
        /* Truncates a positive number: floorf() is a call. */
        const int64_t place = (int64_t)(p[k] * seen->cells_a_length + half + 0x1p20f);
        cell = cell << 19 | ((uint64_t)place & 0x7ffff);
    }
    return cell << 6;
}

/* Returns where the search for a cell begins. */
static uint64_t first_word(const struct bake_seen *seen, uint64_t cell)
{
    return (cell * UINT64_C(0x9e3779b97f4a7c15)) >> (64 - seen->words_log2);
}

static void mark_cell(struct bake_seen *seen, uint64_t cell, uint64_t axes)
{
    const uint64_t mask = (UINT64_C(1) << seen->words_log2) - 1;
    uint64_t at = first_word(seen, cell);
    for (int step = 0; step < MOST_STEPS; step++, at = (at + 1) & mask) {
        uint64_t word = atomic_load_explicit(&seen->words[at], memory_order_relaxed);
        if (word == 0 && atomic_compare_exchange_strong(&seen->words[at], &word, cell | axes))
            return;
        if ((word ^ cell) >> 6 == 0) {
            if (axes & ~word)
                atomic_fetch_or(&seen->words[at], axes);
            return;
        }
    }
    atomic_store(&seen->full, true);
}

/* Marks a hit. both_sides: the normal may be turned round. */
static void seen_mark(struct bake_seen *seen, const float position[3], const float normal[3],
                      bool both_sides)
{
    uint64_t axes = axes_of(normal, 0.5f);
    if (both_sides)
        axes |= (axes & 0x15) << 1 | (axes & 0x2a) >> 1;
    if (axes != 0)
        mark_cell(seen, seen_cell_of(seen, position, -1), axes);
}

/* Returns a number that follows from where a ray starts, so that the choice of rays does not depend
 * on batches and threads. */
static uint64_t lot_of(const struct bake_ray *ray)
{
    uint32_t x, y;
    memcpy(&x, &ray->origin[0], sizeof x);
    memcpy(&y, &ray->origin[1], sizeof y);
    return ((uint64_t)x << 32 | y) * UINT64_C(0x9e3779b97f4a7c15) >> 40;
}

/* Marks the hits of some rays of a range, by the normals of triangles. */
static int mark_some(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct hits *of = arg;
    const struct bake_ray_batch *batch = of->batch;
    for (uint64_t i = begin; i < end; i++) {
        const struct bake_ray *ray = &batch->rays[i];
        const struct bake_hit *hit = &batch->hits[i];
        if (lot_of(ray) >= of->seen->lot || hit->triangle == BAKE_NO_HIT)
            continue;
        const bool flat = hit->facet[0] != 0 || hit->facet[1] != 0 || hit->facet[2] != 0;
        float position[3];
        for (int k = 0; k < 3; k++)
            position[k] = ray->origin[k] * of->unit + (float)hit->t * ray->direction[k];
        seen_mark(of->seen, position, flat ? hit->facet : hit->normal, of->both_sides);
    }
    return 0;
}

int bake_seen_mark_hits(const struct bake_surface *surface, struct bake_seen *seen,
                        const struct bake_ray_batch *batch)
{
    struct hits of = {seen, batch, (float)surface->unit, surface->params.flags & BK_TWO_SIDED};
    return bsq_parallel_ranges(seen->ctx, batch->count, HITS_A_TASK, mark_some, &of);
}

static bool is_marked(const struct bake_seen *seen, uint64_t cell, uint64_t axes)
{
    const uint64_t mask = (UINT64_C(1) << seen->words_log2) - 1;
    uint64_t at = first_word(seen, cell);
    for (int step = 0; step < MOST_STEPS; step++, at = (at + 1) & mask) {
        const uint64_t word = atomic_load_explicit(&seen->words[at], memory_order_relaxed);
        if (word == 0 || (word ^ cell) >> 6 == 0)
            return word & axes;
    }
    return false;
}

/* ---- patches on a device ---- */

struct lines {
    struct bake_ray rays[LINES];
    float reaches[LINES];
    uint64_t count;
};

static void trace_lines(const struct bake_surface *surface, const struct bake_patches *patches,
                        struct lines *lines)
{
    const struct bk_params *params = patches->params;
    struct bake_hit hits[LINES];
    const struct bake_ray_batch batch = {.rays = lines->rays,
                                         .hits = hits,
                                         .count = lines->count,
                                         .t_min = -(double)params->back,
                                         .t_max = (double)params->front,
                                         .reaches = lines->reaches,
                                         .from_reach = params->flags & BK_CAGE};
    bake_trace_rays(&surface->scans->grid, params, 1, &batch, 0, batch.count);
    for (uint64_t i = 0; i < lines->count; i++) {
        const struct bake_ray *ray = &lines->rays[i];
        float position[3];
        for (int k = 0; k < 3; k++)
            position[k] = (ray->origin[k] + (float)hits[i].t * ray->direction[k]) * params->unit;
        if (hits[i].triangle != BAKE_NO_HIT)
            seen_mark(patches->seen, position, hits[i].normal, params->flags & BK_TWO_SIDED);
    }
    lines->count = 0;
}

/* Returns how far the next multiple of the stride is. */
static uint32_t first_of(uint32_t at, uint32_t stride)
{
    return (stride - at % stride) % stride;
}

void bake_seen_mark_patch(const struct bake_surface *surface, const struct bake_patches *patches,
                          const struct bk_patch *patch, const uint32_t *samples)
{
    const struct bk_params *params = patches->params;
    const uint32_t n = params->samples, stride = patches->seen->stride;
    const uint32_t width = patch->width * n, height = patch->height * n;
    struct lines lines = {.count = 0};
    for (uint32_t j = first_of(patch->y * n, stride); j < height; j += stride)
        for (uint32_t i = first_of(patch->x * n, stride); i < width; i += stride) {
            const uint64_t index = (uint64_t)j * width + i;
            if (samples[index] == BK_NO_TRIANGLE)
                continue;
            const struct bk_triangle *triangle = &patches->triangles[samples[index]];
            bk_point point = bk_point_at(triangle, bk_sample_position(patch->x + i / n, i % n, n),
                                         bk_sample_position(patch->y + j / n, j % n, n));
            bk_set_lane3(&point.direction, 0,
                         bk_skewed(triangle, bk_lane3(&point.direction, 0),
                                   bk_sample_skew(params, patch, samples, index)));
            const bk_start start = bk_start_at(params, &point);
            bk_copy_lane(&start.origin, 0, lines.rays[lines.count].origin);
            bk_copy_lane(&start.direction, 0, lines.rays[lines.count].direction);
            lines.reaches[lines.count++] = start.reach;
            if (lines.count == LINES)
                trace_lines(surface, patches, &lines);
        }
    trace_lines(surface, patches, &lines);
}

/* ---- areas ---- */

/* Areas of the scans, of those within the low-poly mesh's bounds, and what of them is not marked.
 */
struct sums {
    const struct bake_seen *seen;
    double low[3], high[3]; /* bounds, relative to the surface's translation */
    double all, inside, unseen, unseen_inside;
};

/* Adds the area that a point stands for. shift: of the scan's origin from the surface's. */
static void seen_add_point(struct sums *sums, const struct bake_area_point *point,
                           const double shift[3])
{
    const uint64_t axes = axes_of(point->normal, 0.25f);
    const double area = (double)point->area;
    bool marked = false, inside = true;
    float at[3];
    for (int k = 0; k < 3; k++) {
        at[k] = (float)((double)point->at[k] + shift[k]);
        inside &= (double)at[k] >= sums->low[k] && (double)at[k] <= sums->high[k];
    }
    for (int corner = 0; corner < 8 && !marked; corner++)
        marked = is_marked(sums->seen, seen_cell_of(sums->seen, at, corner), axes);
    sums->all += area;
    sums->inside += inside ? area : 0;
    sums->unseen += marked ? 0 : area;
    sums->unseen_inside += inside && !marked ? area : 0;
}

/* Adds the voxel of a leaf that has this number among its voxels. A plane crosses the more voxels,
 * the more it is inclined. */
static void add_voxel(struct sums *sums, const struct bake_scan *scan, const struct bk_grid *grid,
                      const uint64_t *leaf, unsigned number, double voxels, const double shift[3])
{
    struct bake_area_point point;
    int32_t corner[3];
    uint32_t layer = 0, bit = 0;
    memcpy(corner, leaf, sizeof corner);
    for (; number >= (unsigned)__builtin_popcountll(leaf[BK_LEAF_MASK + layer]); layer++)
        number -= (unsigned)__builtin_popcountll(leaf[BK_LEAF_MASK + layer]);
    for (uint64_t left = leaf[BK_LEAF_MASK + layer];; left &= left - 1, number--)
        if (number == 0) {
            bit = (uint32_t)__builtin_ctzll(left);
            break;
        }
    const uint32_t at[3] = {layer, bit >> 3, bit & 7};
    const bk_ulong record = bk_leaf_rank(grid, leaf, layer, bit);
    const bk_vec3w normal = bk_decode_normalw((bk_iw)grid->normals[record]);
    bk_copy_lane(&normal, 0, point.normal);
    double inclined = 0;
    for (int k = 0; k < 3; k++) {
        point.at[k] = (float)(((double)(corner[k] & ~7) + at[k]) * scan->unit);
        inclined += fabs((double)point.normal[k]);
    }
    point.area = (float)(voxels * scan->unit * scan->unit / fmax(inclined, 1));
    seen_add_point(sums, &point, shift);
}

static void add_grid(struct sums *sums, const struct bake_scan *scan, const double shift[3])
{
    struct bk_grid grid;
    bake_kernel_grid(&scan->grid, &scan->params, &grid);
    const uint64_t leaves = grid.leaf_count, step = leaves / LEAVES + 1;
    for (uint64_t l = step / 2; l < leaves; l += step) {
        const uint64_t *leaf = grid.leaves + l * BK_LEAF_WORDS;
        unsigned voxels = 0;
        for (uint32_t layer = 0; layer < 8; layer++)
            voxels += (unsigned)__builtin_popcountll(leaf[BK_LEAF_MASK + layer]);
        for (unsigned i = 0; i < VOXELS_A_LEAF && voxels > 0; i++)
            add_voxel(sums, scan, &grid, leaf, (2 * i + 1) * voxels / (2 * VOXELS_A_LEAF),
                      (double)voxels, shift);
    }
}

static void add_scan(struct sums *sums, const struct bake_surface *surface,
                     const struct bake_scan *scan)
{
    const struct bake_area_point *points;
    double shift[3];
    for (int k = 0; k < 3; k++)
        shift[k] = scan->translation[k] - surface->translation[k];
    if (!scan->exact) {
        add_grid(sums, scan, shift);
        return;
    }
    const uint64_t count = bake_exact_areas(scan->exact, &points);
    for (uint64_t i = 0; i < count; i++)
        seen_add_point(sums, &points[i], shift);
}

void bake_seen_report(const struct bake_seen *seen, const struct bake_surface *surface,
                      const struct bake_lowmesh *mesh, struct bake_report *report)
{
    struct sums sums = {.seen = seen};
    if (!seen || atomic_load(&seen->full))
        return;
    for (int k = 0; k < 3; k++) {
        sums.low[k] = mesh->bounds_min[k] - surface->translation[k];
        sums.high[k] = mesh->bounds_max[k] - surface->translation[k];
    }
    for (uint32_t s = 0; s < surface->scan_count; s++)
        add_scan(&sums, surface, &surface->scans[s]);
    if (!(sums.all > 0))
        return;
    report->seen_cell = seen->side;
    report->unseen = sums.unseen / sums.all;
    report->unseen_inside = sums.inside > 0 ? sums.unseen_inside / sums.inside : 0;
}

/* ---- memory ---- */

/* Chooses the stride between marked samples and the side of cells. */
static void choose_cells(const struct bake_surface *surface, double area, double texels,
                         bool device, struct bake_seen *seen)
{
    const double n = surface->params.samples, samples = texels * n * n;
    const double most =
        device ? fmax(samples / DEVICE_SHARE, DEVICE_LEAST) : fmax(samples / RAY_SHARE, RAY_LEAST);
    seen->stride = (uint32_t)ceil(fmax(sqrt(samples / most) - 0.01, 1));
    seen->lot = (uint64_t)(fmin(most / samples, 1) * 0x1p24);
    const double marks = device ? samples / seen->stride / seen->stride : fmin(most, samples);
    seen->side = fmax(3 * sqrt(area / marks), sqrt(area / MOST_CELLS));
    seen->side = fmax(seen->side, 2 * surface->detail);
    seen->cells_a_length = (float)(1 / seen->side);
}

int bake_seen_create(struct bake_surface *surface, double area, double texels, bool device,
                     struct bake_seen **out)
{
    struct bsq_ctx *ctx = surface->ctx;
    struct bake_seen *seen;
    *out = NULL;
    if (!(area > 0 && texels > 0))
        return 0;
    BSQ_PASS(BSQ_CALLOC(ctx, "cells of the scan", 1, &seen));
    *out = seen;
    seen->ctx = ctx;
    choose_cells(surface, area, texels, device, seen);
    seen->words_log2 = LEAST_WORDS_LOG2;
    while (ldexp(1, (int)seen->words_log2) < WORDS_A_CELL * area / (seen->side * seen->side))
        seen->words_log2++;
    BSQ_PASS(BSQ_CALLOC(ctx, "cells of the scan", UINT64_C(1) << seen->words_log2, &seen->words));
    for (uint32_t s = 0; s < surface->scan_count; s++)
        if (surface->scans[s].exact)
            BSQ_PASS(bake_exact_note_areas(surface->scans[s].exact));
    return 0;
}

void bake_seen_free(struct bake_seen *seen)
{
    if (!seen)
        return;
    BSQ_FREE(seen->ctx, (void *)seen->words, seen);
}
