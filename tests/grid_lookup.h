/* grid_lookup.h - looks up voxels of a grid and completes grids, for tests.
 *
 * The lookup descends through root, upper node, lower node and leaf. It is the reference for the
 * kernel's traversal, and like that it bounds every offset and rank that it follows. */
#ifndef TESTS_GRID_LOOKUP_H
#define TESTS_GRID_LOOKUP_H

#include "formats/grid/nvdb_layout_internal.h"

/* Return the slot of a voxel's leaf in its lower node, of the voxel in its leaf. */
static inline uint32_t grid_lower_slot(const int32_t ijk[3])
{
    return ((uint32_t)ijk[0] >> 3 & 15) << 8 | ((uint32_t)ijk[1] >> 3 & 15) << 4 |
           ((uint32_t)ijk[2] >> 3 & 15);
}
static inline uint32_t grid_leaf_slot(const int32_t ijk[3])
{
    return ((uint32_t)ijk[0] & 7) << 6 | ((uint32_t)ijk[1] & 7) << 3 | ((uint32_t)ijk[2] & 7);
}

/* Returns the tile with a key, or NULL; tiles are sorted. */
static inline const struct nvdb_root_tile *grid_find_tile(const struct fmt_nvdb_grid *grid,
                                                          uint64_t key)
{
    const struct nvdb_root_tile *root_tiles = (const struct nvdb_root_tile *)grid->root_tiles;
    uint32_t low = 0, high = grid->root_tile_count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (root_tiles[middle].key < key)
            low = middle + 1;
        else
            high = middle;
    }
    return low < grid->root_tile_count && root_tiles[low].key == key ? &root_tiles[low] : NULL;
}

/* Returns node number `offset` / `bytes` of a level, or NULL if the level has fewer. */
static inline const void *grid_node_at(const uint8_t *level, uint64_t offset, uint64_t bytes,
                                       uint64_t count)
{
    return offset / bytes < count ? level + offset / bytes * bytes : NULL;
}

/* Return the children of a node whose tables name these offsets, or NULL. */
static inline const struct nvdb_upper *grid_upper_of(const struct fmt_nvdb_grid *grid,
                                                     int64_t child)
{
    return grid_node_at(grid->uppers, (uint64_t)child - (uint64_t)(grid->uppers - grid->root),
                        sizeof(struct nvdb_upper), grid->upper_count);
}

static inline const struct nvdb_lower *grid_lower_of(const struct fmt_nvdb_grid *grid,
                                                     const struct nvdb_upper *upper, uint32_t slot)
{
    uint64_t base = (uint64_t)((const uint8_t *)upper - grid->lowers);
    if (!(upper->child_mask[slot >> 6] >> (slot & 63) & 1))
        return NULL;
    return grid_node_at(grid->lowers, base + (uint64_t)upper->table[slot],
                        sizeof(struct nvdb_lower), grid->lower_count);
}

static inline const struct nvdb_leaf *grid_leaf_of(const struct fmt_nvdb_grid *grid,
                                                   const struct nvdb_lower *lower, uint32_t slot)
{
    uint64_t base = (uint64_t)((const uint8_t *)lower - grid->leaves);
    if (!(lower->child_mask[slot >> 6] >> (slot & 63) & 1))
        return NULL;
    return grid_node_at(grid->leaves, base + (uint64_t)lower->table[slot], sizeof(struct nvdb_leaf),
                        grid->leaf_count);
}

/* Returns the value index of the voxel at index coordinates, at most voxel_count; 0 if it is not
 * active. */
static inline uint64_t grid_find(const struct fmt_nvdb_grid *grid, const int32_t ijk[3])
{
    const struct nvdb_root_tile *tile = grid_find_tile(grid, nvdb_root_key(ijk));
    const struct nvdb_upper *upper = tile ? grid_upper_of(grid, tile->child) : NULL;
    const struct nvdb_lower *lower =
        upper ? grid_lower_of(grid, upper, nvdb_upper_cell(ijk)) : NULL;
    const struct nvdb_leaf *leaf = lower ? grid_leaf_of(grid, lower, grid_lower_slot(ijk)) : NULL;
    uint32_t slot = grid_leaf_slot(ijk), word = slot >> 6;
    uint64_t bit = UINT64_C(1) << (slot & 63);
    if (!leaf || !(leaf->mask[word] & bit))
        return 0;
    uint64_t before = word ? leaf->prefix_sum >> (9 * (word - 1)) & 511 : 0;
    uint64_t value = leaf->offset + before + nvdb_popcount(leaf->mask[word] & (bit - 1));
    return value <= grid->voxel_count ? value : 0;
}

/* Returns record number `index`, from 1 to record_count - 1. */
static inline struct fmt_nvdb_record grid_get(const struct fmt_nvdb_grid *grid, uint64_t index)
{
    assert(index > 0 && index < grid->record_count);
    return (struct fmt_nvdb_record){grid->normals[index], grid->planes[index],
                                    grid->colors ? grid->colors[index] : 0,
                                    grid->ids ? grid->ids[index] : 0};
}

/* Completes a grid and gives the file its name. */
static inline int grid_commit(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals)
{
    struct bsq_output *output;
    int status = fmt_nvdb_finish(writer, totals, &output);
    return status == 0 ? bsq_output_commit(output) : status;
}

#endif
