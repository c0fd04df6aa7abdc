/* job.c - runs a bake: inputs, ray lengths, tracing, files, preview.
 *
 * Errors in the arguments, in the inputs and in the output's directory are found before the first
 * ray. The files get their final names at the very end, one after another. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/context.h"
#include "libbake/job/job.h"
#include "libbake/options/options.h"

/* Traces all texels. */
static int job_trace(struct bake_job *job, double started)
{
    BSQ_PASS(bake_arrange_triangles(job));
    BSQ_PASS(bake_rasterise(job));
    BSQ_PASS(bake_open_device(job, bake_expect_work(job)));
    double opened = bsq_seconds_now();
    job->report->seconds_open = opened - started;
    BSQ_PASS(bake_trace_maps(job));
    BSQ_PASS(bake_check_hits(job));
    if (job->maps & BAKE_MAP_CURVATURE)
        BSQ_PASS(bake_trace_curvature(job));
    job->report->chunk_loads = bake_surface_loads(&job->surface);
    bake_end_tracing(job);
    job->report->seconds_trace = bsq_seconds_now() - opened;
    return bake_measure_maps(job);
}

static bool in_ranges(const struct bake_options *options, uint32_t tile)
{
    for (uint32_t i = 0; i < options->tile_range_count; i++)
        if (tile >= options->tile_ranges[i].first && tile <= options->tile_ranges[i].last)
            return true;
    return options->tile_range_count == 0;
}

/* Leaves out the tiles that a merge is not asked for. */
static int skip_tiles(struct bake_job *job, const struct bake_options *asked)
{
    uint32_t left = 0;
    for (uint32_t i = 0; i < job->udim.count; i++) {
        job->tiles[i].skipped = !in_ranges(asked, job->udim.tiles[i].number);
        left += !job->tiles[i].skipped;
    }
    return left > 0 ? 0
                    : bsq_fail(job->ctx, BSQ_EUSAGE, "no triangle lies in the tiles of --tiles");
}

/* asked: the options of the caller, whose tiles a merge may write only. */
static int job_run(struct bake_job *job, const struct bake_options *asked)
{
    const double started = bsq_seconds_now();
    const struct bake_options *options = job->options;
    if (asked->part && asked->tile_range_count > 0)
        return bsq_fail(job->ctx, BSQ_EUSAGE, "a part has all tiles: give --tiles to --merge only");
    BSQ_PASS(bake_open_inputs(job));
    if (!options->part)
        BSQ_PASS(skip_tiles(job, asked));
    BSQ_PASS(bake_note_tiles(job));
    if (options->part)
        return bake_run_part(job);
    BSQ_PASS(bake_check_outputs(job));
    BSQ_PASS(bake_set_params(job));
    BSQ_PASS(bake_open_outputs(job));
    BSQ_PASS(options->parts ? bake_take_parts(job) : job_trace(job, started));
    job->report->texel = bake_udim_texel(options, &job->mesh, &job->udim);
    job->report->voxel = job->surface.grids ? job->surface.detail : 0;
    BSQ_PASS(bake_write_maps(job));
    BSQ_PASS(bake_write_asset(job));
    double written = bsq_seconds_now();
    BSQ_PASS(bake_write_preview(job));
    BSQ_PASS(bake_surface_check(&job->surface));
    double committing = bsq_seconds_now();
    job->report->seconds_preview = committing - written;
    BSQ_PASS(bake_commit_outputs(job));
    job->report->seconds_write += bsq_seconds_now() - committing;
    return 0;
}

static void end_tile(struct bsq_ctx *ctx, struct bake_tile *tile)
{
    bake_raster_free(tile->raster);
    bake_image_free(tile->image);
    BSQ_FREE(ctx, (void *)(uintptr_t)tile->blocks.places, tile->shares);
    bake_map_files_discard(tile->files);
    bake_thumbnail_free(ctx, &tile->normal);
    bake_thumbnail_free(ctx, &tile->color);
    bake_thumbnail_free(ctx, &tile->missed);
    free(tile->output_path);
    free(tile->beside);
    memset(tile, 0, sizeof *tile);
}

static void job_end(struct bake_job *job)
{
    bake_end_tracing(job);
    for (uint32_t i = 0; job->tiles && i < job->udim.count; ++i)
        end_tile(job->ctx, &job->tiles[i]);
    bsq_free(job->ctx, job->tiles);
    bsq_output_discard(job->preview);
    bake_asset_discard(job->asset);
    BSQ_FREE(job->ctx, job->preview_tiles, job->scan_names, job->sees);
    fmt_textures_close(job->skew);
    bake_udim_free(job->ctx, &job->udim);
    bake_lowmesh_free(job->ctx, &job->mesh);
    bake_surface_close(&job->surface);
}

static int job_begin(struct bsq_ctx *ctx, const struct bake_options *options,
                     struct bake_report *report, struct bake_job **out)
{
    struct bake_job *job = NULL; /* on the heap for its size */
    *out = NULL;
    if (bsq_clear_report(ctx, "bake_report", report, sizeof *report) < 0)
        return BSQ_EUSAGE;
    int status = BSQ_CALLOC(ctx, "job", 1, &job);
    *out = job;
    if (status < 0)
        return status;
    job->ctx = ctx;
    job->options = options;
    job->report = report;
    return 0;
}

/* Ends a job. Returns the status, explained. */
static int job_finish(struct bake_job *job, int status)
{
    struct bsq_ctx *ctx = job->ctx;
    if (status < 0)
        status = bake_surface_explain(&job->surface, status);
    job_end(job);
    if (status < 0)
        bake_report_free(job->report);
    bsq_free(ctx, job);
    return status;
}

int bake_run(struct bsq_ctx *ctx, const struct bake_options *options, struct bake_report *report)
{
    struct bake_job *job;
    struct bake_options all = *options;
    /* Ranges of maps are those of all tiles, and so are the pictures. */
    if (options->parts && options->tile_range_count > 0) {
        all.tile_range_count = 0;
        all.glb_path = NULL;
        all.preview_path = NULL;
    }
    BSQ_PASS(job_begin(ctx, &all, report, &job));
    return job_finish(job, job_run(job, options));
}

void bake_report_free(struct bake_report *report)
{
    for (uint32_t i = 0; report->tiles && i < report->tile_count; ++i) {
        free(report->tiles[i].object);
        free(report->tiles[i].material);
    }
    free(report->tiles);
    for (uint64_t i = 0; i < report->id_count; ++i)
        free(report->ids[i].name);
    free(report->ids);
    report->tiles = NULL;
    report->ids = NULL;
    report->tile_count = 0;
    report->id_count = 0;
}

int bake_list_tiles(struct bsq_ctx *ctx, const struct bake_options *options,
                    void (*fn)(void *arg, const struct bake_tile_info *tile), void *arg)
{
    struct bake_lowmesh mesh;
    struct bake_udim udim = {0};
    int status = bake_check_tile_numbers(ctx, options);
    struct bake_options all = *options;
    all.output_path = BAKE_UDIM_TOKEN;
    all.match_names = false;
    all.cage_path = NULL;
    all.low_normals = BAKE_LOW_FLAT; /* of no effect on tiles */
    if (status == 0)
        status = bake_lowmesh_load(ctx, &all, &mesh);
    if (status < 0)
        return status;
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
