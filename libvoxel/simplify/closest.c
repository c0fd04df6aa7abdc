/* closest.c - see closest.h. Each node has four children, whose boxes are compared at once; at the
 * bottom these are triangles. All nodes but the first ones of a level are full, and split at places
 * along the longest side of the triangles' middles. A query visits the nearest child first. */
#include "libvoxel/simplify/closest.h"

#include <math.h>
#include <string.h>

#include "base/geometry/middles.h"
#include "libvoxel/simplify/distance_lanes.h"

/* The depth is that of quartering 2^31 triangles; of each node, three more children wait. */
enum { LANES = 4, DEPTH_MAX = 16, STACK_MAX = (LANES - 1) * DEPTH_MAX + 1 };
#define TRIANGLE UINT32_C(0x80000000) /* or-ed to the number of a triangle: it is no node */

struct vox_closest_node {
    float low[3][LANES], high[3][LANES]; /* of children; of missing ones, boxes that are nowhere */
    uint32_t children[LANES];
};

/* A child that waits, and the squared distance of its box. */
struct waiting {
    uint32_t child;
    double square;
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

/* Moves triangles whose middles are least along the longest side to the front, up to number `at`.
 */
static void divide_triangles(const struct build *b, uint32_t begin, uint32_t end, uint32_t at)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    int axis = 0;
    if (!b->middles || at == end)
        return;
    for (uint32_t i = begin; i < end; i++)
        for (int k = 0; k < 3; k++) {
            const float x = b->middles[i].at[k];
            low[k] = x < low[k] ? x : low[k];
            high[k] = x > high[k] ? x : high[k];
        }
    for (int k = 1; k < 3; k++)
        axis = high[k] - low[k] > high[axis] - low[axis] ? k : axis;
    bsq_select_middles(b->middles + begin, end - begin, at - begin, axis);
}

/* Makes a node of triangles, and sets its box. Returns its number. */
static uint32_t build_node(struct build *b, uint32_t begin, uint32_t end, float low[3],
                           float high[3])
{
    const uint32_t number = b->node_count++;
    struct vox_closest_node *node = &b->tree->nodes[number];
    uint64_t each = 1; /* triangles of a child */
    uint32_t cuts[LANES + 1] = {begin};
    while (LANES * each < end - begin)
        each *= LANES;
    for (uint32_t i = 1; i <= LANES; i++)
        cuts[i] = end - begin > i * each ? begin + (uint32_t)(i * each) : end;
    if (each > 1) {
        divide_triangles(b, begin, end, cuts[2]);
        divide_triangles(b, begin, cuts[2], cuts[1]);
        divide_triangles(b, cuts[2], end, cuts[3]);
    }
    for (int k = 0; k < 3; k++) {
        low[k] = INFINITY;
        high[k] = -INFINITY;
    }
    for (int i = 0; i < LANES; i++) {
        float own_low[3] = {INFINITY, INFINITY, INFINITY},
              own_high[3] = {-INFINITY, -INFINITY, -INFINITY};
        const uint32_t count = cuts[i + 1] - cuts[i];
        node->children[i] = 0;
        if (count == 1) {
            const uint32_t triangle = b->middles ? b->middles[cuts[i]].number : cuts[i];
            bound_triangle(b->tree, triangle, own_low, own_high);
            node->children[i] = TRIANGLE | triangle;
        } else if (count > 1) {
            node->children[i] = build_node(b, cuts[i], cuts[i + 1], own_low, own_high);
        }
        for (int k = 0; k < 3; k++) {
            node->low[k][i] = own_low[k];
            node->high[k][i] = own_high[k];
            low[k] = own_low[k] < low[k] ? own_low[k] : low[k];
            high[k] = own_high[k] > high[k] ? own_high[k] : high[k];
        }
    }
    return number;
}

int vox_closest_build(struct bsq_ctx *ctx, const float (*positions)[3],
                      const uint32_t (*triangles)[3], uint32_t triangle_count, bool in_order,
                      struct vox_closest *out)
{
    struct build b = {.tree = out};
    float low[3], high[3];
    int status = 0;
    *out = (struct vox_closest){
        .positions = positions, .triangles = triangles, .level = bsq_simd_best()};
    /* A third as many as triangles, but one in each level may not be full. */
    BSQ_TRY(BSQ_ALLOC(ctx, "a tree of triangles", triangle_count / 3 + DEPTH_MAX + 1, &out->nodes));
    if (!in_order)
        BSQ_TRY(BSQ_ALLOC(ctx, "a tree of triangles", triangle_count, &b.middles));
    for (uint32_t t = 0; t < triangle_count && b.middles; t++) {
        bound_triangle(out, t, low, high);
        b.middles[t].number = t;
        for (int k = 0; k < 3; k++)
            b.middles[t].at[k] = low[k] + high[k];
    }
    build_node(&b, 0, triangle_count, low, high);
done:
    bsq_free(ctx, b.middles);
    if (status < 0)
        vox_closest_free(ctx, out);
    return status;
}

void vox_closest_free(struct bsq_ctx *ctx, struct vox_closest *tree)
{
    bsq_free(ctx, tree->nodes);
    *tree = (struct vox_closest){0};
}

/* Does what vox_box_square() does, for all children of a node. */
static void find_box_squares(const struct vox_closest_node *node, const float low[3],
                             const float high[3], double squares[LANES])
{
    typedef double four_doubles __attribute__((vector_size(LANES * sizeof(double))));
    four_doubles sum = {0};
    for (int k = 0; k < 3; k++) {
        vox_four below, above;
        memcpy(&below, node->low[k], sizeof below);
        memcpy(&above, node->high[k], sizeof above);
        below -= high[k];
        above = low[k] - above;
        const vox_four_mask gap = ((below > 0.0F) & (vox_four_mask)below) |
                                  ((above > 0.0F) & (vox_four_mask)above); /* one is, at most */
        const four_doubles wide = __builtin_convertvector((vox_four)gap, four_doubles);
        sum += wide * wide;
    }
    sum *= 1 - 4e-7;
    memcpy(squares, &sum, sizeof sum);
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

static void try_triangle(const struct vox_closest *tree, uint32_t triangle, struct vox_batch *b)
{
    const float *corners[3];
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
    struct waiting stack[STACK_MAX] = {{0, 0}};
    for (unsigned depth = 1; depth > 0;) {
        const struct waiting next = stack[--depth];
        const unsigned before = depth;
        double squares[LANES];
        if (!(next.square < b->most))
            continue;
        if (next.child & TRIANGLE) {
            try_triangle(tree, next.child & ~TRIANGLE, b);
            continue;
        }
        const struct vox_closest_node *node = &tree->nodes[next.child];
        find_box_squares(node, b->low, b->high, squares);
        for (int i = 0; i < LANES; i++) {
            unsigned at = depth;
            if (!(squares[i] < b->most))
                continue;
            for (; at > before && stack[at - 1].square < squares[i]; at--)
                stack[at] = stack[at - 1];
            stack[at] = (struct waiting){node->children[i], squares[i]};
            depth++;
        }
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
    struct waiting stack[STACK_MAX] = {{0, 0}};
    for (unsigned depth = 1; depth > 0;) {
        const struct waiting next = stack[--depth];
        double squares[LANES];
        if (next.child & TRIANGLE) {
            if (found(arg, next.child & ~TRIANGLE, next.square))
                return true;
            continue;
        }
        const struct vox_closest_node *node = &tree->nodes[next.child];
        find_box_squares(node, low, high, squares);
        for (int i = LANES; i-- > 0;)
            if (squares[i] <= square && squares[i] < INFINITY)
                stack[depth++] = (struct waiting){node->children[i], squares[i]};
    }
    return false;
}
