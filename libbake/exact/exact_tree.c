/* exact_tree.c - builds and searches trees of boxes, and computes places on the Hilbert curve. */
#include "libbake/exact/exact_tree.h"
#include "libbake/exact/exact.h"

#include <math.h>
#include <string.h>

#include "base/space_curve.h"

enum { AXIS_BITS = 11 }; /* of a place on the curve */

static uint32_t parents(uint32_t count)
{
    return count / 8 + (count % 8 != 0);
}

static uint64_t node_count(uint32_t count)
{
    uint64_t sum = 0;
    do {
        count = parents(count);
        sum += count;
    } while (count > 1);
    return sum;
}

uint64_t bake_exact_tree_bytes(uint32_t count)
{
    return bsq_align_up(node_count(count) * sizeof(struct exact_box8), BSQ_ALIGNMENT);
}

/* ---- nodes ---- */

static void set_child(struct exact_box8 *node, unsigned child, const struct exact_box *box)
{
    for (int k = 0; k < 3; k++) {
        node->planes[0][k][child] = box->low[k];
        node->planes[1][k][child] = box->high[k];
    }
}

static struct exact_box bounds_of(const struct exact_box8 *node)
{
    struct exact_box box;
    for (int k = 0; k < 3; k++) {
        const float *low = node->planes[0][k], *high = node->planes[1][k];
        box.low[k] = low[0];
        box.high[k] = high[0];
        for (int c = 1; c < 8; c++) {
            box.low[k] = low[c] < box.low[k] ? low[c] : box.low[k];
            box.high[k] = high[c] > box.high[k] ? high[c] : box.high[k];
        }
    }
    return box;
}

static const struct exact_box empty = {{INFINITY, INFINITY, INFINITY},
                                       {-INFINITY, -INFINITY, -INFINITY}};

static void fill_leaves(struct exact_tree *tree, const struct exact_box *boxes)
{
    uint32_t nodes = parents(tree->count);
    for (uint32_t n = 0; n < nodes; n++)
        for (unsigned c = 0; c < 8; c++) {
            uint32_t place = 8 * n + c;
            set_child(&tree->nodes[n], c, place < tree->count ? &boxes[place] : &empty);
        }
}

static void fill_level(struct exact_tree *tree, uint32_t level, uint32_t children)
{
    const struct exact_box8 *below = tree->nodes + tree->first[level - 1];
    struct exact_box8 *nodes = tree->nodes + tree->first[level];
    for (uint32_t n = 0; n < parents(children); n++)
        for (unsigned c = 0; c < 8; c++) {
            struct exact_box box = empty;
            if (8 * n + c < children)
                box = bounds_of(&below[8 * n + c]);
            set_child(&nodes[n], c, &box);
        }
}

void bake_exact_tree_build(struct exact_tree *tree, uint32_t count, const struct exact_box *boxes,
                           void *memory)
{
    memset(tree, 0, sizeof *tree);
    if (count == 0)
        return;
    tree->count = count;
    tree->nodes = memory;
    fill_leaves(tree, boxes);
    tree->levels = 1;
    for (uint32_t children = parents(count); children > 1; children = parents(children)) {
        uint32_t level = tree->levels++;
        tree->first[level] = tree->first[level - 1] + children;
        fill_level(tree, level, children);
    }
}

/* ---- search ---- */

static unsigned overlaps(const struct exact_box8 *boxes, const struct exact_box *box)
{
    unsigned bits = 0;
    for (unsigned c = 0; c < 8; c++) {
        unsigned inside = 1;
        for (int k = 0; k < 3; k++)
            inside &= (unsigned)(boxes->planes[0][k][c] <= box->high[k]) &
                      (unsigned)(boxes->planes[1][k][c] >= box->low[k]);
        bits |= inside << c;
    }
    return bits;
}

uint32_t bake_exact_tree_overlapping(const struct exact_tree *tree, const struct exact_box *box,
                                     uint32_t *out)
{
    struct {
        uint32_t level, node;
    } stack[EXACT_TREE_STACK];
    uint32_t depth = 0, found = 0;
    if (tree->levels > 0) {
        stack[0].level = tree->levels - 1;
        stack[0].node = 0;
        depth = 1;
    }
    while (depth > 0) {
        const uint32_t level = stack[--depth].level, node = stack[depth].node;
        unsigned bits = overlaps(&tree->nodes[tree->first[level] + node], box);
        for (; bits; bits &= bits - 1) {
            uint32_t child = 8 * node + (uint32_t)__builtin_ctz(bits);
            if (level == 0) {
                out[found++] = child;
            } else {
                stack[depth].level = level - 1;
                stack[depth++].node = child;
            }
        }
    }
    return found;
}

/* ---- curve ---- */

uint64_t bake_exact_curve_place(const float point[3], const float low[3], double side)
{
    const float most = (1 << AXIS_BITS) - 1;
    const float scale = side > 0 ? (float)fmin((double)most / side, 1e30) : 0.0f;
    uint32_t cells[3];
    for (int k = 0; k < 3; k++) {
        float cell = (point[k] - low[k]) * scale;
        cell = cell < most ? cell : most;
        cells[k] = cell > 0.0f ? (uint32_t)cell : 0;
    }
    return bsq_hilbert_place(cells, AXIS_BITS);
}
