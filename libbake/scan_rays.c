/* scan_rays.c - rays from the nearest hits of several scans: ambient occlusion, bent normals and
 * thickness.
 *
 * A wall of one scan hides the floor of another. So these rays start when the nearest hit of each
 * sample is known. The samples of some rows form a batch; its rays are traced through one scan
 * after the other, and between scans a ray is only a bit or a distance (libbake/secondary/). The
 * rays are the same for all scans; in each, they start as far above the surface as the coarser of
 * the two scans needs. The processor traces them, for all devices. */
#include "libbake/scan_rays.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/kernel/bk_sample.h"
#include "libbake/secondary/secondary.h"

#define NO_SCAN UINT32_MAX

/* Where the rays of a sample start. */
struct origin {
    float position[3]; /* index space of the scan that was hit */
    float normal[3], facet[3];
    uint32_t scan; /* NO_SCAN: there are none */
    uint32_t seed;
    bool reversed;
};

struct scan_rays {
    const struct bake_scan_samples *samples;
    const struct bake_surface *whole;
    struct bk_params params; /* with lengths in world units */
    /* The current batch, in rows of samples. */
    uint32_t row, rows, most_rows;
    uint32_t *triangles; /* of each sample */
    struct origin *origins;
    struct bake_ray_states states;
    /* Of each worker: */
    uint32_t *tiles; /* samples of a tile of the raster */
    float *buffers;  /* a row of samples */
};

/* Places as one of the scans sees them. */
struct scan_view {
    const struct scan_rays *rays;
    uint32_t scan;
};

bk_map_hit bake_sample_hit(uint32_t maps, const float *sample)
{
    bk_map_hit hit = {0};
    bk_take_from_maps(maps, sample, &hit);
    return hit;
}

/* ---- places ---- */

/* Returns whether the object that a sample of the batch lies on sees a scan. */
static bool sees(const struct scan_rays *rays, uint64_t index, uint32_t scan)
{
    const struct bake_tile_scene *scene = rays->samples->scene;
    const uint32_t triangle = rays->triangles[index];
    return !scene->sees ||
           scene->sees[(uint64_t)scene->mesh->object_of[triangle] * rays->whole->part_count + scan];
}

/* Sets the place of a sample, in a space given by its origin and its unit. lift: the distance of
 * open rays from the surface, world units. */
static void set_place(const struct scan_rays *rays, uint64_t index, const double translation[3],
                      double unit, double lift, struct bake_place *out)
{
    const struct origin *from = &rays->origins[index];
    const struct bake_surface *scan = &rays->whole->parts[from->scan];
    const float *facet = from->facet;
    const float *up = facet[0] != 0 || facet[1] != 0 || facet[2] != 0 ? facet : from->normal;
    for (int k = 0; k < 3; k++) {
        const double shift = scan->translation[k] - translation[k];
        const double p = ((double)from->position[k] * scan->unit + shift) / unit;
        out->solid_from[k] = (float)p;
        out->open_from[k] = (float)((double)out->solid_from[k] + lift / unit * (double)up[k]);
    }
    memcpy(out->normal, from->normal, sizeof out->normal);
    memcpy(out->facet, facet, sizeof out->facet);
    out->reversed = from->reversed;
    out->seed = from->seed;
}

static bool get_place(const void *arg, uint64_t index, struct bake_place *out)
{
    const struct scan_view *view = arg;
    const struct scan_rays *rays = view->rays;
    const struct bake_surface *scan = &rays->whole->parts[view->scan];
    const uint32_t hit = rays->origins[index].scan;
    if (hit == NO_SCAN || !sees(rays, index, view->scan))
        return false;
    const double lift = fmax(bake_surface_lift(scan), bake_surface_lift(&rays->whole->parts[hit]));
    set_place(rays, index, scan->translation, scan->unit, lift, out);
    return true;
}

/* ---- a batch ---- */

/* Notes the triangles of a raster tile's samples that are in the batch. */
static int fill_tile(void *arg, uint64_t index, unsigned worker)
{
    const struct scan_rays *rays = arg;
    const struct bake_tile *tile = rays->samples->tile;
    struct bk_tile place = bake_raster_tile(tile->raster, (uint32_t)index);
    if (tile->in_blocks)
        bake_blocks_to_image(&tile->sample_blocks, &place.x, &place.y);
    uint32_t *triangles = rays->tiles + worker * bake_tile_entries(tile);
    uint64_t overlaps;
    if (place.y >= rays->row + rays->rows || place.y + place.height <= rays->row)
        return 0;
    int status = bake_raster_fill(tile->raster, (uint32_t)index, triangles, &overlaps);
    for (uint32_t y = 0; y < place.height && status == 0; y++) {
        const uint64_t row = (uint64_t)place.y + y;
        if (row >= rays->row && row < rays->row + rays->rows)
            memcpy(rays->triangles + (row - rays->row) * rays->samples->width + place.x,
                   triangles + (uint64_t)y * place.width, place.width * sizeof *triangles);
    }
    return status;
}

/* Sets the place in the map of the first sample of a row of the image. */
static void place_row(const struct scan_rays *rays, uint32_t row, uint32_t *x, uint32_t *y)
{
    const struct bake_tile *tile = rays->samples->tile;
    *x = 0;
    *y = row;
    if (tile->in_blocks)
        bake_blocks_to_map(&tile->sample_blocks, x, y);
}

/* Reads a row of samples into the worker's buffer. */
static int read_row(const struct scan_rays *rays, uint32_t row, unsigned worker, float **out)
{
    const uint64_t floats = (uint64_t)rays->samples->width * rays->samples->floats;
    const float *samples = NULL;
    *out = rays->buffers + worker * floats;
    int status = bake_image_rows(rays->samples->image, row, 1, *out, &samples);
    if (status == 0 && samples != *out)
        memcpy(*out, samples, floats * sizeof *samples);
    return status;
}

/* Sets the origins of a row of samples. */
static int load_row(void *arg, uint64_t index, unsigned worker)
{
    const struct scan_rays *rays = arg;
    const struct bake_scan_samples *samples = rays->samples;
    const uint32_t row = rays->row + (uint32_t)index;
    uint32_t map_x, map_y;
    float *sample;
    int status = read_row(rays, row, worker, &sample);
    if (status < 0)
        return status;
    place_row(rays, row, &map_x, &map_y);
    for (uint32_t x = 0; x < samples->width; x++, sample += samples->floats) {
        struct origin *to = &rays->origins[index * samples->width + x];
        const bk_map_hit hit = bake_sample_hit(samples->maps, sample);
        const bool found = sample[BK_HITS] > 0.0f;
        to->scan = found ? (uint32_t)sample[samples->floats - 1] : NO_SCAN;
        memcpy(to->position, hit.place, sizeof to->position);
        memcpy(to->normal, hit.normal, sizeof to->normal);
        memcpy(to->facet, hit.facet, sizeof to->facet);
        to->reversed = hit.side < 0;
        to->seed =
            bk_sample_seed(bk_sample_place(map_x + x, 0, 1), bk_sample_place(map_y, 0, 1), 1);
    }
    return 0;
}

/* Returns what the rays of a sample found. */
static bk_surroundings sum_rays(const struct scan_rays *rays, uint64_t index)
{
    const struct bake_surface *whole = rays->whole;
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    struct bake_place place;
    for (uint32_t p = 0; p < whole->part_count; p++)
        for (int k = 0; k < 3 && sees(rays, index, p); k++) {
            low[k] = fmin(low[k], whole->parts[p].scan_min[k] - whole->translation[k]);
            high[k] = fmax(high[k], whole->parts[p].scan_max[k] - whole->translation[k]);
        }
    set_place(rays, index, whole->translation, 1, 0, &place);
    return bake_sum_rays(&rays->states, &rays->params, &place, index, low, high);
}

/* Writes what the rays found to a sample at (x, y) of the map. Its transfer maps, the last values,
 * stay. */
static void finish_sample(const struct scan_rays *rays, uint64_t index, uint32_t x, uint32_t y,
                          float *sample)
{
    const struct bake_scan_samples *samples = rays->samples;
    const bk_surroundings found = sum_rays(rays, index);
    const bk_point point = bk_point_at(&samples->scene->triangles[rays->triangles[index]],
                                       bk_sample_place(x, 0, 1), bk_sample_place(y, 0, 1));
    bk_map_hit hit = bake_sample_hit(samples->maps, sample);
    bk_map_hits hits = {.found = 1, .normal = {hit.normal[0], hit.normal[1], hit.normal[2]}};
    bk_surroundings_for_maps(&rays->params, &point, &found, &hits);
    hit.open = hits.open;
    hit.thickness = hits.thickness;
    bk_copy_lane(&hits.bent, 0, hit.bent);
    bk_clear_texel(samples->maps & ~(BK_TRANSFER_MASK << BK_TRANSFER_SHIFT), sample);
    sample[BK_COVERED] = 1.0f;
    bk_add_to_maps(samples->maps, &hit, sample);
}

static int finish_row(void *arg, uint64_t index, unsigned worker)
{
    const struct scan_rays *rays = arg;
    const struct bake_scan_samples *samples = rays->samples;
    const uint32_t row = rays->row + (uint32_t)index;
    uint32_t map_x, map_y;
    float *sample;
    int status = read_row(rays, row, worker, &sample);
    place_row(rays, row, &map_x, &map_y);
    for (uint32_t x = 0; x < samples->width && status == 0; x++) {
        const uint64_t number = index * samples->width + x;
        if (rays->origins[number].scan != NO_SCAN)
            finish_sample(rays, number, map_x + x, map_y, sample + (uint64_t)x * samples->floats);
    }
    return status < 0 ? status
                      : bake_image_write(samples->image, 0, row, samples->width, 1, sample);
}

static int trace_batch(struct scan_rays *rays, struct bake_report *report)
{
    const struct bake_tile_scene *scene = rays->samples->scene;
    const uint64_t count = (uint64_t)rays->rows * rays->samples->width;
    bake_ray_states_clear(&rays->states, count);
    int status = 0;
    BSQ_TRY(bsq_parallel_for(scene->ctx, bake_raster_tile_count(rays->samples->tile->raster),
                             fill_tile, rays));
    BSQ_TRY(bsq_parallel_for(scene->ctx, rays->rows, load_row, rays));
    for (uint32_t p = 0; p < rays->whole->part_count; p++) {
        struct bk_params params = scene->part_params[p];
        const struct scan_view view = {rays, p};
        const struct bake_places places = {.get = get_place,
                                           .arg = &view,
                                           .count = count,
                                           .unit = rays->whole->parts[p].unit,
                                           .progress = count};
        params.maps = rays->samples->maps;
        BSQ_TRY(bake_surface_look(&rays->whole->parts[p], &params, &places, &rays->states,
                                  &report->chunk_loads));
    }
    BSQ_TRY(bsq_parallel_for(scene->ctx, rays->rows, finish_row, rays));
done:
    return status;
}

/* ---- memory ---- */

/* Chooses how many rows a batch has: as many as a quarter of the memory holds. */
static void choose_rows(struct scan_rays *rays)
{
    const struct bake_scan_samples *samples = rays->samples;
    const uint64_t row = samples->width * (sizeof *rays->triangles + sizeof *rays->origins +
                                           bake_ray_state_bytes(&rays->params));
    const uint64_t most =
        bsq_memory_share(samples->scene->ctx, "secondary rays of several scans", 4) / row;
    const uint32_t side = samples->tile->tile_size;
    rays->most_rows = most < samples->height ? (uint32_t)most : samples->height;
    /* Each tile of the raster is filled again for each batch that it is in. */
    if (rays->most_rows > side && rays->most_rows < samples->height)
        rays->most_rows -= rays->most_rows % side;
    rays->most_rows = rays->most_rows < 1 ? 1 : rays->most_rows;
}

static int allocate(struct scan_rays *rays)
{
    struct bsq_ctx *ctx = rays->samples->scene->ctx;
    const uint64_t threads = bsq_threads(ctx), width = rays->samples->width;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "samples of a tile", threads * bake_tile_entries(rays->samples->tile),
                      sizeof *rays->tiles, &rays->tiles));
    BSQ_TRY(bsq_alloc(ctx, "rows of samples", threads * width,
                      rays->samples->floats * sizeof *rays->buffers, &rays->buffers));
    choose_rows(rays);
    const uint64_t most = rays->most_rows * width;
    BSQ_TRY(bsq_alloc(ctx, "secondary rays", most, sizeof *rays->triangles, &rays->triangles));
    BSQ_TRY(bsq_alloc(ctx, "secondary rays", most, sizeof *rays->origins, &rays->origins));
    BSQ_TRY(bake_ray_states_create(ctx, &rays->params, most, &rays->states));
done:
    return status;
}

static void release(struct scan_rays *rays)
{
    struct bsq_ctx *ctx = rays->samples->scene->ctx;
    bsq_free(ctx, rays->tiles);
    bsq_free(ctx, rays->buffers);
    bsq_free(ctx, rays->triangles);
    bsq_free(ctx, rays->origins);
    bake_ray_states_free(ctx, &rays->states);
}

/* Returns the parameters of rays with lengths in world units. */
static struct bk_params world_params(const struct bake_scan_samples *samples)
{
    struct bk_params params = *samples->scene->params;
    const double unit = samples->scene->surface->unit;
    params.maps = samples->maps;
    params.unit = 1;
    params.open_limit = (float)((double)params.open_limit * unit);
    params.thickness_limit = (float)((double)params.thickness_limit * unit);
    return params;
}

int bake_trace_scan_rays(const struct bake_scan_samples *samples, struct bake_report *report)
{
    struct bsq_ctx *ctx = samples->scene->ctx;
    struct scan_rays rays = {
        .samples = samples, .whole = samples->scene->surface, .params = world_params(samples)};
    int status = allocate(&rays);
    bsq_progress_begin(ctx, "tracing secondary rays", "samples",
                       (uint64_t)samples->width * samples->height * rays.whole->part_count);
    for (; rays.row < samples->height && status == 0; rays.row += rays.most_rows) {
        const uint32_t left = samples->height - rays.row;
        rays.rows = left < rays.most_rows ? left : rays.most_rows;
        status = trace_batch(&rays, report);
    }
    bsq_progress_end(ctx);
    release(&rays);
    return status;
}
