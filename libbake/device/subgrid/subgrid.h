/* subgrid.h - a grid, or the part of it that some rays need, as the arrays that a device takes;
 * and the passes in which a grid that does not fit a device is baked.
 *
 * Takes a job (its grid and triangles) and a raster; gives subgrids and the tiles to trace with
 * each. A subgrid has the layout of a grid file with fewer nodes and records, renumbered: the
 * kernel cannot tell it from a grid. It never exists in memory as a whole: bake_subgrid_send()
 * hands out its arrays piece by piece on their way to the device. */
#ifndef BAKE_DEVICE_SUBGRID_SUBGRID_H
#define BAKE_DEVICE_SUBGRID_SUBGRID_H

#include "libbake/device/job/job.h"

/* Arrays of a grid, in the order of the kernel's arguments. */
enum {
    BAKE_TILES,
    BAKE_UPPERS,
    BAKE_LOWERS,
    BAKE_LEAVES,
    BAKE_NORMALS,
    BAKE_PLANES,
    BAKE_COLORS,
    BAKE_SECONDS,
    BAKE_SUBGRID_ARRAYS
};

enum { BAKE_MASK_WORDS = 64 }; /* one bit for each child of a lower node, as in its child mask */

/* Calls visit() for each upper node of a grid that overlaps voxels low .. high (inclusive), with
 * lower == BK_NONE, and then for each of its lower nodes that overlap them. origin: the node's
 * lowest voxel. Returns the first result of visit() that is not 0, after which it stops. */
typedef int bake_node_visit(void *arg, uint32_t upper, uint32_t lower, const int32_t origin[3]);
int bake_visit_nodes(const struct fmt_nvdb_grid *grid, const int32_t low[3], const int32_t high[3],
                     bake_node_visit *visit, void *arg);
/* Returns the mask of the leaves of a lower node: BAKE_MASK_WORDS words in the grid's file. */
const uint64_t *bake_lower_children(const struct fmt_nvdb_grid *grid, uint32_t lower);

/* A lower node of a subgrid. */
struct bake_subgrid_lower {
    uint32_t number;                  /* in the grid */
    uint64_t first_leaf, first_voxel; /* leaves and voxels of the nodes before it */
};

struct bake_subgrid {
    const struct fmt_nvdb_grid *grid;
    bool whole;                              /* the fields from here to params are unused */
    uint32_t *uppers;                        /* numbers in the grid, ascending */
    struct bake_subgrid_lower *lowers;       /* ascending numbers */
    uint64_t (*leaf_masks)[BAKE_MASK_WORDS]; /* for each lower node: its leaves in the subgrid */
    uint64_t upper_count, lower_count, leaf_count, voxel_count, second_count;
    struct bk_params params;             /* the job's, for this subgrid */
    uint64_t bytes[BAKE_SUBGRID_ARRAYS]; /* 0: the kernel does not read the array */
};

/* Makes a subgrid that is the whole grid. Allocates nothing. */
void bake_subgrid_whole(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                        struct bake_subgrid *out);

/* Returns the bytes of all arrays together. *largest: of the largest one. */
uint64_t bake_subgrid_total(const uint64_t bytes[BAKE_SUBGRID_ARRAYS], uint64_t *largest);

/* Returns an array's name for messages. */
const char *bake_subgrid_array_name(int array);

/* Calls sink with the bytes of an array from first to last, in parts of any size. Returns the
 * first result of sink that is not 0. Thread-safe. */
int bake_subgrid_send(const struct bake_subgrid *subgrid, int array,
                      int (*sink)(void *arg, const void *data, uint64_t bytes), void *arg);

/* ---- passes ---- */

struct bake_raster;

/* Texels of a tile, relative to it. */
struct bake_rectangle {
    uint32_t x, y, width, height;
};

/* Texels that are traced together: usually a whole tile, less if a tile needs too many nodes. */
struct bake_piece {
    uint32_t tile; /* of the raster */
    struct bake_rectangle texels;
};

/* Pieces of the map, and all nodes that their rays look up. */
struct bake_pass {
    uint64_t first_piece, piece_count;
    struct bake_subgrid subgrid;
};

struct bake_plan {
    struct bake_piece *pieces;
    struct bake_pass *passes;
    uint64_t piece_count, pass_count, piece_capacity, pass_capacity;
};

struct bake_plan_options {
    const struct bake_raster *raster;
    const struct bake_job *job;
    uint64_t subgrid_bytes, buffer_bytes; /* limits for all arrays of a subgrid, and for each */
    /* For messages: device memory that the job uses besides, and subgrids held at a time. */
    uint64_t other_bytes;
    unsigned slots;
};

/* Plans passes over all tiles. Free with bake_plan_free(), also after a failure. Errors:
 * BSQ_ENODEVICE if the nodes of a single texel exceed a limit. */
int bake_plan_passes(struct bsq_ctx *ctx, const struct bake_plan_options *options,
                     struct bake_plan *out);
void bake_plan_free(struct bsq_ctx *ctx, struct bake_plan *plan);

#endif
