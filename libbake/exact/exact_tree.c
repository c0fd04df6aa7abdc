/* exact_tree.c - builds and searches trees of boxes, and computes places on the Hilbert curve. */
#include "libbake/exact/exact_tree.h"
#include "libbake/exact/exact.h"

#include <math.h>
#include <string.h>

#include "base/simd/simd.h"
#include "base/geometry/space_curve.h"

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

/* Sets a node to eight boxes. Returns the bounds of all. */
static struct exact_box set_node(struct exact_box8 *node, const struct exact_box boxes[8])
{
    /* Lower bounds are values 0 to 2 of the one, upper bounds are values 1 to 3 of the other. */
    four_floats low[8], high[8];
    four_floats least = {INFINITY, INFINITY, INFINITY, 0}, most = {0, INFINITY, INFINITY, INFINITY};
    struct exact_box all;
    for (int c = 0; c < 8; c++) {
        memcpy(&low[c], &boxes[c], sizeof *low);
        memcpy(&high[c], (const char *)&boxes[c] + sizeof boxes[c] - sizeof *high, sizeof *high);
        least = four_floats_min(low[c], least);
        most = four_floats_min(-high[c], most);
    }
    exact_node_set(node, low, high, 1);
    for (int k = 0; k < 3; k++) {
        all.low[k] = least[k];
        all.high[k] = -most[k + 1];
    }
    return all;
}

/* Sets a level's nodes to `count` boxes, and replaces the boxes by the nodes' bounds. Returns their
 * number. */
static uint32_t set_level(struct exact_box8 *nodes, struct exact_box *boxes, uint32_t count)
{
    const uint32_t left = count % 8;
    struct exact_box last[8];
    for (uint32_t c = 0; c < 8; c++)
        last[c] = c < left ? boxes[count - left + c] : EXACT_EMPTY_BOX;
    for (uint32_t n = 0; n < count / 8; n++)
        boxes[n] = set_node(&nodes[n], &boxes[8 * n]);
    if (left > 0)
        boxes[count / 8] = set_node(&nodes[count / 8], last);
    return parents(count);
}

void bake_exact_tree_build(struct exact_tree *tree, uint32_t count, struct exact_box *boxes,
                           void *memory)
{
    memset(tree, 0, sizeof *tree);
    if (count == 0)
        return;
    tree->count = count;
    tree->nodes = memory;
    for (uint32_t left = count, first = 0; tree->levels == 0 || left > 1; first += left) {
        tree->first[tree->levels++] = first;
        left = set_level(tree->nodes + first, boxes, left);
    }
}

/* ---- search ---- */

static unsigned exact_overlaps(const struct exact_box8 *boxes, const struct exact_box *box)
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

/* Calls `take` for the numbers of the boxes that overlap `box`. */
static inline __attribute__((always_inline)) void
each_overlapping(const struct exact_tree *tree, const struct exact_box *box,
                 void (*take)(void *arg, uint32_t number), void *arg)
{
    struct {
        uint32_t level, node;
    } stack[EXACT_TREE_STACK];
    uint32_t depth = 0;
    if (tree->levels > 0) {
        stack[0].level = tree->levels - 1;
        stack[0].node = 0;
        depth = 1;
    }
    while (depth > 0) {
        const uint32_t level = stack[--depth].level, node = stack[depth].node;
        unsigned bits = exact_overlaps(&tree->nodes[tree->first[level] + node], box);
        for (; bits; bits &= bits - 1) {
            uint32_t child = 8 * node + (uint32_t)__builtin_ctz(bits);
            if (level == 0) {
                take(arg, child);
            } else {
                stack[depth].level = level - 1;
                stack[depth++].node = child;
            }
        }
    }
}

static void list_box(void *arg, uint32_t number)
{
    uint32_t **end = arg;
    *(*end)++ = number;
}

uint32_t bake_exact_tree_overlapping(const struct exact_tree *tree, const struct exact_box *box,
                                     uint32_t *out)
{
    uint32_t *end = out;
    each_overlapping(tree, box, list_box, &end);
    return (uint32_t)(end - out);
}

struct span {
    uint32_t from, first, last;
};

static void widen_span(void *arg, uint32_t number)
{
    struct span *span = arg;
    if (number < span->from)
        return;
    span->first = number < span->first ? number : span->first;
    span->last = number > span->last ? number : span->last;
}

void bake_exact_tree_span(const struct exact_tree *tree, const struct exact_box *box, uint32_t from,
                          uint32_t *first, uint32_t *last)
{
    struct span span = {from, UINT32_MAX, 0};
    each_overlapping(tree, box, widen_span, &span);
    *first = span.first;
    *last = span.last;
}

/* ---- curve ---- */

uint64_t bake_exact_curve_index(const float point[3], const float low[3], double side)
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
