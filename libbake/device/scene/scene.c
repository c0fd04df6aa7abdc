/* scene.c - prepares a grid file for the kernel, and finds its nodes.
 *
 * The file may change while it is read, so every number of a node is bounded here, as in the
 * kernel: children with wrong numbers count as missing. */
#include "libbake/device/scene/scene.h"

#include <assert.h>
#include <string.h>

#include "libbake/kernel/bk_srgb.h"

_Static_assert(sizeof(struct bk_triangle) == 200, "layout shared with devices");
_Static_assert(sizeof(struct bk_patch) == 16, "layout shared with devices");
_Static_assert(sizeof(struct bk_params) == 144, "layout shared with devices");

int bake_check_grid(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    for (int k = 0; k < 3; k++)
        if (grid->index_min[k] < -BAKE_INDEX_LIMIT || grid->index_max[k] >= BAKE_INDEX_LIMIT)
            return bsq_fail(
                ctx, BSQ_EDATA,
                "%s: voxels from index %d to %d along %c: rays reach those from %d to %d",
                grid->map.path, grid->index_min[k], grid->index_max[k], "xyz"[k], -BAKE_INDEX_LIMIT,
                BAKE_INDEX_LIMIT - 1);
    return 0;
}

static void scene_split(uint64_t value, bk_uint words[2])
{
    words[0] = (bk_uint)value;
    words[1] = (bk_uint)(value >> 32);
}

/* Returns the array from which offsets of ids and channels count. */
static const uint32_t *first_color(const struct fmt_nvdb_grid *grid)
{
    return grid->colors ? grid->colors
           : grid->ids  ? grid->ids
                        : (const uint32_t *)(const void *)grid->channels;
}

void bake_params_from_grid(const struct fmt_nvdb_grid *grid, struct bk_params *params)
{
    assert(grid->upper_bytes == BK_UPPER_WORDS * 8 && grid->lower_bytes == BK_LOWER_WORDS * 8);
    for (int k = 0; k < 3; k++) {
        params->index_min[k] = grid->index_min[k];
        params->index_max[k] = grid->index_max[k];
    }
    params->root_tile_count = grid->root_tile_count;
    params->upper_count = grid->upper_count;
    params->lower_count = grid->lower_count;
    params->leaf_count = grid->leaf_count;
    params->second_base_low = (bk_uint)(grid->voxel_count + 1);
    params->second_base_high = (bk_uint)((grid->voxel_count + 1) >> 32);
    params->second_count = (bk_uint)(grid->record_count - 1 - grid->voxel_count);
    scene_split((uint64_t)(grid->uppers - grid->root), params->upper_offset);
    scene_split((uint64_t)(grid->lowers - grid->uppers), params->lower_offset);
    scene_split((uint64_t)(grid->leaves - grid->lowers), params->leaf_offset);
    params->flags &= ~(bk_uint)(BK_HAS_COLOR | BK_HAS_IDS);
    if (grid->colors)
        params->flags |= BK_HAS_COLOR;
    if (grid->ids)
        params->flags |= BK_HAS_IDS;
    scene_split(grid->ids && grid->colors ? (uint64_t)(grid->ids - grid->colors) : 0,
                params->id_offset);
    scene_split(grid->channels
                    ? (uint64_t)((const uint32_t *)(const void *)grid->channels - first_color(grid))
                    : 0,
                params->channel_offset);
    params->channel_words = grid->channels ? grid->channel_words : 0;
}

void bake_kernel_grid(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      struct bk_grid *out)
{
    bk_grid_from_params(out, params);
    out->root_tiles = (const bk_ulong *)(const void *)grid->root_tiles;
    out->uppers = (const bk_ulong *)(const void *)grid->uppers;
    out->lowers = (const bk_ulong *)(const void *)grid->lowers;
    out->leaves = (const bk_ulong *)(const void *)grid->leaves;
    out->normals = grid->normals;
    out->planes = grid->planes;
    out->colors = first_color(grid);
    out->transfers = grid->transfers;
    out->seconds = &grid->seconds[0][0];
    out->srgb = bk_srgb;
}

/* On a device, ids follow the colours without a gap, and channels follow these. */
static void set_offsets(const struct fmt_nvdb_grid *grid, struct bk_params *params)
{
    const uint64_t colors = grid->colors ? grid->record_count : 0;
    const uint64_t ids = grid->ids ? grid->record_count : 0;
    scene_split(grid->ids ? colors : 0, params->id_offset);
    scene_split(colors + ids, params->channel_offset);
}

void bake_list_arrays(const struct bake_scene *scene, struct bake_grid_arrays *out)
{
    const struct fmt_nvdb_grid *g = scene->grid;
    const struct bake_tree tree = scene->tree ? *scene->tree : (struct bake_tree){0};
    const uint64_t leaves = tree.nodes ? g->leaf_count : 0;
    const uint64_t records = g->record_count * sizeof(uint32_t);
    const uint64_t transfers = g->transfer_count * sizeof *g->transfers;
    const bool colors = g->colors || g->ids || g->channels || transfers > 0;
    const struct bake_grid_array arrays[BAKE_GRID_ARRAYS] = {
        [BAKE_ROOT_TILES] = {"root tiles",
                             {{g->root_tiles, 8ull * g->root_tile_count * BK_ROOT_TILE_WORDS}},
                             0},
        [BAKE_UPPERS] = {"upper nodes", {{g->uppers, 8ull * g->upper_count * BK_UPPER_WORDS}}, 0},
        [BAKE_LOWERS] = {"lower nodes", {{g->lowers, 8ull * g->lower_count * BK_LOWER_WORDS}}, 0},
        [BAKE_LEAVES] = {"leaves", {{g->leaves, 8ull * g->leaf_count * BK_LEAF_WORDS}}, 0},
        [BAKE_NORMALS] = {"normals", {{g->normals, records}}, 0},
        [BAKE_PLANES] = {"planes", {{g->planes, records}}, 0},
        [BAKE_COLORS] = {"colors",
                         {{bk_srgb, colors ? sizeof bk_srgb : 0},
                          {g->transfers, transfers},
                          {g->colors, g->colors ? records : 0},
                          {g->ids, g->ids ? records : 0},
                          {g->channels, g->channels ? records * g->channel_words : 0}},
                         0},
        [BAKE_SECONDS] = {"second records", {{g->seconds, (g->voxel_count / 32 + 1) * 8}}, 0},
        [BAKE_NODES] = {"tree of leaves", {{tree.nodes, tree.count * sizeof *tree.nodes}}, 0},
        [BAKE_BLOCKS] = {"blocks of leaves", {{tree.blocks, leaves * sizeof *tree.blocks}}, 0}};
    *out = (struct bake_grid_arrays){.params = scene->params};
    memcpy(out->arrays, arrays, sizeof arrays);
    set_offsets(g, &out->params);
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        struct bake_grid_array *array = &out->arrays[i];
        for (int k = 0; k < BAKE_ARRAY_RANGES; k++)
            array->bytes += array->ranges[k].bytes;
        out->bytes += array->bytes;
        out->largest = array->bytes > out->largest ? array->bytes : out->largest;
    }
}
