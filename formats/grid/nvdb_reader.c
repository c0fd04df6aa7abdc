/* nvdb_reader.c - recognises and opens grid files, and looks up voxels.
 *
 * The lookup descends through root, upper node, lower node and leaf. It is the reference for the
 * kernel's traversal, and like that it bounds every offset and rank that it follows. */
#include <string.h>

#include "formats/grid/nvdb_layout_internal.h"

bool fmt_nvdb_recognise(const char first[8])
{
    return memcmp(first, "NanoVDB", 7) == 0 || memcmp(first + 1, "BDVonaN", 7) == 0;
}

bool fmt_vdb_recognise(const char first[8])
{
    return memcmp(first, " BDV", 4) == 0;
}

/* Checks a grid that was mapped, and fills in the rest. Closes it on failure. */
static int check_mapped(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    int status = fmt_nvdb_check_header(ctx, grid);
    if (status == 0)
        status = fmt_nvdb_check_nodes(ctx, grid);
    status = bsq_map_explain(ctx, &grid->map, status);
    if (status)
        fmt_nvdb_close(ctx, grid);
    return status;
}

int fmt_nvdb_open(struct bsq_ctx *ctx, const char *path, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    int status = bsq_map_open(ctx, path, &out->map);
    return status ? status : check_mapped(ctx, out);
}

int fmt_nvdb_open_file(struct bsq_ctx *ctx, struct bsq_file *file, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    int status = bsq_map_file(ctx, file, &out->map);
    return status ? status : check_mapped(ctx, out);
}

void fmt_nvdb_close(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    bsq_map_close(ctx, &grid->map);
    memset(grid, 0, sizeof(*grid));
}

/* Returns the tile with a key, or NULL; tiles are sorted. */
static const struct nvdb_tile *find_tile(const struct fmt_nvdb_grid *grid, uint64_t key)
{
    const struct nvdb_tile *tiles = (const struct nvdb_tile *)grid->tiles;
    uint32_t low = 0, high = grid->tile_count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (tiles[middle].key < key)
            low = middle + 1;
        else
            high = middle;
    }
    return low < grid->tile_count && tiles[low].key == key ? &tiles[low] : NULL;
}

/* Returns node number `offset` / `bytes` of a level, or NULL if the level has fewer. */
static const void *node_at(const uint8_t *level, uint64_t offset, uint64_t bytes, uint64_t count)
{
    return offset / bytes < count ? level + offset / bytes * bytes : NULL;
}

/* Return the children of a node whose tables name these offsets, or NULL. */
static const struct nvdb_upper *upper_of(const struct fmt_nvdb_grid *grid, int64_t child)
{
    return node_at(grid->uppers, (uint64_t)child - (uint64_t)(grid->uppers - grid->root),
                   sizeof(struct nvdb_upper), grid->upper_count);
}

static const struct nvdb_lower *lower_of(const struct fmt_nvdb_grid *grid,
                                         const struct nvdb_upper *upper, uint32_t slot)
{
    uint64_t base = (uint64_t)((const uint8_t *)upper - grid->lowers);
    if (!(upper->child_mask[slot >> 6] >> (slot & 63) & 1))
        return NULL;
    return node_at(grid->lowers, base + (uint64_t)upper->table[slot], sizeof(struct nvdb_lower),
                   grid->lower_count);
}

static const struct nvdb_leaf *leaf_of(const struct fmt_nvdb_grid *grid,
                                       const struct nvdb_lower *lower, uint32_t slot)
{
    uint64_t base = (uint64_t)((const uint8_t *)lower - grid->leaves);
    if (!(lower->child_mask[slot >> 6] >> (slot & 63) & 1))
        return NULL;
    return node_at(grid->leaves, base + (uint64_t)lower->table[slot], sizeof(struct nvdb_leaf),
                   grid->leaf_count);
}

uint64_t fmt_nvdb_find(const struct fmt_nvdb_grid *grid, const int32_t ijk[3])
{
    const struct nvdb_tile *tile = find_tile(grid, nvdb_root_key(ijk));
    const struct nvdb_upper *upper = tile ? upper_of(grid, tile->child) : NULL;
    const struct nvdb_lower *lower = upper ? lower_of(grid, upper, nvdb_upper_slot(ijk)) : NULL;
    const struct nvdb_leaf *leaf = lower ? leaf_of(grid, lower, nvdb_lower_slot(ijk)) : NULL;
    uint32_t slot = nvdb_leaf_slot(ijk), word = slot >> 6;
    uint64_t bit = UINT64_C(1) << (slot & 63);
    if (!leaf || !(leaf->mask[word] & bit))
        return 0;
    uint64_t before = word ? leaf->prefix_sum >> (9 * (word - 1)) & 511 : 0;
    uint64_t value = leaf->offset + before + nvdb_popcount(leaf->mask[word] & (bit - 1));
    return value <= grid->voxel_count ? value : 0;
}

int fmt_nvdb_record_version(const struct fmt_nvdb_grid *grid)
{
    return nvdb_record_version(grid->info.ids != BSQ_IDS_NONE, grid->channel_words > 0);
}

struct fmt_nvdb_record fmt_nvdb_get(const struct fmt_nvdb_grid *grid, uint64_t index)
{
    assert(index > 0 && index < grid->record_count);
    return (struct fmt_nvdb_record){grid->normals[index], grid->planes[index],
                                    grid->colors ? grid->colors[index] : 0,
                                    grid->ids ? grid->ids[index] : 0};
}

uint64_t fmt_nvdb_second(const struct fmt_nvdb_grid *grid, uint64_t v)
{
    assert(v <= grid->voxel_count);
    const uint32_t *word = grid->seconds[v / 32];
    uint32_t bit = UINT32_C(1) << (v % 32);
    uint64_t second = 1 + grid->voxel_count + word[1] + nvdb_popcount(word[0] & (bit - 1));
    return word[0] & bit && second < grid->record_count ? second : 0;
}
