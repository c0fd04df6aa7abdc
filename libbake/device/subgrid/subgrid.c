/* subgrid.c - nodes are copied with new child tables, leaves with new value offsets, channels leaf
 * by leaf. Children keep their order, so a part is in breadth-first order as a grid is. */
#include "libbake/device/subgrid/subgrid.h"

#include <stdlib.h>
#include <string.h>

#include "libbake/device/device.h"
#include "libbake/kernel/bk_grid.h"

enum { ROOT_TILE_BYTES = BK_TILE_WORDS * 8, ENTRIES = 512 /* of a table at a time */ };

const char *bake_part_array_name(int array)
{
    static const char *const names[BAKE_PART_ARRAYS] = {
        "root tiles", "upper nodes", "lower nodes", "leaves",
        "normals",    "planes",      "colors",      "second records"};
    return names[array];
}

void bake_part_sizes(const struct fmt_nvdb_grid *grid, const struct bake_leaf_set *counts,
                     uint64_t bytes[BAKE_PART_ARRAYS])
{
    const uint64_t channel = (1 + counts->voxel_count + counts->second_count) * sizeof(uint32_t);
    bytes[BAKE_TILES] = (uint64_t)grid->tile_count * ROOT_TILE_BYTES;
    bytes[BAKE_UPPERS] = counts->upper_count * BK_UPPER_WORDS * 8;
    bytes[BAKE_LOWERS] = counts->lower_count * BK_LOWER_WORDS * 8;
    bytes[BAKE_LEAVES] = counts->leaf_count * BK_LEAF_WORDS * 8;
    bytes[BAKE_NORMALS] = bytes[BAKE_PLANES] = channel;
    bytes[BAKE_COLORS] = grid->colors ? channel : 0;
    bytes[BAKE_SECONDS] = (counts->voxel_count / 32 + 1) * 8;
}

void bake_part_whole(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                     struct bake_part *out)
{
    const struct bake_leaf_set all = {.upper_count = grid->upper_count,
                                      .lower_count = grid->lower_count,
                                      .leaf_count = grid->leaf_count,
                                      .voxel_count = grid->voxel_count,
                                      .second_count = grid->record_count - 1 - grid->voxel_count};
    *out = (struct bake_part){.grid = grid, .whole = true, .params = *params};
    bake_part_sizes(grid, &all, out->bytes);
}

static int by_number(const void *a, const void *b)
{
    const uint32_t x = ((const struct bake_part_lower *)a)->number;
    const uint32_t y = ((const struct bake_part_lower *)b)->number;
    return (x > y) - (x < y);
}

static void copy_nodes(const struct bake_leaf_set *set, struct bake_part *part)
{
    uint64_t leaves = 0, voxels = 0;
    for (uint32_t i = 0, n = 0; i < set->grid->upper_count; i++)
        if (set->has_upper[i])
            part->uppers[n++] = i;
    for (uint64_t i = 0; i < set->lower_count; i++)
        part->lowers[i].number = set->lowers[i];
    qsort(part->lowers, set->lower_count, sizeof *part->lowers, by_number);
    for (uint64_t i = 0; i < set->lower_count; i++) {
        struct bake_part_lower *lower = &part->lowers[i];
        const uint32_t place = set->place_of_lower[lower->number] - 1;
        memcpy(part->marks[i], set->marks[place], sizeof *part->marks);
        lower->first_leaf = leaves;
        lower->first_voxel = voxels;
        for (uint32_t n = 0; n < 64 * BAKE_MARK_WORDS; n++)
            if (part->marks[i][n >> 6] >> (n & 63) & 1) {
                leaves++;
                voxels += bake_leaf_voxels(set->grid, bake_lower_leaf(set->grid, lower->number, n));
            }
    }
}

int bake_part_create(struct bsq_ctx *ctx, const struct bake_leaf_set *set,
                     const struct bk_params *params, struct bake_part *out)
{
    *out = (struct bake_part){.grid = set->grid,
                              .upper_count = set->upper_count,
                              .lower_count = set->lower_count,
                              .leaf_count = set->leaf_count,
                              .voxel_count = set->voxel_count,
                              .second_count = set->second_count,
                              .params = *params};
    const uint64_t second_base = set->voxel_count + 1;
    out->params.upper_count = (bk_uint)set->upper_count;
    out->params.lower_count = (bk_uint)set->lower_count;
    out->params.leaf_count = (bk_uint)set->leaf_count;
    out->params.second_base_low = (bk_uint)second_base;
    out->params.second_base_high = (bk_uint)(second_base >> 32);
    bake_part_sizes(set->grid, set, out->bytes);
    int status = bsq_alloc(ctx, "upper nodes of a pass", set->upper_count + 1, sizeof *out->uppers,
                           &out->uppers);
    if (status == 0)
        status = bsq_alloc(ctx, "lower nodes of a pass", set->lower_count + 1, sizeof *out->lowers,
                           &out->lowers);
    if (status == 0)
        status = bsq_alloc(ctx, "leaves of a pass", set->lower_count + 1, sizeof *out->marks,
                           &out->marks);
    if (status == 0)
        copy_nodes(set, out);
    return status;
}

void bake_part_free(struct bsq_ctx *ctx, struct bake_part *part)
{
    bsq_free(ctx, part->uppers);
    bsq_free(ctx, part->lowers);
    bsq_free(ctx, part->marks);
    *part = (struct bake_part){0};
}

/* ---- sending ---- */

struct sending {
    const struct bake_part *part;
    int (*sink)(void *arg, const void *data, uint64_t bytes);
    void *arg;
};

static int put(const struct sending *s, const void *data, uint64_t bytes)
{
    return s->sink(s->arg, data, bytes);
}

/* Calls fn for each leaf of the part in order; `first`: the part's value index of its first voxel.
 */
static int for_leaves(const struct sending *s,
                      int (*fn)(const struct sending *s, void *state, uint32_t leaf,
                                uint64_t first),
                      void *state)
{
    const struct bake_part *part = s->part;
    int status = 0;
    for (uint64_t i = 0; i < part->lower_count; i++) {
        uint64_t first = 1 + part->lowers[i].first_voxel;
        for (uint32_t w = 0; w < BAKE_MARK_WORDS; w++)
            for (uint64_t bits = part->marks[i][w]; bits; bits &= bits - 1) {
                const uint32_t n = w * 64 + (uint32_t)__builtin_ctzll(bits);
                const uint32_t leaf = bake_lower_leaf(part->grid, part->lowers[i].number, n);
                status = fn(s, state, leaf, first);
                if (status != 0)
                    return status;
                first += bake_leaf_voxels(part->grid, leaf);
            }
    }
    return status;
}

/* Place of a node's number in the part, or -1. */
static int64_t find_lower(const struct bake_part *part, uint32_t number)
{
    const struct bake_part_lower key = {.number = number};
    const struct bake_part_lower *found =
        bsearch(&key, part->lowers, part->lower_count, sizeof key, by_number);
    return found ? found - part->lowers : -1;
}

static int64_t find_upper(const struct bake_part *part, uint32_t number)
{
    for (uint64_t i = 0; i < part->upper_count; i++)
        if (part->uppers[i] == number)
            return (int64_t)i;
    return -1;
}

static int send_tiles(const struct sending *s)
{
    const struct fmt_nvdb_grid *grid = s->part->grid;
    const uint64_t distance = (uint64_t)(grid->uppers - grid->root);
    int status = 0;
    for (uint32_t i = 0; i < grid->tile_count && status == 0; i++) {
        uint64_t tile[BK_TILE_WORDS];
        memcpy(tile, grid->tiles + (uint64_t)i * sizeof tile, sizeof tile);
        if (tile[1] != 0) {
            const uint64_t upper = (tile[1] - distance) / (BK_UPPER_WORDS * 8);
            const int64_t place = find_upper(s->part, (uint32_t)upper);
            tile[1] = place < 0 ? 0 : distance + (uint64_t)place * BK_UPPER_WORDS * 8;
        }
        status = put(s, tile, sizeof tile);
    }
    return status;
}

/* Sends a table's entries; `entry` gives the new one of child n. */
static int send_table(const struct sending *s, uint32_t count, const void *node,
                      uint64_t (*entry)(const struct sending *s, const void *node, uint32_t n))
{
    uint64_t entries[ENTRIES];
    int status = 0;
    for (uint32_t n = 0; n < count && status == 0; n += ENTRIES) {
        for (uint32_t i = 0; i < ENTRIES; i++)
            entries[i] = entry(s, node, n + i);
        status = put(s, entries, sizeof entries);
    }
    return status;
}

struct upper_node {
    uint64_t number, place; /* in the grid, in the part */
    const uint64_t *words;
};

/* Place in the part of the lower node that is child n, -1 where there is none. */
static int64_t lower_child(const struct sending *s, const struct upper_node *node, uint32_t n)
{
    const struct fmt_nvdb_grid *grid = s->part->grid;
    const uint64_t distance = (uint64_t)(grid->lowers - grid->uppers);
    if (!(node->words[BK_UPPER_CHILD_MASK + (n >> 6)] >> (n & 63) & 1))
        return -1;
    const uint64_t child =
        node->number * BK_UPPER_WORDS * 8 + node->words[BK_UPPER_TABLE + n] - distance;
    return find_lower(s->part, (uint32_t)(child / (BK_LOWER_WORDS * 8)));
}

static uint64_t upper_entry(const struct sending *s, const void *state, uint32_t n)
{
    const struct upper_node *node = state;
    const struct fmt_nvdb_grid *grid = s->part->grid;
    const int64_t place = lower_child(s, node, n);
    return place < 0
               ? 0
               : (uint64_t)place * BK_LOWER_WORDS * 8 + (uint64_t)(grid->lowers - grid->uppers) -
                     node->place * BK_UPPER_WORDS * 8;
}

static int send_uppers(const struct sending *s)
{
    const struct bake_part *part = s->part;
    int status = 0;
    for (uint64_t i = 0; i < part->upper_count && status == 0; i++) {
        const uint8_t *bytes = part->grid->uppers + (uint64_t)part->uppers[i] * BK_UPPER_WORDS * 8;
        const struct upper_node node = {part->uppers[i], i, (const uint64_t *)(const void *)bytes};
        uint64_t head[BK_UPPER_TABLE];
        memcpy(head, bytes, sizeof head);
        for (uint32_t n = 0; n < 32 * 32 * 32; n++)
            if (lower_child(s, &node, n) < 0)
                head[BK_UPPER_CHILD_MASK + (n >> 6)] &= ~(UINT64_C(1) << (n & 63));
        status = put(s, head, sizeof head);
        if (status == 0)
            status = send_table(s, 32 * 32 * 32, &node, upper_entry);
    }
    return status;
}

struct lower_node {
    uint64_t place, next_leaf; /* in the part */
    const uint64_t *marks;
};

/* Entries are asked for in order. */
static uint64_t lower_entry(const struct sending *s, const void *state, uint32_t n)
{
    struct lower_node *node = (struct lower_node *)(uintptr_t)state;
    const struct fmt_nvdb_grid *grid = s->part->grid;
    if (!(node->marks[n >> 6] >> (n & 63) & 1))
        return 0;
    return node->next_leaf++ * BK_LEAF_WORDS * 8 + (uint64_t)(grid->leaves - grid->lowers) -
           node->place * BK_LOWER_WORDS * 8;
}

static int send_lowers(const struct sending *s)
{
    const struct bake_part *part = s->part;
    int status = 0;
    for (uint64_t i = 0; i < part->lower_count && status == 0; i++) {
        const struct bake_part_lower *lower = &part->lowers[i];
        struct lower_node node = {i, lower->first_leaf, part->marks[i]};
        uint64_t head[BK_LOWER_TABLE];
        memcpy(head, part->grid->lowers + (uint64_t)lower->number * BK_LOWER_WORDS * 8,
               sizeof head);
        memcpy(head + BK_LOWER_CHILD_MASK, part->marks[i], sizeof *part->marks);
        status = put(s, head, sizeof head);
        if (status == 0)
            status = send_table(s, 16 * 16 * 16, &node, lower_entry);
    }
    return status;
}

static int send_leaf(const struct sending *s, void *state, uint32_t leaf, uint64_t first)
{
    uint64_t words[BK_LEAF_WORDS];
    (void)state;
    memcpy(words, s->part->grid->leaves + (uint64_t)leaf * sizeof words, sizeof words);
    words[BK_LEAF_OFFSET] = first;
    return put(s, words, sizeof words);
}

static int send_values(const struct sending *s, void *channel, uint32_t leaf, uint64_t first)
{
    const uint32_t *values = channel;
    (void)first;
    return put(s, values + bake_leaf_first(s->part->grid, leaf),
               bake_leaf_voxels(s->part->grid, leaf) * sizeof *values);
}

/* A leaf's second records are one run, as its voxels are. */
static int send_second_values(const struct sending *s, void *channel, uint32_t leaf,
                              uint64_t first_in_part)
{
    const struct fmt_nvdb_grid *grid = s->part->grid;
    const uint32_t *seconds = (const uint32_t *)channel + grid->voxel_count + 1;
    const uint64_t first = bake_leaf_first(grid, leaf);
    const uint64_t begin = bake_seconds_below(grid, first);
    const uint64_t end = bake_seconds_below(grid, first + bake_leaf_voxels(grid, leaf));
    (void)first_in_part;
    return end > begin ? put(s, seconds + begin, (end - begin) * sizeof *seconds) : 0;
}

static int send_channel(const struct sending *s, const uint32_t *channel)
{
    int status = put(s, channel, sizeof *channel);
    if (status == 0)
        status = for_leaves(s, send_values, (void *)(uintptr_t)channel);
    if (status == 0)
        status = for_leaves(s, send_second_values, (void *)(uintptr_t)channel);
    return status;
}

/* The pair of 32 value indices that is being filled. */
struct second_bits {
    uint64_t index;
    uint32_t pair[2];
};

static int send_pairs_until(const struct sending *s, struct second_bits *bits, uint64_t index)
{
    int status = 0;
    for (; bits->index < index && status == 0; bits->index++) {
        status = put(s, bits->pair, sizeof bits->pair);
        bits->pair[1] += (uint32_t)__builtin_popcount(bits->pair[0]);
        bits->pair[0] = 0;
    }
    return status;
}

static int send_second_bits(const struct sending *s, void *state, uint32_t leaf, uint64_t first)
{
    const struct fmt_nvdb_grid *grid = s->part->grid;
    struct second_bits *bits = state;
    const uint64_t old = bake_leaf_first(grid, leaf), voxels = bake_leaf_voxels(grid, leaf);
    int status = 0;
    if (bake_seconds_below(grid, old) == bake_seconds_below(grid, old + voxels))
        return 0;
    for (uint64_t i = 0; i < voxels && status == 0; i++) {
        if (!(grid->seconds[(old + i) >> 5][0] >> ((old + i) & 31) & 1))
            continue;
        status = send_pairs_until(s, bits, (first + i) >> 5);
        bits->pair[0] |= UINT32_C(1) << ((first + i) & 31);
    }
    return status;
}

static int send_seconds(const struct sending *s)
{
    struct second_bits bits = {0};
    int status = for_leaves(s, send_second_bits, &bits);
    return status ? status : send_pairs_until(s, &bits, s->part->voxel_count / 32 + 1);
}

static int send_whole(const struct sending *s, int array)
{
    const struct fmt_nvdb_grid *g = s->part->grid;
    const void *data[BAKE_PART_ARRAYS] = {g->tiles,   g->uppers, g->lowers, g->leaves,
                                          g->normals, g->planes, g->colors, g->seconds};
    return put(s, data[array], s->part->bytes[array]);
}

int bake_part_send(const struct bake_part *part, int array,
                   int (*sink)(void *arg, const void *data, uint64_t bytes), void *arg)
{
    const struct sending s = {part, sink, arg};
    if (part->bytes[array] == 0)
        return 0;
    if (part->whole)
        return send_whole(&s, array);
    switch (array) {
    case BAKE_TILES:
        return send_tiles(&s);
    case BAKE_UPPERS:
        return send_uppers(&s);
    case BAKE_LOWERS:
        return send_lowers(&s);
    case BAKE_LEAVES:
        return for_leaves(&s, send_leaf, NULL);
    case BAKE_NORMALS:
        return send_channel(&s, part->grid->normals);
    case BAKE_PLANES:
        return send_channel(&s, part->grid->planes);
    case BAKE_COLORS:
        return send_channel(&s, part->grid->colors);
    default:
        return send_seconds(&s);
    }
}
