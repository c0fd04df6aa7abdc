/* closest.c - see closest.h. A binary tree, split at the median of the triangles' middles along the
 * longest side. A query visits the nearer child first. */
#include "libvoxel/simplify/closest.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"

/* The depth is that of halving 2^32 triangles into leaves. */
enum { LEAF_TRIANGLES = 4, DEPTH_MAX = 32 };
/* A triangle is a needle if its height above its longest side is at most a thousandth of that side.
 * This is the square of that ratio. */
static const double needle_area = 1e-6;

struct vox_closest_node {
    float low[3], high[3];
    uint32_t begin, end; /* in order[] */
    uint32_t right;      /* the other child; the left one follows its parent. 0: a leaf */
};

struct build {
    struct vox_closest *tree;
    float (*middles)[3]; /* of triangles, twice; NULL: triangles are in order */
    uint32_t node_count;
};

static void bound_node(const struct vox_closest *tree, struct vox_closest_node *node)
{
    for (int k = 0; k < 3; k++) {
        node->low[k] = INFINITY;
        node->high[k] = -INFINITY;
    }
    for (uint32_t i = node->begin; i < node->end; i++)
        for (int corner = 0; corner < 3; corner++)
            for (int k = 0; k < 3; k++) {
                const float x = tree->positions[tree->triangles[tree->order[i]][corner]][k];
                node->low[k] = x < node->low[k] ? x : node->low[k];
                node->high[k] = x > node->high[k] ? x : node->high[k];
            }
}

/* Partitions order[begin, end) so that those with the least middles on an axis come first, up to
 * `middle` (Hoare, "Algorithm 65: Find", 1961). */
static void select_middle(const struct build *b, uint32_t begin, uint32_t end, uint32_t middle,
                          int axis)
{
    uint32_t *order = b->tree->order;
    while (end - begin > 1) {
        const float pivot = b->middles[order[begin + (end - begin) / 2]][axis];
        uint32_t i = begin, j = end - 1;
        while (i <= j) {
            while (b->middles[order[i]][axis] < pivot)
                i++;
            while (b->middles[order[j]][axis] > pivot)
                j--;
            if (i > j)
                break;
            const uint32_t swapped = order[i];
            order[i++] = order[j];
            order[j] = swapped;
            if (j-- == 0)
                break;
        }
        if (j != UINT32_MAX && middle <= j)
            end = j + 1;
        else if (middle >= i)
            begin = i;
        else
            return;
    }
}

static void build_node(struct build *b, uint32_t begin, uint32_t end)
{
    struct vox_closest_node *node = &b->tree->nodes[b->node_count++];
    const bool leaf = end - begin <= LEAF_TRIANGLES;
    const uint32_t middle = begin + (end - begin) / 2;
    *node = (struct vox_closest_node){.begin = begin, .end = end};
    if (leaf || b->middles)
        bound_node(b->tree, node);
    if (leaf)
        return;
    if (b->middles) {
        int axis = 0;
        for (int k = 1; k < 3; k++)
            axis = node->high[k] - node->low[k] > node->high[axis] - node->low[axis] ? k : axis;
        select_middle(b, begin, end, middle, axis);
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
    *out = (struct vox_closest){.positions = positions, .triangles = triangles};
    /* Leaves have at least half of LEAF_TRIANGLES. */
    BSQ_TRY(
        bsq_alloc(ctx, "a tree of triangles", triangle_count + 1, sizeof *out->nodes, &out->nodes));
    BSQ_TRY(bsq_alloc(ctx, "a tree of triangles", triangle_count, sizeof *out->order, &out->order));
    for (uint32_t t = 0; t < triangle_count; t++)
        out->order[t] = t;
    if (!in_order)
        BSQ_TRY(
            bsq_alloc(ctx, "a tree of triangles", triangle_count, sizeof *b.middles, &b.middles));
    for (uint32_t t = 0; t < triangle_count && b.middles; t++) {
        for (int k = 0; k < 3; k++) {
            const float x = positions[triangles[t][0]][k], y = positions[triangles[t][1]][k],
                        z = positions[triangles[t][2]][k];
            b.middles[t][k] = fminf(x, fminf(y, z)) + fmaxf(x, fmaxf(y, z));
        }
    }
    build_node(&b, 0, triangle_count);
done:
    bsq_free(ctx, b.middles);
    if (status < 0)
        vox_closest_free(ctx, out);
    return status;
}

void vox_closest_free(struct bsq_ctx *ctx, struct vox_closest *tree)
{
    bsq_free(ctx, tree->nodes);
    bsq_free(ctx, tree->order);
    *tree = (struct vox_closest){0};
}

/* Points that are looked for together, and a box around them. */
struct batch {
    unsigned count;
    double points[3][VOX_CLOSEST_BATCH];
    double *squares;
    double most; /* the largest of squares */
    float low[3], high[3];
};

static void find_most(struct batch *b)
{
    b->most = 0;
    for (unsigned i = 0; i < b->count; i++)
        b->most = b->squares[i] > b->most ? b->squares[i] : b->most;
}

/* What the distance of a point from a triangle is made of. */
struct plane {
    double corners[3][3], edges[3][3], outwards[3][3], normal[3];
    double squares[3], area;               /* of edges, and of the normal */
    double inverse_edges[3], inverse_area; /* of these; 0 for 0 */
    double safe; /* factor of bounds, for rounding; 0: a needle, whose normal is not exact */
};

/* Sets all but the inverses. */
static void set_plane(const float *const corners[3], struct plane *out)
{
    double longest = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            out->corners[i][k] = (double)corners[i][k];
            out->edges[i][k] = (double)corners[(i + 1) % 3][k] - (double)corners[i][k];
        }
    bsq_crossd(out->edges[0], out->edges[1], out->normal);
    out->area = bsq_dotd(out->normal, out->normal);
    for (int i = 0; i < 3; i++) {
        out->squares[i] = bsq_dotd(out->edges[i], out->edges[i]);
        bsq_crossd(out->edges[i], out->normal, out->outwards[i]);
        longest = out->squares[i] > longest ? out->squares[i] : longest;
    }
    out->safe = out->area > needle_area * longest * longest ? 1 - 1e-9 : 0;
}

static void set_inverses(struct plane *plane)
{
    plane->inverse_area = plane->area > 0 ? 1 / plane->area : 0;
    for (int i = 0; i < 3; i++)
        plane->inverse_edges[i] = plane->squares[i] > 0 ? 1 / plane->squares[i] : 0;
}

/* Returns the squared distance of a point from the edges of a triangle. */
static double edge_square(const struct plane *plane, double px, double py, double pz)
{
    double least = INFINITY;
    for (int k = 0; k < 3; k++) {
        const double *c = plane->corners[k], *e = plane->edges[k];
        const double x = px - c[0], y = py - c[1], z = pz - c[2];
        double along = (x * e[0] + y * e[1] + z * e[2]) * plane->inverse_edges[k];
        along = along > 0 ? along : 0;
        along = along < 1 ? along : 1;
        const double dx = x - along * e[0], dy = y - along * e[1], dz = z - along * e[2];
        const double square = dx * dx + dy * dy + dz * dz;
        least = square < least ? square : least;
    }
    return least;
}

/* The distance is that from the plane, for points above the inside, or that from an edge. The way
 * beyond an edge's line and the height above the plane bound the latter, so edges are looked at for
 * few points. The first loop has no branches, so that points are computed side by side. */
static void try_triangle(const float *const corners[3], struct batch *b)
{
    double bounds[VOX_CLOSEST_BATCH], inverse_outwards[3], least_gain = 0;
    struct plane plane;
    set_plane(corners, &plane);
    set_inverses(&plane);
    for (int k = 0; k < 3; k++)
        inverse_outwards[k] = plane.inverse_edges[k] * plane.inverse_area;
    const double flat = plane.area > 0 ? -1 : 1;
    for (unsigned i = 0; i < b->count; i++) {
        double outside = flat, height = 0, way = 0;
        for (int k = 0; k < 3; k++) {
            const double *c = plane.corners[k], *out = plane.outwards[k];
            const double x = b->points[0][i] - c[0], y = b->points[1][i] - c[1],
                         z = b->points[2][i] - c[2];
            const double beyond = x * out[0] + y * out[1] + z * out[2];
            const double square = beyond > 0 ? beyond * beyond * inverse_outwards[k] : 0;
            way = square > way ? square : way;
            outside = beyond > outside ? beyond : outside;
            height = x * plane.normal[0] + y * plane.normal[1] + z * plane.normal[2];
        }
        const double above = height * height * plane.inverse_area;
        const double inside = outside <= 0 ? above : INFINITY;
        const double bound = outside <= 0 ? INFINITY : (above + way) * plane.safe;
        const double square = b->squares[i];
        b->squares[i] = inside < square ? inside : square;
        bounds[i] = bound - square;
        least_gain = bounds[i] < least_gain ? bounds[i] : least_gain;
    }
    if (!(least_gain < 0))
        return;
    for (unsigned i = 0; i < b->count; i++) {
        if (!(bounds[i] < 0))
            continue;
        const double square =
            edge_square(&plane, b->points[0][i], b->points[1][i], b->points[2][i]);
        b->squares[i] = square < b->squares[i] ? square : b->squares[i];
    }
}

/* The same for one point. Divides only if the point may be closer. */
double vox_triangle_square(const float *const corners[3], const float point[3], double most)
{
    const double p[3] = {(double)point[0], (double)point[1], (double)point[2]};
    struct plane plane;
    set_plane(corners, &plane);
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
    set_inverses(&plane);
    const double square =
        inside ? above * plane.inverse_area : edge_square(&plane, p[0], p[1], p[2]);
    return square < most ? square : most;
}

/* Tries a triangle of a leaf if its own box is near enough. */
static void try_boxed(const struct vox_closest *tree, uint32_t triangle, struct batch *b)
{
    const uint32_t *t = tree->triangles[triangle];
    const float *const corners[3] = {tree->positions[t[0]], tree->positions[t[1]],
                                     tree->positions[t[2]]};
    float low[3], high[3];
    for (int k = 0; k < 3; k++) {
        const float x = corners[0][k], y = corners[1][k], z = corners[2][k];
        const float less = x < y ? x : y, more = x < y ? y : x;
        low[k] = less < z ? less : z;
        high[k] = more > z ? more : z;
    }
    if (!(vox_box_square(low, high, b->low, b->high) < b->most))
        return;
    if (b->count == 1) {
        const float *point = b->low;
        b->most = b->squares[0] = vox_triangle_square(corners, point, b->most);
        return;
    }
    try_triangle(corners, b);
    find_most(b);
}

static void walk_tree(const struct vox_closest *tree, struct batch *b)
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

static void set_batch(const float (*points)[3], unsigned count, double *squares, struct batch *b)
{
    b->count = count;
    b->squares = squares;
    memcpy(b->low, points[0], sizeof b->low);
    memcpy(b->high, points[0], sizeof b->high);
    for (unsigned i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            const float x = points[i][k];
            b->points[k][i] = (double)x;
            b->low[k] = x < b->low[k] ? x : b->low[k];
            b->high[k] = x > b->high[k] ? x : b->high[k];
        }
    find_most(b);
}

void vox_closest_squares(const struct vox_closest *tree, const float (*points)[3], unsigned count,
                         double *squares)
{
    struct batch b;
    set_batch(points, count, squares, &b);
    walk_tree(tree, &b);
}
