/* closest.c - see closest.h. A binary tree, split at the median of the triangles' middles along the
 * longest side. A query visits the nearer child first. */
#include "libvoxel/simplify/closest.h"

#include <math.h>
#include <string.h>

#include "base/geometry/middles.h"
#include "libvoxel/simplify/distance_lanes.h"

/* The depth is that of halving 2^32 triangles into leaves. */
enum { LEAF_TRIANGLES = 4, DEPTH_MAX = 32 };

struct vox_closest_node {
    float low[3], high[3];
    uint32_t begin, end; /* in order[] */
    uint32_t right;      /* the other child; the left one follows its parent. 0: a leaf */
};

struct build {
    struct vox_closest *tree;
    struct bsq_middle *middles; /* of triangles, twice; NULL: these are in order */
    uint32_t node_count;
};

static void bound_triangle(const struct vox_closest *tree, uint32_t triangle, float low[3],
                           float high[3])
{
    const uint32_t *t = tree->triangles[triangle];
    for (int k = 0; k < 3; k++) {
        const float x = tree->positions[t[0]][k], y = tree->positions[t[1]][k],
                    z = tree->positions[t[2]][k];
        const float less = x < y ? x : y, more = x < y ? y : x;
        low[k] = less < z ? less : z;
        high[k] = more > z ? more : z;
    }
}

static void bound_node(const struct build *b, struct vox_closest_node *node)
{
    for (int k = 0; k < 3; k++) {
        node->low[k] = INFINITY;
        node->high[k] = -INFINITY;
    }
    for (uint32_t i = node->begin; i < node->end; i++) {
        float low[3], high[3];
        bound_triangle(b->tree, b->middles ? b->middles[i].number : i, low, high);
        for (int k = 0; k < 3; k++) {
            node->low[k] = low[k] < node->low[k] ? low[k] : node->low[k];
            node->high[k] = high[k] > node->high[k] ? high[k] : node->high[k];
        }
    }
}

static void build_node(struct build *b, uint32_t begin, uint32_t end)
{
    struct vox_closest_node *node = &b->tree->nodes[b->node_count++];
    const bool leaf = end - begin <= LEAF_TRIANGLES;
    const uint32_t middle = begin + (end - begin) / 2;
    *node = (struct vox_closest_node){.begin = begin, .end = end};
    if (leaf || b->middles)
        bound_node(b, node);
    if (leaf)
        return;
    if (b->middles) {
        int axis = 0;
        for (int k = 1; k < 3; k++)
            axis = node->high[k] - node->low[k] > node->high[axis] - node->low[axis] ? k : axis;
        bsq_select_middles(b->middles + begin, end - begin, middle - begin, axis);
    }
    build_node(b, begin, middle);
    node->right = b->node_count;
    build_node(b, middle, end);
    const struct vox_closest_node *left = node + 1, *right = &b->tree->nodes[node->right];
    for (int k = 0; k < 3; k++) {
        node->low[k] = left->low[k] < right->low[k] ? left->low[k] : right->low[k];
        node->high[k] = left->high[k] > right->high[k] ? left->high[k] : right->high[k];
    }
}

int vox_closest_build(struct bsq_ctx *ctx, const float (*positions)[3],
                      const uint32_t (*triangles)[3], uint32_t triangle_count, bool in_order,
                      struct vox_closest *out)
{
    struct build b = {.tree = out};
    int status = 0;
    *out = (struct vox_closest){
        .positions = positions, .triangles = triangles, .level = bsq_simd_best()};
    /* Leaves have at least half of LEAF_TRIANGLES. */
    BSQ_TRY(BSQ_ALLOC(ctx, "a tree of triangles", triangle_count + 1, &out->nodes));
    BSQ_TRY(BSQ_ALLOC(ctx, "a tree of triangles", triangle_count, &out->order));
    if (!in_order)
        BSQ_TRY(BSQ_ALLOC(ctx, "a tree of triangles", triangle_count, &b.middles));
    for (uint32_t t = 0; t < triangle_count && b.middles; t++) {
        float low[3], high[3];
        bound_triangle(out, t, low, high);
        b.middles[t].number = t;
        for (int k = 0; k < 3; k++)
            b.middles[t].at[k] = low[k] + high[k];
    }
    build_node(&b, 0, triangle_count);
    for (uint32_t i = 0; i < triangle_count; i++)
        out->order[i] = b.middles ? b.middles[i].number : i;
done:
    bsq_free(ctx, b.middles);
    if (status < 0)
        vox_closest_free(ctx, out);
    return status;
}

void vox_closest_free(struct bsq_ctx *ctx, struct vox_closest *tree)
{
    BSQ_FREE(ctx, tree->nodes, tree->order);
    *tree = (struct vox_closest){0};
}

static void find_most(struct vox_batch *b)
{
    b->most = 0;
    for (unsigned i = 0; i < b->count; i++)
        b->most = b->squares[i] > b->most ? b->squares[i] : b->most;
}

/* Does what vox_try_triangle() does, for one point. Divides only if the point may be closer. */
double vox_triangle_square_at(const float *const corners[3], const double p[3], double most)
{
    struct vox_plane plane;
    vox_set_plane(corners, &plane);
    const double *c = plane.corners[2], to[3] = {p[0] - c[0], p[1] - c[1], p[2] - c[2]};
    const double height = bsq_dotd(to, plane.normal), above = height * height;
    const double limit = most * plane.area;
    bool inside = plane.area > 0;
    if (above * plane.safe > limit)
        return most;
    for (int k = 0; k < 3; k++) {
        const double way[3] = {p[0] - plane.corners[k][0], p[1] - plane.corners[k][1],
                               p[2] - plane.corners[k][2]};
        const double beyond = bsq_dotd(way, plane.outwards[k]), square = plane.squares[k];
        if (beyond > 0 && (above * square + beyond * beyond) * plane.safe > limit * square)
            return most;
        inside &= beyond <= 0;
    }
    vox_set_inverses(&plane);
    const double square =
        inside ? above * plane.inverse_area : vox_edge_square(&plane, p[0], p[1], p[2]);
    return square < most ? square : most;
}

double vox_triangle_square(const float *const corners[3], const float point[3], double most)
{
    const double p[3] = {(double)point[0], (double)point[1], (double)point[2]};
    return vox_triangle_square_at(corners, p, most);
}

/* Tries a triangle of a leaf if its own box is near enough. */
static void try_boxed(const struct vox_closest *tree, uint32_t triangle, struct vox_batch *b)
{
    const float *corners[3];
    float low[3], high[3];
    bound_triangle(tree, triangle, low, high);
    if (!(vox_box_square(low, high, b->low, b->high) < b->most))
        return;
    vox_closest_corners(tree, triangle, corners);
    if (b->count > 1) {
        BSQ_SIMD_PICK(tree->level, vox_try_triangle)(corners, triangle, b);
        find_most(b);
        return;
    }
    const double p[3] = {b->points[0][0], b->points[1][0], b->points[2][0]};
    const double square = vox_triangle_square_at(corners, p, b->most);
    if (square < b->most)
        b->owners[0] = triangle;
    b->most = b->squares[0] = square;
}

static void walk_tree(const struct vox_closest *tree, struct vox_batch *b)
{
    struct {
        uint32_t node;
        double square;
    } stack[DEPTH_MAX + 1];
    unsigned depth = 0;
    const struct vox_closest_node *nodes = tree->nodes;
    stack[depth].node = 0;
    stack[depth++].square = vox_box_square(nodes->low, nodes->high, b->low, b->high);
    while (depth > 0) {
        const uint32_t at = stack[--depth].node;
        if (!(stack[depth].square < b->most))
            continue;
        const struct vox_closest_node *node = &nodes[at];
        if (node->right == 0) {
            for (uint32_t i = node->begin; i < node->end; i++)
                try_boxed(tree, tree->order[i], b);
            continue;
        }
        const struct vox_closest_node *left = node + 1, *right = &nodes[node->right];
        const double to_left = vox_box_square(left->low, left->high, b->low, b->high),
                     to_right = vox_box_square(right->low, right->high, b->low, b->high);
        const bool left_first = to_left <= to_right;
        stack[depth].node = left_first ? node->right : at + 1;
        stack[depth].square = left_first ? to_right : to_left;
        depth += stack[depth].square < b->most;
        stack[depth].node = left_first ? at + 1 : node->right;
        stack[depth++].square = left_first ? to_left : to_right;
    }
}

static void set_batch(const float (*points)[3], unsigned count, double *squares,
                      struct vox_batch *b)
{
    b->count = count;
    b->squares = squares;
    memcpy(b->low, points[0], sizeof b->low);
    memcpy(b->high, points[0], sizeof b->high);
    for (unsigned i = 0; i < count; i++) {
        b->owners[i] = -1;
        for (int k = 0; k < 3; k++) {
            const float x = points[i][k];
            b->points[k][i] = (double)x;
            b->low[k] = x < b->low[k] ? x : b->low[k];
            b->high[k] = x > b->high[k] ? x : b->high[k];
        }
    }
    find_most(b);
}

void vox_closest_squares(const struct vox_closest *tree, const float (*points)[3], unsigned count,
                         double *squares, uint32_t *triangles)
{
    struct vox_batch b;
    set_batch(points, count, squares, &b);
    walk_tree(tree, &b);
    for (unsigned i = 0; i < count && triangles; i++)
        if (b.owners[i] >= 0)
            triangles[i] = (uint32_t)b.owners[i];
}

uint32_t vox_closest_point(const struct vox_closest *tree, const double point[3], double *square)
{
    struct vox_batch b = {.count = 1, .squares = square, .owners = {-1}};
    for (int k = 0; k < 3; k++) {
        const float x = (float)point[k];
        b.points[k][0] = point[k];
        b.low[k] = (double)x > point[k] ? nextafterf(x, -INFINITY) : x;
        b.high[k] = (double)x < point[k] ? nextafterf(x, INFINITY) : x;
    }
    find_most(&b);
    walk_tree(tree, &b);
    return b.owners[0] >= 0 ? (uint32_t)b.owners[0] : UINT32_MAX;
}

bool vox_closest_near(const struct vox_closest *tree, const float low[3], const float high[3],
                      double square, bool (*found)(void *arg, uint32_t triangle, double square),
                      void *arg)
{
    uint32_t stack[DEPTH_MAX + 1];
    unsigned depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const uint32_t at = stack[--depth];
        const struct vox_closest_node *node = &tree->nodes[at];
        if (vox_box_square(node->low, node->high, low, high) > square)
            continue;
        if (node->right > 0) {
            stack[depth++] = node->right;
            stack[depth++] = at + 1;
            continue;
        }
        for (uint32_t i = node->begin; i < node->end; i++) {
            float own_low[3], own_high[3];
            bound_triangle(tree, tree->order[i], own_low, own_high);
            const double own = vox_box_square(own_low, own_high, low, high);
            if (own <= square && found(arg, tree->order[i], own))
                return true;
        }
    }
    return false;
}
