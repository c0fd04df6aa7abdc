/* leaf_tree.h - a tree of boxes around the voxels of a grid, for secondary rays.
 *
 * Takes an open grid file; gives the tree, which processors read in place and which goes up to
 * GPUs.
 *
 * A node has up to eight children. Their boxes are stored as eight-bit steps from the node's corner
 * (Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
 * BVHs", 2017). The lowest nodes are the leaves of the grid. Their children are the eight blocks of
 * 4^3 voxels, whose boxes fit the active voxels exactly. The children of any other node are nodes,
 * each of which covers a range of the leaves in Morton order; their boxes are rounded outwards.
 * Siblings are adjacent in the array.
 *
 * The occupied voxels of blocks are stored again. Rays that voxels hide as a whole need nothing
 * else of the grid, whose file is mapped in small pages. */
#ifndef BAKE_GRID_TREE_LEAF_TREE_H
#define BAKE_GRID_TREE_LEAF_TREE_H

#include <stdint.h>

#include "libbake/kernel/bk_grid.h"

struct bsq_ctx;
struct fmt_nvdb_grid;

enum { BAKE_TREE_WIDTH = 8 };

/* Grids that are wider than this many voxels have no tree. Borders are at most 255 steps of 2^14
 * voxels from a node's corner, and must be exact in float. */
#define BAKE_TREE_EXTENT (1 << 21)
/* Nodes, at most, so that node * BAKE_TREE_WIDTH + child fits in 32 bits. */
#define BAKE_TREE_MOST (UINT32_MAX / BAKE_TREE_WIDTH)

struct bake_tree_node {
    /* Lowest border of the children's boxes, rounded down to a multiple of 8: the corner of a leaf.
     * The lowest three bits of each are other fields, see bake_tree_shift() and
     * bake_tree_is_leaf().
     */
    int32_t corner[3];
    uint32_t first; /* number of the first child; of a leaf its number in the grid */
    /* Of each axis: the lower borders of the children's boxes, then the upper ones. The lower
     * border of a missing child is above the upper one. The children of a leaf are in the order of
     * their bits x y z, x highest. */
    uint8_t borders[3][2][BAKE_TREE_WIDTH];
};
_Static_assert(sizeof(struct bake_tree_node) == 64, "a node takes a cache line");

struct bake_tree {
    struct bake_tree_node
        *nodes; /* the root comes first; it has no children if there are no voxels */
    uint64_t count, capacity;
    /* Occupied voxels of the blocks of each leaf of the grid, bit x << 4 | y << 2 | z. */
    uint64_t (*blocks)[BAKE_TREE_WIDTH];
    int32_t low[3], high[3]; /* borders of a box around all voxels */
};

/* Builds the tree of a grid; the caller frees it. It takes up to 155 bytes a leaf, and about a half
 * more while it is built. Errors: BSQ_EDATA for a grid wider than BAKE_TREE_EXTENT; BSQ_EINTR,
 * BSQ_ENOMEM. */
int bake_tree_build(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, struct bake_tree *tree);
void bake_tree_free(struct bsq_ctx *ctx, struct bake_tree *tree);

/* Returns the lowest border of the children's boxes on an axis. */
static inline int32_t bake_tree_corner(const struct bake_tree_node *node, int axis)
{
    return node->corner[axis] & ~7;
}

/* Returns log2 of a step of a node's borders in voxels: an even number, at most 14. */
static inline uint32_t bake_tree_shift(const struct bake_tree_node *node)
{
    return 2 * ((uint32_t)node->corner[0] & 7);
}

/* Returns 1 if the node is a leaf of the grid, else 0. */
static inline uint32_t bake_tree_is_leaf(const struct bake_tree_node *node)
{
    return (uint32_t)node->corner[2] & 1;
}

#endif
