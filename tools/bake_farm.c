/* bake_farm.c - see bake_farm.h. */
#include "tools/bake_farm.h"

#include <stdlib.h>
#include <string.h>

#include "tools/cli_percent.h"

/* Prints that a file is there already. */
static int say_kept(struct cli *cli, const char *path, const char *what)
{
    if (!cli->json) {
        cli_print("%s: %s is complete already, kept\n", path, what);
        return 0;
    }
    return cli_print_json(cli, json_pack("{s:o, s:b}", "path", cli_json_text(path), "kept", 1));
}

int bake_farm_say_merged(struct cli *cli, const struct bake_arguments *arguments)
{
    return say_kept(cli, arguments->plan, "the merge of this plan");
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
    const char *path = arguments->write_plan;
    bool kept = false;
    int status = bake_write_plan(cli->ctx, &arguments->bake, arguments->tasks, path, &kept, report);
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

static int run_task(struct cli *cli, const struct bake_arguments *arguments,
                    const struct bake_farm_plan *plan, uint32_t task)
{
    struct bake_report report = {0};
    bool kept = false;
    cli->tile_count = &report.tile_count; /* cppcheck-suppress autoVariables; until the end */
    int status = bake_run_task(cli->ctx, plan, task, arguments->force, &kept, &report);
    char *path = status == 0 ? bake_plan_part_path(plan, task) : NULL;
    if (status == 0 && !path)
        status = bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", arguments->plan);
    if (status == 0)
        status = kept ? say_kept(cli, path, "this part") : print_task(cli, path, task, &report);
    free(path);
    cli->tile_count = NULL;
    bake_report_free(&report);
    return status;
}

int bake_farm_tasks(struct cli *cli, const struct bake_arguments *arguments,
                    const struct bake_farm_plan *plan)
{
    const uint32_t first = arguments->task, last = arguments->last_task;
    const uint32_t count = bake_plan_task_count(plan);
    int status = last < count
                     ? 0
                     : bsq_fail(cli->ctx, BSQ_EUSAGE, "%s: there is no task %u: tasks are 0 to %u",
                                arguments->plan, last, count - 1);
    for (uint32_t task = first; task <= last && status == 0; task++) {
        cli_percent_turn(cli, task - first, last - first + 1);
        status = run_task(cli, arguments, plan, task);
    }
    return status;
}
