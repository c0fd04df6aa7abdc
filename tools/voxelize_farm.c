/* voxelize_farm.c - see voxelize_farm.h. */
#include "tools/voxelize_farm.h"

#include <stdlib.h>

#include "base/job_files.h"
#include "tools/voxelize_report.h"

/* ---- the plan ---- */

/* kept: the plan was to be written, but was there already. */
static int print_plan(struct cli *cli, const char *path, const struct vox_farm_plan *plan,
                      bool kept)
{
    struct cli_plan_costs costs = {0};
    for (uint32_t i = 0; i < vox_plan_task_count(plan); i++) {
        const struct vox_task_cost *cost = vox_plan_task_cost(plan, i);
        cli_plan_add(&costs, cost->regions, cost->memory_bytes, cost->scratch_bytes,
                     cost->part_bytes, cost->cpu_seconds);
    }
    return cli_plan_print(cli, path, kept, &costs, "region", "regions", "about");
}

int voxelize_farm_plan(struct cli *cli, const struct cli_tasks *tasks,
                       const struct vox_voxelize_options *options)
{
    struct vox_farm_plan *plan = NULL;
    bool kept = false;
    int status = vox_write_plan(cli->ctx, options, tasks->tasks, tasks->write_plan, &kept);
    if (status == 0)
        status = vox_open_plan(cli->ctx, tasks->write_plan, &plan);
    if (status == 0)
        status = print_plan(cli, tasks->write_plan, plan, kept);
    vox_close_plan(plan);
    return status;
}

/* ---- a task ---- */

static int print_task(struct cli *cli, const char *path, uint32_t task,
                      const struct vox_task_report *report)
{
    char voxels[CLI_TEXT], regions[CLI_TEXT], size[CLI_TEXT];
    if (cli->json)
        return cli_print_json(
            cli, json_pack("{s:o, s:b, s:i, s:I, s:I, s:I, s:I, s:f}", "path", cli_json_text(path),
                           "kept", 0, "task", (int)task, "regions", (json_int_t)report->regions,
                           "voxels", (json_int_t)report->voxels, "second_records",
                           (json_int_t)report->second_records, "part_bytes",
                           (json_int_t)report->part_bytes, "seconds", report->seconds));
    cli_print("%s: task %u, %s in %s, %s, %.2f s\n", path, task,
              cli_counted_text(report->voxels, "voxel", "voxels", voxels),
              cli_counted_text(report->regions, "region", "regions", regions),
              cli_size_text(report->part_bytes, size), report->seconds);
    cli_print_cost(cli);
    return 0;
}

struct task_job {
    const struct cli_tasks *tasks;
    const struct vox_farm_plan *plan;
};

static int run_task(struct cli *cli, void *arg, uint32_t task)
{
    const struct task_job *job = arg;
    struct vox_task_report report;
    bool kept = false;
    int status = vox_run_task(cli->ctx, job->plan, task, job->tasks->force, &kept, &report);
    char *path = status == 0 ? vox_plan_part_path(job->plan, task) : NULL;
    if (status == 0 && !path)
        status = bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", job->tasks->plan);
    if (status == 0)
        status = kept ? cli_tasks_say_kept(cli, path, "this part")
                      : print_task(cli, path, task, &report);
    free(path);
    return status;
}

/* ---- the merge ---- */

static int merge(struct cli *cli, const struct cli_tasks *tasks, const struct vox_farm_plan *plan)
{
    const struct vox_voxelize_options *options = vox_plan_options(plan);
    struct vox_voxelize_report report;
    bool kept = false;
    int status = vox_merge_plan(cli->ctx, plan, tasks->force, &kept, &report);
    if (status < 0)
        return status;
    if (kept)
        return cli_tasks_say_kept(cli, tasks->plan, "the merge of this plan");
    if (cli->json)
        return cli_print_json(cli, json_pack("{s:o, s:o, s:b, s:o}", "grid_path",
                                             cli_json_text(options->grid_path), "vdb_path",
                                             cli_json_text(options->vdb_path), "kept", 0, "grid",
                                             voxelize_report_grid_json(&report)));
    voxelize_report_grid(options, &report);
    cli_print_cost(cli);
    return 0;
}

int voxelize_farm_by_plan(struct cli *cli, const struct cli_tasks *tasks)
{
    struct vox_farm_plan *plan = NULL;
    int status = bsq_note_input(cli->ctx, tasks->plan, "the plan");
    if (status == 0)
        status = vox_open_plan(cli->ctx, tasks->plan, &plan);
    struct task_job job = {tasks, plan};
    if (status == 0)
        status = tasks->merge ? merge(cli, tasks, plan)
                 : tasks->task_given
                     ? cli_tasks_run(cli, tasks, vox_plan_task_count(plan), run_task, &job)
                     : print_plan(cli, tasks->plan, plan, false);
    vox_close_plan(plan);
    return status;
}
