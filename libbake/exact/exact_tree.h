/* exact_tree.h - a tree of boxes with eight children per node, for runs of triangles and for
 * chunks; private to this folder.
 *
 * Boxes are packed by eights in their order, level by level (Kamel & Faloutsos, "On Packing
 * R-trees", 1993): chunk files keep chunks and triangles along a curve through space
 * (formats/FORMATS.md), so that neighbours share a node. Building takes linear time, children need
 * no stored numbers, and the memory is known beforehand. Sorting them first
 * takes longer than the rays along normals of one batch gain; exact_leaves.c does it for those from
 * hits. */
#ifndef BAKE_EXACT_EXACT_TREE_H
#define BAKE_EXACT_EXACT_TREE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "base/simd/simd.h"

enum { EXACT_TREE_LEVELS = 11, EXACT_TREE_STACK = 7 * EXACT_TREE_LEVELS + 1 };

/* The boxes of a node's eight children. Those of missing children are empty. */
struct exact_box8 {
    _Alignas(32) float planes[2][3][8]; /* lower and upper, by axis, of each child */
};

struct exact_box {
    float low[3], high[3];
};

/* Has nothing in it. */
#define EXACT_EMPTY_BOX                                                                            \
    ((struct exact_box){{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}})

/* Lets a box contain what lies between two corners, too. */
static inline void exact_box_grow(struct exact_box *box, const float low[3], const float high[3])
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = low[k] < box->low[k] ? low[k] : box->low[k];
        box->high[k] = high[k] > box->high[k] ? high[k] : box->high[k];
    }
}

/* Sets the boxes of a node. Lower bounds are the first three numbers of low[], upper bounds those
 * of high[] from number `skipped` on. Overwrites both. */
LANES_INLINE void exact_node_set(struct exact_box8 *node, four_floats low[8], four_floats high[8],
                                 int skipped)
{
    for (int c = 0; c < 8; c += 4) {
        four_floats_transpose(&low[c]);
        four_floats_transpose(&high[c]);
    }
    for (int k = 0; k < 3; k++) {
        const eights all[2] = {eights_join(low[k], low[4 + k]),
                               eights_join(high[k + skipped], high[4 + k + skipped])};
        memcpy(node->planes[0][k], &all[0], sizeof *all);
        memcpy(node->planes[1][k], &all[1], sizeof *all);
    }
}

/* Puts box number i into a list of boxes by eights. */
static inline void exact_box8_put(struct exact_box8 *boxes, uint32_t i, const float low[3],
                                  const float high[3])
{
    for (int k = 0; k < 3; k++) {
        boxes[i / 8].planes[0][k][i % 8] = low[k];
        boxes[i / 8].planes[1][k][i % 8] = high[k];
    }
}

/* Ends a list of `count` boxes by eights with empty ones. */
static inline void exact_box8_end(struct exact_box8 *boxes, uint32_t count)
{
    const struct exact_box none = EXACT_EMPTY_BOX;
    for (; count % 8 != 0; count++)
        exact_box8_put(boxes, count, none.low, none.high);
}

struct exact_tree {
    struct exact_box8 *nodes; /* by level, from the leaves to the root; box 8 k + c is child c of
                                 leaf node k */
    uint32_t count;           /* of boxes */
    uint32_t levels;          /* 0 if there are no boxes */
    uint32_t first[EXACT_TREE_LEVELS]; /* index of each level's first node */
};

/* Largest number of boxes. */
#define EXACT_TREE_BOXES (UINT32_C(1) << 31)

/* Returns the size in bytes of `memory` for bake_exact_tree_build(). */
uint64_t bake_exact_tree_bytes(uint32_t count);

/* Builds the tree of `count` boxes in `memory`, which is aligned to 64 bytes and must outlive the
 * tree. Overwrites the boxes. */
void bake_exact_tree_build(struct exact_tree *tree, uint32_t count, struct exact_box *boxes,
                           void *memory);

/* Writes the numbers of the boxes that overlap `box` to out[], which has tree->count entries.
 * Returns their count. */
uint32_t bake_exact_tree_overlapping(const struct exact_tree *tree, const struct exact_box *box,
                                     uint32_t *out);

/* Sets the lowest and the highest number, from `from` on, of the boxes that overlap `box`. Without
 * any, *first is above *last. */
void bake_exact_tree_span(const struct exact_tree *tree, const struct exact_box *box, uint32_t from,
                          uint32_t *first, uint32_t *last);

#endif
