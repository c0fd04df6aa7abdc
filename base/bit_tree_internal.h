/* bit_tree_internal.h - a set of numbers that finds its next member in logarithmic time; private to
 * base.
 *
 * Level 0 has a bit for each number. A bit of a higher level tells whether a word of the level
 * below has any bit. */
#ifndef BSQ_BIT_TREE_INTERNAL_H
#define BSQ_BIT_TREE_INTERNAL_H

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

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

#endif
