/* bake.c - runs a bake: inputs, ray lengths, tracing, files, preview.
 *
 * Errors in the arguments, in the inputs and in the output's directory are found before the first
 * ray. The files get their final names at the very end, one after another. */
#include "libbake/bake.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/clock.h"
#include "libbake/device/device.h"
#include "libbake/exact/exact.h"
#include "libbake/lowpoly/lowpoly.h"
#include "libbake/maps/maps.h"
#include "libbake/preview/preview.h"
#include "libbake/raster/raster.h"
#include "libbake/surface/surface.h"

enum { PREVIEW_TEXTURE = 2048 /* largest side of a texture of the preview, in texels */ };

struct job {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    struct bake_report *report;
    uint32_t maps;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_job traced; /* what the device traces */
    struct bk_triangle *triangles;
    struct bake_raster *raster;
    uint32_t tile_size;
    struct bake_device *device; /* NULL: the triangles of a chunk file are traced */
    struct bake_image *image;
    struct bake_map_files *files;
    struct bake_preview preview;
    struct bake_preview_file *preview_file;
};

void bake_defaults(struct bake_options *options)
{
    *options = (struct bake_options){
        .maps = BAKE_MAPS_DEFAULT,
        .width = 2048,
        .height = 2048,
        .samples = 2,
        .front = -1.0,
        .back = -1.0,
        .padding = 16,
        .normal_space = BAKE_TANGENT_SPACE,
        .sampling = BAKE_TRILINEAR,
        .device = "auto",
    };
}

/* ---- inputs ---- */

int bake_check_options(struct bsq_ctx *ctx, const struct bake_options *options)
{
    if (!options->scan_path || !options->mesh_path || !options->output_path)
        return bsq_fail(ctx, BSQ_EUSAGE, "a scan, a low-poly mesh and an output are needed");
    if (options->maps >= 1u << BK_MAP_COUNT)
        return bsq_fail(ctx, BSQ_EUSAGE, "unknown maps: %#x", options->maps);
    if (options->samples < 1 || options->samples > BAKE_MAX_SAMPLES)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u x %u samples a texel: must be 1 to %d",
                        options->samples, options->samples, BAKE_MAX_SAMPLES);
    if (isnan(options->front) || isnan(options->back) || isinf(options->front) ||
        isinf(options->back))
        return bsq_fail(ctx, BSQ_EUSAGE, "ray lengths %g and %g are not numbers", options->front,
                        options->back);
    if (options->front == 0.0 && options->back == 0.0)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "rays of length 0 find nothing: front and back must not both be 0");
    if (options->normal_space == BAKE_OBJECT_SPACE && options->green_down)
        return bsq_fail(ctx, BSQ_EUSAGE, "an object-space map has no green direction to flip");
    /* The default maps depend on the scan; they are checked again after it was opened. */
    return bake_map_files_check(ctx, options,
                                options->maps ? options->maps : (uint32_t)BAKE_MAP_NORMAL);
}

int bake_default_maps(struct bsq_ctx *ctx, const char *scan_path, uint32_t *out)
{
    bool has_color;
    int status = bake_scan_has_color(ctx, scan_path, &has_color);
    *out = status == 0 ? bake_choose_maps(BAKE_MAPS_DEFAULT, has_color) : BAKE_MAPS_DEFAULT;
    return status;
}

/* Chooses the maps, after the scan was opened. Errors: BSQ_EDATA if it lacks colours. */
static int choose_maps(struct job *job)
{
    bool has_color = job->surface.has_color;
    job->maps = bake_choose_maps(job->options->maps, has_color);
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (job->maps & 1u << i && bake_map_table[i].needs_color && !has_color)
            return bsq_fail(job->ctx, BSQ_EDATA, "%s has no colour; leave %s out of --maps",
                            job->options->scan_path, bake_map_names[i]);
    return bake_map_files_check(job->ctx, job->options, job->maps);
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
    status = bake_lowmesh_load(job->ctx, job->options->mesh_path, &job->mesh);
    if (status == 0)
        job->report->low_triangles = job->mesh.triangle_count;
    return status;
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
    job->report->front = front;
    job->report->back = back;
    params->front = (float)(front / job->surface.unit);
    params->back = (float)(back / job->surface.unit);
    return 0;
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
    return choose_distances(job);
}

/* ---- tracing ---- */

static int prepare_triangles(struct job *job)
{
    const struct bake_options *options = job->options;
    job->tile_size = bake_tile_size(job->ctx, options->width, options->height, options->samples);
    struct bake_raster_options raster = {.width = options->width,
                                         .height = options->height,
                                         .samples = options->samples,
                                         .tile_size = job->tile_size};
    struct bake_raster_report report = {0};
    int status = bake_raster_create(job->ctx, &job->mesh, &raster, &report, &job->raster);
    if (status < 0)
        return status;
    job->report->degenerate_uv_triangles = report.degenerate_triangles;
    job->report->outside_uv_triangles = report.outside_triangles;
    status = bsq_alloc(job->ctx, "triangles of the low-poly mesh", job->mesh.triangle_count,
                       sizeof *job->triangles, &job->triangles);
    if (status == 0)
        bake_raster_kernel_triangles(job->raster, job->surface.translation, job->surface.unit,
                                     job->triangles);
    return status;
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
    job->traced.triangle_count = (uint32_t)job->mesh.triangle_count;
    job->traced.tile_texels = job->tile_size * job->tile_size;
    job->traced.device_memory = job->options->gpu_memory_bytes;
    const char *name = job->options->device ? job->options->device : "auto";
    int status = bake_device_open(job->ctx, name, &job->traced, &job->device);
    if (status == 0)
        snprintf(job->report->device, sizeof job->report->device, "%s",
                 bake_device_name(job->device));
    return status;
}

/* Creates the image: in memory if it takes at most half of the memory that is left in the budget,
 * as writing needs the rest. */
static int create_image(struct job *job)
{
    struct bake_image_options image = {.width = job->options->width,
                                       .height = job->options->height,
                                       .channels = bake_image_channels_for(job->maps),
                                       .memory_bytes = bsq_memory_left(job->ctx) / 2,
                                       .beside = job->options->output_path};
    return bake_image_create(job->ctx, &image, &job->image);
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
                        "%s: no texel lies in a triangle: are the texture coordinates in 0..1?",
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
        : job->options->two_sided ? "try a larger --front and --back"
                                  : "try a larger --front and --back, or --two-sided "
                                    "if the scan's faces are wound inwards");
}

static struct bake_tiles tiles_of(const struct job *job)
{
    return (struct bake_tiles){.raster = job->raster,
                               .triangles = job->triangles,
                               .triangle_count = (uint32_t)job->mesh.triangle_count,
                               .params = &job->traced.params,
                               .image = job->image,
                               .tile_size = job->tile_size};
}

static int trace_exact(struct job *job)
{
    const struct bake_exact_tiles tiles = {.tiles = tiles_of(job),
                                           .exact = job->surface.exact,
                                           .front = job->report->front,
                                           .back = job->report->back};
    return bake_exact_trace_tiles(job->ctx, &tiles, job->report);
}

static int trace_grid(struct job *job)
{
    struct bake_plan plan;
    int status = bake_device_plan(job->device, job->raster, &plan);
    const struct bake_grid_tiles tiles = {.tiles = tiles_of(job),
                                          .device = job->device,
                                          .surface = &job->surface,
                                          .plan = plan.pass_count > 0 ? &plan : NULL};
    job->report->passes = plan.pass_count > 0 ? plan.pass_count : 1;
    if (status == 0)
        status = bake_trace_grid_tiles(job->ctx, &tiles, job->report);
    bake_plan_free(job->ctx, &plan);
    return status;
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

static int trace(struct job *job)
{
    int status = job->surface.exact ? trace_exact(job) : trace_grid(job);
    if (job->device)
        note_device_times(job);
    if (status == 0 && job->report->hits == 0)
        status = fail_without_hit(job);
    return status;
}

/* Frees what is needed for tracing only. */
static void end_tracing(struct job *job)
{
    bake_device_close(job->device);
    job->device = NULL;
    bake_raster_free(job->raster);
    job->raster = NULL;
    bsq_free(job->ctx, job->triangles);
    job->triangles = NULL;
}

/* ---- output ---- */

static int open_outputs(struct job *job)
{
    const char *sampling = job->options->sampling == BAKE_NEAREST ? "nearest" : "trilinear";
    const struct bake_traced traced = {.front = job->report->front,
                                       .back = job->report->back,
                                       .sampling = job->surface.exact ? "exact" : sampling};
    int status = bake_map_files_open(job->ctx, job->options, job->maps, &traced, &job->files);
    if (status == 0 && job->options->preview_path)
        status = bake_preview_open(job->ctx, job->options->preview_path, &job->preview_file);
    return status;
}

static int create_thumbnail(struct job *job, enum bake_map map, uint32_t side,
                            struct bake_thumbnail *out)
{
    if (!(job->maps & (uint32_t)map))
        return 0;
    bake_map_files_set_thumbnail(job->files, map, out);
    return bake_thumbnail_create(job->ctx, job->options->width, job->options->height, side, out);
}

static int create_thumbnails(struct job *job)
{
    struct bake_preview *preview = &job->preview;
    uint32_t side = PREVIEW_TEXTURE;
    uint64_t share = bsq_memory_left(job->ctx) / 8;
    while (side > 64 && (uint64_t)side * side * sizeof *preview->normal.texels > share)
        side /= 2;
    int status = create_thumbnail(job, BAKE_MAP_NORMAL, side, &preview->normal);
    if (status == 0)
        status = create_thumbnail(job, BAKE_MAP_COLOR, side, &preview->color);
    return status;
}

static int write_maps(struct job *job)
{
    int status = job->preview_file ? create_thumbnails(job) : 0;
    return status < 0 ? status : bake_map_files_write(job->files, job->image, job->report);
}

static int write_preview(struct job *job)
{
    if (!job->preview_file)
        return 0;
    struct bake_preview *preview = &job->preview;
    preview->mesh = &job->mesh;
    preview->surface = &job->surface;
    preview->params = &job->traced.params;
    preview->normal_space = job->options->normal_space;
    preview->green_down = job->options->green_down;
    return bake_preview_write(job->preview_file, preview);
}

static int commit(struct job *job)
{
    int status = bake_map_files_commit(job->files);
    job->files = NULL;
    if (status == 0 && job->preview_file) {
        status = bake_preview_commit(job->preview_file);
        job->preview_file = NULL;
    }
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
    if (status == 0)
        status = create_image(job);
    double opened = bsq_seconds_now();
    job->report->seconds_open = opened - started;
    if (status == 0)
        status = trace(job);
    end_tracing(job);
    job->report->seconds_trace = bsq_seconds_now() - opened;
    if (status == 0)
        status = write_maps(job);
    bake_image_free(job->image);
    job->image = NULL;
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
    bake_image_free(job->image);
    bake_map_files_discard(job->files);
    bake_preview_discard(job->preview_file);
    bake_thumbnail_free(job->ctx, &job->preview.normal);
    bake_thumbnail_free(job->ctx, &job->preview.color);
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
    end(job);
    bsq_free(ctx, job);
    return status;
}
