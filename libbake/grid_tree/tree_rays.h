/* tree_rays.h - traces secondary rays through the tree of leaves; all instruction sets give the
 * bits of bk_tree_look(), which a GPU runs for each ray. */
#ifndef BAKE_GRID_TREE_TREE_RAYS_H
#define BAKE_GRID_TREE_TREE_RAYS_H

#include <stdbool.h>
#include <stddef.h>

#include "base/simd/simd.h"
#include "libbake/grid_tree/leaf_tree.h"
#include "libbake/kernel/bk_tree.h"

enum {
    BAKE_TREE_BUNDLE = 64, /* rays that go through the upper nodes together */
    BAKE_TREE_RAYS = 512,  /* in a stream */
    BAKE_TREE_AT_ONCE =
        24, /* pairs of rays and nodes that are taken together, and whose nodes are prefetched */
    /* Most levels of the tree: each level splits at another bit of those that differ between the
     * corners of leaves, at most 19 an axis with BAKE_TREE_EXTENT, and a leaf is a level. */
    BAKE_TREE_DEPTH = 58,
    /* Of each level at most three groups of pairs wait: two that are taken in turns, and one that a
     * shallower group has covered. */
    BAKE_TREE_NODES = 1024 + 3 * BAKE_TREE_DEPTH * BAKE_TREE_AT_ONCE * BAKE_TREE_WIDTH,
    BAKE_TREE_BLOCKS = 1024,
    BAKE_TREE_TESTED = 256, /* blocks are tested as soon as this many pairs wait */
    BAKE_TREE_VOXELS = 256
};

/* A ray on its way, see bk_ray and bk_walk. Code loads four words at once, from the first ones of
 * the rows. */
struct bake_tree_ray {
    float inverse[3];
    float t_before; /* voxels are entered before it: t_end; far below 0 if only the first one is */
    float start[3];
    float side; /* of the point, times bk_ray_rise(), or times 2 if that is 0 */
    int32_t base[3];
    float t_begin;
    int32_t first[3]; /* voxel in which the walk begins */
    /* How the voxel of the nearest hit is entered: at t_stop, across a border of stop_axis. Voxels
     * that are entered later, by t and then by axis, do not count, and boxes after t_last. */
    float t_stop;
    float direction[3];
    int32_t stop_axis;
    float margin[3]; /* of the t of a box's borders */
    float t_end;
    int32_t near[3]; /* byte offsets of the borders that the ray meets first */
    float t_last;
    int32_t far[3]; /* and last */
    uint32_t result;
};
_Static_assert(sizeof(struct bake_tree_ray) == 128 && offsetof(struct bake_tree_ray, start) == 16 &&
                   offsetof(struct bake_tree_ray, near) == 96 &&
                   offsetof(struct bake_tree_ray, far) == 112,
               "rows of four words");

/* Rays, and lists of pairs of a ray and a node, a block or a voxel. Vectors are stored at the ends
 * of lists. */
struct bake_tree_stream {
    struct bake_tree_ray rays[BAKE_TREE_RAYS + 1];
    uint32_t node[BAKE_TREE_NODES + BAKE_TREE_WIDTH], node_ray[BAKE_TREE_NODES + BAKE_TREE_WIDTH];
    /* A block is its leaf's node times BAKE_TREE_WIDTH, and its number there. */
    uint32_t block[BAKE_TREE_BLOCKS + BAKE_TREE_WIDTH];
    uint32_t block_ray[BAKE_TREE_BLOCKS + BAKE_TREE_WIDTH];
    /* Pairs of a ray and a block that have voxels to test, and these voxels. */
    uint32_t met[BAKE_TREE_BLOCKS];
    uint64_t met_voxels[BAKE_TREE_BLOCKS];
    uint64_t voxel_value[BAKE_TREE_VOXELS]; /* index */
    uint32_t voxel_block[BAKE_TREE_VOXELS], voxel_ray[BAKE_TREE_VOXELS];
    uint8_t voxel[BAKE_TREE_VOXELS]; /* in its block, as x << 4 | y << 2 | z */
};

/* Traces the rays of `count` points, all of one kind. results: kind->count values for each point,
 * see bk_add_up(), `stride` apart; of open rays only the sign is defined, unless params->flags has
 * BK_OPEN_FALLOFF. The stream is scratch memory. */
typedef void bake_tree_look_fn(const struct bk_grid *grid, const struct bk_params *params,
                               const struct bake_tree *tree, const bk_rays *kind,
                               const bk_viewpoint *points, uint32_t count, float *results,
                               uint64_t stride, struct bake_tree_stream *stream);
BSQ_SIMD_DECLARE(bake_tree_look_fn, bake_tree_look);

/* ---- for tree_rays_lanes.c and tree_voxels_lanes.c ---- */

/* The end of a ray that is finished: below the t of every box and voxel. */
#define BAKE_TREE_DONE (-1.0e30f)

/* More than any way through a block, in voxels, and its margin. */
#define BAKE_TREE_BLOCK_MOST 8.0f

_Static_assert(BAKE_TREE_BUNDLE == 64 && BAKE_TREE_BUNDLE % BK_WIDTH == 0,
               "the rays of a bundle are bits of a word, in whole lanes");
_Static_assert(BAKE_TREE_TESTED + BAKE_TREE_AT_ONCE * BAKE_TREE_WIDTH <= BAKE_TREE_BLOCKS &&
                   BAKE_TREE_BUNDLE * BAKE_TREE_WIDTH <= BAKE_TREE_BLOCKS,
               "what a step adds fits in the list of blocks");

/* The section of rays that is traced: boxes that they meet from t = begin to end. */
struct bake_tree_section {
    float begin, end;
};

struct bake_tree_tracer {
    const bk_grid *grid;
    const bk_params *params;
    const struct bake_tree *tree;
    const bk_rays *kind;
    struct bake_tree_stream *stream;
    float *results;
    uint32_t rays, nodes, blocks, voxels; /* in the lists of `stream` */
    /* Tolerances of box borders for bundles, in voxels: 2^-20 of the largest distance, which is
     * sixteen roundings; tests of boxes have at most fifteen. */
    float margins[3];
    struct bake_tree_section section;
    bool nearest; /* distances matter */
    bk_cache cache;
};

/* Tests all pairs of rays and blocks, and of rays and voxels. */
typedef void bake_tree_test_fn(struct bake_tree_tracer *tracer);
BSQ_SIMD_DECLARE(bake_tree_test_fn, bake_tree_test_blocks);

#endif
