/* bound.c - see bound.h.
 *
 * The distance from one triangle of the mesh is convex, so that at the corners of a polygon bounds
 * it everywhere. A polygon that the triangle closest to its middle does not bound is cut at the
 * planes through that triangle's edges, and a little beyond them: what lies over the triangle is
 * bounded by it, and the other parts are tried alone. On a flat surface that takes about as many
 * parts as triangles, however small the distance is. */
#include "libvoxel/simplify/bound.h"

#include <string.h>

#include "base/geometry/vec.h"

enum { CORNERS_MAX = 16, CORNERS_MANY = 9, PARTS_DEPTH_MAX = 96, PARTS_MAX = 32768 };

struct polygon {
    unsigned count;
    double corners[CORNERS_MAX][3];
};

struct bounding {
    const struct vox_closest *tree;
    struct vox_bound *bound;
    double high;  /* of the parts that are bounded */
    double loose; /* how many times as high as allowed that may be */
    unsigned parts;
};

void vox_bound_note(struct vox_bound *b, const double where[3], double distance)
{
    if (!(distance > b->low))
        return;
    b->low = distance;
    memcpy(b->where, where, sizeof b->where);
}

void vox_bound_add(struct vox_bound *b, const struct vox_bound *other)
{
    vox_bound_note(b, other->where, other->low);
    b->high = fmax(b->high, other->high);
}

/* Returns the distance of the farthest corner from a triangle. */
static double farthest_corner(const struct polygon *p, const float *const triangle[3])
{
    double most = 0;
    for (unsigned i = 0; i < p->count; i++)
        most = fmax(most, vox_triangle_square_at(triangle, p->corners[i], INFINITY));
    return sqrt(most);
}

/* Divides a polygon at a plane: *below receives what is not above it. Returns false, and leaves
 * *below and *above as they are, if one of them would be empty. */
static bool divide_polygon(const struct polygon *p, const double normal[3], const double at[3],
                           double height, struct polygon *below, struct polygon *above)
{
    double heights[CORNERS_MAX], least = INFINITY, most = -INFINITY;
    struct polygon parts[2] = {{0}, {0}};
    for (unsigned i = 0; i < p->count; i++) {
        const double *c = p->corners[i], to[3] = {c[0] - at[0], c[1] - at[1], c[2] - at[2]};
        heights[i] = bsq_dotd(to, normal) - height;
        least = fmin(least, heights[i]);
        most = fmax(most, heights[i]);
    }
    if (!(least < 0 && most > 0))
        return false;
    for (unsigned i = 0; i < p->count; i++) {
        const unsigned next = (i + 1) % p->count;
        const double *a = p->corners[i], *b = p->corners[next];
        for (int side = 0; side < 2; side++)
            if (side == 0 ? heights[i] <= 0 : heights[i] >= 0)
                memcpy(parts[side].corners[parts[side].count++], a, sizeof p->corners[i]);
        if (!(heights[i] < 0 ? heights[next] > 0 : heights[i] > 0 && heights[next] < 0))
            continue;
        const double share = heights[i] / (heights[i] - heights[next]);
        for (int side = 0; side < 2; side++) {
            double *cut = parts[side].corners[parts[side].count++];
            for (int k = 0; k < 3; k++)
                cut[k] = a[k] + share * (b[k] - a[k]);
        }
    }
    *below = parts[0];
    *above = parts[1];
    return true;
}

/* Divides a polygon across its longest edge, or at a diagonal if it has many corners. */
static bool halve_polygon(struct polygon *below, struct polygon *above)
{
    const struct polygon *p = below;
    const unsigned half = p->count / 2;
    double longest = 0, edge[3] = {0}, middle[3] = {0};
    if (p->count >= CORNERS_MANY) {
        above->count = p->count - half + 1;
        memcpy(above->corners, p->corners[half], (p->count - half) * sizeof *p->corners);
        memcpy(above->corners[p->count - half], p->corners[0], sizeof *p->corners);
        below->count = half + 1;
        return true;
    }
    for (unsigned i = 0; i < p->count; i++) {
        const double *a = p->corners[i], *b = p->corners[(i + 1) % p->count];
        const double along[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        const double square = bsq_dotd(along, along);
        if (!(square > longest))
            continue;
        longest = square;
        for (int k = 0; k < 3; k++) {
            edge[k] = along[k];
            middle[k] = a[k] + 0.5 * along[k];
        }
    }
    return divide_polygon(p, edge, middle, 0, below, above);
}

/* Cuts off what lies beyond the edges of a triangle, and stores it in outside[]. Returns the number
 * of parts there. middle: a point of the polygon; margin: how far beyond it and the edges. */
static unsigned cut_prism(struct polygon *p, const float *const triangle[3], const double middle[3],
                          double margin, struct polygon outside[3])
{
    double c[3][3], edges[3][3], normal[3];
    unsigned count = 0;
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++) {
            c[k][i] = (double)triangle[k][i];
            edges[k][i] = (double)triangle[(k + 1) % 3][i] - (double)triangle[k][i];
        }
    bsq_crossd(edges[0], edges[1], normal);
    for (int k = 0; k < 3; k++) {
        const double to[3] = {middle[0] - c[k][0], middle[1] - c[k][1], middle[2] - c[k][2]};
        double out[3];
        bsq_crossd(edges[k], normal, out);
        const double length = sqrt(bsq_dotd(out, out));
        for (int i = 0; i < 3; i++)
            out[i] /= length;
        if (length > 0 &&
            divide_polygon(p, out, c[k], fmax(0, bsq_dotd(to, out)) + margin, p, &outside[count]))
            count++;
    }
    return count;
}

/* Bounds a part of a polygon. near: a triangle that may be closest to its middle. cut: it lies over
 * this one. */
static void bound_part(struct bounding *in, struct polygon *p, uint32_t near, bool cut,
                       unsigned depth)
{
    struct polygon parts[3];
    const float *triangle[3];
    double middle[3] = {0}, square = INFINITY;
    if (in->bound->enough > 0 && in->bound->low > in->bound->enough)
        return;
    for (unsigned i = 0; i < p->count; i++)
        for (int k = 0; k < 3; k++)
            middle[k] += p->corners[i][k] / p->count;
    if (near != UINT32_MAX) {
        vox_closest_corners(in->tree, near, triangle);
        const double most = farthest_corner(p, triangle);
        if (most <= in->loose * vox_bound_allowed(in->bound)) {
            in->high = fmax(in->high, most);
            return;
        }
        square = vox_triangle_square_at(triangle, middle, INFINITY);
    }
    const uint32_t closest = vox_closest_point(in->tree, middle, &square);
    cut &= closest == UINT32_MAX;
    near = closest != UINT32_MAX ? closest : near;
    vox_bound_note(in->bound, middle, sqrt(square));
    vox_closest_corners(in->tree, near, triangle);
    const double most = farthest_corner(p, triangle),
                 allowed = in->loose * vox_bound_allowed(in->bound);
    if (most <= allowed || depth == PARTS_DEPTH_MAX || ++in->parts > PARTS_MAX) {
        in->high = fmax(in->high, most);
        return;
    }
    unsigned count = 0;
    if (!cut && p->count < CORNERS_MANY)
        count = cut_prism(p, triangle, middle, 0.4 * sqrt(allowed * allowed - square), parts);
    cut = count > 0;
    if (count == 0 && halve_polygon(p, &parts[0]))
        count = 1;
    if (count == 0) /* it is smaller than coordinates can tell */
        depth = PARTS_DEPTH_MAX - 1;
    for (unsigned i = 0; i < count; i++)
        bound_part(in, &parts[i], near, false, depth + 1);
    bound_part(in, p, near, cut, depth + 1);
}

void vox_bound_triangle(const struct vox_closest *tree, const float *const corners[3],
                        struct vox_bound *b)
{
    struct bounding in = {.tree = tree, .bound = b, .loose = 0.5};
    do {
        struct polygon p = {.count = 3};
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                p.corners[i][k] = (double)corners[i][k];
        in.loose *= 2;
        in.high = 0;
        in.parts = 0;
        bound_part(&in, &p, UINT32_MAX, false, 0);
    } while (in.parts > PARTS_MAX);
    b->high = fmax(b->high, in.high);
}
