/* grid_use.h - what fuzz targets do with an open grid. Each function aborts if a result is out of
 * range. */
#ifndef FUZZ_GRID_USE_H
#define FUZZ_GRID_USE_H

#include "tests/fuzz/grid_patch.h"

/* The file that fmt_nvdb_open() opens, under any name. */
extern struct patched_grid fuzzed_grid;

/* Looks up voxels on and around the diagonal of the bounds, with their records. */
void grid_use_look_up(const struct fmt_nvdb_grid *grid);
/* Traces rays through the ends of the grid and between them, along axes and askew. */
void grid_use_trace(const struct fmt_nvdb_grid *grid);
/* Traces a patch, to run the code for several rays at a time. */
int grid_use_trace_patch(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);
/* Traces a patch with secondary rays, through the tree of leaves. */
int grid_use_look_around(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

#endif
