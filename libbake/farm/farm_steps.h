/* farm_steps.h - what planning, tasks and merges share; private to this folder. */
#ifndef BAKE_FARM_FARM_STEPS_H
#define BAKE_FARM_FARM_STEPS_H

#include "libbake/farm/farm.h"
#include "libbake/job/job.h"

/* Checks that the inputs are those of the plan, opens them, and checks that they give its tiles. */
int bake_farm_open_job(struct bake_work *job, const struct bake_farm_plan *plan);

/* Checks before the work that a file of bake_farm_path() can be written. */
int bake_farm_check_output(const struct bake_farm_plan *plan, const char *kind, uint32_t number);

#endif
