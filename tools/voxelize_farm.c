/* voxelize_farm.c - see voxelize_farm.h. */
#include "tools/voxelize_farm.h"

#include <stdlib.h>

#include "base/job_files.h"
#include "tools/voxelize_report.h"

/* ---- the plan ---- */

static uint64_t larger(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

/* Sets *most to the largest needs of any task, *all to their sums. */
static void sum_costs(const struct vox_farm_plan *plan, struct vox_task_cost *most,
                      struct vox_task_cost *all)
{
    *most = *all = (struct vox_task_cost){0};
    for (uint32_t i = 0; i < vox_plan_task_count(plan); i++) {
        const struct vox_task_cost *cost = vox_plan_task_cost(plan, i);
        most->memory_bytes = larger(most->memory_bytes, cost->memory_bytes);
        most->scratch_bytes = larger(most->scratch_bytes, cost->scratch_bytes);
        most->cpu_seconds =
            cost->cpu_seconds > most->cpu_seconds ? cost->cpu_seconds : most->cpu_seconds;
        all->regions += cost->regions;
        all->part_bytes += cost->part_bytes;
        all->cpu_seconds += cost->cpu_seconds;
    }
}

static int print_plan(struct cli *cli, const char *path, const struct vox_farm_plan *plan,
                      bool kept)
{
    const uint32_t tasks = vox_plan_task_count(plan);
    struct vox_task_cost most, all;
    char memory[CLI_TEXT], scratch[CLI_TEXT], parts[CLI_TEXT], regions[CLI_TEXT];
    sum_costs(plan, &most, &all);
    if (cli->json)
        return cli_print_json(
            cli,
            json_pack("{s:o, s:b, s:i, s:I, s:I, s:I, s:I, s:f, s:f}", "path", cli_json_text(path),
                      "kept", (int)kept, "tasks", (int)tasks, "regions", (json_int_t)all.regions,
                      "task_memory_bytes", (json_int_t)most.memory_bytes, "task_scratch_bytes",
                      (json_int_t)most.scratch_bytes, "parts_bytes", (json_int_t)all.part_bytes,
                      "task_cpu_seconds", most.cpu_seconds, "cpu_seconds", all.cpu_seconds));
    cli_print("%s: %s for %s%s\n", path, cli_counted_text(tasks, "task", "tasks", memory),
              cli_counted_text(all.regions, "region", "regions", regions),
              kept ? ", was there already" : "");
    cli_print("a task: about %s of memory, %s of temporary files, %.3g s of one core\n",
              cli_size_text(most.memory_bytes, memory), cli_size_text(most.scratch_bytes, scratch),
              most.cpu_seconds);
    cli_print("all parts: about %s\n", cli_size_text(all.part_bytes, parts));
    return 0;
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
