/* subgrid.h - a grid, or a part of one, as the arrays that a device needs of it.
 *
 * A part has the layout of a grid file with fewer nodes and records, renumbered: the kernel cannot
 * tell it from a grid. It is not made in memory: bake_part_send() hands out the arrays piece by
 * piece as they go to the device. */
#ifndef BAKE_DEVICE_SUBGRID_SUBGRID_H
#define BAKE_DEVICE_SUBGRID_SUBGRID_H

#include "libbake/kernel/bk_types.h"
#include "libbake/device/subgrid/leaf_set.h"

/* In the order of the kernel's arguments. */
enum {
    BAKE_TILES,
    BAKE_UPPERS,
    BAKE_LOWERS,
    BAKE_LEAVES,
    BAKE_NORMALS,
    BAKE_PLANES,
    BAKE_COLORS,
    BAKE_SECONDS,
    BAKE_PART_ARRAYS
};

/* A lower node of a part, and what of the part comes before it. */
struct bake_part_lower {
    uint32_t number; /* in the grid */
    uint64_t first_leaf, first_voxel;
};

struct bake_part {
    const struct fmt_nvdb_grid *grid;
    bool whole; /* the fields from here to params are unused */
    uint32_t *uppers;
    struct bake_part_lower *lowers; /* ascending */
    uint64_t (*marks)[BAKE_MARK_WORDS];
    uint64_t upper_count, lower_count, leaf_count, voxel_count, second_count;
    struct bk_params params;          /* the job's, for this part */
    uint64_t bytes[BAKE_PART_ARRAYS]; /* 0: the kernel does not read it */
};

const char *bake_part_array_name(int array);

/* Bytes of the arrays of a part with these counts. */
void bake_part_sizes(const struct fmt_nvdb_grid *grid, const struct bake_leaf_set *counts,
                     uint64_t bytes[BAKE_PART_ARRAYS]);

/* The whole grid. Nothing is allocated. */
void bake_part_whole(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                     struct bake_part *out);
/* The nodes of a set; free with bake_part_free(), also after a failure. */
int bake_part_create(struct bsq_ctx *ctx, const struct bake_leaf_set *set,
                     const struct bk_params *params, struct bake_part *out);
void bake_part_free(struct bsq_ctx *ctx, struct bake_part *part);

/* Calls sink with the bytes of an array from its first to its last, in pieces of any size; returns
 * its first result that is not 0. Any number of threads at a time. */
int bake_part_send(const struct bake_part *part, int array,
                   int (*sink)(void *arg, const void *data, uint64_t bytes), void *arg);

#endif
