/* ray_patches.c - traces the samples of a map as batches of rays, against triangles and several
 * scans.
 *
 * The patches of a map form batches, each as large as the budget allows. Patches are ordered along
 * a curve through the scan, not through the map. So the rays that cross a chunk are in few batches,
 * whatever the layout of the charts. Each of the three passes over a patch rasterises it again,
 * which costs less than keeping the triangle of every sample. Rays and sums are computed by the
 * kernel's functions. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "libbake/kernel/bk_sample.h"

/* Triangles within this distance of a hit, as a share of 1/2048 of the scan's longest side, belong
 * to the surface that was hit: more than rounding errors. */
#define NEXT_SHEET 0.02

struct patch {
    uint64_t curve; /* on the curve through the scan */
    uint64_t rays;  /* of the squares with samples in triangles, see square_side() */
    uint32_t index; /* number of the patch in the raster */
};

struct job {
    struct bsq_ctx *ctx;
    const struct bake_surface *surface;
    const struct bake_patches *patches;
    const uint32_t *object_of;         /* of each triangle; NULL: not needed */
    double units_a_length;             /* of the surface, a world unit: 1 for triangles alone */
    struct bake_patch_workers workers; /* with sums for a row of squares, see square_side() */
    struct patch *order;
    uint32_t patch_count;
    struct bake_exact_footprint *footprint_table; /* of each triangle; NULL: not needed */
    /* The current batch: patches order[first .. first + count). */
    uint32_t first, count;
    uint64_t *starts; /* patch_count + 1: first ray of order[i], counted over all batches */
    struct bake_exact_ray *rays;
    struct bake_exact_hit *hits;
    struct bake_exact_hit *next; /* beside these hits, for `confidence`; else NULL */
    float *reaches;
    uint32_t *footprints, *objects;
    float *channels; /* of each hit: values of transfer maps; NULL: there are none */
    uint64_t capacity;
    /* For maps of secondary rays; else NULL. */
    struct bake_look *look;
    struct bk_share *shares;
    struct bk_surroundings *surroundings;
};

/* ---- counting and ordering ---- */

/* Returns where the centre of a triangle of the low-poly mesh lies on the curve. */
static uint64_t curve_index(const struct job *job, uint32_t triangle)
{
    const struct bk_triangle *t = &job->patches->triangles[triangle];
    float centre[3];
    for (int k = 0; k < 3; k++)
        centre[k] = (t->position[0][k] + t->position[1][k] + t->position[2][k]) / 3.0f;
    return bake_surface_curve_index(job->surface, centre);
}

static uint32_t patch_samples(const struct job *job, const struct bk_patch *patch)
{
    const uint32_t n = job->patches->params->samples;
    return patch->width * n * (patch->height * n);
}

/* Returns the side in texels of the squares by which the samples of a patch are numbered. Rays of a
 * square meet fewer triangles of the scan than those of a line. */
static uint32_t square_side(const struct job *job)
{
    const uint32_t n = job->patches->params->samples;
    return (3 + n) / n;
}

/* Returns the next multiple of a bundle's rays. Each square begins a bundle. */
static uint64_t next_bundle(uint64_t ray)
{
    return (ray + BAKE_EXACT_BUNDLE - 1) / BAKE_EXACT_BUNDLE * BAKE_EXACT_BUNDLE;
}

/* Returns the number of samples of a square that lie in a triangle. column, row: of its first texel
 * in the patch. */
static uint32_t square_samples(const struct job *job, const struct bk_patch *patch, uint32_t column,
                               uint32_t row, const uint32_t *samples)
{
    const uint32_t n = job->patches->params->samples, side = square_side(job);
    const uint32_t width = (side < patch->width - column ? side : patch->width - column) * n;
    const uint32_t height = (side < patch->height - row ? side : patch->height - row) * n;
    uint32_t covered = 0;
    for (uint32_t line = row * n; line < row * n + height; line++) {
        const uint32_t *at = samples + ((uint64_t)line * patch->width + column) * n;
        for (uint32_t i = 0; i < width; i++)
            covered += at[i] != BK_NO_TRIANGLE;
    }
    return covered;
}

/* Counts the rays of a patch, and places the patch on the curve by its middle sample. */
static int count_patch(void *arg, uint64_t index, unsigned number)
{
    struct job *job = arg;
    struct bake_patch_worker *worker = &job->workers.workers[number];
    const struct bk_patch patch = bake_raster_patch(job->patches->raster, (uint32_t)index);
    const uint32_t all = patch_samples(job, &patch), side = square_side(job);
    const uint32_t *samples = worker->sample_triangles;
    uint64_t overlaps = 0, rays = 0;
    uint32_t covered = 0, seen = 0;
    int status = bake_raster_fill(job->patches->raster, (uint32_t)index, worker->sample_triangles,
                                  &overlaps);
    if (status < 0)
        return status;
    worker->overlaps += overlaps;
    for (uint32_t row = 0; row < patch.height; row += side)
        for (uint32_t column = 0; column < patch.width; column += side) {
            const uint32_t here = square_samples(job, &patch, column, row, samples);
            covered += here;
            rays += next_bundle(here);
        }
    job->order[index] = (struct patch){.index = (uint32_t)index, .rays = rays};
    for (uint32_t i = 0; i < all; i++)
        if (samples[i] != BK_NO_TRIANGLE && seen++ == covered / 2) {
            job->order[index].curve = curve_index(job, samples[i]);
            break;
        }
    return 0;
}

static int compare_patches(const void *a, const void *b)
{
    const struct patch *x = a, *y = b;
    if (x->curve != y->curve)
        return x->curve < y->curve ? -1 : 1;
    return (x->index > y->index) - (x->index < y->index);
}

static int order_patches(struct job *job)
{
    int status = bsq_parallel_for(job->ctx, job->patch_count, count_patch, job);
    if (status < 0)
        return status;
    bsq_sort(job->order, job->patch_count, sizeof *job->order, compare_patches);
    job->starts[0] = 0;
    for (uint32_t i = 0; i < job->patch_count; i++)
        job->starts[i + 1] = job->starts[i] + job->order[i].rays;
    return 0;
}

/* ---- samples to rays ---- */

/* A sample of a patch that lies in a triangle. */
struct sample {
    uint32_t triangle, column; /* column: of the patch's texels */
    float x, y;                /* map position in texels */
    bk_point point;            /* of the low-poly mesh */
    uint64_t ray;              /* its number in the batch */
};

/* Calls `take` for the samples of a line of a square that lie in a triangle, from the left. column,
 * end: its texels in the patch. */
static inline void
each_sample_of_line(struct job *job, const struct bk_patch *patch, const uint32_t *samples,
                    uint32_t line, uint32_t column, uint32_t end, uint64_t *ray,
                    void (*take)(struct job *job, const struct sample *sample, float *texels),
                    float *texels)
{
    const struct bk_params *params = job->patches->params;
    const uint32_t n = params->samples;
    const float y = bk_sample_position(patch->y + line / n, line % n, n);
    uint64_t index = ((uint64_t)line * patch->width + column) * n;
    for (; column < end; column++)
        for (uint32_t i = 0; i < n; i++, index++) {
            struct sample sample = {.triangle = samples[index], .column = column, .y = y};
            if (sample.triangle == BK_NO_TRIANGLE)
                continue;
            const struct bk_triangle *triangle = &job->patches->triangles[sample.triangle];
            sample.x = bk_sample_position(patch->x + column, i, n);
            sample.point = bk_point_at(triangle, sample.x, y);
            if (params->flags & BK_SKEW)
                bk_set_lane3(&sample.point.direction, 0,
                             bk_skewed(triangle, bk_lane3(&sample.point.direction, 0),
                                       bk_sample_skew(params, patch, samples, index)));
            sample.ray = (*ray)++;
            take(job, &sample, texels);
        }
}

/* Calls `take` for the samples of a row of squares that lie in a triangle: square by square, and
 * line by line in each. Their rays are numbered from *ray on, with gaps between squares. row: of
 * the first texels. samples: of the patch. texels: of the row, line by line; NULL: not needed. */
static inline void each_sample_of_row(struct job *job, const struct bk_patch *patch,
                                      const uint32_t *samples, uint32_t row, uint64_t *ray,
                                      void (*take)(struct job *job, const struct sample *sample,
                                                   float *texels),
                                      float *texels)
{
    const uint32_t n = job->patches->params->samples, side = square_side(job);
    const uint32_t rows = side < patch->height - row ? side : patch->height - row;
    const uint64_t floats = texels ? (uint64_t)patch->width * job->workers.texel_floats : 0;
    for (uint32_t column = 0; column < patch->width; column += side) {
        const uint32_t end = side < patch->width - column ? column + side : patch->width;
        *ray = next_bundle(*ray);
        for (uint32_t line = 0; line < rows * n; line++)
            each_sample_of_line(job, patch, samples, row * n + line, column, end, ray, take,
                                texels ? texels + line / n * floats : NULL);
    }
}

/* Calls `take` for each sample of the patch with this index in the batch that lies in a triangle.
 */
static inline int each_sample(struct job *job, uint64_t index, unsigned worker,
                              void (*take)(struct job *job, const struct sample *sample,
                                           float *texels))
{
    const struct patch *entry = &job->order[job->first + index];
    const struct bk_patch patch = bake_raster_patch(job->patches->raster, entry->index);
    uint32_t *samples = job->workers.workers[worker].sample_triangles;
    uint64_t overlaps, ray = job->starts[job->first + index] - job->starts[job->first];
    int status = bake_raster_fill(job->patches->raster, entry->index, samples, &overlaps);
    for (uint32_t row = 0; row < patch.height && status == 0; row += square_side(job))
        each_sample_of_row(job, &patch, samples, row, &ray, take, NULL);
    return status;
}

static void cast_sample(struct job *job, const struct sample *sample, float *texels)
{
    (void)texels;
    const bk_start start = bk_start_at(job->patches->params, &sample->point);
    job->rays[sample->ray] =
        (struct bake_exact_ray){{start.origin.x, start.origin.y, start.origin.z},
                                {start.direction.x, start.direction.y, start.direction.z}};
    job->reaches[sample->ray] = start.reach * job->patches->params->unit;
    if (job->footprints)
        job->footprints[sample->ray] = sample->triangle;
    if (job->objects)
        job->objects[sample->ray] = job->object_of[sample->triangle];
}

/* Writes the rays of a patch to the batch. Those between squares have no direction. */
static int cast_patch(void *arg, uint64_t index, unsigned number)
{
    struct job *job = arg;
    const uint64_t *starts = &job->starts[job->first + index];
    const uint64_t begin = starts[0] - job->starts[job->first], count = starts[1] - starts[0];
    memset(job->rays + begin, 0, count * sizeof *job->rays);
    memset(job->reaches + begin, 0, count * sizeof *job->reaches);
    if (job->objects)
        memset(job->objects + begin, 0, count * sizeof *job->objects);
    return each_sample(arg, index, number, cast_sample);
}

static void measure_footprints(const struct job *job)
{
    const float step = job->patches->params->unit / (float)job->patches->params->samples;
    for (uint32_t t = 0; t < job->patches->triangle_count; t++) {
        const struct bk_triangle *triangle = &job->patches->triangles[t];
        for (int s = 0; s < 2; s++)
            for (int k = 0; k < 3; k++)
                job->footprint_table[t].step[s][k] =
                    step *
                    (triangle->b1[s] * (triangle->position[1][k] - triangle->position[0][k]) +
                     triangle->b2[s] * (triangle->position[2][k] - triangle->position[0][k]));
    }
}

/* ---- hits to texels ---- */

/* Turns the hit of a ray into a hit for maps. */
static bk_map_hits place_hit(const struct job *job, const bk_point *point,
                             const struct bake_exact_hit *hit)
{
    const bk_hits hits = {.found = hit->triangle != BAKE_EXACT_NONE,
                          .reversed = hit->reversed,
                          .t = (float)(hit->t * job->units_a_length),
                          .normal = {hit->normal[0], hit->normal[1], hit->normal[2]},
                          .color = {hit->color[0], hit->color[1], hit->color[2]},
                          .id = (bk_int)hit->id};
    const bk_start start = bk_start_at(job->patches->params, point);
    bk_map_hits placed;
    bk_hits_for_maps(job->patches->params, point, &start, &hits, &placed);
    return placed;
}

/* Returns the number of values that transfer maps have of a hit. */
static uint64_t transfer_floats(const struct job *job)
{
    return (uint64_t)BK_TRANSFER_VALUES * bk_transfers(job->patches->params->maps);
}

/* Sets the confidence in a sample's hit. */
static void set_confidence(const struct job *job, const struct sample *sample, bk_map_hits *placed)
{
    const struct bk_params *params = job->patches->params;
    const struct bake_exact_hit *hit = &job->hits[sample->ray], *beside = &job->next[sample->ray];
    const bk_start start = bk_start_at(params, &sample->point);
    const bk_hits hits = {.t = (float)(hit->t * job->units_a_length), .normal = placed->normal};
    const float way = (float)(beside->t * job->units_a_length), t = hits.t + way;
    const bool other =
        beside->triangle != BAKE_EXACT_NONE && t >= -params->back && t <= start.t_max;
    bk_set_confidence(params, &start, &hits, other ? fabsf(way) : BK_FAR, placed);
}

/* Adds a sample to its texel. texels: the row of it. */
static void add_sample(struct job *job, const struct sample *sample, float *texels)
{
    const struct bk_params *params = job->patches->params;
    float *texel = texels + sample->column * job->workers.texel_floats;
    bk_map_hits placed = place_hit(job, &sample->point, &job->hits[sample->ray]);
    if (job->next)
        set_confidence(job, sample, &placed);
    if (job->look)
        bk_surroundings_for_maps(params, &sample->point, &job->surroundings[sample->ray], &placed);
    bk_add_sample(params, &placed, 0, texel);
    if (job->channels && placed.found)
        bk_add_transfers(params->maps, job->channels + sample->ray * transfer_floats(job), texel);
}

/* Sums and resolves a patch, and writes it to the image. */
static int resolve_patch(void *arg, uint64_t index, unsigned number)
{
    struct job *job = arg;
    struct bake_patch_worker *worker = &job->workers.workers[number];
    const struct patch *entry = &job->order[job->first + index];
    const struct bk_patch patch = bake_raster_patch(job->patches->raster, entry->index);
    uint64_t overlaps, next = job->starts[job->first + index] - job->starts[job->first];
    int status =
        bake_raster_fill(job->patches->raster, entry->index, worker->sample_triangles, &overlaps);
    if (status < 0)
        return status;
    for (uint32_t row = 0; row < patch.height; row += square_side(job)) {
        const uint32_t left = patch.height - row,
                       rows = left < square_side(job) ? left : square_side(job);
        const uint32_t texels = rows * patch.width;
        memset(worker->texels, 0,
               (uint64_t)texels * job->workers.texel_floats * sizeof *worker->texels);
        /* Each texel gets its samples in the same order as in the kernel. */
        each_sample_of_row(job, &patch, worker->sample_triangles, row, &next, add_sample,
                           worker->texels);
        bake_patch_worker_resolve(&job->workers, worker, texels,
                                  worker->resolved +
                                      (size_t)row * patch.width * job->workers.channels);
    }
    return bake_image_write_patch(job->patches->image, &patch, worker->resolved);
}

/* ---- secondary rays ---- */

/* Sets which of its texel's directions a sample has. */
static void share_sample(struct job *job, const struct sample *sample, float *texels)
{
    (void)texels;
    job->shares[sample->ray] = bk_sample_share(sample->x, sample->y, job->patches->params->samples);
}

/* Prepares the hits of a patch's rays. */
static int share_patch(void *arg, uint64_t index, unsigned number)
{
    return each_sample(arg, index, number, share_sample);
}

/* Looks from each hit along its ray, both ways, for the next surface that the ray could have hit.
 * The rays start at the hits from here on. */
static int look_beside(struct job *job, const struct bake_surface_rays *rays)
{
    const struct bake_surface *surface = job->surface;
    const double most = surface->front + surface->back, unit = surface->unit;
    const struct bake_surface_rays beside = {.batch = {.rays = job->rays,
                                                       .hits = job->next,
                                                       .count = rays->batch.count,
                                                       .t_min = -most,
                                                       .t_max = most,
                                                       .gap = NEXT_SHEET * surface->detail,
                                                       .distances_only = true},
                                             .objects = job->objects};
    for (uint64_t i = 0; i < rays->batch.count; i++) {
        const bool found = job->hits[i].triangle != BAKE_EXACT_NONE;
        struct bake_exact_ray *ray = &job->rays[i];
        for (int k = 0; k < 3; k++) {
            ray->origin[k] += found ? (float)(job->hits[i].t / unit) * ray->direction[k] : 0;
            ray->direction[k] = found ? ray->direction[k] : 0;
        }
    }
    return bake_surface_trace(surface, &beside);
}

/* Traces the rays from all hits of the batch. */
static int look_around(struct job *job, uint64_t count, uint64_t progress)
{
    const struct bake_look_hits hits = {.rays = job->rays,
                                        .hits = job->hits,
                                        .shares = job->shares,
                                        .objects = job->objects,
                                        .count = count,
                                        .progress = progress};
    int status = bsq_parallel_for(job->ctx, job->count, share_patch, job);
    return status < 0 ? status : bake_look_around(job->look, &hits, job->surroundings);
}

/* ---- batches ---- */

/* Takes the next patches, as many as fit. Returns the number of their texels. */
static uint64_t choose_batch(struct job *job)
{
    uint64_t texels = 0;
    job->first += job->count;
    job->count = 0;
    while (job->first + job->count < job->patch_count) {
        const uint32_t next = job->first + job->count;
        const struct bk_patch patch =
            bake_raster_patch(job->patches->raster, job->order[next].index);
        if (job->starts[next + 1] - job->starts[job->first] > job->capacity)
            break;
        texels += (uint64_t)patch.width * patch.height;
        job->count++;
    }
    return texels;
}

/* Returns what a sample costs, as a multiple of its first ray. */
static uint32_t sample_cost(const struct bk_params *params)
{
    return 1 + bk_open_rays(params) + bk_solid_rays(params);
}

static int run_batch(struct job *job, uint64_t texels)
{
    const struct bake_surface *surface = job->surface;
    const uint64_t count = job->starts[job->first + job->count] - job->starts[job->first];
    /* The share of the progress that the first rays have. */
    const uint64_t first_texels = texels / sample_cost(job->patches->params);
    const struct bake_surface_rays rays = {
        .batch = {.rays = job->rays,
                  .hits = job->hits,
                  .count = count,
                  .t_min = -surface->back,
                  .t_max = surface->front,
                  .reaches = job->reaches,
                  .from_reach = job->patches->params->flags & BK_CAGE,
                  .footprints = job->footprints,
                  .footprint_table = job->footprint_table,
                  .channels = job->channels,
                  .progress = first_texels},
        .objects = job->objects};
    int status = 0;
    BSQ_TRY(bsq_parallel_for(job->ctx, job->count, cast_patch, job));
    BSQ_TRY(bake_surface_trace(surface, &rays));
    BSQ_TRY(bake_surface_check(surface));
    if (job->patches->seen)
        BSQ_TRY(bake_seen_mark_hits(surface, job->patches->seen, &rays.batch));
    if (job->look && count > 0)
        BSQ_TRY(look_around(job, count, texels - first_texels));
    if (job->next)
        BSQ_TRY(look_beside(job, &rays));
    BSQ_TRY(bsq_parallel_for(job->ctx, job->count, resolve_patch, job));
done:
    return status;
}

static int run_batches(struct job *job)
{
    int status = 0;
    while (status == 0) {
        const uint64_t texels = choose_batch(job);
        if (job->count == 0)
            break;
        status = run_batch(job, texels);
    }
    return status;
}

/* ---- memory ---- */

static int allocate_patches(struct job *job)
{
    bool wanted = false;
    int status = 0;
    job->patch_count = bake_raster_patch_count(job->patches->raster);
    BSQ_TRY(bsq_alloc(job->ctx, "patches", job->patch_count, sizeof *job->order, &job->order));
    BSQ_TRY(bsq_alloc(job->ctx, "patches", (uint64_t)job->patch_count + 1, sizeof *job->starts,
                      &job->starts));
    for (uint32_t s = 0; s < job->surface->scan_count; s++)
        wanted |= job->surface->scans[s].exact &&
                  bake_exact_wants_footprints(job->surface->scans[s].exact);
    if (wanted) {
        BSQ_TRY(bsq_alloc(job->ctx, "footprints", job->patches->triangle_count,
                          sizeof *job->footprint_table, &job->footprint_table));
        measure_footprints(job);
    }
done:
    return status;
}

/* Allocates as many rays as the budget allows, but at least those of the largest patch. */
static int allocate_rays(struct job *job)
{
    const uint64_t all = job->starts[job->patch_count];
    const uint64_t look = job->look ? sizeof *job->shares + sizeof *job->surroundings : 0;
    const uint64_t object = job->object_of ? sizeof *job->objects : 0;
    const uint64_t next = job->patches->params->maps & BAKE_MAP_CONFIDENCE ? sizeof *job->next : 0;
    const uint64_t channels = transfer_floats(job) * sizeof *job->channels;
    struct bsq_ctx *ctx = job->ctx;
    int status = 0;
    job->capacity =
        bake_surface_capacity(job->surface, look + object + next + sizeof *job->reaches);
    for (uint32_t i = 0; i < job->patch_count; i++)
        if (job->order[i].rays > job->capacity)
            job->capacity = job->order[i].rays;
    if (job->capacity > all)
        job->capacity = all;
    const uint64_t n = job->capacity;
    BSQ_TRY(bsq_alloc(ctx, "rays", n, sizeof *job->rays, &job->rays));
    BSQ_TRY(bsq_alloc(ctx, "hits", n, sizeof *job->hits, &job->hits));
    BSQ_TRY(bsq_alloc(ctx, "rays", n, sizeof *job->reaches, &job->reaches));
    if (job->look) {
        BSQ_TRY(bsq_alloc(ctx, "secondary rays", n, sizeof *job->shares, &job->shares));
        BSQ_TRY(bsq_alloc(ctx, "secondary rays", n, sizeof *job->surroundings, &job->surroundings));
    }
    if (next > 0)
        BSQ_TRY(bsq_alloc(ctx, "hits", n, next, &job->next));
    if (job->footprint_table)
        BSQ_TRY(bsq_alloc(ctx, "footprints", n, sizeof *job->footprints, &job->footprints));
    if (object > 0)
        BSQ_TRY(bsq_alloc(ctx, "objects of rays", n, object, &job->objects));
    if (channels > 0)
        BSQ_TRY(bsq_alloc(ctx, "channels of hits", n, channels, &job->channels));
done:
    return status;
}

static void release(struct job *job, struct bake_report *report)
{
    bake_patch_workers_end(job->ctx, &job->workers, report);
    bake_look_free(job->look);
    bsq_free(job->ctx, job->order);
    bsq_free(job->ctx, job->starts);
    bsq_free(job->ctx, job->footprint_table);
    bsq_free(job->ctx, job->rays);
    bsq_free(job->ctx, job->hits);
    bsq_free(job->ctx, job->next);
    bsq_free(job->ctx, job->reaches);
    bsq_free(job->ctx, job->footprints);
    bsq_free(job->ctx, job->objects);
    bsq_free(job->ctx, job->channels);
    bsq_free(job->ctx, job->shares);
    bsq_free(job->ctx, job->surroundings);
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
    struct job job = {.ctx = surface->ctx,
                      .surface = surface,
                      .patches = patches,
                      .object_of = object_of,
                      .units_a_length = 1 / surface->unit};
    int status = 0;
    BSQ_TRY(bake_patch_workers_begin(
        job.ctx, patches, (uint64_t)patches->patch_side * square_side(&job), &job.workers));
    BSQ_TRY(allocate_patches(&job));
    BSQ_TRY(order_patches(&job));
    if (patches->params->maps & BK_SECONDARY_MAPS)
        BSQ_TRY(bake_look_create(surface, job.starts[job.patch_count], &job.look));
    BSQ_TRY(allocate_rays(&job));
    BSQ_TRY(run_batches(&job));
    BSQ_TRY(tell_losses(surface));
done:
    release(&job, report);
    return status;
}
