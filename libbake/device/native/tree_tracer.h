/* tree_tracer.h - what the sources that trace rays through the tree of leaves share. Included with
 * BK_WIDTH defined. */
#ifndef BAKE_DEVICE_NATIVE_TREE_TRACER_H
#define BAKE_DEVICE_NATIVE_TREE_TRACER_H

#include <stdbool.h>

#include "libbake/device/native/tree_rays.h"

/* The t at which rays end that meet nothing more. */
#define BAKE_TREE_DONE (-1.0e30f)

struct bake_tree_tracer {
    const bk_grid *grid;
    const bk_params *params;
    const struct bake_tree *tree;
    const bk_rays *kind;
    struct bake_tree_stream *stream;
    float *results;
    uint32_t rays, nodes, blocks, voxels; /* in the lists of `stream` */
    bool nearest;                         /* distances matter */
    bk_cache cache;
};

/* Tests all pairs of rays and blocks, and of rays and voxels. */
typedef void bake_tree_test_fn(struct bake_tree_tracer *tracer);
BSQ_SIMD_DECLARE(bake_tree_test_fn, bake_tree_test_blocks);

#endif
