/* subgrid.c - sets of lower nodes, and the sizes and numbers of the subgrids made of them, and
 * their arrays, made as they are sent.
 *
 * Grid files store leaves and values in the order of the lower nodes. So the leaves and the values
 * of a lower node are ranges, and those of neighbours are one range. If the file changes, its nodes
 * no longer agree with these ranges; all ranges lie in the file's arrays nevertheless. */
#include "libbake/device/subgrid/subgrid.h"

#include <stdlib.h>
#include <string.h>

#include "base/sort_array.h"
#include "libbake/kernel/bk_grid.h"
#include "libbake/kernel/bk_srgb.h"

/* Runs of values begin at their old place in a word of 32 bits, see send_seconds(). */
enum { WORD_BITS = 32 };

const char *bake_subgrid_array_name(int array)
{
    static const char *const names[BAKE_SUBGRID_ARRAYS] = {
        "root tiles", "upper nodes", "lower nodes", "leaves",
        "normals",    "planes",      "colors",      "second records"};
    return names[array];
}

uint64_t bake_subgrid_total(const uint64_t bytes[BAKE_SUBGRID_ARRAYS], uint64_t *largest)
{
    uint64_t total = 0;
    *largest = 0;
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++) {
        total += bytes[i];
        *largest = bytes[i] > *largest ? bytes[i] : *largest;
    }
    return total;
}

/* ---- sets ---- */

int bake_lower_set_create(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                          struct bake_lower_set *out)
{
    *out = (struct bake_lower_set){.grid = grid};
    return bsq_calloc(ctx, "lower nodes of a pass", grid->lower_count, 1, &out->has);
}

void bake_lower_set_free(struct bsq_ctx *ctx, struct bake_lower_set *set)
{
    bsq_free(ctx, set->has);
    bsq_free(ctx, set->lowers);
    *set = (struct bake_lower_set){0};
}

void bake_lower_set_clear(struct bake_lower_set *set)
{
    while (set->count > 0)
        set->has[set->lowers[--set->count]] = 0;
}

int bake_lower_set_add(struct bsq_ctx *ctx, struct bake_lower_set *set, uint32_t lower)
{
    if (set->has[lower])
        return 0;
    int status = bsq_grow(ctx, "lower nodes of a pass", set->count + 1, sizeof *set->lowers,
                          &set->lowers, &set->capacity);
    if (status < 0)
        return status;
    set->has[lower] = 1;
    set->lowers[set->count++] = lower;
    return 0;
}

/* ---- ranges of the grid ---- */

/* Leaves and values of a lower node. */
struct range {
    uint32_t first_leaf, leaf_count;
    uint64_t first_value, value_count;
};

static const uint64_t *leaf_words(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    return (const uint64_t *)(const void *)grid->leaves + (uint64_t)leaf * BK_LEAF_WORDS;
}

/* Returns the value index of a leaf's first voxel, at most voxel_count. */
static uint64_t first_value(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    const uint64_t first = leaf_words(grid, leaf)[BK_LEAF_OFFSET];
    return first <= grid->voxel_count ? first : grid->voxel_count;
}

/* Returns the value index after a leaf's last voxel, at most voxel_count + 1. */
static uint64_t end_value(const struct fmt_nvdb_grid *grid, uint32_t leaf)
{
    const uint64_t *words = leaf_words(grid, leaf);
    uint64_t end = first_value(grid, leaf);
    for (uint32_t i = 0; i < 8; i++)
        end += (uint32_t)__builtin_popcountll(words[BK_LEAF_MASK + i]);
    return end <= grid->voxel_count ? end : grid->voxel_count + 1;
}

static struct range range_of(const struct fmt_nvdb_grid *grid, uint32_t lower)
{
    const uint64_t *mask = bake_lower_children(grid, lower);
    uint32_t first = BK_NONE, last = BK_NONE;
    for (uint32_t w = 0; w < BAKE_MASK_WORDS; w++) {
        const uint64_t bits = mask[w];
        if (bits && first == BK_NONE)
            first = bake_lower_leaf(grid, lower, 64 * w + (uint32_t)__builtin_ctzll(bits));
        if (bits)
            last = bake_lower_leaf(grid, lower, 64 * w + 63 - (uint32_t)__builtin_clzll(bits));
    }
    if (first > last || last == BK_NONE)
        return (struct range){0};
    const uint64_t begin = first_value(grid, first), end = end_value(grid, last);
    return (struct range){first, last - first + 1, begin, end > begin ? end - begin : 0};
}

/* Returns how many voxels with a value index below v have a second record. */
static uint64_t seconds_below(const struct fmt_nvdb_grid *grid, uint64_t v)
{
    const uint64_t all = grid->record_count - 1 - grid->voxel_count;
    if (v > grid->voxel_count)
        return all;
    const uint32_t *pair = grid->seconds[v / WORD_BITS];
    const uint32_t below = pair[0] & (uint32_t)((UINT64_C(1) << v % WORD_BITS) - 1);
    const uint64_t count = (uint64_t)pair[1] + (uint32_t)__builtin_popcount(below);
    return count < all ? count : all;
}

static uint64_t seconds_in(const struct fmt_nvdb_grid *grid, uint64_t first, uint64_t count)
{
    const uint64_t begin = seconds_below(grid, first), end = seconds_below(grid, first + count);
    return end > begin ? end - begin : 0;
}

/* ---- sizes ---- */

void bake_subgrid_count(const struct fmt_nvdb_grid *grid, uint32_t lower,
                        struct bake_subgrid_counts *counts)
{
    const struct range range = range_of(grid, lower);
    counts->lowers++;
    counts->leaves += range.leaf_count;
    counts->values += range.value_count + 2 * WORD_BITS; /* if it begins a run */
    counts->seconds += seconds_in(grid, range.first_value, range.value_count);
}

void bake_subgrid_sizes(const struct fmt_nvdb_grid *grid, const struct bake_subgrid_counts *counts,
                        uint64_t bytes[BAKE_SUBGRID_ARRAYS])
{
    const uint64_t channel = (counts->values + counts->seconds) * sizeof(uint32_t);
    bytes[BAKE_TILES] = (uint64_t)grid->tile_count * BK_TILE_WORDS * 8;
    bytes[BAKE_UPPERS] = (uint64_t)grid->upper_count * BK_UPPER_WORDS * 8;
    bytes[BAKE_LOWERS] = counts->lowers * BK_LOWER_WORDS * 8;
    /* The kernel reads leaf 0 for rays that are in no leaf. */
    bytes[BAKE_LEAVES] = (counts->leaves + !counts->leaves) * BK_LEAF_WORDS * 8;
    bytes[BAKE_NORMALS] = bytes[BAKE_PLANES] = channel;
    bytes[BAKE_COLORS] = (grid->colors ? channel : 0) + (grid->ids ? channel : 0) +
                         grid->transfer_count * sizeof *grid->transfers +
                         (grid->channels ? channel * grid->channel_words : 0);
    bytes[BAKE_COLORS] += bytes[BAKE_COLORS] > 0 ? sizeof bk_srgb : 0;
    bytes[BAKE_SECONDS] = ((counts->values - 1) / WORD_BITS + 1) * 8;
}

/* On a device, ids follow the colours of `records` records without a gap, and channels these. */
static void set_offsets(const struct fmt_nvdb_grid *grid, uint64_t records,
                        struct bk_params *params)
{
    const uint64_t ids = grid->colors && grid->ids ? records : 0;
    const uint64_t channels = (grid->colors ? records : 0) + (grid->ids ? records : 0);
    params->id_offset[0] = (bk_uint)ids;
    params->id_offset[1] = (bk_uint)(ids >> 32);
    params->channel_offset[0] = (bk_uint)channels;
    params->channel_offset[1] = (bk_uint)(channels >> 32);
}

void bake_subgrid_whole(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                        struct bake_subgrid *out)
{
    *out = (struct bake_subgrid){.grid = grid,
                                 .whole = true,
                                 .counts = {.lowers = grid->lower_count,
                                            .leaves = grid->leaf_count,
                                            .values = grid->voxel_count + 1,
                                            .seconds = grid->record_count - 1 - grid->voxel_count},
                                 .params = *params};
    set_offsets(grid, grid->record_count, &out->params);
    bake_subgrid_sizes(grid, &out->counts, out->bytes);
}

/* ---- subgrids ---- */

static int ascending(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

/* Adds the values of a lower node to the last run, or to a new one in words of its own. */
static void add_values(struct bake_subgrid *subgrid, const struct range *range)
{
    struct bake_value_run *run = &subgrid->runs[subgrid->run_count - 1];
    if (range->first_value != run->first + run->count) {
        const uint64_t word = bsq_align_up(run->to + run->count, WORD_BITS);
        *++run = (struct bake_value_run){.first = range->first_value,
                                         .to = word + range->first_value % WORD_BITS};
        subgrid->run_count++;
    }
    run->count += range->value_count;
}

static void add_lower(struct bake_subgrid *subgrid, uint32_t number)
{
    const struct range range = range_of(subgrid->grid, number);
    add_values(subgrid, &range);
    const struct bake_value_run *run = &subgrid->runs[subgrid->run_count - 1];
    subgrid->lowers[subgrid->counts.lowers++] = (struct bake_subgrid_lower){
        number, range.first_leaf, range.leaf_count, run->to - run->first};
    subgrid->counts.leaves += range.leaf_count;
    subgrid->counts.values = run->to + run->count;
}

static void set_params(struct bake_subgrid *subgrid)
{
    const struct bake_subgrid_counts *counts = &subgrid->counts;
    struct bk_params *params = &subgrid->params;
    params->lower_count = (bk_uint)counts->lowers;
    params->leaf_count = (bk_uint)counts->leaves;
    params->second_count = (bk_uint)counts->seconds;
    params->second_base_low = (bk_uint)counts->values;
    params->second_base_high = (bk_uint)(counts->values >> 32);
    set_offsets(subgrid->grid, counts->values + counts->seconds, params);
}

int bake_subgrid_create(struct bsq_ctx *ctx, struct bake_lower_set *set,
                        const struct bk_params *params, struct bake_subgrid *out)
{
    int status;
    *out = (struct bake_subgrid){.grid = set->grid, .params = *params, .run_count = 1};
    BSQ_TRY(bsq_alloc(ctx, "lower nodes of a pass", set->count, sizeof *out->lowers, &out->lowers));
    BSQ_TRY(bsq_alloc(ctx, "values of a pass", set->count + 1, sizeof *out->runs, &out->runs));
    out->runs[0] = (struct bake_value_run){.count = 1}; /* the background */
    out->counts.values = 1;
    bsq_sort(set->lowers, set->count, sizeof *set->lowers, ascending);
    for (uint64_t i = 0; i < set->count; i++)
        add_lower(out, set->lowers[i]);
    for (uint64_t i = 0; i < out->run_count; i++) {
        struct bake_value_run *run = &out->runs[i];
        run->first_second = seconds_below(out->grid, run->first);
        run->second_count = seconds_in(out->grid, run->first, run->count);
        out->counts.seconds += run->second_count;
    }
    set_params(out);
    bake_subgrid_sizes(out->grid, &out->counts, out->bytes);
done:
    return status;
}

void bake_subgrid_free(struct bsq_ctx *ctx, struct bake_subgrid *subgrid)
{
    bsq_free(ctx, subgrid->lowers);
    bsq_free(ctx, subgrid->runs);
    *subgrid = (struct bake_subgrid){0};
}

/* ---- sending ----
 *
 * Nodes are copied with new offsets of their children, leaves with new value offsets, and records
 * run by run. Children keep their order, so a subgrid is in breadth-first order, as a grid is.
 *
 * If the file changes, its nodes no longer agree with the subgrid's ranges. Each array has its size
 * nevertheless: what is too much is cut off, what is missing is zero. */

enum {
    ENTRIES = 512, /* words of a child table, sent at a time */
    LEAVES = 64    /* likewise */
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
