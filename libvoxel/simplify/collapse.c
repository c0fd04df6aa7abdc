/* collapse.c - see steps.h.
 *
 * Each vertex keeps the sums over its triangles that costs are made of; as the planes of these go
 * through the vertex, nine numbers are enough. Candidates are in a heap. One counts only while
 * neither vertex has changed since it was made, and is computed again when it comes up, because its
 * cost may have grown as neighbours moved; then it goes back into the heap. */
#include "libvoxel/simplify/steps.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"
#include "libvoxel/simplify/closest.h"
#include "libvoxel/simplify/fit.h"
#include "libvoxel/simplify/folds.h"
#include "libvoxel/simplify/limits.h"
#include "libvoxel/simplify/topology.h"

/* Weight of the distance from an open border, beside that from the triangles. */
static const double border_weight = 10.0;
/* Pull towards the middle of an edge, in parts of the quadric's trace: it decides where the
 * quadric does not, along flat or straight parts. */
static const double pull = 1e-10;
/* Share of the squared length of the edge, in the quadric's trace, that is added to a cost. In flat
 * parts, where all costs are 0, short edges go first. */
static const double length_share = 1e-13;
/* Weight of the sixth power of a drift, beside squared volumes: it lets most collapses go in the
 * order of their volumes, and keeps back those that would go far, such as tips of thin parts. */
static const double drift_weight = 100;
/* Weight of the fourth power of a drift and the area, and by how much a drift's square in parts of
 * the area raises a squared volume: between the two, they keep back what goes far for its size. */
static const double area_weight = 2, volume_weight = 50;
/* Weight of the cost of the drift that dropping a piece leads to: the surface is nearer than its
 * vertices are. */
static const double piece_weight = 0.1;
/* Weight of the squared volume between a cut and the surface, so that handles go after noise. */
static const double cut_weight = 30;
/* Weight of the sixth power of the longest edge where the surface would fold over: such changes
 * come last. */
static const double fold_weight = 1e6;
/* A candidate whose cost has grown by more than this factor goes back into the heap. */
static const double grown = 1.000001;
/* With limits, edges collapse again as long as less than this share of triangles is left. */
static const double gain_least = 0.98;

/* Places in the heap have four children, which begin at a multiple of four: one line of the cache.
 */
enum { CHILDREN = 4, HEAP_TOP = 3 };

struct candidate {
    uint64_t key; /* bits of the cost, which are in the order of costs, above u */
    uint32_t v;
    uint32_t stamp; /* the sum of both vertices' stamps */
};

/* Sums over the triangles around a vertex. */
struct around {
    double a[6];      /* n n^T, with n of twice the area's length */
    double normal[3]; /* n */
};

struct collapse {
    struct vox_rings rings;
    uint32_t target;
    double unit; /* factor of costs: a power of two that lets floats hold them at any scale */
    struct around *around; /* of vertices */
    uint32_t *stamps;      /* of vertices: grow with each change */
    float *drifts;         /* of vertices: how far the surface there has gone, see add_drift() */
    float (*old)[3];       /* of vertices: where they were at first */
    uint32_t *into;        /* sets of vertices that have become one, for vox_find_root() */
    struct candidate *heap;
    uint64_t heap_end, heap_capacity;
    struct vox_places places; /* for pieces */
    struct vox_removed *removed;
    struct vox_limits *limits; /* NULL: the number of triangles is the only one */
};

/* What the collapse of an edge would do. */
struct result {
    double cost;
    double area_square; /* sum of the squares of twice the triangles' areas */
    float position[3];
};

/* ---- costs ---- */

/* v A v + 2 b v + c, relative to the middle of an edge. */
struct error {
    double a[6], b[3], c;
};

static void add_product(double a[6], const double n[3], double w)
{
    a[0] += w * n[0] * n[0];
    a[1] += w * n[0] * n[1];
    a[2] += w * n[0] * n[2];
    a[3] += w * n[1] * n[1];
    a[4] += w * n[1] * n[2];
    a[5] += w * n[2] * n[2];
}

static void multiply(const double a[6], const double x[3], double out[3])
{
    out[0] = a[0] * x[0] + a[1] * x[1] + a[2] * x[2];
    out[1] = a[1] * x[0] + a[3] * x[1] + a[4] * x[2];
    out[2] = a[2] * x[0] + a[4] * x[1] + a[5] * x[2];
}

static void sum_around(struct collapse *c, uint32_t v)
{
    const struct vox_mesh *mesh = c->rings.mesh;
    struct around sum = {{0}, {0}};
    for (VOX_EACH_CORNER(&c->rings, v, k)) {
        double n[3];
        vox_triangle_normal((const float(*)[3])mesh->positions, vox_corners(&c->rings, k), n);
        add_product(sum.a, n, 1);
        for (int i = 0; i < 3; i++)
            sum.normal[i] += n[i];
    }
    c->around[v] = sum;
}

/* Adds w |e x (x - p)|^2: the squared distance from the line through p along e, times |e|^2. */
static void add_line(struct error *q, const double e[3], const double p[3], double w)
{
    static const double axes[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int k = 0; k < 3; k++) {
        double n[3]; /* component k of e x y is n y */
        bsq_crossd(axes[k], e, n);
        const double d = bsq_dotd(n, p);
        add_product(q->a, n, w);
        for (int i = 0; i < 3; i++)
            q->b[i] -= w * d * n[i];
        q->c += w * d * d;
    }
}

/* Adds the borders at a vertex, but not the edge to `skipped`. */
static void add_borders(struct collapse *c, uint32_t u, uint32_t skipped, const double from[3],
                        double scale, struct error *q)
{
    struct vox_rings *r = &c->rings;
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    if ((r->flags[u] & (VOX_BORDER | VOX_LOCKED)) != VOX_BORDER)
        return;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t ends[2] = {vox_after(r, k), vox_before(r, k)};
        for (int i = 0; i < 2; i++) {
            double edge[3], p[3];
            if (ends[i] == skipped || !(r->flags[ends[i]] & VOX_BORDER) ||
                !vox_rings_is_border(r, u, ends[i]))
                continue;
            for (int j = 0; j < 3; j++) {
                p[j] = (double)positions[u][j] - from[j];
                edge[j] = (double)positions[ends[i]][j] - (double)positions[u][j];
            }
            add_line(q, edge, p, border_weight * scale);
        }
    }
}

/* Finds the place of least error near the origin, which is the middle of the edge, under the
 * constraint normal x = volume. */
static void place(const struct error *q, const double normal[3], double volume, double x[3])
{
    double tied[6], minus_b[3], y[3];
    const double trace = q->a[0] + q->a[3] + q->a[5];
    memcpy(tied, q->a, sizeof tied);
    tied[0] += pull * trace;
    tied[3] += pull * trace;
    tied[5] += pull * trace;
    for (int k = 0; k < 3; k++)
        minus_b[k] = -q->b[k];
    if (!vox_solve(tied, minus_b, x)) {
        memset(x, 0, 3 * sizeof *x);
        return;
    }
    if (!vox_solve(tied, normal, y))
        return;
    const double along = bsq_dotd(normal, y), missing = volume - bsq_dotd(normal, x);
    for (int k = 0; k < 3 && along > 0; k++)
        x[k] += y[k] * missing / along;
}

static double error_of_place(const struct error *q, const double x[3])
{
    double ax[3];
    multiply(q->a, x, ax);
    const double error = bsq_dotd(x, ax) + 2 * bsq_dotd(q->b, x) + q->c;
    return error > 0 ? error : 0;
}

/* Finds the end of an edge, or its middle, where the error is least. w: an end from the middle. */
static void place_on_edge(const struct error *q, const double w[3], double x[3])
{
    double least = INFINITY;
    for (int i = -1; i <= 1; i++) {
        const double at[3] = {i * w[0], i * w[1], i * w[2]}, error = error_of_place(q, at);
        if (error < least)
            memcpy(x, at, sizeof at);
        least = fmin(least, error);
    }
}

/* Sums up what the triangles around an edge say, relative to its middle. w: u from the middle.
 * Triangles with both vertices are in both sums; their planes go through the middle. */
static void sum_edge(struct collapse *c, uint32_t u, uint32_t v, const double w[3], struct error *q,
                     double normal[3], double *volume)
{
    struct vox_rings *r = &c->rings;
    const struct around *at_u = &c->around[u], *at_v = &c->around[v];
    double sum[6], difference[6], aw[3];
    for (int i = 0; i < 6; i++) {
        sum[i] = at_u->a[i] + at_v->a[i];
        difference[i] = at_v->a[i] - at_u->a[i];
    }
    *q = (struct error){{0}, {0}, 0};
    multiply(difference, w, q->b);
    multiply(sum, w, aw);
    q->c = bsq_dotd(w, aw);
    memcpy(q->a, sum, sizeof sum);
    *volume = 0;
    for (int k = 0; k < 3; k++) {
        *volume += (at_u->normal[k] - at_v->normal[k]) * w[k];
        normal[k] = at_u->normal[k] + at_v->normal[k];
    }
    for (VOX_EACH_CORNER(r, u, k)) {
        double n[3];
        if (vox_after(r, k) != v && vox_before(r, k) != v)
            continue;
        vox_triangle_normal((const float(*)[3])r->mesh->positions, vox_corners(r, k), n);
        add_product(q->a, n, -1);
        for (int i = 0; i < 3; i++)
            normal[i] -= n[i];
    }
}

/* Computes what the collapse of an edge does. Returns false if it is not allowed, as both vertices
 * are locked, or not finite. A place that is farther from the middle than the edge is long would be
 * a spike; then it is on the edge. */
static bool evaluate(struct collapse *c, uint32_t u, uint32_t v, struct result *out)
{
    const float(*positions)[3] = (const float(*)[3])c->rings.mesh->positions;
    const uint8_t *flags = c->rings.flags;
    struct error q;
    double middle[3], w[3], x[3] = {0, 0, 0}, normal[3], volume, square = 0;
    if (flags[u] & flags[v] & VOX_LOCKED)
        return false;
    for (int k = 0; k < 3; k++) {
        middle[k] = 0.5 * ((double)positions[u][k] + (double)positions[v][k]);
        w[k] = 0.5 * ((double)positions[u][k] - (double)positions[v][k]);
        square += 4 * w[k] * w[k];
    }
    sum_edge(c, u, v, w, &q, normal, &volume);
    add_borders(c, u, VOX_NONE, middle, square, &q);
    add_borders(c, v, u, middle, square, &q);
    const uint8_t differ = flags[u] ^ flags[v];
    /* A vertex that is locked, or alone on an open border, decides the place. */
    const uint8_t decides = differ & VOX_LOCKED ? VOX_LOCKED : differ & VOX_BORDER;
    if (decides) {
        const uint32_t from = flags[u] & decides ? u : v;
        memcpy(out->position, positions[from], sizeof out->position);
    } else {
        place(&q, normal, volume, x);
        if (!(bsq_dotd(x, x) <= square))
            place_on_edge(&q, w, x);
        for (int k = 0; k < 3; k++)
            out->position[k] = (float)(middle[k] + x[k]);
    }
    for (int k = 0; k < 3; k++)
        x[k] = (double)out->position[k] - middle[k];
    out->cost = error_of_place(&q, x);
    out->area_square = q.a[0] + q.a[3] + q.a[5];
    out->cost += length_share * out->area_square * square;
    out->cost *= c->unit;
    return isfinite(out->cost) && isfinite(out->position[0] + out->position[1] + out->position[2]);
}

/* ---- the heap ---- */

/* Cheapest first; the vertices decide between equal costs. */
static bool is_before(const struct candidate *a, const struct candidate *b)
{
    return a->key != b->key ? a->key < b->key : a->v < b->v;
}

static uint32_t get_u(const struct candidate *candidate)
{
    return (uint32_t)candidate->key;
}

static float get_cost(const struct candidate *candidate)
{
    const uint32_t bits = (uint32_t)(candidate->key >> 32);
    float cost;
    memcpy(&cost, &bits, sizeof cost);
    return cost;
}

static uint64_t place_below(uint64_t at)
{
    return CHILDREN * (at - HEAP_TOP + 1);
}

static void sift_down(struct collapse *c, uint64_t at)
{
    const struct candidate moved = c->heap[at];
    for (uint64_t child; (child = place_below(at)) < c->heap_end; at = child) {
        const uint64_t end = child + CHILDREN;
        for (uint64_t i = 0; i < CHILDREN; i++)
            __builtin_prefetch(&c->heap[place_below(child + i)]);
        for (uint64_t i = child + 1; i < end && i < c->heap_end; i++)
            child = is_before(&c->heap[i], &c->heap[child]) ? i : child;
        if (!is_before(&c->heap[child], &moved))
            break;
        c->heap[at] = c->heap[child];
    }
    c->heap[at] = moved;
}

static bool is_current(const struct collapse *c, const struct candidate *candidate)
{
    const uint32_t u = get_u(candidate), v = candidate->v;
    return c->stamps[u] + c->stamps[v] == candidate->stamp && c->rings.corner[u] != VOX_NONE &&
           c->rings.corner[v] != VOX_NONE;
}

/* Drops candidates that do not count any more. */
static void clean_heap(struct collapse *c)
{
    uint64_t kept = HEAP_TOP;
    for (uint64_t i = HEAP_TOP; i < c->heap_end; i++)
        if (is_current(c, &c->heap[i]))
            c->heap[kept++] = c->heap[i];
    c->heap_end = kept;
    for (uint64_t i = kept; i-- > HEAP_TOP;)
        sift_down(c, i);
}

/* Adds a candidate. The heap has space for twice the edges of the mesh, so cleaning makes space. */
static void push(struct collapse *c, struct candidate candidate)
{
    if (c->heap_end == c->heap_capacity)
        clean_heap(c);
    if (c->heap_end == c->heap_capacity)
        return;
    uint64_t at = c->heap_end++;
    for (uint64_t above; at > HEAP_TOP; at = above) {
        above = at / CHILDREN + HEAP_TOP - 1;
        if (!is_before(&candidate, &c->heap[above]))
            break;
        c->heap[at] = c->heap[above];
    }
    c->heap[at] = candidate;
}

static struct candidate pop(struct collapse *c)
{
    const struct candidate top = c->heap[HEAP_TOP];
    c->heap[HEAP_TOP] = c->heap[--c->heap_end];
    sift_down(c, HEAP_TOP);
    return top;
}

static void push_edge(struct collapse *c, uint32_t u, uint32_t v, double cost)
{
    const uint32_t low = u < v ? u : v, high = u < v ? v : u;
    const float rounded = (float)cost;
    uint32_t bits;
    memcpy(&bits, &rounded, sizeof bits);
    push(c, (struct candidate){(uint64_t)bits << 32 | low, high, c->stamps[u] + c->stamps[v]});
}

/* Adds the edges of a vertex, or only those to vertices with higher numbers. Ends early after an
 * interruption: many edges of one vertex take long. */
static void push_edges(struct collapse *c, uint32_t vertex, bool higher)
{
    struct result result;
    const uint32_t mark = ++c->rings.walk;
    for (VOX_EACH_CORNER(&c->rings, vertex, k)) {
        const uint32_t ends[2] = {vox_after(&c->rings, k), vox_before(&c->rings, k)};
        for (int i = 0; i < 2; i++) {
            if (c->rings.marks[ends[i]] == mark || (higher && ends[i] < vertex))
                continue;
            c->rings.marks[ends[i]] = mark;
            if (bsq_check(c->rings.ctx) < 0)
                return;
            if (evaluate(c, vertex, ends[i], &result))
                push_edge(c, vertex, ends[i], result.cost);
        }
    }
}

/* ---- the collapse ---- */

/* Returns the squared distance of a point from the triangles of u without v, with u at p, or `most`
 * if that is less. */
static double find_square(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3],
                          const float point[3], double most)
{
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t a = vox_after(r, k), b = vox_before(r, k);
        if (a != v && b != v)
            most = vox_triangle_square((const float *const[3]){p, positions[a], positions[b]},
                                       point, most);
    }
    return most;
}

/* Returns a drift after a further step. Steps of noise go to and fro, so their squares add up. */
static float add_drift(float before, double square)
{
    return (float)sqrt((double)before * (double)before + square);
}

/* Returns the drift that the collapse of (u, v) to p leads to: the larger one of both vertices',
 * and the distances of these from the triangles after it and of p from those before. */
static float find_drift(struct collapse *c, uint32_t u, uint32_t v, const float p[3])
{
    struct vox_rings *r = &c->rings;
    const float *at_u = r->mesh->positions[u], *at_v = r->mesh->positions[v];
    double from_u = 0, from_v = 0;
    for (int k = 0; k < 3; k++) {
        const double du = (double)at_u[k] - (double)p[k], dv = (double)at_v[k] - (double)p[k];
        from_u += du * du;
        from_v += dv * dv;
    }
    double back = fmin(from_u, from_v);
    from_u = find_square(r, u, v, p, at_u, from_u);
    from_u = find_square(r, v, u, p, at_u, from_u);
    from_v = find_square(r, u, v, p, at_v, from_v);
    from_v = find_square(r, v, u, p, at_v, from_v);
    back = find_square(r, u, VOX_NONE, at_u, p, back);
    back = find_square(r, v, u, at_v, p, back);
    return add_drift(fmaxf(c->drifts[u], c->drifts[v]), fmax(back, fmax(from_u, from_v)));
}

static double drift_cost(const struct collapse *c, float drift)
{
    const double square = (double)drift * (double)drift;
    return c->unit * drift_weight * square * square * square;
}

/* Returns the cost of a collapse that leads to a drift. */
static double cost_with_drift(const struct collapse *c, const struct result *result, float drift)
{
    const double area = sqrt(result->area_square), square = (double)drift * (double)drift;
    const double share = area > 0 ? square / area : 0;
    return result->cost * (1 + volume_weight * share) +
           c->unit * area_weight * area * square * square + drift_cost(c, drift);
}

/* Returns the squared length of the way between two vertices. */
static double edge_square(const struct collapse *c, uint32_t u, uint32_t v)
{
    const float(*positions)[3] = (const float(*)[3])c->rings.mesh->positions;
    double square = 0;
    for (int k = 0; k < 3; k++) {
        const double way = (double)positions[u][k] - (double)positions[v][k];
        square += way * way;
    }
    return square;
}

static double fold_cost(const struct collapse *c, double square)
{
    return c->unit * fold_weight * square * square * square;
}

/* Puts a candidate back into the heap if it has become dearer. Returns whether it has. */
static bool put_back(struct collapse *c, const struct candidate *candidate, double cost)
{
    const float before = get_cost(candidate);
    if (!(cost > (double)before * grown && (float)cost > before))
        return false;
    if (isfinite((float)cost))
        push_edge(c, get_u(candidate), candidate->v, cost);
    return true;
}

/* Computes anew what changes when the triangles of a vertex do, and adds its candidates. */
static void update_vertex(struct collapse *c, uint32_t v)
{
    struct vox_rings *r = &c->rings;
    const uint32_t mark = ++r->walk;
    c->stamps[v]++;
    sum_around(c, v);
    for (VOX_EACH_CORNER(r, v, k)) {
        const uint32_t ends[2] = {vox_after(r, k), vox_before(r, k)};
        for (int i = 0; i < 2; i++) {
            if (r->marks[ends[i]] != mark)
                sum_around(c, ends[i]);
            r->marks[ends[i]] = mark;
        }
    }
    push_edges(c, v, false);
}

/* ---- pieces and handles ---- */

/* Drops the small piece of a candidate's edge. What is nearest stands for it from then on. Returns
 * whether there is one, or an error. */
static int drop_small_piece(struct collapse *c, const struct candidate *candidate)
{
    struct vox_rings *r = &c->rings;
    struct vox_small_piece piece;
    float drift = 0;
    int status = vox_find_small_piece(r, candidate->v, &c->places, &piece);
    if (status < 0 || piece.count == 0)
        return status;
    for (unsigned i = 0; i < piece.count; i++)
        drift = fmaxf(drift, c->drifts[piece.vertices[i]]);
    drift = add_drift(fmaxf(drift, c->drifts[piece.nearest]), piece.square);
    if (put_back(c, candidate, piece_weight * drift_cost(c, drift)))
        return 1;
    const uint32_t before = r->alive;
    vox_drop_piece(r, &piece);
    c->drifts[piece.nearest] = drift;
    c->removed->pieces++;
    c->removed->triangles += before - r->alive;
    return 1;
}

/* Cuts a handle or a neck where a candidate's edge is one of three around it. */
static void cut_handle(struct collapse *c, const struct candidate *candidate)
{
    struct vox_rings *r = &c->rings;
    uint32_t cycle[3], copies[3];
    double normal[3], longest = 0, around = 0;
    float drift = 0;
    if (!vox_find_cycle(r, get_u(candidate), candidate->v, cycle))
        return;
    vox_triangle_normal((const float(*)[3])r->mesh->positions, cycle, normal);
    for (int i = 0; i < 3; i++) {
        const double square = edge_square(c, cycle[i], cycle[(i + 1) % 3]);
        longest = fmax(longest, square);
        around += sqrt(square);
        drift = fmaxf(drift, c->drifts[cycle[i]]);
    }
    /* No place in the new triangles is farther from the surface than the radius of their circle,
     * which is twice their area by the way around them. */
    const double area_square = bsq_dotd(normal, normal), square = area_square / (around * around);
    drift = add_drift(drift, square);
    const double fold = vox_cap_folds(r, cycle, normal) ? fold_cost(c, longest) : 0;
    if (put_back(c, candidate,
                 c->unit * cut_weight * area_square * square + drift_cost(c, drift) + fold) ||
        !vox_cut_cycle(r, cycle, copies))
        return;
    c->removed->handles++;
    for (int i = 0; i < 3; i++) {
        c->drifts[cycle[i]] = c->drifts[copies[i]] = drift;
        c->into[copies[i]] = copies[i];
    }
    for (int i = 0; i < 3; i++) {
        update_vertex(c, cycle[i]);
        update_vertex(c, copies[i]);
    }
}

/* Takes the cheapest candidate, and collapses it if that is allowed. Errors: BSQ_ENOMEM,
 * BSQ_EINTR. */
static int collapse_next(struct collapse *c)
{
    const struct candidate candidate = pop(c);
    const uint32_t u = get_u(&candidate), v = candidate.v;
    struct vox_rings *r = &c->rings;
    struct result result;
    if (!is_current(c, &candidate) || !evaluate(c, u, v, &result))
        return 0;
    const float drift = find_drift(c, u, v, result.position);
    result.cost = cost_with_drift(c, &result, drift);
    if (put_back(c, &candidate, result.cost))
        return 0;
    if (!vox_rings_keep_topology(r, u, v)) {
        if (c->limits)
            return 0;
        const int dropped = drop_small_piece(c, &candidate);
        if (dropped == 0)
            cut_handle(c, &candidate);
        return dropped < 0 ? dropped : 0;
    }
    if (vox_makes_fold(r, u, v, result.position) &&
        (c->limits || put_back(c, &candidate, result.cost + fold_cost(c, edge_square(c, u, v)))))
        return 0;
    if (c->limits) {
        if (!vox_limits_allow(c->limits, r, u, v, result.position))
            return 0;
        vox_limits_change(c->limits);
    }
    vox_rings_join(r, u, v, result.position);
    c->into[v] = u;
    c->drifts[u] = drift;
    c->removed->cost = result.cost / c->unit;
    update_vertex(c, u);
    return 0;
}

/* Edges that were refused may be allowed after their neighbours have changed, so all edges become
 * candidates again as long as that helps; with limits, only after the mesh has been fitted. */
static int collapse_edges(struct collapse *c)
{
    struct vox_rings *r = &c->rings;
    uint32_t before_pass = UINT32_MAX, reported = r->alive;
    while (r->alive > c->target && r->alive < before_pass) {
        before_pass = r->alive;
        for (uint32_t v = 0; v < r->mesh->vertex_count; v++) {
            if (bsq_check(r->ctx) < 0)
                return BSQ_EINTR;
            if (vox_first_corner(r, v) != VOX_NONE)
                push_edges(c, v, true);
        }
        for (uint64_t i = 0; c->heap_end > HEAP_TOP && r->alive > c->target; i++) {
            int status = collapse_next(c);
            if (status == 0)
                status = bsq_check(r->ctx);
            if (status < 0)
                return status;
            if (i % VOX_CHECK_EVERY != 0)
                continue;
            bsq_progress_add(r->ctx, reported - r->alive);
            reported = r->alive;
        }
        c->heap_end = HEAP_TOP;
        if (c->limits)
            break;
    }
    return 0;
}

/* Returns the unit of costs, which have the dimension of the third power of an area. */
static double find_unit(const struct vox_mesh *mesh)
{
    double area = 0;
    int exponent;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        double normal[3];
        vox_triangle_normal((const float(*)[3])mesh->positions, mesh->triangles[t], normal);
        area += sqrt(bsq_dotd(normal, normal));
    }
    frexp(area / mesh->triangle_count, &exponent);
    return ldexp(1, -3 * exponent);
}

/* Frees what only collapses need. */
static void free_candidates(struct collapse *c)
{
    BSQ_FREE(c->rings.ctx, c->places.places, c->heap, c->around, c->stamps);
    c->places.places = NULL;
    c->heap = NULL;
    c->around = NULL;
    c->stamps = NULL;
}

/* Collapses edges and fits the mesh; with limits, again as long as that takes 2 % away. */
static int collapse_and_fit(struct collapse *c)
{
    struct vox_rings *r = &c->rings;
    const struct vox_fit_from from = {(const float(*)[3])c->old, c->into, c->drifts, c->limits};
    uint32_t before;
    do {
        for (uint32_t v = 0; v < r->mesh->vertex_count; v++)
            if (vox_first_corner(r, v) != VOX_NONE)
                sum_around(c, v);
        before = r->alive;
        BSQ_PASS(collapse_edges(c));
        if (!c->limits)
            free_candidates(c);
        BSQ_PASS(vox_fit(r, &from));
    } while (c->limits && r->alive < gain_least * before);
    return 0;
}

int vox_collapse(struct bsq_ctx *ctx, uint32_t target, struct vox_limits *limits,
                 const uint8_t *locked, struct vox_mesh *mesh, struct vox_removed *removed)
{
    static const char what[] = "an edge collapse";
    const uint64_t vertices = mesh->vertex_count;
    struct collapse c = {.rings = {.ctx = ctx},
                         .target = target,
                         .unit = find_unit(mesh),
                         .removed = removed,
                         .limits = limits,
                         .heap_end = HEAP_TOP,
                         /* twice the edges of a closed mesh */
                         .heap_capacity = 3 * (uint64_t)mesh->triangle_count + 16};
    int status = 0;
    if (mesh->triangle_count <= target)
        return 0;
    BSQ_TRY(vox_rings_build(ctx, mesh, false, &c.rings));
    BSQ_TRY(BSQ_CALLOC(ctx, what, vertices, &c.stamps));
    BSQ_TRY(BSQ_CALLOC(ctx, what, vertices, &c.drifts));
    BSQ_TRY(BSQ_ALLOC(ctx, what, vertices, &c.around));
    BSQ_TRY(BSQ_ALLOC(ctx, what, vertices, &c.old));
    BSQ_TRY(BSQ_ALLOC(ctx, what, vertices, &c.into));
    BSQ_TRY(BSQ_ALLOC(ctx, what, c.heap_capacity, &c.heap));
    memcpy(c.old, mesh->positions, vertices * sizeof *c.old);
    for (uint32_t v = 0; v < vertices; v++) {
        c.into[v] = v;
        c.rings.flags[v] |= locked && locked[v] ? VOX_LOCKED | VOX_SHARED : 0;
    }
    if (limits)
        vox_limits_restart(limits);
    BSQ_TRY(collapse_and_fit(&c));
    if (limits)
        vox_limits_number(limits, &c.rings);
    vox_rings_compact(&c.rings);
done:
    free_candidates(&c);
    BSQ_FREE(ctx, c.into, c.old, c.drifts);
    vox_rings_free(&c.rings);
    return status;
}
