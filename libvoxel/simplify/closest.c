/* closest.c - see closest.h. A binary tree, split at the median of the triangles' middles along the
 * longest side. A query visits the nearer child first. */
#include "libvoxel/simplify/closest.h"

#include <math.h>
#include <string.h>

#include "base/vec.h"

/* The depth is that of halving 2^32 triangles into leaves. */
enum { LEAF_TRIANGLES = 4, DEPTH_MAX = 32 };

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

/* Returns the squared distance of p from a triangle (Ericson, "Real-Time Collision Detection",
 * 2004, section 5.1.5). */
static double triangle_square(const struct vox_closest *tree, uint32_t triangle, const double p[3])
{
    double a[3], ab[3], ac[3], ap[3], bp[3], cp[3], s, t;
    for (int k = 0; k < 3; k++) {
        const double b = (double)tree->positions[tree->triangles[triangle][1]][k],
                     c = (double)tree->positions[tree->triangles[triangle][2]][k];
        a[k] = (double)tree->positions[tree->triangles[triangle][0]][k];
        ab[k] = b - a[k];
        ac[k] = c - a[k];
        ap[k] = p[k] - a[k];
        bp[k] = p[k] - b;
        cp[k] = p[k] - c;
    }
    const double d1 = bsq_dotd(ab, ap), d2 = bsq_dotd(ac, ap), d3 = bsq_dotd(ab, bp),
                 d4 = bsq_dotd(ac, bp), d5 = bsq_dotd(ab, cp), d6 = bsq_dotd(ac, cp);
    const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    if (d1 <= 0 && d2 <= 0) {
        s = t = 0;
    } else if (d3 >= 0 && d4 <= d3) {
        s = 1, t = 0;
    } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        s = d1 / (d1 - d3), t = 0;
    } else if (d6 >= 0 && d5 <= d6) {
        s = 0, t = 1;
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        s = 0, t = d2 / (d2 - d6);
    } else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        s = 1 - t;
    } else {
        s = vb / (va + vb + vc);
        t = vc / (va + vb + vc);
    }
    double square = 0;
    for (int k = 0; k < 3; k++) {
        const double to = ap[k] - s * ab[k] - t * ac[k];
        square += to * to;
    }
    return square;
}

double vox_closest_square(const struct vox_closest *tree, const double point[3], double most)
{
    struct {
        uint32_t node;
        double square;
    } stack[DEPTH_MAX + 1];
    unsigned depth = 0;
    const struct vox_closest_node *nodes = tree->nodes;
    stack[depth].node = 0;
    stack[depth++].square = vox_box_square(nodes->low, nodes->high, point);
    while (depth > 0) {
        const uint32_t at = stack[--depth].node;
        if (!(stack[depth].square < most))
            continue;
        const struct vox_closest_node *node = &nodes[at];
        if (node->right == 0) {
            for (uint32_t i = node->begin; i < node->end; i++) {
                const double square = triangle_square(tree, tree->order[i], point);
                most = square < most ? square : most;
            }
            continue;
        }
        const struct vox_closest_node *left = node + 1, *right = &nodes[node->right];
        const double to_left = vox_box_square(left->low, left->high, point),
                     to_right = vox_box_square(right->low, right->high, point);
        const bool left_first = to_left <= to_right;
        stack[depth].node = left_first ? node->right : at + 1;
        stack[depth++].square = left_first ? to_right : to_left;
        stack[depth].node = left_first ? at + 1 : node->right;
        stack[depth++].square = left_first ? to_left : to_right;
    }
    return most;
}
