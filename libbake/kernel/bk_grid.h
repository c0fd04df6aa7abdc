/* bk_grid.h - finds voxels in a NanoVDB Mask grid (32.4.2), used in place as 64-bit words.
 *
 * Node arrays and channels may be separate buffers, so a child's byte offset is converted to its
 * index in the array. A cache keeps the nodes of the last lookup, as NanoVDB's ReadAccessor does:
 * neighbouring voxels usually share the leaf.
 *
 * Nothing outside of the arrays is read, whatever words they hold: another process may change a
 * mapped file at any time. Every number that comes from the arrays is bounded by a count of struct
 * bk_grid, in the register that is then used as an index; what was true of a word when the file was
 * opened may no longer be. */
#ifndef BAKE_KERNEL_BK_GRID_H
#define BAKE_KERNEL_BK_GRID_H

#include "bk_types.h"

#define BK_NONE 0xffffffffu

/* Node layouts in words of eight bytes. */
#define BK_ROOT_TILE_WORDS  4u     /* root tile: key, child offset, state, value */
#define BK_UPPER_WORDS      33800u /* 32^3 children of 128^3 voxels */
#define BK_UPPER_CHILD_MASK 516u
#define BK_UPPER_TABLE      1032u
#define BK_LOWER_WORDS      4232u /* 16^3 children of 8^3 voxels */
#define BK_LOWER_CHILD_MASK 68u
#define BK_LOWER_TABLE      136u
#define BK_LEAF_WORDS       12u
#define BK_LEAF_MASK        2u /* one word a layer of constant x, bit y << 3 | z */
#define BK_LEAF_OFFSET      10u
#define BK_LEAF_PREFIX      11u

/* log2 of the side of a node. */
#define BK_LEAF_LOG2  3u
#define BK_LOWER_LOG2 7u
#define BK_UPPER_LOG2 12u

typedef struct bk_grid {
    const BK_GLOBAL bk_ulong *root_tiles, *uppers, *lowers, *leaves;
    const BK_GLOBAL bk_uint *normals, *planes, *colors, *seconds;
    const BK_GLOBAL float *srgb; /* linear values of the 256 sRGB codes */
    /* The tree around the leaves: nodes, and the occupied voxels of each leaf's blocks. */
    const BK_GLOBAL bk_ulong2 *nodes;
    const BK_GLOBAL bk_ulong *blocks;
    bk_uint root_tile_count, upper_count, lower_count, leaf_count, second_count;
    /* Byte distances: root to uppers, uppers to lowers, lowers to leaves. */
    bk_ulong upper_offset, lower_offset, leaf_offset;
    bk_ulong second_base;
    bk_ulong id_offset; /* of a record's id from its colour, if there are ids */
    /* Of channels, if there are transfer maps: offset of those of record 0, and words a record. For
     * each map, `transfers` has its first word, times 4, and its number of values, 1 or 3. */
    bk_ulong channel_offset;
    bk_uint channel_words;
    const BK_GLOBAL bk_uint *transfers;
} bk_grid;

/* Nodes that contain voxel (x, y, z); BK_NONE: no such node. */
typedef struct bk_cache {
    bk_int x, y, z;
    bk_uint upper, lower, leaf;
    bk_uint level, side; /* result of the last lookup; log2 of the side of the node it ended in */
} bk_cache;

BK_FN bk_ulong bk_join(const bk_uint words[2])
{
    return (bk_ulong)words[1] << 32 | words[0];
}

/* Sets counts and offsets; the caller sets the pointers. */
BK_FN void bk_grid_from_params(bk_grid *grid, const bk_params *params)
{
    grid->root_tile_count = params->root_tile_count;
    grid->upper_count = params->upper_count;
    grid->lower_count = params->lower_count;
    grid->leaf_count = params->leaf_count;
    grid->second_count = params->second_count;
    grid->upper_offset = bk_join(params->upper_offset);
    grid->lower_offset = bk_join(params->lower_offset);
    grid->leaf_offset = bk_join(params->leaf_offset);
    grid->id_offset = bk_join(params->id_offset);
    grid->channel_offset = bk_join(params->channel_offset);
    grid->channel_words = params->channel_words;
    grid->second_base = (bk_ulong)params->second_base_high << 32 | params->second_base_low;
}

BK_FN bk_cache bk_cache_empty(void)
{
    bk_cache cache;
    cache.x = cache.y = cache.z = 0x7fffffff; /* outside of every grid */
    cache.level = cache.side = 0;
    cache.upper = cache.lower = cache.leaf = BK_NONE;
    return cache;
}

/* Returns the number of the upper node at a voxel, or BK_NONE. Searches the root's tiles, which are
 * in key order. */
BK_FN bk_uint bk_find_upper(const bk_grid *grid, bk_int x, bk_int y, bk_int z)
{
    bk_ulong key = (bk_ulong)((bk_uint)x >> BK_UPPER_LOG2) << 42 |
                   (bk_ulong)((bk_uint)y >> BK_UPPER_LOG2) << 21 |
                   (bk_ulong)((bk_uint)z >> BK_UPPER_LOG2);
    bk_uint low = 0, high = grid->root_tile_count;
    bk_ulong child;
    bk_uint upper;

    while (low < high) {
        bk_uint middle = low + (high - low) / 2;
        if (grid->root_tiles[(bk_ulong)middle * BK_ROOT_TILE_WORDS] < key)
            low = middle + 1;
        else
            high = middle;
    }
    if (low == grid->root_tile_count || grid->root_tiles[(bk_ulong)low * BK_ROOT_TILE_WORDS] != key)
        return BK_NONE;
    child = grid->root_tiles[(bk_ulong)low * BK_ROOT_TILE_WORDS + 1];
    if (child == 0)
        return BK_NONE;
    upper = (bk_uint)((child - grid->upper_offset) / (BK_UPPER_WORDS * 8u));
    return upper < grid->upper_count ? upper : BK_NONE;
}

/* Moves the cache to voxel (x, y, z). Returns 0 if a leaf contains it, else log2 of the side of the
 * empty node around it. */
BK_FN bk_uint bk_locate(const bk_grid *grid, bk_cache *cache, bk_int x, bk_int y, bk_int z)
{
    bk_uint differ = (bk_uint)((x ^ cache->x) | (y ^ cache->y) | (z ^ cache->z));
    bk_ulong node, child;
    bk_uint n;

    if (differ >> cache->side == 0)
        return cache->level;
    cache->x = x;
    cache->y = y;
    cache->z = z;
    cache->leaf = BK_NONE;
    if (differ >= 128u || cache->lower == BK_NONE) {
        cache->lower = BK_NONE;
        if (differ >= 4096u || cache->upper == BK_NONE) {
            cache->upper = bk_find_upper(grid, x, y, z);
        }
        if (cache->upper == BK_NONE)
            return cache->level = cache->side = BK_UPPER_LOG2;
        n = (bk_uint)(x >> 7 & 31) << 10 | (bk_uint)(y >> 7 & 31) << 5 | (bk_uint)(z >> 7 & 31);
        node = (bk_ulong)cache->upper * BK_UPPER_WORDS;
        if (!(grid->uppers[node + BK_UPPER_CHILD_MASK + (n >> 6)] >> (n & 63u) & 1u))
            return cache->level = cache->side = BK_LOWER_LOG2;
        child = node * 8u + grid->uppers[node + BK_UPPER_TABLE + n] - grid->lower_offset;
        cache->lower = (bk_uint)(child / (BK_LOWER_WORDS * 8u));
        if (cache->lower >= grid->lower_count) {
            cache->lower = BK_NONE;
            return cache->level = cache->side = BK_LOWER_LOG2;
        }
    }
    n = (bk_uint)(x >> 3 & 15) << 8 | (bk_uint)(y >> 3 & 15) << 4 | (bk_uint)(z >> 3 & 15);
    node = (bk_ulong)cache->lower * BK_LOWER_WORDS;
    if (!(grid->lowers[node + BK_LOWER_CHILD_MASK + (n >> 6)] >> (n & 63u) & 1u))
        return cache->level = cache->side = BK_LEAF_LOG2;
    child = node * 8u + grid->lowers[node + BK_LOWER_TABLE + n] - grid->leaf_offset;
    cache->leaf = (bk_uint)(child / (BK_LEAF_WORDS * 8u));
    cache->side = BK_LEAF_LOG2;
    if (cache->leaf >= grid->leaf_count) {
        cache->leaf = BK_NONE;
        return cache->level = BK_LEAF_LOG2;
    }
    return cache->level = 0;
}

/* Returns the value index of the first active voxel of a leaf at or after (layer, bit). */
BK_FN bk_ulong bk_leaf_rank(const bk_grid *grid, const BK_GLOBAL bk_ulong *words, bk_uint layer,
                            bk_uint bit)
{
    const bk_ulong below = words[BK_LEAF_MASK + layer] & (((bk_ulong)1 << bit) - 1u);
    bk_uint before = 0;
    bk_ulong rank;

    if (layer)
        before = (bk_uint)(words[BK_LEAF_PREFIX] >> (9u * (layer - 1u))) & 511u;
    rank = words[BK_LEAF_OFFSET] + before + bk_popcount64(below);
    return rank < grid->second_base ? rank : 0;
}

/* Returns the value index of a voxel of a leaf, 0 if it is not active. */
BK_FN bk_ulong bk_leaf_value(const bk_grid *grid, bk_uint leaf, bk_int x, bk_int y, bk_int z)
{
    const BK_GLOBAL bk_ulong *words = grid->leaves + (bk_ulong)leaf * BK_LEAF_WORDS;
    const bk_uint layer = (bk_uint)x & 7u, bit = ((bk_uint)y & 7u) << 3 | ((bk_uint)z & 7u);

    if (!(words[BK_LEAF_MASK + layer] >> bit & 1u))
        return 0;
    return bk_leaf_rank(grid, words, layer, bit);
}

/* Returns the number of the second record of the voxel with value index v, or 0. v must be below
 * grid->second_base. Trusts neither the flag in the plane nor the rank. */
BK_FN bk_ulong bk_second(const bk_grid *grid, bk_ulong v)
{
    const BK_GLOBAL bk_uint *pair = grid->seconds + (v >> 5) * 2u;
    const bk_uint bit = (bk_uint)v & 31u, bits = pair[0];
    const bk_ulong rank = (bk_ulong)pair[1] + bk_popcount32(bits & (((bk_uint)1 << bit) - 1u));

    return bits >> bit & 1u && rank < grid->second_count ? grid->second_base + rank : 0;
}

#endif
