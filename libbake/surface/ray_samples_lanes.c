/* ray_samples_lanes.c - turns samples of patches into rays, and their hits into texels, BK_WIDTH at
 * a time, by the kernel's functions. */
#include <math.h>
#include <string.h>

#include "base/simd/simd.h"
#define BK_WIDTH SIMD_FLOATS
#include "libbake/kernel/bk_sample.h"
#include "libbake/surface/ray_patches.h"

/* Samples of a patch that lie in triangles. */
struct group {
    bk_samples samples;
    uint64_t rays[BK_WIDTH]; /* their numbers in the batch */
};

/* Does something with the samples of a group. into: where the result goes. */
typedef void take_group_fn(struct tracing *tracing, const struct group *group,
                           const bk_point *points, void *into);

/* Calls `take` for a group, and empties it. */
static inline void samples_take_group(struct tracing *tracing, struct group *group,
                                      take_group_fn *take, void *into)
{
    if (group->samples.count == 0)
        return;
    const bk_point points =
        bk_points_at(tracing->patches->params, tracing->patches->triangles, &group->samples);
    take(tracing, group, &points, into);
    group->samples.count = 0;
}

/* Calls `take` for the samples of a row of squares that lie in a triangle: square by square, and
 * line by line in each. Their rays are numbered from *ray on, with gaps between squares. row: of
 * the first texels. */
static inline void each_sample_of_row(struct tracing *tracing, const struct bk_patch *patch,
                                      const struct bake_patch_worker *worker, uint32_t row,
                                      uint64_t *ray, take_group_fn *take, void *into)
{
    const struct bk_params *params = tracing->patches->params;
    const uint32_t *triangles = worker->sample_triangles;
    const uint32_t n = params->samples, side = square_side(tracing), width = patch->width;
    const uint32_t rows = side < patch->height - row ? side : patch->height - row;
    struct group group = {.samples.count = 0};
    bk_samples *samples = &group.samples;
    for (uint32_t column = 0; column < width; column += side) {
        const uint32_t end = side < width - column ? column + side : width;
        *ray = next_bundle(*ray);
        for (uint32_t line = row * n; line < (row + rows) * n; line++) {
            const float y = bk_sample_position(patch->y + line / n, line % n, n);
            uint64_t index = ((uint64_t)line * width + column) * n;
            uint64_t texel = (line / n - row) * (uint64_t)width + column;
            for (uint32_t x = column; x < end; x++, texel++)
                for (uint32_t i = 0; i < n; i++, index++) {
                    if (triangles[index] == BK_NO_TRIANGLE)
                        continue;
                    const uint32_t lane = samples->count++;
                    samples->triangle[lane] = triangles[index];
                    samples->x[lane] = bk_sample_position(patch->x + x, i, n);
                    samples->y[lane] = y;
                    samples->skew[lane] = bk_sample_skew(params, patch, triangles, index);
                    samples->texel[lane] = worker->texels + texel * tracing->workers.texel_floats;
                    group.rays[lane] = (*ray)++;
                    if (samples->count == BK_WIDTH)
                        samples_take_group(tracing, &group, take, into);
                }
        }
    }
    samples_take_group(tracing, &group, take, into);
}

/* Calls `take` for the samples of a patch that lie in a triangle. ray: number of the first one's.
 */
static inline int each_sample(struct tracing *tracing, uint32_t index, uint64_t ray,
                              unsigned number, take_group_fn *take, void *into)
{
    const struct bk_patch patch = bake_raster_patch(tracing->patches->raster, index);
    const struct bake_patch_worker *worker = &tracing->workers.workers[number];
    uint64_t overlaps;
    int status =
        bake_raster_fill(tracing->patches->raster, index, worker->sample_triangles, &overlaps);
    for (uint32_t row = 0; row < patch.height && status == 0; row += square_side(tracing))
        each_sample_of_row(tracing, &patch, worker, row, &ray, take, into);
    return status;
}

/* ---- samples to rays ---- */

static void cast_group(struct tracing *tracing, const struct group *group, const bk_point *points,
                       void *into)
{
    (void)into;
    const struct bk_params *params = tracing->patches->params;
    const bk_samples *samples = &group->samples;
    const bk_start start = bk_start_at(params, points);
    const bk_fw reaches = start.reach * params->unit;
    for (uint32_t lane = 0; lane < samples->count; lane++) {
        const uint64_t ray = group->rays[lane];
        bk_copy_lane(&start.origin, lane, tracing->rays[ray].origin);
        bk_copy_lane(&start.direction, lane, tracing->rays[ray].direction);
        tracing->reaches[ray] = bk_lane(reaches, lane);
        if (tracing->footprints)
            tracing->footprints[ray] = samples->triangle[lane];
        if (tracing->objects)
            tracing->objects[ray] = tracing->object_of[samples->triangle[lane]];
        if (tracing->shares)
            tracing->shares[ray] =
                bk_sample_share(samples->x[lane], samples->y[lane], params->samples);
    }
}

int BSQ_SIMD_NAME(bake_cast_patch)(void *arg, uint64_t index, unsigned number)
{
    struct tracing *tracing = arg;
    const uint64_t seat = tracing->waiting + index, begin = seat * tracing->seat_rays;
    memset(tracing->rays + begin, 0, tracing->seat_rays * sizeof *tracing->rays);
    memset(tracing->reaches + begin, 0, tracing->seat_rays * sizeof *tracing->reaches);
    if (tracing->objects)
        memset(tracing->objects + begin, 0, tracing->seat_rays * sizeof *tracing->objects);
    return each_sample(tracing, tracing->seated[seat].index, begin, number, cast_group, NULL);
}

/* The box of rays, lane by lane. */
struct bounds {
    bk_fw low[3], high[3];
};

/* Grows a box by the ways of samples' rays. Lanes without a sample have that of the first one. */
static void bound_group(struct tracing *tracing, const struct group *group, const bk_point *points,
                        void *into)
{
    (void)group;
    const struct bk_params *params = tracing->patches->params;
    const bk_start start = bk_start_at(params, points);
    const bk_fw origin[3] = {start.origin.x, start.origin.y, start.origin.z};
    const bk_fw direction[3] = {start.direction.x, start.direction.y, start.direction.z};
    struct bounds *bounds = into;
    for (int k = 0; k < 3; k++) {
        const bk_fw a = origin[k] + params->front * direction[k],
                    b = origin[k] - params->back * direction[k];
        bounds->low[k] = bk_minw(bk_minw(a, b), bounds->low[k]);
        bounds->high[k] = bk_maxw(bk_maxw(a, b), bounds->high[k]);
    }
}

int BSQ_SIMD_NAME(bake_bound_patch)(void *arg, uint64_t index, unsigned number)
{
    struct tracing *tracing = arg;
    struct patch *patch = &tracing->order[index];
    struct bounds bounds;
    for (int k = 0; k < 3; k++) {
        bounds.low[k] = bk_splat(INFINITY);
        bounds.high[k] = bk_splat(-INFINITY);
    }
    const int status = each_sample(tracing, patch->index, 0, number, bound_group, &bounds);
    for (int k = 0; k < 3; k++) {
        patch->low[k] = INFINITY;
        patch->high[k] = -INFINITY;
        for (int lane = 0; lane < BK_WIDTH; lane++) {
            patch->low[k] = fminf(patch->low[k], bk_lane(bounds.low[k], lane));
            patch->high[k] = fmaxf(patch->high[k], bk_lane(bounds.high[k], lane));
        }
    }
    return status;
}

/* ---- hits to texels ---- */

/* Gathers the hits of a group's rays. */
static bk_hits hits_of(const struct tracing *tracing, const struct group *group)
{
    bk_hits hits = {0};
    for (uint32_t lane = 0; lane < group->samples.count; lane++) {
        const struct bake_hit *hit = &tracing->hits[group->rays[lane]];
        hits.found |= (bk_uint)(hit->triangle != BAKE_NO_HIT) << lane;
        hits.reversed |= (bk_uint)hit->reversed << lane;
        bk_set_lane(hits.t, lane, (float)(hit->t * tracing->units_a_length));
        bk_set_lane3(&hits.normal, lane, bk_v3(hit->normal[0], hit->normal[1], hit->normal[2]));
        bk_set_lane3(&hits.color, lane, bk_v3(hit->color[0], hit->color[1], hit->color[2]));
        bk_set_lane(hits.id, lane, (bk_int)hit->id);
    }
    return hits;
}

/* Sets the confidence in hits. */
static void samples_set_confidence(const struct tracing *tracing, const struct group *group,
                                   const bk_start *start, const bk_hits *hits, bk_map_hits *placed)
{
    const struct bk_params *params = tracing->patches->params;
    bk_fw next = bk_splat(BK_FAR);
    for (uint32_t lane = 0; lane < group->samples.count; lane++) {
        const struct bake_hit *beside = &tracing->next_hits[group->rays[lane]];
        const float way = (float)(beside->t * tracing->units_a_length),
                    t = bk_lane(hits->t, lane) + way;
        if (beside->triangle != BAKE_NO_HIT && t >= -params->back &&
            t <= bk_lane(start->t_max, lane))
            bk_set_lane(next, lane, fabsf(way));
    }
    bk_set_confidence(params, start, hits, next, placed);
}

/* Adds samples to their texels. */
static void sum_group(struct tracing *tracing, const struct group *group, const bk_point *points,
                      void *into)
{
    (void)into;
    const struct bk_params *params = tracing->patches->params;
    const bk_start start = bk_start_at(params, points);
    const bk_hits hits = hits_of(tracing, group);
    bk_map_hits placed;
    bk_hits_for_maps(params, points, &start, &hits, &placed);
    if (tracing->next_hits)
        samples_set_confidence(tracing, group, &start, &hits, &placed);
    if (tracing->look) {
        bk_surroundings sums[BK_WIDTH] = {{.open = 0}};
        for (uint32_t lane = 0; lane < group->samples.count; lane++)
            sums[lane] = tracing->surroundings[group->rays[lane]];
        bk_surroundings_for_maps(params, points, sums, &placed);
    }
    for (uint32_t lane = 0; lane < group->samples.count; lane++) {
        float *texel = group->samples.texel[lane];
        if (tracing->workers.more > 0 &&
            texel[BK_COVERED] == 0) /* the object of the first sample */
            memcpy(texel + tracing->workers.texel_floats - 1,
                   &tracing->object_of[group->samples.triangle[lane]], sizeof *texel);
        bk_add_sample(params, &placed, lane, texel);
        if (tracing->channels && placed.found >> lane & 1)
            bk_add_transfers(params->maps,
                             tracing->channels + group->rays[lane] * transfer_floats(tracing),
                             texel);
    }
}

int BSQ_SIMD_NAME(bake_resolve_patch)(void *arg, uint64_t index, unsigned number)
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
        each_sample_of_row(tracing, &patch, worker, row, &next, sum_group, NULL);
        bake_patch_worker_resolve(&tracing->workers, worker, texels,
                                  worker->resolved +
                                      (size_t)row * patch.width * tracing->workers.channels);
    }
    return bake_image_write_patch(tracing->patches->image, &patch, worker->resolved);
}
