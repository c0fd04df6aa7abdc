/* nvdb_check_nodes.c - checks everything in a mapped grid that a traversal follows.
 *
 * The nodes of a level are contiguous, and so are their children. So each node is checked alone
 * with its right neighbour: its children must be successive, and the neighbour's first child must
 * follow its last one. With the first and last child of a level fixed, each child then has exactly
 * one parent. This needs no memory and runs on all threads. Entries of the channel "second" are
 * checked in the same way. A node is read more than once, and the file may change in between, so
 * numbers of children are bounded where they are used. */
#include <inttypes.h>
#include <string.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_layout_internal.h"

/* Entries of the channel "second" in a task. */
enum { ENTRIES_PER_TASK = 1 << 16 };

struct check {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    const struct nvdb_tile *tiles;
    const struct nvdb_upper *uppers;
    const struct nvdb_lower *lowers;
    const struct nvdb_leaf *leaves;
    uint64_t entry_count;
};

static int bad_node(const struct check *c, const char *level, uint64_t number, const char *what)
{
    return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: %s node %" PRIu64 " has a wrong %s",
                    c->grid->map.path, level, number, what);
}

/* A node's children [first, end), numbered within the level below. */
struct children {
    uint64_t first, end;
};

/* Reads the children that a node's table names for the bits of its mask. Returns false if there are
 * none, or if they are not successive nodes of the level below. base: offset from the node to the
 * first node of that level. */
static bool read_children(const uint64_t *child_mask, int words, const int64_t *table, int64_t base,
                          uint64_t child_bytes, uint64_t child_count, struct children *out)
{
    uint64_t next = UINT64_MAX, first = 0;
    for (int word = 0; word < words; word++) {
        for (uint64_t bits = child_mask[word]; bits; bits &= bits - 1) {
            /* Unsigned: a wrong offset wraps to a large number and fails the comparisons below. */
            uint64_t distance = (uint64_t)table[64 * word + __builtin_ctzll(bits)] - (uint64_t)base;
            if (next == UINT64_MAX) {
                if (distance % child_bytes != 0 || distance / child_bytes >= child_count)
                    return false;
                first = next = distance / child_bytes;
            } else if (next >= child_count || distance != next * child_bytes) {
                return false;
            }
            next++;
        }
    }
    if (next == UINT64_MAX)
        return false;
    *out = (struct children){first, next};
    return true;
}

static bool all_zero(const uint64_t *words, int count)
{
    uint64_t any = 0;
    for (int i = 0; i < count; i++)
        any |= words[i];
    return any == 0;
}

static bool upper_children(const struct check *c, uint64_t number, struct children *out)
{
    const struct nvdb_upper *upper = &c->uppers[number];
    return read_children(upper->child_mask, 512, upper->table,
                         (const char *)c->lowers - (const char *)upper, sizeof(*c->lowers),
                         c->grid->lower_count, out);
}

static bool lower_children(const struct check *c, uint64_t number, struct children *out)
{
    const struct nvdb_lower *lower = &c->lowers[number];
    return read_children(lower->child_mask, 64, lower->table,
                         (const char *)c->leaves - (const char *)lower, sizeof(*c->leaves),
                         c->grid->leaf_count, out);
}

/* Returns a node's first child, UINT64_MAX if there is none or its offset is wrong. */
static uint64_t first_child(const uint64_t *child_mask, int words, const int64_t *table,
                            int64_t base, uint64_t child_bytes)
{
    for (int word = 0; word < words; word++)
        if (child_mask[word]) {
            uint64_t distance =
                (uint64_t)table[64 * word + __builtin_ctzll(child_mask[word])] - (uint64_t)base;
            return distance % child_bytes == 0 ? distance / child_bytes : UINT64_MAX;
        }
    return UINT64_MAX;
}

static uint64_t upper_first_child(const struct check *c, uint64_t number)
{
    if (number == c->grid->upper_count)
        return c->grid->lower_count;
    const struct nvdb_upper *upper = &c->uppers[number];
    return first_child(upper->child_mask, 512, upper->table,
                       (const char *)c->lowers - (const char *)upper, sizeof(*c->lowers));
}

static uint64_t lower_first_child(const struct check *c, uint64_t number)
{
    if (number == c->grid->lower_count)
        return c->grid->leaf_count;
    const struct nvdb_lower *lower = &c->lowers[number];
    return first_child(lower->child_mask, 64, lower->table,
                       (const char *)c->leaves - (const char *)lower, sizeof(*c->leaves));
}

/* Sets the origin of a node with `dim` voxels along its edge: its lower bounds, rounded down. */
static void node_origin(const int32_t bbox_min[3], int32_t dim, int32_t origin[3])
{
    for (int axis = 0; axis < 3; axis++)
        origin[axis] = (int32_t)((uint32_t)bbox_min[axis] & ~((uint32_t)dim - 1));
}

/* Sets the origin of the child in `slot` of a node at `origin`. */
static void child_origin(const int32_t origin[3], uint32_t slot, int log2_slots, int32_t child_dim,
                         int32_t out[3])
{
    uint32_t low = (1u << log2_slots) - 1;
    uint32_t step[3] = {slot >> (2 * log2_slots), slot >> log2_slots & low, slot & low};
    for (int axis = 0; axis < 3; axis++)
        out[axis] = (int32_t)((uint32_t)origin[axis] + step[axis] * (uint32_t)child_dim);
}

static bool same_box(const int32_t a_min[3], const int32_t a_max[3], const int32_t b_min[3],
                     const int32_t b_max[3])
{
    return memcmp(a_min, b_min, 12) == 0 && memcmp(a_max, b_max, 12) == 0;
}

static int check_upper(const struct check *c, uint64_t number)
{
    const struct nvdb_upper *upper = &c->uppers[number];
    struct children children;
    if (!all_zero(upper->value_mask, 512) || !upper_children(c, number, &children) ||
        (number == 0 && children.first != 0) || upper_first_child(c, number + 1) != children.end)
        return bad_node(c, "upper", number, "child");
    int32_t origin[3];
    node_origin(upper->bbox_min, NVDB_UPPER_DIM, origin);
    if (nvdb_root_key(origin) != c->tiles[number].key)
        return bad_node(c, "upper", number, "place");

    int32_t bbox_min[3], bbox_max[3];
    fmt_nvdb_bbox_clear(bbox_min, bbox_max);
    uint64_t child = children.first;
    for (int word = 0; word < 512; word++) {
        for (uint64_t bits = upper->child_mask[word]; bits; bits &= bits - 1, child++) {
            if (child == children.end)
                return bad_node(c, "upper", number, "child");
            const struct nvdb_lower *lower = &c->lowers[child];
            int32_t expected[3], found[3];
            child_origin(origin, (uint32_t)(64 * word + __builtin_ctzll(bits)), 5, NVDB_LOWER_DIM,
                         expected);
            node_origin(lower->bbox_min, NVDB_LOWER_DIM, found);
            if (memcmp(expected, found, sizeof(found)) != 0)
                return bad_node(c, "lower", child, "place");
            fmt_nvdb_bbox_extend(bbox_min, bbox_max, lower->bbox_min, lower->bbox_max);
        }
    }
    if (!same_box(bbox_min, bbox_max, upper->bbox_min, upper->bbox_max))
        return bad_node(c, "upper", number, "bounding box");
    return 0;
}

/* Checks a leaf and extends the box of its parent. */
static int check_leaf(const struct check *c, uint64_t number, const int32_t origin[3],
                      int32_t bbox_min[3], int32_t bbox_max[3])
{
    const struct nvdb_leaf *leaf = &c->leaves[number];
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

static int check_lower(const struct check *c, uint64_t number)
{
    const struct nvdb_lower *lower = &c->lowers[number];
    struct children children;
    if (!all_zero(lower->value_mask, 64) || !lower_children(c, number, &children) ||
        (number == 0 && children.first != 0) || lower_first_child(c, number + 1) != children.end)
        return bad_node(c, "lower", number, "child");
    int32_t origin[3], bbox_min[3], bbox_max[3];
    node_origin(lower->bbox_min, NVDB_LOWER_DIM, origin);
    fmt_nvdb_bbox_clear(bbox_min, bbox_max);
    uint64_t child = children.first;
    for (int word = 0; word < 64; word++) {
        for (uint64_t bits = lower->child_mask[word]; bits; bits &= bits - 1, child++) {
            if (child == children.end)
                return bad_node(c, "lower", number, "child");
            int32_t leaf_origin[3];
            child_origin(origin, (uint32_t)(64 * word + __builtin_ctzll(bits)), 4, NVDB_LEAF_DIM,
                         leaf_origin);
            int status = check_leaf(c, child, leaf_origin, bbox_min, bbox_max);
            if (status)
                return status;
        }
    }
    if (!same_box(bbox_min, bbox_max, lower->bbox_min, lower->bbox_max))
        return bad_node(c, "lower", number, "bounding box");
    return 0;
}

/* Checks that ranks add up from entry to entry, and that bits are set for voxels only. */
static int check_seconds(const struct check *c, uint64_t task)
{
    const struct fmt_nvdb_grid *grid = c->grid;
    uint64_t begin = task * ENTRIES_PER_TASK, end = begin + ENTRIES_PER_TASK;
    if (end > c->entry_count)
        end = c->entry_count;
    uint64_t seconds = grid->record_count - 1 - grid->voxel_count;
    for (uint64_t i = begin; i < end; i++) {
        uint32_t bits = grid->seconds[i][0], beyond = 0;
        bool last = i + 1 == c->entry_count;
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
    for (uint32_t i = 0; i < grid->tile_count; i++) {
        const struct nvdb_tile *tile = &c->tiles[i];
        if ((i > 0 && tile->key <= tile[-1].key) || tile->child != (int64_t)child ||
            !all_zero(tile->values, 2))
            return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: root tile %" PRIu32 " is wrong",
                            grid->map.path, i);
        fmt_nvdb_bbox_extend(bbox_min, bbox_max, c->uppers[i].bbox_min, c->uppers[i].bbox_max);
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
        return check_lower(c, index);
    index -= c->grid->lower_count;
    if (index < c->grid->upper_count)
        return check_upper(c, index);
    return check_seconds(c, index - c->grid->upper_count);
}

int fmt_nvdb_check_nodes(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct check c = {
        .ctx = ctx,
        .grid = grid,
        .tiles = (const void *)grid->tiles,
        .uppers = (const void *)grid->uppers,
        .lowers = (const void *)grid->lowers,
        .leaves = (const void *)grid->leaves,
        .entry_count = grid->voxel_count / 32 + 1,
    };
    int status = check_root(&c);
    if (status)
        return status;
    uint64_t tasks = (c.entry_count + ENTRIES_PER_TASK - 1) / ENTRIES_PER_TASK;
    return bsq_parallel_for(ctx, (uint64_t)grid->lower_count + grid->upper_count + tasks,
                            check_task, &c);
}
