/* subgrid.h - a grid, or the part of it that some rays need, as the arrays that a device takes;
 * and the passes in which a grid that does not fit a device is baked.
 *
 * Takes a job (its grid and triangles) and a raster; gives subgrids and the pieces of the map to
 * trace with each. A subgrid has all upper nodes of a grid, and some of its lower nodes (128^3
 * voxels) with all of their leaves and records, renumbered: the kernel cannot tell it from a grid.
 * It never exists in memory as a whole: bake_subgrid_send() hands out its arrays piece by piece on
 * their way to the device.
 *
 * A lower node that a ray looks up must not be missing: it would look empty, and the ray would take
 * other steps through it. So a subgrid gives results with the same bits as the whole grid. */
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

/* Sizes of a subgrid. */
struct bake_subgrid_counts {
    uint64_t lowers, leaves;
    uint64_t values; /* indices of first records, 0 and those that no voxel has included */
    uint64_t seconds;
};

/* A lower node of a subgrid, and its leaves in the grid. */
struct bake_subgrid_lower {
    uint32_t number; /* in the grid */
    uint32_t first_leaf, leaf_count;
    uint64_t shift; /* what its voxels' value indices in the subgrid have more than in the grid */
};

/* Value indices `first` to first + count - 1 of the grid, which are those from `to` on in the
 * subgrid, and their second records. `first` and `to` have the same remainder by 32. */
struct bake_value_run {
    uint64_t first, count, to;
    uint64_t first_second, second_count;
};

struct bake_subgrid {
    const struct fmt_nvdb_grid *grid;
    bool whole;                        /* the fields from here to params are unused */
    struct bake_subgrid_lower *lowers; /* ascending numbers */
    struct bake_value_run *runs;
    uint64_t run_count;
    struct bake_subgrid_counts counts;
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

/* ---- lower nodes ---- */

/* Lower nodes of a grid. */
struct bake_lower_set {
    const struct fmt_nvdb_grid *grid;
    uint8_t *has;     /* for each lower node of the grid */
    uint32_t *lowers; /* numbers of those in the set, in the order in which they were added */
    uint64_t count, capacity;
};

/* Makes an empty set; free with bake_lower_set_free(), also after a failure. */
int bake_lower_set_create(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                          struct bake_lower_set *out);
void bake_lower_set_free(struct bsq_ctx *ctx, struct bake_lower_set *set);
void bake_lower_set_clear(struct bake_lower_set *set);
int bake_lower_set_add(struct bsq_ctx *ctx, struct bake_lower_set *set, uint32_t lower);

/* Adds a lower node to the counts of a subgrid; at most what it really adds. */
void bake_subgrid_count(const struct fmt_nvdb_grid *grid, uint32_t lower,
                        struct bake_subgrid_counts *counts);
/* Computes the bytes of each array. */
void bake_subgrid_sizes(const struct fmt_nvdb_grid *grid, const struct bake_subgrid_counts *counts,
                        uint64_t bytes[BAKE_SUBGRID_ARRAYS]);
/* Makes a subgrid of the nodes of a set, which it sorts; free with bake_subgrid_free(), also after
 * a failure. */
int bake_subgrid_create(struct bsq_ctx *ctx, struct bake_lower_set *set,
                        const struct bk_params *params, struct bake_subgrid *out);
void bake_subgrid_free(struct bsq_ctx *ctx, struct bake_subgrid *subgrid);

/* ---- rays ---- */

/* Texels of a patch, relative to it. */
struct bake_rectangle {
    uint32_t x, y, width, height;
};

/* Adds all lower nodes that the rays of a rectangle's samples, or the blending around their hits,
 * look up. sample_triangles are those of the whole patch. */
int bake_lower_set_add_rays(struct bsq_ctx *ctx, struct bake_lower_set *set,
                            const struct bake_job *job, const struct bk_patch *patch,
                            const uint32_t *sample_triangles,
                            const struct bake_rectangle *rectangle);
/* Returns how far rays that start at hits reach from there, in voxels. */
float bake_secondary_reach(const struct bk_params *params);

/* ---- passes ---- */

struct bake_raster;

/* Texels that are traced together: usually a whole patch, less if a patch needs too many nodes. */
struct bake_piece {
    uint32_t patch; /* of the raster */
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

/* Plans passes over all patches. Free with bake_plan_free(), also after a failure. Errors:
 * BSQ_ENODEVICE if the nodes of a single texel exceed a limit. */
int bake_plan_passes(struct bsq_ctx *ctx, const struct bake_plan_options *options,
                     struct bake_plan *out);
void bake_plan_free(struct bsq_ctx *ctx, struct bake_plan *plan);

#endif
