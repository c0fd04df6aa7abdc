/* bake_farm.c - see bake_farm.h. */
#include "tools/bake_farm.h"

#include <stdlib.h>
#include <string.h>

int bake_farm_say_merged(struct cli *cli, const struct bake_arguments *arguments)
{
    return cli_tasks_say_kept(cli, arguments->farm.plan, "the merge of this plan");
}

/* ---- the plan ---- */

/* Sets *most to the largest needs of any task, *all to their sums. */
static void sum_costs(const struct bake_farm_plan *plan, struct bake_task_cost *most,
                      struct bake_task_cost *all)
{
    *most = *all = (struct bake_task_cost){0};
    for (uint32_t i = 0; i < bake_plan_task_count(plan); i++) {
        const struct bake_task_cost *cost = bake_plan_task_cost(plan, i);
        most->memory_bytes =
            cost->memory_bytes > most->memory_bytes ? cost->memory_bytes : most->memory_bytes;
        most->scratch_bytes =
            cost->scratch_bytes > most->scratch_bytes ? cost->scratch_bytes : most->scratch_bytes;
        most->cpu_seconds =
            cost->cpu_seconds > most->cpu_seconds ? cost->cpu_seconds : most->cpu_seconds;
        all->texels += cost->texels;
        all->part_bytes += cost->part_bytes;
        all->cpu_seconds += cost->cpu_seconds;
    }
}

/* kept: the plan was to be written, but was there already. */
static int print_plan(struct cli *cli, const char *path, const struct bake_farm_plan *plan,
                      bool kept)
{
    const uint32_t tasks = bake_plan_task_count(plan);
    struct bake_task_cost most, all;
    char memory[CLI_TEXT], scratch[CLI_TEXT], parts[CLI_TEXT], texels[CLI_TEXT];
    sum_costs(plan, &most, &all);
    if (cli->json)
        return cli_print_json(
            cli,
            json_pack("{s:o, s:b, s:i, s:I, s:I, s:I, s:I, s:f, s:f}", "path", cli_json_text(path),
                      "kept", (int)kept, "tasks", (int)tasks, "texels", (json_int_t)all.texels,
                      "task_memory_bytes", (json_int_t)most.memory_bytes, "task_scratch_bytes",
                      (json_int_t)most.scratch_bytes, "parts_bytes", (json_int_t)all.part_bytes,
                      "task_cpu_seconds", most.cpu_seconds, "cpu_seconds", all.cpu_seconds));
    cli_print("%s: %s for %s%s\n", path, cli_counted_text(tasks, "task", "tasks", memory),
              cli_counted_text(all.texels, "texel", "texels", texels),
              kept ? ", was there already" : "");
    cli_print("a task: about %s of memory, %s of temporary files, %.3g s of one core\n",
              cli_size_text(most.memory_bytes, memory), cli_size_text(most.scratch_bytes, scratch),
              most.cpu_seconds);
    cli_print("all parts: at most %s\n", cli_size_text(all.part_bytes, parts));
    return 0;
}

int bake_farm_print(struct cli *cli, const char *path, const struct bake_farm_plan *plan)
{
    return print_plan(cli, path, plan, false);
}

int bake_farm_plan(struct cli *cli, const struct bake_arguments *arguments,
                   struct bake_report *report)
{
    struct bake_farm_plan *plan = NULL;
    const char *path = arguments->farm.write_plan;
    bool kept = false;
    int status =
        bake_write_plan(cli->ctx, &arguments->bake, arguments->farm.tasks, path, &kept, report);
    if (status == 0)
        status = bake_open_plan(cli->ctx, path, &plan);
    if (status == 0)
        status = print_plan(cli, path, plan, kept);
    bake_close_plan(plan);
    return status;
}

/* ---- a task ---- */

static int print_task(struct cli *cli, const char *path, uint32_t task,
                      const struct bake_report *report)
{
    char samples[CLI_TEXT], misses[CLI_TEXT];
    if (cli->json)
        return cli_print_json(
            cli, json_pack("{s:o, s:b, s:i, s:s, s:I, s:I, s:I, s:f, s:f}", "path",
                           cli_json_text(path), "kept", 0, "task", (int)task, "device",
                           report->device, "covered_texels", (json_int_t)report->covered_texels,
                           "samples", (json_int_t)report->samples, "hits", (json_int_t)report->hits,
                           "front", report->front, "back", report->back));
    cli_print("%s: task %u, %s, %s without surface", path, task,
              cli_counted_text(report->samples, "sample", "samples", samples),
              cli_count_text(report->misses, misses));
    if (report->device[0])
        cli_print(", on %s", report->device);
    putchar('\n');
    cli_print_cost(cli);
    return 0;
}

struct task_job {
    const struct bake_arguments *arguments;
    const struct bake_farm_plan *plan;
};

static int run_task(struct cli *cli, void *arg, uint32_t task)
{
    const struct task_job *job = arg;
    const struct bake_arguments *arguments = job->arguments;
    const struct bake_farm_plan *plan = job->plan;
    struct bake_report report = {0};
    bool kept = false;
    cli->tile_count = &report.tile_count; /* cppcheck-suppress autoVariables; until the end */
    int status = bake_run_task(cli->ctx, plan, task, arguments->farm.force, &kept, &report);
    char *path = status == 0 ? bake_plan_part_path(plan, task) : NULL;
    if (status == 0 && !path)
        status = bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", arguments->farm.plan);
    if (status == 0)
        status = kept ? cli_tasks_say_kept(cli, path, "this part")
                      : print_task(cli, path, task, &report);
    free(path);
    cli->tile_count = NULL;
    bake_report_free(&report);
    return status;
}

int bake_farm_tasks(struct cli *cli, const struct bake_arguments *arguments,
                    const struct bake_farm_plan *plan)
{
    struct task_job job = {arguments, plan};
    return cli_tasks_run(cli, &arguments->farm, bake_plan_task_count(plan), run_task, &job);
}
