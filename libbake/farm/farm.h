/* farm.h - a bake as tasks: the plan, and the part that each task makes.
 *
 * In: a bake's options, with all that tasks must share, and the blocks of its maps. Out: a plan
 * file, which names all inputs with checksums and says what each task bakes, and part files, which
 * hold the texels of blocks. FORMATS.md describes both files.
 *
 * A block is a square of texels of one UDIM tile. Tasks get blocks along a curve through the scan,
 * so that the rays of a task cross few chunks that other tasks read too. A texel does not depend
 * on its block, so the maps do not depend on the division. */
#ifndef BAKE_FARM_FARM_H
#define BAKE_FARM_FARM_H

#include "libbake/job/job.h"

/* ---- the plan ---- */

/* Members have the names that they have in the file. */

/* A file that the bake reads. All texts are owned. */
struct bake_farm_input {
    char *path, *role;         /* the role is for messages */
    uint64_t bytes;            /* of struct fmt_fingerprint, like the next two */
    char *xxh3_128, *identity; /* the identity may be "": unknown */
};

/* A UDIM tile, of one object or material if these have maps of their own, and its blocks. */
struct bake_farm_tile {
    uint32_t tile, width, height; /* number; texels */
    uint32_t columns, rows;       /* of blocks */
    uint32_t *task_of;            /* for each block: the task that bakes it */
};

struct bake_farm_plan {
    struct bsq_ctx *ctx;
    char *path;                  /* of the plan file */
    char id[33];                 /* a checksum of what is in the file, in hexadecimal digits */
    struct bake_options options; /* with distances, maps and radius as all tasks use them */
    bool owns_options;           /* the strings and arrays in them */
    uint32_t tasks, block_side;
    uint64_t degenerate_triangles;
    struct bake_farm_input *inputs;
    struct bake_farm_tile *tiles;
    struct bake_task_cost *expected; /* one a task */
    uint32_t input_count, tile_count, expected_count;
};

/* Makes a plan without inputs and tiles. The strings and arrays of `options` must outlive it. Free
 * *out with bake_close_plan(). Errors: BSQ_ENOMEM. */
int bake_farm_plan_create(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                          uint32_t tasks, struct bake_farm_plan **out);

/* Adds tiles with the numbers and sizes that options and block_side give. No block has a task yet.
 * Errors: BSQ_ENOMEM. */
int bake_farm_add_tiles(struct bake_farm_plan *plan, const struct bake_baked_tile *tiles,
                        uint32_t count);

/* Adds each file that the job has opened as input, with its fingerprint. Errors: those of
 * fmt_fingerprint(). */
int bake_farm_add_inputs(struct bake_farm_plan *plan);

/* Checks that all inputs are those of the plan. Errors: BSQ_EDATA, which names the first that is
 * not; those of fmt_is_same(). */
int bake_farm_check_inputs(const struct bake_farm_plan *plan);

/* Writes the plan file, computes its id, and sets *kept if the same plan was there already. Errors:
 * BSQ_EUSAGE for a file name that is not UTF-8; BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int bake_farm_plan_write(struct bake_farm_plan *plan, bool *kept);

/* Reads a plan file. Free *out with bake_close_plan(). Errors: BSQ_ENOINPUT; BSQ_EDATA for a
 * file that is no plan, is damaged or was written by another version. */
int bake_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out);

/* ---- dividing ---- */

/* A block and the work in it. */
struct bake_farm_block {
    uint64_t index;       /* on the curve through the scan */
    uint32_t tile, block; /* indices */
    uint32_t samples;     /* in triangles, one a texel */
};

/* Returns a side for blocks: smaller if many tasks share few texels. */
uint32_t bake_farm_block_side(const struct bake_baked_tile *tiles, uint32_t tile_count,
                              uint32_t tasks);

/* Gives each block of the plan's tiles to a task, so that all have about as many samples. `blocks`
 * lists those with samples and is sorted. Errors: BSQ_EINTR. */
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

/* And what the ranges of maps follow from. */
struct bake_farm_found {
    struct bake_farm_counts counts;
    struct bake_statistics statistics[BK_MAP_COUNT];
};

/* Sets *out to the path of a task's part ("part") or of a tile's note ("merged"), which the caller
 * frees. Errors: BSQ_ENOMEM. */
int bake_farm_path(const struct bake_farm_plan *plan, const char *kind, uint32_t number,
                   char **out);

/* Writes the part of a task from the images of its tiles, which hold blocks, or are NULL. Blocks
 * without covered texels are left out. Tries again if another task of the same number took the file
 * away. Errors: BSQ_EIO, BSQ_ECANTCREAT, BSQ_ENOMEM, BSQ_EINTR. */
int bake_farm_part_write(const struct bake_farm_plan *plan, uint32_t task,
                         const struct bake_tile *tiles, const struct bake_farm_found *found);

/* Sets *out if the part of a task is there, complete and of this plan. Errors: BSQ_ENOMEM,
 * BSQ_EINTR. */
int bake_farm_part_is_there(const struct bake_farm_plan *plan, uint32_t task, bool *out);

/* Checks all but the texels of all parts, and adds up what was found. Errors: BSQ_ENOINPUT, which
 * names the missing ones; BSQ_EDATA; BSQ_EINTR. */
int bake_farm_parts_check(const struct bake_farm_plan *plan, struct bake_farm_found *found);

/* Copies a tile's texels from all parts into an image. Errors: those of bake_farm_parts_check() and
 * bake_image_write(). */
int bake_farm_parts_read(const struct bake_farm_plan *plan, uint32_t tile,
                         struct bake_image *image);

/* ---- steps of tasks and merges ---- */

/* Checks that the inputs are those of the plan, opens them, and checks that they give its tiles. */
int bake_farm_open_job(struct bake_work *job, const struct bake_farm_plan *plan);

/* Checks before the work that a file of bake_farm_path() can be written. */
int bake_farm_check_output(const struct bake_farm_plan *plan, const char *kind, uint32_t number);

#endif
