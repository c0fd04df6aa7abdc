/* bake_farm.c - a bake as tasks: writes the plan, bakes one task, merges the parts.
 *
 * All three run steps of bake_run(). The plan gives the tasks the distances and the radius that a
 * single run would measure. Ranges of maps follow from all texels, so the merge measures them. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/output.h"
#include "base/parallel.h"
#include "formats/farm/farm.h"
#include "libbake/job/job.h"
#include "libbake/options/options.h"
#include "libbake/exact/exact.h"
#include "libbake/farm/farm.h"
#include "libbake/kernel/bk_sample.h"

/* ---- the work in each block ---- */

struct count_job {
    const struct bake_work *job;
    const struct bake_raster *raster; /* with one sample a texel; its tiles are blocks */
    const struct bake_farm_tile *tile;
    struct bake_farm_block *blocks; /* out, one for each tile of the raster */
    uint32_t tile_index, side;
    uint32_t **samples; /* one buffer a worker */
};

/* Returns where a sample lies on the curve through the scan. */
static uint64_t place_of(const struct count_job *count, uint32_t triangle, float x, float y)
{
    const bk_point point = bk_point_at(&count->job->triangles[triangle], x, y);
    const float at[3] = {point.position.x, point.position.y, point.position.z};
    return bake_surface_curve_place(&count->job->surface, at);
}

/* Counts the samples of a block, and places it on the curve by its middle sample. */
static int count_block(void *arg, uint64_t index, unsigned worker)
{
    const struct count_job *count = arg;
    const struct bk_tile tile = bake_raster_tile(count->raster, (uint32_t)index);
    uint32_t *samples = count->samples[worker], covered = 0, seen = 0;
    uint64_t overlaps;
    int status = bake_raster_fill(count->raster, (uint32_t)index, samples, &overlaps);
    for (uint32_t i = 0; i < tile.width * tile.height && status == 0; i++)
        covered += samples[i] != BK_NO_TRIANGLE;
    struct bake_farm_block *block = &count->blocks[index];
    *block = (struct bake_farm_block){.tile = count->tile_index,
                                      .block = tile.y / count->side * count->tile->columns +
                                               tile.x / count->side,
                                      .samples = covered};
    for (uint32_t i = 0; i < tile.width * tile.height && status == 0; i++) {
        const uint32_t x = tile.x + i % tile.width, y = tile.y + i / tile.width;
        if (samples[i] != BK_NO_TRIANGLE && seen++ == covered / 2)
            block->place = place_of(count, samples[i], (float)x + 0.5f, (float)y + 0.5f);
    }
    return status;
}

static int create_count_raster(const struct bake_work *job, const struct bake_farm_plan *plan,
                               uint32_t tile, struct bake_raster **out)
{
    const struct bake_tile *from = &job->tiles[tile];
    const struct bake_raster_options options = {.width = from->options.width,
                                                .height = from->options.height,
                                                .samples = 1,
                                                .tile_size = plan->block_side,
                                                .first = from->place.first,
                                                .count = from->place.count};
    struct bake_raster_report ignored;
    return bake_raster_create(job->ctx, &job->mesh, &options, &ignored, out);
}

struct block_list {
    struct bake_farm_block *blocks;
    uint64_t count, capacity;
};

/* Adds the blocks of a tile that have samples to a list. */
static int count_tile(const struct bake_work *job, const struct bake_farm_plan *plan, uint32_t tile,
                      uint32_t **samples, struct block_list *list)
{
    struct bake_raster *raster = NULL;
    int status = create_count_raster(job, plan, tile, &raster);
    if (status < 0)
        return status;
    const uint32_t found = bake_raster_tile_count(raster);
    status = bsq_grow(job->ctx, "blocks", list->count + found, sizeof *list->blocks, &list->blocks,
                      &list->capacity);
    if (status == 0 && found > 0) {
        struct bake_farm_block *added = list->blocks + list->count;
        struct count_job count = {job,    raster, &plan->tiles[tile], added, tile, plan->block_side,
                                  samples};
        status = bsq_parallel_for(job->ctx, found, count_block, &count);
        for (uint32_t i = 0; i < found && status == 0; i++)
            if (added[i].samples > 0)
                list->blocks[list->count++] = added[i];
    }
    bake_raster_free(raster);
    return status;
}

/* Divides the blocks of all tiles by the work in them. */
static int divide(const struct bake_work *job, struct bake_farm_plan *plan)
{
    const unsigned workers = bsq_threads(job->ctx);
    const uint64_t texels = (uint64_t)plan->block_side * plan->block_side;
    struct block_list list = {0};
    uint32_t **samples;
    int status = bsq_calloc(job->ctx, "samples of blocks", workers, sizeof *samples, &samples);
    for (unsigned w = 0; w < workers && status == 0; w++)
        status = bsq_alloc(job->ctx, "samples of blocks", texels, sizeof **samples, &samples[w]);
    for (uint32_t t = 0; t < plan->tile_count && status == 0; t++)
        status = count_tile(job, plan, t, samples, &list);
    if (status == 0)
        status = bake_farm_divide(plan, list.blocks, list.count);
    for (unsigned w = 0; samples && w < workers; w++)
        bsq_free(job->ctx, samples[w]);
    bsq_free(job->ctx, samples);
    bsq_free(job->ctx, list.blocks);
    return status;
}

/* ---- the plan ---- */

/* Opens all inputs, sets the parameters and prepares the triangles. */
static int open_job(struct bake_work *job)
{
    int status = bake_open_inputs(job);
    if (status == 0)
        status = bake_set_params(job);
    return status;
}

/* Checks the files of the plan and of all maps. */
static int check_files(struct bake_work *job, const char *plan_path)
{
    int status = bsq_output_check(job->ctx, plan_path);
    for (uint32_t i = 0; i < job->udim.count && status == 0; i++)
        status = bake_tile_check_files(job->ctx, &job->tiles[i], plan_path);
    return status;
}

/* Returns the job's options with all that its tasks must share. */
static struct bake_options shared_options(const struct bake_work *job)
{
    struct bake_options shared = *job->options;
    shared.maps = job->maps & ((1u << BK_MAP_COUNT) - 1u);
    if (!shared.cage_path)
        shared.front = job->report->front;
    shared.back = job->report->back;
    if (job->maps & BAKE_MAP_CURVATURE)
        shared.curvature_radius = job->measures.curvature_radius;
    if (!shared.device)
        shared.device = "auto";
    if (!shared.low_suffix)
        shared.low_suffix = "";
    if (!shared.high_suffix)
        shared.high_suffix = "";
    return shared;
}

/* Checks that tasks can read a file again. A pipe or a standard input is not among the inputs. */
static int check_input(const struct bake_farm_plan *plan, const char *path)
{
    for (uint32_t i = 0; i < plan->base.input_count; i++)
        if (strcmp(plan->base.inputs[i].path, path) == 0)
            return 0;
    return bsq_fail(plan->base.ctx, BSQ_EUSAGE, "%s: tasks cannot read it again: it is not a file",
                    path);
}

static int check_named_inputs(const struct bake_farm_plan *plan, const struct bake_options *options)
{
    int status = check_input(plan, options->scan_path);
    for (uint32_t i = 0; i < options->more_scan_count && status == 0; i++)
        status = check_input(plan, options->more_scan_paths[i]);
    if (status == 0)
        status = check_input(plan, options->mesh_path);
    for (uint32_t i = 0; i < options->more_mesh_count && status == 0; i++)
        status = check_input(plan, options->more_mesh_paths[i]);
    return status == 0 && options->cage_path ? check_input(plan, options->cage_path) : status;
}

static int make_plan(struct bake_work *job, struct bake_farm_plan *plan, bool *kept)
{
    const struct bake_report *report = job->report;
    plan->degenerate_triangles = report->degenerate_uv_triangles;
    plan->block_side =
        bake_farm_block_side(report->tiles, report->tile_count, plan->base.task_count);
    int status = bake_farm_add_tiles(plan, report->tiles, report->tile_count);
    if (status == 0)
        status = divide(job, plan);
    if (status == 0)
        bake_expect_costs(job, plan);
    if (status == 0)
        status = fmt_farm_add_inputs(&plan->base);
    if (status == 0)
        status = check_named_inputs(plan, job->options);
    if (status == 0)
        status = bake_surface_check(&job->surface);
    return status < 0 ? status : bake_farm_plan_write(plan, kept);
}

static int plan_job(struct bake_work *job, uint32_t tasks, const char *path, bool *kept)
{
    struct bake_farm_plan *plan = NULL;
    int status = open_job(job);
    if (status == 0)
        status = check_files(job, path);
    if (status == 0)
        status = bake_prepare_triangles(job);
    if (status < 0)
        return status;
    bake_choose_radius(job);
    const struct bake_options shared = shared_options(job);
    status = bake_farm_plan_create(job->ctx, path, &shared, tasks, &plan);
    if (status == 0)
        status = make_plan(job, plan, kept);
    bake_farm_plan_free(plan);
    return status;
}

int bake_write_plan(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t tasks,
                    const char *path, bool *kept, struct bake_report *report)
{
    struct bake_work *job;
    *kept = false;
    if (tasks < 1 || tasks > BAKE_MAX_TASKS)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u tasks: must be 1 to %d", tasks, BAKE_MAX_TASKS);
    int status = bake_begin_job(ctx, options, report, &job);
    return status < 0 ? status : bake_end_job(job, plan_job(job, tasks, path, kept));
}

int bake_open_plan(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out)
{
    int status = bake_farm_plan_read(ctx, path, out);
    if (status == 0)
        status = bake_check_options(ctx, &(*out)->options);
    if (status < 0) {
        bake_farm_plan_free(*out);
        *out = NULL;
    }
    return status;
}

void bake_close_plan(struct bake_farm_plan *plan)
{
    bake_farm_plan_free(plan);
}

const struct bake_options *bake_plan_options(const struct bake_farm_plan *plan)
{
    return &plan->options;
}

void bake_plan_use_device(struct bake_farm_plan *plan, const char *device)
{
    plan->task_device = device;
}

uint32_t bake_plan_task_count(const struct bake_farm_plan *plan)
{
    return plan->base.task_count;
}

const struct bake_task_cost *bake_plan_task_cost(const struct bake_farm_plan *plan, uint32_t task)
{
    return &plan->costs[task];
}

char *bake_plan_part_path(const struct bake_farm_plan *plan, uint32_t task)
{
    return fmt_farm_part_path(&plan->base, task);
}

/* ---- a task ---- */

/* Returns whether two names are the same, or both are NULL. */
static bool is_same_name(const char *a, const char *b)
{
    return a && b ? strcmp(a, b) == 0 : a == b;
}

static bool is_same_tile(const struct bake_baked_tile *a, const struct bake_farm_tile *b)
{
    return a->tile == b->number && a->width == b->width && a->height == b->height &&
           is_same_name(a->object, b->object) && is_same_name(a->material, b->material);
}

/* Checks that the inputs are those of the plan, opens them, and checks that they give its tiles. */
static int open_planned(struct bake_work *job, const struct bake_farm_plan *plan)
{
    int status = fmt_farm_check_inputs(&plan->base);
    if (status == 0)
        status = open_job(job);
    if (status < 0)
        return status;
    bool same = job->udim.count == plan->tile_count;
    for (uint32_t i = 0; same && i < plan->tile_count; i++)
        same = is_same_tile(&job->report->tiles[i], &plan->tiles[i]);
    return same ? 0
                : bsq_fail(job->ctx, BSQ_EDATA, "%s: the plan has other UDIM tiles than its inputs",
                           plan->base.path);
}

/* Makes each tile bake the blocks of a task only. Returns the number of blocks, or an error. */
static int choose_blocks(struct bake_work *job, const struct bake_farm_plan *plan, uint32_t task,
                         uint64_t *blocks)
{
    int status = 0;
    *blocks = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; i++) {
        job->tiles[i].in_blocks = true;
        status = bake_farm_task_blocks(plan, i, task, &job->tiles[i].blocks);
        *blocks += job->tiles[i].blocks.count;
    }
    return status;
}

static int trace_task(struct bake_work *job)
{
    int status = bake_prepare_triangles(job);
    if (status == 0)
        status = bake_open_device(job);
    if (status == 0)
        status = bake_trace_maps(job);
    if (status == 0 && job->maps & BAKE_MAP_CURVATURE)
        status = bake_trace_curvature(job);
    bake_end_tracing(job);
    return status < 0 ? status : bake_surface_check(&job->surface);
}

static int write_part(const struct bake_work *job, const struct bake_farm_plan *plan, uint32_t task)
{
    const struct bake_report *report = job->report;
    const struct bake_farm_counts counts = {report->covered_texels, report->samples,
                                            report->hits,           report->overlapping_samples,
                                            job->curvature.texels,  job->curvature.alone};
    struct bake_farm_image *images = NULL;
    int status = bsq_alloc(job->ctx, "images", job->udim.count, sizeof *images, &images);
    for (uint32_t i = 0; i < job->udim.count && status == 0; i++)
        images[i] = (struct bake_farm_image){job->tiles[i].blocks, job->tiles[i].image};
    if (status == 0)
        status = bake_farm_part_write(plan, task, images, &counts);
    bsq_free(job->ctx, images);
    return status;
}

static int run_task(struct bake_work *job, const struct bake_farm_plan *plan, uint32_t task)
{
    uint64_t blocks = 0;
    int status = fmt_farm_check_part_output(&plan->base, task);
    if (status == 0)
        status = open_planned(job, plan);
    if (status == 0)
        status = choose_blocks(job, plan, task, &blocks);
    if (status == 0 && blocks > 0)
        status = trace_task(job);
    return status < 0 ? status : write_part(job, plan, task);
}

int bake_run_task(struct bsq_ctx *ctx, const struct bake_farm_plan *plan, uint32_t task, bool force,
                  bool *kept, struct bake_report *report)
{
    struct bake_work *job;
    struct bake_options options = plan->options;
    *kept = false;
    memset(report, 0, sizeof *report);
    if (plan->task_device)
        options.device = plan->task_device;
    int status = fmt_farm_check_task(&plan->base, task);
    if (status < 0)
        return status;
    if (!force) {
        status = bake_farm_part_is_there(plan, task, kept);
        if (status == 0 && *kept)
            status = fmt_farm_check_inputs(&plan->base);
        if (status < 0 || *kept)
            return status;
    }
    status = bake_begin_job(ctx, &options, report, &job);
    return status < 0 ? status : bake_end_job(job, run_task(job, plan, task));
}

/* ---- merging ---- */

/* Creates the images of all tiles, which share half of the memory that is left, as in a bake
 * without tasks. */
static int create_images(struct bake_work *job)
{
    const uint64_t kept = bsq_memory_left(job->ctx) / 2;
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count && status == 0; i++) {
        const uint64_t left = bsq_memory_left(job->ctx), share = left > kept ? left - kept : 0;
        status = bake_tile_create_image(job->ctx, &job->tiles[i], share / (job->udim.count - i));
    }
    return status;
}

/* Reads the texels that all tasks traced. */
static int read_parts(struct bake_work *job, const struct bake_farm_plan *plan)
{
    struct bake_farm_counts counts = {0};
    struct bake_farm_image *images = NULL;
    int status = bsq_alloc(job->ctx, "images", job->udim.count, sizeof *images, &images);
    for (uint32_t i = 0; i < job->udim.count && status == 0; i++)
        images[i] = (struct bake_farm_image){.image = job->tiles[i].image};
    if (status == 0)
        status = bake_farm_parts_read(plan, images, &counts);
    bsq_free(job->ctx, images);
    if (status < 0)
        return status;
    job->report->degenerate_uv_triangles = plan->degenerate_triangles;
    job->report->covered_texels = counts.covered_texels;
    job->report->samples = counts.samples;
    job->report->hits = counts.hits;
    job->report->misses = counts.samples - counts.hits;
    job->report->overlapping_samples = counts.overlapping_samples;
    job->curvature =
        (struct bake_curvature_counts){counts.curvature_texels, counts.curvature_alone};
    snprintf(job->report->device, sizeof job->report->device, "%u tasks", plan->base.task_count);
    return bake_check_hits(job);
}

static int write_outputs(struct bake_work *job)
{
    int status = bake_write_maps(job);
    if (status == 0)
        status = bake_write_preview(job);
    if (status == 0)
        status = bake_surface_check(&job->surface);
    return status < 0 ? status : bake_commit_outputs(job);
}

static int merge(struct bake_work *job, const struct bake_farm_plan *plan)
{
    int status = bake_farm_parts_check(plan);
    if (status == 0)
        status = fmt_farm_check_note_output(&plan->base);
    if (status == 0)
        status = open_planned(job, plan);
    if (status == 0)
        status = bake_open_outputs(job);
    if (status == 0)
        status = bake_udim_arrange(job->ctx, job->options, &job->udim, &job->mesh);
    if (status == 0)
        status = create_images(job);
    if (status == 0)
        status = read_parts(job, plan);
    if (status < 0)
        return status;
    bake_choose_radius(job);
    status = bake_warn_of_radius(job->ctx, &job->curvature, job->measures.curvature_radius);
    return status < 0 ? status : write_outputs(job);
}

/* Lists the files of all maps and tiles, and the preview. Free the list with free_paths(). */
static int list_outputs(const struct bake_farm_plan *plan, char ***out, uint64_t *count)
{
    const struct bake_options *options = &plan->options;
    const uint32_t maps = bake_selection(options);
    char **paths = calloc((uint64_t)plan->tile_count * bake_selection_end(maps) + 1, sizeof *paths);
    bool failed = paths == NULL;
    *count = 0;
    for (uint32_t t = 0; t < plan->tile_count && !failed; t++) {
        const struct bake_farm_tile *of = &plan->tiles[t];
        char *set = bake_object_path(options->output_path, of->object, of->material);
        char *tile = set ? bake_tile_path(set, of->number) : NULL;
        free(set);
        for (unsigned i = 0; i < bake_selection_end(maps); i++)
            if (tile && bake_has_file(options, maps, i))
                failed |= !(paths[(*count)++] = bake_map_path(tile, bake_name_of(options, i)));
        failed |= tile == NULL;
        free(tile);
    }
    if (!failed && options->preview_path)
        failed |= !(paths[(*count)++] = strdup(options->preview_path));
    *out = paths;
    return failed ? bsq_fail(plan->base.ctx, BSQ_ENOMEM, "%s: out of memory", plan->base.path) : 0;
}

static void free_paths(char **paths, uint64_t count)
{
    for (uint64_t i = 0; paths && i < count; i++)
        free(paths[i]);
    free(paths);
}

/* ---- merging again ---- */

/* Writes what a merge found as a line, for recall_found(). */
static void describe_found(const struct bake_report *report,
                           const struct bake_curvature_counts *curvature,
                           char out[FMT_FARM_FOUND_BYTES])
{
    snprintf(out, FMT_FARM_FOUND_BYTES,
             "samples %" PRIu64 " hits %" PRIu64 " curvature %" PRIu64 " alone %" PRIu64,
             report->samples, report->hits, curvature->texels, curvature->alone);
}

/* Reads the line of a merge that is kept. Returns whether it is such a line. */
static bool recall_found(const char *found, struct bake_report *report,
                         struct bake_curvature_counts *curvature)
{
    const bool known =
        sscanf(found, "samples %" SCNu64 " hits %" SCNu64 " curvature %" SCNu64 " alone %" SCNu64,
               &report->samples, &report->hits, &curvature->texels, &curvature->alone) == 4 &&
        report->hits <= report->samples;
    report->misses = known ? report->samples - report->hits : 0;
    return known;
}

/* Merges, and notes what was found. */
static int merge_and_note(struct bsq_ctx *ctx, const struct bake_farm_plan *plan, char **paths,
                          uint64_t count, struct bake_report *report)
{
    struct bake_work *job;
    char found[FMT_FARM_FOUND_BYTES] = "";
    int status = bake_begin_job(ctx, &plan->options, report, &job);
    if (status < 0)
        return status;
    status = merge(job, plan);
    describe_found(report, &job->curvature, found);
    status = bake_end_job(job, status);
    return status < 0 ? status : fmt_farm_note_merged(&plan->base, paths, count, found);
}

int bake_merge_plan(struct bsq_ctx *ctx, const struct bake_farm_plan *plan, bool force, bool *kept,
                    struct bake_report *report)
{
    struct bake_curvature_counts curvature;
    char **paths, found[FMT_FARM_FOUND_BYTES];
    uint64_t count;
    memset(report, 0, sizeof *report);
    int status = list_outputs(plan, &paths, &count);
    *kept = status == 0 && !force && fmt_farm_is_merged(&plan->base, paths, count, found) &&
            recall_found(found, report, &curvature);
    if (*kept)
        status = fmt_farm_check_inputs(&plan->base);
    if (status == 0 && *kept)
        status = bake_warn_of_radius(ctx, &curvature, plan->options.curvature_radius);
    if (status == 0 && !*kept)
        status = merge_and_note(ctx, plan, paths, count, report);
    free_paths(paths, count);
    return status;
}
