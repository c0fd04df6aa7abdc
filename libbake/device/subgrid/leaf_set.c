/* leaf_set.c - one 4096-bit mask for each lower node in the set; a box sets rows of up to 16 bits.
 *
 * The file may change while it is read, so every number from it is bounded here, as in the kernel:
 * children of wrong numbers count as missing. */
#include "libbake/device/subgrid/leaf_set.h"

#include <string.h>

#include "libbake/kernel/bk_grid.h"

static const uint64_t *upper_words(const struct fmt_nvdb_grid *grid, uint32_t upper)
{
    return (const uint64_t *)(const void *)grid->uppers + (uint64_t)upper * BK_UPPER_WORDS;
}

static const uint64_t *lower_words(const struct fmt_nvdb_grid *grid, uint32_t lower)
{
    return (const uint64_t *)(const void *)grid->lowers + (uint64_t)lower * BK_LOWER_WORDS;
}

static const uint64_t *leaf_words(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    return (const uint64_t *)(const void *)grid->leaves + (uint64_t)leaf * BK_LEAF_WORDS;
}

/* Returns the number of the node at a byte offset from the first node of its level, or BK_NONE. */
static uint32_t node_at(uint64_t offset, uint32_t node_words, uint32_t count)
{
    const uint64_t number = offset / (node_words * UINT64_C(8));
    return number < count ? (uint32_t)number : BK_NONE;
}

uint32_t bake_tile_upper(const struct fmt_nvdb_grid *grid, uint64_t child)
{
    const uint64_t distance = (uint64_t)(grid->uppers - grid->root);
    return node_at(child - distance, BK_UPPER_WORDS, grid->upper_count);
}

uint32_t bake_upper_lower(const struct fmt_nvdb_grid *grid, uint32_t upper, uint32_t n)
{
    const uint64_t distance = (uint64_t)(grid->lowers - grid->uppers);
    const uint64_t node = (uint64_t)upper * BK_UPPER_WORDS;
    const uint64_t child = node * 8 + upper_words(grid, upper)[BK_UPPER_TABLE + n] - distance;
    return node_at(child, BK_LOWER_WORDS, grid->lower_count);
}

const uint64_t *bake_lower_children(const struct fmt_nvdb_grid *grid, uint32_t lower)
{
    return lower_words(grid, lower) + BK_LOWER_CHILD_MASK;
}

uint32_t bake_lower_leaf(const struct fmt_nvdb_grid *grid, uint32_t lower, uint32_t n)
{
    const uint64_t distance = (uint64_t)(grid->leaves - grid->lowers);
    const uint64_t node = (uint64_t)lower * BK_LOWER_WORDS;
    const uint64_t child = node * 8 + lower_words(grid, lower)[BK_LOWER_TABLE + n] - distance;
    return node_at(child, BK_LEAF_WORDS, grid->leaf_count);
}

uint64_t bake_leaf_first(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    const uint64_t first = leaf_words(grid, leaf)[BK_LEAF_OFFSET];
    return first <= grid->voxel_count ? first : grid->voxel_count;
}

uint32_t bake_leaf_voxels(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    const uint64_t *words = leaf_words(grid, leaf);
    uint32_t count = 0;
    for (uint32_t i = 0; i < 8; i++)
        count += (uint32_t)__builtin_popcountll(words[BK_LEAF_MASK + i]);
    return count;
}

uint64_t bake_seconds_below(const struct fmt_nvdb_grid *grid, uint64_t v)
{
    const uint64_t all = grid->record_count - 1 - grid->voxel_count;
    if (v > grid->voxel_count)
        return all;
    const uint32_t *pair = grid->seconds[v >> 5];
    const uint32_t below = pair[0] & (uint32_t)((UINT64_C(1) << (v & 31)) - 1);
    const uint64_t count = (uint64_t)pair[1] + (uint32_t)__builtin_popcount(below);
    return count < all ? count : all;
}

int bake_leaf_set_create(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                         struct bake_leaf_set *out)
{
    *out = (struct bake_leaf_set){.grid = grid};
    int status = bsq_calloc(ctx, "upper nodes of a pass", grid->upper_count, 1, &out->has_upper);
    if (status == 0)
        status = bsq_calloc(ctx, "lower nodes of a pass", grid->lower_count,
                            sizeof *out->place_of_lower, &out->place_of_lower);
    return status;
}

void bake_leaf_set_free(struct bsq_ctx *ctx, struct bake_leaf_set *set)
{
    bsq_free(ctx, set->has_upper);
    bsq_free(ctx, set->place_of_lower);
    bsq_free(ctx, set->lowers);
    bsq_free(ctx, set->leaf_masks);
    *set = (struct bake_leaf_set){0};
}

void bake_leaf_set_clear(struct bake_leaf_set *set)
{
    for (uint64_t i = 0; i < set->lower_count; i++)
        set->place_of_lower[set->lowers[i]] = 0;
    memset(set->has_upper, 0, set->grid->upper_count);
    set->lower_count = set->upper_count = 0;
    set->leaf_count = set->voxel_count = set->second_count = 0;
}

/* ---- adding ---- */

static void add_upper(struct bake_leaf_set *set, uint32_t upper)
{
    set->upper_count += !set->has_upper[upper];
    set->has_upper[upper] = 1;
}

/* Returns the leaf mask of a lower node, and adds the node if it is new. */
static int find_lower(struct bsq_ctx *ctx, struct bake_leaf_set *set, uint32_t lower,
                      uint64_t **mask)
{
    if (set->place_of_lower[lower] == 0) {
        uint64_t capacity = set->capacity;
        int status = bsq_grow(ctx, "lower nodes of a pass", set->lower_count + 1,
                              sizeof *set->lowers, &set->lowers, &capacity);
        if (status == 0)
            status = bsq_grow(ctx, "leaves of a pass", set->lower_count + 1,
                              sizeof *set->leaf_masks, &set->leaf_masks, &set->capacity);
        if (status < 0)
            return status;
        memset(set->leaf_masks[set->lower_count], 0, sizeof *set->leaf_masks);
        set->lowers[set->lower_count++] = lower;
        set->place_of_lower[lower] = (uint32_t)set->lower_count;
    }
    *mask = set->leaf_masks[set->place_of_lower[lower] - 1];
    return 0;
}

static void count_leaves(struct bake_leaf_set *counts, uint32_t lower, uint32_t word,
                         uint64_t added)
{
    const struct fmt_nvdb_grid *grid = counts->grid;
    for (; added; added &= added - 1) {
        const uint32_t n = word * 64 + (uint32_t)__builtin_ctzll(added);
        const uint32_t leaf = bake_lower_leaf(grid, lower, n);
        if (leaf == BK_NONE)
            continue;
        const uint64_t first = bake_leaf_first(grid, leaf), voxels = bake_leaf_voxels(grid, leaf);
        const uint64_t begin = bake_seconds_below(grid, first);
        const uint64_t end = bake_seconds_below(grid, first + voxels);
        counts->leaf_count++;
        counts->voxel_count += voxels;
        counts->second_count += end > begin ? end - begin : 0;
    }
}

/* Computes which children of a node overlap voxels low .. high along an axis. */
static void child_range(int32_t origin, int32_t low, int32_t high, uint32_t child_log2,
                        uint32_t children, uint32_t *first, uint32_t *last)
{
    const int64_t a = ((int64_t)low - origin) >> child_log2;
    const int64_t b = ((int64_t)high - origin) >> child_log2;
    *first = a < 0 ? 0 : (uint32_t)a;
    *last = b >= children ? children - 1 : (uint32_t)b;
}

static int visit_upper(const struct fmt_nvdb_grid *grid, uint32_t upper, const int32_t origin[3],
                       const int32_t low[3], const int32_t high[3], bake_node_visit *visit,
                       void *arg)
{
    const uint64_t *words = upper_words(grid, upper);
    uint32_t first[3], last[3];
    int status = visit(arg, upper, BK_NONE, origin);
    for (int k = 0; k < 3; k++)
        child_range(origin[k], low[k], high[k], BK_LOWER_LOG2, 32, &first[k], &last[k]);
    for (uint32_t x = first[0]; x <= last[0]; x++)
        for (uint32_t y = first[1]; y <= last[1]; y++)
            for (uint32_t z = first[2]; status == 0 && z <= last[2]; z++) {
                const uint32_t n = x << 10 | y << 5 | z;
                if (!(words[BK_UPPER_CHILD_MASK + (n >> 6)] >> (n & 63) & 1))
                    continue;
                const uint32_t lower = bake_upper_lower(grid, upper, n);
                const int32_t at[3] = {origin[0] + (int32_t)(x << BK_LOWER_LOG2),
                                       origin[1] + (int32_t)(y << BK_LOWER_LOG2),
                                       origin[2] + (int32_t)(z << BK_LOWER_LOG2)};
                status = lower == BK_NONE ? 0 : visit(arg, upper, lower, at);
            }
    return status;
}

/* Returns the lowest voxel of a root tile along the axis whose key bits begin at `shift`. */
static int32_t tile_origin(uint64_t key, uint32_t shift)
{
    const uint32_t bits = (uint32_t)(key >> shift) & 0xfffff; /* x >> 12 of a 32-bit x */
    return (int32_t)(bits << BK_UPPER_LOG2);
}

int bake_visit_nodes(const struct fmt_nvdb_grid *grid, const int32_t low[3], const int32_t high[3],
                     bake_node_visit *visit, void *arg)
{
    const uint64_t *tiles = (const uint64_t *)(const void *)grid->tiles;
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < grid->tile_count; i++) {
        const uint64_t key = tiles[i * BK_TILE_WORDS], child = tiles[i * BK_TILE_WORDS + 1];
        const int32_t origin[3] = {tile_origin(key, 42), tile_origin(key, 21), tile_origin(key, 0)};
        bool inside = child != 0;
        for (int k = 0; k < 3; k++)
            inside = inside && high[k] >= origin[k] &&
                     low[k] <= (int64_t)origin[k] + (1 << BK_UPPER_LOG2) - 1;
        const uint32_t upper = inside ? bake_tile_upper(grid, child) : BK_NONE;
        if (upper != BK_NONE)
            status = visit_upper(grid, upper, origin, low, high, visit, arg);
    }
    return status;
}

/* ---- adding boxes ---- */

struct box_addition {
    struct bsq_ctx *ctx;
    struct bake_leaf_set *set;
    const int32_t *low, *high;
};

static int add_in_lower(const struct box_addition *box, uint32_t lower, const int32_t origin[3])
{
    struct bake_leaf_set *set = box->set;
    const uint64_t *children = bake_lower_children(set->grid, lower);
    uint32_t first[3], last[3];
    uint64_t *mask;
    int status = find_lower(box->ctx, set, lower, &mask);
    if (status < 0)
        return status;
    for (int k = 0; k < 3; k++)
        child_range(origin[k], box->low[k], box->high[k], BK_LEAF_LOG2, 16, &first[k], &last[k]);
    const uint64_t row = (UINT64_C(2) << last[2]) - (UINT64_C(1) << first[2]);
    for (uint32_t x = first[0]; x <= last[0]; x++)
        for (uint32_t y = first[1]; y <= last[1]; y++) {
            const uint32_t n = x << 8 | y << 4, word = n >> 6;
            const uint64_t added = row << (n & 63) & children[word] & ~mask[word];
            mask[word] |= added;
            count_leaves(set, lower, word, added);
        }
    return 0;
}

static int add_node(void *arg, uint32_t upper, uint32_t lower, const int32_t origin[3])
{
    const struct box_addition *box = arg;
    if (lower != BK_NONE)
        return add_in_lower(box, lower, origin);
    add_upper(box->set, upper);
    return 0;
}

int bake_leaf_set_add_box(struct bsq_ctx *ctx, struct bake_leaf_set *set, const int32_t low[3],
                          const int32_t high[3])
{
    struct box_addition box = {ctx, set, low, high};
    return bake_visit_nodes(set->grid, low, high, add_node, &box);
}

int bake_leaf_set_add(struct bsq_ctx *ctx, struct bake_leaf_set *set,
                      const struct bake_leaf_set *other)
{
    for (uint32_t i = 0; i < set->grid->upper_count; i++)
        if (other->has_upper[i])
            add_upper(set, i);
    for (uint64_t i = 0; i < other->lower_count; i++) {
        uint64_t *mask;
        int status = find_lower(ctx, set, other->lowers[i], &mask);
        if (status < 0)
            return status;
        for (uint32_t w = 0; w < BAKE_MASK_WORDS; w++) {
            const uint64_t added = other->leaf_masks[i][w] & ~mask[w];
            mask[w] |= added;
            count_leaves(set, other->lowers[i], w, added);
        }
    }
    return 0;
}

void bake_leaf_set_preview(const struct bake_leaf_set *set, const struct bake_leaf_set *other,
                           struct bake_leaf_set *counts)
{
    *counts = *set;
    for (uint32_t i = 0; i < set->grid->upper_count; i++)
        counts->upper_count += other->has_upper[i] && !set->has_upper[i];
    for (uint64_t i = 0; i < other->lower_count; i++) {
        const uint32_t lower = other->lowers[i], place = set->place_of_lower[lower];
        counts->lower_count += place == 0;
        for (uint32_t w = 0; w < BAKE_MASK_WORDS; w++)
            count_leaves(counts, lower, w,
                         other->leaf_masks[i][w] & ~(place ? set->leaf_masks[place - 1][w] : 0));
    }
}
