/* ray_patches.c - traces the samples of a map as batches of rays, against triangles and several
 * scans.
 *
 * Patches have seats in memory, as many as the budget allows. If not all patches have one, they
 * take turns in the order of the first chunk that their rays may cross. A batch meets the chunks
 * before the first one of the patches without seats. Then patches that have no chunk ahead are
 * written, and others take their seats. So each chunk is met once, whatever the layout of the
 * charts. If too many patches wait for chunks ahead, a batch goes on, and the next one meets some
 * chunks again.
 *
 * Several scans have no common order of chunks. Their batches, and those whose hits send further
 * rays, meet all chunks. Their patches are ordered along a curve through the scans.
 *
 * Each pass over a patch rasterises it again, which costs less than keeping the triangle of every
 * sample. Rays and sums are computed by the kernel's functions. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "libbake/kernel/bk_sample.h"

/* Triangles within this distance of a hit, as a share of 1/2048 of the scan's longest side, belong
 * to the surface that was hit: more than rounding errors. */
#define NEXT_SHEET 0.02

/* A box grows by this share of its coordinates: more than the rounding errors of single precision
 * when it was computed. */
#define BOX_SLACK 1e-6f

struct patch {
    uint32_t index; /* number of the patch in the raster */
    /* In a sweep the first and the last chunk that the rays may cross, of those that they have not
     * met. Otherwise the place on the curve, and 0. */
    uint32_t first, last;
    float low[3], high[3]; /* what the rays cross, in the index space */
};

struct tracing {
    struct bsq_ctx *ctx;
    const struct bake_surface *surface;
    const struct bake_patches *patches;
    const uint32_t *object_of;         /* of each triangle; NULL: not needed */
    double units_a_length;             /* of the surface, a world unit: 1 for triangles alone */
    struct bake_patch_workers workers; /* with sums for a row of squares, see square_side() */
    struct patch *order;
    uint32_t patch_count;
    struct bake_exact_sweep *sweep;         /* NULL: each batch meets all chunks */
    struct bake_footprint *footprint_table; /* of each triangle; NULL: not needed */
    /* The current batch: the patches in the first `taken` seats. Each has space for seat_rays. */
    uint32_t seat_count, taken;
    uint32_t next;        /* order[next] is the first patch that had no seat yet */
    uint32_t waiting;     /* seats from the first on whose patches an earlier batch has begun */
    struct patch *seated; /* of each seat */
    uint64_t seat_rays;
    struct bake_ray *rays;
    struct bake_hit *hits;
    struct bake_hit *next_hits; /* beside these hits, for `confidence`; else NULL */
    float *reaches;
    uint32_t *footprints, *objects;
    float *channels; /* of each hit: values of transfer maps; NULL: there are none */
    /* For maps of secondary rays; else NULL. */
    struct bake_look *look;
    struct bk_share *shares;
    struct bk_surroundings *surroundings;
};

/* ---- samples to rays ---- */

/* Returns the side in texels of the squares by which the samples of a patch are numbered. Rays of a
 * square meet fewer triangles of the scan than those of a line. */
static uint32_t square_side(const struct tracing *tracing)
{
    const uint32_t n = tracing->patches->params->samples;
    return (3 + n) / n;
}

/* Returns the next multiple of a bundle's rays. Each square begins a bundle. */
static uint64_t next_bundle(uint64_t ray)
{
    return (ray + BAKE_RAY_BUNDLE - 1) / BAKE_RAY_BUNDLE * BAKE_RAY_BUNDLE;
}

/* Returns the most rays of a patch. */
static uint64_t most_rays(const struct tracing *tracing)
{
    const uint32_t n = tracing->patches->params->samples, side = square_side(tracing);
    const uint32_t squares = (tracing->patches->patch_side + side - 1) / side;
    return squares * squares * next_bundle((uint64_t)side * side * n * n);
}

/* A sample of a patch that lies in a triangle. */
struct sample {
    uint32_t triangle;
    uint32_t texel; /* number in the row of squares, line by line */
    float x, y;     /* map position in texels */
    bk_point point; /* of the low-poly mesh */
    uint64_t ray;   /* its number in the batch */
};

/* Does something with a sample. into: where the result goes. */
typedef void take_sample_fn(struct tracing *tracing, const struct sample *sample, void *into);

/* Calls `take` for the samples of a line of a square that lie in a triangle, from the left. column,
 * end: its texels in the patch. first: number of the line's first texel, see struct sample. */
static inline void each_sample_of_line(struct tracing *tracing, const struct bk_patch *patch,
                                       const uint32_t *samples, uint32_t line, uint32_t column,
                                       uint32_t end, uint32_t first, uint64_t *ray,
                                       take_sample_fn *take, void *into)
{
    const struct bk_params *params = tracing->patches->params;
    const uint32_t n = params->samples;
    const float y = bk_sample_position(patch->y + line / n, line % n, n);
    uint64_t index = ((uint64_t)line * patch->width + column) * n;
    for (; column < end; column++)
        for (uint32_t i = 0; i < n; i++, index++) {
            struct sample sample = {.triangle = samples[index], .texel = first + column, .y = y};
            if (sample.triangle == BK_NO_TRIANGLE)
                continue;
            const struct bk_triangle *triangle = &tracing->patches->triangles[sample.triangle];
            sample.x = bk_sample_position(patch->x + column, i, n);
            sample.point = bk_point_at(triangle, sample.x, y);
            if (params->flags & BK_SKEW)
                bk_set_lane3(&sample.point.direction, 0,
                             bk_skewed(triangle, bk_lane3(&sample.point.direction, 0),
                                       bk_sample_skew(params, patch, samples, index)));
            sample.ray = (*ray)++;
            take(tracing, &sample, into);
        }
}

/* Calls `take` for the samples of a row of squares that lie in a triangle: square by square, and
 * line by line in each. Their rays are numbered from *ray on, with gaps between squares. row: of
 * the first texels. samples: of the patch. */
static inline void each_sample_of_row(struct tracing *tracing, const struct bk_patch *patch,
                                      const uint32_t *samples, uint32_t row, uint64_t *ray,
                                      take_sample_fn *take, void *into)
{
    const uint32_t n = tracing->patches->params->samples, side = square_side(tracing);
    const uint32_t rows = side < patch->height - row ? side : patch->height - row;
    for (uint32_t column = 0; column < patch->width; column += side) {
        const uint32_t end = side < patch->width - column ? column + side : patch->width;
        *ray = next_bundle(*ray);
        for (uint32_t line = 0; line < rows * n; line++)
            each_sample_of_line(tracing, patch, samples, row * n + line, column, end,
                                line / n * patch->width, ray, take, into);
    }
}

/* Calls `take` for each sample of a patch that lies in a triangle. ray: number of the first one's.
 */
static inline int each_sample(struct tracing *tracing, uint32_t index, uint64_t ray,
                              unsigned number, take_sample_fn *take, void *into)
{
    const struct bk_patch patch = bake_raster_patch(tracing->patches->raster, index);
    uint32_t *samples = tracing->workers.workers[number].sample_triangles;
    uint64_t overlaps;
    int status = bake_raster_fill(tracing->patches->raster, index, samples, &overlaps);
    for (uint32_t row = 0; row < patch.height && status == 0; row += square_side(tracing))
        each_sample_of_row(tracing, &patch, samples, row, &ray, take, into);
    return status;
}

static void cast_sample(struct tracing *tracing, const struct sample *sample, void *into)
{
    (void)into;
    const bk_start start = bk_start_at(tracing->patches->params, &sample->point);
    tracing->rays[sample->ray] =
        (struct bake_ray){{start.origin.x, start.origin.y, start.origin.z},
                          {start.direction.x, start.direction.y, start.direction.z}};
    tracing->reaches[sample->ray] = start.reach * tracing->patches->params->unit;
    if (tracing->footprints)
        tracing->footprints[sample->ray] = sample->triangle;
    if (tracing->objects)
        tracing->objects[sample->ray] = tracing->object_of[sample->triangle];
    if (tracing->shares)
        tracing->shares[sample->ray] =
            bk_sample_share(sample->x, sample->y, tracing->patches->params->samples);
}

/* Writes the rays of a patch to its seat, one that does not wait. The rest have no direction. */
static int cast_patch(void *arg, uint64_t index, unsigned number)
{
    struct tracing *tracing = arg;
    const uint64_t seat = tracing->waiting + index, begin = seat * tracing->seat_rays;
    memset(tracing->rays + begin, 0, tracing->seat_rays * sizeof *tracing->rays);
    memset(tracing->reaches + begin, 0, tracing->seat_rays * sizeof *tracing->reaches);
    if (tracing->objects)
        memset(tracing->objects + begin, 0, tracing->seat_rays * sizeof *tracing->objects);
    return each_sample(tracing, tracing->seated[seat].index, begin, number, cast_sample, NULL);
}

static void measure_footprints(const struct tracing *tracing)
{
    const float step = tracing->patches->params->unit / (float)tracing->patches->params->samples;
    for (uint32_t t = 0; t < tracing->patches->triangle_count; t++) {
        const struct bk_triangle *triangle = &tracing->patches->triangles[t];
        for (int s = 0; s < 2; s++)
            for (int k = 0; k < 3; k++)
                tracing->footprint_table[t].step[s][k] =
                    step *
                    (triangle->b1[s] * (triangle->position[1][k] - triangle->position[0][k]) +
                     triangle->b2[s] * (triangle->position[2][k] - triangle->position[0][k]));
    }
}

/* ---- hits to texels ---- */

/* Turns the hit of a ray into a hit for maps. */
static bk_map_hits place_hit(const struct tracing *tracing, const bk_point *point,
                             const struct bake_hit *hit)
{
    const bk_hits hits = {.found = hit->triangle != BAKE_NO_HIT,
                          .reversed = hit->reversed,
                          .t = (float)(hit->t * tracing->units_a_length),
                          .normal = {hit->normal[0], hit->normal[1], hit->normal[2]},
                          .color = {hit->color[0], hit->color[1], hit->color[2]},
                          .id = (bk_int)hit->id};
    const bk_start start = bk_start_at(tracing->patches->params, point);
    bk_map_hits placed;
    bk_hits_for_maps(tracing->patches->params, point, &start, &hits, &placed);
    return placed;
}

/* Returns the number of values that transfer maps have of a hit. */
static uint64_t transfer_floats(const struct tracing *tracing)
{
    return (uint64_t)BK_TRANSFER_VALUES * bk_transfers(tracing->patches->params->maps);
}

/* Sets the confidence in a sample's hit. */
static void set_confidence(const struct tracing *tracing, const struct sample *sample,
                           bk_map_hits *placed)
{
    const struct bk_params *params = tracing->patches->params;
    const struct bake_hit *hit = &tracing->hits[sample->ray],
                          *beside = &tracing->next_hits[sample->ray];
    const bk_start start = bk_start_at(params, &sample->point);
    const bk_hits hits = {.t = (float)(hit->t * tracing->units_a_length), .normal = placed->normal};
    const float way = (float)(beside->t * tracing->units_a_length), t = hits.t + way;
    const bool other = beside->triangle != BAKE_NO_HIT && t >= -params->back && t <= start.t_max;
    bk_set_confidence(params, &start, &hits, other ? fabsf(way) : BK_FAR, placed);
}

/* Adds a sample to its texel. into: the texels of its row of squares. */
static void add_sample(struct tracing *tracing, const struct sample *sample, void *into)
{
    const struct bk_params *params = tracing->patches->params;
    float *texel = (float *)into + sample->texel * (uint64_t)tracing->workers.texel_floats;
    bk_map_hits placed = place_hit(tracing, &sample->point, &tracing->hits[sample->ray]);
    if (tracing->next_hits)
        set_confidence(tracing, sample, &placed);
    if (tracing->look)
        bk_surroundings_for_maps(params, &sample->point, &tracing->surroundings[sample->ray],
                                 &placed);
    bk_add_sample(params, &placed, 0, texel);
    if (tracing->channels && placed.found)
        bk_add_transfers(params->maps, tracing->channels + sample->ray * transfer_floats(tracing),
                         texel);
}

/* Sums and resolves the patch of a seat, one that does not wait, and writes it to the image. */
static int resolve_patch(void *arg, uint64_t index, unsigned number)
{
    struct tracing *tracing = arg;
    struct bake_patch_worker *worker = &tracing->workers.workers[number];
    const uint32_t seat = tracing->waiting + (uint32_t)index,
                   patch_index = tracing->seated[seat].index;
    const struct bk_patch patch = bake_raster_patch(tracing->patches->raster, patch_index);
    uint64_t overlaps, next = seat * tracing->seat_rays;
    int status = bake_raster_fill(tracing->patches->raster, patch_index, worker->sample_triangles,
                                  &overlaps);
    worker->overlaps += overlaps;
    if (status < 0)
        return status;
    for (uint32_t row = 0; row < patch.height; row += square_side(tracing)) {
        const uint32_t left = patch.height - row,
                       rows = left < square_side(tracing) ? left : square_side(tracing);
        const uint32_t texels = rows * patch.width;
        memset(worker->texels, 0,
               (uint64_t)texels * tracing->workers.texel_floats * sizeof *worker->texels);
        /* Each texel gets its samples in the same order as in the kernel. */
        each_sample_of_row(tracing, &patch, worker->sample_triangles, row, &next, add_sample,
                           worker->texels);
        bake_patch_worker_resolve(&tracing->workers, worker, texels,
                                  worker->resolved +
                                      (size_t)row * patch.width * tracing->workers.channels);
    }
    return bake_image_write_patch(tracing->patches->image, &patch, worker->resolved);
}

/* ---- secondary rays ---- */

/* Looks from each hit along its ray, both ways, for the next surface that the ray could have hit.
 * The rays start at the hits from here on. */
static int look_beside(struct tracing *tracing, const struct bake_surface_rays *rays)
{
    const struct bake_surface *surface = tracing->surface;
    const double most = surface->front + surface->back, unit = surface->unit;
    const uint64_t first = tracing->waiting * tracing->seat_rays;
    const struct bake_surface_rays beside = {.batch = {.rays = rays->batch.rays,
                                                       .hits = tracing->next_hits + first,
                                                       .count = rays->batch.count,
                                                       .t_min = -most,
                                                       .t_max = most,
                                                       .gap = NEXT_SHEET * surface->detail,
                                                       .distances_only = true},
                                             .objects = rays->objects};
    for (uint64_t i = first; i < first + rays->batch.count; i++) {
        const bool found = tracing->hits[i].triangle != BAKE_NO_HIT;
        struct bake_ray *ray = &tracing->rays[i];
        for (int k = 0; k < 3; k++) {
            ray->origin[k] += found ? (float)(tracing->hits[i].t / unit) * ray->direction[k] : 0;
            ray->direction[k] = found ? ray->direction[k] : 0;
        }
    }
    return bake_surface_trace(surface, &beside);
}

/* Traces the rays from all hits. */
static int patches_look_around(struct tracing *tracing, const struct bake_surface_rays *rays,
                               uint64_t progress)
{
    const uint64_t first = tracing->waiting * tracing->seat_rays;
    const struct bake_look_hits hits = {.rays = rays->batch.rays,
                                        .hits = rays->batch.hits,
                                        .shares = tracing->shares + first,
                                        .objects = rays->objects,
                                        .count = rays->batch.count,
                                        .progress = progress};
    return bake_look_around(tracing->look, &hits, tracing->surroundings + first);
}

/* ---- ordering ---- */

/* Grows the box of a patch by the way of a sample's ray. */
static void bound_sample(struct tracing *tracing, const struct sample *sample, void *into)
{
    const bk_start start = bk_start_at(tracing->patches->params, &sample->point);
    const float origin[3] = {start.origin.x, start.origin.y, start.origin.z};
    const float direction[3] = {start.direction.x, start.direction.y, start.direction.z};
    const float front = tracing->patches->params->front, back = tracing->patches->params->back;
    struct patch *patch = into;
    for (int k = 0; k < 3; k++) {
        const float a = origin[k] + front * direction[k], b = origin[k] - back * direction[k];
        const float low = a < b ? a : b, high = a < b ? b : a;
        patch->low[k] = low < patch->low[k] ? low : patch->low[k];
        patch->high[k] = high > patch->high[k] ? high : patch->high[k];
    }
}

/* Sets the first and the last chunk that a patch may need, of those from `from` on. Both are 0 if
 * there is none. */
static void set_chunks(const struct tracing *tracing, uint32_t from, struct patch *patch)
{
    bake_exact_chunks_in(tracing->surface->scans->exact, patch->low, patch->high, from,
                         &patch->first, &patch->last);
    if (patch->first > patch->last)
        patch->first = patch->last = 0;
}

/* Finds out where a patch comes in the order of patches. */
static int bound_patch(void *arg, uint64_t index, unsigned number)
{
    struct tracing *tracing = arg;
    struct patch patch = {.index = (uint32_t)index,
                          .low = {INFINITY, INFINITY, INFINITY},
                          .high = {-INFINITY, -INFINITY, -INFINITY}};
    const int status = each_sample(tracing, (uint32_t)index, 0, number, bound_sample, &patch);
    float middle[3];
    for (int k = 0; k < 3; k++) {
        const float slack = BOX_SLACK * fmaxf(fabsf(patch.low[k]), fabsf(patch.high[k]));
        middle[k] = 0.5f * (patch.low[k] + patch.high[k]);
        patch.low[k] -= slack;
        patch.high[k] += slack;
    }
    if (tracing->sweep)
        set_chunks(tracing, 0, &patch);
    else
        patch.first = (uint32_t)(bake_surface_curve_index(tracing->surface, middle) >> 2);
    tracing->order[index] = patch;
    return status;
}

static int compare_patches(const void *a, const void *b)
{
    const struct patch *x = a, *y = b;
    if (x->first != y->first)
        return x->first < y->first ? -1 : 1;
    return (x->index > y->index) - (x->index < y->index);
}

/* Lists the patches, in the order of the chunks that they need if they do not fit at once. */
static int order_patches(struct tracing *tracing)
{
    if (tracing->seat_count == tracing->patch_count) {
        for (uint32_t i = 0; i < tracing->patch_count; i++)
            tracing->order[i] = (struct patch){.index = i};
        return 0;
    }
    int status = bsq_parallel_for(tracing->ctx, tracing->patch_count, bound_patch, tracing);
    if (status == 0)
        bsq_sort(tracing->order, tracing->patch_count, sizeof *tracing->order, compare_patches);
    return status;
}

/* ---- batches ---- */

/* Returns how many of the patches in seats need chunks from `end` on. */
static uint32_t count_waiting(const struct tracing *tracing, uint32_t end)
{
    uint32_t waiting = 0;
    for (uint32_t s = 0; s < tracing->taken; s++)
        waiting += tracing->seated[s].last >= end;
    return waiting;
}

/* Returns the first chunk from `end` on such that at most `most` patches in seats need it or later
 * ones. */
static uint32_t end_of_few(const struct tracing *tracing, uint32_t end, uint32_t most)
{
    for (uint32_t high = UINT32_MAX; end < high;) {
        const uint32_t middle = end + (high - end) / 2;
        if (count_waiting(tracing, middle) > most)
            end = middle + 1;
        else
            high = middle;
    }
    return end;
}

/* Gives seats to the next patches, as long as there are some. Returns the number after the last
 * chunk that the batch should meet: the first chunk of the patches without seats. If seats would
 * become short, the batch goes on until a sixteenth of them is free, and the next one meets some
 * chunks again. */
static uint32_t take_seats(struct tracing *tracing)
{
    const uint32_t most = tracing->seat_count - (tracing->seat_count + 15) / 16;
    tracing->taken = tracing->waiting;
    while (tracing->taken < tracing->seat_count && tracing->next < tracing->patch_count)
        tracing->seated[tracing->taken++] = tracing->order[tracing->next++];
    if (tracing->next == tracing->patch_count || !tracing->sweep)
        return UINT32_MAX;
    uint32_t end = tracing->order[tracing->next].first;
    if (end <= tracing->seated[tracing->waiting].first)
        end = tracing->seated[tracing->waiting].first + 1;
    end = end_of_few(tracing, end, most);
    for (; tracing->seated[tracing->taken - 1].first >= end; tracing->taken--)
        tracing->next--;
    return end;
}

/* Returns what a sample costs, as a multiple of its first ray. */
static uint32_t sample_cost(const struct bk_params *params)
{
    return 1 + bk_open_rays(params) + bk_solid_rays(params);
}

static void swap_bytes(void *a, void *b, size_t size)
{
    unsigned char *x = a, *y = b, other[4096];
    for (size_t i = 0; i < size; i += sizeof other) {
        const size_t n = size - i < sizeof other ? size - i : sizeof other;
        memcpy(other, x + i, n);
        memcpy(x + i, y + i, n);
        memcpy(y + i, other, n);
    }
}

/* Exchanges the patches of two seats. */
static void exchange_seats(const struct tracing *tracing, uint32_t a, uint32_t b)
{
    const uint64_t n = tracing->seat_rays, x = a * n, y = b * n, floats = transfer_floats(tracing);
    const struct patch patch = tracing->seated[a];
    tracing->seated[a] = tracing->seated[b];
    tracing->seated[b] = patch;
    swap_bytes(tracing->rays + x, tracing->rays + y, n * sizeof *tracing->rays);
    swap_bytes(tracing->hits + x, tracing->hits + y, n * sizeof *tracing->hits);
    swap_bytes(tracing->reaches + x, tracing->reaches + y, n * sizeof *tracing->reaches);
    if (tracing->footprints)
        swap_bytes(tracing->footprints + x, tracing->footprints + y,
                   n * sizeof *tracing->footprints);
    if (tracing->channels)
        swap_bytes(tracing->channels + x * floats, tracing->channels + y * floats,
                   n * floats * sizeof *tracing->channels);
}

/* Moves patches that need no chunk before `end` from seats [first, last) to the first ones of
 * these. Returns the number after their last seat. */
static uint32_t patches_gather(struct tracing *tracing, uint32_t first, uint32_t last, uint32_t end)
{
    for (uint32_t s = first; s < last; s++)
        if (tracing->seated[s].first >= end) {
            if (s > first)
                exchange_seats(tracing, s, first);
            first++;
        }
    return first;
}

/* Moves the patches that need chunks from `end` on from seats [first, taken) to the first ones of
 * these. */
static void keep_waiting(struct tracing *tracing, uint32_t first, uint32_t end)
{
    for (struct patch *p = tracing->seated + first; p < tracing->seated + tracing->taken; p++)
        if (p->last < end)
            p->first = 0;
        else
            set_chunks(tracing, end, p);
    tracing->waiting = patches_gather(tracing, first, tracing->taken, end);
}

/* Returns the texels of the patches that do not wait for chunks from `end` on. */
static uint64_t patches_count_texels(const struct tracing *tracing, uint32_t end)
{
    uint64_t texels = 0;
    for (uint32_t s = 0; s < tracing->taken; s++) {
        const struct bk_patch patch =
            bake_raster_patch(tracing->patches->raster, tracing->seated[s].index);
        texels += tracing->seated[s].last < end ? (uint64_t)patch.width * patch.height : 0;
    }
    return texels;
}

/* Returns the rays in the seats from `first` on. */
static struct bake_surface_rays rays_of(const struct tracing *tracing, uint32_t first)
{
    const struct bake_surface *surface = tracing->surface;
    const uint64_t begin = first * tracing->seat_rays;
    const uint32_t waiting = tracing->waiting - first;
    return (struct bake_surface_rays){
        .batch = {.rays = tracing->rays + begin,
                  .hits = tracing->hits + begin,
                  .count = (tracing->taken - first) * tracing->seat_rays,
                  .t_min = -surface->back,
                  .t_max = surface->front,
                  .reaches = tracing->reaches + begin,
                  .from_reach = tracing->patches->params->flags & BK_CAGE,
                  .footprints = tracing->footprints ? tracing->footprints + begin : NULL,
                  .footprint_table = tracing->footprint_table,
                  .channels = tracing->channels
                                  ? tracing->channels + begin * transfer_floats(tracing)
                                  : NULL,
                  .sweep = tracing->sweep,
                  .continued = waiting * tracing->seat_rays},
        .objects = tracing->objects ? tracing->objects + begin : NULL};
}

/* Traces the patches in the seats, and resolves those that do not wait then. */
static int run_batch(struct tracing *tracing)
{
    const struct bake_surface *surface = tracing->surface;
    const uint32_t end = take_seats(tracing);
    const uint64_t texels = patches_count_texels(tracing, end);
    /* The share of the progress that the first rays have. */
    const uint64_t first_texels = texels / sample_cost(tracing->patches->params);
    const uint32_t idle = patches_gather(tracing, 0, tracing->waiting, end);
    struct bake_surface_rays rays = rays_of(tracing, idle);
    rays.batch.progress = first_texels;
    rays.batch.first_chunk = tracing->seated[tracing->waiting].first;
    rays.batch.end_chunk = end;
    BSQ_PASS(
        bsq_parallel_for(tracing->ctx, tracing->taken - tracing->waiting, cast_patch, tracing));
    BSQ_PASS(bake_surface_trace(surface, &rays));
    BSQ_PASS(bake_surface_check(surface));
    keep_waiting(tracing, idle, end);
    rays = rays_of(tracing, tracing->waiting);
    if (tracing->patches->seen)
        BSQ_PASS(bake_seen_mark_hits(surface, tracing->patches->seen, &rays.batch));
    if (tracing->look && rays.batch.count > 0)
        BSQ_PASS(patches_look_around(tracing, &rays, texels - first_texels));
    if (tracing->next_hits)
        BSQ_PASS(look_beside(tracing, &rays));
    return bsq_parallel_for(tracing->ctx, tracing->taken - tracing->waiting, resolve_patch,
                            tracing);
}

static int run_batches(struct tracing *tracing)
{
    int status = 0;
    while (status == 0 && tracing->next < tracing->patch_count)
        status = run_batch(tracing);
    return status;
}

/* ---- memory ---- */

static int allocate_patches(struct tracing *tracing)
{
    bool wanted = false;
    tracing->patch_count = bake_raster_patch_count(tracing->patches->raster);
    BSQ_PASS(BSQ_ALLOC(tracing->ctx, "patches", tracing->patch_count, &tracing->order));
    for (uint32_t s = 0; s < tracing->surface->scan_count; s++)
        wanted |= tracing->surface->scans[s].exact &&
                  bake_exact_wants_footprints(tracing->surface->scans[s].exact);
    if (wanted) {
        BSQ_PASS(BSQ_ALLOC(tracing->ctx, "footprints", tracing->patches->triangle_count,
                           &tracing->footprint_table));
        measure_footprints(tracing);
    }
    return 0;
}

/* Returns whether batches can be parts of a sweep: only through one order of chunks. Rays that
 * start at hits need chunks around these, so that large batches load less. */
static bool can_sweep(const struct tracing *tracing)
{
    const uint32_t from_hits = BK_SECONDARY_MAPS | BAKE_MAP_CONFIDENCE;
    return tracing->surface->scan_count == 1 && tracing->surface->scans->exact &&
           !(tracing->patches->params->maps & from_hits);
}

/* Allocates as many seats as the budget allows, but at least one. */
static int allocate_rays(struct tracing *tracing)
{
    const bool sweeps = can_sweep(tracing);
    const uint64_t look =
        tracing->look ? sizeof *tracing->shares + sizeof *tracing->surroundings : 0;
    const uint64_t object = tracing->object_of ? sizeof *tracing->objects : 0;
    const uint64_t next =
        tracing->patches->params->maps & BAKE_MAP_CONFIDENCE ? sizeof *tracing->next_hits : 0;
    const uint64_t channels = transfer_floats(tracing) * sizeof *tracing->channels;
    struct bsq_ctx *ctx = tracing->ctx;
    uint64_t seats =
        bake_surface_capacity(tracing->surface, look + object + next + sizeof *tracing->reaches) /
        tracing->seat_rays;
    seats -= sweeps ? seats / 7 * 2 : 0; /* for the chunks that a sweep keeps */
    seats = seats < 1 ? 1 : seats;
    tracing->seat_count = seats < tracing->patch_count ? (uint32_t)seats : tracing->patch_count;
    const uint64_t n = tracing->seat_count * tracing->seat_rays;
    if (sweeps)
        BSQ_PASS(bake_exact_sweep_create(tracing->surface->scans->exact, n, &tracing->sweep));
    BSQ_PASS(BSQ_ALLOC(ctx, "patches", tracing->seat_count, &tracing->seated));
    BSQ_PASS(BSQ_ALLOC(ctx, "rays", n, &tracing->rays));
    BSQ_PASS(BSQ_ALLOC(ctx, "hits", n, &tracing->hits));
    BSQ_PASS(BSQ_ALLOC(ctx, "rays", n, &tracing->reaches));
    if (tracing->look) {
        BSQ_PASS(BSQ_ALLOC(ctx, "secondary rays", n, &tracing->shares));
        BSQ_PASS(BSQ_ALLOC(ctx, "secondary rays", n, &tracing->surroundings));
    }
    if (next > 0)
        BSQ_PASS(bsq_alloc(ctx, "hits", n, next, &tracing->next_hits));
    if (tracing->footprint_table)
        BSQ_PASS(BSQ_ALLOC(ctx, "footprints", n, &tracing->footprints));
    if (object > 0)
        BSQ_PASS(bsq_alloc(ctx, "objects of rays", n, object, &tracing->objects));
    if (channels > 0)
        BSQ_PASS(bsq_alloc(ctx, "channels of hits", n, channels, &tracing->channels));
    return 0;
}

static void patches_release(struct tracing *tracing, struct bake_report *report)
{
    bake_patch_workers_end(tracing->ctx, &tracing->workers, report);
    bake_look_free(tracing->look);
    BSQ_FREE(tracing->ctx, tracing->order, tracing->seated);
    bake_exact_sweep_free(tracing->sweep);
    BSQ_FREE(tracing->ctx, tracing->footprint_table, tracing->rays, tracing->hits,
             tracing->next_hits, tracing->reaches, tracing->footprints, tracing->objects,
             tracing->channels, tracing->shares, tracing->surroundings);
}

static int tell_losses(const struct bake_surface *surface)
{
    int status = 0;
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++)
        if (surface->scans[s].exact)
            status = bake_exact_tell_losses(surface->scans[s].exact);
    return status;
}

int bake_trace_ray_patches(const struct bake_surface *surface, const struct bake_patches *patches,
                           const uint32_t *object_of, struct bake_report *report)
{
    struct tracing tracing = {.ctx = surface->ctx,
                              .surface = surface,
                              .patches = patches,
                              .object_of = object_of,
                              .units_a_length = 1 / surface->unit};
    int status = 0;
    BSQ_TRY(bake_patch_workers_begin(tracing.ctx, patches,
                                     (uint64_t)patches->patch_side * square_side(&tracing),
                                     &tracing.workers));
    tracing.seat_rays = most_rays(&tracing);
    BSQ_TRY(allocate_patches(&tracing));
    if (patches->params->maps & BK_SECONDARY_MAPS)
        BSQ_TRY(bake_look_create(surface, tracing.patch_count * tracing.seat_rays, &tracing.look));
    BSQ_TRY(allocate_rays(&tracing));
    BSQ_TRY(order_patches(&tracing));
    BSQ_TRY(run_batches(&tracing));
    BSQ_TRY(tell_losses(surface));
done:
    patches_release(&tracing, report);
    return status;
}
