/* leaf_tree.c - builds the tree of boxes around the voxels of a grid.
 *
 * The leaves are sorted in Morton order. Nodes are made from the root down: each has a range of
 * that list and divides it where the highest bit changes, until there are eight ranges or only
 * single leaves. Boxes are then made from the last node up, since children follow their parents. */
#include "libbake/grid_tree/leaf_tree.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "base/context.h"
#include "base/geometry/space_curve.h"
#include "base/sort_array.h"
#include "formats/grid/nvdb.h"

/* A leaf of the grid. */
struct leaf {
    uint64_t key;      /* of its place in Morton order (1966) */
    int32_t corner[3]; /* lowest voxel */
    uint32_t number;
};

/* A range of the list of leaves. */
struct range {
    uint64_t begin, end;
};

/* The state of a node while the tree is built, in its borders until make_boxes() fills these. */
struct pending {
    struct range range; /* its leaves */
    uint32_t children;
};
_Static_assert(sizeof(struct pending) <= sizeof((struct bake_tree_node *)0)->borders,
               "borders hold what is pending");

/* Nodes, and leaves of the grid, that are handled between checks for an interruption. */
enum { CHECKED = 4096 };

struct builder {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    struct leaf *leaves;
    uint64_t leaf_count;
    struct bake_tree *tree;
};

struct box {
    int32_t low[3], high[3]; /* borders */
};

/* ---- the list of leaves ---- */

static int by_key(const void *left, const void *right)
{
    const uint64_t a = ((const struct leaf *)left)->key, b = ((const struct leaf *)right)->key;
    return (a > b) - (a < b);
}

/* Sets a leaf's corner and key. Returns whether it is within the grid's bounds. */
static bool set_leaf(const struct fmt_nvdb_grid *grid, uint32_t number, struct leaf *leaf)
{
    uint32_t cell[3];
    bool inside = true;
    leaf->number = number;
    memcpy(leaf->corner, grid->leaves + (uint64_t)number * BK_LEAF_WORDS * 8, sizeof leaf->corner);
    for (int k = 0; k < 3; k++) {
        /* Twice the extent, so that corners from here on have 20 bits above those of a leaf. */
        const int32_t base = grid->index_min[k] & ~(2 * BAKE_TREE_EXTENT - 1);
        leaf->corner[k] &= ~7;
        inside &=
            leaf->corner[k] + 7 >= grid->index_min[k] && leaf->corner[k] <= grid->index_max[k];
        cell[k] = ((uint32_t)leaf->corner[k] - (uint32_t)base) >> BK_LEAF_LOG2;
    }
    leaf->key = bsq_morton_key(cell);
    return inside;
}

/* Lists the leaves in Morton order, each place once: the file may change while it is read. */
static int list_leaves(struct builder *builder)
{
    struct leaf *leaves = builder->leaves;
    uint64_t count = 0;
    for (uint32_t number = 0; number < builder->grid->leaf_count; number++) {
        BSQ_PASS(number % CHECKED ? 0 : bsq_check(builder->ctx));
        count += set_leaf(builder->grid, number, &leaves[count]);
    }
    bsq_sort(leaves, count, sizeof *leaves, by_key);
    for (uint64_t i = 0; i < count; i++)
        if (i == 0 || leaves[i - 1].key != leaves[i].key)
            leaves[builder->leaf_count++] = leaves[i];
    return 0;
}

/* ---- nodes ---- */

/* Returns the level at which a range of leaves splits: one more than the highest bit in which the
 * keys of the first leaf and the last differ; 0 for a single leaf. *middle: the index of the first
 * leaf whose bit is that of the last. */
static uint32_t leaves_split(const struct builder *builder, const struct range *range,
                             uint64_t *middle)
{
    const struct leaf *leaves = builder->leaves;
    uint64_t low = range->begin, high = range->end - 1;
    const uint64_t first = leaves[low].key, bits = first ^ leaves[high].key;
    if (bits == 0)
        return 0;
    const uint32_t bit = 63 - (uint32_t)__builtin_clzll(bits);
    while (high - low > 1) {
        const uint64_t at = low + (high - low) / 2;
        if ((leaves[at].key ^ first) >> bit & 1)
            high = at;
        else
            low = at;
    }
    *middle = high;
    return bit + 1;
}

/* Divides a range into at most eight ranges, in order. Returns their number. */
static uint32_t leaves_divide(const struct builder *builder, struct range ranges[BAKE_TREE_WIDTH])
{
    uint64_t middles[BAKE_TREE_WIDTH];
    uint32_t levels[BAKE_TREE_WIDTH], count = 1;
    levels[0] = leaves_split(builder, &ranges[0], &middles[0]);
    while (count < BAKE_TREE_WIDTH) {
        uint32_t best = 0;
        for (uint32_t i = 1; i < count; i++)
            if (levels[i] > levels[best])
                best = i;
        if (levels[best] == 0)
            break;
        for (uint32_t i = count++; i > best; i--) {
            ranges[i] = ranges[i - 1];
            levels[i] = levels[i - 1];
            middles[i] = middles[i - 1];
        }
        ranges[best].end = ranges[best + 1].begin = middles[best];
        levels[best] = leaves_split(builder, &ranges[best], &middles[best]);
        levels[best + 1] = leaves_split(builder, &ranges[best + 1], &middles[best + 1]);
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
    int status = BSQ_GROW(builder->ctx, "tree of leaves", tree->count + count, &tree->nodes,
                          &tree->capacity);
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
    struct range ranges[BAKE_TREE_WIDTH] = {pending.range};
    if (pending.range.end - pending.range.begin == 1) {
        const struct leaf *leaf = &builder->leaves[pending.range.begin];
        struct bake_tree_node *node = &tree->nodes[number];
        memcpy(node->corner, leaf->corner, sizeof node->corner);
        node->first = leaf->number;
        node->corner[2] |= 1;
        return 0;
    }
    pending.children = leaves_divide(builder, ranges);
    memcpy(tree->nodes[number].borders, &pending, sizeof pending);
    tree->nodes[number].first = (uint32_t)tree->count;
    return leaves_append(builder, ranges, pending.children);
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
    BSQ_PASS(leaves_append(builder, &(struct range){0, builder->leaf_count}, 1));
    for (uint64_t i = 0; i < tree->count; i++) {
        if (i % CHECKED == 0)
            BSQ_PASS(bsq_check(builder->ctx));
        BSQ_PASS(add_children(builder, i));
    }
    for (uint64_t i = tree->count; i-- > 0;) {
        if (i % CHECKED == 0)
            BSQ_PASS(bsq_check(builder->ctx));
        if (bake_tree_is_leaf(&tree->nodes[i]))
            make_blocks(builder->grid, tree, &tree->nodes[i]);
        else
            make_boxes(tree, &tree->nodes[i]);
    }
    const struct box whole = node_box(&tree->nodes[0]);
    memcpy(tree->low, whole.low, sizeof tree->low);
    memcpy(tree->high, whole.high, sizeof tree->high);
    return 0;
}

/* Fails for a grid that is wider than BAKE_TREE_EXTENT or has too many leaves. */
static int check_extent(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    bool fits = grid->leaf_count <= BAKE_TREE_MOST / 2;
    for (int axis = 0; axis < 3; axis++)
        fits &= (int64_t)grid->index_max[axis] - grid->index_min[axis] < BAKE_TREE_EXTENT;
    return fits ? 0
                : bsq_fail(ctx, BSQ_EDATA,
                           "%s: rays from hits need a grid of at most %d voxels along each axis "
                           "and %u leaves",
                           grid->map.path, BAKE_TREE_EXTENT, (unsigned)(BAKE_TREE_MOST / 2));
}

int bake_tree_build(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, struct bake_tree *tree)
{
    struct builder builder = {.ctx = ctx, .grid = grid, .tree = tree};
    int status;

    *tree = (struct bake_tree){0};
    BSQ_TRY(check_extent(ctx, grid));
    BSQ_TRY(BSQ_ALLOC(ctx, "leaves", grid->leaf_count, &builder.leaves));
    BSQ_TRY(BSQ_ALLOC(ctx, "blocks of leaves", grid->leaf_count, &tree->blocks));
    BSQ_TRY(list_leaves(&builder));
    status = builder.leaf_count > 0 ? add_nodes(&builder) : add_empty_root(&builder);
done:
    bsq_free(ctx, builder.leaves);
    if (status < 0)
        bake_tree_free(ctx, tree);
    return status;
}

void bake_tree_free(struct bsq_ctx *ctx, struct bake_tree *tree)
{
    BSQ_FREE(ctx, tree->nodes, tree->blocks);
    *tree = (struct bake_tree){0};
}
