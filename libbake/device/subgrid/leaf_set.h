/* leaf_set.h - the nodes of a grid that some rays can come to.
 *
 * A set holds whatever a ray looks up: a node that is left out would be an empty one of another
 * size, and rays would step through it otherwise. So results with a part of the grid have the same
 * bits as with all of it. */
#ifndef BAKE_DEVICE_SUBGRID_LEAF_SET_H
#define BAKE_DEVICE_SUBGRID_LEAF_SET_H

#include "formats/grid/nvdb.h"

enum { BAKE_MARK_WORDS = 64 }; /* one bit a child of a lower node, in the order of its child mask */

struct bake_leaf_set {
    const struct fmt_nvdb_grid *grid;
    uint8_t *has_upper;       /* for each upper node */
    uint32_t *place_of_lower; /* for each lower node: 1 + its place below, 0: not in the set */
    uint64_t lower_count, capacity;
    uint32_t *lowers;                   /* numbers, in the order in which they came */
    uint64_t (*marks)[BAKE_MARK_WORDS]; /* their leaves */
    uint64_t upper_count, leaf_count, voxel_count, second_count;
};

/* Makes an empty set; free with bake_leaf_set_free(), also after a failure. */
int bake_leaf_set_create(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                         struct bake_leaf_set *out);
void bake_leaf_set_free(struct bsq_ctx *ctx, struct bake_leaf_set *set);
void bake_leaf_set_clear(struct bake_leaf_set *set);

/* Adds all nodes that voxels low .. high (inclusive) lie in. */
int bake_leaf_set_add_box(struct bsq_ctx *ctx, struct bake_leaf_set *set, const int32_t low[3],
                          const int32_t high[3]);
/* Adds another set of the same grid. */
int bake_leaf_set_add(struct bsq_ctx *ctx, struct bake_leaf_set *set,
                      const struct bake_leaf_set *other);
/* Sets the counts to what they will be when `other` is added. */
void bake_leaf_set_preview(const struct bake_leaf_set *set, const struct bake_leaf_set *other,
                           struct bake_leaf_set *counts);

/* ---- nodes of a grid ---- */

/* Number of the leaf that is child `n` of a lower node, for a child that exists. */
uint32_t bake_lower_leaf(const struct fmt_nvdb_grid *grid, uint32_t lower, uint32_t n);
/* Value index of a leaf's first voxel, and how many voxels it has. */
uint64_t bake_leaf_first(const struct fmt_nvdb_grid *grid, uint32_t leaf);
uint32_t bake_leaf_voxels(const struct fmt_nvdb_grid *grid, uint32_t leaf);
/* How many of the value indices below v have a second record. */
uint64_t bake_seconds_below(const struct fmt_nvdb_grid *grid, uint64_t v);

#endif
