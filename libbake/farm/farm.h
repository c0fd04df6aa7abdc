/* farm.h - a bake as tasks: the plan, and the part that each task makes.
 *
 * In: a bake's options, with all that tasks must share, and the blocks of its maps. Out: a plan
 * file, which says what each task bakes, and part files, which hold the texels of blocks.
 * FORMATS.md describes both files.
 *
 * A block is a square of texels of one UDIM tile. Tasks get blocks along a curve through the scan,
 * so that the rays of a task cross few chunks that other tasks read too. A texel does not depend
 * on its block, so the maps do not depend on the division. */
#ifndef BAKE_FARM_FARM_H
#define BAKE_FARM_FARM_H

#include "formats/farm/farm.h"
#include "libbake/bake.h"
#include "libbake/maps/maps.h"

/* ---- the plan ---- */

/* A UDIM tile, of one object or material if these have maps of their own, and its blocks. */
struct bake_farm_tile {
    uint32_t number, width, height; /* texels */
    char *object, *material;        /* owned; or NULL */
    uint32_t columns, rows;         /* of blocks */
    uint32_t *tasks;                /* for each block: the task that bakes it */
};

struct bake_farm_plan {
    struct fmt_farm_plan base;
    struct bake_options options; /* with distances, maps and radius as all tasks use them */
    const char *task_device;     /* traces the rays of tasks; NULL: that of the options */
    bool owns_options;           /* the strings and arrays in them */
    uint32_t block_side;
    struct bake_farm_tile *tiles;
    uint32_t tile_count;
    struct bake_task_cost *costs; /* one a task */
    uint64_t degenerate_triangles;
};

/* Makes a plan without inputs and tiles. The strings and arrays of `options` must outlive it. Free
 * *out with bake_farm_plan_free(). Errors: BSQ_ENOMEM. */
int bake_farm_plan_create(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                          uint32_t task_count, struct bake_farm_plan **out);
void bake_farm_plan_free(struct bake_farm_plan *plan); /* NULL is allowed */

/* Adds tiles with the numbers, names, sizes and blocks that options and block_side give. No block
 * has a task yet. Errors: BSQ_ENOMEM. */
int bake_farm_add_tiles(struct bake_farm_plan *plan, const struct bake_baked_tile *tiles,
                        uint32_t count);

/* Writes the plan file, computes its id, and sets *kept if the same plan was there already. Errors:
 * BSQ_EUSAGE for a file name that is not UTF-8; BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int bake_farm_plan_write(struct bake_farm_plan *plan, bool *kept);

/* Reads a plan file. Free *out with bake_farm_plan_free(). Errors: BSQ_ENOINPUT; BSQ_EDATA for a
 * file that is no plan, is damaged or was written by another version. */
int bake_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out);

/* ---- dividing ---- */

/* A block and the work in it. */
struct bake_farm_block {
    uint64_t place;       /* on the curve through the scan */
    uint32_t tile, block; /* indices */
    uint32_t samples;     /* in triangles, one a texel */
};

/* Returns a side for blocks: smaller if many tasks share few texels. */
uint32_t bake_farm_block_side(const struct bake_baked_tile *tiles, uint32_t tile_count,
                              uint32_t task_count);

/* Gives each block of the plan's tiles to a task, so that all have about as many samples. `blocks`
 * lists those with samples and is sorted. Errors: BSQ_ENOMEM. */
int bake_farm_divide(struct bake_farm_plan *plan, struct bake_farm_block *blocks, uint64_t count);

/* Makes the list of a tile's blocks that a task bakes. The caller frees blocks->slots with
 * bsq_free(). Errors: BSQ_ENOMEM; BSQ_EUSAGE if these are too many for one task. */
int bake_farm_task_blocks(const struct bake_farm_plan *plan, uint32_t tile, uint32_t task,
                          struct bake_blocks *out);

/* ---- parts ---- */

/* What a task counted, for the report of the bake. */
struct bake_farm_counts {
    uint64_t covered_texels, samples, hits, overlapping_samples;
    uint64_t curvature_texels, curvature_alone; /* of struct bake_curvature_counts */
};

/* The texels of one tile. */
struct bake_farm_image {
    struct bake_blocks blocks; /* those of a task; unused when parts are merged */
    struct bake_image *image;  /* NULL: the task has no blocks in this tile */
};

/* Writes the part of a task: one image for each tile of the plan. Blocks without covered texels are
 * left out. Tries again if another task of the same number took the file away. Errors: BSQ_EIO,
 * BSQ_ECANTCREAT, BSQ_ENOMEM, BSQ_EINTR. */
int bake_farm_part_write(const struct bake_farm_plan *plan, uint32_t task,
                         const struct bake_farm_image *images,
                         const struct bake_farm_counts *counts);

/* Sets *out if the part of a task is there, complete and of this plan. Errors: BSQ_ENOMEM,
 * BSQ_EINTR. */
int bake_farm_part_is_there(const struct bake_farm_plan *plan, uint32_t task, bool *out);

/* Checks that all parts are there and of this plan. Errors: BSQ_ENOINPUT, which names the missing
 * ones; BSQ_EDATA. */
int bake_farm_parts_check(const struct bake_farm_plan *plan);

/* Copies all parts into images, one for each tile of the plan, and adds up their counts. Errors:
 * those of bake_farm_parts_check() and bake_image_write(). */
int bake_farm_parts_read(const struct bake_farm_plan *plan, const struct bake_farm_image *images,
                         struct bake_farm_counts *counts);

#endif
