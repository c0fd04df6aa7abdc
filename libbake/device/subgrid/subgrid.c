/* subgrid.c - sets of lower nodes, and the sizes and numbers of the subgrids made of them;
 * subgrid_send.c makes the arrays.
 *
 * Grid files store leaves and values in the order of the lower nodes. So the leaves and the values
 * of a lower node are ranges, and those of neighbours are one range. If the file changes, its nodes
 * no longer agree with these ranges; all ranges lie in the file's arrays nevertheless. */
#include "libbake/device/subgrid/subgrid.h"

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
