/* grid_patch.c - applies the changes of a small input to a grid file in memory.
 *
 * An input is u8 flags (bits 0-1: template, bit 2: leave the checksums wrong, bit 3: verify), then
 * changes: u8 kind and its operands. A place is a number among the bytes that are in or beside
 * words that are not zero, so that 16 bits are enough; SET_FAR counts all bytes of the file. Some
 * changes keep the grid valid: they move or scale the grid, or move a voxel. */
#include "tests/fuzz/grid_patch.h"

#include <sanitizer/asan_interface.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "formats/grid/nvdb_layout_internal.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/unit/formats/grid/nvdb_scene.h"

enum { TEMPLATES = 4, CHANGES = 32, RANGES = 256, SLACK = 1 << 15 };

enum change {
    SET,      /* u16 place, u8 n - 1 in 0 ... 7, n bytes */
    SET_FAR,  /* u32 offset in the file, then as SET */
    ADD,      /* u16 place, i8 to add to the aligned u64 there */
    MOVE,     /* u8 axis, i32 number of upper nodes */
    SCALE,    /* f64 edge of a voxel */
    SHIFT,    /* u8 axis, f64 translation */
    MOVE_BIT, /* u16 leaf, u16 old and u16 new bit of a voxel in the leaf */
    CUT       /* i16 bytes to remove from the end */
};
/* Maps the low bits of an input's kind to changes, frequent ones several times. */
static const uint8_t kinds[16] = {SET, SET,  SET,  SET,   SET,   SET_FAR,  ADD,      ADD,
                                  CUT, MOVE, MOVE, SCALE, SHIFT, MOVE_BIT, MOVE_BIT, MOVE_BIT};

struct grid_template {
    uint8_t *bytes, *original;
    uint64_t size;
    struct fmt_nvdb_layout layout;
    uint32_t *places, place_count; /* offset of each place */
    struct fmt_nvdb_range changed[RANGES];
    int changed_count;
    bool remake; /* the head is made again from the tree's bounds, voxel size and translation */
};

struct cursor {
    const uint8_t *at, *end;
};

static uint64_t take(struct cursor *from, size_t bytes)
{
    uint64_t value = 0;
    size_t left = (size_t)(from->end - from->at);
    size_t n = bytes < left ? bytes : left;
    memcpy(&value, from->at, n);
    from->at += n;
    return value;
}

/* ---- templates ---- */

/* Writes a clump of voxels around a point; the template's number decides type and colour. */
static void make_scene(int number, struct scene *scene)
{
    static const int32_t centre[TEMPLATES][3] = {
        {30, 40, 50}, {128, 60, 70}, {4096, 30, 20}, {3, 3, 3}};
    static const int extent[TEMPLATES] = {5, 12, 6, 2};
    static const unsigned counts[TEMPLATES] = {8, 90, 12, 3};
    uint64_t state = (uint64_t)number + 1;
    scene_random(scene, (uint64_t)number + 1, 30);
    uint64_t kept = 0;
    for (uint64_t i = 0; i < scene->count && i < counts[number]; i++) {
        struct scene_voxel *v = &scene->voxels[kept++];
        for (int k = 0; k < 3; k++)
            v->ijk[k] = centre[number][k] +
                        (int32_t)(scene_next(&state) % (2 * (unsigned)extent[number])) -
                        extent[number];
    }
    scene->count = kept;
    scene_sort(scene);
    scene->info.has_color = number != 1;
    scene->info.channels = number == 2 ? "metallic,coat" : number == 1 ? "roughness" : NULL;
}

static void write_scene(int number, const char *path)
{
    struct scene scene;
    struct bsq_ctx *ctx;
    struct fmt_nvdb_totals totals;
    require(bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &ctx) == 0, "no context");
    make_scene(number, &scene);
    require(scene_write(ctx, path, &scene, &totals) == 0, "cannot write a template");
    scene_free(&scene);
    bsq_ctx_destroy(ctx);
}

static uint8_t *allocate(uint64_t size)
{
    void *memory = NULL;
    require(posix_memalign(&memory, 4096, size ? size : 1) == 0, "no memory");
    return memory;
}

/* Makes the file end at `size`, also for the sanitizer. */
static void set_end(const struct grid_template *t, uint64_t size)
{
    ASAN_UNPOISON_MEMORY_REGION(t->bytes, t->size + SLACK);
    ASAN_POISON_MEMORY_REGION(t->bytes + size, t->size + SLACK - size);
}

static void find_places(struct grid_template *t)
{
    t->places = malloc(t->size * sizeof *t->places);
    require(t->places != NULL, "no memory");
    const uint64_t words = t->size / 8;
    const uint64_t *word = (const uint64_t *)(const void *)t->original;
    for (uint64_t i = 0; i < words; i++)
        if (word[i] || (i > 0 && word[i - 1]) || (i + 1 < words && word[i + 1]))
            for (uint32_t b = 0; b < 8; b++)
                t->places[t->place_count++] = (uint32_t)(8 * i) + b;
}

static void make_template(int number, struct grid_template *t)
{
    char directory[] = "/tmp/bisque-fuzz.XXXXXX", path[64];
    require(mkdtemp(directory) != NULL, "no directory for a template");
    snprintf(path, sizeof path, "%s/x.nvdb", directory);
    write_scene(number, path);
    FILE *file = fopen(path, "rb");
    struct stat info;
    require(file && fstat(fileno(file), &info) == 0, "no template");
    t->size = (uint64_t)info.st_size;
    t->bytes = allocate(t->size + SLACK);
    memset(t->bytes + t->size, 0, SLACK);
    t->original = allocate(t->size);
    require(fread(t->original, 1, t->size, file) == t->size, "no template");
    fclose(file);
    unlink(path);
    rmdir(directory);
    memcpy(t->bytes, t->original, t->size);
    set_end(t, t->size);
    find_places(t);

    struct bsq_ctx *ctx;
    struct fmt_nvdb_grid grid = {
        .map = {.data = t->bytes, .size = t->size, .path = (char *)"template"}};
    require(bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &ctx) == 0, "no context");
    require(fmt_nvdb_check_header(ctx, &grid) == 0, "a template that is not valid");
    t->layout = grid.layout;
    bsq_ctx_destroy(ctx);
}

static struct grid_template *template_at(int number)
{
    static struct grid_template templates[TEMPLATES];
    if (!templates[number].bytes)
        make_template(number, &templates[number]);
    return &templates[number];
}

/* Notes that `size` bytes at p will change. If there are too many notes, all bytes count as
 * changed. */
static void touch(struct grid_template *t, const void *p, uint64_t size)
{
    if (t->changed_count == RANGES)
        t->changed[--t->changed_count] = (struct fmt_nvdb_range){0, t->size};
    else
        t->changed[t->changed_count] =
            (struct fmt_nvdb_range){(uint64_t)((const uint8_t *)p - t->bytes), size};
    t->changed_count++;
}

static void touch_section(struct grid_template *t, enum nvdb_section section)
{
    touch(t, t->bytes + t->layout.section[section].offset, t->layout.section[section].size);
}

static bool is_touched(const struct grid_template *t, const struct fmt_nvdb_range *range)
{
    for (int i = 0; i < t->changed_count; i++)
        if (t->changed[i].offset < range->offset + range->size &&
            range->offset < t->changed[i].offset + t->changed[i].size)
            return true;
    return false;
}

/* ---- changes that keep the tree valid ---- */

static struct nvdb_fixed *head(const struct grid_template *t)
{
    return (void *)t->bytes;
}
static void *nodes(const struct grid_template *t, enum nvdb_section section)
{
    return t->bytes + t->layout.section[section].offset;
}
static uint64_t node_count(const struct grid_template *t, enum nvdb_section section, uint64_t bytes)
{
    return t->layout.section[section].size / bytes;
}

static int32_t moved(int32_t at, uint32_t by)
{
    return (int32_t)((uint32_t)at + by);
}

static void touch_bounds(struct grid_template *t)
{
    struct nvdb_upper *upper = nodes(t, NVDB_UPPERS);
    struct nvdb_lower *lower = nodes(t, NVDB_LOWERS);
    for (uint64_t i = 0; i < node_count(t, NVDB_UPPERS, sizeof *upper); i++)
        touch(t, &upper[i], offsetof(struct nvdb_upper, flags));
    for (uint64_t i = 0; i < node_count(t, NVDB_LOWERS, sizeof *lower); i++)
        touch(t, &lower[i], offsetof(struct nvdb_lower, flags));
    touch_section(t, NVDB_LEAVES);
}

static void move_grid(struct grid_template *t, uint32_t axis, uint32_t uppers)
{
    const uint32_t by = uppers * NVDB_UPPER_DIM;
    struct nvdb_upper *upper = nodes(t, NVDB_UPPERS);
    struct nvdb_lower *lower = nodes(t, NVDB_LOWERS);
    struct nvdb_leaf *leaf = nodes(t, NVDB_LEAVES);
    struct nvdb_root_tile *tile = (void *)(t->bytes + NVDB_ROOT_TILES_OFFSET);
    struct nvdb_root *root = &head(t)->root;
    touch_bounds(t);
    fmt_nvdb_bbox_clear(root->bbox_min, root->bbox_max);
    for (uint64_t i = 0; i < node_count(t, NVDB_LEAVES, sizeof *leaf); i++)
        leaf[i].bbox_min[axis] = moved(leaf[i].bbox_min[axis], by);
    for (uint64_t i = 0; i < node_count(t, NVDB_LOWERS, sizeof *lower); i++) {
        lower[i].bbox_min[axis] = moved(lower[i].bbox_min[axis], by);
        lower[i].bbox_max[axis] = moved(lower[i].bbox_max[axis], by);
    }
    for (uint64_t i = 0; i < node_count(t, NVDB_UPPERS, sizeof *upper); i++) {
        upper[i].bbox_min[axis] = moved(upper[i].bbox_min[axis], by);
        upper[i].bbox_max[axis] = moved(upper[i].bbox_max[axis], by);
        tile[i].key = nvdb_root_key(upper[i].bbox_min);
        fmt_nvdb_bbox_extend(root->bbox_min, root->bbox_max, upper[i].bbox_min, upper[i].bbox_max);
    }
}

static void scale_grid(const struct grid_template *t, uint64_t bits)
{
    double size;
    memcpy(&size, &bits, sizeof size);
    for (int i = 0; i < 9; i += 4)
        head(t)->grid.map.matrix[i] = size;
}

/* Computes the bounds of all nodes above the leaves. */
static void join_bounds(const struct grid_template *t)
{
    struct nvdb_upper *upper = nodes(t, NVDB_UPPERS);
    struct nvdb_lower *lower = nodes(t, NVDB_LOWERS);
    struct nvdb_leaf *leaf = nodes(t, NVDB_LEAVES);
    struct nvdb_root *root = &head(t)->root;
    fmt_nvdb_bbox_clear(root->bbox_min, root->bbox_max);
    for (uint64_t u = 0; u < node_count(t, NVDB_UPPERS, sizeof *upper); u++) {
        fmt_nvdb_bbox_clear(upper[u].bbox_min, upper[u].bbox_max);
        for (int word = 0; word < 512; word++)
            for (uint64_t bits = upper[u].child_mask[word]; bits; bits &= bits - 1, lower++) {
                if ((uint8_t *)lower >= (uint8_t *)nodes(t, NVDB_LEAVES))
                    return;
                fmt_nvdb_bbox_clear(lower->bbox_min, lower->bbox_max);
                for (int i = 0; i < 64; i++)
                    for (uint64_t some = lower->child_mask[i]; some; some &= some - 1, leaf++) {
                        if ((uint8_t *)leaf >= (uint8_t *)nodes(t, NVDB_BLIND))
                            return;
                        int32_t origin[3], low[3], high[3];
                        for (int k = 0; k < 3; k++)
                            origin[k] = leaf->bbox_min[k] & ~(NVDB_LEAF_DIM - 1);
                        fmt_nvdb_leaf_bounds(origin, leaf->mask, low, high);
                        fmt_nvdb_bbox_extend(lower->bbox_min, lower->bbox_max, low, high);
                    }
                fmt_nvdb_bbox_extend(upper[u].bbox_min, upper[u].bbox_max, lower->bbox_min,
                                     lower->bbox_max);
            }
        fmt_nvdb_bbox_extend(root->bbox_min, root->bbox_max, upper[u].bbox_min, upper[u].bbox_max);
    }
}

static void move_bit(struct grid_template *t, uint64_t number, uint32_t from, uint32_t to)
{
    struct nvdb_leaf *leaf = nodes(t, NVDB_LEAVES);
    leaf += number % node_count(t, NVDB_LEAVES, sizeof *leaf);
    from %= 512;
    to %= 512;
    int32_t origin[3], high[3];
    for (int k = 0; k < 3; k++)
        origin[k] = leaf->bbox_min[k] & ~(NVDB_LEAF_DIM - 1);
    while (!(leaf->mask[from / 64] >> (from % 64) & 1)) {
        from = (from + 1) % 512;
        if (from == to)
            return;
    }
    if (leaf->mask[to / 64] >> (to % 64) & 1)
        return;
    touch_bounds(t);
    leaf->mask[from / 64] ^= UINT64_C(1) << (from % 64);
    leaf->mask[to / 64] ^= UINT64_C(1) << (to % 64);
    leaf->prefix_sum = fmt_nvdb_prefix_sum(leaf->mask);
    fmt_nvdb_leaf_bounds(origin, leaf->mask, leaf->bbox_min, high);
    for (int k = 0; k < 3; k++)
        leaf->bbox_dif[k] = (uint8_t)(high[k] - leaf->bbox_min[k]);
    join_bounds(t);
}

/* ---- changes ---- */

static void set_bytes(struct grid_template *t, uint64_t place, struct cursor *from)
{
    uint64_t count = take(from, 1) % 8 + 1;
    if (count > t->size - place)
        count = t->size - place;
    uint64_t value = take(from, count);
    touch(t, t->bytes + place, count);
    memcpy(t->bytes + place, &value, count);
}

static void add_to_word(struct grid_template *t, uint64_t place, int8_t by)
{
    uint64_t word;
    place &= ~(uint64_t)7;
    memcpy(&word, t->bytes + place, sizeof word);
    word += (uint64_t)(int64_t)by;
    touch(t, t->bytes + place, sizeof word);
    memcpy(t->bytes + place, &word, sizeof word);
}

static void change(struct grid_template *t, struct cursor *from, uint64_t *size)
{
    enum change kind = (enum change)kinds[take(from, 1) % sizeof kinds];
    uint64_t a, b;
    t->remake |= kind == MOVE || kind == SCALE || kind == SHIFT || kind == MOVE_BIT;
    switch (kind) {
    case SET:
        set_bytes(t, t->places[take(from, 2) % t->place_count], from);
        break;
    case SET_FAR:
        set_bytes(t, take(from, 4) % t->size, from);
        break;
    case ADD:
        a = t->places[take(from, 2) % t->place_count];
        add_to_word(t, a, (int8_t)take(from, 1));
        break;
    case MOVE:
        a = take(from, 1) % 3;
        move_grid(t, (uint32_t)a, (uint32_t)take(from, 4));
        break;
    case SCALE:
        scale_grid(t, take(from, 8));
        break;
    case SHIFT:
        a = take(from, 1) % 3;
        b = take(from, 8);
        memcpy(&head(t)->grid.map.translation[a], &b, sizeof b);
        break;
    case MOVE_BIT:
        a = take(from, 2);
        b = take(from, 2);
        move_bit(t, a, (uint32_t)b, (uint32_t)take(from, 2));
        break;
    case CUT:
        *size = t->size - (uint64_t)(int64_t)(int16_t)take(from, 2);
        break;
    }
}

/* Makes the head again up to its tiles, for a grid that was moved or scaled. */
static void remake_head(const struct grid_template *t)
{
    const struct nvdb_tree_data *tree = &head(t)->tree;
    const struct nvdb_root root = head(t)->root;
    struct fmt_nvdb_info info = {.voxel_size = head(t)->grid.map.matrix[0]};
    struct nvdb_counts counts = {.uppers = tree->node_count[2],
                                 .lowers = tree->node_count[1],
                                 .leaves = tree->node_count[0],
                                 .voxels = tree->voxel_count};
    memcpy(info.translation, head(t)->grid.map.translation, sizeof info.translation);
    fmt_nvdb_fill_fixed(&info, &counts, &t->layout, root.bbox_min, root.bbox_max, t->bytes);
    head(t)->grid.checksum[1] = UINT32_MAX;
}

/* Corrects the file header, which repeats parts of GridData, and all checksums. */
static void mend(struct grid_template *t)
{
    const struct fmt_nvdb_layout *layout = &t->layout;
    struct nvdb_trailer *trailer = nodes(t, NVDB_TRAILER);
    touch_section(t, NVDB_HEAD);
    touch_section(t, NVDB_TRAILER);
    if (t->remake)
        remake_head(t);
    else
        fmt_nvdb_fill_file_head(head(t));
    head(t)->grid.checksum[0] = fmt_nvdb_head_crc(t->bytes, layout);
    for (int i = 0; i < NVDB_TRAILER; i++) {
        const struct fmt_nvdb_range *range = &layout->section[i];
        if (is_touched(t, range))
            *nvdb_checksum(trailer, i) = XXH3_64bits(t->bytes + range->offset, range->size);
    }
    trailer->trailer_checksum = fmt_nvdb_trailer_checksum(trailer);
}

void grid_patch_apply(const uint8_t *data, size_t size, struct patched_grid *out)
{
    struct cursor from = {data, data + size};
    if (size >= 7 && memcmp(data, "NanoVDB", 7) == 0) {
        *out = (struct patched_grid){allocate(size), size, NULL, true};
        memcpy(out->bytes, data, size);
        return;
    }
    uint64_t flags = take(&from, 1);
    struct grid_template *t = template_at((int)(flags % TEMPLATES));
    touch_section(t, NVDB_HEAD);
    uint64_t file_size = t->size;
    for (int i = 0; i < CHANGES && from.at < from.end; i++)
        change(t, &from, &file_size);
    if (!(flags & 4))
        mend(t);
    set_end(t, file_size);
    *out = (struct patched_grid){t->bytes, file_size, t, flags & 8};
}

void grid_patch_begin(const uint8_t *data, size_t size, struct patched_grid *out)
{
    struct grid_template *t = template_at(size > 0 ? data[0] % TEMPLATES : 0);
    *out = (struct patched_grid){t->bytes, t->size, t, size > 0 && data[0] & 8};
}

void grid_patch_overwrite(const uint8_t *data, size_t size, struct patched_grid *grid)
{
    struct cursor from = {data + (size > 0), data + size};
    uint64_t file_size = grid->size;
    touch_section(grid->of, NVDB_HEAD);
    for (int i = 0; i < CHANGES && from.at < from.end; i++)
        change(grid->of, &from, &file_size);
}

void grid_patch_revert(struct patched_grid *grid)
{
    struct grid_template *t = grid->of;
    if (t)
        set_end(t, t->size);
    for (int i = 0; t && i < t->changed_count; i++) {
        const struct fmt_nvdb_range *range = &t->changed[i];
        memcpy(t->bytes + range->offset, t->original + range->offset, range->size);
    }
    if (t) {
        t->changed_count = 0;
        t->remake = false;
    } else {
        free(grid->bytes);
    }
    grid->bytes = NULL;
}
