/* subgrid.c - the sizes and nodes of a subgrid; subgrid_send.c makes its arrays. */
#include "libbake/device/subgrid/leaf_set.h"

#include <string.h>

#include "base/sort_array.h"
#include "libbake/kernel/bk_grid.h"
#include "libbake/kernel/bk_srgb.h"

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

void bake_subgrid_sizes(const struct fmt_nvdb_grid *grid, const struct bake_leaf_set *counts,
                        uint64_t bytes[BAKE_SUBGRID_ARRAYS])
{
    const uint64_t channel = (1 + counts->voxel_count + counts->second_count) * sizeof(uint32_t);
    bytes[BAKE_TILES] = (uint64_t)grid->tile_count * BK_TILE_WORDS * 8;
    bytes[BAKE_UPPERS] = counts->upper_count * BK_UPPER_WORDS * 8;
    bytes[BAKE_LOWERS] = counts->lower_count * BK_LOWER_WORDS * 8;
    /* The kernel reads leaf 0 for rays that are in no leaf. */
    bytes[BAKE_LEAVES] = (counts->leaf_count + !counts->leaf_count) * BK_LEAF_WORDS * 8;
    bytes[BAKE_NORMALS] = bytes[BAKE_PLANES] = channel;
    bytes[BAKE_COLORS] = (grid->colors ? channel : 0) + (grid->ids ? channel : 0) +
                         grid->transfer_count * sizeof *grid->transfers +
                         (grid->channels ? channel * grid->channel_words : 0);
    bytes[BAKE_COLORS] += bytes[BAKE_COLORS] > 0 ? sizeof bk_srgb : 0;
    bytes[BAKE_SECONDS] = (counts->voxel_count / 32 + 1) * 8;
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
    const struct bake_leaf_set all = {.upper_count = grid->upper_count,
                                      .lower_count = grid->lower_count,
                                      .leaf_count = grid->leaf_count,
                                      .voxel_count = grid->voxel_count,
                                      .second_count = grid->record_count - 1 - grid->voxel_count};
    *out = (struct bake_subgrid){.grid = grid, .whole = true, .params = *params};
    set_offsets(grid, grid->record_count, &out->params);
    bake_subgrid_sizes(grid, &all, out->bytes);
}

static int by_number(const void *a, const void *b)
{
    const uint32_t x = ((const struct bake_subgrid_lower *)a)->number;
    const uint32_t y = ((const struct bake_subgrid_lower *)b)->number;
    return (x > y) - (x < y);
}

static void copy_nodes(const struct bake_leaf_set *set, struct bake_subgrid *subgrid)
{
    uint64_t leaves = 0, voxels = 0;
    for (uint32_t i = 0, n = 0; i < set->grid->upper_count; i++)
        if (set->has_upper[i])
            subgrid->uppers[n++] = i;
    for (uint64_t i = 0; i < set->lower_count; i++)
        subgrid->lowers[i].number = set->lowers[i];
    bsq_sort(subgrid->lowers, set->lower_count, sizeof *subgrid->lowers, by_number);
    for (uint64_t i = 0; i < set->lower_count; i++) {
        struct bake_subgrid_lower *lower = &subgrid->lowers[i];
        const uint32_t place = set->place_of_lower[lower->number] - 1;
        memcpy(subgrid->leaf_masks[i], set->leaf_masks[place], sizeof *subgrid->leaf_masks);
        lower->first_leaf = leaves;
        lower->first_voxel = voxels;
        for (uint32_t n = 0; n < 64 * BAKE_MASK_WORDS; n++)
            if (subgrid->leaf_masks[i][n >> 6] >> (n & 63) & 1) {
                const uint32_t leaf = bake_lower_leaf(set->grid, lower->number, n);
                leaves++;
                voxels += leaf == BK_NONE ? 0 : bake_leaf_voxels(set->grid, leaf);
            }
    }
}

int bake_subgrid_create(struct bsq_ctx *ctx, const struct bake_leaf_set *set,
                        const struct bk_params *params, struct bake_subgrid *out)
{
    *out = (struct bake_subgrid){.grid = set->grid,
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
    out->params.second_count = (bk_uint)set->second_count;
    out->params.second_base_low = (bk_uint)second_base;
    out->params.second_base_high = (bk_uint)(second_base >> 32);
    set_offsets(set->grid, second_base + set->second_count, &out->params);
    bake_subgrid_sizes(set->grid, set, out->bytes);
    int status = bsq_alloc(ctx, "upper nodes of a pass", set->upper_count + 1, sizeof *out->uppers,
                           &out->uppers);
    if (status == 0)
        status = bsq_alloc(ctx, "lower nodes of a pass", set->lower_count + 1, sizeof *out->lowers,
                           &out->lowers);
    if (status == 0)
        status = bsq_alloc(ctx, "leaves of a pass", set->lower_count + 1, sizeof *out->leaf_masks,
                           &out->leaf_masks);
    if (status == 0)
        copy_nodes(set, out);
    return status;
}

void bake_subgrid_free(struct bsq_ctx *ctx, struct bake_subgrid *subgrid)
{
    bsq_free(ctx, subgrid->uppers);
    bsq_free(ctx, subgrid->lowers);
    bsq_free(ctx, subgrid->leaf_masks);
    *subgrid = (struct bake_subgrid){0};
}
