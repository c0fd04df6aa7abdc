/* nvdb_layout.c - offsets of the sections of a grid file, small facts about nodes, and all parts
 * that are neither nodes nor channels.
 *
 * Sections follow each other in NanoVDB's breadth-first order, without gaps up to the blind
 * metadata. Each channel then starts at a multiple of 64 bytes in the file, so that a mapped
 * channel is aligned for any access. */
#include <limits.h>
#include <math.h>
#include <string.h>
#include <zlib.h>
#include <xxhash.h>

#include "formats/grid/nvdb_layout_internal.h"

/* GridType, GridBlindDataSemantic and GridBlindDataClass numbers of NanoVDB. */
enum { TYPE_UNKNOWN = 0, TYPE_UINT32 = 10, TYPE_RGBA8 = 12 };
enum { SEMANTIC_UNKNOWN = 0, SEMANTIC_COLOR = 2, SEMANTIC_NORMAL = 3 };
enum { CLASS_CHANNEL_ARRAY = 4 };

enum {
    COLOR = NVDB_TRAILER_HAS_COLOR,
    IDS = NVDB_TRAILER_HAS_IDS,
    CHANNELS = NVDB_TRAILER_HAS_CHANNELS
};

const struct nvdb_row fmt_nvdb_rows[NVDB_SECTION_COUNT] = {
    [NVDB_HEAD] = {.name = "header"},
    [NVDB_UPPERS] = {.name = "upper nodes", .grows = true},
    [NVDB_LOWERS] = {.name = "lower nodes", .grows = true},
    [NVDB_LEAVES] = {.name = "leaf nodes", .grows = true},
    [NVDB_BLIND] = {.name = "blind metadata"},
    [NVDB_NORMALS] = {"normal", SEMANTIC_NORMAL, TYPE_UINT32, 4, 0, true, true},
    [NVDB_PLANES] = {"plane", SEMANTIC_UNKNOWN, TYPE_UINT32, 4, 0, true, true},
    [NVDB_COLORS] = {"color", SEMANTIC_COLOR, TYPE_RGBA8, 4, COLOR, true, true},
    [NVDB_SECONDS] = {"second", SEMANTIC_UNKNOWN, TYPE_UINT32, 4, 0, false, true},
    [NVDB_IDS] = {"id", SEMANTIC_UNKNOWN, TYPE_UINT32, 4, IDS, true, true},
    [NVDB_NAMES] = {.name = "names", .value_bytes = 1, .flag = IDS},
    [NVDB_CHANNELS] = {"channels", SEMANTIC_UNKNOWN, TYPE_UINT32, 4, CHANNELS, true, true},
    [NVDB_TRAILER] = {.name = "bisque", .value_bytes = 1},
};

const struct nvdb_level fmt_nvdb_upper = {
    .name = "upper",
    .section = NVDB_UPPERS,
    .child_section = NVDB_LOWERS,
    .words = 512,
    .log2_cells = 5,
    .dim = NVDB_UPPER_DIM,
    .child_dim = NVDB_LOWER_DIM,
    .node_bytes = sizeof(struct nvdb_upper),
    .child_bytes = sizeof(struct nvdb_lower),
};
const struct nvdb_level fmt_nvdb_lower = {
    .name = "lower",
    .section = NVDB_LOWERS,
    .child_section = NVDB_LEAVES,
    .words = 64,
    .log2_cells = 4,
    .dim = NVDB_LOWER_DIM,
    .child_dim = NVDB_LEAF_DIM,
    .node_bytes = sizeof(struct nvdb_lower),
    .child_bytes = sizeof(struct nvdb_leaf),
};

void fmt_nvdb_layout_compute(const struct nvdb_counts *counts, struct fmt_nvdb_layout *layout)
{
    uint64_t blinds = 0, offset = 0;
    for (int i = NVDB_NORMALS; i < NVDB_SECTION_COUNT; i++)
        blinds += nvdb_has(counts->flags, i);
    layout->record_count = 1 + counts->voxels + counts->seconds;
    const uint64_t size[NVDB_SECTION_COUNT] = {
        [NVDB_HEAD] =
            NVDB_ROOT_TILES_OFFSET + counts->uppers * (uint64_t)sizeof(struct nvdb_root_tile),
        [NVDB_UPPERS] = counts->uppers * (uint64_t)sizeof(struct nvdb_upper),
        [NVDB_LOWERS] = counts->lowers * (uint64_t)sizeof(struct nvdb_lower),
        [NVDB_LEAVES] = counts->leaves * (uint64_t)sizeof(struct nvdb_leaf),
        [NVDB_BLIND] = blinds * sizeof(struct nvdb_blind),
        [NVDB_NORMALS] = layout->record_count * 4,
        [NVDB_PLANES] = layout->record_count * 4,
        [NVDB_COLORS] = layout->record_count * 4,
        [NVDB_SECONDS] = (counts->voxels / 32 + 1) * 8,
        [NVDB_IDS] = layout->record_count * 4,
        [NVDB_NAMES] = counts->name_bytes,
        [NVDB_CHANNELS] = nvdb_channels_head_bytes(counts->channel_list_bytes) +
                          layout->record_count * counts->channel_words * sizeof(float),
        [NVDB_TRAILER] = sizeof(struct nvdb_trailer),
    };
    for (int i = 0; i < NVDB_SECTION_COUNT; i++) {
        if (i >= NVDB_NORMALS)
            offset = bsq_align_up(offset, NVDB_ALIGNMENT);
        layout->section[i] =
            (struct fmt_nvdb_range){offset, nvdb_has(counts->flags, i) ? size[i] : 0};
        offset += layout->section[i].size;
    }
    layout->file_bytes = offset;
}

/* Sets the numbers of the lowest and highest set bit; `bits` is not zero. */
static void nvdb_bit_range(uint32_t bits, int32_t *low, int32_t *high)
{
    *low = __builtin_ctz(bits);
    *high = 31 - __builtin_clz(bits);
}

uint32_t fmt_nvdb_leaf_bounds(const int32_t origin[3], const uint64_t mask[8], int32_t bbox_min[3],
                              int32_t bbox_max[3])
{
    uint32_t count = 0, bits[3] = {0, 0, 0};
    uint64_t yz = 0;
    for (uint32_t x = 0; x < 8; x++) {
        count += nvdb_popcount(mask[x]);
        bits[0] |= (uint32_t)(mask[x] != 0) << x;
        yz |= mask[x];
    }
    for (uint32_t y = 0; y < 8; y++) {
        uint32_t z = (uint32_t)(yz >> (8 * y) & 0xff);
        bits[1] |= (uint32_t)(z != 0) << y;
        bits[2] |= z;
    }
    if (count == 0)
        return 0;
    for (int axis = 0; axis < 3; axis++) {
        int32_t low, high;
        nvdb_bit_range(bits[axis], &low, &high);
        bbox_min[axis] = origin[axis] + low;
        bbox_max[axis] = origin[axis] + high;
    }
    return count;
}

uint64_t fmt_nvdb_prefix_sum(const uint64_t mask[8])
{
    uint64_t packed = 0, sum = 0;
    for (int word = 0; word < 7; word++) {
        sum += nvdb_popcount(mask[word]);
        packed |= sum << (9 * word);
    }
    return packed;
}

void fmt_nvdb_bbox_clear(int32_t bbox_min[3], int32_t bbox_max[3])
{
    for (int axis = 0; axis < 3; axis++) {
        bbox_min[axis] = INT32_MAX;
        bbox_max[axis] = INT32_MIN;
    }
}

void fmt_nvdb_bbox_extend(int32_t bbox_min[3], int32_t bbox_max[3], const int32_t other_min[3],
                          const int32_t other_max[3])
{
    for (int axis = 0; axis < 3; axis++) {
        if (other_min[axis] < bbox_min[axis])
            bbox_min[axis] = other_min[axis];
        if (other_max[axis] > bbox_max[axis])
            bbox_max[axis] = other_max[axis];
    }
}

/* ---- the head of the file, and the descriptions of channels ---- */

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

void fmt_nvdb_fill_file_head(struct nvdb_fixed *fixed)
{
    const struct nvdb_grid_data *grid = &fixed->grid;
    const struct nvdb_tree_data *tree = &fixed->tree;
    struct nvdb_file_meta *meta = &fixed->meta;
    fixed->header = (struct nvdb_file_header){NVDB_MAGIC, grid->version, 1, 0};
    *meta = (struct nvdb_file_meta){
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
    memcpy(meta->world_min, grid->world_min, sizeof meta->world_min);
    memcpy(meta->world_max, grid->world_max, sizeof meta->world_max);
    memcpy(meta->voxel_size, grid->voxel_size, sizeof meta->voxel_size);
    memcpy(meta->index_min, fixed->root.bbox_min, sizeof meta->index_min);
    memcpy(meta->index_max, fixed->root.bbox_max, sizeof meta->index_max);
    memset(fixed->name, 0, sizeof fixed->name);
    strcpy(fixed->name, NVDB_GRID_NAME);
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

static void nvdb_fill_grid_data(const struct fmt_nvdb_info *info, const struct nvdb_counts *counts,
                                const struct fmt_nvdb_layout *layout, const struct nvdb_root *root,
                                struct nvdb_grid_data *grid)
{
    grid->magic = NVDB_MAGIC;
    grid->version = NVDB_GRID_VERSION;
    grid->flags = NVDB_HAS_BBOX | NVDB_BREADTH_FIRST;
    grid->grid_count = 1;
    grid->grid_bytes = layout->file_bytes - FMT_NVDB_GRID_OFFSET;
    strcpy(grid->name, NVDB_GRID_NAME);
    fill_map(info, &grid->map);
    /* NanoVDB's world box reaches from the lowest index to the highest index plus one, in world
     * coordinates that are rounded once. */
    for (int axis = 0; axis < 3; axis++) {
        grid->world_min[axis] =
            fma(root->bbox_min[axis], info->voxel_size, info->translation[axis]);
        grid->world_max[axis] =
            fma(root->bbox_max[axis] + 1.0, info->voxel_size, info->translation[axis]);
        grid->voxel_size[axis] = info->voxel_size;
    }
    grid->grid_class = NVDB_CLASS_TOPOLOGY;
    grid->grid_type = NVDB_TYPE_MASK;
    grid->blind_offset = (int64_t)(layout->section[NVDB_BLIND].offset - FMT_NVDB_GRID_OFFSET);
    grid->blind_count = (uint32_t)(layout->section[NVDB_BLIND].size / sizeof(struct nvdb_blind));
    grid->value_count = 1 + counts->voxels;
}

static void fill_tree(const struct nvdb_counts *counts, const struct fmt_nvdb_layout *layout,
                      struct nvdb_tree_data *tree)
{
    const uint64_t start = offsetof(struct nvdb_fixed, tree);
    tree->node_offset[0] = layout->section[NVDB_LEAVES].offset - start;
    tree->node_offset[1] = layout->section[NVDB_LOWERS].offset - start;
    tree->node_offset[2] = layout->section[NVDB_UPPERS].offset - start;
    tree->node_offset[3] = NVDB_ROOT_OFFSET - start;
    tree->node_count[0] = counts->leaves;
    tree->node_count[1] = counts->lowers;
    tree->node_count[2] = counts->uppers;
    tree->voxel_count = counts->voxels;
}

uint32_t fmt_nvdb_head_crc(const uint8_t *head, const struct fmt_nvdb_layout *layout)
{
    uint64_t begin = FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, version);
    uLong crc = crc32(0, NULL, 0);
    return (uint32_t)crc32_z(crc, head + begin, layout->section[NVDB_HEAD].size - begin);
}

uint64_t fmt_nvdb_trailer_checksum(const struct nvdb_trailer *trailer)
{
    return XXH3_64bits(trailer, offsetof(struct nvdb_trailer, trailer_checksum));
}

void fmt_nvdb_fill_fixed(const struct fmt_nvdb_info *info, const struct nvdb_counts *counts,
                         const struct fmt_nvdb_layout *layout, const int32_t bbox_min[3],
                         const int32_t bbox_max[3], uint8_t *head)
{
    struct nvdb_fixed fixed = {.root.root_tile_count = counts->uppers};
    memcpy(fixed.root.bbox_min, bbox_min, sizeof fixed.root.bbox_min);
    memcpy(fixed.root.bbox_max, bbox_max, sizeof fixed.root.bbox_max);
    nvdb_fill_grid_data(info, counts, layout, &fixed.root, &fixed.grid);
    fill_tree(counts, layout, &fixed.tree);
    fmt_nvdb_fill_file_head(&fixed);
    memset(head, 0, NVDB_ROOT_TILES_OFFSET);
    memcpy(head, &fixed, sizeof fixed);
}

void fmt_nvdb_fill_blind(const struct fmt_nvdb_layout *layout, struct nvdb_blind *blind)
{
    memset(blind, 0, layout->section[NVDB_BLIND].size);
    uint64_t here = layout->section[NVDB_BLIND].offset;
    for (int section = NVDB_NORMALS; section <= NVDB_TRAILER; section++) {
        const struct fmt_nvdb_range *range = &layout->section[section];
        if (range->size == 0)
            continue;
        const struct nvdb_row *row = &fmt_nvdb_rows[section];
        blind->offset = (int64_t)(range->offset - here);
        blind->count = range->size / row->value_bytes;
        blind->value_bytes = row->value_bytes;
        blind->semantic = row->semantic;
        blind->data_class = CLASS_CHANNEL_ARRAY;
        blind->data_type = row->data_type;
        strcpy(blind->name, row->name);
        blind++;
        here += sizeof(*blind);
    }
}
