/* bake_farm.c - see bake_farm.h. */
#include "tools/bake_farm.h"
#include "tools/bake_report.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

int bake_farm_say_merged(struct cli *cli, const struct bake_arguments *arguments)
{
    return cli_say_kept(cli, arguments->farm.plan, "the merge of this plan");
}

/* ---- the plan ---- */

/* The costs of a plan: the largest of any task, and the sums of all. */
struct plan_costs {
    uint32_t tasks;
    uint64_t texels;                                /* of all */
    uint64_t task_memory_bytes, task_scratch_bytes; /* largest */
    double task_cpu_seconds;                        /* largest */
    uint64_t parts_bytes;                           /* of all */
    double cpu_seconds;                             /* of all */
};

static uint64_t larger(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

static void add_cost(struct plan_costs *costs, const struct bake_task_cost *cost)
{
    costs->tasks++;
    costs->texels += cost->texels;
    costs->task_memory_bytes = larger(costs->task_memory_bytes, cost->memory_bytes);
    costs->task_scratch_bytes = larger(costs->task_scratch_bytes, cost->scratch_bytes);
    costs->task_cpu_seconds = fmax(costs->task_cpu_seconds, cost->cpu_seconds);
    costs->parts_bytes += cost->part_bytes;
    costs->cpu_seconds += cost->cpu_seconds;
}

/* kept: the plan was to be written, but was there already. */
static int print_costs(struct cli *cli, const char *path, bool kept, const struct plan_costs *costs)
{
    char memory[CLI_TEXT], scratch[CLI_TEXT], parts[CLI_TEXT], texels[CLI_TEXT];
    if (cli->json)
        return cli_print_json(
            cli, json_pack("{s:o, s:b, s:i, s:I, s:I, s:I, s:I, s:f, s:f}", "path",
                           cli_json_text(path), "kept", (int)kept, "tasks", (int)costs->tasks,
                           "texels", (json_int_t)costs->texels, "task_memory_bytes",
                           (json_int_t)costs->task_memory_bytes, "task_scratch_bytes",
                           (json_int_t)costs->task_scratch_bytes, "parts_bytes",
                           (json_int_t)costs->parts_bytes, "task_cpu_seconds",
                           costs->task_cpu_seconds, "cpu_seconds", costs->cpu_seconds));
    cli_print("%s: %s for %s%s\n", path, cli_counted_text(costs->tasks, "task", "tasks", memory),
              cli_counted_text(costs->texels, "texel", "texels", texels),
              kept ? ", was there already" : "");
    cli_print("a task: about %s of memory with eight threads, ",
              cli_size_text(costs->task_memory_bytes, memory));
    if (costs->task_scratch_bytes > 0)
        cli_print("%s of temporary files with less, ",
                  cli_size_text(costs->task_scratch_bytes, scratch));
    cli_print("%.3g s of one core\n", costs->task_cpu_seconds);
    cli_print("all parts: at most %s\n", cli_size_text(costs->parts_bytes, parts));
    return 0;
}

static int print_plan(struct cli *cli, const char *path, const struct bake_farm_plan *plan,
                      bool kept)
{
    struct plan_costs costs = {0};
    for (uint32_t i = 0; i < bake_plan_task_count(plan); i++)
        add_cost(&costs, bake_plan_task_cost(plan, i));
    return print_costs(cli, path, kept, &costs);
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
    bake_report_watch(cli, &report);
    int status = bake_run_task(cli->ctx, plan, task, arguments->farm.force, &kept, &report);
    char *path = status == 0 ? bake_plan_part_path(plan, task) : NULL;
    if (status == 0 && !path)
        status = bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", arguments->farm.plan);
    if (status == 0)
        status = kept ? cli_say_kept(cli, path, "this part") : print_task(cli, path, task, &report);
    free(path);
    bake_report_watch(cli, NULL);
    bake_report_free(&report);
    return status;
}

int bake_farm_tasks(struct cli *cli, const struct bake_arguments *arguments,
                    struct bake_farm_plan *plan)
{
    struct task_job job = {arguments, plan};
    bake_plan_use_device(plan,
                         bake_arguments_has(arguments, "device") ? arguments->bake.device : NULL);
    return bake_tasks_run(cli, &arguments->farm, bake_plan_task_count(plan), run_task, &job);
}
