/* voxelize_farm.c - a grid as tasks: writes the plan, makes the regions of one task, merges parts.
 *
 * A region depends on no other, so a task runs the pipeline of a whole grid on its own regions. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/clock.h"
#include "base/loss.h"
#include "formats/farm/farm.h"
#include "libvoxel/farm/farm.h"
#include "libvoxel/voxelize/grid_estimate.h"
#include "libvoxel/voxelize/voxelize_run.h"

/* Work of visiting a chunk for a region, and of a region itself, in triangles. */
static const double visit_work = 1000.0, region_work = 1000.0;

/* ---- the regions of a grid ---- */

/* Calls fn for each region and each chunk that touches it; chunk is UINT32_MAX for the first call
 * of a region. */
static int visit_regions(const struct vox_run *run,
                         int (*fn)(void *arg, const int32_t origin[3], uint32_t chunk), void *arg)
{
    struct vox_schedule *schedule;
    struct vox_region_key key, after;
    uint64_t visited = 0;
    uint32_t chunk;
    int status = vox_schedule_create(run->ctx, run->boxes, run->box_count, run->filter, &schedule);
    while (status == 0 && vox_schedule_next(schedule, &key)) {
        int32_t origin[3];
        vox_region_origin(key, origin);
        status = fn(arg, origin, UINT32_MAX);
        while (vox_schedule_chunk(schedule, &chunk, &after))
            if (status == 0)
                status = fn(arg, origin, chunk);
        if (status == 0 && visited++ % 1024 == 0)
            status = bsq_check(run->ctx);
    }
    vox_schedule_destroy(schedule);
    return status;
}

/* ---- the plan ---- */

struct division {
    const struct vox_run *run;
    const struct vox_farm_plan *plan;
    double *share; /* of each chunk: its triangles for each region that its boxes touch */
    struct vox_farm_region *regions;
    uint64_t count, capacity;
};

static int count_region(void *arg, const int32_t origin[3], uint32_t chunk)
{
    struct division *d = arg;
    if (chunk != UINT32_MAX) {
        d->regions[d->count - 1].work += d->share[chunk] + visit_work;
        return 0;
    }
    int status = bsq_grow(d->run->ctx, "regions", d->count + 1, sizeof *d->regions, &d->regions,
                          &d->capacity);
    if (status == 0)
        d->regions[d->count++] =
            (struct vox_farm_region){vox_farm_place(d->plan, origin), region_work};
    return status;
}

/* Spreads the triangles of each chunk evenly over the regions of its boxes. */
static int share_triangles(struct division *d)
{
    const struct vox_run *run = d->run;
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(run->file);
    int status =
        bsq_calloc(run->ctx, "chunks", run->header->chunk_count, sizeof *d->share, &d->share);
    if (status < 0)
        return status;
    for (uint64_t i = 0; i < run->box_count; i++)
        d->share[run->boxes[i].chunk] += vox_region_count(&run->boxes[i].box);
    for (uint64_t i = 0; i < run->header->chunk_count; i++)
        d->share[i] = infos[i].triangle_count / d->share[i];
    return 0;
}

static int divide(const struct vox_run *run, struct vox_farm_plan *plan)
{
    struct division d = {.run = run, .plan = plan};
    int status = share_triangles(&d);
    if (status == 0)
        status = visit_regions(run, count_region, &d);
    if (status == 0)
        vox_farm_divide(plan, d.regions, d.count);
    bsq_free(run->ctx, d.regions);
    bsq_free(run->ctx, d.share);
    return status;
}

/* Seconds of one core: to start, for a triangle of a chunk that is loaded, and for a value of a
 * voxel, which has two or more. docs/decisions/0073 has the measurements. */
static const double start_seconds = 0.03, triangle_seconds = 0.17e-6, value_seconds = 0.1e-6;

/* Voxels of a leaf, and bytes of one in a part. */
enum { LEAF_VOXELS = 64, LEAF_BYTES = 72, SAMPLES = 16 };

static int expect_costs(const struct vox_run *run, struct vox_farm_plan *plan)
{
    enum { OTHER_BYTES = 96 << 20 }; /* sums and results */
    const double triangles = (double)run->header->triangle_count;
    const double chunks = (double)run->header->chunk_count;
    const uint64_t slot = vox_chunks_slot_bytes(run->file, true);
    const uint64_t open = bsq_memory_used(run->ctx);
    double voxels = 0.0, all = 0.0;
    int status = vox_estimate_voxels(run->ctx, run->file, &run->shared.transform, SAMPLES, &voxels);
    for (uint32_t i = 0; i < plan->base.task_count; i++)
        all += plan->costs[i].work;
    for (uint32_t i = 0; i < plan->base.task_count && status == 0; i++) {
        struct vox_task_cost *cost = &plan->costs[i];
        const double share = cost->work / all, own = voxels * share;
        const double read = 8.0 + 2.0 * share * chunks;
        /* If the surface of a task is a square that covers n chunks, it touches (sqrt(n) + 1)^2. */
        const double side = sqrt(share * chunks) + 1.0;
        cost->memory_bytes = open + OTHER_BYTES + (uint64_t)(read < chunks ? read : chunks) * slot;
        cost->part_bytes =
            (uint64_t)(own * (4.0 * vox_run_channels(run)) + own * LEAF_BYTES / LEAF_VOXELS);
        cost->cpu_seconds = start_seconds +
                            triangles * fmin(side * side / chunks, 1.0) * triangle_seconds +
                            own * vox_run_channels(run) * value_seconds;
    }
    return status;
}

/* Opens the textures, so that they are among the inputs. */
static int open_textures(const struct vox_run *run)
{
    struct vox_shading shading;
    int status = vox_shading_init(run->ctx, run->header, bsq_memory_left(run->ctx) / 4, &shading);
    if (status < 0)
        return status;
    if (run->options->channels)
        status = vox_shading_use_channels(run->ctx, run->file, run->options->channels,
                                          bsq_memory_left(run->ctx) / 4, &shading);
    if (status == 0)
        status = vox_shading_use_normal_map(run->ctx, run->options->tris_path,
                                            run->options->scan_normal_map,
                                            bsq_memory_left(run->ctx) / 4, &shading);
    vox_shading_free(run->ctx, &shading);
    return status;
}

static int make_plan(struct vox_run *run, uint32_t tasks, const char *path, bool *kept)
{
    const struct vox_transform *transform = &run->shared.transform;
    struct vox_farm_plan *plan = NULL;
    int status = vox_farm_plan_create(run->ctx, path, run->options, tasks, transform->voxels.lo,
                                      transform->voxels.hi, &plan);
    if (status < 0)
        return status;
    plan->voxel_size = transform->h;
    memcpy(plan->start, transform->start, sizeof plan->start);
    status = divide(run, plan);
    if (status == 0)
        status = expect_costs(run, plan);
    if (status == 0)
        status = open_textures(run);
    if (status == 0)
        status = fmt_farm_add_inputs(&plan->base);
    if (status == 0)
        status = vox_farm_plan_write(plan, kept);
    vox_farm_plan_free(plan);
    return status;
}

int vox_write_plan(struct bsq_ctx *ctx, const struct vox_voxelize_options *options, uint32_t tasks,
                   const char *path, bool *kept)
{
    struct vox_run run = {0};
    *kept = false;
    int status = vox_grid_note_outputs(ctx, options);
    if (status == 0)
        status = bsq_output_check(ctx, path);
    if (status == 0)
        status = vox_run_open(ctx, options, &run);
    if (status == 0)
        status = vox_run_find_boxes(&run, NULL);
    if (status == 0)
        status = vox_run_check_grid(&run);
    if (status == 0)
        status = make_plan(&run, tasks, path, kept);
    vox_run_close(&run);
    return status;
}

int vox_open_plan(struct bsq_ctx *ctx, const char *path, struct vox_farm_plan **out)
{
    return vox_farm_plan_read(ctx, path, out);
}

void vox_close_plan(struct vox_farm_plan *plan)
{
    vox_farm_plan_free(plan);
}

const struct vox_voxelize_options *vox_plan_options(const struct vox_farm_plan *plan)
{
    return &plan->options;
}

uint32_t vox_plan_task_count(const struct vox_farm_plan *plan)
{
    return plan->base.task_count;
}

const struct vox_task_cost *vox_plan_task_cost(const struct vox_farm_plan *plan, uint32_t task)
{
    return &plan->costs[task];
}

char *vox_plan_part_path(const struct vox_farm_plan *plan, uint32_t task)
{
    return fmt_farm_part_path(&plan->base, task);
}

/* ---- a task ---- */

/* Checks that the inputs are those of the plan, opens them, and checks that the voxels lie where
 * the plan has them. Close the run also after a failure. */
static int open_planned(const struct vox_farm_plan *plan, struct vox_run *run)
{
    const struct vox_transform *transform = &run->shared.transform;
    struct bsq_ctx *ctx = plan->base.ctx;
    int status = fmt_farm_check_inputs(&plan->base);
    bsq_mute_warnings(ctx, true); /* they were given when the plan was made */
    if (status == 0)
        status = vox_run_open(ctx, &plan->options, run);
    bsq_mute_warnings(ctx, false);
    if (status < 0)
        return status;
    bool same = transform->h == plan->voxel_size;
    for (int a = 0; a < 3; a++)
        same = same && transform->start[a] == plan->start[a] &&
               transform->voxels.lo[a] >> VOX_REGION_LOG2 == plan->first_region[a];
    return same ? 0 : fmt_farm_fail_plan(&plan->base, "its inputs give other voxels");
}

/* The regions of a task. */
struct choice {
    const struct vox_farm_plan *plan;
    uint32_t task;
    uint64_t regions; /* that chunks may touch */
};

/* Reading a chunk takes as long as looking at about this many regions. */
static const double most_looked_at = 16384.0;

/* Returns how many regions of the task a box touches, see struct vox_box_filter. */
static uint64_t count_of_task(void *arg, const struct vox_box *box, uint64_t most)
{
    const struct choice *choice = arg;
    const int32_t *lo = box->lo, *hi = box->hi;
    uint64_t count = 0;
    int32_t at[3];
    if (vox_region_count(box) > most_looked_at)
        return most;
    for (at[0] = lo[0] & -VOX_REGION_SIZE; at[0] <= hi[0]; at[0] += VOX_REGION_SIZE)
        for (at[1] = lo[1] & -VOX_REGION_SIZE; at[1] <= hi[1]; at[1] += VOX_REGION_SIZE)
            for (at[2] = lo[2] & -VOX_REGION_SIZE; at[2] <= hi[2]; at[2] += VOX_REGION_SIZE)
                if (vox_farm_task_of(choice->plan, at) == choice->task && ++count == most)
                    return count;
    return count;
}

static int count_own(void *arg, const int32_t origin[3], uint32_t chunk)
{
    struct choice *choice = arg;
    (void)origin;
    choice->regions += chunk == UINT32_MAX;
    return 0;
}

/* Makes the run one of the regions that the filter's choice wants. */
static int choose_regions(struct vox_run *run, const struct vox_box_filter *filter)
{
    struct choice *choice = filter->arg;
    const struct vox_farm_plan *plan = choice->plan;
    int status = vox_run_find_boxes(run, filter);
    if (status == 0)
        status = visit_regions(run, count_own, choice);
    run->expected_triangles = (uint64_t)plan->costs[choice->task].work;
    run->expected_regions = (double)choice->regions;
    return status;
}

struct task_job {
    const struct vox_farm_plan *plan;
    uint32_t task;
    struct vox_task_report *report;
};

static int write_regions(const struct task_job *job, struct vox_run *run, struct bsq_output *output)
{
    struct vox_part_writer *writer = NULL;
    struct vox_part_totals totals = {0};
    int status = vox_part_begin(job->plan, job->task, vox_shading_has_color(run->header),
                                run->options->ids, output, &writer);
    const struct vox_sink sink = {vox_part_append, writer};
    if (status == 0 && run->expected_regions > 0)
        status = vox_run_regions(run, &sink);
    memcpy(totals.index_min, run->index_min, sizeof totals.index_min);
    memcpy(totals.index_max, run->index_max, sizeof totals.index_max);
    if (status == 0)
        status = vox_part_end(writer, &totals);
    vox_part_free(writer);
    *job->report = (struct vox_task_report){.regions = totals.regions,
                                            .voxels = totals.voxels,
                                            .second_records = totals.second_records,
                                            .part_bytes = bsq_output_tell(output)};
    return status;
}

/* Makes the regions of a task and writes them. */
static int write_part(void *arg, struct bsq_output *output)
{
    const struct task_job *job = arg;
    struct vox_run run = {0};
    struct choice choice = {.plan = job->plan, .task = job->task};
    const struct vox_box_filter filter = {count_of_task, &choice};
    int status = open_planned(job->plan, &run);
    if (status == 0)
        status = choose_regions(&run, &filter);
    if (status == 0)
        status = write_regions(job, &run, output);
    vox_run_close(&run);
    return status;
}

static int check_part(void *arg, uint32_t task)
{
    const struct task_job *job = arg;
    return vox_part_check(job->plan, task);
}

int vox_run_task(struct bsq_ctx *ctx, const struct vox_farm_plan *plan, uint32_t task, bool force,
                 bool *kept, struct vox_task_report *report)
{
    const double start = bsq_seconds_now();
    *report = (struct vox_task_report){0};
    struct task_job job = {plan, task, report};
    const struct fmt_farm_part_steps steps = {&job, write_part, check_part};
    *kept = false;
    int status = fmt_farm_check_task(&plan->base, task);
    if (status == 0 && !force)
        status = fmt_farm_part_is_there(&plan->base, task, &steps, kept);
    if (status == 0 && *kept)
        return fmt_farm_check_inputs(&plan->base);
    if (status == 0)
        status = fmt_farm_part_write(&plan->base, task, &steps);
    report->seconds = bsq_seconds_now() - start;
    return status < 0 ? status : bsq_check(ctx);
}

/* ---- merging ---- */

static int append_region(void *arg, const struct fmt_nvdb_region *region)
{
    return fmt_nvdb_append(arg, region);
}

/* Copies the voxels of all parts into the grid of a run. */
static int merge_parts(const struct vox_farm_plan *plan, struct vox_run *run,
                       struct fmt_nvdb_writer *writer)
{
    struct vox_part_totals totals;
    struct vox_parts *parts;
    int status = vox_parts_open(plan, vox_shading_has_color(run->header), plan->options.ids,
                                &totals, &parts);
    const struct fmt_nvdb_totals expected = {.voxels = totals.voxels,
                                             .second_records = totals.second_records,
                                             .leaves = totals.leaves,
                                             .lowers = totals.regions,
                                             .uppers = totals.tiles};
    if (status == 0)
        status = fmt_nvdb_expect(writer, &expected);
    if (status == 0)
        status = vox_parts_read(parts, append_region, writer);
    vox_parts_close(parts);
    memcpy(run->index_min, totals.index_min, sizeof run->index_min);
    memcpy(run->index_max, totals.index_max, sizeof run->index_max);
    return status;
}

static int merge(const struct vox_farm_plan *plan, struct vox_voxelize_report *report)
{
    struct vox_run run = {0};
    struct fmt_nvdb_writer *writer = NULL;
    int status = fmt_farm_check_note_output(&plan->base);
    if (status == 0)
        status = vox_grid_note_outputs(plan->base.ctx, &plan->options);
    if (status == 0)
        status = open_planned(plan, &run);
    if (status == 0)
        status = vox_grid_create(&run, &writer);
    if (status == 0)
        status = merge_parts(plan, &run, writer);
    if (status == 0)
        status = vox_grid_commit(&run, writer, report);
    else
        fmt_nvdb_discard(writer);
    vox_run_close(&run);
    return status;
}

int vox_merge_plan(struct bsq_ctx *ctx, const struct vox_farm_plan *plan, bool force, bool *kept,
                   struct vox_voxelize_report *report)
{
    const double start = bsq_seconds_now();
    char *paths[2] = {(char *)(uintptr_t)plan->options.grid_path,
                      (char *)(uintptr_t)plan->options.vdb_path};
    const uint64_t count = paths[1] ? 2 : 1;
    char found[FMT_FARM_FOUND_BYTES];
    memset(report, 0, sizeof *report);
    *kept = !force && fmt_farm_is_merged(&plan->base, paths, count, found);
    if (*kept)
        return fmt_farm_check_inputs(&plan->base);
    int status = merge(plan, report);
    if (status == 0)
        status = fmt_farm_note_merged(&plan->base, paths, count, "");
    report->seconds = bsq_seconds_now() - start;
    return status < 0 ? status : bsq_check(ctx);
}
