/* bake_tasks.h - the options of a bake that is divided into tasks. */
#ifndef BAKE_TASKS_H
#define BAKE_TASKS_H

#include "libbake/bake.h"
#include "tools/cli.h"

struct bake_tasks {
    const char *write_plan; /* plan to write; NULL: none */
    const char *plan;       /* plan to work by; NULL: none */
    uint32_t tasks;         /* of the plan to write; 0: not given */
    uint32_t task;          /* the first one to do */
    uint32_t last_task;     /* the last one to do */
    bool task_given, merge, force;
};

/* The rows of the options of tasks; they set members of struct bake_tasks. */
enum { BAKE_TASK_ROWS = 6 };
extern const struct bsq_option bake_task_rows[BAKE_TASK_ROWS];

/* Parses the number of a task, or of the first and the last one with a dash between them. */
int bake_tasks_parse_range(struct cli *cli, struct bake_tasks *tasks, const char *text);

/* Checks the options against each other. work_option: the name of an option of the work itself that
 * was given, which a plan has already; NULL if none was. files: how many were given. */
int bake_tasks_check(struct cli *cli, const struct bake_tasks *tasks, const char *work_option,
                     int files);

/* Calls fn for each task that was asked for, one after the other. count: tasks of the plan. Returns
 * the first failure. */
int bake_tasks_run(struct cli *cli, const struct bake_tasks *tasks, uint32_t count,
                   int (*fn)(struct cli *cli, void *arg, uint32_t task), void *arg);

#endif
