/* read_nvdb.c - a second reader of grid files, written from formats/FORMATS.md alone.
 *
 *   naive-read-nvdb FILE          checks each byte; prints counts and sums over the voxels
 *   naive-read-nvdb FILE POINTS   also looks up points of a text file, one a line: "x y z" in world
 *                                 space or "x y z red green blue" with colours from 0 to 1. Prints
 *                                 how many are in a voxel, and how far they are from its plane and
 *                                 colour.
 */
#include "bytes.h"

enum { GRID = 224, TREE = 896, ROOT = 960, TILE_BYTES = 32 };
enum { UPPER_BYTES = 270400, LOWER_BYTES = 33856, LEAF_BYTES = 96, BLIND_BYTES = 288 };
enum {
    HEAD,
    UPPERS,
    LOWERS,
    LEAVES,
    BLIND,
    NORMAL,
    PLANE,
    COLOR,
    SECOND,
    IDS,
    NAMES,
    CHANNELS,
    RECORD,
    SECTIONS
};
enum {
    MASK = 8,
    ONINDEX = 20,
    RECORD_BYTES = 192,
    SECOND_BIT = 1 << 24,
    SHADED_BIT = 1 << 25,
    SUMMED = 4
};

struct box {
    int64_t low[3], high[3];
};

struct sums {
    uint64_t seconds, shaded;
    double normal[3], offset, coverage, color[3];
    double channels[SUMMED]; /* of the first values */
};

struct grid {
    struct bytes file;
    uint32_t type, version;
    int has_color, has_ids, has_channels;
    uint64_t uppers, lowers, leaves, voxels, seconds, records, root_bytes, name_bytes;
    uint64_t words, channels_head; /* of `channels` */
    uint64_t at[SECTIONS], size[SECTIONS];
    double h, translation[3];
    struct box box;
    /* During the walk: the next node and voxel of each kind. */
    uint64_t next_upper, next_lower, next_leaf, next_value;
    struct sums sums;
};

/* A kind of internal node: an upper node has 32^3 lower nodes, a lower node has 16^3 leaves. */
struct kind {
    uint64_t children, child_edge;
    unsigned bits;
};
static const struct kind upper_kind = {32768, 128, 5}, lower_kind = {4096, 8, 4};

/* ---- layout ---- */

static void read_counts(struct grid *g)
{
    const struct bytes *file = &g->file;
    g->version = u32(file, 8);
    g->type = u32(file, 48);
    int mask = g->type == MASK && g->version == (32u << 21 | 4u << 10 | 2u);
    int indexed = g->type == ONINDEX && g->version == (32u << 21 | 6u << 10 | 0u);
    if (!mask && !indexed)
        refuse(file, "version %u.%u.%u with grid type %u is not known", g->version >> 21,
               g->version >> 10 & 2047, g->version & 1023, g->type);
    g->root_bytes = indexed ? 96 : 64;
    g->leaves = u32(file, TREE + 32);
    g->lowers = u32(file, TREE + 36);
    g->uppers = u32(file, TREE + 40);
    g->voxels = u64(file, TREE + 56);
    require(file,
            g->uppers >= 1 && g->lowers >= g->uppers && g->leaves >= g->lowers &&
                g->voxels >= g->leaves && g->voxels <= 512 * g->leaves,
            "wrong counts");
    uint32_t channels = u32(file, GRID + 648);
    uint32_t flags = u32(file, file->size - RECORD_BYTES + 12);
    g->has_color = flags & 1;
    g->has_ids = flags >> 1 & 1;
    g->has_channels = flags >> 2 & 1;
    require(file, flags < 8 && channels == 4 + (flags & 1) + (flags & 2) + (flags >> 2),
            "wrong number of channels");
}

static void check_record(struct grid *g)
{
    const struct bytes *file = &g->file;
    require(file, file->size > RECORD_BYTES, "no bisque record");
    uint64_t at = file->size - RECORD_BYTES;
    require_text(file, at, "BISQUE\r\n", "no bisque record");
    if (u32(file, at + 8) < 2 || u32(file, at + 8) > 4)
        refuse(file, "bisque record of version %u, this reader knows 2 to 4", u32(file, at + 8));
    require(file,
            u32(file, at + 8) == (g->has_channels ? 4u
                                  : g->has_ids    ? 3u
                                                  : 2u),
            "ids or channels in another version");
    require(file, u64(file, at + 184) == checksum(file, at, 184), "wrong checksum of the record");
    if (!g->has_ids)
        require_zeros(file, at + 152, 24);
    if (!g->has_channels)
        require_zeros(file, at + 176, 8);
    g->name_bytes = u64(file, at + 168);
    require(file, g->name_bytes < file->size, "wrong bytes of names");
    g->seconds = u64(file, at + 24);
    require(file, g->seconds <= g->voxels && g->seconds <= UINT32_MAX, "wrong second records");
    g->records = 1 + g->voxels + g->seconds;
}

/* Reads the names of further channels, which begin at g->at[CHANNELS]. Returns the bytes of the
 * section. */
static uint64_t read_channels(struct grid *g)
{
    static const char *const single[] = {"roughness",
                                         "metallic",
                                         "sheen",
                                         "clearcoat",
                                         "clearcoat_roughness",
                                         "anisotropy",
                                         "anisotropy_rotation",
                                         "shininess",
                                         "opacity",
                                         "occlusion",
                                         "displacement"};
    const struct bytes *file = &g->file;
    uint64_t at = g->at[CHANNELS], bytes = u32(file, at + 4), words = 0, length = 0;
    g->words = u32(file, at);
    g->channels_head = (8 + bytes + 63) / 64 * 64;
    require_zeros(file, at + 8 + bytes, g->channels_head - 8 - bytes);
    const char *list = (const char *)bytes_at(file, at + 8, bytes);
    for (uint64_t i = 0; i <= bytes; i++) {
        if (i < bytes && list[i] != ',') {
            int letter = list[i] >= 'a' && list[i] <= 'z';
            int more = (list[i] >= '0' && list[i] <= '9') || list[i] == '_';
            require(file, letter || (more && length > 0), "wrong name of a channel");
            length++;
            continue;
        }
        uint64_t values = 3;
        for (unsigned k = 0; k < sizeof single / sizeof *single; k++)
            if (strlen(single[k]) == length && memcmp(single[k], list + i - length, length) == 0)
                values = 1;
        require(file, length > 0, "empty name of a channel");
        words += values;
        length = 0;
    }
    require(file, words == g->words && words <= 65535, "wrong number of values of channels");
    return g->channels_head + 4 * g->records * g->words;
}

static void place_sections(struct grid *g)
{
    const struct bytes *file = &g->file;
    uint64_t channel = 4 * g->records, at = 0;
    uint64_t sizes[SECTIONS] = {960 + g->root_bytes + TILE_BYTES * g->uppers,
                                UPPER_BYTES * g->uppers,
                                LOWER_BYTES * g->lowers,
                                LEAF_BYTES * g->leaves,
                                u32(file, GRID + 648) * BLIND_BYTES,
                                channel,
                                channel,
                                g->has_color ? channel : 0,
                                8 * (g->voxels / 32 + 1),
                                g->has_ids ? channel : 0,
                                g->name_bytes,
                                0,
                                RECORD_BYTES};
    for (int i = 0; i < SECTIONS; i++) {
        uint64_t begin = i >= NORMAL ? (at + 63) / 64 * 64 : at;
        require_zeros(file, at, begin - at);
        g->at[i] = begin;
        if (i == CHANNELS && g->has_channels)
            sizes[i] = read_channels(g);
        g->size[i] = sizes[i];
        at = begin + sizes[i];
    }
    require(file, at == file->size, "the sections do not end with the file");
}

static void check_sums(const struct grid *g)
{
    const struct bytes *file = &g->file;
    for (int i = 0; i < (g->has_ids ? CHANNELS : IDS); i++)
        if (u64(file, g->at[RECORD] + 80 + 8 * (uint64_t)i) != checksum(file, g->at[i], g->size[i]))
            refuse(file, "wrong checksum of section %d", i);
    if (g->has_channels &&
        u64(file, g->at[RECORD] + 176) != checksum(file, g->at[CHANNELS], g->size[CHANNELS]))
        refuse(file, "wrong checksum of channels");
    uint32_t crc = 0xffffffffu;
    for (uint64_t at = GRID + 16; at < g->at[UPPERS]; at++) {
        crc ^= file->data[at];
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
    }
    require(file, u32(file, GRID + 8) == ~crc, "wrong CRC-32");
    require(file, u32(file, GRID + 12) == 0xffffffffu, "the nodes have a checksum of NanoVDB");
}

/* ---- head ---- */

static void check_u32s(const struct bytes *file, uint64_t at, uint64_t count,
                       const uint32_t *values)
{
    for (uint64_t i = 0; i < count; i++)
        if (u32(file, at + 4 * i) != values[i])
            refuse(file, "%u instead of %u at %llu", u32(file, at + 4 * i), values[i],
                   (unsigned long long)(at + 4 * i));
}

static void check_u64(const struct bytes *file, uint64_t at, uint64_t value)
{
    if (u64(file, at) != value)
        refuse(file, "%llu instead of %llu at %llu", (unsigned long long)u64(file, at),
               (unsigned long long)value, (unsigned long long)at);
}

static void check_same(const struct bytes *file, uint64_t a, uint64_t b, uint64_t size)
{
    require(file, memcmp(bytes_at(file, a, size), bytes_at(file, b, size), size) == 0,
            "what is in the file twice differs");
}

static void check_file_header(const struct grid *g)
{
    const struct bytes *file = &g->file;
    const uint32_t class = g->type == ONINDEX ? 8 : 6;
    uint64_t key = 0;
    for (const char *c = "surface"; *c; c++)
        key = 67 * key + (uint64_t)*c + (key >> 56);
    check_u32s(file, 12, 1, (uint32_t[]){1});
    check_u64(file, 16, file->size - GRID);
    check_u64(file, 24, file->size - GRID);
    check_u64(file, 32, key);
    check_u64(file, 40, g->voxels);
    check_u32s(file, 52, 1, &class);
    check_same(file, 56, GRID + 560, 48);
    check_same(file, 104, ROOT, 24);
    check_same(file, 128, GRID + 608, 24);
    check_u32s(file, 152, 10,
               (uint32_t[]){32, (uint32_t)g->leaves, (uint32_t)g->lowers, (uint32_t)g->uppers, 1, 0,
                            0, 0, 0, g->version});
    require_name(file, 192, "surface", 32);
}

/* Checks a matrix with its inverse, translation and taper, of f64 if `wide`, else of f32. */
static void check_map(const struct grid *g, uint64_t at, int wide)
{
    const struct bytes *file = &g->file;
    const uint64_t size = wide ? 8 : 4;
    for (uint64_t i = 0; i < 22; i++) {
        double value = wide ? f64(file, at + size * i) : (double)f32(file, at + size * i);
        double expected = i == 21            ? 1.0
                          : i >= 18          ? g->translation[i - 18]
                          : (i % 9) % 4 != 0 ? 0.0
                          : i < 9            ? g->h
                                             : 1.0 / g->h;
        require(file, value == (wide ? expected : (double)(float)expected), "wrong transform");
    }
}

static void check_grid_data(struct grid *g)
{
    const struct bytes *file = &g->file;
    const int indexed = g->type == ONINDEX;
    require_text(file, GRID, "NanoVDB0", "wrong magic of the grid");
    check_u32s(file, GRID + 16, 4, (uint32_t[]){g->version, 34, 0, 1});
    check_u64(file, GRID + 32, file->size - GRID);
    require_name(file, GRID + 40, "surface", 256);
    g->h = f64(file, GRID + 384);
    require(file, isfinite(g->h) && g->h > 0.0, "wrong voxel size");
    for (uint64_t k = 0; k < 3; k++) {
        g->translation[k] = f64(file, GRID + 528 + 8 * k);
        g->box.low[k] = i32(file, ROOT + 4 * k);
        g->box.high[k] = i32(file, ROOT + 12 + 4 * k);
        double low = fma((double)g->box.low[k], g->h, g->translation[k]);
        double high = fma((double)g->box.high[k] + 1.0, g->h, g->translation[k]);
        require(file,
                f64(file, GRID + 560 + 8 * k) == low && f64(file, GRID + 584 + 8 * k) == high &&
                    f64(file, GRID + 608 + 8 * k) == g->h,
                "wrong world bounds or voxel size");
    }
    check_map(g, GRID + 296, 0);
    check_map(g, GRID + 384, 1);
    check_u32s(file, GRID + 632, 2, (uint32_t[]){indexed ? 8 : 6, g->type});
    check_u64(file, GRID + 640, g->at[BLIND] - GRID);
    check_u32s(file, GRID + 652, 1, (uint32_t[]){0});
    check_u64(file, GRID + 656, 1 + g->voxels);
    if (indexed)
        require_text(file, GRID + 664, "NanoVDB1", "wrong data2");
    else
        check_u64(file, GRID + 664, 0);
}

static void check_tree_and_root(const struct grid *g)
{
    const struct bytes *file = &g->file;
    check_u64(file, TREE, g->at[LEAVES] - TREE);
    check_u64(file, TREE + 8, g->at[LOWERS] - TREE);
    check_u64(file, TREE + 16, g->at[UPPERS] - TREE);
    check_u64(file, TREE + 24, ROOT - TREE);
    require_zeros(file, TREE + 44, 12);
    check_u32s(file, ROOT + 24, 1, (uint32_t[]){(uint32_t)g->uppers});
    require_zeros(file, ROOT + 28, g->root_bytes - 28);
}

static void check_blind(const struct grid *g)
{
    static const struct {
        const char *name;
        uint32_t bytes, semantic, type;
    } channels[] = {{"normal", 4, 3, 10},   {"plane", 4, 0, 10}, {"color", 4, 2, 12},
                    {"second", 4, 0, 10},   {"id", 4, 0, 10},    {"names", 1, 0, 0},
                    {"channels", 4, 0, 10}, {"bisque", 1, 0, 0}};
    uint64_t at = g->at[BLIND];
    for (int i = 0; i < 8; i++) {
        if ((NORMAL + i == CHANNELS && !g->has_channels) ||
            (NORMAL + i == COLOR && !g->has_color) ||
            ((NORMAL + i == IDS || NORMAL + i == NAMES) && !g->has_ids))
            continue;
        check_u64(&g->file, at, g->at[NORMAL + i] - at);
        check_u64(&g->file, at + 8, g->size[NORMAL + i] / channels[i].bytes);
        check_u32s(&g->file, at + 16, 4,
                   (uint32_t[]){channels[i].bytes, channels[i].semantic, 4, channels[i].type});
        require_name(&g->file, at + 32, channels[i].name, 256);
        at += BLIND_BYTES;
    }
}

/* ---- names ---- */

/* Checks the names, and prints them if `print` is set. */
static void read_names(const struct grid *g, int print)
{
    const struct bytes *file = &g->file;
    uint64_t at = g->at[NAMES] + 8, end = g->at[NAMES] + g->size[NAMES];
    const char *last = NULL;
    uint32_t ids, last_length = 0;
    if (!g->has_ids)
        return;
    ids = u32(file, g->at[NAMES]);
    require(file, at <= end && ids >= 1 && ids <= 3, "unknown ids");
    if (print)
        printf("ids %u\n", ids);
    for (uint32_t left = u32(file, g->at[NAMES] + 4); left > 0; left--) {
        uint32_t length = u32(file, at);
        require(file, ids != 3 && at + 4 + length <= end, "names beyond their section");
        const char *name = (const char *)bytes_at(file, at + 4, length);
        require(file, length == 0 || memchr(name, 0, length) == NULL, "a name with a zero byte");
        if (last) {
            int order = memcmp(last, name, last_length < length ? last_length : length);
            require(file, order < 0 || (order == 0 && last_length < length), "names do not ascend");
        }
        if (print)
            printf("name %.*s\n", (int)length, name);
        last = name, last_length = length;
        at += 4 + length;
    }
    require(file, at == end, "names do not fill their section");
}

/* ---- records ---- */

static uint32_t channel(const struct grid *g, int section, uint64_t entry)
{
    require(&g->file, entry < g->records, "a record beyond the last");
    return u32(&g->file, g->at[section] + 4 * entry);
}

/* Returns value k of an entry of the channels. */
static double value_of(const struct grid *g, uint64_t entry, uint64_t k)
{
    uint32_t bits = u32(&g->file, g->at[CHANNELS] + g->channels_head + 4 * (entry * g->words + k));
    float value;
    memcpy(&value, &bits, sizeof value);
    return (double)value;
}

static double plane_offset(uint32_t plane)
{
    return (double)(int16_t)(uint16_t)plane / 32767.0;
}

/* Returns the number of a value index's second record, 0 if it has none. */
static uint64_t second_of(const struct grid *g, uint64_t value)
{
    uint64_t word = g->at[SECOND] + value / 32 * 8, below = 0;
    uint32_t bits = u32(&g->file, word);
    for (unsigned b = 0; b < value % 32; b++)
        below += bits >> b & 1;
    return bits >> value % 32 & 1 ? 1 + g->voxels + u32(&g->file, word + 4) + below : 0;
}

static int popcount(uint64_t bits)
{
    int count = 0;
    for (; bits; bits >>= 1)
        count += (int)(bits & 1);
    return count;
}

static void check_entry(struct grid *g, uint64_t entry)
{
    uint32_t plane = channel(g, PLANE, entry);
    require(&g->file, plane >> 29 == 0, "unknown bits in plane");
    require(&g->file, plane >> 26 == 0 || !(plane & SHADED_BIT), "grain where planes do not count");
    require(&g->file, entry <= g->voxels || !(plane & SECOND_BIT), "a second record has a second");
    require(&g->file, fabs(plane_offset(plane)) <= 0.8701, "a plane outside of its voxel");
    if (g->has_ids)
        require(&g->file, channel(g, IDS, entry) >> 24 == 255, "wrong alpha of an id");
    for (uint64_t k = 0; k < g->words; k++) {
        require(&g->file, isfinite(value_of(g, entry, k)), "a channel is not finite");
        if (entry <= g->voxels && k < SUMMED)
            g->sums.channels[k] += value_of(g, entry, k);
    }
    if (g->has_color) {
        uint32_t color = channel(g, COLOR, entry);
        require(&g->file, color == 0 || color >> 24 == 255, "wrong alpha");
    }
}

static void take_voxel(struct grid *g, uint64_t value)
{
    struct sums *sums = &g->sums;
    uint32_t plane = channel(g, PLANE, value);
    uint64_t second = second_of(g, value);
    double n[3];
    check_entry(g, value);
    require(&g->file, !(plane & SECOND_BIT) == !second, "plane and second differ");
    if (second) {
        require(&g->file, second == 1 + g->voxels + sums->seconds, "wrong number of a second");
        check_entry(g, second);
        sums->seconds++;
    }
    decode_normal(channel(g, NORMAL, value), n);
    for (int k = 0; k < 3; k++) {
        sums->normal[k] += n[k];
        if (g->has_color)
            sums->color[k] += channel(g, COLOR, value) >> 8 * k & 255;
    }
    sums->offset += plane_offset(plane);
    sums->coverage += (plane >> 16 & 255) / 255.0;
    sums->shaded += (plane & SHADED_BIT) != 0;
}

/* Checks that each rank is the sum of the bits before, also in entries without set bits. */
static void check_second_words(const struct grid *g)
{
    uint64_t rank = 0;
    for (uint64_t i = 0; i <= g->voxels / 32; i++) {
        uint32_t bits = u32(&g->file, g->at[SECOND] + 8 * i);
        check_u32s(&g->file, g->at[SECOND] + 8 * i + 4, 1, (uint32_t[]){(uint32_t)rank});
        rank += (uint64_t)popcount(bits);
        for (uint64_t b = 0; b < 32; b++)
            require(&g->file, !(bits >> b & 1) || (32 * i + b >= 1 && 32 * i + b <= g->voxels),
                    "a second record of no voxel");
    }
    require(&g->file, rank == g->seconds, "wrong number of second records");
}

/* ---- the walk through the tree ---- */

static struct box empty_box(void)
{
    return (struct box){{INT64_MAX, INT64_MAX, INT64_MAX}, {INT64_MIN, INT64_MIN, INT64_MIN}};
}

static void join_box(struct box *box, const struct box *other)
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = other->low[k] < box->low[k] ? other->low[k] : box->low[k];
        box->high[k] = other->high[k] > box->high[k] ? other->high[k] : box->high[k];
    }
}

static int mask_bit(const struct bytes *file, uint64_t mask, uint64_t bit)
{
    return (int)(u64(file, mask + bit / 64 * 8) >> bit % 64 & 1);
}

/* Sets the origin of child or voxel `bit` of a node that has 2^bits of them along its edge. */
static void place(const int64_t origin[3], uint64_t bit, unsigned bits, uint64_t edge,
                  int64_t out[3])
{
    for (unsigned k = 0; k < 3; k++)
        out[k] = origin[k] + (int64_t)((bit >> (2 - k) * bits & ((1u << bits) - 1)) * edge);
}

static struct box walk_leaf(struct grid *g, uint64_t at, const int64_t origin[3])
{
    const struct bytes *file = &g->file;
    struct box box = empty_box();
    uint64_t first = u64(file, at + 80), packed = 0, before = 0;
    require(file, first == g->next_value, "value indices are not numbered on");
    for (uint64_t bit = 0; bit < 512; bit++) {
        if (bit % 64 == 0 && bit > 0)
            packed |= before << 9 * (bit / 64 - 1);
        if (!mask_bit(file, at + 16, bit))
            continue;
        struct box voxel;
        place(origin, bit, 3, 1, voxel.low);
        memcpy(voxel.high, voxel.low, sizeof voxel.high);
        join_box(&box, &voxel);
        take_voxel(g, first + before++);
    }
    require(file, before > 0, "a leaf without voxels");
    check_u64(file, at + 88, packed);
    require(file, file->data[at + 15] == 2, "wrong flags of a leaf");
    for (uint64_t k = 0; k < 3; k++)
        require(file,
                i32(file, at + 4 * k) == box.low[k] &&
                    file->data[at + 12 + k] == box.high[k] - box.low[k],
                "wrong bounds of a leaf");
    g->next_value += before;
    return box;
}

static struct box walk_inner(struct grid *g, uint64_t at, const int64_t origin[3],
                             const struct kind *kind)
{
    const struct bytes *file = &g->file;
    const uint64_t c = kind->children, child_mask = at + 32 + c / 8, table = at + 64 + c / 4;
    const int upper = kind == &upper_kind;
    uint64_t *next = upper ? &g->next_lower : &g->next_leaf;
    struct box box = empty_box();
    require_zeros(file, at + 32, c / 8);
    require_zeros(file, at + 32 + c / 4, 32);
    for (uint64_t bit = 0; bit < c; bit++) {
        if (!mask_bit(file, child_mask, bit)) {
            require_zeros(file, table + 8 * bit, 8);
            continue;
        }
        int64_t child_origin[3];
        uint64_t child = at + u64(file, table + 8 * bit);
        place(origin, bit, kind->bits, kind->child_edge, child_origin);
        require(file, child == *next, "a child is not the next node");
        *next += upper ? LOWER_BYTES : LEAF_BYTES;
        struct box inside = upper ? walk_inner(g, child, child_origin, &lower_kind)
                                  : walk_leaf(g, child, child_origin);
        join_box(&box, &inside);
    }
    for (uint64_t k = 0; k < 3; k++)
        require(file,
                i32(file, at + 4 * k) == box.low[k] && i32(file, at + 12 + 4 * k) == box.high[k],
                "wrong bounds of a node");
    check_u64(file, at + 24, 2);
    return box;
}

static void walk(struct grid *g)
{
    const struct bytes *file = &g->file;
    struct box box = empty_box();
    uint64_t tiles = ROOT + g->root_bytes;
    g->next_upper = g->at[UPPERS];
    g->next_lower = g->at[LOWERS];
    g->next_leaf = g->at[LEAVES];
    g->next_value = 1;
    for (uint64_t i = 0; i < g->uppers; i++) {
        uint64_t tile = tiles + TILE_BYTES * i, key = u64(file, tile);
        require(file, i == 0 || key > u64(file, tile - TILE_BYTES), "tiles are not sorted");
        require(file, key >> 62 == 0 && (key >> 20 & 1) == 0 && (key >> 41 & 1) == 0,
                "wrong key of a tile");
        require(file, ROOT + u64(file, tile + 8) == g->next_upper, "wrong offset of a tile");
        require_zeros(file, tile + 16, 16);
        int64_t origin[3];
        for (int k = 0; k < 3; k++)
            origin[k] = (int32_t)(uint32_t)((key >> (42 - 21 * k) & 0xfffff) << 12);
        struct box inside = walk_inner(g, g->next_upper, origin, &upper_kind);
        join_box(&box, &inside);
        g->next_upper += UPPER_BYTES;
    }
    require(file,
            g->next_upper == g->at[LOWERS] && g->next_lower == g->at[LEAVES] &&
                g->next_leaf == g->at[BLIND],
            "nodes that no other refers to");
    require(file, g->next_value == 1 + g->voxels, "value indices do not end at the last voxel");
    require(file, memcmp(&box, &g->box, sizeof box) == 0, "wrong bounds of the root");
}

/* ---- looking up points ---- */

/* Returns the value index of a voxel, 0 if there is none, by the descent that the page describes.
 */
static uint64_t find_voxel(const struct grid *g, const int64_t ijk[3])
{
    const struct bytes *file = &g->file;
    uint64_t u[3], key, at = 0;
    for (int k = 0; k < 3; k++)
        u[k] = (uint32_t)(int32_t)ijk[k];
    key = u[0] >> 12 << 42 | u[1] >> 12 << 21 | u[2] >> 12;
    for (uint64_t i = 0; i < g->uppers; i++)
        if (u64(file, ROOT + g->root_bytes + TILE_BYTES * i) == key)
            at = g->at[UPPERS] + UPPER_BYTES * i;
    if (at == 0)
        return 0;
    for (int level = 0; level < 2; level++) {
        const struct kind *kind = level == 0 ? &upper_kind : &lower_kind;
        uint64_t in[3], c = kind->children;
        for (int k = 0; k < 3; k++)
            in[k] = u[k] / kind->child_edge % (1u << kind->bits);
        uint64_t bit = in[0] << 2 * kind->bits | in[1] << kind->bits | in[2];
        if (!mask_bit(file, at + 32 + c / 8, bit))
            return 0;
        at += u64(file, at + 64 + c / 4 + 8 * bit);
    }
    uint64_t bit = u[0] % 8 << 6 | u[1] % 8 << 3 | u[2] % 8, word = bit / 64;
    uint64_t sum = word > 0 ? u64(file, at + 88) >> 9 * (word - 1) & 511 : 0;
    uint64_t below = u64(file, at + 16 + 8 * word) & (((uint64_t)1 << bit % 64) - 1);
    return mask_bit(file, at + 16, bit) ? u64(file, at + 80) + sum + (uint64_t)popcount(below) : 0;
}

/* Finds the voxel of a point. On a border, rounding decides between voxels; any of them will do. */
static uint64_t voxel_of_point(const struct grid *g, const double point[3], double from_center[3])
{
    for (int corner = 0; corner < 8; corner++) {
        int64_t ijk[3];
        for (int k = 0; k < 3; k++) {
            double x = (point[k] - g->translation[k]) / g->h;
            ijk[k] = (int64_t)floor(x + 0.5 + (corner >> k & 1 ? 1e-4 : -1e-4));
            from_center[k] = x - (double)ijk[k];
        }
        uint64_t value = find_voxel(g, ijk);
        if (value != 0)
            return value;
    }
    return 0;
}

static double distance_to(const struct grid *g, uint64_t entry, const double from_center[3])
{
    double n[3];
    decode_normal(channel(g, NORMAL, entry), n);
    return fabs(n[0] * from_center[0] + n[1] * from_center[1] + n[2] * from_center[2] -
                plane_offset(channel(g, PLANE, entry)));
}

/* Returns the mean difference of the channels, in units of 1 / 255. */
static double difference(uint32_t color, const double rgb[3])
{
    double sum = 0.0;
    for (int k = 0; k < 3; k++)
        sum += fabs((color >> 8 * k & 255) - 255.0 * rgb[k]) / 3.0;
    return sum;
}

static void look_up(const struct grid *g, const char *path)
{
    uint64_t points = 0, found = 0, colored = 0;
    double distance = 0.0, color = 0.0;
    char line[512];
    FILE *stream = fopen(path, "r");
    if (!stream)
        refuse(&(struct bytes){path, NULL, 0}, "cannot be opened");
    while (fgets(line, sizeof line, stream)) {
        double p[3], rgb[3], from_center[3];
        int numbers =
            sscanf(line, "%lf %lf %lf %lf %lf %lf", p, p + 1, p + 2, rgb, rgb + 1, rgb + 2);
        if (numbers < 3)
            continue;
        points++;
        uint64_t entry = voxel_of_point(g, p, from_center);
        if (entry == 0)
            continue;
        uint64_t second = second_of(g, entry);
        if (second && distance_to(g, second, from_center) < distance_to(g, entry, from_center))
            entry = second;
        found++;
        distance += distance_to(g, entry, from_center);
        if (numbers == 6 && g->has_color) {
            colored++;
            color += difference(channel(g, COLOR, entry), rgb);
        }
    }
    fclose(stream);
    printf("points %llu\npoints_found %llu\n", (unsigned long long)points,
           (unsigned long long)found);
    printf("points_from_plane %.6f\n", found ? distance / (double)found : 0.0);
    printf("points_from_color %.6f\n", colored ? color / (double)colored : 0.0);
}

/* ---- results ---- */

static void print_u64(const char *name, uint64_t value)
{
    printf("%s %llu\n", name, (unsigned long long)value);
}

static void print_vector(const char *name, const double v[3])
{
    printf("%s %.17g %.17g %.17g\n", name, v[0], v[1], v[2]);
}

static void print_grid(const struct grid *g)
{
    const struct bytes *file = &g->file;
    const struct sums *sums = &g->sums;
    uint64_t at = g->at[RECORD];
    print_u64("type", g->type);
    print_u64("color", (uint64_t)g->has_color);
    print_u64("uppers", g->uppers);
    print_u64("lowers", g->lowers);
    print_u64("leaves", g->leaves);
    print_u64("voxels", g->voxels);
    print_u64("second_records", sums->seconds);
    print_u64("shaded", sums->shaded);
    print_u64("triangles", u64(file, at + 16));
    for (uint64_t end = 0; end < 2; end++) {
        double v[3];
        for (uint64_t k = 0; k < 3; k++)
            v[k] = f64(file, at + 32 + 24 * end + 8 * k);
        require(file, isfinite(v[0]) && isfinite(v[1]) && isfinite(v[2]), "wrong scan bounds");
        print_vector(end ? "scan_max" : "scan_min", v);
    }
    printf("voxel_size %.17g\n", g->h);
    print_vector("translation", g->translation);
    printf("index_min %lld %lld %lld\n", (long long)g->box.low[0], (long long)g->box.low[1],
           (long long)g->box.low[2]);
    printf("index_max %lld %lld %lld\n", (long long)g->box.high[0], (long long)g->box.high[1],
           (long long)g->box.high[2]);
    print_vector("sum_normal", sums->normal);
    printf("sum_offset %.9g\nsum_coverage %.9g\n", sums->offset, sums->coverage);
    print_vector("sum_color", sums->color);
    for (uint64_t k = 0; k < g->words && k < SUMMED; k++)
        printf("sum_channel %.9g\n", sums->channels[k]);
}

int main(int argc, char **argv)
{
    if (argc != 2 && argc != 3) {
        fprintf(stderr, "usage: naive-read-nvdb FILE [POINTS]\n");
        return 64;
    }
    struct grid g = {.file = read_bytes(argv[1])};
    require_text(&g.file, 0, "NanoVDB0", "not a NanoVDB file");
    read_counts(&g);
    check_record(&g);
    place_sections(&g);
    check_sums(&g);
    check_file_header(&g);
    check_grid_data(&g);
    check_tree_and_root(&g);
    check_blind(&g);
    check_second_words(&g);
    read_names(&g, 0);
    for (int i = NORMAL; i <= COLOR; i++)
        require(&g.file, g.size[i] == 0 || channel(&g, i, 0) == 0, "entry 0 is not 0");
    require(&g.file, !g.has_ids || channel(&g, IDS, 0) == 0, "entry 0 of the ids is not 0");
    for (uint64_t k = 0; k < g.words; k++)
        require(&g.file, value_of(&g, 0, k) == 0.0, "entry 0 of the channels is not 0");
    walk(&g);
    print_grid(&g);
    read_names(&g, 1);
    if (argc == 3)
        look_up(&g, argv[2]);
    free(g.file.data);
    return 0;
}
