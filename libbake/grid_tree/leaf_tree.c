/* leaf_tree.c - builds the tree of boxes around the voxels of a grid.
 *
 * The leaves are listed in Morton order. Nodes are made from the root down: each has a range of
 * that list and divides it where the highest bit changes, until there are eight parts or only
 * single leaves. Boxes are then made from the last node up, since children follow their parents. */
#include "libbake/grid_tree/leaf_tree.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "base/context.h"
#include "base/sort_array.h"
#include "formats/grid/nvdb.h"

/* A leaf of the grid. */
struct leaf {
    int32_t corner[3]; /* lowest voxel */
    uint32_t number;
};

/* A part of the list of leaves. */
struct range {
    uint64_t begin, end;
};

/* A lower node of the grid: 16^3 leaves. */
struct lower_node {
    int32_t corner[3];
    uint32_t lower;
};

/* The state of a node while the tree is built, in its borders until make_boxes() fills these. */
struct pending {
    struct range range; /* its leaves */
    uint32_t children;
};
_Static_assert(sizeof(struct pending) <= sizeof((struct bake_tree_node *)0)->borders,
               "borders hold what is pending");

/* Nodes, and lower nodes of the grid, that are handled between checks for an interruption. */
enum { CHECKED = 4096, CHECKED_LOWERS = 64 };

struct builder {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    struct lower_node *lowers;
    uint64_t lower_count;
    struct leaf *leaves;
    uint64_t leaf_count;
    struct bake_tree *tree;
};

struct box {
    int32_t low[3], high[3]; /* borders */
};

/* Returns the axis with the highest bit in which two corners differ; the first one if several
 * differ in that bit. It decides their Morton order (Chan, "A minimalist's implementation of an
 * approximate nearest neighbor algorithm", 2006). *bits: the XOR of the coordinates on that axis.
 */
static int first_axis(const int32_t a[3], const int32_t b[3], uint32_t *bits)
{
    int axis = 0;
    *bits = 0;
    for (int i = 0; i < 3; i++) {
        const uint32_t differ = (uint32_t)a[i] ^ (uint32_t)b[i];
        if (*bits < differ && *bits < (*bits ^ differ)) {
            *bits = differ;
            axis = i;
        }
    }
    return axis;
}

static int by_morton_order(const void *left, const void *right)
{
    const int32_t *a = ((const struct lower_node *)left)->corner;
    const int32_t *b = ((const struct lower_node *)right)->corner;
    uint32_t bits;
    const int axis = first_axis(a, b, &bits);
    return (a[axis] > b[axis]) - (a[axis] < b[axis]);
}

/* ---- nodes of the grid ---- */

typedef int node_visit(void *arg, uint32_t lower, const int32_t origin[3]);

/* Returns the number of child n of a node; its level's first node is `distance` bytes before that
 * of the children's level. */
static uint32_t leaves_child_of(const uint64_t *words, uint64_t node_at, uint32_t mask,
                                uint32_t table, uint32_t n, uint64_t distance, uint32_t child_words,
                                uint32_t count)
{
    if (!(words[mask + (n >> 6)] >> (n & 63) & 1))
        return BK_NONE;
    const uint64_t number = (node_at + words[table + n] - distance) / (child_words * UINT64_C(8));
    return number < count ? (uint32_t)number : BK_NONE;
}

static uint32_t upper_lower(const struct fmt_nvdb_grid *grid, uint32_t upper, uint32_t n)
{
    const uint64_t at = (uint64_t)upper * BK_UPPER_WORDS * 8;
    return leaves_child_of((const uint64_t *)(const void *)(grid->uppers + at), at,
                           BK_UPPER_CHILD_MASK, BK_UPPER_TABLE, n,
                           (uint64_t)(grid->lowers - grid->uppers), BK_LOWER_WORDS,
                           grid->lower_count);
}

/* Returns the number of a leaf of a lower node; BK_NONE if there is none, or if the grid has no
 * such leaf: the file may change while it is read. */
static uint32_t lower_leaf(const struct fmt_nvdb_grid *grid, uint32_t lower, uint32_t n)
{
    const uint64_t at = (uint64_t)lower * BK_LOWER_WORDS * 8;
    return leaves_child_of((const uint64_t *)(const void *)(grid->lowers + at), at,
                           BK_LOWER_CHILD_MASK, BK_LOWER_TABLE, n,
                           (uint64_t)(grid->leaves - grid->lowers), BK_LEAF_WORDS,
                           grid->leaf_count);
}

static int visit_upper(const struct fmt_nvdb_grid *grid, uint32_t upper, const int32_t origin[3],
                       node_visit *visit, void *arg)
{
    uint32_t first[3], last[3];
    int status = 0;
    for (int k = 0; k < 3; k++) {
        const int64_t a = ((int64_t)grid->index_min[k] - origin[k]) >> BK_LOWER_LOG2;
        const int64_t b = ((int64_t)grid->index_max[k] - origin[k]) >> BK_LOWER_LOG2;
        first[k] = a < 0 ? 0 : (uint32_t)a;
        last[k] = b > 31 ? 31 : (uint32_t)b;
    }
    for (uint32_t x = first[0]; x <= last[0]; x++)
        for (uint32_t y = first[1]; y <= last[1]; y++)
            for (uint32_t z = first[2]; status == 0 && z <= last[2]; z++) {
                const uint32_t lower = upper_lower(grid, upper, x << 10 | y << 5 | z);
                const int32_t at[3] = {origin[0] + (int32_t)(x << BK_LOWER_LOG2),
                                       origin[1] + (int32_t)(y << BK_LOWER_LOG2),
                                       origin[2] + (int32_t)(z << BK_LOWER_LOG2)};
                status = lower == BK_NONE ? 0 : visit(arg, lower, at);
            }
    return status;
}

/* Returns the lowest voxel of a root tile along the axis whose key bits begin at `shift`. */
static int32_t tile_origin(uint64_t key, uint32_t shift)
{
    const uint32_t bits = (uint32_t)(key >> shift) & 0xfffff; /* x >> 12 of a 32-bit x */
    return (int32_t)(bits << BK_UPPER_LOG2);
}

/* Calls visit() for each lower node of a grid that overlaps its bounds. origin: the node's lowest
 * voxel. Returns the first result of visit() that is not 0, after which it stops. */
static int leaves_visit_nodes(const struct fmt_nvdb_grid *grid, node_visit *visit, void *arg)
{
    const uint64_t *tiles = (const uint64_t *)(const void *)grid->tiles;
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < grid->tile_count; i++) {
        const uint64_t key = tiles[i * BK_TILE_WORDS], child = tiles[i * BK_TILE_WORDS + 1];
        const uint64_t upper =
            (child - (uint64_t)(grid->uppers - grid->root)) / (BK_UPPER_WORDS * UINT64_C(8));
        const int32_t origin[3] = {tile_origin(key, 42), tile_origin(key, 21), tile_origin(key, 0)};
        bool inside = child != 0 && upper < grid->upper_count;
        for (int k = 0; k < 3; k++)
            inside = inside && grid->index_max[k] >= origin[k] &&
                     grid->index_min[k] <= (int64_t)origin[k] + (1 << BK_UPPER_LOG2) - 1;
        if (inside)
            status = visit_upper(grid, (uint32_t)upper, origin, visit, arg);
    }
    return status;
}

/* ---- the list of leaves ---- */

static int add_lower(void *arg, uint32_t lower, const int32_t origin[3])
{
    struct builder *builder = arg;
    if (builder->lower_count == builder->grid->lower_count)
        return 0; /* the file is damaged */
    builder->lowers[builder->lower_count++] =
        (struct lower_node){{origin[0], origin[1], origin[2]}, lower};
    return builder->lower_count % CHECKED_LOWERS ? 0 : bsq_check(builder->ctx);
}

static int list_lowers(struct builder *builder)
{
    int status = leaves_visit_nodes(builder->grid, add_lower, builder);
    bsq_sort(builder->lowers, builder->lower_count, sizeof *builder->lowers, by_morton_order);
    return status;
}

/* Returns every third of the lowest twelve bits. */
static uint32_t third_bits(uint32_t code)
{
    return (code & 1) | (code >> 2 & 2) | (code >> 4 & 4) | (code >> 6 & 8);
}

static int list_leaves(struct builder *builder)
{
    const struct fmt_nvdb_grid *grid = builder->grid;
    for (uint64_t b = 0; b < builder->lower_count; b++) {
        const struct lower_node *lower = &builder->lowers[b];
        int status = b % CHECKED_LOWERS ? 0 : bsq_check(builder->ctx);
        if (status < 0)
            return status;
        if (b > 0 && by_morton_order(lower - 1, lower) == 0)
            continue; /* the file is damaged */
        for (uint32_t code = 0; code < 1u << 12; code++) {
            const uint32_t x = third_bits(code >> 2), y = third_bits(code >> 1);
            const uint32_t z = third_bits(code);
            const uint32_t leaf = lower_leaf(grid, lower->lower, x << 8 | y << 4 | z);
            if (leaf == BK_NONE)
                continue;
            if (builder->leaf_count == grid->leaf_count)
                return 0; /* the file is damaged */
            builder->leaves[builder->leaf_count++] =
                (struct leaf){.corner = {lower->corner[0] + (int32_t)(x << BK_LEAF_LOG2),
                                         lower->corner[1] + (int32_t)(y << BK_LEAF_LOG2),
                                         lower->corner[2] + (int32_t)(z << BK_LEAF_LOG2)},
                              .number = leaf};
        }
    }
    return 0;
}

/* ---- nodes ---- */

/* Returns the level at which a range of leaves splits: 3 * bit + 3 - axis of the highest bit in
 * which the first leaf and the last differ; 0 for a single leaf. *middle: the index of the first
 * leaf whose bit is that of the last. */
static uint32_t leaves_split(const struct builder *builder, const struct range *range,
                             uint64_t *middle)
{
    const struct leaf *leaves = builder->leaves;
    uint64_t low = range->begin, high = range->end - 1;
    const int32_t *first = leaves[low].corner;
    uint32_t bits;
    const int axis = first_axis(first, leaves[high].corner, &bits);
    if (bits == 0)
        return 0;
    const uint32_t bit = 31 - (uint32_t)__builtin_clz(bits);
    const uint32_t same = ((uint32_t)first[axis] >> bit) & 1;
    while (high - low > 1) {
        const uint64_t at = low + (high - low) / 2;
        if (((uint32_t)leaves[at].corner[axis] >> bit & 1) == same)
            low = at;
        else
            high = at;
    }
    *middle = high;
    return 3 * bit + 3 - (uint32_t)axis;
}

/* Divides a range into at most eight parts, in order. Returns their number. */
static uint32_t leaves_divide(const struct builder *builder, struct range parts[BAKE_TREE_WIDTH])
{
    uint64_t middles[BAKE_TREE_WIDTH];
    uint32_t levels[BAKE_TREE_WIDTH], count = 1;
    levels[0] = leaves_split(builder, &parts[0], &middles[0]);
    while (count < BAKE_TREE_WIDTH) {
        uint32_t best = 0;
        for (uint32_t i = 1; i < count; i++)
            if (levels[i] > levels[best])
                best = i;
        if (levels[best] == 0)
            break;
        for (uint32_t i = count++; i > best; i--) {
            parts[i] = parts[i - 1];
            levels[i] = levels[i - 1];
            middles[i] = middles[i - 1];
        }
        parts[best].end = parts[best + 1].begin = middles[best];
        levels[best] = leaves_split(builder, &parts[best], &middles[best]);
        levels[best + 1] = leaves_split(builder, &parts[best + 1], &middles[best + 1]);
    }
    return count;
}

static struct pending get_pending(const struct bake_tree_node *node)
{
    struct pending pending;
    memcpy(&pending, node->borders, sizeof pending);
    return pending;
}

/* Appends nodes that each have a range of leaves. */
static int leaves_append(struct builder *builder, const struct range *ranges, uint32_t count)
{
    struct bake_tree *tree = builder->tree;
    int status = bsq_grow(builder->ctx, "tree of leaves", tree->count + count, sizeof *tree->nodes,
                          &tree->nodes, &tree->capacity);
    for (uint32_t i = 0; status == 0 && i < count; i++) {
        const struct pending pending = {.range = ranges[i]};
        struct bake_tree_node *node = &tree->nodes[tree->count++];
        memset(node, 0, sizeof *node);
        memcpy(node->borders, &pending, sizeof pending);
    }
    return status;
}

/* Gives a node its children. */
static int add_children(struct builder *builder, uint64_t number)
{
    struct bake_tree *tree = builder->tree;
    struct pending pending = get_pending(&tree->nodes[number]);
    struct range parts[BAKE_TREE_WIDTH] = {pending.range};
    if (pending.range.end - pending.range.begin == 1) {
        const struct leaf *leaf = &builder->leaves[pending.range.begin];
        struct bake_tree_node *node = &tree->nodes[number];
        memcpy(node->corner, leaf->corner, sizeof node->corner);
        node->first = leaf->number;
        node->corner[2] |= 1;
        return 0;
    }
    pending.children = leaves_divide(builder, parts);
    memcpy(tree->nodes[number].borders, &pending, sizeof pending);
    tree->nodes[number].first = (uint32_t)tree->count;
    return leaves_append(builder, parts, pending.children);
}

/* ---- boxes ---- */

/* Returns the occupied voxels of a block of a leaf. */
static uint64_t occupied_voxels(const struct fmt_nvdb_grid *grid, uint64_t leaf, uint32_t block)
{
    const uint64_t *words = (const uint64_t *)(const void *)grid->leaves + leaf * BK_LEAF_WORDS +
                            BK_LEAF_MASK + (block & 4);
    const uint32_t shift = (block & 2) << 4 | (block & 1) << 2;
    uint64_t all = 0;
    for (uint32_t x = 0; x < 4; x++) {
        /* Four rows of four bits, a byte apart. */
        uint64_t rows = words[x] >> shift & 0x0f0f0f0f;
        rows = (rows | rows >> 4) & 0x00ff00ff;
        all |= ((rows | rows >> 8) & 0xffff) << (16 * x);
    }
    return all;
}

/* Finds the lowest and the highest of up to four bits. */
static void leaves_bit_range(uint32_t bits, uint32_t from, uint8_t *low, uint8_t *high)
{
    *low = (uint8_t)(bits ? from + (uint32_t)__builtin_ctz(bits) : UINT8_MAX);
    *high = (uint8_t)(bits ? from + 32 - (uint32_t)__builtin_clz(bits) : 0);
}

/* Makes the boxes of a leaf's blocks. */
static void make_blocks(const struct fmt_nvdb_grid *grid, const struct bake_tree *tree,
                        struct bake_tree_node *node)
{
    for (uint32_t block = 0; block < BAKE_TREE_WIDTH; block++) {
        const uint64_t voxels = occupied_voxels(grid, node->first, block);
        const uint32_t from[3] = {block & 4, block << 1 & 4, block << 2 & 4};
        uint32_t bits[3] = {0, 0, 0};
        for (uint32_t i = 0; i < 16; i++) {
            const uint32_t row = (uint32_t)(voxels >> (4 * i)) & 15, some = row != 0;
            bits[0] |= some << (i >> 2);
            bits[1] |= some << (i & 3);
            bits[2] |= row;
        }
        for (int axis = 0; axis < 3; axis++)
            leaves_bit_range(bits[axis], from[axis], &node->borders[axis][0][block],
                             &node->borders[axis][1][block]);
        tree->blocks[node->first][block] = voxels;
    }
}

/* The box of nothing. */
static const struct box no_box = {{INT32_MAX, INT32_MAX, INT32_MAX},
                                  {INT32_MIN, INT32_MIN, INT32_MIN}};

static void leaves_join(struct box *box, const struct box *other)
{
    for (int axis = 0; axis < 3; axis++) {
        if (other->low[axis] < box->low[axis])
            box->low[axis] = other->low[axis];
        if (other->high[axis] > box->high[axis])
            box->high[axis] = other->high[axis];
    }
}

/* Returns the box around the boxes of a node's children. */
static struct box node_box(const struct bake_tree_node *node)
{
    const uint32_t shift = bake_tree_shift(node);
    struct box box;
    for (int axis = 0; axis < 3; axis++) {
        uint8_t low = UINT8_MAX, high = 0;
        for (int i = 0; i < BAKE_TREE_WIDTH; i++) {
            if (node->borders[axis][0][i] > node->borders[axis][1][i])
                continue;
            low = node->borders[axis][0][i] < low ? node->borders[axis][0][i] : low;
            high = node->borders[axis][1][i] > high ? node->borders[axis][1][i] : high;
        }
        if (low > high)
            low = high; /* a leaf without voxels: the file is damaged */
        box.low[axis] = bake_tree_corner(node, axis) + ((int32_t)low << shift);
        box.high[axis] = bake_tree_corner(node, axis) + ((int32_t)high << shift);
    }
    return box;
}

/* Stores the boxes of a node's children in its borders. */
static void make_boxes(const struct bake_tree *tree, struct bake_tree_node *node)
{
    const uint32_t children = get_pending(node).children;
    struct box boxes[BAKE_TREE_WIDTH] = {{{0}, {0}}}, whole = no_box;
    uint32_t shift = 0;
    for (uint32_t i = 0; i < children; i++) {
        boxes[i] = node_box(&tree->nodes[node->first + i]);
        leaves_join(&whole, &boxes[i]);
    }
    for (int axis = 0; axis < 3; axis++)
        while ((whole.high[axis] - (whole.low[axis] & ~7)) >> shift > UINT8_MAX - 1)
            shift += 2;
    for (int axis = 0; axis < 3; axis++) {
        const int32_t corner = whole.low[axis] & ~7, up = (1 << shift) - 1;
        node->corner[axis] = corner;
        for (uint32_t i = 0; i < BAKE_TREE_WIDTH; i++) {
            const bool some = i < children;
            node->borders[axis][0][i] =
                some ? (uint8_t)((boxes[i].low[axis] - corner) >> shift) : UINT8_MAX;
            node->borders[axis][1][i] =
                some ? (uint8_t)((boxes[i].high[axis] - corner + up) >> shift) : 0;
        }
    }
    assert(shift <= 14);
    node->corner[0] |= (int32_t)(shift / 2);
}

/* Makes a root whose children are missing. */
static int add_empty_root(struct builder *builder)
{
    const int status = leaves_append(builder, &(struct range){0, 0}, 1);
    for (int axis = 0; status == 0 && axis < 3; axis++) {
        memset(builder->tree->nodes->borders[axis][0], UINT8_MAX, BAKE_TREE_WIDTH);
        memset(builder->tree->nodes->borders[axis][1], 0, BAKE_TREE_WIDTH);
    }
    return status;
}

/* Makes the root and all its descendants. */
static int add_nodes(struct builder *builder)
{
    struct bake_tree *tree = builder->tree;
    int status;
    BSQ_TRY(leaves_append(builder, &(struct range){0, builder->leaf_count}, 1));
    for (uint64_t i = 0; i < tree->count; i++) {
        if (i % CHECKED == 0)
            BSQ_TRY(bsq_check(builder->ctx));
        BSQ_TRY(add_children(builder, i));
    }
    for (uint64_t i = tree->count; i-- > 0;) {
        if (i % CHECKED == 0)
            BSQ_TRY(bsq_check(builder->ctx));
        if (bake_tree_is_leaf(&tree->nodes[i]))
            make_blocks(builder->grid, tree, &tree->nodes[i]);
        else
            make_boxes(tree, &tree->nodes[i]);
    }
    const struct box whole = node_box(&tree->nodes[0]);
    memcpy(tree->low, whole.low, sizeof tree->low);
    memcpy(tree->high, whole.high, sizeof tree->high);
done:
    return status;
}

/* Fails unless the leaves are within BAKE_TREE_EXTENT of each other, and few enough. */
static int check_extent(const struct builder *builder)
{
    struct box box = no_box;
    bool fits = builder->leaf_count <= BAKE_TREE_MOST / 2;
    for (uint64_t i = 0; i < builder->lower_count; i++) {
        struct box block;
        for (int axis = 0; axis < 3; axis++) {
            block.low[axis] = builder->lowers[i].corner[axis];
            block.high[axis] = block.low[axis] + (1 << BK_LOWER_LOG2);
        }
        leaves_join(&box, &block);
    }
    for (int axis = 0; axis < 3 && builder->lower_count > 0; axis++)
        fits &= (int64_t)box.high[axis] - box.low[axis] <= BAKE_TREE_EXTENT;
    return fits ? 0
                : bsq_fail(builder->ctx, BSQ_EDATA,
                           "%s: rays from hits need a grid of at most %d voxels along each axis "
                           "and %u leaves",
                           builder->grid->map.path, BAKE_TREE_EXTENT,
                           (unsigned)(BAKE_TREE_MOST / 2));
}

int bake_tree_build(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, struct bake_tree *tree)
{
    struct builder builder = {.ctx = ctx, .grid = grid, .tree = tree};
    int status;

    *tree = (struct bake_tree){0};
    BSQ_TRY(
        bsq_alloc(ctx, "lower nodes", grid->lower_count, sizeof *builder.lowers, &builder.lowers));
    BSQ_TRY(bsq_alloc(ctx, "leaves", grid->leaf_count, sizeof *builder.leaves, &builder.leaves));
    BSQ_TRY(
        bsq_alloc(ctx, "blocks of leaves", grid->leaf_count, sizeof *tree->blocks, &tree->blocks));
    BSQ_TRY(list_lowers(&builder));
    BSQ_TRY(list_leaves(&builder));
    BSQ_TRY(check_extent(&builder));
    status = builder.leaf_count > 0 ? add_nodes(&builder) : add_empty_root(&builder);
done:
    bsq_free(ctx, builder.lowers);
    bsq_free(ctx, builder.leaves);
    if (status < 0)
        bake_tree_free(ctx, tree);
    return status;
}

void bake_tree_free(struct bsq_ctx *ctx, struct bake_tree *tree)
{
    bsq_free(ctx, tree->nodes);
    bsq_free(ctx, tree->blocks);
    *tree = (struct bake_tree){0};
}
