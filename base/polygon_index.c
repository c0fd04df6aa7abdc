/* polygon_index.c - finds corners of a polygon that lie in a triangle.
 *
 * Corners are sorted along the Z-order curve of their ranks on two axes, and a complete binary tree
 * of bounding boxes is built over them (Qi, Tao, Chang and Zhang, "Theoretically Optimal and
 * Empirically Efficient R-trees with Strong Parallelizability", 2018). Ranks adapt to any
 * distribution of corners, and corners at one place stay together.
 *
 * A node is skipped only if outline_has() is false for all positions in its box. That holds
 * exactly: floating-point subtraction, multiplication and addition are monotonic, and the bound
 * computes what outline_has() computes, in the same order, from the box's extremes. */
#include <math.h>
#include <string.h>

#include "base/polygon_internal.h"

enum { LEAF_CORNERS = 8, DIGIT_BITS = 8, DIGITS = 1 << DIGIT_BITS };

/* ---- memory ---- */

static uint32_t leaf_count(uint32_t count)
{
    uint32_t leaves = 1;
    while ((uint64_t)leaves * LEAF_CORNERS < count)
        leaves *= 2;
    return leaves;
}

uint64_t bsq_corner_index_bytes(uint32_t count, uint32_t n)
{
    const uint64_t nodes = 2 * (uint64_t)leaf_count(count);
    const uint64_t numbers = (uint64_t)count + n + nodes;
    return 2 * (uint64_t)count * sizeof(struct index_entry) + nodes * sizeof(struct index_box) +
           bsq_align_up(numbers * sizeof(uint32_t), 8);
}

void bsq_corner_index_init(struct corner_index *index, const double (*positions)[3], uint32_t count,
                           uint32_t n, void *memory)
{
    const uint32_t leaves = leaf_count(count);
    *index = (struct corner_index){.positions = positions, .count = count, .leaves = leaves};
    index->entries = memory;
    index->boxes = (struct index_box *)(index->entries + 2 * (uint64_t)count);
    index->order = (uint32_t *)(index->boxes + 2 * (uint64_t)leaves);
    index->places = index->order + count;
    index->live = index->places + n;
}

/* ---- order ---- */

/* Maps a number to an integer of the same order; 0 and -0 are equal. */
static uint64_t ordered_bits(double value)
{
    uint64_t bits;
    value += 0.0;
    memcpy(&bits, &value, sizeof bits);
    return bits >> 63 ? ~bits : bits | UINT64_C(1) << 63;
}

/* Moves the entries in the order of one digit of their keys. Returns false if it is the same in all
 * of them; then nothing is moved. */
static bool sort_by_digit(const struct index_entry *from, struct index_entry *to, uint32_t count,
                          unsigned shift)
{
    uint32_t starts[DIGITS] = {0}, sum = 0;
    for (uint32_t i = 0; i < count; i++)
        starts[from[i].key >> shift & (DIGITS - 1)]++;
    if (starts[from[0].key >> shift & (DIGITS - 1)] == count)
        return false;
    for (uint32_t d = 0; d < DIGITS; d++) {
        const uint32_t entries = starts[d];
        starts[d] = sum;
        sum += entries;
    }
    for (uint32_t i = 0; i < count; i++)
        to[starts[from[i].key >> shift & (DIGITS - 1)]++] = from[i];
    return true;
}

/* Sorts by key, stably. *entries are in one half of the scratch memory, *spare is the other one. */
static int sort_entries(struct bsq_ctx *ctx, uint32_t count, struct index_entry **entries,
                        struct index_entry **spare)
{
    int status = 0;
    for (unsigned shift = 0; shift < 64 && status == 0; shift += DIGIT_BITS) {
        if (sort_by_digit(*entries, *spare, count, shift)) {
            struct index_entry *sorted = *spare;
            *spare = *entries;
            *entries = sorted;
        }
        status = bsq_check(ctx);
    }
    return status;
}

/* Spreads the bits of a number so that a zero bit follows each. */
static uint64_t spread(uint32_t number)
{
    uint64_t x = number;
    x = (x | x << 16) & 0x0000ffff0000ffffu;
    x = (x | x << 8) & 0x00ff00ff00ff00ffu;
    x = (x | x << 4) & 0x0f0f0f0f0f0f0f0fu;
    x = (x | x << 2) & 0x3333333333333333u;
    return (x | x << 1) & 0x5555555555555555u;
}

/* Sorts the corners of `order` along the Z-order curve of their ranks on two axes. */
static int sort_corners(struct bsq_ctx *ctx, struct corner_index *index, const int axes[2])
{
    const uint32_t count = index->count;
    struct index_entry *entries = index->entries, *spare = entries + count;
    int status = 0;
    for (uint32_t i = 0; i < count; i++)
        entries[i] = (struct index_entry){.corner = index->order[i]};
    for (int k = 0; k < 2 && status == 0; k++) {
        for (uint32_t i = 0; i < count; i++)
            entries[i].key = ordered_bits(index->positions[entries[i].corner][axes[k]]);
        status = sort_entries(ctx, count, &entries, &spare);
        uint64_t before = entries[0].key;
        for (uint32_t i = 0, rank = 0; i < count; i++) {
            const uint64_t key = entries[i].key;
            rank += key != before;
            before = key;
            entries[i].key = spread(entries[i].rank) << 1 | spread(rank);
            entries[i].rank = rank;
        }
    }
    if (status == 0)
        status = sort_entries(ctx, count, &entries, &spare);
    for (uint32_t i = 0; i < count; i++)
        index->order[i] = entries[i].corner;
    return status;
}

/* ---- the tree ---- */

static void include(struct index_box *box, const double low[3], const double high[3])
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = low[k] < box->low[k] ? low[k] : box->low[k];
        box->high[k] = high[k] > box->high[k] ? high[k] : box->high[k];
    }
}

/* Computes a node from its corners or children. */
static void update_node(struct corner_index *index, uint32_t node)
{
    struct index_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    uint32_t live = 0;
    if (node >= index->leaves) {
        const uint64_t first = (uint64_t)(node - index->leaves) * LEAF_CORNERS;
        for (uint64_t i = first; i < first + LEAF_CORNERS && i < index->count; i++) {
            if (index->order[i] == UINT32_MAX)
                continue;
            include(&box, index->positions[index->order[i]], index->positions[index->order[i]]);
            live++;
        }
    } else {
        for (uint32_t child = 2 * node; child <= 2 * node + 1; child++) {
            include(&box, index->boxes[child].low, index->boxes[child].high);
            live += index->live[child];
        }
    }
    index->boxes[node] = box;
    index->live[node] = live;
}

/* Drops the axis along which the polygon extends least. */
static void choose_axes(struct vector normal, int axes[2])
{
    const double x = fabs(normal.x), y = fabs(normal.y), z = fabs(normal.z);
    axes[0] = x >= y && x >= z ? 1 : 0;
    axes[1] = axes[0] == 1 || y >= z ? 2 : 1;
}

int bsq_corner_index_fill(struct bsq_ctx *ctx, struct corner_index *index, struct vector normal)
{
    int axes[2];
    choose_axes(normal, axes);
    int status = sort_corners(ctx, index, axes);
    for (uint32_t i = 0; i < index->count; i++)
        index->places[index->order[i]] = i;
    for (uint32_t node = 2 * index->leaves - 1; node > 0 && status == 0; node--)
        update_node(index, node);
    return status;
}

void bsq_corner_index_remove(struct corner_index *index, uint32_t corner)
{
    const uint32_t place = index->places[corner];
    index->order[place] = UINT32_MAX;
    for (uint32_t node = index->leaves + place / LEAF_CORNERS; node > 0; node /= 2)
        update_node(index, node);
}

/* ---- search ---- */

/* Returns the larger product of `factor` and a number from `low` to `high`; NaN if it is unknown.
 */
static double largest(double factor, double low, double high)
{
    const double a = factor * low, b = factor * high;
    return a >= b ? a : b >= a ? b : (double)NAN;
}

/* Returns false if no position in the box can lie in the outline. */
static bool may_overlap(const struct index_box *box, const struct outline *o)
{
    for (int i = 0; i < 3; i++) {
        const double *p = o->corners[i];
        const struct vector low = difference(box->low, p), high = difference(box->high, p);
        const struct vector most = {largest(o->inward[i].x, low.x, high.x),
                                    largest(o->inward[i].y, low.y, high.y),
                                    largest(o->inward[i].z, low.z, high.z)};
        if (most.x + most.y + most.z < 0)
            return false;
    }
    /* Corners at the position of one of the outline's do not count. */
    return !is_same_place(box->low, box->high) ||
           (!is_same_place(box->low, o->corners[0]) && !is_same_place(box->low, o->corners[1]) &&
            !is_same_place(box->low, o->corners[2]));
}

static uint32_t search_leaf(const struct corner_index *index, uint32_t leaf,
                            const struct outline *outline)
{
    const uint32_t first = (leaf - index->leaves) * LEAF_CORNERS;
    for (uint32_t i = first; i < first + LEAF_CORNERS && i < index->count; i++) {
        const uint32_t corner = index->order[i];
        if (corner != UINT32_MAX && outline_has(outline, index->positions[corner]))
            return corner;
    }
    return UINT32_MAX;
}

/* Returns bits that look random: the finaliser of MurmurHash3 (Appleby, 2011). */
static uint32_t mix(uint32_t x)
{
    x = (x ^ x >> 16) * UINT32_C(0x85ebca6b);
    x = (x ^ x >> 13) * UINT32_C(0xc2b2ae35);
    return x ^ x >> 16;
}

uint32_t bsq_corner_index_find(const struct corner_index *index, const struct outline *outline,
                               uint32_t seed)
{
    uint32_t stack[64], depth = 0;
    seed = mix(seed);
    stack[depth++] = 1;
    while (depth > 0) {
        const uint32_t node = stack[--depth];
        if (index->live[node] == 0 || !may_overlap(&index->boxes[node], outline))
            continue;
        if (node >= index->leaves) {
            const uint32_t corner = search_leaf(index, node, outline);
            if (corner != UINT32_MAX)
                return corner;
            continue;
        }
        const uint32_t first = mix(node + seed) >> 31;
        stack[depth++] = 2 * node + !first;
        stack[depth++] = 2 * node + first;
    }
    return UINT32_MAX;
}
