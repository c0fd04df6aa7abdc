/* nvdb_layout_internal.h - the bytes of a grid file, and the offsets of its sections.
 *
 * The structures are those of NanoVDB 32.4.2 for a Mask grid. A few counts determine the offset of
 * each section (fmt_nvdb_layout_compute). So the writer can write from front to back, and the
 * reader compares all offsets in a file with computed ones. The byte tables are in FORMATS.md. */
#ifndef FMT_GRID_NVDB_LAYOUT_INTERNAL_H
#define FMT_GRID_NVDB_LAYOUT_INTERNAL_H

#include <assert.h>
#include <stddef.h>

#include "formats/grid/nvdb.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "NanoVDB grids are little-endian and used in place"
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define NVDB_MAGIC            UINT64_C(0x304244566f6e614e) /* "NanoVDB0" */
#define NVDB_MAGIC_GRID       UINT64_C(0x314244566f6e614e) /* "NanoVDB1" */
#define NVDB_MAGIC_FILE       UINT64_C(0x324244566f6e614e) /* "NanoVDB2" */
#define NVDB_VERSION(a, b, c) ((uint32_t)(a) << 21 | (uint32_t)(b) << 10 | (uint32_t)(c))
#define NVDB_GRID_VERSION     NVDB_VERSION(32, 4, 2)
#define NVDB_GRID_NAME        "surface"

enum {
    NVDB_NAME_BYTES = 32, /* padded, so that GridData is at FMT_NVDB_GRID_OFFSET */
    NVDB_TYPE_MASK = 8,   /* GridType */
    NVDB_CLASS_TOPOLOGY = 6,
    NVDB_HAS_BBOX = 1 << 1, /* grid flags */
    NVDB_BREADTH_FIRST = 1 << 5,
    NVDB_NODE_HAS_BBOX = 2, /* node flags */
    NVDB_ALIGNMENT = 64,    /* of a channel's offset in the file */
    NVDB_LEAF_DIM = 8,      /* voxels along the edge of a node */
    NVDB_LOWER_DIM = 128,
    NVDB_UPPER_DIM = 4096
};

struct nvdb_file_header {
    uint64_t magic;
    uint32_t version;
    uint16_t grid_count;
    uint16_t codec;
};

struct nvdb_file_meta {
    uint64_t grid_bytes, file_bytes, name_key, voxel_count;
    uint32_t grid_type, grid_class;
    double world_min[3], world_max[3];
    int32_t index_min[3], index_max[3];
    double voxel_size[3];
    uint32_t name_bytes;
    uint32_t node_count[4]; /* leaf, lower, upper, root */
    uint32_t root_tile_count[3];
    uint16_t codec, padding;
    uint32_t version;
};

struct nvdb_map {
    float matrix_f[9], inverse_f[9], translation_f[3], taper_f;
    double matrix[9], inverse[9], translation[3], taper;
};

struct nvdb_grid_data {
    uint64_t magic;
    uint32_t checksum[2]; /* CRC-32 of the head; all ones, so nodes are not covered */
    uint32_t version, flags;
    uint32_t grid_index, grid_count;
    uint64_t grid_bytes;
    char name[256];
    struct nvdb_map map;
    double world_min[3], world_max[3];
    double voxel_size[3];
    uint32_t grid_class, grid_type;
    int64_t blind_offset; /* from GridData */
    uint32_t blind_count, data0;
    uint64_t value_count; /* the background and all voxels */
    uint64_t data2;
};

struct nvdb_tree_data {
    uint64_t node_offset[4]; /* from TreeData to the first leaf, lower, upper, root */
    uint32_t node_count[3];
    uint32_t root_tile_count[3];
    uint64_t voxel_count;
};

/* RootData without its values (all zero) and padding, which follow. */
struct nvdb_root {
    int32_t bbox_min[3], bbox_max[3];
    uint32_t root_tile_count;
};
enum { NVDB_ROOT_BYTES = 64 };

/* The beginning of every file. The rest of RootData follows, and the tiles. */
struct nvdb_fixed {
    struct nvdb_file_header header;
    struct nvdb_file_meta meta;
    char name[NVDB_NAME_BYTES];
    struct nvdb_grid_data grid;
    struct nvdb_tree_data tree;
    struct nvdb_root root;
};
enum {
    NVDB_ROOT_OFFSET = offsetof(struct nvdb_fixed, root),
    NVDB_ROOT_TILES_OFFSET = NVDB_ROOT_OFFSET + NVDB_ROOT_BYTES
};

struct nvdb_root_tile {
    uint64_t key;
    int64_t child; /* from RootData */
    uint64_t values[2];
};

struct nvdb_upper {
    int32_t bbox_min[3], bbox_max[3];
    uint64_t flags;
    uint64_t value_mask[512], child_mask[512];
    uint64_t statistics[4];
    int64_t table[32768]; /* child: offset from this node */
};

struct nvdb_lower {
    int32_t bbox_min[3], bbox_max[3];
    uint64_t flags;
    uint64_t value_mask[64], child_mask[64];
    uint64_t statistics[4];
    int64_t table[4096];
};

struct nvdb_leaf {
    int32_t bbox_min[3];
    uint8_t bbox_dif[3];
    uint8_t flags;
    uint64_t mask[8];
    uint64_t offset;     /* value index of the first voxel */
    uint64_t prefix_sum; /* bits 9 k ... 9 k + 8: voxels in words 0 ... k */
};

struct nvdb_blind {
    int64_t offset; /* from this structure */
    uint64_t count;
    uint32_t value_bytes; /* unused "flags" before version 32.6 */
    uint32_t semantic, data_class, data_type;
    char name[256];
};

static_assert(sizeof(struct nvdb_file_header) == 16, "file header");
static_assert(sizeof(struct nvdb_file_meta) == 176, "file metadata");
static_assert(offsetof(struct nvdb_fixed, grid) == FMT_NVDB_GRID_OFFSET, "start of the grid");
static_assert(NVDB_ROOT_OFFSET == 960, "start of RootData");
static_assert(offsetof(struct nvdb_grid_data, map) == 296, "GridData");
static_assert(offsetof(struct nvdb_grid_data, world_min) == 560, "GridData");
static_assert(offsetof(struct nvdb_grid_data, blind_offset) == 640, "GridData");
static_assert(sizeof(struct nvdb_grid_data) == 672, "GridData");
static_assert(sizeof(struct nvdb_tree_data) == 64, "TreeData");
static_assert(sizeof(struct nvdb_root) == 28, "RootData");
static_assert(sizeof(struct nvdb_root_tile) == 32, "RootData::Tile");
static_assert(sizeof(struct nvdb_upper) == 270400, "InternalData<5>");
static_assert(sizeof(struct nvdb_lower) == 33856, "InternalData<4>");
static_assert(offsetof(struct nvdb_upper, table) == 64 + 16 * 512, "InternalData<5>");
static_assert(offsetof(struct nvdb_lower, table) == 64 + 16 * 64, "InternalData<4>");
static_assert(sizeof(struct nvdb_leaf) == FMT_NVDB_LEAF_BYTES, "LeafData");
static_assert(sizeof(struct nvdb_blind) == 288, "GridBlindMetaData");

/* Sections of the file, in its order; each has a checksum. */
enum nvdb_section {
    NVDB_HEAD, /* file header and metadata, GridData, TreeData, RootData and tiles */
    NVDB_UPPERS,
    NVDB_LOWERS,
    NVDB_LEAVES,
    NVDB_BLIND, /* array of struct nvdb_blind */
    NVDB_NORMALS,
    NVDB_PLANES,
    NVDB_COLORS, /* of size 0 if the grid has no colour */
    NVDB_SECONDS,
    NVDB_IDS,      /* this and the next: of size 0 if the grid has no ids */
    NVDB_NAMES,    /* struct nvdb_names_head and names */
    NVDB_CHANNELS, /* struct nvdb_channels_head, the list, and values; size 0 without channels */
    NVDB_TRAILER,  /* struct nvdb_trailer; its checksum is its own last member */
    NVDB_SECTION_COUNT
};
static_assert((int)NVDB_SECTION_COUNT == (int)FMT_NVDB_SECTION_COUNT, "sections");

#define NVDB_TRAILER_MAGIC "BISQUE\r\n"
enum { NVDB_TRAILER_HAS_COLOR = 1, NVDB_TRAILER_HAS_IDS = 2, NVDB_TRAILER_HAS_CHANNELS = 4 };

/* Names follow: for each a uint32_t with its bytes, and these. */
struct nvdb_names_head {
    uint32_t ids; /* enum fmt_ids */
    uint32_t count;
};
static_assert(sizeof(struct nvdb_names_head) == 8, "head of the names");

/* The list follows, and zeros up to a multiple of NVDB_ALIGNMENT. */
struct nvdb_channels_head {
    uint32_t words; /* values of a record */
    uint32_t list_bytes;
};
static_assert(sizeof(struct nvdb_channels_head) == 8, "head of the channels");

/* The trailer, which is the last blind data. */
struct nvdb_trailer {
    char magic[8];
    uint32_t version, flags;
    uint64_t source_triangles, second_count;
    double scan_min[3], scan_max[3];
    uint64_t checksum[NVDB_CHANNELS]; /* XXH3-64 of each section before; 0 for those of ids if the
                                         grid has none */
    uint64_t name_bytes;              /* likewise */
    uint64_t channels_checksum;       /* of that section; 0 without it */
    uint64_t trailer_checksum;        /* XXH3-64 of all members above */
};
static_assert(sizeof(struct nvdb_trailer) == 192, "bisque trailer");

/* The counts that determine a layout. */
struct nvdb_counts {
    uint32_t flags; /* of the trailer: which sections the grid has */
    uint32_t uppers, lowers, leaves;
    uint64_t voxels, seconds, name_bytes;
    uint32_t channel_words, channel_list_bytes; /* 0: no channels */
};

/* A row of the table of sections. From NVDB_NORMALS on they are channels: NanoVDB's terms describe
 * them. */
struct nvdb_row {
    const char *name; /* of the channel, or for messages */
    uint32_t semantic, data_type, value_bytes;
    uint32_t flag;   /* of the trailers of grids that have the section; 0: all grids do */
    bool per_record; /* it has values for each record: those of second records come last */
    bool grows;      /* with the voxels */
};
extern const struct nvdb_row fmt_nvdb_rows[NVDB_SECTION_COUNT];

/* Returns the flags of a grid that has these. */
static inline uint32_t nvdb_flags(bool color, enum fmt_ids ids, bool channels)
{
    return (color ? NVDB_TRAILER_HAS_COLOR : 0) | (ids != FMT_IDS_NONE ? NVDB_TRAILER_HAS_IDS : 0) |
           (channels ? NVDB_TRAILER_HAS_CHANNELS : 0);
}

/* Returns whether a grid with these flags has a section. */
static inline bool nvdb_has(uint32_t flags, int section)
{
    return (fmt_nvdb_rows[section].flag & ~flags) == 0;
}

/* Returns the version of a trailer with these flags. */
static inline uint32_t nvdb_trailer_version(uint32_t flags)
{
    return flags & NVDB_TRAILER_HAS_CHANNELS ? FMT_NVDB_TRAILER_VERSION_CHANNELS
           : flags & NVDB_TRAILER_HAS_IDS    ? FMT_NVDB_TRAILER_VERSION_IDS
                                             : FMT_NVDB_TRAILER_VERSION;
}

/* Returns the place of the checksum of a section before the trailer. Without a section it is 0, but
 * without colours it is the checksum of no bytes. */
static inline uint64_t *nvdb_checksum(struct nvdb_trailer *trailer, int section)
{
    return section == NVDB_CHANNELS ? &trailer->channels_checksum : &trailer->checksum[section];
}
static inline bool nvdb_has_checksum(uint32_t flags, int section)
{
    return section == NVDB_COLORS || nvdb_has(flags, section);
}

/* Upper and lower nodes: both are a struct nvdb_node, and these words follow: the value mask and
 * the child mask, four of statistics, and the table of children. */
struct nvdb_level {
    const char *name;
    enum nvdb_section section, child_section;
    uint32_t words;         /* of a mask */
    uint32_t log2_cells;    /* children along the edge of a node */
    int32_t dim, child_dim; /* voxels along the edge of a node, and of a child */
    uint64_t node_bytes, child_bytes;
};
extern const struct nvdb_level fmt_nvdb_upper, fmt_nvdb_lower;

struct nvdb_node {
    int32_t bbox_min[3], bbox_max[3];
    uint64_t flags;
};

static inline const uint64_t *nvdb_value_mask(const struct nvdb_node *node)
{
    return (const uint64_t *)(const void *)(node + 1);
}
static inline const uint64_t *nvdb_child_mask(const struct nvdb_level *level,
                                              const struct nvdb_node *node)
{
    return nvdb_value_mask(node) + level->words;
}
static inline const uint64_t *nvdb_statistics(const struct nvdb_level *level,
                                              const struct nvdb_node *node)
{
    return nvdb_value_mask(node) + 2 * level->words;
}
static inline const int64_t *nvdb_table(const struct nvdb_level *level,
                                        const struct nvdb_node *node)
{
    return (const int64_t *)(const void *)(nvdb_statistics(level, node) + 4);
}

/* Computes the offsets of all sections. Nothing overflows if voxels <= 512 * leaves, seconds <=
 * voxels, name_bytes is below 2^61 and channel_words at most FMT_CHANNEL_VALUES_MAX. */
void fmt_nvdb_layout_compute(const struct nvdb_counts *counts, struct fmt_nvdb_layout *layout);

/* Returns the key of the root tile that contains a voxel. */
static inline uint64_t nvdb_root_key(const int32_t ijk[3])
{
    return (uint64_t)((uint32_t)ijk[0] >> 12) << 42 | (uint64_t)((uint32_t)ijk[1] >> 12) << 21 |
           (uint64_t)((uint32_t)ijk[2] >> 12);
}

/* Returns the cell of a voxel's lower node in its upper node. */
static inline uint32_t nvdb_upper_cell(const int32_t ijk[3])
{
    return ((uint32_t)ijk[0] >> 7 & 31) << 10 | ((uint32_t)ijk[1] >> 7 & 31) << 5 |
           ((uint32_t)ijk[2] >> 7 & 31);
}

static inline uint32_t nvdb_popcount(uint64_t bits)
{
    return (uint32_t)__builtin_popcountll(bits);
}

/* Returns the voxel count of a leaf at `origin`, and sets the bounds of its voxels unless it is 0.
 */
uint32_t fmt_nvdb_leaf_bounds(const int32_t origin[3], const uint64_t mask[8], int32_t bbox_min[3],
                              int32_t bbox_max[3]);
/* Returns the seven prefix sums of a leaf's mask, packed. */
uint64_t fmt_nvdb_prefix_sum(const uint64_t mask[8]);

/* Make a box empty; extend it to contain another one. */
void fmt_nvdb_bbox_clear(int32_t bbox_min[3], int32_t bbox_max[3]);
void fmt_nvdb_bbox_extend(int32_t bbox_min[3], int32_t bbox_max[3], const int32_t other_min[3],
                          const int32_t other_max[3]);

/* Fills the file header and its metadata, which repeat numbers of GridData, TreeData and RootData.
 */
void fmt_nvdb_fill_file_head(struct nvdb_fixed *fixed);
/* Fills section NVDB_HEAD up to the tiles, layout->tiles bytes, with zeros for the checksum. Reads
 * only voxel size and translation of `info`. */
void fmt_nvdb_fill_fixed(const struct fmt_nvdb_info *info, const struct nvdb_counts *counts,
                         const struct fmt_nvdb_layout *layout, const int32_t bbox_min[3],
                         const int32_t bbox_max[3], uint8_t *head);
/* Fills section NVDB_BLIND. */
void fmt_nvdb_fill_blind(const struct fmt_nvdb_layout *layout, struct nvdb_blind *blind);

/* Returns NanoVDB's checksum of a grid's head: GridData after its checksum, TreeData, RootData and
 * tiles. That is NanoVDB's default mode. Its full mode is not used because it covers other bytes in
 * 32.6 than in 32.4; the trailer has checksums of all sections instead. */
uint32_t fmt_nvdb_head_crc(const uint8_t *head, const struct fmt_nvdb_layout *layout);
uint64_t fmt_nvdb_trailer_checksum(const struct nvdb_trailer *trailer);

/* The two steps of fmt_nvdb_open() after mapping the file. The first checks that Bisque wrote the
 * file and that its sections are in place, and fills in `grid` except for the map; the second
 * checks all nodes. Errors: BSQ_EDATA. */
int fmt_nvdb_check_header(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid);
int fmt_nvdb_check_nodes(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

/* Returns the bytes of section NVDB_CHANNELS before its values. */
static inline uint64_t nvdb_channels_head_bytes(uint32_t list_bytes)
{
    return bsq_align_up(sizeof(struct nvdb_channels_head) + (uint64_t)list_bytes, NVDB_ALIGNMENT);
}

/* Returns the trailer of a grid that fmt_nvdb_check_header() accepted. */
static inline const struct nvdb_trailer *nvdb_trailer_of(const struct fmt_nvdb_grid *grid)
{
    return (const struct nvdb_trailer *)((const char *)grid->map.data +
                                         grid->layout.section[NVDB_TRAILER].offset);
}

/* Bytes that OpenVDB takes for nodes of vectors and of bits, with malloc's overhead: the memory of
 * the program bisque-vdb, which its caller reserves. vdb_program.cc checks them. */
enum {
    VDB_VECTOR_LEAF = 128 + 512 * 12,
    VDB_VECTOR_LOWER = 66608,
    VDB_VECTOR_UPPER = 532624,
    VDB_BIT_LEAF = 112,
    VDB_BIT_LOWER = 33840,
    VDB_BIT_UPPER = 270480
};

#ifdef __cplusplus
}
#endif
#endif
