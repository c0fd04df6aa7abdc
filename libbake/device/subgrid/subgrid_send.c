/* subgrid_send.c - the arrays of a subgrid, made as they are sent.
 *
 * Nodes are copied with new offsets of their children, leaves with new value offsets, and records
 * run by run. Children keep their order, so a subgrid is in breadth-first order, as a grid is.
 *
 * If the file changes, its nodes no longer agree with the subgrid's ranges. Each array has its size
 * nevertheless: what is too much is cut off, what is missing is zero. */
#include <stdlib.h>
#include <string.h>

#include "libbake/device/subgrid/subgrid.h"
#include "libbake/kernel/bk_grid.h"
#include "libbake/kernel/bk_srgb.h"

enum {
    ENTRIES = 512, /* words of a child table, sent at a time */
    LEAVES = 64,   /* likewise */
    WORD_BITS = 32
};

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

static int put_zeros(const struct sending *s, uint64_t bytes)
{
    static const uint64_t zeros[ENTRIES];
    int status = 0;
    while (bytes > 0 && *s->left > 0 && status == 0) {
        const uint64_t part = bytes < sizeof zeros ? bytes : sizeof zeros;
        status = put(s, zeros, part);
        bytes -= part;
    }
    return status;
}

/* ---- nodes ---- */

static int by_number(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = ((const struct bake_subgrid_lower *)b)->number;
    return (x > y) - (x < y);
}

/* Returns the new offset of a child of an upper node, or 0 if the subgrid has no such node. */
static uint64_t upper_entry(const struct bake_subgrid *subgrid, uint32_t upper, uint32_t n)
{
    const struct fmt_nvdb_grid *grid = subgrid->grid;
    const uint32_t lower = bake_upper_lower(grid, upper, n);
    const struct bake_subgrid_lower *found =
        lower == BK_NONE ? NULL
                         : bsearch(&lower, subgrid->lowers, subgrid->counts.lowers,
                                   sizeof *subgrid->lowers, by_number);
    return found
               ? (uint64_t)(found - subgrid->lowers) * BK_LOWER_WORDS * 8 +
                     (uint64_t)(grid->lowers - grid->uppers) - (uint64_t)upper * BK_UPPER_WORDS * 8
               : 0;
}

/* Sends an upper node. Its mask of children comes before its table. */
static int send_upper(const struct sending *s, uint32_t upper)
{
    uint64_t head[BK_UPPER_TABLE], entries[ENTRIES];
    int status;
    memcpy(head, s->subgrid->grid->uppers + (uint64_t)upper * BK_UPPER_WORDS * 8, sizeof head);
    for (uint32_t n = 0; n < 32 * 32 * 32; n++)
        if (upper_entry(s->subgrid, upper, n) == 0)
            head[BK_UPPER_CHILD_MASK + (n >> 6)] &= ~(UINT64_C(1) << (n & 63));
    BSQ_TRY(put(s, head, sizeof head));
    for (uint32_t n = 0; n < 32 * 32 * 32; n += ENTRIES) {
        for (uint32_t i = 0; i < ENTRIES; i++)
            entries[i] = upper_entry(s->subgrid, upper, n + i);
        BSQ_TRY(put(s, entries, sizeof entries));
    }
done:
    return status;
}

static int send_uppers(const struct sending *s)
{
    int status = 0;
    for (uint32_t i = 0; i < s->subgrid->grid->upper_count && status == 0; i++)
        status = send_upper(s, i);
    return status;
}

/* Sends lower nodes. All children of one move by the same distance. */
static int send_lowers(const struct sending *s)
{
    const struct bake_subgrid *subgrid = s->subgrid;
    uint64_t leaf = 0;
    int status = 0;
    for (uint64_t i = 0; i < subgrid->counts.lowers; i++) {
        const struct bake_subgrid_lower *lower = &subgrid->lowers[i];
        const uint64_t *words = (const uint64_t *)(const void *)subgrid->grid->lowers +
                                (uint64_t)lower->number * BK_LOWER_WORDS;
        const uint64_t moved = (leaf - lower->first_leaf) * BK_LEAF_WORDS * 8 -
                               (i - lower->number) * BK_LOWER_WORDS * 8;
        uint64_t entries[ENTRIES];
        BSQ_TRY(put(s, words, BK_LOWER_TABLE * sizeof *words));
        for (uint32_t n = BK_LOWER_TABLE; n < BK_LOWER_WORDS; n += ENTRIES) {
            for (uint32_t k = 0; k < ENTRIES; k++)
                entries[k] = words[n + k] + moved;
            BSQ_TRY(put(s, entries, sizeof entries));
        }
        leaf += lower->leaf_count;
    }
done:
    return status;
}
_Static_assert((BK_LOWER_WORDS - BK_LOWER_TABLE) % ENTRIES == 0, "tables are sent in whole parts");

static int send_leaves(const struct sending *s)
{
    uint64_t words[LEAVES][BK_LEAF_WORDS];
    int status = 0;
    for (uint64_t i = 0; i < s->subgrid->counts.lowers; i++) {
        const struct bake_subgrid_lower *lower = &s->subgrid->lowers[i];
        for (uint32_t n = 0; n < lower->leaf_count; n += LEAVES) {
            const uint32_t left = lower->leaf_count - n, count = left < LEAVES ? left : LEAVES;
            memcpy(words,
                   s->subgrid->grid->leaves + ((uint64_t)lower->first_leaf + n) * sizeof *words,
                   count * sizeof *words);
            for (uint32_t k = 0; k < count; k++)
                words[k][BK_LEAF_OFFSET] += lower->shift;
            BSQ_TRY(put(s, words, count * sizeof *words));
        }
    }
done:
    return status;
}

/* ---- records ---- */

/* Sends an array of records of `words` words each: first records, then second ones. */
static int send_records(const struct sending *s, const void *records, uint64_t words)
{
    const struct bake_subgrid *subgrid = s->subgrid;
    const uint64_t bytes = words * sizeof(uint32_t);
    uint64_t sent = 0;
    int status = 0;
    if (!records)
        return 0;
    if (subgrid->whole)
        return put(s, records, subgrid->grid->record_count * bytes);
    for (uint64_t i = 0; i < subgrid->run_count; i++) {
        const struct bake_value_run *run = &subgrid->runs[i];
        BSQ_TRY(put_zeros(s, (run->to - sent) * bytes));
        BSQ_TRY(put(s, (const char *)records + run->first * bytes, run->count * bytes));
        sent = run->to + run->count;
    }
    for (uint64_t i = 0; i < subgrid->run_count; i++) {
        const struct bake_value_run *run = &subgrid->runs[i];
        const uint64_t first = subgrid->grid->voxel_count + 1 + run->first_second;
        BSQ_TRY(put(s, (const char *)records + first * bytes, run->second_count * bytes));
    }
done:
    return status;
}

/* Sends the pairs (mask and prefix sum) of 32 value indices each. Runs begin at the bit that they
 * have in the grid, and share no word, so that masks keep their bits. */
static int send_seconds(const struct sending *s)
{
    uint32_t before = 0;
    int status = 0;
    for (uint64_t i = 0; i < s->subgrid->run_count; i++) {
        const struct bake_value_run *run = &s->subgrid->runs[i];
        const uint64_t end = run->first + run->count;
        for (uint64_t v = run->first; v < end; v = (v / WORD_BITS + 1) * WORD_BITS) {
            const uint64_t word = v / WORD_BITS * WORD_BITS, left = end - word;
            const uint64_t bits = left < WORD_BITS ? (UINT64_C(1) << left) - 1 : UINT32_MAX;
            const uint64_t skipped = (UINT64_C(1) << (v - word)) - 1;
            const uint32_t mask =
                s->subgrid->grid->seconds[v / WORD_BITS][0] & (uint32_t)(bits & ~skipped);
            BSQ_TRY(put(s, (const uint32_t[2]){mask, before}, 2 * sizeof mask));
            before += (uint32_t)__builtin_popcount(mask);
        }
    }
done:
    return status;
}

/* Sends the array of colours, which begins with the kernel's table of sRGB codes and the words of
 * transfer maps. Ids and channels follow. */
static int send_colors(const struct sending *s)
{
    const struct fmt_nvdb_grid *grid = s->subgrid->grid;
    int status;
    BSQ_TRY(put(s, bk_srgb, sizeof bk_srgb));
    if (grid->transfer_count > 0)
        BSQ_TRY(put(s, grid->transfers, grid->transfer_count * sizeof *grid->transfers));
    BSQ_TRY(send_records(s, grid->colors, 1));
    BSQ_TRY(send_records(s, grid->ids, 1));
    BSQ_TRY(send_records(s, grid->channels, grid->channel_words));
done:
    return status;
}

static int send_array(const struct sending *s, int array)
{
    const struct fmt_nvdb_grid *g = s->subgrid->grid;
    const void *whole[BAKE_SUBGRID_ARRAYS] = {g->tiles,   g->uppers, g->lowers, g->leaves,
                                              g->normals, g->planes, NULL,      g->seconds};
    if (array == BAKE_COLORS)
        return send_colors(s);
    if (s->subgrid->whole || array == BAKE_TILES)
        return put(s, whole[array], *s->left);
    switch (array) {
    case BAKE_UPPERS:
        return send_uppers(s);
    case BAKE_LOWERS:
        return send_lowers(s);
    case BAKE_LEAVES:
        return send_leaves(s);
    case BAKE_SECONDS:
        return send_seconds(s);
    default:
        return send_records(s, whole[array], 1);
    }
}

int bake_subgrid_send(const struct bake_subgrid *subgrid, int array,
                      int (*sink)(void *arg, const void *data, uint64_t bytes), void *arg)
{
    uint64_t left = subgrid->bytes[array];
    const struct sending s = {subgrid, sink, arg, &left};
    const int status = left > 0 ? send_array(&s, array) : 0;
    return status ? status : put_zeros(&s, left);
}
