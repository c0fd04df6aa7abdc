/* subgrid_send.c - the arrays of a subgrid, made as they are sent.
 *
 * Nodes are copied with new child tables, leaves with new value offsets, channels leaf by leaf.
 * Children keep their order, so a subgrid is in breadth-first order, as a grid is.
 *
 * If the file changes, its nodes no longer agree with the subgrid's counts. Each array has its size
 * nevertheless: what is too much is cut off, what is missing is zero. */
#include <stdlib.h>
#include <string.h>

#include "libbake/device/subgrid/leaf_set.h"
#include "libbake/kernel/bk_grid.h"
#include "libbake/kernel/bk_srgb.h"

enum { ENTRIES = 512 /* of a child table, sent at a time */ };

struct sending {
    const struct bake_subgrid *subgrid;
    int (*sink)(void *arg, const void *data, uint64_t bytes);
    void *arg;
    uint64_t *left; /* bytes of the array that are still to send */
};

/* Sends bytes of the array, at most those that are left. */
static int put(const struct sending *s, const void *data, uint64_t bytes)
{
    const uint64_t sent = bytes < *s->left ? bytes : *s->left;
    *s->left -= sent;
    return sent > 0 ? s->sink(s->arg, data, sent) : 0;
}

/* Sends zeros for all bytes that are left. */
static int put_zeros(const struct sending *s)
{
    static const uint64_t zeros[ENTRIES];
    int status = 0;
    while (*s->left > 0 && status == 0)
        status = put(s, zeros, sizeof zeros);
    return status;
}

/* Calls fn for each leaf of the subgrid in order. `first`: value index of its first voxel in the
 * subgrid. */
static int for_leaves(const struct sending *s,
                      int (*fn)(const struct sending *s, void *state, uint32_t leaf,
                                uint64_t first),
                      void *state)
{
    const struct bake_subgrid *subgrid = s->subgrid;
    int status = 0;
    for (uint64_t i = 0; i < subgrid->lower_count; i++) {
        uint64_t first = 1 + subgrid->lowers[i].first_voxel;
        for (uint32_t w = 0; w < BAKE_MASK_WORDS; w++)
            for (uint64_t bits = subgrid->leaf_masks[i][w]; bits; bits &= bits - 1) {
                const uint32_t n = w * 64 + (uint32_t)__builtin_ctzll(bits);
                const uint32_t leaf = bake_lower_leaf(subgrid->grid, subgrid->lowers[i].number, n);
                if (leaf == BK_NONE)
                    continue;
                status = fn(s, state, leaf, first);
                if (status != 0)
                    return status;
                first += bake_leaf_voxels(subgrid->grid, leaf);
            }
    }
    return status;
}

static int by_number(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = ((const struct bake_subgrid_lower *)b)->number;
    return (x > y) - (x < y);
}

/* Returns the index of a lower node in the subgrid, or -1. */
static int64_t find_lower(const struct bake_subgrid *subgrid, uint32_t number)
{
    const struct bake_subgrid_lower *found =
        bsearch(&number, subgrid->lowers, subgrid->lower_count, sizeof *subgrid->lowers, by_number);
    return found ? found - subgrid->lowers : -1;
}

static int64_t find_upper(const struct bake_subgrid *subgrid, uint32_t number)
{
    for (uint64_t i = 0; i < subgrid->upper_count; i++)
        if (subgrid->uppers[i] == number)
            return (int64_t)i;
    return -1;
}

static int send_tiles(const struct sending *s)
{
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    const uint64_t distance = (uint64_t)(grid->uppers - grid->root);
    int status = 0;
    for (uint32_t i = 0; i < grid->tile_count && status == 0; i++) {
        uint64_t tile[BK_TILE_WORDS];
        memcpy(tile, grid->tiles + (uint64_t)i * sizeof tile, sizeof tile);
        if (tile[1] != 0) {
            const int64_t place = find_upper(s->subgrid, bake_tile_upper(grid, tile[1]));
            tile[1] = place < 0 ? 0 : distance + (uint64_t)place * BK_UPPER_WORDS * 8;
        }
        status = put(s, tile, sizeof tile);
    }
    return status;
}

/* Sends a child table; `entry` returns the new entry of child n. */
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
    uint32_t number; /* in the grid */
    uint64_t place;  /* in the subgrid */
    const uint64_t *words;
};

/* Returns the index in the subgrid of the lower node that is child n, or -1. */
static int64_t lower_child(const struct sending *s, const struct upper_node *node, uint32_t n)
{
    if (!(node->words[BK_UPPER_CHILD_MASK + (n >> 6)] >> (n & 63) & 1))
        return -1;
    return find_lower(s->subgrid, bake_upper_lower(s->subgrid->grid, node->number, n));
}

static uint64_t upper_entry(const struct sending *s, const void *state, uint32_t n)
{
    const struct upper_node *node = state;
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    const int64_t place = lower_child(s, node, n);
    return place < 0
               ? 0
               : (uint64_t)place * BK_LOWER_WORDS * 8 + (uint64_t)(grid->lowers - grid->uppers) -
                     node->place * BK_UPPER_WORDS * 8;
}

static int send_uppers(const struct sending *s)
{
    const struct bake_subgrid *subgrid = s->subgrid;
    int status = 0;
    for (uint64_t i = 0; i < subgrid->upper_count && status == 0; i++) {
        const uint8_t *bytes =
            subgrid->grid->uppers + (uint64_t)subgrid->uppers[i] * BK_UPPER_WORDS * 8;
        const struct upper_node node = {subgrid->uppers[i], i,
                                        (const uint64_t *)(const void *)bytes};
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
    uint64_t place, next_leaf; /* indices in the subgrid */
    const uint64_t *leaf_mask;
};

/* Must be called for n in ascending order. */
static uint64_t lower_entry(const struct sending *s, const void *state, uint32_t n)
{
    struct lower_node *node = (struct lower_node *)(uintptr_t)state;
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    if (!(node->leaf_mask[n >> 6] >> (n & 63) & 1))
        return 0;
    return node->next_leaf++ * BK_LEAF_WORDS * 8 + (uint64_t)(grid->leaves - grid->lowers) -
           node->place * BK_LOWER_WORDS * 8;
}

static int send_lowers(const struct sending *s)
{
    const struct bake_subgrid *subgrid = s->subgrid;
    int status = 0;
    for (uint64_t i = 0; i < subgrid->lower_count && status == 0; i++) {
        const struct bake_subgrid_lower *lower = &subgrid->lowers[i];
        struct lower_node node = {i, lower->first_leaf, subgrid->leaf_masks[i]};
        uint64_t head[BK_LOWER_TABLE];
        memcpy(head, subgrid->grid->lowers + (uint64_t)lower->number * BK_LOWER_WORDS * 8,
               sizeof head);
        memcpy(head + BK_LOWER_CHILD_MASK, subgrid->leaf_masks[i], sizeof *subgrid->leaf_masks);
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
    memcpy(words, s->subgrid->grid->leaves + (uint64_t)leaf * sizeof words, sizeof words);
    words[BK_LEAF_OFFSET] = first;
    return put(s, words, sizeof words);
}

/* The value indices of a leaf's voxels, all in the grid. */
struct values {
    uint64_t first, count;
};

static struct values values_of(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    const uint64_t first = bake_leaf_first(grid, leaf), most = grid->voxel_count + 1 - first;
    const uint64_t count = bake_leaf_voxels(grid, leaf);
    return (struct values){first, count < most ? count : most};
}

/* An array of records. */
struct records {
    const uint32_t *first; /* NULL: there is none */
    uint64_t words;        /* of a record */
};

static int put_records(const struct sending *s, const struct records *records, uint64_t begin,
                       uint64_t count)
{
    return put(s, records->first + begin * records->words,
               count * records->words * sizeof *records->first);
}

static int send_values(const struct sending *s, void *records, uint32_t leaf, uint64_t first)
{
    const struct values values = values_of(s->subgrid->grid, leaf);
    (void)first;
    return put_records(s, records, values.first, values.count);
}

/* Sends the second records of a leaf, which are contiguous, as its voxels are. */
static int send_second_values(const struct sending *s, void *records, uint32_t leaf,
                              uint64_t first_in_subgrid)
{
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    const struct values values = values_of(grid, leaf);
    const uint64_t begin = bake_seconds_below(grid, values.first);
    const uint64_t end = bake_seconds_below(grid, values.first + values.count);
    (void)first_in_subgrid;
    return end > begin ? put_records(s, records, grid->voxel_count + 1 + begin, end - begin) : 0;
}

/* Sends the records of the subgrid's voxels: the background, first and second records. */
static int send_records(const struct sending *s, const void *first, uint64_t words)
{
    struct records records = {first, words};
    if (!first)
        return 0;
    if (s->subgrid->whole)
        return put_records(s, &records, 0, s->subgrid->grid->record_count);
    int status = put_records(s, &records, 0, 1);
    if (status == 0)
        status = for_leaves(s, send_values, &records);
    if (status == 0)
        status = for_leaves(s, send_second_values, &records);
    return status;
}

/* `channel` may be NULL: there is none. */
static int send_channel(const struct sending *s, const uint32_t *channel)
{
    return send_records(s, channel, 1);
}

/* The pair (mask and prefix sum) of 32 value indices that is being filled. */
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
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    struct second_bits *bits = state;
    const struct values values = values_of(grid, leaf);
    const uint64_t old = values.first;
    int status = 0;
    if (bake_seconds_below(grid, old) == bake_seconds_below(grid, old + values.count))
        return 0;
    for (uint64_t i = 0; i < values.count && status == 0; i++) {
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
    return status ? status : send_pairs_until(s, &bits, s->subgrid->voxel_count / 32 + 1);
}

/* Sends the array of colours, which begins with the kernel's table of sRGB codes and the words of
 * transfer maps. Ids and channels follow. */
static int send_colors(const struct sending *s)
{
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    int status = put(s, bk_srgb, sizeof bk_srgb);
    if (status == 0 && grid->transfer_count > 0)
        status = put(s, grid->transfers, grid->transfer_count * sizeof *grid->transfers);
    if (status == 0)
        status = send_channel(s, grid->colors);
    if (status == 0)
        status = send_channel(s, grid->ids);
    return status ? status : send_records(s, grid->channels, grid->channel_words);
}

static int send_whole(const struct sending *s, int array)
{
    const struct fmt_nvdb_grid *g = s->subgrid->grid;
    const void *data[BAKE_SUBGRID_ARRAYS] = {g->tiles,   g->uppers, g->lowers, g->leaves,
                                             g->normals, g->planes, NULL,      g->seconds};
    return array == BAKE_COLORS ? send_colors(s) : put(s, data[array], *s->left);
}

static int send_part(const struct sending *s, int array)
{
    switch (array) {
    case BAKE_TILES:
        return send_tiles(s);
    case BAKE_UPPERS:
        return send_uppers(s);
    case BAKE_LOWERS:
        return send_lowers(s);
    case BAKE_LEAVES:
        return for_leaves(s, send_leaf, NULL);
    case BAKE_NORMALS:
        return send_channel(s, s->subgrid->grid->normals);
    case BAKE_PLANES:
        return send_channel(s, s->subgrid->grid->planes);
    case BAKE_COLORS:
        return send_colors(s);
    default:
        return send_seconds(s);
    }
}

int bake_subgrid_send(const struct bake_subgrid *subgrid, int array,
                      int (*sink)(void *arg, const void *data, uint64_t bytes), void *arg)
{
    uint64_t left = subgrid->bytes[array];
    const struct sending s = {subgrid, sink, arg, &left};
    int status = 0;
    if (left > 0)
        status = subgrid->whole ? send_whole(&s, array) : send_part(&s, array);
    return status ? status : put_zeros(&s);
}
