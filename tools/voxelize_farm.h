/* voxelize_farm.h - the tasks of a grid: writes plans and part files, merges parts, and reports. */
#ifndef VOXELIZE_FARM_H
#define VOXELIZE_FARM_H

#include "libvoxel/voxel.h"
#include "tools/cli_tasks.h"

/* Writes the plan that the arguments ask for, and prints what its tasks need. */
int voxelize_farm_plan(struct cli *cli, const struct cli_tasks *tasks,
                       const struct vox_voxelize_options *options);

/* Does tasks of a plan, merges its parts, or prints what it asks for. */
int voxelize_farm_by_plan(struct cli *cli, const struct cli_tasks *tasks);

#endif
