/* bake_farm.h - the tasks of a bake: writes plans and part files, and reports on them. */
#ifndef BAKE_FARM_H
#define BAKE_FARM_H

#include "tools/bake_arguments.h"

/* Writes the plan that the arguments ask for, and prints what its tasks need. */
int bake_farm_plan(struct cli *cli, const struct bake_arguments *arguments,
                   struct bake_report *report);

/* Prints what the tasks of a plan need. */
int bake_farm_print(struct cli *cli, const char *path, const struct bake_farm_plan *plan);

/* Bakes the tasks of a plan that the arguments name, one after the other, and prints a report of
 * each. Ends with the first that fails. */
int bake_farm_tasks(struct cli *cli, const struct bake_arguments *arguments,
                    struct bake_farm_plan *plan);

/* Says that the maps of the plan are there already. */
int bake_farm_say_merged(struct cli *cli, const struct bake_arguments *arguments);

#endif
