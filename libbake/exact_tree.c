/* exact_tree.c - building and searching trees of boxes. */
#include "libbake/exact_tree_internal.h"

#include <string.h>

/* A sort key: place on the Morton curve above, number of the box below. */
enum { NUMBER_BITS = 22, AXIS_BITS = 14, DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS };
_Static_assert(NUMBER_BITS + 3 * AXIS_BITS == 64, "keys fill 64 bits");

static uint64_t align64(uint64_t bytes)
{
    return (bytes + 63) & ~UINT64_C(63);
}

static uint32_t parents(uint32_t count)
{
    return count / 4 + (count % 4 != 0);
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

uint64_t exact_tree_bytes(uint32_t count)
{
    return align64(node_count(count) * sizeof(struct exact_box4)) +
           align64((uint64_t)count * sizeof(uint32_t));
}

uint64_t exact_tree_scratch_bytes(uint32_t count)
{
    return 2 * (uint64_t)count * sizeof(uint64_t);
}

/* ---- order ---- */

/* Bits 0 .. 13 of v moved to every third place. */
static uint64_t spread(uint32_t v)
{
    uint64_t x = v;
    x = (x | x << 32) & UINT64_C(0x1f00000000ffff);
    x = (x | x << 16) & UINT64_C(0x1f0000ff0000ff);
    x = (x | x << 8) & UINT64_C(0x100f00f00f00f00f);
    x = (x | x << 4) & UINT64_C(0x10c30c30c30c30c3);
    return (x | x << 2) & UINT64_C(0x1249249249249249);
}

uint64_t exact_curve_place(const float point[3], const float low[3], double side)
{
    const float most = (1 << AXIS_BITS) - 1;
    const float scale = side > 0 ? (float)fmin((double)most / side, 1e30) : 0.0f;
    uint64_t place = 0;
    for (int k = 0; k < 3; k++) {
        float cell = (point[k] - low[k]) * scale;
        cell = cell < most ? cell : most;
        place |= spread(cell > 0.0f ? (uint32_t)cell : 0) << k;
    }
    return place;
}

/* Keys of the boxes' centres, on a lattice that divides the longest side of their bounds. */
static void make_keys(uint32_t count, const struct exact_box *boxes, uint64_t *keys)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            float centre = 0.5f * boxes[i].low[k] + 0.5f * boxes[i].high[k];
            low[k] = centre < low[k] ? centre : low[k];
            high[k] = centre > high[k] ? centre : high[k];
        }
    double side = 0;
    for (int k = 0; k < 3; k++)
        side = fmax(side, (double)high[k] - (double)low[k]);
    for (uint32_t i = 0; i < count; i++) {
        float centre[3];
        for (int k = 0; k < 3; k++)
            centre[k] = 0.5f * boxes[i].low[k] + 0.5f * boxes[i].high[k];
        keys[i] = exact_curve_place(centre, low, side) << NUMBER_BITS | i;
    }
}

/* Sorts by place; the result is in keys again. */
static void sort_keys(uint32_t count, uint64_t *keys, uint64_t *other)
{
    for (unsigned shift = NUMBER_BITS; shift < 64; shift += DIGIT_BITS) {
        uint32_t starts[DIGITS] = {0}, sum = 0;
        for (uint32_t i = 0; i < count; i++)
            starts[keys[i] >> shift & (DIGITS - 1)]++;
        for (int d = 0; d < DIGITS; d++) {
            uint32_t here = starts[d];
            starts[d] = sum;
            sum += here;
        }
        for (uint32_t i = 0; i < count; i++)
            other[starts[keys[i] >> shift & (DIGITS - 1)]++] = keys[i];
        uint64_t *swap = keys;
        keys = other;
        other = swap;
    }
}
_Static_assert((64 - NUMBER_BITS + DIGIT_BITS - 1) / DIGIT_BITS % 2 == 0,
               "an even number of passes");

/* ---- nodes ---- */

static void set_child(struct exact_box4 *node, unsigned child, const struct exact_box *box)
{
    for (int k = 0; k < 3; k++) {
        node->planes[0][k][child] = box->low[k];
        node->planes[1][k][child] = box->high[k];
    }
}

static struct exact_box bounds_of(const struct exact_box4 *node)
{
    struct exact_box box;
    for (int k = 0; k < 3; k++) {
        const float *low = node->planes[0][k], *high = node->planes[1][k];
        box.low[k] = low[0];
        box.high[k] = high[0];
        for (int c = 1; c < 4; c++) {
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
        for (unsigned c = 0; c < 4; c++) {
            uint32_t place = 4 * n + c;
            set_child(&tree->nodes[n], c,
                      place < tree->count ? &boxes[tree->order[place]] : &empty);
        }
}

static void fill_level(struct exact_tree *tree, uint32_t level, uint32_t children)
{
    const struct exact_box4 *below = tree->nodes + tree->first[level - 1];
    struct exact_box4 *nodes = tree->nodes + tree->first[level];
    for (uint32_t n = 0; n < parents(children); n++)
        for (unsigned c = 0; c < 4; c++) {
            struct exact_box box = empty;
            if (4 * n + c < children)
                box = bounds_of(&below[4 * n + c]);
            set_child(&nodes[n], c, &box);
        }
}

void exact_tree_build(struct exact_tree *tree, uint32_t count, const struct exact_box *boxes,
                      void *memory, void *scratch)
{
    uint64_t *keys = scratch;
    memset(tree, 0, sizeof *tree);
    if (count == 0)
        return;
    tree->count = count;
    tree->nodes = memory;
    tree->order =
        (uint32_t *)(void *)((char *)memory + align64(node_count(count) * sizeof *tree->nodes));
    make_keys(count, boxes, keys);
    sort_keys(count, keys, keys + count);
    for (uint32_t i = 0; i < count; i++)
        tree->order[i] = (uint32_t)(keys[i] & ((UINT64_C(1) << NUMBER_BITS) - 1));
    fill_leaves(tree, boxes);
    tree->levels = 1;
    for (uint32_t children = parents(count); children > 1; children = parents(children)) {
        uint32_t level = tree->levels++;
        tree->first[level] = tree->first[level - 1] + children;
        fill_level(tree, level, children);
    }
}

/* ---- search ---- */

static unsigned overlaps4(const struct exact_box4 *boxes, const struct exact_box *box)
{
    unsigned bits = 0;
    for (unsigned c = 0; c < 4; c++) {
        unsigned inside = 1;
        for (int k = 0; k < 3; k++)
            inside &= (unsigned)(boxes->planes[0][k][c] <= box->high[k]) &
                      (unsigned)(boxes->planes[1][k][c] >= box->low[k]);
        bits |= inside << c;
    }
    return bits;
}

uint32_t exact_tree_overlapping(const struct exact_tree *tree, const struct exact_box *box,
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
        unsigned bits = overlaps4(&tree->nodes[tree->first[level] + node], box);
        for (; bits; bits &= bits - 1) {
            uint32_t child = 4 * node + (uint32_t)__builtin_ctz(bits);
            if (level == 0) {
                out[found++] = tree->order[child];
            } else {
                stack[depth].level = level - 1;
                stack[depth++].node = child;
            }
        }
    }
    return found;
}
