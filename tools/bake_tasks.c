/* bake_tasks.c - see bake_tasks.h. */
#include "tools/bake_tasks.h"

#include <stdlib.h>

#include "tools/cli_percent.h"

#define MEMBER(kind, member) BSQ_MEMBER(kind, struct bake_tasks, member)

const struct bsq_option bake_task_rows[BAKE_TASK_ROWS] = {
    {.name = "tasks",
     .argument = "N",
     .heading = "Tasks for several machines",
     MEMBER(COUNT, tasks),
     BSQ_RANGE(1, BAKE_MAX_TASKS, 0),
     .help = "with --write-plan: divide the work into N tasks (default: none)"},
    {.name = "write-plan",
     .argument = "FILE",
     MEMBER(OUTPUT, write_plan),
     .help = "write a plan of the tasks, and do nothing else"},
    {.name = "plan",
     .argument = "FILE",
     MEMBER(INPUT, plan),
     .help = "take inputs, output and options from a plan\n"
             "alone: print how many tasks it has, and what each needs"},
    {.name = "task",
     .argument = "I | I-J",
     .own_syntax = true,
     MEMBER(FLAG, task_given),
     .help = "do task I, or I to J, of the plan, from 0 on, into part files"},
    {.name = "merge", MEMBER(FLAG, merge), .help = "write the outputs from all parts of the plan"},
    {.name = "force",
     MEMBER(FLAG, force),
     .help = "do it again if the part or the outputs are there already"},
};

int bake_tasks_parse_range(struct cli *cli, struct bake_tasks *tasks, const char *text)
{
    unsigned long long number[2] = {0};
    const char *at = text;
    char *end;
    tasks->task_given = true;
    for (int i = 0; i < 2; i++) {
        number[i] = strtoull(at, &end, 10);
        if (*at < '0' || *at > '9' || number[i] >= BAKE_MAX_TASKS || (*end && (*end != '-' || i)))
            return cli_usage(cli, "--task: \"%s\" is no number from 0 to %d, and no range of them",
                             text, BAKE_MAX_TASKS - 1);
        at = *end ? end + 1 : at;
    }
    tasks->task = (uint32_t)number[0];
    tasks->last_task = (uint32_t)number[1];
    return number[0] <= number[1]
               ? 0
               : cli_usage(cli, "--task: \"%s\": the first task comes after the last one", text);
}

int bake_tasks_check(struct cli *cli, const struct bake_tasks *tasks, const char *work_option,
                     int files)
{
    const bool work = tasks->task_given || tasks->merge;
    if (!tasks->write_plan != !tasks->tasks)
        return cli_usage(cli, "--tasks and --write-plan need each other");
    if (work && !tasks->plan)
        return cli_usage(cli, "--task and --merge need --plan");
    if (tasks->force && !work)
        return cli_usage(cli, "--force needs --task or --merge");
    if (!tasks->plan)
        return 0;
    if (tasks->task_given && tasks->merge)
        return cli_usage(cli, "--task and --merge exclude each other");
    if (tasks->write_plan)
        return cli_usage(cli, "--plan and --write-plan exclude each other");
    if (work_option)
        return cli_usage(cli, "--plan has the options of the work: leave out --%s", work_option);
    return files == 0 ? 0 : cli_usage(cli, "--plan names the inputs: leave out the files");
}

int bake_tasks_run(struct cli *cli, const struct bake_tasks *tasks, uint32_t count,
                   int (*fn)(struct cli *cli, void *arg, uint32_t task), void *arg)
{
    const uint32_t first = tasks->task, last = tasks->last_task;
    int status = last < count
                     ? 0
                     : bsq_fail(cli->ctx, BSQ_EUSAGE, "%s: there is no task %u: tasks are 0 to %u",
                                tasks->plan, last, count - 1);
    for (uint32_t task = first; task <= last && status == 0; task++) {
        cli_percent_turn(cli, task - first, last - first + 1);
        status = fn(cli, arg, task);
    }
    return status;
}
