/* collapse.c - see collapse.h.
 *
 * Corners of triangles are linked in a ring around each vertex. A collapse of (u, v) joins the
 * rings of both; corners of triangles that are gone leave a ring when somebody walks along it.
 * Candidates are in a binary heap. One counts only while neither vertex has changed since it was
 * made, and is computed again when it comes up, because its cost may have grown as neighbours
 * moved; then it goes back into the heap. */
#include "libvoxel/simplify/collapse.h"

#include <math.h>
#include <string.h>

#include "base/positions.h"
#include "base/vec.h"

enum {
    VERTEX_BORDER = 1, /* at an edge with one triangle */
    VERTEX_LOCKED = 2,
    NONE = UINT32_MAX,
    CHECK_EVERY = 1024 /* collapses between two looks at an interruption */
};

/* Weight of the distance from an open border, beside that from the triangles. */
static const double border_weight = 10.0;
/* Pull towards the middle of an edge, in parts of the quadric's trace: it decides where the
 * quadric does not, along flat or straight parts. */
static const double pull = 1e-6;
/* Share of the squared length of the edge, in the quadric's trace, that is added to a cost. In flat
 * parts, where all costs are 0, short edges go first. */
static const double length_share = 1e-7;
/* Least cosine between a triangle's normals before and after a collapse. */
static const double least_cosine = 0.2;
/* A candidate whose cost has grown by more than this factor goes back into the heap. */
static const double grown = 1.000001;

struct candidate {
    float cost;
    uint32_t u, v;
    uint32_t stamp; /* the sum of both vertices' stamps */
};

struct collapse {
    struct bsq_ctx *ctx;
    const struct vox_collapse_options *options;
    struct vox_mesh *mesh;
    uint32_t alive;   /* triangles */
    uint32_t *next;   /* of each corner (3 t + k): the next one in its vertex's ring */
    uint32_t *corner; /* of each vertex: a corner of its ring, or NONE */
    uint32_t *stamps; /* of vertices: grow with each change */
    uint8_t *flags;   /* of vertices */
    uint32_t *marks;  /* of vertices: the walk that found them last */
    uint32_t walk;
    struct candidate *heap;
    uint64_t heap_count, heap_capacity;
};

/* What the collapse of an edge would do. */
struct result {
    double cost;
    float position[3];
    struct vox_quadric quadric; /* carried on */
};

/* ---- quadrics ---- */

static void to_double(const float p[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (double)p[k];
}

/* Adds w (n x - d)^2. */
static void add_plane(struct vox_quadric *q, const double n[3], double d, double w)
{
    static const int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
    for (int i = 0; i < 6; i++)
        q->a[i] += w * n[row[i]] * n[column[i]];
    for (int k = 0; k < 3; k++)
        q->b[k] -= w * d * n[k];
    q->c += w * d * d;
}

/* Adds w |e x (x - p)|^2: the squared distance from the line through p along e, times |e|^2. */
static void add_line(struct vox_quadric *q, const double e[3], const double p[3], double w)
{
    static const double axes[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int k = 0; k < 3; k++) {
        double n[3]; /* component k of e x y is n y */
        bsq_crossd(axes[k], e, n);
        add_plane(q, n, bsq_dotd(n, p), w);
    }
}

static void add_quadric(struct vox_quadric *q, const struct vox_quadric *other)
{
    for (int i = 0; i < 6; i++)
        q->a[i] += other->a[i];
    for (int k = 0; k < 3; k++)
        q->b[k] += other->b[k];
    q->c += other->c;
}

static void multiply(const double a[6], const double x[3], double out[3])
{
    out[0] = a[0] * x[0] + a[1] * x[1] + a[2] * x[2];
    out[1] = a[1] * x[0] + a[3] * x[1] + a[4] * x[2];
    out[2] = a[2] * x[0] + a[4] * x[1] + a[5] * x[2];
}

static double quadric_at(const struct vox_quadric *q, const double x[3])
{
    double ax[3];
    multiply(q->a, x, ax);
    return bsq_dotd(x, ax) + 2 * bsq_dotd(q->b, x) + q->c;
}

/* Moves the origin to p. */
static void shift_quadric(struct vox_quadric *q, const double p[3])
{
    double ap[3];
    multiply(q->a, p, ap);
    q->c += bsq_dotd(p, ap) + 2 * bsq_dotd(q->b, p);
    for (int k = 0; k < 3; k++)
        q->b[k] += ap[k];
}

/* Solves A x = b for a positive definite A, by Cholesky's method. Returns false if it is not. */
static bool solve(const double a[6], const double b[3], double x[3])
{
    if (!(a[0] > 0))
        return false;
    const double l00 = sqrt(a[0]), l10 = a[1] / l00, l20 = a[2] / l00;
    const double d11 = a[3] - l10 * l10;
    if (!(d11 > 0))
        return false;
    const double l11 = sqrt(d11), l21 = (a[4] - l20 * l10) / l11;
    const double d22 = a[5] - l20 * l20 - l21 * l21;
    if (!(d22 > 0))
        return false;
    const double l22 = sqrt(d22);
    const double y0 = b[0] / l00, y1 = (b[1] - l10 * y0) / l11,
                 y2 = (b[2] - l20 * y0 - l21 * y1) / l22;
    x[2] = y2 / l22;
    x[1] = (y1 - l21 * x[2]) / l11;
    x[0] = (y0 - l10 * x[1] - l20 * x[2]) / l00;
    return true;
}

/* Adds the squared distance from a triangle's plane, times its area (CARRIED), or times the square
 * of twice its area. *normal receives twice the area times the normal; the result is its product
 * with a corner. Positions are relative to `from`. */
static double add_triangle(struct vox_quadric *q, const float (*positions)[3],
                           const uint32_t triangle[3], const double from[3], bool carried,
                           double normal[3])
{
    double p[3][3], e[2][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            p[i][k] = (double)positions[triangle[i]][k] - from[k];
    for (int k = 0; k < 3; k++) {
        e[0][k] = p[1][k] - p[0][k];
        e[1][k] = p[2][k] - p[0][k];
    }
    bsq_crossd(e[0], e[1], normal);
    const double d = bsq_dotd(normal, p[0]), length = sqrt(bsq_dotd(normal, normal));
    if (length > 0)
        add_plane(q, normal, d, carried ? 0.5 / length : 1.0);
    return d;
}

void vox_mesh_set_quadrics(struct vox_mesh *mesh)
{
    static const double zero[3] = {0, 0, 0};
    memset(mesh->quadrics, 0, mesh->vertex_count * sizeof *mesh->quadrics);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        struct vox_quadric q = {{0}, {0}, 0};
        double normal[3];
        add_triangle(&q, mesh->positions, mesh->triangles[t], zero, true, normal);
        for (int k = 0; k < 3; k++)
            add_quadric(&mesh->quadrics[mesh->triangles[t][k]], &q);
    }
}

/* ---- rings ---- */

static bool is_gone(const struct collapse *c, uint32_t triangle)
{
    return c->mesh->triangles[triangle][0] == NONE;
}

/* Returns the corner after `corner` in its ring, and drops those of triangles that are gone. */
static uint32_t next_corner(struct collapse *c, uint32_t corner)
{
    uint32_t next = c->next[corner];
    while (is_gone(c, next / 3) && next != corner)
        next = c->next[corner] = c->next[next];
    return next;
}

/* Returns a corner of a vertex's ring whose triangle is there, or NONE. */
static uint32_t first_corner(struct collapse *c, uint32_t vertex)
{
    uint32_t corner = c->corner[vertex];
    if (corner == NONE || !is_gone(c, corner / 3))
        return corner;
    uint32_t next = next_corner(c, corner);
    if (is_gone(c, next / 3))
        next = NONE;
    return c->corner[vertex] = next;
}

/* The other corners of a corner's triangle, in their order. */
static uint32_t after(const struct collapse *c, uint32_t corner)
{
    return c->mesh->triangles[corner / 3][(corner % 3 + 1) % 3];
}
static uint32_t before(const struct collapse *c, uint32_t corner)
{
    return c->mesh->triangles[corner / 3][(corner % 3 + 2) % 3];
}

/* Walks along the ring of a vertex: for (each corner k of vertex v). */
#define EACH_CORNER(c, v, k)                                                                       \
    uint32_t k = first_corner(c, v), k##_first = k, k##_more = k != NONE;                          \
    k##_more;                                                                                      \
    k = next_corner(c, k), k##_more = k != k##_first

static int link_corners(struct collapse *c)
{
    const struct vox_mesh *mesh = c->mesh;
    memset(c->corner, 0xff, mesh->vertex_count * sizeof *c->corner);
    for (uint32_t corner = 0; corner < 3 * mesh->triangle_count; corner++) {
        uint32_t *first = &c->corner[mesh->triangles[corner / 3][corner % 3]];
        if (*first == NONE) {
            *first = c->next[corner] = corner;
        } else {
            c->next[corner] = c->next[*first];
            c->next[*first] = corner;
        }
    }
    return bsq_check(c->ctx);
}

/* Returns the number of triangles at an edge, and up to two vertices opposite to it. */
static unsigned edge_triangles(struct collapse *c, uint32_t u, uint32_t v, uint32_t opposite[2])
{
    unsigned count = 0;
    for (EACH_CORNER(c, u, k)) {
        if (after(c, k) != v && before(c, k) != v)
            continue;
        if (count < 2)
            opposite[count] = after(c, k) == v ? before(c, k) : after(c, k);
        count++;
    }
    return count;
}

/* Finds open borders, and vertices that must stay. */
static int flag_vertices(struct collapse *c)
{
    const uint8_t border = c->options->lock_borders ? VERTEX_BORDER | VERTEX_LOCKED : VERTEX_BORDER;
    for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
        if (v % CHECK_EVERY == 0 && bsq_check(c->ctx) < 0)
            return BSQ_EINTR;
        for (EACH_CORNER(c, v, k)) {
            uint32_t opposite[2];
            const unsigned count = edge_triangles(c, v, after(c, k), opposite);
            const uint8_t flags = count == 1 ? border : count > 2 ? VERTEX_LOCKED : 0;
            c->flags[v] |= flags;
            c->flags[after(c, k)] |= flags;
        }
    }
    return 0;
}

/* ---- which collapses are allowed ---- */

/* Returns whether the link condition holds (Dey, Edelsbrunner, Guha and Nekhayev, 1999): the
 * vertices next to both u and v are those opposite to the edge, and no edge lies opposite to both.
 */
static bool keeps_topology(struct collapse *c, uint32_t u, uint32_t v)
{
    uint32_t opposite[2];
    const unsigned count = edge_triangles(c, u, v, opposite);
    const bool both_border = c->flags[u] & c->flags[v] & VERTEX_BORDER;
    if (count == 0 || count > 2 || (count == 2 && (both_border || opposite[0] == opposite[1])))
        return false;
    const uint32_t around_u = c->walk + 1, around_v = c->walk + 2;
    c->walk += 2;
    unsigned common = 0;
    bool u_spans = false, v_spans = false;
    for (EACH_CORNER(c, u, k)) {
        const uint32_t a = after(c, k), b = before(c, k);
        c->marks[a] = c->marks[b] = around_u;
        u_spans |= count == 2 && (a == opposite[0] || a == opposite[1]) &&
                   (b == opposite[0] || b == opposite[1]);
    }
    for (EACH_CORNER(c, v, k)) {
        const uint32_t ends[2] = {after(c, k), before(c, k)};
        for (int i = 0; i < 2; i++)
            if (c->marks[ends[i]] == around_u) {
                c->marks[ends[i]] = around_v;
                common += ends[i] != u;
            }
        v_spans |= count == 2 && (ends[0] == opposite[0] || ends[0] == opposite[1]) &&
                   (ends[1] == opposite[0] || ends[1] == opposite[1]);
    }
    return common == count && !(u_spans && v_spans);
}

/* Returns whether the triangles of u without v keep their orientation if u moves to p. */
static bool keeps_orientation(struct collapse *c, uint32_t u, uint32_t v, const float p[3])
{
    const float(*positions)[3] = (const float(*)[3])c->mesh->positions;
    for (EACH_CORNER(c, u, k)) {
        const uint32_t a = after(c, k), b = before(c, k);
        if (a == v || b == v)
            continue;
        double edge[3], old_to[3], new_to[3], old_normal[3], new_normal[3];
        for (int i = 0; i < 3; i++) {
            edge[i] = (double)positions[b][i] - (double)positions[a][i];
            old_to[i] = (double)positions[u][i] - (double)positions[a][i];
            new_to[i] = (double)p[i] - (double)positions[a][i];
        }
        bsq_crossd(edge, old_to, old_normal);
        bsq_crossd(edge, new_to, new_normal);
        const double old_square = bsq_dotd(old_normal, old_normal),
                     new_square = bsq_dotd(new_normal, new_normal);
        if (old_square > 0 && !(bsq_dotd(old_normal, new_normal) >
                                least_cosine * sqrt(old_square) * sqrt(new_square)))
            return false;
    }
    return true;
}

/* ---- costs ---- */

/* Adds what the triangles and the open borders around a vertex say; triangles that have `other` are
 * left out, and so is the border to it, if `skip`. Sums up normals for the volume. */
static void add_surroundings(struct collapse *c, uint32_t u, uint32_t other, bool skip,
                             const double from[3], double scale, struct vox_quadric *q,
                             double volume[4])
{
    const float(*positions)[3] = (const float(*)[3])c->mesh->positions;
    const bool carried = c->options->measure == VOX_COLLAPSE_CARRIED;
    const bool border = (c->flags[u] & (VERTEX_BORDER | VERTEX_LOCKED)) == VERTEX_BORDER;
    if (carried && !border)
        return;
    for (EACH_CORNER(c, u, k)) {
        const uint32_t ends[2] = {after(c, k), before(c, k)};
        const bool shared = ends[0] == other || ends[1] == other;
        if (!carried && !(shared && skip)) {
            double normal[3];
            volume[3] += add_triangle(q, positions, c->mesh->triangles[k / 3], from, false, normal);
            for (int i = 0; i < 3; i++)
                volume[i] += normal[i];
        }
        if (!border)
            continue;
        for (int i = 0; i < 2; i++) {
            uint32_t opposite[2];
            double edge[3], p[3];
            if ((skip && ends[i] == other) || !(c->flags[ends[i]] & VERTEX_BORDER) ||
                edge_triangles(c, u, ends[i], opposite) != 1)
                continue;
            for (int j = 0; j < 3; j++) {
                p[j] = (double)positions[u][j] - from[j];
                edge[j] = (double)positions[ends[i]][j] - (double)positions[u][j];
            }
            add_line(q, edge, p, border_weight * scale);
        }
    }
}

/* Finds the place of least error near the origin, which is the middle of the edge. */
static void place(const struct vox_quadric *q, const double volume[4], bool keep_volume,
                  double x[3])
{
    struct vox_quadric tied = *q;
    const double trace = q->a[0] + q->a[3] + q->a[5];
    double minus_b[3], y[3];
    tied.a[0] += pull * trace;
    tied.a[3] += pull * trace;
    tied.a[5] += pull * trace;
    for (int k = 0; k < 3; k++)
        minus_b[k] = -q->b[k];
    if (!solve(tied.a, minus_b, x)) {
        memset(x, 0, 3 * sizeof *x);
        return;
    }
    if (!keep_volume || !solve(tied.a, volume, y))
        return;
    const double along = bsq_dotd(volume, y), missing = volume[3] - bsq_dotd(volume, x);
    for (int k = 0; k < 3 && along > 0; k++)
        x[k] += y[k] * missing / along;
}

/* Computes what the collapse of an edge does. Returns false if it is not allowed: both vertices are
 * locked, or the result is not finite. */
static bool evaluate(struct collapse *c, uint32_t u, uint32_t v, struct result *out)
{
    const struct vox_mesh *mesh = c->mesh;
    const bool carried = c->options->measure == VOX_COLLAPSE_CARRIED;
    struct vox_quadric q = {{0}, {0}, 0};
    double a[3], b[3], middle[3], x[3], volume[4] = {0, 0, 0, 0}, square = 0;
    if (c->flags[u] & c->flags[v] & VERTEX_LOCKED)
        return false;
    to_double(mesh->positions[u], a);
    to_double(mesh->positions[v], b);
    for (int k = 0; k < 3; k++) {
        middle[k] = 0.5 * (a[k] + b[k]);
        square += (a[k] - b[k]) * (a[k] - b[k]);
    }
    if (carried) {
        out->quadric = mesh->quadrics[u];
        add_quadric(&out->quadric, &mesh->quadrics[v]);
        q = out->quadric;
        shift_quadric(&q, middle);
    }
    const double scale = carried ? 1.0 : square;
    add_surroundings(c, u, v, false, middle, scale, &q, volume);
    add_surroundings(c, v, u, true, middle, scale, &q, volume);
    const uint8_t differ = c->flags[u] ^ c->flags[v];
    /* A vertex that is locked, or alone on an open border, decides the place. */
    const uint8_t decides = differ & VERTEX_LOCKED ? VERTEX_LOCKED : differ & VERTEX_BORDER;
    if (decides) {
        const uint32_t from = c->flags[u] & decides ? u : v;
        memcpy(out->position, mesh->positions[from], sizeof out->position);
    } else {
        place(&q, volume, !carried, x);
        for (int k = 0; k < 3; k++)
            out->position[k] = (float)(middle[k] + x[k]);
    }
    for (int k = 0; k < 3; k++)
        x[k] = (double)out->position[k] - middle[k];
    out->cost = quadric_at(&q, x);
    out->cost = out->cost > 0 ? out->cost : 0;
    out->cost += length_share * (q.a[0] + q.a[3] + q.a[5]) * square;
    return isfinite(out->cost) && isfinite(out->position[0] + out->position[1] + out->position[2]);
}

/* ---- the heap ---- */

/* Cheapest first; the vertices decide between equal costs. */
static bool is_before(const struct candidate *a, const struct candidate *b)
{
    if (a->cost != b->cost)
        return a->cost < b->cost;
    return a->u != b->u ? a->u < b->u : a->v < b->v;
}

static void sift_down(struct collapse *c, uint64_t at)
{
    const struct candidate moved = c->heap[at];
    for (uint64_t child; (child = 2 * at + 1) < c->heap_count; at = child) {
        if (child + 1 < c->heap_count && is_before(&c->heap[child + 1], &c->heap[child]))
            child++;
        if (!is_before(&c->heap[child], &moved))
            break;
        c->heap[at] = c->heap[child];
    }
    c->heap[at] = moved;
}

static bool is_current(const struct collapse *c, const struct candidate *candidate)
{
    return c->corner[candidate->u] != NONE && c->corner[candidate->v] != NONE &&
           c->stamps[candidate->u] + c->stamps[candidate->v] == candidate->stamp;
}

/* Drops candidates that do not count any more. */
static void clean_heap(struct collapse *c)
{
    uint64_t kept = 0;
    for (uint64_t i = 0; i < c->heap_count; i++)
        if (is_current(c, &c->heap[i]))
            c->heap[kept++] = c->heap[i];
    c->heap_count = kept;
    for (uint64_t i = kept / 2; i-- > 0;)
        sift_down(c, i);
}

/* Adds a candidate. The heap has space for twice the edges of the mesh, so cleaning makes space. */
static void push(struct collapse *c, struct candidate candidate)
{
    if (c->heap_count == c->heap_capacity)
        clean_heap(c);
    if (c->heap_count == c->heap_capacity)
        return;
    uint64_t at = c->heap_count++;
    for (; at > 0 && is_before(&candidate, &c->heap[(at - 1) / 2]); at = (at - 1) / 2)
        c->heap[at] = c->heap[(at - 1) / 2];
    c->heap[at] = candidate;
}

static struct candidate pop(struct collapse *c)
{
    const struct candidate top = c->heap[0];
    c->heap[0] = c->heap[--c->heap_count];
    if (c->heap_count > 0)
        sift_down(c, 0);
    return top;
}

static void push_edge(struct collapse *c, uint32_t u, uint32_t v, double cost)
{
    const uint32_t low = u < v ? u : v, high = u < v ? v : u;
    push(c, (struct candidate){(float)cost, low, high, c->stamps[u] + c->stamps[v]});
}

/* Adds the edges of a vertex, or only those to vertices with higher numbers. */
static void push_edges(struct collapse *c, uint32_t vertex, bool higher)
{
    struct result result;
    const uint32_t seen = ++c->walk;
    for (EACH_CORNER(c, vertex, k)) {
        const uint32_t ends[2] = {after(c, k), before(c, k)};
        for (int i = 0; i < 2; i++) {
            if (c->marks[ends[i]] == seen || (higher && ends[i] < vertex))
                continue;
            c->marks[ends[i]] = seen;
            if (evaluate(c, vertex, ends[i], &result))
                push_edge(c, vertex, ends[i], result.cost);
        }
    }
}

/* ---- the collapse ---- */

/* Collapses (u, v) into u. */
static void collapse_edge(struct collapse *c, uint32_t u, uint32_t v, const struct result *result)
{
    struct vox_mesh *mesh = c->mesh;
    const uint32_t start = c->corner[v];
    uint32_t k = start;
    do { /* through all corners, also those that are gone */
        uint32_t *triangle = mesh->triangles[k / 3];
        if (!is_gone(c, k / 3)) {
            if (triangle[0] == u || triangle[1] == u || triangle[2] == u) {
                triangle[0] = NONE;
                c->alive--;
            } else {
                triangle[k % 3] = u;
            }
        }
        k = c->next[k];
    } while (k != start);
    const uint32_t swapped = c->next[start];
    c->next[start] = c->next[c->corner[u]];
    c->next[c->corner[u]] = swapped;
    c->corner[v] = NONE;
    memcpy(mesh->positions[u], result->position, sizeof result->position);
    if (mesh->quadrics)
        mesh->quadrics[u] = result->quadric;
    c->flags[u] |= c->flags[v];
    c->stamps[u]++;
}

/* Takes the cheapest candidate, and collapses it if that is allowed. */
static void collapse_next(struct collapse *c)
{
    const struct candidate candidate = pop(c);
    const uint32_t u = candidate.u, v = candidate.v;
    struct result result;
    if (!is_current(c, &candidate) || !evaluate(c, u, v, &result))
        return;
    if (result.cost > (double)candidate.cost * grown && (float)result.cost > candidate.cost) {
        push_edge(c, u, v, result.cost);
        return;
    }
    if (!keeps_topology(c, u, v) || !keeps_orientation(c, u, v, result.position) ||
        !keeps_orientation(c, v, u, result.position))
        return;
    collapse_edge(c, u, v, &result);
    push_edges(c, u, false);
}

/* Edges that were refused may be allowed after their neighbours have changed, so all edges become
 * candidates again as long as that helps. */
static int collapse_edges(struct collapse *c)
{
    uint32_t before_pass = UINT32_MAX, reported = c->alive;
    while (c->alive > c->options->target && c->alive < before_pass) {
        before_pass = c->alive;
        for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
            if (v % CHECK_EVERY == 0 && bsq_check(c->ctx) < 0)
                return BSQ_EINTR;
            if (first_corner(c, v) != NONE)
                push_edges(c, v, true);
        }
        for (uint64_t i = 0; c->heap_count > 0 && c->alive > c->options->target; i++) {
            collapse_next(c);
            if (i % CHECK_EVERY != 0)
                continue;
            if (bsq_check(c->ctx) < 0)
                return BSQ_EINTR;
            if (c->options->progress)
                bsq_progress_add(c->ctx, reported - c->alive);
            reported = c->alive;
        }
        c->heap_count = 0;
    }
    return 0;
}

/* Renumbers vertices and triangles that are left, in their order. */
static void compact(struct vox_mesh *mesh, uint32_t *numbers)
{
    uint32_t vertices = 0, triangles = 0;
    memset(numbers, 0xff, mesh->vertex_count * sizeof *numbers);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        if (mesh->triangles[t][0] == NONE)
            continue;
        for (int k = 0; k < 3; k++) {
            numbers[mesh->triangles[t][k]] = 0;
            mesh->triangles[triangles][k] = mesh->triangles[t][k];
        }
        triangles++;
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        if (numbers[v] == NONE)
            continue;
        memmove(mesh->positions[vertices], mesh->positions[v], sizeof *mesh->positions);
        if (mesh->quadrics)
            mesh->quadrics[vertices] = mesh->quadrics[v];
        numbers[v] = vertices++;
    }
    for (uint32_t t = 0; t < triangles; t++)
        for (int k = 0; k < 3; k++)
            mesh->triangles[t][k] = numbers[mesh->triangles[t][k]];
    mesh->vertex_count = vertices;
    mesh->triangle_count = triangles;
}

static uint64_t heap_capacity(uint64_t triangles)
{
    return 3 * triangles + 16; /* twice the edges of a closed mesh */
}

int vox_collapse(struct bsq_ctx *ctx, const struct vox_collapse_options *options,
                 struct vox_mesh *mesh)
{
    const uint64_t vertices = mesh->vertex_count, corners = 3 * (uint64_t)mesh->triangle_count;
    struct collapse c = {.ctx = ctx,
                         .options = options,
                         .mesh = mesh,
                         .alive = mesh->triangle_count,
                         .heap_capacity = heap_capacity(mesh->triangle_count)};
    static const char what[] = "an edge collapse";
    int status = 0;
    if (mesh->triangle_count <= options->target)
        return 0;
    BSQ_TRY(bsq_alloc(ctx, what, corners, sizeof *c.next, &c.next));
    BSQ_TRY(bsq_alloc(ctx, what, vertices, sizeof *c.corner, &c.corner));
    BSQ_TRY(bsq_calloc(ctx, what, vertices, sizeof *c.stamps, &c.stamps));
    BSQ_TRY(bsq_calloc(ctx, what, vertices, sizeof *c.marks, &c.marks));
    BSQ_TRY(bsq_calloc(ctx, what, vertices, sizeof *c.flags, &c.flags));
    BSQ_TRY(bsq_alloc(ctx, what, c.heap_capacity, sizeof *c.heap, &c.heap));
    BSQ_TRY(link_corners(&c));
    BSQ_TRY(flag_vertices(&c));
    BSQ_TRY(collapse_edges(&c));
    compact(mesh, c.marks);
done:
    bsq_free(ctx, c.heap);
    bsq_free(ctx, c.flags);
    bsq_free(ctx, c.marks);
    bsq_free(ctx, c.stamps);
    bsq_free(ctx, c.corner);
    bsq_free(ctx, c.next);
    return status;
}

/* ---- meshes ---- */

uint64_t vox_collapse_bytes(uint64_t vertices, uint64_t triangles, bool quadrics)
{
    const uint64_t vertex =
        sizeof(float[3]) + (quadrics ? sizeof(struct vox_quadric) : 0) + 3 * sizeof(uint32_t) + 1;
    return vertices * vertex + triangles * 6 * sizeof(uint32_t) +
           heap_capacity(triangles) * sizeof(struct candidate);
}

int vox_mesh_allocate(struct bsq_ctx *ctx, uint32_t vertices, uint32_t triangles, bool quadrics,
                      struct vox_mesh *mesh)
{
    int status = 0;
    *mesh = (struct vox_mesh){.vertex_count = vertices, .triangle_count = triangles};
    BSQ_TRY(bsq_alloc(ctx, "a mesh", vertices, sizeof *mesh->positions, &mesh->positions));
    BSQ_TRY(bsq_alloc(ctx, "a mesh", triangles, sizeof *mesh->triangles, &mesh->triangles));
    if (quadrics)
        BSQ_TRY(bsq_alloc(ctx, "a mesh", vertices, sizeof *mesh->quadrics, &mesh->quadrics));
done:
    if (status < 0)
        vox_mesh_free(ctx, mesh);
    return status;
}

void vox_mesh_free(struct bsq_ctx *ctx, struct vox_mesh *mesh)
{
    bsq_free(ctx, mesh->positions);
    bsq_free(ctx, mesh->triangles);
    bsq_free(ctx, mesh->quadrics);
    *mesh = (struct vox_mesh){0};
}

/* Numbers positions in the order of their first vertices; moves these together. */
static void join_vertices(struct vox_mesh *mesh, struct bsq_positions *table, uint32_t *numbers)
{
    uint32_t count = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        uint32_t *slot = bsq_positions_find(table, mesh->positions[v]);
        if (*slot == 0) {
            memmove(mesh->positions[count], mesh->positions[v], sizeof *mesh->positions);
            if (mesh->quadrics)
                mesh->quadrics[count] = mesh->quadrics[v];
            *slot = ++count;
        } else if (mesh->quadrics) {
            add_quadric(&mesh->quadrics[*slot - 1], &mesh->quadrics[v]);
        }
        numbers[v] = *slot - 1;
    }
    mesh->vertex_count = count;
}

/* Returns whether a triangle before `count` has the same corners, in any order. */
static bool is_repeated(const struct vox_mesh *mesh, const uint32_t *first, const uint32_t *next,
                        const uint32_t corners[3])
{
    const uint32_t least = corners[0] < corners[1] ? corners[0] : corners[1];
    for (uint32_t t = first[least < corners[2] ? least : corners[2]]; t != NONE; t = next[t]) {
        unsigned same = 0;
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                same += mesh->triangles[t][i] == corners[k];
        if (same == 3)
            return true;
    }
    return false;
}

/* Leaves triangles out that have no three corners or that are there already. first: of vertices,
 * the last triangle whose least corner it is; next: the one before that. */
static void join_triangles(struct vox_mesh *mesh, const uint32_t *numbers, uint32_t *first,
                           uint32_t *next)
{
    uint32_t count = 0;
    memset(first, 0xff, mesh->vertex_count * sizeof *first);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        uint32_t corners[3];
        for (int k = 0; k < 3; k++)
            corners[k] = numbers[mesh->triangles[t][k]];
        if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0] ||
            is_repeated(mesh, first, next, corners))
            continue;
        const uint32_t least = corners[0] < corners[1] ? corners[0] : corners[1];
        uint32_t *chain = &first[least < corners[2] ? least : corners[2]];
        next[count] = *chain;
        *chain = count;
        memcpy(mesh->triangles[count++], corners, sizeof corners);
    }
    mesh->triangle_count = count;
}

int vox_mesh_weld(struct bsq_ctx *ctx, struct vox_mesh *mesh)
{
    struct bsq_positions table = {.positions = (const float(*)[3])mesh->positions};
    uint32_t *numbers = NULL, *first = NULL, *next = NULL;
    const uint32_t slots = bsq_positions_slots(mesh->vertex_count);
    int status = 0;
    table.mask = slots - 1;
    BSQ_TRY(bsq_calloc(ctx, "welding a mesh", slots, sizeof *table.slots, &table.slots));
    BSQ_TRY(bsq_alloc(ctx, "welding a mesh", mesh->vertex_count, sizeof *numbers, &numbers));
    BSQ_TRY(bsq_alloc(ctx, "welding a mesh", mesh->vertex_count, sizeof *first, &first));
    BSQ_TRY(bsq_alloc(ctx, "welding a mesh", mesh->triangle_count, sizeof *next, &next));
    join_vertices(mesh, &table, numbers);
    join_triangles(mesh, numbers, first, next);
done:
    bsq_free(ctx, next);
    bsq_free(ctx, first);
    bsq_free(ctx, numbers);
    bsq_free(ctx, table.slots);
    return status;
}
