/* bake_farm.h - the options of a bake in tasks; writes plans and part files, and reports on them.
 */
#ifndef BAKE_FARM_H
#define BAKE_FARM_H

#include "libbake/bake.h"
#include "tools/cli.h"

struct bake_arguments;

/* A number, or the first and the last one. */
struct bake_numbers {
    bool given;
    uint32_t first, last;
};

struct bake_tasks {
    const char *write_plan;   /* plan to write; NULL: none */
    const char *plan;         /* plan to work by; NULL: none */
    uint32_t tasks;           /* of the plan to write; 0: not given */
    struct bake_numbers task; /* with `merge`: UDIM tiles */
    bool merge, force;
};

/* The rows of these options; they set members of struct bake_tasks. */
enum { BAKE_TASK_ROWS = 5 };
extern const struct bsq_option bake_task_rows[BAKE_TASK_ROWS];

/* Parses the value of an option: a number, or the first and the last one with a dash between. */
int bake_farm_parse(struct cli *cli, const char *option, const char *text,
                    struct bake_numbers *out);

/* Checks the options against each other, and against those of a bake, which a plan has already.
 * Moves the plan to `write_plan` if it is to be written. */
int bake_farm_check(struct cli *cli, struct bake_arguments *arguments);

/* Writes the plan that the arguments ask for, and prints what its tasks need. */
int bake_farm_plan(struct cli *cli, const struct bake_arguments *arguments,
                   struct bake_report *report);

/* Prints what the tasks of a plan need. kept: the plan was to be written, but was there already. */
int bake_farm_print(struct cli *cli, const char *path, const struct bake_farm_plan *plan,
                    bool kept);

/* Bakes the tasks of a plan that the arguments name, one after the other, and prints a report of
 * each. Ends with the first that fails. */
int bake_farm_tasks(struct cli *cli, const struct bake_arguments *arguments,
                    const struct bake_farm_plan *plan);

#endif
