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
#include "libbake/surface/ray_patches.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"

/* Triangles within this distance of a hit, as a share of 1/2048 of the scan's longest side, belong
 * to the surface that was hit: more than rounding errors. */
#define NEXT_SHEET 0.02

/* A box grows by this share of its coordinates: more than the rounding errors of single precision
 * when it was computed. */
#define BOX_SLACK 1e-6f

/* Returns the most rays of a patch. */
static uint64_t most_rays(const struct tracing *tracing)
{
    const uint32_t n = tracing->patches->params->samples, side = square_side(tracing);
    const uint32_t squares = (tracing->patches->patch_side + side - 1) / side;
    return squares * squares * next_bundle((uint64_t)side * side * n * n);
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

/* ---- secondary rays ---- */

/* Looks from each hit along its ray, both ways, for the next surface that the ray could have hit.
 * The rays start at the hits from here on. */
static int look_beside(struct tracing *tracing, const struct bake_ray_batch *rays)
{
    const struct bake_surface *surface = tracing->surface;
    const double most = surface->front + surface->back, unit = surface->unit;
    const uint64_t first = tracing->waiting * tracing->seat_rays;
    const struct bake_ray_batch beside = {.rays = rays->rays,
                                          .hits = tracing->next_hits + first,
                                          .count = rays->count,
                                          .t_min = -most,
                                          .t_max = most,
                                          .gap = NEXT_SHEET * surface->detail,
                                          .distances_only = true,
                                          .objects = rays->objects};
    for (uint64_t i = first; i < first + rays->count; i++) {
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
static int patches_look_around(struct tracing *tracing, const struct bake_ray_batch *rays,
                               uint64_t progress)
{
    const uint64_t first = tracing->waiting * tracing->seat_rays;
    const struct bake_look_hits hits = {.rays = rays->rays,
                                        .hits = rays->hits,
                                        .shares = tracing->shares + first,
                                        .objects = rays->objects,
                                        .count = rays->count,
                                        .progress = progress};
    return bake_look_around(tracing->look, &hits, tracing->surroundings + first);
}

/* ---- ordering ---- */

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
static int order_patch(void *arg, uint64_t index, unsigned number)
{
    struct tracing *tracing = arg;
    struct patch *patch = &tracing->order[index];
    patch->index = (uint32_t)index;
    BSQ_PASS(BSQ_SIMD_PICK(tracing->simd, bake_bound_patch)(tracing, index, number));
    float middle[3];
    for (int k = 0; k < 3; k++) {
        const float slack = BOX_SLACK * fmaxf(fabsf(patch->low[k]), fabsf(patch->high[k]));
        middle[k] = 0.5f * (patch->low[k] + patch->high[k]);
        patch->low[k] -= slack;
        patch->high[k] += slack;
    }
    if (tracing->sweep) {
        set_chunks(tracing, 0, patch);
        return 0;
    }
    patch->first = (uint32_t)(bake_surface_curve_index(tracing->surface, middle) >> 2);
    patch->last = 0;
    return 0;
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
    int status = bsq_parallel_for(tracing->ctx, tracing->patch_count, order_patch, tracing);
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
static int exchange_seats(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct tracing *tracing = arg;
    const uint32_t a = tracing->exchanges[index][0], b = tracing->exchanges[index][1];
    const uint64_t n = tracing->seat_rays, x = a * n, y = b * n, values = transfer_floats(tracing);
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
        swap_bytes(tracing->channels + x * values, tracing->channels + y * values,
                   n * values * sizeof *tracing->channels);
    return 0;
}

/* Moves patches that need no chunk before `end` from seats [first, last) to the first ones of
 * these. Sets *after to the number after their last seat. */
static int patches_gather(struct tracing *tracing, uint32_t first, uint32_t last, uint32_t end,
                          uint32_t *after)
{
    uint32_t count = 0;
    for (;; count++) {
        for (; first < last && tracing->seated[first].first >= end; first++)
            ;
        for (; first < last && tracing->seated[last - 1].first < end; last--)
            ;
        if (first == last)
            break;
        tracing->exchanges[count][0] = first++;
        tracing->exchanges[count][1] = --last;
    }
    *after = first;
    return bsq_parallel_for(tracing->ctx, count, exchange_seats, tracing);
}

/* Moves the patches that need chunks from `end` on from seats [first, taken) to the first ones of
 * these. */
static int keep_waiting(struct tracing *tracing, uint32_t first, uint32_t end)
{
    for (struct patch *p = tracing->seated + first; p < tracing->seated + tracing->taken; p++)
        if (p->last < end)
            p->first = 0;
        else
            set_chunks(tracing, end, p);
    return patches_gather(tracing, first, tracing->taken, end, &tracing->waiting);
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
static struct bake_ray_batch rays_of(const struct tracing *tracing, uint32_t first)
{
    const struct bake_surface *surface = tracing->surface;
    const uint64_t begin = first * tracing->seat_rays;
    const uint32_t waiting = tracing->waiting - first;
    return (struct bake_ray_batch){
        .rays = tracing->rays + begin,
        .hits = tracing->hits + begin,
        .count = (tracing->taken - first) * tracing->seat_rays,
        .t_min = -surface->back,
        .t_max = surface->front,
        .reaches = tracing->reaches + begin,
        .from_reach = tracing->patches->params->flags & BK_CAGE,
        .footprints = tracing->footprints ? tracing->footprints + begin : NULL,
        .footprint_table = tracing->footprint_table,
        .channels = tracing->channels ? tracing->channels + begin * transfer_floats(tracing) : NULL,
        .sweep = tracing->sweep,
        .continued = waiting * tracing->seat_rays,
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
    uint32_t idle;
    BSQ_PASS(patches_gather(tracing, 0, tracing->waiting, end, &idle));
    struct bake_ray_batch rays = rays_of(tracing, idle);
    rays.progress = first_texels;
    rays.first_chunk = tracing->seated[tracing->waiting].first;
    rays.end_chunk = end;
    BSQ_PASS(bsq_parallel_for(tracing->ctx, tracing->taken - tracing->waiting,
                              BSQ_SIMD_PICK(tracing->simd, bake_cast_patch), tracing));
    BSQ_PASS(bake_surface_trace(surface, &rays));
    BSQ_PASS(bake_surface_check(surface));
    BSQ_PASS(keep_waiting(tracing, idle, end));
    rays = rays_of(tracing, tracing->waiting);
    if (tracing->look && rays.count > 0)
        BSQ_PASS(patches_look_around(tracing, &rays, texels - first_texels));
    if (tracing->next_hits)
        BSQ_PASS(look_beside(tracing, &rays));
    return bsq_parallel_for(tracing->ctx, tracing->taken - tracing->waiting,
                            BSQ_SIMD_PICK(tracing->simd, bake_resolve_patch), tracing);
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
    BSQ_PASS(BSQ_ALLOC(ctx, "patches", tracing->seat_count / 2, &tracing->exchanges));
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
    BSQ_FREE(tracing->ctx, tracing->order, tracing->seated, tracing->exchanges);
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
                              .simd = bsq_simd_best(),
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
