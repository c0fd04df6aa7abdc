/* tree_tracer.h - what the sources that trace rays through the tree of leaves share. Included with
 * BK_WIDTH defined. */
#ifndef BAKE_DEVICE_NATIVE_TREE_TRACER_H
#define BAKE_DEVICE_NATIVE_TREE_TRACER_H

#include <stdbool.h>

#include "libbake/device/native/tree_rays.h"

/* The end of a ray that is finished: below the t of every box and voxel. */
#define BAKE_TREE_DONE (-1.0e30f)

_Static_assert(BAKE_TREE_POINT_RAYS == 64 && BAKE_TREE_POINT_RAYS % BK_WIDTH == 0,
               "the rays of a point are bits of a word, in whole lanes");
_Static_assert(BAKE_TREE_TESTED + BAKE_TREE_AT_ONCE * BAKE_TREE_WIDTH <= BAKE_TREE_BLOCKS &&
                   BAKE_TREE_POINT_RAYS * BAKE_TREE_WIDTH <= BAKE_TREE_BLOCKS,
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
    uint32_t rays, points, nodes, blocks, voxels; /* in the lists of `stream` */
    struct bake_tree_section section;
    bool nearest; /* distances matter */
    float coarse; /* of bk_coarse_from() */
    bk_cache cache;
};

/* Tests all pairs of rays and blocks, and of rays and voxels. */
typedef void bake_tree_test_fn(struct bake_tree_tracer *tracer);
BSQ_SIMD_DECLARE(bake_tree_test_fn, bake_tree_test_blocks);

#endif
