/* bake_farm.c - see bake_farm.h. */
#include "tools/bake_farm.h"

#include <stdlib.h>

#include "tools/bake_report.h"

/* ---- options ---- */

#define MEMBER(kind, member) BSQ_MEMBER(kind, struct bake_tasks, member)

const struct bsq_option bake_task_rows[BAKE_TASK_ROWS] = {
    {BSQ_ROW("tasks", "N",
             "divide the work into N tasks, and write only their plan (default: none)"),
     .heading = "Tasks for several machines", MEMBER(COUNT, tasks),
     BSQ_RANGE(1, BAKE_MAX_TASKS, 0)},
    {BSQ_ROW("plan", "FILE",
             "with --tasks: the plan to write\n"
             "else: take inputs, output and options from it; alone: print how\n"
             "many tasks it has, and what each needs"),
     MEMBER(INPUT, plan)},
    {BSQ_ROW("task", "I | I-J", "do task I, or I to J, of the plan, from 0 on, into part files"),
     BSQ_OWN},
    {BSQ_ROW("merge", NULL,
             "write all maps from the parts of the plan, and the preview\n"
             "with --task I: only the maps of UDIM tile I, from 0 on"),
     MEMBER(FLAG, merge)},
    {BSQ_ROW("force", NULL, "do it again if the part or the outputs are there already"),
     MEMBER(FLAG, force)},
};

int bake_farm_parse(struct cli *cli, const char *option, const char *text, struct bake_numbers *out)
{
    unsigned long long number[2] = {0};
    const char *at = text;
    char *end;
    for (int i = 0; i < 2; i++) {
        number[i] = strtoull(at, &end, 10);
        if (*at < '0' || *at > '9' || number[i] >= BAKE_MAX_TASKS || (*end && (*end != '-' || i)))
            return cli_usage(cli, "--%s: \"%s\" is no number from 0 to %d, and no range of them",
                             option, text, BAKE_MAX_TASKS - 1);
        at = *end ? end + 1 : at;
    }
    *out = (struct bake_numbers){true, (uint32_t)number[0], (uint32_t)number[1]};
    return out->first <= out->last
               ? 0
               : cli_usage(cli, "--%s: \"%s\": the first number comes after the last one", option,
                           text);
}

int bake_farm_check(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_tasks *tasks = &arguments->farm;
    const struct cli_table table = bake_arguments_table(arguments);
    const struct bsq_option *row = cli_given(&table, false);
    const bool works = tasks->task.given || tasks->merge;
    if (tasks->tasks) {
        tasks->write_plan = tasks->plan;
        tasks->plan = NULL;
    }
    if (tasks->plan && (!tasks->task.given || tasks->merge) && cli_is_given(&table, "device"))
        return cli_usage(cli, "--plan has the device of the tasks: give --device to --task only");
    if (tasks->plan && (!tasks->merge || tasks->task.given) && cli_is_given(&table, "max-missed"))
        return cli_usage(cli, "--max-missed is for the bake of all texels: give it to --merge");
    if (tasks->tasks && arguments->bake.page_path)
        return cli_usage(cli, "--report shows a bake in one piece, without --tasks");
    if (tasks->tasks && !tasks->write_plan)
        return cli_usage(cli, "--tasks needs --plan, the file to write");
    if (works && !tasks->plan)
        return cli_usage(cli, "--task and --merge need --plan, without --tasks");
    if (tasks->force && !works)
        return cli_usage(cli, "--force needs --task or --merge");
    if (tasks->plan && row)
        return cli_usage(cli, "--plan has the options of the work: leave out --%s", row->name);
    if (tasks->plan && arguments->file_count > 0)
        return cli_usage(cli, "--plan names the inputs: leave out the files, or add --tasks");
    return 0;
}

/* ---- the plan ---- */

int bake_farm_print(struct cli *cli, const char *path, const struct bake_farm_plan *plan, bool kept)
{
    char memory[CLI_TEXT], scratch[CLI_TEXT], parts[CLI_TEXT], texels[CLI_TEXT];
    const struct bake_plan_facts facts = bake_describe_plan(plan);
    struct bake_task_cost most = {0}, all = {0}; /* of any task; of all */
    for (uint32_t i = 0; i < facts.tasks; i++) {
        const struct bake_task_cost *cost = &facts.costs[i];
        if (cost->memory_bytes > most.memory_bytes)
            most.memory_bytes = cost->memory_bytes;
        if (cost->scratch_bytes > most.scratch_bytes)
            most.scratch_bytes = cost->scratch_bytes;
        if (cost->cpu_seconds > most.cpu_seconds)
            most.cpu_seconds = cost->cpu_seconds;
        all.texels += cost->texels;
        all.part_bytes += cost->part_bytes;
        all.cpu_seconds += cost->cpu_seconds;
    }
    if (cli->json)
        return cli_print_json(cli, json_pack("{s:o, s:b, s:i, s:i, s:I, s:I, s:I, s:I, s:f, s:f}",
                                             "path", cli_json_text(path), "kept", (int)kept,
                                             "tasks", (int)facts.tasks, "tiles", (int)facts.tiles,
                                             "texels", (json_int_t)all.texels, "task_memory_bytes",
                                             (json_int_t)most.memory_bytes, "task_scratch_bytes",
                                             (json_int_t)most.scratch_bytes, "parts_bytes",
                                             (json_int_t)all.part_bytes, "task_cpu_seconds",
                                             most.cpu_seconds, "cpu_seconds", all.cpu_seconds));
    cli_print("%s: %s for %s", path, cli_counted_text(facts.tasks, "task", "tasks", memory),
              cli_counted_text(all.texels, "texel", "texels", texels));
    cli_print(" in %s%s\n", cli_counted_text(facts.tiles, "tile", "tiles", texels),
              kept ? ", was there already" : "");
    cli_print("a task: about %s of memory with eight threads, ",
              cli_size_text(most.memory_bytes, memory));
    if (most.scratch_bytes > 0)
        cli_print("%s of temporary files with less, ", cli_size_text(most.scratch_bytes, scratch));
    cli_print("%.3g s of one core\n", most.cpu_seconds);
    cli_print("all parts: at most %s\n", cli_size_text(all.part_bytes, parts));
    return 0;
}

int bake_farm_plan(struct cli *cli, const struct bake_arguments *arguments,
                   struct bake_report *report)
{
    struct bake_farm_plan *plan = NULL;
    const char *path = arguments->farm.write_plan;
    bool kept = false;
    int status;
    BSQ_TRY(
        bake_write_plan(cli->ctx, &arguments->bake, arguments->farm.tasks, path, &kept, report));
    BSQ_TRY(bake_open_plan(cli->ctx, path, &plan));
    status = bake_farm_print(cli, path, plan, kept);
done:
    bake_close_plan(plan);
    return status;
}

/* ---- a task ---- */

static int print_task(struct cli *cli, const char *path, uint32_t task,
                      const struct bake_report *report)
{
    char samples[CLI_TEXT], misses[CLI_TEXT];
    if (cli->json)
        return cli_print_json(cli, json_pack("{s:o, s:b, s:i, s:s, s:I, s:I, s:I, s:f, s:f}",
                                             "path", cli_json_text(path), "kept", 0, "task",
                                             (int)task, CLI_VALUE(report, device),
                                             CLI_COUNT(report, covered_texels),
                                             CLI_COUNT(report, samples), CLI_COUNT(report, hits),
                                             CLI_VALUE(report, front), CLI_VALUE(report, back)));
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
    struct bake_report report = {.size = sizeof report};
    bool kept = false;
    const struct cli_table table = bake_arguments_table(arguments);
    const char *device = cli_is_given(&table, "device") ? arguments->bake.device : NULL;
    char *path;
    int status;
    bake_report_watch(cli, &report);
    BSQ_TRY(bake_plan_part_path(plan, task, &path));
    BSQ_TRY(bake_run_task(cli->ctx, plan, task, device, arguments->farm.force, &kept, &report));
    status = kept ? cli_say_kept(cli, path, "this part") : print_task(cli, path, task, &report);
done:
    free(path);
    bake_report_watch(cli, NULL);
    bake_report_free(&report);
    return status;
}

int bake_farm_tasks(struct cli *cli, const struct bake_arguments *arguments,
                    const struct bake_farm_plan *plan)
{
    const struct bake_numbers *range = &arguments->farm.task;
    const uint32_t count = bake_describe_plan(plan).tasks;
    int status = 0;
    if (range->last >= count)
        return bsq_fail(cli->ctx, BSQ_EUSAGE, "%s: there is no task %u: tasks are 0 to %u",
                        arguments->farm.plan, range->last, count - 1);
    for (uint32_t task = range->first; task <= range->last && status == 0; task++) {
        cli_percent_turn(cli, task - range->first, range->last - range->first + 1);
        status = run_task(cli, arguments, plan, task);
    }
    return status;
}
