/* exact_leaves.h - chunks as secondary rays and devices meet them; private to this folder.
 *
 * Rays from hits go anywhere, one by one, and enter a tree many times. So it has its triangles'
 * corners in its leaves, eight triangles each, and these are tested in float at once. What no line
 * that close can hit is left out; the others are tested as for all rays. */
#ifndef BAKE_EXACT_EXACT_LEAVES_H
#define BAKE_EXACT_EXACT_LEAVES_H

#include "libbake/exact/exact_scene.h"

/* Eight triangles; the last one stands for those that are missing. */
struct exact_leaf {
    _Alignas(32) float corners[3][3][8]; /* by corner and axis */
    uint32_t backwards; /* bit i: bake_exact_wound_backwards(), if rays ask for sides */
};

/* A chunk's triangles. */
struct exact_leaves {
    struct exact_tree tree; /* over the leaves */
    struct exact_leaf *leaves;
};

/* Returns the bytes of `memory` and of `scratch` for bake_exact_leaves_build(). */
uint64_t bake_exact_leaves_bytes(uint32_t triangles);
uint64_t bake_exact_leaves_scratch_bytes(uint32_t triangles);

/* Makes the leaves and the tree of a chunk. sorted: triangles that are close together share leaves
 * and nodes, which takes longer than loading the chunk, and makes rays nearly twice as fast;
 * otherwise those that follow each other in the file. sided: rays ask which side of a triangle
 * they meet. memory: aligned to BSQ_ALIGNMENT, outlives *out. scratch: likewise aligned. */
void bake_exact_leaves_build(const struct fmt_tris_chunk *chunk, bool sorted, bool sided,
                             void *memory, void *scratch, struct exact_leaves *out);

struct bsq_middle;
/* Makes the leaf of EXACT_RUN triangles that follow each other in an order, or if that is NULL in
 * the file. The last triangle stands for missing ones, whose numbers would be higher. Returns their
 * bounds. */
struct exact_box bake_exact_leaf_set(const struct fmt_tris_chunk *chunk,
                                     const struct bsq_middle *order, uint32_t run, bool sided,
                                     struct exact_leaf *out);

/* Several chunks, with a tree over their bounds. */
struct exact_group {
    struct exact_tree tree;
    struct exact_leaves *chunks;
};

/* Returns the bytes of the table of a group with this many chunks, a multiple of BSQ_ALIGNMENT. */
uint64_t bake_exact_table_bytes(uint32_t chunks);
/* Writes the table with which an area in the memory of a device begins (bk_meet.h). The group's
 * chunks follow it there one after the other, each as bake_exact_leaves_build() made it. */
void bake_exact_table_set(const struct exact_group *group, uint32_t chunks, void *table);

/* Which hits of a ray count: from its origin up to t_max. */
struct exact_look_limits {
    double t_max;
    bool facing_origin, two_sided; /* as in struct bake_ray_batch and bake_exact */
    bool any;                      /* the first hit that is found will do */
};

/* The nodes that a point is in, from the roots on. All rays from the point meet them, so their
 * boxes are tested one after the other without waiting for each other's results. */
enum { EXACT_STEPS = 32 };
struct exact_path {
    float origin[3];
    uint32_t count;
    struct exact_step {
        const struct exact_leaves *chunk; /* NULL: the node is one of the group's tree */
        const struct exact_box8 *boxes;
        uint32_t level, node;
        uint32_t inside; /* bit i: child i is a step, too */
        float far;       /* largest coordinate of the chunk's corners, relative to the point */
    } steps[EXACT_STEPS];
};
typedef void bake_exact_path_find_fn(const struct exact_group *group, const float origin[3],
                                     struct exact_path *out);
BSQ_SIMD_DECLARE(bake_exact_path_find_fn, bake_exact_path_find);

/* Returns whether a ray from the path's point hits a triangle of the group, and sets *t to the
 * distance of the nearest one. */
typedef bool bake_exact_group_trace_fn(const struct exact_group *group,
                                       const struct exact_path *path, const float direction[3],
                                       const struct exact_look_limits *limits, double *t);
BSQ_SIMD_DECLARE(bake_exact_group_trace_fn, bake_exact_group_trace);

#endif
