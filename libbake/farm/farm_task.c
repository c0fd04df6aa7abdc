/* bake_farm.c - a bake as tasks: writes the plan, and bakes one task. bake_merge.c merges the
 * parts.
 *
 * All run steps of bake_run(). The plan gives the tasks the distances and the radius that a single
 * run would measure. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/output.h"
#include "base/parallel.h"
#include "libbake/exact/exact.h"
#include "libbake/farm/farm.h"
#include "libbake/kernel/bk_sample.h"

/* ---- the work in each block ---- */

struct count_job {
    const struct bake_work *job;
    const struct bake_raster *raster;
    const struct bake_farm_tile *tile;
    struct bake_farm_block *blocks; /* out, one for each patch of the raster */
    uint32_t tile_index, side;
    uint32_t **samples; /* one buffer a worker */
};

/* Returns where a sample lies on the curve through the scan. */
static uint64_t curve_index(const struct count_job *count, uint32_t triangle, float x, float y)
{
    const bk_point point = bk_point_at(&count->job->triangles[triangle], x, y);
    const float at[3] = {point.position.x, point.position.y, point.position.z};
    return bake_surface_curve_index(&count->job->surface, at);
}

/* Counts the samples of a block, and places it on the curve by its middle sample. */
static int count_block(void *arg, uint64_t index, unsigned worker)
{
    const struct count_job *count = arg;
    const struct bk_patch patch = bake_raster_patch(count->raster, (uint32_t)index);
    uint32_t *samples = count->samples[worker], covered = 0, seen = 0;
    uint64_t overlaps;
    int status = bake_raster_fill(count->raster, (uint32_t)index, samples, &overlaps);
    for (uint32_t i = 0; i < patch.width * patch.height && status == 0; i++)
        covered += samples[i] != BK_NO_TRIANGLE;
    struct bake_farm_block *block = &count->blocks[index];
    *block = (struct bake_farm_block){.tile = count->tile_index,
                                      .block = patch.y / count->side * count->tile->columns +
                                               patch.x / count->side,
                                      .samples = covered};
    for (uint32_t i = 0; i < patch.width * patch.height && status == 0; i++) {
        const uint32_t x = patch.x + i % patch.width, y = patch.y + i / patch.width;
        if (samples[i] != BK_NO_TRIANGLE && seen++ == covered / 2)
            block->index = curve_index(count, samples[i], (float)x + 0.5f, (float)y + 0.5f);
    }
    return status;
}

/* Makes a raster of a tile with one sample a texel, whose patches are blocks. */
static int create_count_raster(const struct bake_work *job, const struct bake_farm_plan *plan,
                               uint32_t tile, struct bake_raster **out)
{
    const struct bake_tile *from = &job->tiles[tile];
    const struct bake_raster_options options = {.width = from->options.width,
                                                .height = from->options.height,
                                                .samples = 1,
                                                .patch_side = plan->block_side,
                                                .first = from->udim.first,
                                                .count = from->udim.count};
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
    int status;
    BSQ_TRY(create_count_raster(job, plan, tile, &raster));
    const uint32_t found = bake_raster_patch_count(raster);
    BSQ_TRY(bsq_grow(job->ctx, "blocks", list->count + found, sizeof *list->blocks, &list->blocks,
                     &list->capacity));
    if (found == 0)
        goto done;
    struct bake_farm_block *added = list->blocks + list->count;
    struct count_job count = {job,    raster, &plan->tiles[tile], added, tile, plan->block_side,
                              samples};
    BSQ_TRY(bsq_parallel_for(job->ctx, found, count_block, &count));
    for (uint32_t i = 0; i < found; i++)
        if (added[i].samples > 0)
            list->blocks[list->count++] = added[i];
done:
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
    int status;
    BSQ_TRY(bsq_calloc(job->ctx, "samples of blocks", workers, sizeof *samples, &samples));
    for (unsigned w = 0; w < workers; w++)
        BSQ_TRY(bsq_alloc(job->ctx, "samples of blocks", texels, sizeof **samples, &samples[w]));
    for (uint32_t t = 0; t < plan->tile_count; t++)
        BSQ_TRY(count_tile(job, plan, t, samples, &list));
    status = bake_farm_divide(plan, list.blocks, list.count);
done:
    for (unsigned w = 0; samples && w < workers; w++)
        bsq_free(job->ctx, samples[w]);
    bsq_free(job->ctx, samples);
    bsq_free(job->ctx, list.blocks);
    return status;
}

/* ---- the plan ---- */

/* Sets what each task of a plan needs. The plan has its tiles, blocks and texels. */
static void expect_costs(const struct bake_work *job, struct bake_farm_plan *plan)
{
    const uint64_t texel = bake_image_channels_for(job->maps) * sizeof(float);
    const uint64_t block = (uint64_t)plan->block_side * plan->block_side * texel;
    uint64_t all = 0;
    for (uint32_t t = 0; t < plan->tile_count; t++)
        for (uint64_t b = 0; b < (uint64_t)plan->tiles[t].columns * plan->tiles[t].rows; b++)
            plan->expected[plan->tiles[t].task_of[b]].part_bytes += block;
    for (uint32_t i = 0; i < plan->tasks; i++)
        all += plan->expected[i].texels;
    for (uint32_t i = 0; i < plan->tasks; i++)
        bake_expect_cost(job, plan->expected[i].texels, all, &plan->expected[i]);
}

/* Returns the job's options with all that its tasks must share. */
static struct bake_options shared_options(const struct bake_work *job)
{
    struct bake_options shared = *job->options;
    shared.maps = job->maps & ((1u << BAKE_NAMED_MAPS) - 1u);
    if (!bake_has_cage(&shared))
        shared.front = job->report->front;
    shared.back = job->report->back;
    if (job->maps & BAKE_MAP_CURVATURE)
        shared.curvature_radius = job->measures.curvature_radius;
    shared.as_is = true; /* the meshes were compared */
    if (!shared.device)
        shared.device = "";
    if (!shared.low_suffix)
        shared.low_suffix = "";
    if (!shared.high_suffix)
        shared.high_suffix = "";
    return shared;
}

/* Checks that tasks can read a file again. A pipe or a standard input is not among the inputs. */
static int check_input(const struct bake_farm_plan *plan, const char *path)
{
    for (uint32_t i = 0; i < plan->input_count; i++)
        if (strcmp(plan->inputs[i].path, path) == 0)
            return 0;
    return bsq_fail(plan->ctx, BSQ_EUSAGE, "%s: tasks cannot read it again: it is not a file",
                    path);
}

static int check_named_inputs(const struct bake_farm_plan *plan, const struct bake_options *options)
{
    int status;
    BSQ_TRY(check_input(plan, options->scan_path));
    for (uint32_t i = 0; i < options->more_scan_count; i++)
        BSQ_TRY(check_input(plan, options->more_scan_paths[i]));
    BSQ_TRY(check_input(plan, options->mesh_path));
    for (uint32_t i = 0; i < options->more_mesh_count; i++)
        BSQ_TRY(check_input(plan, options->more_mesh_paths[i]));
    if (options->cage_path)
        BSQ_TRY(check_input(plan, options->cage_path));
done:
    return status;
}

static int plan_job(struct bake_work *job, uint32_t tasks, const char *path, bool *kept)
{
    const struct bake_report *report = job->report;
    struct bake_farm_plan *plan = NULL;
    int status;
    BSQ_TRY(bake_open_inputs(job));
    BSQ_TRY(bake_check_outputs(job, path));
    BSQ_TRY(bake_set_params(job));
    BSQ_TRY(bake_prepare_triangles(job));
    bake_choose_radius(job);
    const struct bake_options shared = shared_options(job);
    BSQ_TRY(bake_farm_plan_create(job->ctx, path, &shared, tasks, &plan));
    plan->degenerate_triangles = report->degenerate_uv_triangles;
    plan->block_side = bake_farm_block_side(report->tiles, report->tile_count, tasks);
    BSQ_TRY(bake_farm_add_tiles(plan, report->tiles, report->tile_count));
    BSQ_TRY(divide(job, plan));
    expect_costs(job, plan);
    BSQ_TRY(bake_farm_add_inputs(plan));
    BSQ_TRY(check_named_inputs(plan, job->options));
    BSQ_TRY(bake_surface_check(&job->surface));
    status = bake_farm_plan_write(plan, kept);
done:
    bake_close_plan(plan);
    return status;
}

int bake_write_plan(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t tasks,
                    const char *path, bool *kept, struct bake_report *report)
{
    struct bake_work *job;
    *kept = false;
    if (tasks < 1 || tasks > BAKE_MAX_TASKS)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u tasks: must be 1 to %d", tasks, BAKE_MAX_TASKS);
    if (options->glb_path)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: tasks do not make a GLB file", options->glb_path);
    int status = bake_begin_job(ctx, options, report, &job);
    return status < 0 ? status : bake_end_job(job, plan_job(job, tasks, path, kept));
}

int bake_open_plan(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out)
{
    int status = bake_farm_plan_read(ctx, path, out);
    if (status == 0)
        status = bake_check_options(ctx, &(*out)->options);
    if (status < 0) {
        bake_close_plan(*out);
        *out = NULL;
    }
    return status;
}

struct bake_plan_facts bake_describe_plan(const struct bake_farm_plan *plan)
{
    return (struct bake_plan_facts){&plan->options, plan->tasks, plan->tile_count, plan->expected};
}

int bake_plan_part_path(const struct bake_farm_plan *plan, uint32_t task, char **out)
{
    return bake_farm_path(plan, "part", task, out);
}

/* ---- a task ---- */

int bake_farm_check_output(const struct bake_farm_plan *plan, const char *kind, uint32_t number)
{
    char *path;
    int status = bake_farm_path(plan, kind, number, &path);
    if (status == 0)
        status = bsq_output_check(plan->ctx, path);
    free(path);
    return status;
}

int bake_farm_open_job(struct bake_work *job, const struct bake_farm_plan *plan)
{
    int status;
    BSQ_TRY(bake_farm_check_inputs(plan));
    BSQ_TRY(bake_open_inputs(job));
    BSQ_TRY(bake_set_params(job));
    bool same = job->udim.count == plan->tile_count;
    for (uint32_t i = 0; same && i < plan->tile_count; i++) {
        const struct bake_baked_tile *tile = &job->report->tiles[i];
        const struct bake_farm_tile *planned = &plan->tiles[i];
        same = tile->tile == planned->tile && tile->width == planned->width &&
               tile->height == planned->height;
    }
    if (!same)
        status = bsq_fail(job->ctx, BSQ_EDATA, "%s: the plan has other UDIM tiles than its inputs",
                          plan->path);
done:
    return status;
}

/* seconds: what one core is expected to take. */
static int trace_task(struct bake_work *job, double seconds)
{
    int status;
    BSQ_TRY(bake_prepare_triangles(job));
    BSQ_TRY(bake_open_device(job, seconds));
    BSQ_TRY(bake_trace_maps(job));
    if (job->maps & BAKE_MAP_CURVATURE)
        BSQ_TRY(bake_trace_curvature(job));
    bake_end_tracing(job);
    status = bake_surface_check(&job->surface);
done:
    return status;
}

static int write_part(const struct bake_work *job, const struct bake_farm_plan *plan, uint32_t task)
{
    const struct bake_report *report = job->report;
    struct bake_farm_found found = {.counts = {report->covered_texels, report->samples,
                                               report->hits, report->overlapping_samples,
                                               job->curvature.texels, job->curvature.alone}};
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count; i++)
        if (job->tiles[i].image)
            BSQ_TRY(bake_image_measure(job->ctx, job->tiles[i].image, job->maps, found.statistics));
    status = bake_farm_part_write(plan, task, job->tiles, &found);
done:
    return status;
}

static int run_task(struct bake_work *job, const struct bake_farm_plan *plan, uint32_t task)
{
    uint64_t blocks = 0;
    int status;
    BSQ_TRY(bake_farm_check_output(plan, "part", task));
    BSQ_TRY(bake_farm_open_job(job, plan));
    for (uint32_t i = 0; i < job->udim.count; i++) {
        job->tiles[i].in_blocks = true;
        BSQ_TRY(bake_farm_task_blocks(plan, i, task, &job->tiles[i].blocks));
        blocks += job->tiles[i].blocks.count;
    }
    if (blocks > 0)
        BSQ_TRY(trace_task(job, plan->expected[task].cpu_seconds));
    status = write_part(job, plan, task);
done:
    return status;
}

int bake_run_task(struct bsq_ctx *ctx, const struct bake_farm_plan *plan, uint32_t task,
                  const char *device, bool force, bool *kept, struct bake_report *report)
{
    struct bake_work *job;
    struct bake_options options = plan->options;
    int status = 0;
    *kept = false;
    if (bsq_clear_report(ctx, "bake_report", report, sizeof *report) < 0)
        return BSQ_EUSAGE;
    if (device)
        options.device = device;
    if (task >= plan->tasks)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: there is no task %u: tasks are 0 to %u", plan->path,
                        task, plan->tasks - 1);
    if (!force)
        status = bake_farm_part_is_there(plan, task, kept);
    if (status == 0 && *kept)
        status = bake_farm_check_inputs(plan);
    if (status < 0 || *kept)
        return status;
    status = bake_begin_job(ctx, &options, report, &job);
    return status < 0 ? status : bake_end_job(job, run_task(job, plan, task));
}
