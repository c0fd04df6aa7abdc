/* nvdb_reader.c - checks that Bisque wrote a file, finds its sections, and opens it.
 *
 * A few counts determine the layout. They are read first and bounded by the file's size. Then the
 * layout is computed from them, and every offset and count in the file must agree with it. All
 * checks and results are of a copy of the header, because the file may change meanwhile. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "formats/material/channels.h"
#include "formats/grid/nvdb_layout_internal.h"

struct head {
    struct bsq_ctx *ctx;
    const char *path;
    const uint8_t *file;
    uint64_t size;
    struct nvdb_fixed fixed; /* copied, with zeros after the end of the file */
    /* Valid after read_trailer(), read_counts() and nvdb_read_channels(). */
    struct nvdb_trailer trailer;
    struct nvdb_counts counts;
    struct fmt_nvdb_layout layout;
};

static int damaged(const struct head *h, const char *what)
{
    return bsq_fail(h->ctx, BSQ_EDATA, "%s: damaged: wrong %s", h->path, what);
}

static int fail_version(const struct head *h)
{
    uint32_t v = h->fixed.header.version;
    return bsq_fail(h->ctx, BSQ_EDATA,
                    "%s: NanoVDB file of version %" PRIu32 ".%" PRIu32 ".%" PRIu32
                    ": Bisque reads 32.4.2; make the grid with bisque-voxelize",
                    h->path, v >> 21, v >> 10 & 2047, v & 1023);
}

/* Copies a name for a message; characters that are not printable ASCII become '?'. */
static void nvdb_copy_name(const char *from, uint64_t size, char out[64])
{
    uint64_t n = 0;
    while (n < size && n < 63 && from[n] != 0) {
        unsigned char c = (unsigned char)from[n];
        out[n++] = c >= 32 && c < 127 ? (char)c : '?';
    }
    out[n] = 0;
}

/* Reports a grid that another NanoVDB program wrote, with its name and type. */
static int fail_foreign(const struct head *h)
{
    static const char *const types[] = {
        "?",      "float", "double", "int16", "int32",   "int64",     "Vec3f",      "Vec3d",
        "Mask",   "Half",  "uint32", "bool",  "RGBA8",   "Float4",    "Float8",     "Float16",
        "FloatN", "Vec4f", "Vec4d",  "Index", "OnIndex", "IndexMask", "OnIndexMask"};
    char name[64];
    const uint64_t start = offsetof(struct nvdb_fixed, name), available = h->size - start;
    nvdb_copy_name((const char *)h->file + start,
                   h->fixed.meta.name_bytes < available ? h->fixed.meta.name_bytes : available,
                   name);
    uint32_t type = h->fixed.meta.grid_type;
    if (type == 0 || type >= sizeof(types) / sizeof(*types))
        return bsq_fail(h->ctx, BSQ_EDATA,
                        "%s: grid \"%s\" of type number %" PRIu32 " is not a Bisque surface grid",
                        h->path, name, type);
    return bsq_fail(h->ctx, BSQ_EDATA, "%s: grid \"%s\" of type %s is not a Bisque surface grid",
                    h->path, name, types[type]);
}

/* Reports a file that another program compressed: it cannot be used in place. */
static int fail_compressed(const struct head *h)
{
    static const char *const codecs[] = {"none", "ZIP", "BLOSC"};
    uint16_t codec = h->fixed.header.codec;
    return bsq_fail(h->ctx, BSQ_EDATA,
                    "%s: compressed NanoVDB file (codec %s): Bisque reads uncompressed ones",
                    h->path, codec < 3 ? codecs[codec] : "unknown");
}

/* Checks magic, version, type and codec. Files that fail here are mostly not damaged: they are of
 * another kind, and the messages name it. */
static int check_file_header(struct head *h)
{
    if (h->size >= sizeof(uint64_t) &&
        (__builtin_bswap64(h->fixed.header.magic) == NVDB_MAGIC ||
         __builtin_bswap64(h->fixed.header.magic) == NVDB_MAGIC_FILE))
        return bsq_fail(h->ctx, BSQ_EDATA,
                        "%s: NanoVDB file of a big-endian machine: Bisque reads little-endian ones",
                        h->path);
    if (h->size < sizeof(uint64_t) ||
        (h->fixed.header.magic != NVDB_MAGIC && h->fixed.header.magic != NVDB_MAGIC_GRID &&
         h->fixed.header.magic != NVDB_MAGIC_FILE))
        return bsq_fail(h->ctx, BSQ_EDATA, "%s: not a NanoVDB file", h->path);
    if (h->size < NVDB_ROOT_TILES_OFFSET)
        return bsq_fail(h->ctx, BSQ_EDATA, "%s: truncated: %" PRIu64 " bytes are too few", h->path,
                        h->size);
    if (h->fixed.header.magic == NVDB_MAGIC_GRID)
        return bsq_fail(h->ctx, BSQ_EDATA, "%s: a NanoVDB grid without file header", h->path);
    if (h->fixed.header.magic == NVDB_MAGIC_FILE || h->fixed.header.version != NVDB_GRID_VERSION)
        return fail_version(h);
    if (h->fixed.header.grid_count != 1)
        return bsq_fail(h->ctx, BSQ_EDATA, "%s: %u grids: a Bisque surface grid stands alone",
                        h->path, h->fixed.header.grid_count);
    if (h->fixed.meta.grid_type != NVDB_TYPE_MASK)
        return fail_foreign(h);
    if (h->fixed.header.codec != 0)
        return fail_compressed(h);
    if (h->fixed.meta.name_bytes != NVDB_NAME_BYTES)
        return fail_foreign(h);
    return 0;
}

/* Checks the numbers that the rest of the head is computed from, see check_head(). */
static int check_grid_data(const struct head *h)
{
    const struct nvdb_grid_data *grid = &h->fixed.grid;
    if (grid->grid_bytes != h->size - FMT_NVDB_GRID_OFFSET)
        return bsq_fail(h->ctx, BSQ_EDATA,
                        "%s: truncated or damaged: the grid has %" PRIu64
                        " bytes, the file has %" PRIu64 " for it",
                        h->path, grid->grid_bytes, h->size - FMT_NVDB_GRID_OFFSET);
    if (grid->version != h->fixed.header.version || grid->grid_type != h->fixed.meta.grid_type)
        return damaged(h, "version or type of the grid");
    if (strncmp(grid->name, NVDB_GRID_NAME, sizeof(grid->name)) != 0)
        return fail_foreign(h);
    double size = grid->map.matrix[0];
    if (!(size > 0.0) || !isfinite(size) || !isfinite(1.0 / size))
        return damaged(h, "voxel size");
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(grid->map.translation[axis]) ||
            h->fixed.root.bbox_min[axis] > h->fixed.root.bbox_max[axis])
            return damaged(h, "translation or bounds");
    return 0;
}

/* Returns whether the trailer is as a writer would write it for the grid that it describes. */
static bool is_trailer_valid(const struct nvdb_trailer *trailer)
{
    const uint32_t known =
        NVDB_TRAILER_HAS_COLOR | NVDB_TRAILER_HAS_IDS | NVDB_TRAILER_HAS_CHANNELS;
    struct nvdb_trailer expected = *trailer;
    expected.flags &= known;
    expected.version = nvdb_trailer_version(expected.flags);
    for (int i = 0; i < NVDB_TRAILER; i++)
        if (!nvdb_has_checksum(expected.flags, i))
            *nvdb_checksum(&expected, i) = 0;
    if (!nvdb_has(expected.flags, NVDB_NAMES))
        expected.name_bytes = 0;
    expected.trailer_checksum = fmt_nvdb_trailer_checksum(&expected);
    const unsigned char *found = (const unsigned char *)trailer; /* copied from the file as it is */
    return memcmp(found, (const unsigned char *)&expected, sizeof expected) == 0;
}

static int read_trailer(struct head *h)
{
    struct nvdb_trailer *trailer = &h->trailer;
    memcpy(trailer, h->file + h->size - sizeof *trailer, sizeof *trailer);
    if (memcmp(trailer->magic, NVDB_TRAILER_MAGIC, sizeof trailer->magic) != 0)
        return fail_foreign(h);
    if (trailer->version < FMT_NVDB_TRAILER_VERSION ||
        trailer->version > FMT_NVDB_TRAILER_VERSION_CHANNELS)
        return bsq_fail(
            h->ctx, BSQ_EDATA,
            "%s: surface grid of version %" PRIu32 ": this Bisque reads versions %d to %d", h->path,
            trailer->version, FMT_NVDB_TRAILER_VERSION, FMT_NVDB_TRAILER_VERSION_CHANNELS);
    if (!is_trailer_valid(trailer))
        return damaged(h, "\"bisque\" trailer");
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(trailer->scan_min[axis]) || !isfinite(trailer->scan_max[axis]) ||
            trailer->scan_min[axis] > trailer->scan_max[axis])
            return damaged(h, "scan bounds");
    return 0;
}

/* Reads the counts that determine the layout, except for those of channels. The limits bound them
 * so that fmt_nvdb_layout_compute() cannot overflow. */
static int read_counts(struct head *h)
{
    const struct nvdb_tree_data *tree = &h->fixed.tree;
    struct nvdb_counts *counts = &h->counts;
    *counts = (struct nvdb_counts){
        .flags = h->trailer.flags,
        .leaves = tree->node_count[0],
        .lowers = tree->node_count[1],
        .uppers = tree->node_count[2],
        .voxels = tree->voxel_count,
        .seconds = h->trailer.second_count,
        .name_bytes = h->trailer.name_bytes,
    };
    if (counts->uppers == 0 || counts->lowers < counts->uppers || counts->leaves < counts->lowers ||
        counts->voxels < counts->leaves || counts->voxels / 512 > counts->leaves)
        return damaged(h, "node counts");
    if (counts->seconds > counts->voxels || counts->seconds > UINT32_MAX ||
        counts->name_bytes >> 61 != 0)
        return damaged(h, "\"bisque\" trailer");
    return 0;
}

/* Reads how many values the channels have, from the list at the beginning of their section, and
 * computes the layout. How many they are does not change where the section begins. */
static int nvdb_read_channels(struct head *h)
{
    struct nvdb_channels_head head;
    fmt_nvdb_layout_compute(&h->counts, &h->layout);
    if (!nvdb_has(h->counts.flags, NVDB_CHANNELS))
        return 0;
    const uint64_t offset = h->layout.section[NVDB_CHANNELS].offset;
    if (offset > h->size || h->size - offset < sizeof head)
        return damaged(h, "list of channels");
    memcpy(&head, h->file + offset, sizeof head);
    const uint8_t *list = h->file + offset + sizeof head;
    const uint64_t bytes = nvdb_channels_head_bytes(head.list_bytes);
    if (h->size - offset < bytes || head.words == 0 ||
        fmt_channel_list_values((const char *)list, head.list_bytes) != head.words)
        return damaged(h, "list of channels");
    for (uint64_t i = head.list_bytes; i < bytes - sizeof head; i++)
        if (list[i] != 0)
            return damaged(h, "list of channels");
    h->counts.channel_words = head.words;
    h->counts.channel_list_bytes = head.list_bytes;
    fmt_nvdb_layout_compute(&h->counts, &h->layout);
    return 0;
}

/* Compares the file up to the root's tiles, except for the CRC-32, with what a writer would write
 * for these counts, this transform and these bounds. */
static int check_fixed(const struct head *h)
{
    const uint64_t crc_at = FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, checksum);
    const struct {
        uint64_t end;
        const char *name;
    } ranges[] = {{FMT_NVDB_GRID_OFFSET, "file header"},
                  {offsetof(struct nvdb_fixed, tree), "GridData"},
                  {NVDB_ROOT_OFFSET, "TreeData"},
                  {NVDB_ROOT_TILES_OFFSET, "RootData"}};
    uint8_t expected[NVDB_ROOT_TILES_OFFSET];
    const struct nvdb_map *map = &h->fixed.grid.map;
    struct fmt_nvdb_info info = {.voxel_size = map->matrix[0]};
    memcpy(info.translation, map->translation, sizeof(info.translation));
    fmt_nvdb_fill_fixed(&info, &h->counts, &h->layout, h->fixed.root.bbox_min,
                        h->fixed.root.bbox_max, expected);
    memcpy(expected + crc_at, h->file + crc_at, sizeof(h->fixed.grid.checksum[0]));
    memset(expected + crc_at + 4, 0xff, sizeof(h->fixed.grid.checksum[1]));
    uint64_t begin = 0;
    for (int i = 0; i < 4; begin = ranges[i++].end)
        if (memcmp(h->file + begin, expected + begin, ranges[i].end - begin) != 0)
            return damaged(h, ranges[i].name);
    return 0;
}

/* Compares offsets, sizes and all that can be computed with the file. */
static int check_head(const struct head *h)
{
    const struct fmt_nvdb_range *descriptions = &h->layout.section[NVDB_BLIND];
    struct nvdb_blind blind[NVDB_SECTION_COUNT];
    if (h->layout.file_bytes != h->size)
        return damaged(h, h->layout.file_bytes > h->size ? "node counts" : "file size");
    BSQ_PASS(check_fixed(h));
    fmt_nvdb_fill_blind(&h->layout, blind);
    if (memcmp(h->file + descriptions->offset, blind, descriptions->size) != 0)
        return damaged(h, "channel descriptions");
    if (fmt_nvdb_head_crc(h->file, &h->layout) != h->fixed.grid.checksum[0])
        return damaged(h, "checksum of the grid's header");
    return 0;
}

/* Returns a section of the file, NULL if the grid lacks it. */
static const void *nvdb_section_of(const struct head *h, enum nvdb_section section)
{
    const bool has = nvdb_has(h->counts.flags, section);
    return has ? h->file + h->layout.section[section].offset : NULL;
}

static void fill_grid(const struct head *h, struct fmt_nvdb_grid *grid)
{
    const struct nvdb_fixed *fixed = &h->fixed;
    const struct nvdb_trailer *trailer = &h->trailer;
    const struct nvdb_counts *counts = &h->counts;
    grid->layout = h->layout;
    grid->flags = counts->flags;
    grid->info.has_color = nvdb_has(counts->flags, NVDB_COLORS);
    grid->info.voxel_size = fixed->grid.map.matrix[0];
    grid->info.source_triangles = trailer->source_triangles;
    memcpy(grid->info.translation, fixed->grid.map.translation, sizeof(grid->info.translation));
    memcpy(grid->info.scan_min, trailer->scan_min, sizeof(grid->info.scan_min));
    memcpy(grid->info.scan_max, trailer->scan_max, sizeof(grid->info.scan_max));
    memcpy(grid->index_min, fixed->root.bbox_min, sizeof(grid->index_min));
    memcpy(grid->index_max, fixed->root.bbox_max, sizeof(grid->index_max));
    grid->grid = h->file + FMT_NVDB_GRID_OFFSET;
    grid->root = h->file + NVDB_ROOT_OFFSET;
    grid->root_tiles = h->file + NVDB_ROOT_TILES_OFFSET;
    grid->uppers = nvdb_section_of(h, NVDB_UPPERS);
    grid->lowers = nvdb_section_of(h, NVDB_LOWERS);
    grid->leaves = nvdb_section_of(h, NVDB_LEAVES);
    grid->root_tile_count = grid->upper_count = counts->uppers;
    grid->lower_count = counts->lowers;
    grid->leaf_count = counts->leaves;
    grid->upper_bytes = sizeof(struct nvdb_upper);
    grid->lower_bytes = sizeof(struct nvdb_lower);
    grid->voxel_count = counts->voxels;
    grid->record_count = h->layout.record_count;
    grid->normals = nvdb_section_of(h, NVDB_NORMALS);
    grid->planes = nvdb_section_of(h, NVDB_PLANES);
    grid->colors = nvdb_section_of(h, NVDB_COLORS);
    grid->seconds = nvdb_section_of(h, NVDB_SECONDS);
    grid->ids = nvdb_section_of(h, NVDB_IDS);
    grid->names = nvdb_section_of(h, NVDB_NAMES);
    grid->name_bytes = counts->name_bytes;
    grid->channel_words = counts->channel_words;
    grid->channel_list_bytes = counts->channel_list_bytes;
    const uint8_t *channels = nvdb_section_of(h, NVDB_CHANNELS);
    if (!channels)
        return;
    grid->channel_list = (const char *)channels + sizeof(struct nvdb_channels_head);
    grid->channels =
        (const void *)(channels + nvdb_channels_head_bytes(counts->channel_list_bytes));
}

/* ---- names ---- */

/* A name in the file: bytes that another process may change. */
struct name {
    const uint8_t *bytes;
    uint32_t length;
};

/* Finds the name at byte *at of the section and moves *at past it. Returns false if it is cut off.
 */
static bool next_name(const struct fmt_nvdb_grid *grid, uint64_t *at, struct name *out)
{
    const uint64_t left = grid->name_bytes - *at;
    if (left < sizeof out->length)
        return false;
    memcpy(&out->length, grid->names + *at, sizeof out->length);
    if (left - sizeof out->length < out->length)
        return false;
    out->bytes = grid->names + *at + sizeof out->length;
    *at += sizeof out->length + out->length;
    return true;
}

static bool nvdb_is_before(const struct name *a, const struct name *b)
{
    const uint32_t both = a->length < b->length ? a->length : b->length;
    const int order = memcmp(a->bytes, b->bytes, both);
    return order != 0 ? order < 0 : a->length < b->length;
}

/* Returns whether the names of a mapped grid are as FORMATS.md describes, and sets grid->info.ids.
 */
static bool check_names(struct fmt_nvdb_grid *grid)
{
    struct nvdb_names_head head;
    struct name last = {0}, name;
    uint64_t at = sizeof head;
    if (grid->name_bytes < sizeof head)
        return false;
    memcpy(&head, grid->names, sizeof head);
    if (head.ids < FMT_IDS_MATERIAL || head.ids > FMT_IDS_COLOR ||
        (head.ids == FMT_IDS_COLOR && head.count > 0))
        return false;
    for (uint32_t i = 0; i < head.count; i++) {
        if (!next_name(grid, &at, &name) || memchr(name.bytes, 0, name.length) ||
            (i > 0 && !nvdb_is_before(&last, &name)))
            return false;
        last = name;
    }
    grid->info.ids = (enum fmt_ids)head.ids;
    return at == grid->name_bytes;
}

int fmt_nvdb_check_header(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    struct head h = {
        .ctx = ctx, .path = grid->map.path, .file = grid->map.data, .size = grid->map.size};
    if (h.size > 0)
        memcpy(&h.fixed, h.file, h.size < sizeof h.fixed ? h.size : sizeof h.fixed);
    BSQ_PASS(check_file_header(&h));
    BSQ_PASS(check_grid_data(&h));
    BSQ_PASS(read_trailer(&h));
    BSQ_PASS(read_counts(&h));
    BSQ_PASS(nvdb_read_channels(&h));
    BSQ_PASS(check_head(&h));
    fill_grid(&h, grid);
    if (grid->names && !check_names(grid))
        return damaged(&h, "names of ids");
    return 0;
}

/* ---- opening ---- */

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
    BSQ_PASS(bsq_map_open(ctx, path, &out->map));
    return check_mapped(ctx, out);
}

int fmt_nvdb_open_file(struct bsq_ctx *ctx, struct bsq_file *file, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    BSQ_PASS(bsq_map_file(ctx, file, &out->map));
    return check_mapped(ctx, out);
}

void fmt_nvdb_close(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    bsq_map_close(ctx, &grid->map);
    memset(grid, 0, sizeof(*grid));
}

int fmt_nvdb_trailer_version(const struct fmt_nvdb_grid *grid)
{
    return (int)nvdb_trailer_version(grid->flags);
}

uint64_t fmt_nvdb_second(const struct fmt_nvdb_grid *grid, uint64_t v)
{
    assert(v <= grid->voxel_count);
    const uint32_t *word = grid->seconds[v / 32];
    uint32_t bit = UINT32_C(1) << (v % 32);
    uint64_t second = 1 + grid->voxel_count + word[1] + nvdb_popcount(word[0] & (bit - 1));
    return word[0] & bit && second < grid->record_count ? second : 0;
}

int fmt_nvdb_read_names(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                        int (*fn)(void *arg, const char *name), void *arg)
{
    struct name name;
    int status = 0;
    for (uint64_t at = sizeof(struct nvdb_names_head); at < grid->name_bytes && status == 0;) {
        char *text;
        if (!next_name(grid, &at, &name))
            return bsq_fail(ctx, BSQ_EIO, "%s: was changed while it was read", grid->map.path);
        BSQ_PASS(bsq_alloc(ctx, "name of an id", (uint64_t)name.length + 1, 1, &text));
        memcpy(text, name.bytes, name.length);
        text[name.length] = '\0';
        status = fn(arg, text);
        bsq_free(ctx, text);
    }
    return status;
}
