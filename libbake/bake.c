/* bake.c - runs a bake: inputs, ray lengths, tracing, files, preview.
 *
 * Errors in the arguments, in the inputs and in the output's directory are found before the first
 * ray. The files get their final names at the very end, one after another. */
#include "libbake/bake.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/clock.h"
#include "libbake/bake_options.h"
#include "libbake/curvature/curvature.h"
#include "libbake/preview/preview.h"
#include "libbake/tile_bake.h"

enum { PREVIEW_TEXTURE = 2048 /* largest side of a texture of the preview, in texels */ };

struct job {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    struct bake_report *report;
    uint32_t maps;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_udim udim;
    struct bake_tile *tiles; /* one for each tile of `udim` */
    struct bake_job traced;  /* what the device traces */
    struct bk_triangle *triangles;
    struct bake_measures measures; /* over all tiles */
    struct bake_device *device;    /* NULL: the triangles of a chunk file are traced */
    struct bake_preview_tile *preview_tiles;
    struct bake_preview_file *preview_file;
};

/* ---- inputs ---- */

int bake_find_maps(struct bsq_ctx *ctx, const char *scan_path, uint32_t asked, uint32_t *out)
{
    bool has_color = false;
    bool exact = false;
    int status = 0;
    if (asked == BAKE_MAPS_DEFAULT || asked & BAKE_MAPS_ALL)
        status = bake_scan_has_color(ctx, scan_path, &has_color);
    if (status == 0 && asked & BAKE_MAPS_ALL)
        status = bake_scan_is_exact(ctx, scan_path, &exact);
    *out = status == 0 ? bake_choose_maps(asked, has_color, exact) : asked;
    return status;
}

/* Chooses the maps, after the scan was opened. Errors: BSQ_EDATA if it lacks colours, BSQ_EUSAGE if
 * a map needs a grid. */
static int choose_maps(struct job *job)
{
    bool has_color = job->surface.has_color;
    const bool exact = job->surface.exact != NULL;
    job->maps = bake_choose_maps(job->options->maps, has_color, exact);
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (exact && job->maps & 1u << i && bake_map_table[i].needs_grid)
            return bsq_fail(job->ctx, BSQ_EUSAGE,
                            "%s: the map %s is baked from a grid (.nvdb), not from triangles",
                            job->options->scan_path, bake_map_names[i]);
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (job->maps & 1u << i && bake_map_table[i].needs_color && !has_color)
            return bsq_fail(job->ctx, BSQ_EDATA, "%s has no colour; leave %s out of --maps",
                            job->options->scan_path, bake_map_names[i]);
    return bake_check_maps(job->ctx, job->options, job->maps);
}

/* Notes the tiles and their sizes in the report. */
static int report_tiles(struct job *job)
{
    struct bake_report *report = job->report;
    assert(job->udim.count > 0);
    report->tiles = calloc(job->udim.count, sizeof *report->tiles);
    if (!report->tiles)
        return bsq_fail(job->ctx, BSQ_ENOMEM, "out of memory");
    report->tile_count = job->udim.count;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        report->tiles[i] = (struct bake_tile_size){.tile = job->tiles[i].place.number,
                                                   .width = job->tiles[i].options.width,
                                                   .height = job->tiles[i].options.height};
    return 0;
}

static int begin_tiles(struct job *job)
{
    int status = bake_udim_find(job->ctx, job->options, &job->mesh, &job->udim);
    if (status == 0)
        status = bsq_calloc(job->ctx, "tiles", job->udim.count, sizeof *job->tiles, &job->tiles);
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        status =
            bake_tile_begin(job->ctx, job->options, job->maps, &job->udim.tiles[i], &job->tiles[i]);
    job->report->outside_uv_triangles = job->udim.outside_triangles;
    return status < 0 ? status : report_tiles(job);
}

static int open_inputs(struct job *job)
{
    int status = bake_check_options(job->ctx, job->options);
    if (status < 0)
        return status;
    status = bake_surface_open(job->ctx, job->options, &job->surface);
    if (status < 0)
        return status;
    status = choose_maps(job);
    if (status == 0 && job->maps & BAKE_MAP_COLOR)
        status = bake_surface_use_color(&job->surface);
    if (status < 0)
        return status;
    const struct bake_lowmesh_options low = {.path = job->options->mesh_path,
                                             .cage_path = job->options->cage_path,
                                             .rays = job->options->rays};
    status = bake_lowmesh_load(job->ctx, &low, &job->mesh);
    if (status < 0)
        return status;
    job->report->low_triangles = job->mesh.triangle_count;
    return begin_tiles(job);
}

/* ---- parameters ---- */

static int choose_distances(struct job *job)
{
    const struct bake_options *options = job->options;
    struct bk_params *params = &job->traced.params;
    double front = options->front, back = options->back;
    if (front < 0 || back < 0) {
        int status = bake_measure_distances(&job->surface, params, &job->mesh, &front, &back);
        if (status < 0)
            return status;
        if (options->front >= 0)
            front = options->front;
        if (options->back >= 0)
            back = options->back;
    }
    if (options->cage_path)
        front = job->mesh.cage_distance;
    job->report->front = front;
    job->report->back = back;
    params->front = (float)(front / job->surface.unit);
    params->back = (float)(back / job->surface.unit);
    return 0;
}

/* Sets what rays from hits have in common, in voxels. */
static void set_rays(const struct job *job, struct bk_params *params)
{
    const struct bake_options *options = job->options;
    const struct bake_surface *surface = &job->surface;
    const double half = 0.5 * options->ao_spread * 0.017453292519943295;
    const double thickness = bake_thickness_distance(options, surface->scan_min, surface->scan_max);
    params->open_rays = options->ao_rays;
    params->thickness_rays = options->thickness_rays;
    params->open_limit = BK_FAR;
    if (options->ao_distance > 0)
        params->open_limit = fminf((float)(options->ao_distance / surface->unit), BK_FAR);
    params->thickness_limit = fminf((float)(thickness / surface->unit), BK_FAR);
    params->open_sine2 = (float)(sin(half) * sin(half));
    if (options->ao_falloff)
        params->flags |= BK_OPEN_FALLOFF;
}

static int set_params(struct job *job)
{
    const struct bake_options *options = job->options;
    struct bk_params *params = &job->traced.params;
    if (!job->surface.exact)
        bake_params_from_grid(&job->surface.grid, params);
    params->maps = job->maps;
    params->samples = options->samples;
    params->unit = (float)job->surface.unit;
    if (options->normal_space == BAKE_OBJECT_SPACE)
        params->flags |= BK_OBJECT_SPACE;
    if (options->sampling == BAKE_NEAREST)
        params->flags |= BK_NEAREST;
    if (options->two_sided)
        params->flags |= BK_TWO_SIDED;
    if (options->cage_path)
        params->flags |= BK_CAGE;
    set_rays(job, params);
    return choose_distances(job);
}

/* ---- tracing ---- */

/* Returns the number of triangles that lie in tiles to bake. They are the first ones of the mesh.
 */
static uint64_t tile_triangles(const struct job *job)
{
    const struct bake_udim_tile *last = &job->udim.tiles[job->udim.count - 1];
    return last->first + last->count;
}

static struct bake_tile_scene scene_of(const struct job *job)
{
    return (struct bake_tile_scene){.ctx = job->ctx,
                                    .surface = &job->surface,
                                    .mesh = &job->mesh,
                                    .params = &job->traced.params,
                                    .triangles = job->triangles,
                                    .triangle_count = (uint32_t)tile_triangles(job),
                                    .device = job->device};
}

static int prepare_triangles(struct job *job)
{
    int status = bake_udim_arrange(job->ctx, job->options, &job->udim, &job->mesh);
    if (status == 0)
        status = bsq_alloc(job->ctx, "triangles of the low-poly mesh", tile_triangles(job),
                           sizeof *job->triangles, &job->triangles);
    const struct bake_tile_scene scene = scene_of(job);
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        status = bake_tile_rasterise(&scene, &job->tiles[i], job->report);
    return status;
}

/* Returns the most texels of a raster's tile. */
static uint32_t most_texels(const struct job *job)
{
    uint32_t most = 0;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        if (job->tiles[i].tile_size > most)
            most = job->tiles[i].tile_size;
    return most * most;
}

static int open_device(struct job *job)
{
    if (job->surface.exact) {
        unsigned threads = bsq_threads(job->ctx);
        snprintf(job->report->device, sizeof job->report->device, "cpu, %u thread%s, exact",
                 threads, threads == 1 ? "" : "s");
        return 0;
    }
    job->traced.grid = &job->surface.grid;
    job->traced.triangles = job->triangles;
    job->traced.triangle_count = (uint32_t)tile_triangles(job);
    job->traced.tile_texels = most_texels(job);
    job->traced.device_memory = job->options->gpu_memory_bytes;
    const char *name = job->options->device ? job->options->device : "auto";
    int status = bake_device_open(job->ctx, name, &job->traced, &job->device);
    if (status == 0)
        snprintf(job->report->device, sizeof job->report->device, "%s",
                 bake_device_name(job->device));
    return status;
}

/* Returns whether the scan and the low-poly mesh have about the same size and place, so that longer
 * rays can help. */
static bool in_same_place(const struct bake_surface *scan, const struct bake_lowmesh *low)
{
    double scan_side = 0, low_side = 0, gap = 0;
    for (int k = 0; k < 3; ++k) {
        scan_side = fmax(scan_side, scan->scan_max[k] - scan->scan_min[k]);
        low_side = fmax(low_side, low->bounds_max[k] - low->bounds_min[k]);
        gap = fmax(gap, fmax(low->bounds_min[k] - scan->scan_max[k],
                             scan->scan_min[k] - low->bounds_max[k]));
    }
    return low_side < 4 * scan_side && scan_side < 4 * low_side && gap < 0.1 * scan_side;
}

static int fail_without_hit(const struct job *job)
{
    const struct bake_surface *scan = &job->surface;
    const struct bake_lowmesh *low = &job->mesh;
    if (job->report->samples == 0)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s: no texel lies in a triangle: is the mesh unwrapped?",
                        job->options->mesh_path);
    /* Seven digits, as float32 has: six would cut the metres off geo-referenced coordinates. */
    return bsq_fail(
        job->ctx, BSQ_EDATA,
        "no ray hit within %g in front and %g behind: the scan spans (%.7g %.7g %.7g) to "
        "(%.7g %.7g %.7g), the low-poly mesh (%.7g %.7g %.7g) to (%.7g %.7g %.7g): %s",
        job->report->front, job->report->back, scan->scan_min[0], scan->scan_min[1],
        scan->scan_min[2], scan->scan_max[0], scan->scan_max[1], scan->scan_max[2],
        low->bounds_min[0], low->bounds_min[1], low->bounds_min[2], low->bounds_max[0],
        low->bounds_max[1], low->bounds_max[2],
        !in_same_place(scan, low) ? "are they in the same place and units?"
        : job->options->cage_path ? "try a larger cage, or a larger --back"
        : job->options->two_sided ? "try a larger --front and --back"
                                  : "try a larger --front and --back, or --two-sided "
                                    "if the scan's faces are wound inwards");
}

static void note_device_times(struct job *job)
{
    struct bake_device_times times;
    bake_device_times(job->device, &times);
    job->report->seconds_upload = times.upload;
    job->report->seconds_kernels = times.kernels;
    job->report->seconds_copies = times.copies;
    job->report->kernel_calls = times.launches;
}

/* Traces all tiles. Their images share half of the memory that is left in the budget, as writing
 * needs the rest. */
static int trace(struct job *job)
{
    const struct bake_tile_scene scene = scene_of(job);
    const uint64_t kept = bsq_memory_left(job->ctx) / 2;
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i) {
        const uint64_t left = bsq_memory_left(job->ctx), share = left > kept ? left - kept : 0;
        status =
            bake_tile_trace(&scene, &job->tiles[i], share / (job->udim.count - i), job->report);
    }
    if (job->device)
        note_device_times(job);
    if (status == 0 && job->report->hits == 0)
        status = fail_without_hit(job);
    return status;
}

/* The processor traces from here on, so the curvature is the same for all devices. */
static int trace_curvature(struct job *job)
{
    const double given = job->options->curvature_radius;
    int status = 0;
    job->measures.curvature_radius =
        given > 0 ? given
                  : bake_curvature_radius(&job->surface, job->options, &job->mesh, &job->udim);
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i) {
        const struct bake_curvature curvature = {
            .surface = &job->surface,
            .params = &job->traced.params,
            .image = job->tiles[i].image,
            .place = bake_image_channels_for(job->maps & (BAKE_MAP_CURVATURE - 1)),
            .radius = job->measures.curvature_radius};
        status = bake_curvature_trace(job->ctx, &curvature);
    }
    return status;
}

/* Frees what is needed for tracing only. */
static void end_tracing(struct job *job)
{
    bake_device_close(job->device);
    job->device = NULL;
    bsq_free(job->ctx, job->triangles);
    job->triangles = NULL;
}

/* ---- output ---- */

static struct bake_traced traced_of(const struct job *job)
{
    const char *sampling = job->options->sampling == BAKE_NEAREST ? "nearest" : "trilinear";
    struct bake_traced traced = {.front = job->report->front,
                                 .back = job->report->back,
                                 .sampling = job->surface.exact ? "exact" : sampling};
    memcpy(traced.scan_min, job->surface.scan_min, sizeof traced.scan_min);
    memcpy(traced.scan_max, job->surface.scan_max, sizeof traced.scan_max);
    memcpy(traced.image_origin, job->surface.translation, sizeof traced.image_origin);
    return traced;
}

/* Checks the files of all tiles before the work, and creates those of the first. Those of other
 * tiles are created when they are written. */
static int open_outputs(struct job *job)
{
    const struct bake_traced traced = traced_of(job);
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        status = bake_tile_check_files(job->ctx, &job->tiles[i]);
    if (status == 0)
        status = bake_tile_open_files(job->ctx, &job->tiles[0], &traced);
    if (status == 0 && job->options->preview_path)
        status = bake_preview_open(job->ctx, job->options->preview_path, &job->preview_file);
    return status;
}

/* Returns the side of thumbnails: all of them together may take an eighth of what is left in the
 * budget. */
static uint32_t thumbnail_side(const struct job *job)
{
    uint32_t side = PREVIEW_TEXTURE;
    uint64_t share = bsq_memory_left(job->ctx) / 8 / job->udim.count;
    while (side > 64 && (uint64_t)side * side * sizeof *job->tiles->normal.texels > share)
        side /= 2;
    return side;
}

static int write_tile(struct job *job, struct bake_tile *tile, uint32_t side)
{
    const struct bake_traced traced = traced_of(job);
    int status = bake_tile_open_files(job->ctx, tile, &traced);
    if (status == 0 && job->preview_file)
        status = bake_tile_create_thumbnails(job->ctx, tile, side);
    if (status == 0)
        status = bake_map_files_write(tile->files, tile->image, &job->measures, job->report);
    bake_image_free(tile->image);
    tile->image = NULL;
    return status;
}

/* Measures the values of all tiles, since they share the ranges of the maps. */
static int measure_maps(struct job *job)
{
    const double start = bsq_seconds_now();
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        status =
            bake_image_measure(job->ctx, job->tiles[i].image, job->maps, job->measures.statistics);
    job->report->seconds_resolve += bsq_seconds_now() - start;
    return status;
}

static int write_maps(struct job *job)
{
    const uint32_t side = thumbnail_side(job);
    int status = measure_maps(job);
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        status = write_tile(job, &job->tiles[i], side);
    return status;
}

static int write_preview(struct job *job)
{
    if (!job->preview_file)
        return 0;
    int status = bsq_calloc(job->ctx, "preview", job->udim.count, sizeof *job->preview_tiles,
                            &job->preview_tiles);
    if (status < 0)
        return status;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        job->preview_tiles[i] = (struct bake_preview_tile){
            job->udim.tiles[i], &job->tiles[i].normal, &job->tiles[i].color};
    const struct bake_preview preview = {.mesh = &job->mesh,
                                         .surface = &job->surface,
                                         .params = &job->traced.params,
                                         .tiles = job->preview_tiles,
                                         .tile_count = job->udim.count,
                                         .normal_space = job->options->normal_space,
                                         .green_down = job->options->green_down};
    return bake_preview_write(job->preview_file, &preview);
}

static int commit(struct job *job)
{
    struct bsq_output_group group = {0};
    struct bsq_output *preview;
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i) {
        status = bake_map_files_hand_over(job->tiles[i].files, &group);
        job->tiles[i].files = NULL;
    }
    if (status == 0 && job->preview_file) {
        status = bake_preview_hand_over(job->preview_file, &preview);
        job->preview_file = NULL;
        if (status == 0)
            status = bsq_output_group_add(&group, preview);
    }
    if (status == 0)
        status = bsq_output_group_commit(&group);
    bsq_output_group_discard(&group);
    return status;
}

/* ---- the job ---- */

static int run(struct job *job)
{
    double started = bsq_seconds_now();
    int status = open_inputs(job);
    if (status == 0)
        status = set_params(job);
    if (status == 0)
        status = open_outputs(job);
    if (status == 0)
        status = prepare_triangles(job);
    if (status == 0)
        status = open_device(job);
    double opened = bsq_seconds_now();
    job->report->seconds_open = opened - started;
    if (status == 0)
        status = trace(job);
    if (status == 0 && job->maps & BAKE_MAP_CURVATURE)
        status = trace_curvature(job);
    end_tracing(job);
    job->report->seconds_trace = bsq_seconds_now() - opened;
    if (status == 0)
        status = write_maps(job);
    double written = bsq_seconds_now();
    if (status == 0)
        status = write_preview(job);
    if (status == 0)
        status = bake_surface_check(&job->surface);
    double committing = bsq_seconds_now();
    job->report->seconds_preview = committing - written;
    if (status == 0)
        status = commit(job);
    job->report->seconds_write += bsq_seconds_now() - committing;
    return status;
}

static void end(struct job *job)
{
    end_tracing(job);
    for (uint32_t i = 0; job->tiles && i < job->udim.count; ++i)
        bake_tile_end(job->ctx, &job->tiles[i]);
    bsq_free(job->ctx, job->tiles);
    bake_preview_discard(job->preview_file);
    bsq_free(job->ctx, job->preview_tiles);
    bake_udim_free(job->ctx, &job->udim);
    bake_lowmesh_free(job->ctx, &job->mesh);
    bake_surface_close(&job->surface);
}

int bake_run(struct bsq_ctx *ctx, const struct bake_options *options, struct bake_report *report)
{
    memset(report, 0, sizeof *report);
    struct job *job; /* on the heap for its size */
    int status = bsq_calloc(ctx, "job", 1, sizeof *job, &job);
    if (status < 0)
        return status;
    job->ctx = ctx;
    job->options = options;
    job->report = report;
    status = run(job);
    if (status < 0)
        status = bake_surface_explain(&job->surface, status);
    end(job);
    if (status < 0)
        bake_report_free(report);
    bsq_free(ctx, job);
    return status;
}

void bake_report_free(struct bake_report *report)
{
    free(report->tiles);
    report->tiles = NULL;
    report->tile_count = 0;
}

int bake_list_tiles(struct bsq_ctx *ctx, const struct bake_options *options,
                    void (*fn)(void *arg, const struct bake_tile_info *tile), void *arg)
{
    struct bake_lowmesh mesh;
    struct bake_udim udim = {0};
    const struct bake_lowmesh_options low = {.path = options->mesh_path};
    int status = bake_lowmesh_load(ctx, &low, &mesh);
    if (status < 0)
        return status;
    struct bake_options all = *options;
    all.output_path = BAKE_UDIM_TOKEN;
    status = bake_udim_find(ctx, &all, &mesh, &udim);
    for (uint32_t i = 0; i < udim.count && status == 0; ++i) {
        struct bake_tile_info info = {.tile = udim.tiles[i].number,
                                      .triangles = udim.tiles[i].count};
        bake_tile_size_of(options, info.tile, &info.width, &info.height);
        fn(arg, &info);
    }
    bake_udim_free(ctx, &udim);
    bake_lowmesh_free(ctx, &mesh);
    return status;
}
