/* nvdb_header.c - fills in all parts of a grid file that are neither nodes nor channels. */
#include <math.h>
#include <string.h>
#include <zlib.h>
#include <xxhash.h>

#include "formats/grid/nvdb_layout_internal.h"

enum { CLASS_CHANNEL_ARRAY = 4 }; /* NanoVDB's GridBlindDataClass */

/* Returns the key by which NanoVDB finds grids by name: a hash to base 67 that adds the top byte,
 * which overflows, back in. */
static uint64_t name_key(const char *name)
{
    uint64_t key = 0;
    for (; *name; name++) {
        uint64_t overflow = key >> 56;
        key = key * 67 + (unsigned char)*name + overflow;
    }
    return key;
}

void fmt_nvdb_fill_file_head(const struct nvdb_grid_data *grid, const struct nvdb_tree_data *tree,
                             const struct nvdb_root *root, uint8_t head[FMT_NVDB_GRID_OFFSET])
{
    struct nvdb_file_header header = {NVDB_MAGIC, grid->version, 1, 0};
    struct nvdb_file_meta meta = {
        .grid_bytes = grid->grid_bytes,
        .file_bytes = grid->grid_bytes,
        .name_key = name_key(NVDB_GRID_NAME),
        .voxel_count = tree->voxel_count,
        .grid_type = grid->grid_type,
        .grid_class = grid->grid_class,
        .name_bytes = NVDB_NAME_BYTES,
        .node_count = {tree->node_count[0], tree->node_count[1], tree->node_count[2], 1},
        .version = grid->version,
    };
    memcpy(meta.world_min, grid->world_min, sizeof(meta.world_min));
    memcpy(meta.world_max, grid->world_max, sizeof(meta.world_max));
    memcpy(meta.voxel_size, grid->voxel_size, sizeof(meta.voxel_size));
    memcpy(meta.index_min, root->bbox_min, sizeof(meta.index_min));
    memcpy(meta.index_max, root->bbox_max, sizeof(meta.index_max));
    memset(head, 0, FMT_NVDB_GRID_OFFSET);
    memcpy(head, &header, sizeof(header));
    memcpy(head + sizeof(header), &meta, sizeof(meta));
    strcpy((char *)head + sizeof(header) + sizeof(meta), NVDB_GRID_NAME);
}

static void fill_map(const struct fmt_nvdb_info *info, struct nvdb_map *map)
{
    double inverse = 1.0 / info->voxel_size;
    for (int axis = 0; axis < 3; axis++) {
        map->matrix[4 * axis] = info->voxel_size;
        map->matrix_f[4 * axis] = (float)info->voxel_size;
        map->inverse[4 * axis] = inverse;
        map->inverse_f[4 * axis] = (float)inverse;
        map->translation[axis] = info->translation[axis];
        map->translation_f[axis] = (float)info->translation[axis];
    }
    map->taper = 1.0;
    map->taper_f = 1.0f;
}

static void fill_grid(const struct fmt_nvdb_info *info, const struct nvdb_counts *counts,
                      const struct nvdb_layout *layout, const int32_t bbox_min[3],
                      const int32_t bbox_max[3], struct nvdb_grid_data *grid)
{
    grid->magic = NVDB_MAGIC;
    grid->version = nvdb_version(counts->type);
    grid->flags = NVDB_HAS_BBOX | NVDB_BREADTH_FIRST;
    grid->grid_count = 1;
    grid->grid_bytes = layout->file_bytes - FMT_NVDB_GRID_OFFSET;
    strcpy(grid->name, NVDB_GRID_NAME);
    fill_map(info, &grid->map);
    /* NanoVDB's world box reaches from the lowest index to the highest index plus one, in world
     * coordinates that are rounded once. */
    for (int axis = 0; axis < 3; axis++) {
        grid->world_min[axis] = fma(bbox_min[axis], info->voxel_size, info->translation[axis]);
        grid->world_max[axis] =
            fma(bbox_max[axis] + 1.0, info->voxel_size, info->translation[axis]);
        grid->voxel_size[axis] = info->voxel_size;
    }
    bool indexed = counts->type == FMT_NVDB_ONINDEX;
    grid->grid_class = indexed ? NVDB_CLASS_INDEX : NVDB_CLASS_TOPOLOGY;
    grid->grid_type = counts->type;
    grid->blind_offset = (int64_t)(layout->section[NVDB_BLIND].offset - FMT_NVDB_GRID_OFFSET);
    grid->blind_count = layout->blind_count;
    grid->value_count = 1 + counts->voxels;
    grid->data2 = indexed ? NVDB_MAGIC_GRID : 0;
}

static void fill_tree(const struct nvdb_counts *counts, const struct nvdb_layout *layout,
                      struct nvdb_tree_data *tree)
{
    uint64_t start = FMT_NVDB_GRID_OFFSET + sizeof(struct nvdb_grid_data);
    tree->node_offset[0] = layout->section[NVDB_LEAVES].offset - start;
    tree->node_offset[1] = layout->section[NVDB_LOWERS].offset - start;
    tree->node_offset[2] = layout->section[NVDB_UPPERS].offset - start;
    tree->node_offset[3] = layout->root - start;
    tree->node_count[0] = counts->leaves;
    tree->node_count[1] = counts->lowers;
    tree->node_count[2] = counts->uppers;
    tree->voxel_count = counts->voxels;
}

uint32_t fmt_nvdb_head_crc(const uint8_t *head, const struct nvdb_layout *layout)
{
    uint64_t begin = FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, version);
    uLong crc = crc32(0, NULL, 0);
    return (uint32_t)crc32_z(crc, head + begin, layout->section[NVDB_HEAD].size - begin);
}

uint64_t fmt_nvdb_record_checksum(const struct nvdb_record *record)
{
    return XXH3_64bits(record, offsetof(struct nvdb_record, record_checksum));
}

void fmt_nvdb_fill_fixed(const struct fmt_nvdb_info *info, const struct nvdb_counts *counts,
                         const struct nvdb_layout *layout, const int32_t bbox_min[3],
                         const int32_t bbox_max[3], uint8_t *head)
{
    memset(head, 0, layout->tiles);
    struct nvdb_grid_data grid = {0};
    fill_grid(info, counts, layout, bbox_min, bbox_max, &grid);
    struct nvdb_tree_data tree = {0};
    fill_tree(counts, layout, &tree);
    struct nvdb_root root = {.tile_count = counts->uppers};
    memcpy(root.bbox_min, bbox_min, sizeof(root.bbox_min));
    memcpy(root.bbox_max, bbox_max, sizeof(root.bbox_max));

    fmt_nvdb_fill_file_head(&grid, &tree, &root, head);
    memcpy(head + FMT_NVDB_GRID_OFFSET, &grid, sizeof(grid));
    memcpy(head + FMT_NVDB_GRID_OFFSET + sizeof(grid), &tree, sizeof(tree));
    memcpy(head + layout->root, &root, sizeof(root));
}

void fmt_nvdb_fill_head(const struct fmt_nvdb_info *info, const struct nvdb_counts *counts,
                        const struct nvdb_layout *layout, const uint64_t *keys,
                        const int32_t bbox_min[3], const int32_t bbox_max[3], uint8_t *head)
{
    fmt_nvdb_fill_fixed(info, counts, layout, bbox_min, bbox_max, head);
    uint64_t child = layout->section[NVDB_UPPERS].offset - layout->root;
    for (uint32_t i = 0; i < counts->uppers; i++) {
        struct nvdb_tile tile = {.key = keys[i], .child = (int64_t)child};
        memcpy(head + layout->tiles + i * (uint64_t)sizeof(tile), &tile, sizeof(tile));
        child += sizeof(struct nvdb_upper);
    }
    uint32_t checksum[2] = {fmt_nvdb_head_crc(head, layout), UINT32_MAX};
    memcpy(head + FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, checksum), checksum,
           sizeof(checksum));
}

void fmt_nvdb_fill_blind(const struct nvdb_layout *layout, struct nvdb_blind *blind)
{
    memset(blind, 0, layout->section[NVDB_BLIND].size);
    uint64_t here = layout->section[NVDB_BLIND].offset;
    for (int section = NVDB_NORMALS; section <= NVDB_RECORD; section++) {
        const struct nvdb_range *range = &layout->section[section];
        if (range->size == 0)
            continue;
        const struct fmt_nvdb_channel *channel = fmt_nvdb_channel((enum nvdb_section)section);
        blind->offset = (int64_t)(range->offset - here);
        blind->count = range->size / channel->value_bytes;
        blind->value_bytes = channel->value_bytes;
        blind->semantic = channel->semantic;
        blind->data_class = CLASS_CHANNEL_ARRAY;
        blind->data_type = channel->data_type;
        strcpy(blind->name, channel->name);
        blind++;
        here += sizeof(*blind);
    }
}
