/* cli_tasks.h - the options of work that is divided into tasks, for programs that divide theirs. */
#ifndef CLI_TASKS_H
#define CLI_TASKS_H

#include "tools/cli.h"

struct cli_tasks {
    const char *write_plan; /* plan to write; NULL: none */
    const char *plan;       /* plan to work by; NULL: none */
    uint32_t tasks;         /* of the plan to write; 0: not given */
    uint32_t task;          /* the first one to do */
    uint32_t last_task;     /* the last one to do */
    bool task_given, merge, force;
    bool alone; /* the command is a task without a plan */
};

/* The most tasks that a plan can have. */
enum { CLI_MOST_TASKS = 65536 };

/* The rows of the options of tasks; they set members of struct cli_tasks. */
enum { CLI_TASK_ROWS = 6 };
extern const struct bsq_option cli_task_rows[CLI_TASK_ROWS];

/* Parses the number of a task, or of the first and the last one with a dash between them. */
int cli_tasks_parse_range(struct cli *cli, struct cli_tasks *tasks, const char *text);

/* Checks the options against each other. work_option: the name of an option of the work itself that
 * was given, which a plan has already; NULL if none was. files: how many were given. */
int cli_tasks_check(struct cli *cli, const struct cli_tasks *tasks, const char *work_option,
                    int files);

/* Calls fn for each task that was asked for, one after the other. count: tasks of the plan. Returns
 * the first failure. */
int cli_tasks_run(struct cli *cli, const struct cli_tasks *tasks, uint32_t count,
                  int (*fn)(struct cli *cli, void *arg, uint32_t task), void *arg);

/* The costs of a plan: the largest of any task, and the sums of all. */
struct cli_plan_costs {
    uint32_t tasks;
    uint64_t work;                                  /* of all, in the plan's unit */
    uint64_t task_memory_bytes, task_scratch_bytes; /* largest */
    double task_cpu_seconds;                        /* largest */
    uint64_t parts_bytes;                           /* of all */
    double cpu_seconds;                             /* of all */
};

/* Adds a task. */
void cli_plan_add(struct cli_plan_costs *costs, uint64_t work, uint64_t memory_bytes,
                  uint64_t scratch_bytes, uint64_t part_bytes, double cpu_seconds);

/* Prints the costs of a plan. unit, units: of the work, "texel" and "texels". bound: what the size
 * of the parts is, "at most" or "about". kept: the plan was to be written, but was there already.
 */
int cli_plan_print(struct cli *cli, const char *path, bool kept, const struct cli_plan_costs *costs,
                   const char *unit, const char *units, const char *bound);

#endif
