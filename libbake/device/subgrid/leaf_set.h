/* leaf_set.h - the nodes of a grid that some rays look up, and the subgrid made of them.
 *
 * A set holds every node that a ray looks up. A node left out would look like an empty node of
 * another size, and rays would take other steps through it. So a subgrid gives results with the
 * same bits as the whole grid. */
#ifndef BAKE_DEVICE_SUBGRID_LEAF_SET_H
#define BAKE_DEVICE_SUBGRID_LEAF_SET_H

#include "libbake/device/subgrid/subgrid.h"

struct bake_leaf_set {
    const struct fmt_nvdb_grid *grid;
    uint8_t *has_upper;       /* for each upper node of the grid */
    uint32_t *place_of_lower; /* for each lower node of the grid: 1 + its index below, 0: not in the
                                 set */
    uint64_t lower_count, capacity;
    uint32_t *lowers;                        /* numbers, in the order in which they were added */
    uint64_t (*leaf_masks)[BAKE_MASK_WORDS]; /* for each lower node: its leaves in the set */
    uint64_t upper_count, leaf_count, voxel_count, second_count;
};

/* Makes an empty set; free with bake_leaf_set_free(), also after a failure. */
int bake_leaf_set_create(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                         struct bake_leaf_set *out);
void bake_leaf_set_free(struct bsq_ctx *ctx, struct bake_leaf_set *set);
void bake_leaf_set_clear(struct bake_leaf_set *set);

/* Adds all nodes that overlap voxels low .. high (inclusive). */
int bake_leaf_set_add_box(struct bsq_ctx *ctx, struct bake_leaf_set *set, const int32_t low[3],
                          const int32_t high[3]);
/* Adds all nodes that the rays of a rectangle's samples, or the blending around their hits, look
 * up. Conservative: adds boxes around the rays of a few neighbouring texels. sample_triangles are
 * those of the whole tile. */
int bake_leaf_set_add_rays(struct bsq_ctx *ctx, struct bake_leaf_set *set,
                           const struct bake_job *job, const struct bk_tile *tile,
                           const uint32_t *sample_triangles,
                           const struct bake_rectangle *rectangle);
/* Returns how far rays that start at hits reach from there, in voxels. */
float bake_secondary_reach(const struct bk_params *params);
/* Adds the nodes of another set of the same grid. */
int bake_leaf_set_add(struct bsq_ctx *ctx, struct bake_leaf_set *set,
                      const struct bake_leaf_set *other);
/* Sets the counts of *counts to what they would be in `set` after `other` was added. */
void bake_leaf_set_preview(const struct bake_leaf_set *set, const struct bake_leaf_set *other,
                           struct bake_leaf_set *counts);

/* ---- nodes of a grid ---- */

/* Return the number of a child: the upper node at byte offset `child` of a root tile, child n of an
 * upper node, child n of a lower node. BK_NONE if the grid has no such node. */
uint32_t bake_tile_upper(const struct fmt_nvdb_grid *grid, uint64_t child);
uint32_t bake_upper_lower(const struct fmt_nvdb_grid *grid, uint32_t upper, uint32_t n);
uint32_t bake_lower_leaf(const struct fmt_nvdb_grid *grid, uint32_t lower, uint32_t n);
/* Returns the value index of a leaf's first voxel, at most voxel_count, and the number of its
 * voxels. Their sum may exceed voxel_count + 1 if the file was changed after it was opened. */
uint64_t bake_leaf_first(const struct fmt_nvdb_grid *grid, uint32_t leaf);
uint32_t bake_leaf_voxels(const struct fmt_nvdb_grid *grid, uint32_t leaf);
/* Returns how many voxels with a value index below v have a second record. */
uint64_t bake_seconds_below(const struct fmt_nvdb_grid *grid, uint64_t v);

/* ---- the subgrid of a set ---- */

/* Computes the bytes of each array for a set's counts. */
void bake_subgrid_sizes(const struct fmt_nvdb_grid *grid, const struct bake_leaf_set *counts,
                        uint64_t bytes[BAKE_SUBGRID_ARRAYS]);
/* Makes a subgrid of the nodes of a set; free with bake_subgrid_free(), also after a failure. */
int bake_subgrid_create(struct bsq_ctx *ctx, const struct bake_leaf_set *set,
                        const struct bk_params *params, struct bake_subgrid *out);
void bake_subgrid_free(struct bsq_ctx *ctx, struct bake_subgrid *subgrid);

#endif
