/* job.h - what a device traces: the grid, the low-poly mesh's triangles and the parameters.
 *
 * Takes an open grid file (formats/grid); gives the kernel's parameters and array pointers for it,
 * and its nodes. Every other folder of device/ uses this one. */
#ifndef BAKE_DEVICE_JOB_JOB_H
#define BAKE_DEVICE_JOB_JOB_H

#include "formats/grid/nvdb.h"
#include "libbake/bake.h"
#include "libbake/kernel/bk_maps.h"

struct bk_grid;

/* Everything that stays the same over a job; pointers stay valid until the device is closed. */
struct bake_job {
    const struct fmt_nvdb_grid *grid;
    const struct bk_triangle *triangles;
    uint32_t triangle_count;
    uint32_t patch_texels;  /* largest width * height of a patch */
    uint64_t device_memory; /* limit for a device's own memory, in bytes; 0: all that is free */
    struct bk_params params;
};

/* Voxels that can be traced have indices in -BAKE_INDEX_LIMIT .. BAKE_INDEX_LIMIT - 1, so that
 * neither neighbours nor distances from a ray's origin overflow 32 bits. Bisque writes no others,
 * but its format allows them. */
#define BAKE_INDEX_LIMIT (1 << 30)

/* Checks the index bounds of a grid. Errors: BSQ_EDATA. */
int bake_check_grid(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

/* Fills the grid part of params (bounds, counts, second_base, BK_HAS_COLOR, ids). */
void bake_params_from_grid(const struct fmt_nvdb_grid *grid, struct bk_params *params);

/* Points the kernel's grid at the arrays of a mapped file; valid while the file is open. */
void bake_kernel_grid(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      struct bk_grid *out);

/* Rays of a grid with one range of t and one facing rule: of the hits with t in [t_min, t_max] the
 * one that bk_nearest() chooses wins. Surfaces that face the other way are ignored, unless
 * params->flags has BK_TWO_SIDED, which turns their normals round. */
struct bake_ray_batch {
    const float (*rays)[6]; /* origin and unit direction of each, in index space */
    uint64_t count;
    float t_min, t_max;
    float gap;            /* as in struct bk_lines */
    float facing;         /* 1: surfaces must face along the ray; -1: against it */
    const float *reaches; /* of each ray, voxels; NULL: 0 */
    bool from_reach;      /* rays go inwards from their reach only */
    /* Of each ray, BK_TRANSFER_VALUES sums for each transfer map of params->maps, to which the
     * values at its hit are added. NULL: none. */
    float *channels;
};

/* ---- nodes of a grid ---- */

enum { BAKE_MASK_WORDS = 64 }; /* one bit for each child of a lower node */

/* Calls visit() for each lower node of a grid that overlaps voxels low .. high (inclusive). origin:
 * the node's lowest voxel. Returns the first result of visit() that is not 0, after which it stops.
 */
typedef int bake_node_visit(void *arg, uint32_t lower, const int32_t origin[3]);
int bake_visit_nodes(const struct fmt_nvdb_grid *grid, const int32_t low[3], const int32_t high[3],
                     bake_node_visit *visit, void *arg);

/* Return the number of child n of an upper or of a lower node; BK_NONE if there is none, or if the
 * grid has no such node: the file may change while it is read. */
uint32_t bake_upper_lower(const struct fmt_nvdb_grid *grid, uint32_t upper, uint32_t n);
uint32_t bake_lower_leaf(const struct fmt_nvdb_grid *grid, uint32_t lower, uint32_t n);
/* Returns the mask of the leaves of a lower node: BAKE_MASK_WORDS words in the grid's file. */
const uint64_t *bake_lower_children(const struct fmt_nvdb_grid *grid, uint32_t lower);

/* Returns the cost of a sample, secondary rays included, in pairs of primary rays. */
uint32_t bake_sample_cost(const struct bk_params *params);

#endif
