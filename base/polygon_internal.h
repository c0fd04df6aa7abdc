/* polygon_internal.h - vectors, sets of numbers, and an index of a polygon's corners in space;
 * private to polygon*.c. */
#ifndef BSQ_POLYGON_INTERNAL_H
#define BSQ_POLYGON_INTERNAL_H

#include <string.h>

#include "base/context.h"

struct vector {
    double x, y, z;
};

static inline struct vector difference(const double *a, const double *b)
{
    return (struct vector){a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

static inline struct vector cross(struct vector a, struct vector b)
{
    return (struct vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double dot(struct vector a, struct vector b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* A triangle as seen along the polygon's normal: corners, and normals of its edges. Edge i runs
 * from corner i to the next one; its normal points inwards. */
struct outline {
    const double *corners[3];
    struct vector inward[3];
};

static inline bool is_same_place(const double *a, const double *b)
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

/* Returns whether a position lies in the outline or on its border. Positions of the outline's
 * corners do not count: a polygon with holes has a bridge to each hole, which it walks twice. */
static inline bool outline_has(const struct outline *o, const double *q)
{
    for (int i = 0; i < 3; i++)
        if (dot(o->inward[i], difference(q, o->corners[i])) < 0)
            return false;
    return !is_same_place(q, o->corners[0]) && !is_same_place(q, o->corners[1]) &&
           !is_same_place(q, o->corners[2]);
}

/* ---- sets of numbers ----
 *
 * The next member of a set is found in logarithmic time. Level 0 has a bit for each number. A bit
 * of a higher level tells whether a word of the level below has any bit. */

enum { BIT_TREE_LEVELS = 6 }; /* 64^6 is above 2^32 */

struct bit_tree {
    uint64_t *levels[BIT_TREE_LEVELS];
    uint32_t height; /* levels in use */
};

#define BIT_TREE_NONE UINT32_MAX

/* Returns the 64-bit words that a set of numbers below `size` needs. */
static inline uint64_t bit_tree_words(uint32_t size)
{
    uint64_t words = 0, level = size;
    do {
        level = (level + 63) / 64;
        words += level;
    } while (level > 1);
    return words;
}

/* Makes an empty set in `words`. */
static inline void bit_tree_init(struct bit_tree *tree, uint64_t *words, uint32_t size)
{
    uint64_t level = size;
    memset(words, 0, bit_tree_words(size) * sizeof *words);
    tree->height = 0;
    do {
        level = (level + 63) / 64;
        tree->levels[tree->height++] = words;
        words += level;
    } while (level > 1);
}

static inline bool bit_tree_has(const struct bit_tree *tree, uint32_t number)
{
    return tree->levels[0][number / 64] >> number % 64 & 1;
}

static inline void bit_tree_add(struct bit_tree *tree, uint32_t number)
{
    for (uint32_t l = 0; l < tree->height; l++, number /= 64)
        tree->levels[l][number / 64] |= UINT64_C(1) << number % 64;
}

static inline void bit_tree_remove(struct bit_tree *tree, uint32_t number)
{
    for (uint32_t l = 0; l < tree->height; l++, number /= 64) {
        tree->levels[l][number / 64] &= ~(UINT64_C(1) << number % 64);
        if (tree->levels[l][number / 64] != 0)
            break;
    }
}

/* Returns the smallest member >= `from`, which is below the set's size; BIT_TREE_NONE if there is
 * none. */
static inline uint32_t bit_tree_next(const struct bit_tree *tree, uint32_t from)
{
    uint64_t rest = tree->levels[0][from / 64] >> from % 64;
    if (rest)
        return from + (uint32_t)__builtin_ctzll(rest);
    for (uint32_t l = 1; l < tree->height; l++) {
        from /= 64;
        /* The word that holds `from` was searched in the level below. */
        rest = tree->levels[l][from / 64] >> from % 64 >> 1;
        if (rest == 0)
            continue;
        from += 1 + (uint32_t)__builtin_ctzll(rest);
        while (l-- > 0)
            from = 64 * from + (uint32_t)__builtin_ctzll(tree->levels[l][from]);
        return from;
    }
    return BIT_TREE_NONE;
}

/* ---- polygon_index.c ---- */

struct index_box {
    double low[3], high[3];
};

struct index_entry {
    uint64_t key;
    uint32_t corner, rank;
};

/* Some corners of a polygon in a binary tree of boxes. Node 1 is the root; the children of node i
 * are 2 i and 2 i + 1. */
struct corner_index {
    const double (*positions)[3];
    uint32_t count, leaves;   /* corners; leaf nodes, a power of two */
    uint32_t *order, *places; /* corners in the order of the leaves; where each corner is there */
    uint32_t *live;           /* corners of each node that were not removed */
    struct index_box *boxes;
    struct index_entry *entries; /* scratch memory, for 2 * count */
};

/* Returns the bytes that an index of `count` of a polygon's n corners needs. */
uint64_t bsq_corner_index_bytes(uint32_t count, uint32_t n);

/* Fills the index with index->count corners, which index->order lists. `normal` is the polygon's.
 * Errors: BSQ_EINTR. */
int bsq_corner_index_fill(struct bsq_ctx *ctx, struct corner_index *index, struct vector normal);

/* Places the arrays of an index for `count` corners of n in `memory`, aligned to 8 bytes. */
void bsq_corner_index_init(struct corner_index *index, const double (*positions)[3], uint32_t count,
                           uint32_t n, void *memory);

void bsq_corner_index_remove(struct corner_index *index, uint32_t corner);

/* Returns any corner of the index for which outline_has() holds, or UINT32_MAX. `seed` varies which
 * one. */
uint32_t bsq_corner_index_find(const struct corner_index *index, const struct outline *outline,
                               uint32_t seed);

#endif
