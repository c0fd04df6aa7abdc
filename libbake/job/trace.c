/* trace.c - traces the maps of a bake. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/context.h"
#include "libbake/job/job.h"

/* Largest side in texels of patches whose rays meet triangles. Larger ones have parts of more
 * charts, whose rays cross chunks far apart. */
enum { TRIANGLES_PATCH = 16 };

/* Sorts the tile's triangles for sampling and writes them to job->triangles. */
static int rasterise(const struct bake_job *job, struct bake_tile *tile)
{
    const struct bake_options *options = &tile->options;
    tile->patch_side =
        bake_patch_side(job->ctx, options->width, options->height, options->samples, tile->maps);
    if (job->surface.triangles && tile->patch_side > TRIANGLES_PATCH)
        tile->patch_side = TRIANGLES_PATCH;
    while (tile->in_blocks && tile->blocks.side % tile->patch_side != 0)
        tile->patch_side /= 2;
    const struct bake_raster_options raster = {.width = options->width,
                                               .height = options->height,
                                               .samples = options->samples,
                                               .patch_side = tile->patch_side,
                                               .first = tile->udim.first,
                                               .count = tile->udim.count,
                                               .blocks = tile->in_blocks ? &tile->blocks : NULL,
                                               .skew = job->skew,
                                               .skew_number = (uint32_t)(tile - job->tiles)};
    struct bake_raster_report counts = {0};
    BSQ_PASS(bake_raster_create(job->ctx, &job->mesh, &raster, &counts, &tile->raster));
    if (!tile->in_blocks)
        job->report->degenerate_uv_triangles += counts.degenerate_triangles;
    bake_raster_kernel_triangles(tile->raster, job->surface.translation, job->surface.unit,
                                 job->triangles);
    return 0;
}

int bake_arrange_triangles(struct bake_job *job)
{
    BSQ_PASS(bake_udim_arrange(job->ctx, job->options, &job->udim, &job->mesh));
    const struct bake_udim_tile *last = &job->udim.tiles[job->udim.count - 1];
    job->triangle_count = (uint32_t)(last->first + last->count);
    return BSQ_CALLOC(job->ctx, "triangles of the low-poly mesh", job->triangle_count,
                      &job->triangles);
}

int bake_rasterise(struct bake_job *job)
{
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        if (!job->tiles[i].in_blocks || job->tiles[i].blocks.count > 0)
            status = rasterise(job, &job->tiles[i]);
    return status;
}

/* Returns the most texels of a patch. */
static uint32_t most_texels(const struct bake_job *job)
{
    uint32_t most = 0;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        if (job->tiles[i].patch_side > most)
            most = job->tiles[i].patch_side;
    return most * most;
}

/* Lets the device trace rays through triangles, if it is a GPU. */
static int share_device(const struct bake_job *job)
{
    uint64_t bytes = 0;
    int status = BSQ_RETRY;
    if (bake_device_has_areas(job->device))
        status = bake_device_make_wave(job->device, job->traced.place_bytes, &bytes);
    for (uint32_t s = 0; s < job->surface.scan_count && status == 0; s++)
        bake_exact_set_device(job->surface.scans[s].exact, job->device, bytes);
    return status == BSQ_RETRY ? 0 : status;
}

int bake_open_device(struct bake_job *job, uint64_t texels)
{
    const char *name = job->options->device ? job->options->device : "";
    const struct bake_scan *scan = job->surface.scans;
    if (job->surface.scan_count > 1 && job->surface.grids) {
        const unsigned threads = bsq_threads(job->ctx);
        snprintf(job->report->device, sizeof job->report->device, "cpu, %u thread%s", threads,
                 threads == 1 ? "" : "s");
        return 0;
    }
    job->traced = (struct bake_scene){.device_memory = job->options->gpu_memory_bytes,
                                      .params = job->surface.params};
    for (uint32_t s = 0; s < job->surface.scan_count && scan->exact; s++)
        bake_exact_add_needs(job->surface.scans[s].exact, &job->traced);
    if (!scan->exact) {
        job->traced.grid = &scan->grid;
        job->traced.triangles = job->triangles;
        job->traced.triangle_count = job->triangle_count;
        job->traced.patch_texels = most_texels(job);
    }
    if (!*name)
        name = bake_expect_processor_first(job, texels) ? "cpu" : "auto";
    BSQ_PASS(bake_device_open(job->ctx, name, &job->traced, &job->device));
    return scan->exact ? share_device(job) : 0;
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

static int fail_without_hit(const struct bake_job *job)
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
        !in_same_place(scan, low)     ? "are they in the same place and units?"
        : bake_has_cage(job->options) ? "try a larger cage, or a larger --back"
        : job->options->two_sided     ? "try a larger --front and --back"
                                      : "try a larger --front and --back, or --two-sided "
                                        "if the scan's faces are wound inwards");
}

/* Returns whether curvature must know the objects of texels, as these see some scans only. */
static bool keeps_objects(const struct bake_job *job)
{
    return job->sees && job->surface.scan_count > 1 && job->maps & BAKE_MAP_CURVATURE;
}

/* Traces all samples of a tile into its image, and frees its raster. */
static int trace_tile(const struct bake_job *job, struct bake_tile *tile, uint64_t memory_bytes)
{
    const bool several = job->surface.scan_count > 1;
    const uint32_t *objects = job->sees && several ? job->mesh.object_of : NULL;
    BSQ_PASS(bake_tile_create_image(job->ctx, tile, keeps_objects(job), memory_bytes));
    const struct bake_patches patches = {.raster = tile->raster,
                                         .triangles = job->triangles,
                                         .triangle_count = job->triangle_count,
                                         .params = &job->surface.params,
                                         .image = tile->image,
                                         .patch_side = tile->patch_side};
    int status = job->traced.grid
                     ? bake_trace_grid_patches(&job->surface, job->device, &patches, job->report)
                     : bake_trace_ray_patches(&job->surface, &patches, objects, job->report);
    bake_raster_free(tile->raster);
    tile->raster = NULL;
    return status;
}

/* Traces all tiles. Their images share half of the memory that is left in the budget, as writing
 * needs the rest. */
int bake_trace_maps(struct bake_job *job)
{
    const uint64_t reserve = bsq_memory_left(job->ctx) / 2;
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count; i++)
        job->report->traced_tiles += job->tiles[i].raster != NULL;
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i) {
        const uint64_t left = bsq_memory_left(job->ctx),
                       share = left > reserve ? left - reserve : 0;
        if (job->tiles[i].raster)
            status = trace_tile(job, &job->tiles[i], share / (job->udim.count - i));
    }
    return status;
}

int bake_check_hits(struct bake_job *job)
{
    return job->report->hits == 0 ? fail_without_hit(job) : 0;
}

/* ---- curvature ---- */

void bake_choose_radius(struct bake_job *job)
{
    const double given = job->options->curvature_radius;
    job->measures.curvature_radius =
        given > 0 ? given
                  : bake_curvature_radius(&job->surface, job->options, &job->mesh, &job->udim);
}

int bake_trace_curvature(struct bake_job *job)
{
    int status = 0;
    bake_choose_radius(job);
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i) {
        if (!job->tiles[i].image)
            continue;
        const struct bake_curvature curvature = {.surface = &job->surface,
                                                 .image = job->tiles[i].image,
                                                 .offset =
                                                     bake_map_offset(job->maps, BK_MAP_curvature),
                                                 .radius = job->measures.curvature_radius,
                                                 .by_objects = keeps_objects(job),
                                                 .device = job->traced.grid ? job->device : NULL};
        status = bake_curvature_trace(job->ctx, &curvature, &job->curvature);
    }
    return status < 0
               ? status
               : bake_warn_of_radius(job->ctx, &job->curvature, job->measures.curvature_radius);
}

int bake_warn_of_radius(struct bsq_ctx *ctx, const struct bake_curvature_counts *counts,
                        double radius)
{
    if (counts->alone == 0)
        return 0;
    return bsq_warn_loss(ctx,
                         "map curvature: no surface around the hits of %" PRIu64 " of %" PRIu64
                         " texels, at a radius of %g; they became 0: try a smaller "
                         "--distance curvature",
                         counts->alone, counts->texels, radius);
}

static void note_device(struct bake_job *job)
{
    struct bake_device_times times;
    snprintf(job->report->device, sizeof job->report->device, "%s", bake_device_name(job->device));
    bake_device_times(job->device, &times);
    job->report->seconds_upload = times.upload;
    job->report->seconds_kernels = times.kernels;
    job->report->seconds_copies = times.copies;
    job->report->kernel_calls = times.launches;
}

void bake_end_tracing(struct bake_job *job)
{
    if (job->device)
        note_device(job);
    for (uint32_t s = 0; s < job->surface.scan_count && job->device && !job->traced.grid; s++)
        bake_exact_set_device(job->surface.scans[s].exact, NULL, 0);
    bake_device_close(job->device);
    job->device = NULL;
    bsq_free(job->ctx, job->triangles);
    job->triangles = NULL;
}
