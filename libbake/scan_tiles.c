/* scan_tiles.c - traces a tile of maps on several scans.
 *
 * Each scan is traced as if it were alone, by the functions for a single scan, so all devices and
 * all kinds of scans can be baked together. A texel of these images is a sample of the map. Of all
 * scans, each sample keeps its nearest hit. Secondary rays are traced when these are known. Then
 * the samples are summed as the kernel sums them. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/scan_rays.h"

/* No ray starts as far away as this, so a triangle there hits nothing. */
#define OUT_OF_SIGHT (4.0f * BK_FAR)

struct work {
    const struct bake_tile_scene *scene;
    struct bake_tile *tile;
    uint32_t part;
    uint32_t traced, kept; /* maps of the images below */
    uint32_t traced_floats, kept_floats;
    uint32_t width, height;   /* of the images, in samples */
    struct bake_image *image; /* samples of one scan, with lengths in voxels */
    /* Samples of all scans so far, with lengths in world units. The last float is the number of the
     * scan. */
    struct bake_image *nearest;
    struct bake_tile_workers workers;
    float *rows; /* of each worker: a row of either image, and a sample */
    uint64_t row_floats;
};

/* ---- one scan ---- */

/* Hides the triangles of objects that do not see the scan. */
static void hide_triangles(const struct work *work)
{
    const struct bake_tile_scene *scene = work->scene;
    const struct bake_udim_tile *place = &work->tile->place;
    for (uint64_t t = place->first; t < place->first + place->count && scene->sees; t++) {
        const uint64_t object = scene->mesh->object_of[t];
        for (int c = 0; c < 3 && !scene->sees[object * scene->surface->part_count + work->part];
             c++)
            for (int k = 0; k < 3; k++)
                scene->triangles[t].position[c][k] = OUT_OF_SIGHT;
    }
}

static int trace_grid(const struct work *work, const struct bake_tiles *tiles,
                      struct bake_report *report)
{
    const struct bake_tile_scene *scene = work->scene;
    const struct bake_surface *part = &scene->surface->parts[work->part];
    const struct bake_options *options = &work->tile->options;
    const struct bake_job job = {.grid = &part->grid,
                                 .triangles = scene->triangles,
                                 .triangle_count = scene->triangle_count,
                                 .tile_texels = tiles->tile_size * tiles->tile_size,
                                 .device_memory = options->gpu_memory_bytes,
                                 .params = scene->part_params[work->part]};
    struct bake_device *device;
    struct bake_device_times times;
    int status =
        bake_device_open(scene->ctx, options->device ? options->device : "auto", &job, &device);
    if (status < 0)
        return status;
    snprintf(report->device, sizeof report->device, "%s", bake_device_name(device));
    status = bake_tile_trace_grid(scene->ctx, device, part, tiles, report);
    bake_device_times(device, &times);
    report->seconds_upload += times.upload;
    report->seconds_kernels += times.kernels;
    report->seconds_copies += times.copies;
    report->kernel_calls += times.launches;
    bake_device_close(device);
    return status;
}

static int trace_exact(const struct work *work, const struct bake_tiles *tiles,
                       struct bake_report *report)
{
    const struct bake_exact_tiles exact = {.tiles = *tiles,
                                           .exact = work->scene->surface->parts[work->part].exact,
                                           .front = report->front,
                                           .back = report->back};
    return bake_exact_trace_tiles(work->scene->ctx, &exact, report);
}

/* Traces the tile on one scan. Samples are counted later, so the report keeps its counts. */
static int trace_part(const struct work *work, struct bake_report *report)
{
    const struct bake_tile_scene *scene = work->scene;
    const struct bake_surface *part = &scene->surface->parts[work->part];
    const struct bake_tiles tiles = {.raster = work->tile->raster,
                                     .triangles = scene->triangles,
                                     .triangle_count = scene->triangle_count,
                                     .params = &scene->part_params[work->part],
                                     .image = work->image,
                                     .sums = true,
                                     .tile_size = work->tile->tile_size};
    const struct bake_report before = *report;
    bake_raster_kernel_triangles(work->tile->raster, part->translation, part->unit,
                                 scene->triangles);
    hide_triangles(work);
    int status = part->exact ? trace_exact(work, &tiles, report) : trace_grid(work, &tiles, report);
    report->covered_texels = before.covered_texels;
    report->samples = before.samples;
    report->hits = before.hits;
    report->misses = before.misses;
    if (work->part > 0)
        report->overlapping_samples = before.overlapping_samples;
    return status;
}

/* ---- the nearest hits ---- */

/* Returns the values of transfer maps of a sample, the last ones. */
static const float *channels_of(uint32_t maps, const float *sample)
{
    return sample + (bk_texel_floats(maps) - BK_TRANSFER_VALUES * bk_transfers(maps));
}

/* Converts the hit of a scan to world units and to the origin of all scans. The processor computes
 * what the kernel would with the unit of the scan. */
static void move_hit(const struct work *work, bk_map_hit *hit)
{
    const struct bake_surface *whole = work->scene->surface, *part = &whole->parts[work->part];
    const float unit = (float)part->unit;
    hit->t *= unit;
    hit->thickness *= unit;
    for (int k = 0; k < 3; k++)
        hit->position[k] = (float)((double)(hit->position[k] * unit) +
                                   (part->translation[k] - whole->translation[k]));
}

/* Returns whether a sample comes before another one. Rays from a cage take the first surface, which
 * is the highest; others take the nearest. Of hits at the same distance, any is as good, but it
 * must not depend on the order of scans. */
static bool is_nearer(const struct work *work, const float *sample, const float *other)
{
    if (sample[BK_HITS] == 0.0f || other[BK_HITS] == 0.0f)
        return sample[BK_HITS] > other[BK_HITS];
    const float t = bake_sample_hit(work->kept, sample).t;
    const float other_t = bake_sample_hit(work->kept, other).t;
    if (t == other_t)
        return memcmp(sample, other, (work->kept_floats - 1) * sizeof *sample) < 0;
    if (work->scene->part_params[0].flags & BK_CAGE || fabsf(t) == fabsf(other_t))
        return t > other_t;
    return fabsf(t) < fabsf(other_t);
}

/* Replaces a sample by that of the current scan, if it is nearer. moved: space for a sample. */
static void keep_nearest(const struct work *work, const float *sample, float *moved, float *nearest)
{
    if (sample[BK_COVERED] == 0.0f)
        return;
    memset(moved, 0, work->kept_floats * sizeof *moved);
    moved[BK_COVERED] = 1.0f;
    moved[work->kept_floats - 1] = (float)work->part;
    if (sample[BK_HITS] > 0.0f) {
        bk_map_hit hit = bake_sample_hit(work->traced, sample);
        move_hit(work, &hit);
        bk_add_to_maps(work->kept, &hit, moved);
        bk_add_transfers(work->kept, channels_of(work->traced, sample), moved);
    }
    if (nearest[BK_COVERED] == 0.0f || is_nearer(work, moved, nearest))
        memcpy(nearest, moved, work->kept_floats * sizeof *nearest);
}

/* Merges a row of samples of the current scan into the nearest ones. */
static int merge_row(void *arg, uint64_t row, unsigned worker)
{
    const struct work *work = arg;
    const uint64_t floats = (uint64_t)work->width * work->kept_floats;
    float *buffers = work->rows + worker * work->row_floats;
    float *to = buffers + (uint64_t)work->width * work->traced_floats;
    const float *from = NULL, *old = NULL;
    int status = bake_image_rows(work->image, (uint32_t)row, 1, buffers, &from);
    if (status == 0)
        status = bake_image_rows(work->nearest, (uint32_t)row, 1, to, &old);
    if (status < 0)
        return status;
    assert(from && old);
    if (old != to)
        memcpy(to, old, floats * sizeof *to);
    for (uint32_t x = 0; x < work->width; x++)
        keep_nearest(work, from + (uint64_t)x * work->traced_floats, to + floats,
                     to + (uint64_t)x * work->kept_floats);
    return bake_image_write(work->nearest, 0, (uint32_t)row, work->width, 1, to);
}

/* ---- texels ---- */

/* Adds a row of samples to its texels. */
static void sum_samples(const struct work *work, const float *sample, float *texels)
{
    const uint32_t n = work->tile->options.samples;
    for (uint32_t x = 0; x < work->width; x++, sample += work->kept_floats) {
        float *texel = texels + (size_t)(x / n) * work->workers.texel_floats;
        const bk_map_hit hit = bake_sample_hit(work->kept, sample);
        texel[BK_COVERED] += sample[BK_COVERED];
        if (sample[BK_HITS] > 0.0f) {
            bk_add_to_maps(work->workers.maps, &hit, texel);
            bk_add_transfers(work->workers.maps, channels_of(work->kept, sample), texel);
        }
    }
}

/* Sums the samples of a row of texels, and writes the row to the tile's image. */
static int resolve_row(void *arg, uint64_t row, unsigned number)
{
    const struct work *work = arg;
    struct bake_tile_worker *worker = &work->workers.workers[number];
    const uint32_t n = work->tile->options.samples, width = work->width / n;
    float *buffer = work->rows + number * work->row_floats;
    int status = 0;
    memset(worker->texels, 0, (size_t)width * work->workers.texel_floats * sizeof *worker->texels);
    for (uint32_t j = 0; j < n && status == 0; j++) {
        const float *samples;
        status = bake_image_rows(work->nearest, (uint32_t)row * n + j, 1, buffer, &samples);
        if (status == 0)
            sum_samples(work, samples, worker->texels);
    }
    if (status < 0)
        return status;
    bake_tile_worker_resolve(&work->workers, worker, width, worker->resolved);
    bsq_progress_add(work->scene->ctx, 1);
    return bake_image_write(work->tile->image, 0, (uint32_t)row, width, 1, worker->resolved);
}

/* Sums all texels. A worker's tile is a row of texels. */
static int resolve(struct work *work, struct bake_report *report)
{
    struct bsq_ctx *ctx = work->scene->ctx;
    const uint32_t n = work->tile->options.samples;
    int status = bake_row_workers_begin(ctx, work->tile->maps, work->width / n, &work->workers);
    if (status == 0)
        status = bsq_parallel_for(ctx, work->height / n, resolve_row, work);
    bake_tile_workers_end(ctx, &work->workers, report);
    return status;
}

/* ---- all scans ---- */

static int create_images(struct work *work, uint64_t memory_bytes)
{
    const struct bake_tile *tile = work->tile;
    struct bake_image_options image = {.width = work->width,
                                       .height = work->height,
                                       .channels = work->kept_floats,
                                       .memory_bytes = memory_bytes / 3,
                                       .beside = tile->beside,
                                       .blocks = tile->in_blocks ? &tile->sample_blocks : NULL};
    struct bsq_ctx *ctx = work->scene->ctx;
    int status = 0;
    BSQ_TRY(bake_image_create(ctx, &image, &work->nearest));
    image.channels = work->traced_floats;
    BSQ_TRY(bake_image_create(ctx, &image, &work->image));
    work->row_floats =
        (uint64_t)work->width * (work->traced_floats + work->kept_floats) + work->kept_floats;
    BSQ_TRY(bsq_alloc(ctx, "rows of samples", bsq_threads(ctx),
                      work->row_floats * sizeof *work->rows, &work->rows));
done:
    return status;
}

static int trace_rays_from_hits(struct work *work, struct bake_report *report)
{
    const struct bake_scan_samples samples = {.scene = work->scene,
                                              .tile = work->tile,
                                              .image = work->nearest,
                                              .maps = work->kept,
                                              .floats = work->kept_floats,
                                              .width = work->width,
                                              .height = work->height};
    bake_image_free(work->image);
    work->image = NULL;
    return bake_trace_scan_rays(&samples, report);
}

int bake_tile_trace_scans(const struct bake_tile_scene *scene, struct bake_tile *tile,
                          uint64_t memory_bytes, struct bake_report *report)
{
    const uint32_t n = tile->options.samples, traced = scene->part_params[0].maps;
    struct work work = {.scene = scene,
                        .tile = tile,
                        .traced = traced,
                        .kept = traced | tile->maps,
                        .traced_floats = bk_texel_floats(traced),
                        .kept_floats = bk_texel_floats(traced | tile->maps) + 1,
                        .width = bake_image_width(tile->image) * n,
                        .height = bake_image_height(tile->image) * n};
    int status = 0;
    BSQ_TRY(create_images(&work, memory_bytes));
    for (; work.part < scene->surface->part_count; work.part++) {
        BSQ_TRY(trace_part(&work, report));
        BSQ_TRY(bsq_parallel_for(scene->ctx, work.height, merge_row, &work));
    }
    if (traced & BK_PLACE)
        BSQ_TRY(trace_rays_from_hits(&work, report));
    BSQ_TRY(resolve(&work, report));
done:
    bsq_free(scene->ctx, work.rows);
    bake_image_free(work.image);
    bake_image_free(work.nearest);
    return status;
}
