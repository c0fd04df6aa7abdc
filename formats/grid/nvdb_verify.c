/* nvdb_verify.c - checks everything in a mapped grid that a traversal follows; and, to verify a
 * whole file, each section against its checksum, and each record.
 *
 * The nodes of a level are contiguous, and so are their children. So each node is checked alone
 * with its right neighbour: its children must be successive, and the neighbour's first child must
 * follow its last one. With the first and last child of a level fixed, each child then has exactly
 * one parent. This needs no memory and runs on all threads. Entries of the channel "second" are
 * checked in the same way. A node is read more than once, and the file may change in between, so
 * numbers of children are bounded where they are used.
 *
 * Only verifying checks records, and bytes of nodes that a traversal does not follow. The baker is
 * safe with any bits in a record, and reading all channels would take most of the time of opening a
 * grid. Voxels are checked in tasks of whole entries of the channel "second", whose ranks give the
 * numbers of a task's second records. */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_layout_internal.h"

/* Entries of the channel "second" in a task. */
enum { ENTRIES_PER_TASK = 1 << 16 };
/* Bytes that are hashed between two checks for an interrupt. */
#define HASH_BYTES (UINT64_C(4) << 20)
/* Voxels of a task: 32 for each entry of the channel "second". */
#define VOXELS_PER_TASK (UINT64_C(32) << 14)

struct check {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    const uint8_t *file;
    struct nvdb_trailer trailer; /* only for verifying */
};

static int bad_node(const struct check *c, const char *level, uint64_t number, const char *what)
{
    return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: %s node %" PRIu64 " has a wrong %s",
                    c->grid->map.path, level, number, what);
}

static bool verify_all_zero(const uint64_t *words, uint32_t count)
{
    uint64_t any = 0;
    for (uint32_t i = 0; i < count; i++)
        any |= words[i];
    return any == 0;
}

/* ---- children ---- */

static bool is_upper(const struct nvdb_level *level)
{
    return level->section == NVDB_UPPERS;
}

static const void *verify_section_of(const struct check *c, enum nvdb_section section)
{
    return c->file + c->grid->layout.section[section].offset;
}

static const struct nvdb_node *node_of(const struct check *c, const struct nvdb_level *level,
                                       uint64_t number)
{
    const uint8_t *nodes = verify_section_of(c, level->section);
    return (const void *)(nodes + number * level->node_bytes);
}

static uint64_t child_count(const struct check *c, const struct nvdb_level *level)
{
    return is_upper(level) ? c->grid->lower_count : c->grid->leaf_count;
}

/* Returns the number, within the level below, of the child that a cell of the table names. A wrong
 * offset gives a number that no child has. */
static uint64_t verify_child_of(const struct check *c, const struct nvdb_level *level,
                                const struct nvdb_node *node, uint32_t cell)
{
    const uint8_t *below = verify_section_of(c, level->child_section);
    const uint64_t base = (uint64_t)(below - (const uint8_t *)node);
    const uint64_t distance = (uint64_t)nvdb_table(level, node)[cell] - base;
    return distance % level->child_bytes == 0 ? distance / level->child_bytes : UINT64_MAX;
}

/* Returns the first child of a node, UINT64_MAX if it has none; after the last node, the number of
 * all children. */
static uint64_t first_child(const struct check *c, const struct nvdb_level *level, uint64_t number)
{
    if (number == (is_upper(level) ? c->grid->upper_count : c->grid->lower_count))
        return child_count(c, level);
    const struct nvdb_node *node = node_of(c, level, number);
    const uint64_t *mask = nvdb_child_mask(level, node);
    for (uint32_t word = 0; word < level->words; word++)
        if (mask[word])
            return verify_child_of(c, level, node,
                                   64 * word + (uint32_t)__builtin_ctzll(mask[word]));
    return UINT64_MAX;
}

/* Sets the origin of a node with `dim` voxels along its edge: its lower bounds, rounded down. */
static void node_origin(const int32_t bbox_min[3], int32_t dim, int32_t origin[3])
{
    for (int axis = 0; axis < 3; axis++)
        origin[axis] = (int32_t)((uint32_t)bbox_min[axis] & ~((uint32_t)dim - 1));
}

/* Sets the origin of the child in `cell` of a node at `origin`. */
static void child_origin(const struct nvdb_level *level, const int32_t origin[3], uint32_t cell,
                         int32_t out[3])
{
    const uint32_t bits = level->log2_cells, low = (1u << bits) - 1;
    const uint32_t step[3] = {cell >> 2 * bits, cell >> bits & low, cell & low};
    for (int axis = 0; axis < 3; axis++)
        out[axis] = (int32_t)((uint32_t)origin[axis] + step[axis] * (uint32_t)level->child_dim);
}

static bool same_box(const int32_t a_min[3], const int32_t a_max[3], const int32_t b_min[3],
                     const int32_t b_max[3])
{
    return memcmp(a_min, b_min, 12) == 0 && memcmp(a_max, b_max, 12) == 0;
}

/* Checks a leaf and extends the box of its parent. */
static int check_leaf(const struct check *c, uint64_t number, const int32_t origin[3],
                      int32_t bbox_min[3], int32_t bbox_max[3])
{
    const struct nvdb_leaf *leaf =
        (const struct nvdb_leaf *)verify_section_of(c, NVDB_LEAVES) + number;
    int32_t leaf_min[3], leaf_max[3];
    uint64_t count = fmt_nvdb_leaf_bounds(origin, leaf->mask, leaf_min, leaf_max);
    if (count == 0)
        return bad_node(c, "leaf", number, "mask");
    for (int axis = 0; axis < 3; axis++)
        if (leaf->bbox_min[axis] != leaf_min[axis] ||
            leaf->bbox_dif[axis] != leaf_max[axis] - leaf_min[axis])
            return bad_node(c, "leaf", number, "bounding box");
    bool last = number + 1 == c->grid->leaf_count;
    uint64_t end = last ? 1 + c->grid->voxel_count : leaf[1].offset;
    if (leaf->prefix_sum != fmt_nvdb_prefix_sum(leaf->mask) || leaf->flags != NVDB_NODE_HAS_BBOX ||
        (number == 0 && leaf->offset != 1) || leaf->offset > end || end - leaf->offset != count)
        return bad_node(c, "leaf", number, "value index");
    fmt_nvdb_bbox_extend(bbox_min, bbox_max, leaf_min, leaf_max);
    return 0;
}

/* Checks the place of a lower node and extends the box of its parent. */
static int check_place(const struct check *c, uint64_t number, const int32_t origin[3],
                       int32_t bbox_min[3], int32_t bbox_max[3])
{
    const struct nvdb_node *lower = node_of(c, &fmt_nvdb_lower, number);
    int32_t found[3];
    node_origin(lower->bbox_min, NVDB_LOWER_DIM, found);
    if (memcmp(origin, found, sizeof found) != 0)
        return bad_node(c, "lower", number, "place");
    fmt_nvdb_bbox_extend(bbox_min, bbox_max, lower->bbox_min, lower->bbox_max);
    return 0;
}

/* Checks that the children of a node are successive nodes in their places, and that its box is
 * theirs. */
static int check_children(const struct check *c, const struct nvdb_level *level, uint64_t number,
                          const int32_t origin[3])
{
    const struct nvdb_node *node = node_of(c, level, number);
    const uint64_t *mask = nvdb_child_mask(level, node);
    int32_t bbox_min[3], bbox_max[3];
    uint64_t child = first_child(c, level, number);
    fmt_nvdb_bbox_clear(bbox_min, bbox_max);
    if (number == 0 && child != 0)
        return bad_node(c, level->name, number, "child");
    for (uint32_t word = 0; word < level->words; word++)
        for (uint64_t bits = mask[word]; bits; bits &= bits - 1, child++) {
            const uint32_t cell = 64 * word + (uint32_t)__builtin_ctzll(bits);
            int32_t place[3];
            if (child >= child_count(c, level) || verify_child_of(c, level, node, cell) != child)
                return bad_node(c, level->name, number, "child");
            child_origin(level, origin, cell, place);
            BSQ_PASS(is_upper(level) ? check_place(c, child, place, bbox_min, bbox_max)
                                     : check_leaf(c, child, place, bbox_min, bbox_max));
        }
    if (first_child(c, level, number + 1) != child)
        return bad_node(c, level->name, number, "child");
    if (!same_box(bbox_min, bbox_max, node->bbox_min, node->bbox_max))
        return bad_node(c, level->name, number, "bounding box");
    return 0;
}

static int check_node(const struct check *c, const struct nvdb_level *level, uint64_t number)
{
    const struct nvdb_node *node = node_of(c, level, number);
    int32_t origin[3];
    node_origin(node->bbox_min, level->dim, origin);
    if (!verify_all_zero(nvdb_value_mask(node), level->words) ||
        first_child(c, level, number) == UINT64_MAX)
        return bad_node(c, level->name, number, "child");
    const struct nvdb_root_tile *root_tiles = (const void *)c->grid->root_tiles;
    if (is_upper(level) && nvdb_root_key(origin) != root_tiles[number].key)
        return bad_node(c, level->name, number, "place");
    return check_children(c, level, number, origin);
}

/* Returns the number of entries of the channel "second". */
static uint64_t entry_count(const struct fmt_nvdb_grid *grid)
{
    return grid->voxel_count / 32 + 1;
}

/* Checks that ranks add up from entry to entry, and that bits are set for voxels only. */
static int check_seconds(const struct check *c, uint64_t task)
{
    const struct fmt_nvdb_grid *grid = c->grid;
    const uint64_t count = entry_count(grid), begin = task * ENTRIES_PER_TASK;
    const uint64_t end = begin + ENTRIES_PER_TASK < count ? begin + ENTRIES_PER_TASK : count;
    uint64_t seconds = grid->record_count - 1 - grid->voxel_count;
    for (uint64_t i = begin; i < end; i++) {
        uint32_t bits = grid->seconds[i][0], beyond = 0;
        bool last = i + 1 == count;
        if (i == 0)
            beyond |= 1;
        if (last && grid->voxel_count % 32 != 31)
            beyond |= UINT32_MAX << (grid->voxel_count % 32 + 1);
        uint64_t next = last ? seconds : grid->seconds[i + 1][1];
        if ((bits & beyond) || (i == 0 && grid->seconds[i][1] != 0) ||
            (uint64_t)grid->seconds[i][1] + nvdb_popcount(bits) != next)
            return bsq_fail(c->ctx, BSQ_EDATA,
                            "%s: damaged: word %" PRIu64 " of channel \"second\" has a wrong rank",
                            grid->map.path, i);
    }
    return 0;
}

static int check_root(const struct check *c)
{
    const struct fmt_nvdb_grid *grid = c->grid;
    int32_t bbox_min[3], bbox_max[3];
    fmt_nvdb_bbox_clear(bbox_min, bbox_max);
    uint64_t child = (uint64_t)(grid->uppers - grid->root);
    for (uint32_t i = 0; i < grid->root_tile_count; i++) {
        const struct nvdb_root_tile *tile =
            (const struct nvdb_root_tile *)(const void *)grid->root_tiles + i;
        if ((i > 0 && tile->key <= tile[-1].key) || tile->child != (int64_t)child ||
            !verify_all_zero(tile->values, 2))
            return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: root tile %" PRIu32 " is wrong",
                            grid->map.path, i);
        const struct nvdb_node *upper = node_of(c, &fmt_nvdb_upper, i);
        fmt_nvdb_bbox_extend(bbox_min, bbox_max, upper->bbox_min, upper->bbox_max);
        child += sizeof(struct nvdb_upper);
    }
    if (!same_box(bbox_min, bbox_max, grid->index_min, grid->index_max))
        return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: the root node has a wrong bounding box",
                        grid->map.path);
    return 0;
}

static int check_task(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct check *c = arg;
    if (index < c->grid->lower_count)
        return check_node(c, &fmt_nvdb_lower, index);
    index -= c->grid->lower_count;
    if (index < c->grid->upper_count)
        return check_node(c, &fmt_nvdb_upper, index);
    return check_seconds(c, index - c->grid->upper_count);
}

int fmt_nvdb_check_nodes(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct check c = {.ctx = ctx, .grid = grid, .file = grid->map.data};
    BSQ_PASS(check_root(&c));
    const uint64_t tasks = (entry_count(grid) + ENTRIES_PER_TASK - 1) / ENTRIES_PER_TASK;
    return bsq_parallel_for(ctx, (uint64_t)grid->lower_count + grid->upper_count + tasks,
                            check_task, &c);
}

/* ---- verifying ---- */

/* Returns pages of a mapped file to the system, so that few are resident at a time. Leaves a grid
 * alone that is in other memory, as in tests: its bytes would be lost. */
static void forget_pages(const struct fmt_nvdb_grid *grid, const void *from, uint64_t size)
{
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), begin = (uintptr_t)from / page * page;
    if (grid->map.range)
        madvise((void *)begin, (uintptr_t)from + size - begin, MADV_DONTNEED);
}

/* ---- sections ---- */

static int hash_section(const struct check *c, const struct fmt_nvdb_range *range, uint64_t *hash)
{
    XXH3_state_t *state = XXH3_createState();
    if (!state)
        return bsq_fail(c->ctx, BSQ_ENOMEM, "no memory for a checksum");
    int status = 0;
    XXH3_64bits_reset(state);
    const uint8_t *data = c->file + range->offset;
    for (uint64_t done = 0; done < range->size && status == 0;) {
        uint64_t left = range->size - done, size = left < HASH_BYTES ? left : HASH_BYTES;
        XXH3_64bits_update(state, data + done, (size_t)size);
        forget_pages(c->grid, data + done, size);
        done += size;
        bsq_progress_add(c->ctx, size);
        status = bsq_check(c->ctx);
    }
    *hash = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    return status;
}

static int verify_section(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    struct check *c = arg;
    const int section = (int)index;
    const struct fmt_nvdb_range *range = &c->grid->layout.section[section];
    uint64_t hash = 0;
    if (!nvdb_has_checksum(c->grid->flags, section))
        return 0;
    BSQ_PASS(hash_section(c, range, &hash));
    if (hash != *nvdb_checksum(&c->trailer, section))
        return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: wrong checksum of %s at byte %llu",
                        c->grid->map.path, fmt_nvdb_rows[section].name,
                        (unsigned long long)range->offset);
    return 0;
}

/* Checks that the bytes between sections are zero. */
static int verify_padding(const struct check *c)
{
    for (int i = 1; i < NVDB_SECTION_COUNT; i++) {
        const struct fmt_nvdb_range *before = &c->grid->layout.section[i - 1];
        for (uint64_t at = before->offset + before->size; at < c->grid->layout.section[i].offset;
             at++)
            if (c->file[at] != 0)
                return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: padding at byte %llu is not zero",
                                c->grid->map.path, (unsigned long long)at);
    }
    return 0;
}

/* ---- nodes ---- */

/* Returns what is wrong with bytes of a node that no reader of Bisque follows, or NULL. */
static const char *fault_of_node(const struct nvdb_level *level, const struct nvdb_node *node)
{
    const uint64_t *mask = nvdb_child_mask(level, node), *of = nvdb_statistics(level, node);
    const int64_t *table = nvdb_table(level, node);
    uint64_t unused = 0;
    for (uint32_t i = 0; i < 64 * level->words; i++)
        unused |= mask[i / 64] >> (i % 64) & 1 ? 0 : (uint64_t)table[i];
    if (node->flags != NVDB_NODE_HAS_BBOX)
        return "flag";
    if (of[0] | of[1] | of[2] | of[3])
        return "statistic";
    return unused ? "offset without a child" : NULL;
}

static int verify_node(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct check *c = arg;
    const bool upper = index < c->grid->upper_count;
    const struct nvdb_level *level = upper ? &fmt_nvdb_upper : &fmt_nvdb_lower;
    const uint64_t number = upper ? index : index - c->grid->upper_count;
    const struct nvdb_node *node = node_of(c, level, number);
    const char *fault = fault_of_node(level, node);
    forget_pages(c->grid, node, level->node_bytes);
    return fault ? bad_node(c, level->name, number, fault) : bsq_check(c->ctx);
}

/* ---- records ---- */

static int bad_record(const struct check *c, uint64_t number, const char *what)
{
    return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: record %" PRIu64 " has a wrong %s",
                    c->grid->map.path, number, what);
}

/* Returns what is wrong with a record, or NULL. second: whether its voxel has a second record. */
static const char *verify_fault_of(const struct fmt_nvdb_grid *grid, uint64_t number, bool second)
{
    uint32_t normal = grid->normals[number], plane = grid->planes[number];
    if ((normal & 0xffff) == 0x8000 || normal >> 16 == 0x8000)
        return "normal";
    uint32_t noise = plane >> FMT_NVDB_FACET_NOISE_SHIFT;
    if (noise > FMT_NVDB_FACET_NOISE_MAX || (noise > 0 && (plane & FMT_NVDB_PLANE_INCONSISTENT)) ||
        abs((int16_t)(plane & 0xffff)) > FMT_NVDB_PLANE_MAX)
        return "plane";
    if (!(plane & FMT_NVDB_PLANE_SECOND) != !second)
        return "mark of a second record";
    uint32_t color = grid->colors ? grid->colors[number] : 0;
    if (color != 0 && color >> 24 != 255)
        return "colour";
    if (grid->ids && grid->ids[number] >> 24 != 255)
        return "id";
    bool finite = true;
    for (uint32_t i = 0; i < grid->channel_words; i++)
        finite &= isfinite(grid->channels[number * grid->channel_words + i]) != 0;
    return finite ? NULL : "channel";
}

/* Returns whether the background's channels are 0. */
static bool channels_begin_with_zeros(const struct fmt_nvdb_grid *grid)
{
    bool zero = true;
    for (uint32_t i = 0; i < grid->channel_words; i++)
        zero &= grid->channels[i] == 0.0f && !signbit(grid->channels[i]);
    return zero;
}

static int verify_voxel(const struct check *c, uint64_t index)
{
    uint64_t second = fmt_nvdb_second(c->grid, index);
    const char *fault = verify_fault_of(c->grid, index, second != 0);
    if (fault)
        return bad_record(c, index, fault);
    if (second && (fault = verify_fault_of(c->grid, second, false)))
        return bad_record(c, second, fault);
    return 0;
}

static int verify_voxels(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct check *c = arg;
    const struct fmt_nvdb_grid *grid = c->grid;
    uint64_t begin = task * VOXELS_PER_TASK, end = begin + VOXELS_PER_TASK;
    int status = bsq_check(c->ctx);
    if (end > grid->voxel_count + 1)
        end = grid->voxel_count + 1;
    for (uint64_t i = begin > 0 ? begin : 1; i < end && !status; i++)
        status = verify_voxel(c, i);
    const uint32_t *const values[] = {grid->normals, grid->planes, grid->colors, grid->ids};
    for (int i = 0; i < 4; i++)
        if (values[i])
            forget_pages(grid, values[i] + begin, (end - begin) * sizeof *values[i]);
    if (grid->channels)
        forget_pages(grid, grid->channels + begin * grid->channel_words,
                     (end - begin) * grid->channel_words * sizeof *grid->channels);
    return status;
}

static int verify_records(struct check *c)
{
    const struct fmt_nvdb_grid *grid = c->grid;
    if (grid->normals[0] || grid->planes[0] || (grid->colors && grid->colors[0]) ||
        (grid->ids && grid->ids[0]) || !channels_begin_with_zeros(grid))
        return bad_record(c, 0, "value, as it is the background");
    return bsq_parallel_for(c->ctx, grid->voxel_count / VOXELS_PER_TASK + 1, verify_voxels, c);
}

int fmt_nvdb_verify(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct check c = {.ctx = ctx, .grid = grid, .file = grid->map.data};
    forget_pages(grid, grid->map.data, grid->map.size);
    c.trailer = *nvdb_trailer_of(grid);
    BSQ_PASS(bsq_parallel_for(ctx, NVDB_TRAILER, verify_section, &c));
    BSQ_PASS(verify_padding(&c));
    BSQ_PASS(
        bsq_parallel_for(ctx, (uint64_t)grid->upper_count + grid->lower_count, verify_node, &c));
    return verify_records(&c);
}
