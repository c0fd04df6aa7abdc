/* cluster.c - see steps.h.
 *
 * A cluster has the number of its least vertex. It may become a vertex if its part of the surface
 * is contractible: if its vertices less its edges, plus its triangles, are 1. Then only edges
 * between two clusters that join, and what is left of pieces, can make a surface that is none,
 * which shows at the triangles around the new vertices. */
#include "libvoxel/simplify/steps.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"

enum {
    AXIS_BITS = 10,                   /* of the number of a cell */
    CELLS_MAX = (1 << AXIS_BITS) - 2, /* along an axis */
    STAYS = 1 << (3 * AXIS_BITS),     /* or-ed to a vertex: a cell of its own */
    LEAST_SHARE = 24,                 /* a mesh keeps at least a 24th of its vertices */
    SMALL = 3,                        /* vertices of a cluster that joins its neighbour */
    ROUNDS_MAX = 8
};
/* Cells that a plane crosses, for its area in squares of cells, on average over its directions. */
static const double crossed_cells = 1.5;
/* Pull towards the middle of a cluster's vertices, in parts of its quadric's trace. Less of it
 * leads to more folds where the scan is rough. */
static const double pull = 1e-3;
/* Least cosine between neighbouring triangles. */
static const float least_cosine = -0.2F;

/* A corner of a new triangle: the ends of the edge opposite to it, in order. */
struct corner {
    uint32_t after, before;
    uint32_t triangle; /* in kept */
};

/* Of a new vertex: the last one + 1 that it was found beside, and the corner where it is after
 * that.
 */
struct mark {
    uint32_t after_mark, before_mark, corner;
};

struct clustering {
    struct bsq_ctx *ctx;
    struct vox_mesh *mesh;
    uint32_t *cells;  /* of vertices */
    uint32_t *owners; /* of vertices: their cluster */
    int32_t *euler;   /* of clusters: twice their vertices, less edges, plus triangles */
    uint8_t *bad;     /* of clusters; before they are judged, vertices of small ones */
    /* Of clusters, their new vertex; first sums relative to their least vertex. */
    float (*positions)[3];
    struct vox_quadric *quadrics;
    uint32_t *sizes;
    /* Triangles with corners in three clusters, and the corners of each cluster. */
    uint32_t *kept, kept_count;
    uint32_t *first; /* of clusters and one more */
    struct corner *corners;
    float (*normals)[3]; /* of kept triangles */
    struct mark *marks;
};

/* ---- clusters ---- */

/* Gives vertices a cell of their own unless the edges around them close. Then each neighbour is
 * once after and once before a vertex, so that sums of mixed numbers are 0. Returns how many have
 * one. */
static int keep_borders(struct clustering *c, uint32_t *kept)
{
    const struct vox_mesh *mesh = c->mesh;
    uint64_t *sums = NULL;
    int status = 0;
    *kept = 0;
    BSQ_TRY(BSQ_CALLOC(c->ctx, "clusters", mesh->vertex_count, &sums));
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        const uint64_t m[3] = {vox_mix_bits(v[0] + UINT64_C(1)), vox_mix_bits(v[1] + UINT64_C(1)),
                               vox_mix_bits(v[2] + UINT64_C(1))};
        sums[v[0]] += m[1] - m[2];
        sums[v[1]] += m[2] - m[0];
        sums[v[2]] += m[0] - m[1];
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        c->cells[v] = sums[v] != 0 ? STAYS | v : 0;
        *kept += sums[v] != 0;
    }
done:
    bsq_free(c->ctx, sums);
    return status;
}

/* Numbers the cells of vertices. Cells are as large as the share asks for. */
static void number_cells(struct clustering *c, double share, uint32_t kept)
{
    const struct vox_mesh *mesh = c->mesh;
    const double count = mesh->vertex_count;
    double area = 0, longest = 0;
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const float *a = mesh->quadrics[v].a, *p = mesh->positions[v];
        area += (double)(a[0] + a[3] + a[5]) / 3; /* each triangle is in three traces */
        for (int k = 0; k < 3; k++) {
            low[k] = p[k] < low[k] ? p[k] : low[k];
            high[k] = p[k] > high[k] ? p[k] : high[k];
        }
    }
    for (int k = 0; k < 3; k++)
        longest = fmax(longest, (double)high[k] - (double)low[k]);
    const double wanted = fmax(share * count - kept, count / LEAST_SHARE);
    const double side = fmax(sqrt(crossed_cells * area / wanted), longest / CELLS_MAX);
    const double scale = side > 0 ? 1 / side : 0;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const float *p = mesh->positions[v];
        uint32_t cell = 0;
        for (int k = 2; k >= 0; k--) {
            const double at = ((double)p[k] - (double)low[k]) * scale;
            cell = cell << AXIS_BITS | (uint32_t)(at < CELLS_MAX ? at : CELLS_MAX);
        }
        c->cells[v] = c->cells[v] ? c->cells[v] : cell;
    }
}

/* Joins two clusters. */
static void unite(uint32_t *owners, uint32_t i, uint32_t j)
{
    owners[i > j ? i : j] = i < j ? i : j;
}

/* Joins vertices along edges inside a cell. */
static void find_clusters(struct clustering *c)
{
    const struct vox_mesh *mesh = c->mesh;
    uint32_t *owners = c->owners;
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        owners[v] = v;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        for (int k = 0; k < 3; k++) {
            const uint32_t a = v[k], b = v[k == 2 ? 0 : k + 1];
            if ((c->cells[a] == c->cells[b]) & (owners[a] != owners[b]))
                unite(owners, vox_find_root(owners, a), vox_find_root(owners, b));
        }
    }
}

/* Joins small clusters to a neighbour. Corners of cells cut them off, and they would often have two
 * neighbours only. */
static void join_small(struct clustering *c)
{
    const struct vox_mesh *mesh = c->mesh;
    uint32_t *sizes = c->sizes, *owners = c->owners;
    memset(sizes, 0, mesh->vertex_count * sizeof *sizes);
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        sizes[owners[v] = vox_find_root(owners, v)]++;
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        c->bad[v] = sizes[owners[v]] <= SMALL;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        for (int k = 0; k < 3 && (c->bad[v[0]] | c->bad[v[1]] | c->bad[v[2]]); k++) {
            const uint32_t a = v[k], b = v[k == 2 ? 0 : k + 1];
            if (c->cells[a] == c->cells[b] || ((c->cells[a] | c->cells[b]) & STAYS))
                continue;
            const uint32_t i = vox_find_root(owners, a), j = vox_find_root(owners, b);
            if (i == j || (sizes[i] > SMALL && sizes[j] > SMALL))
                continue;
            unite(owners, i, j);
            sizes[i < j ? i : j] = sizes[i] + sizes[j];
        }
    }
}

/* Ends the search: each vertex has its cluster. Those that are not contractible are bad. */
static void judge_clusters(struct clustering *c)
{
    const struct vox_mesh *mesh = c->mesh;
    uint32_t *owners = c->owners;
    memset(c->euler, 0, mesh->vertex_count * sizeof *c->euler);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        owners[v] = vox_find_root(owners, v);
        c->euler[owners[v]] += 2;
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        const uint32_t i = owners[v[0]], j = owners[v[1]], k = owners[v[2]];
        /* Each side is half an edge: two corners take away one, and three take away 3 - 2. */
        c->euler[i == j || i == k ? i : j] -= i == j || j == k || i == k;
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        c->bad[v] = owners[v] == v && c->euler[v] != 2;
}

/* Lets each vertex of bad clusters be one of its own. Returns whether there were any. */
static bool dissolve(struct clustering *c)
{
    bool any = false;
    for (uint32_t v = c->mesh->vertex_count; v-- > 0;) { /* the least vertex last */
        if (!c->bad[c->owners[v]] || c->sizes[c->owners[v]] < 2)
            continue;
        any = true;
        c->owners[v] = v;
        c->sizes[v] = 1;
        memcpy(c->positions[v], c->mesh->positions[v], sizeof *c->positions);
        c->quadrics[v] = c->mesh->quadrics[v];
    }
    memset(c->bad, 0, c->mesh->vertex_count);
    return any;
}

/* ---- new vertices ---- */

/* Adds a vertex to the sums of its cluster, which are relative to `from`. */
static void add_vertex(struct clustering *c, uint32_t v, const float from[3])
{
    const uint32_t owner = c->owners[v];
    const struct vox_quadric *q = &c->mesh->quadrics[v];
    struct vox_quadric *sum = &c->quadrics[owner];
    const float *p = c->mesh->positions[v], *a = q->a;
    const float s[3] = {from[0] - p[0], from[1] - p[1], from[2] - p[2]};
    const float as[3] = {a[0] * s[0] + a[1] * s[1] + a[2] * s[2],
                         a[1] * s[0] + a[3] * s[1] + a[4] * s[2],
                         a[2] * s[0] + a[4] * s[1] + a[5] * s[2]};
    for (int i = 0; i < 6; i++)
        sum->a[i] += a[i];
    for (int k = 0; k < 3; k++) {
        sum->c += s[k] * (as[k] + 2 * q->b[k]);
        sum->b[k] += q->b[k] + as[k];
        c->positions[owner][k] -= s[k];
    }
    sum->c += q->c;
    c->sizes[owner]++;
}

/* Turns the sums of a cluster into its new vertex. */
static void place_vertex(struct clustering *c, uint32_t owner)
{
    const float *from = c->mesh->positions[owner];
    struct vox_quadric *q = &c->quadrics[owner];
    double a[6], b[3], middle[3], x[3], at_c;
    for (int i = 0; i < 6; i++)
        a[i] = (double)q->a[i];
    const double tied = pull * (a[0] + a[3] + a[5]);
    a[0] += tied;
    a[3] += tied;
    a[5] += tied;
    for (int k = 0; k < 3; k++) {
        middle[k] = (double)c->positions[owner][k] / c->sizes[owner];
        b[k] = tied * middle[k] - (double)q->b[k];
    }
    const bool solved = vox_solve(a, b, x) && isfinite(x[0] + x[1] + x[2]);
    for (int k = 0; k < 3; k++) {
        c->positions[owner][k] = (float)((double)from[k] + (solved ? x[k] : middle[k]));
        x[k] = (double)c->positions[owner][k] - (double)from[k];
    }
    vox_quadric_shift(q, x, a, b, &at_c);
    for (int k = 0; k < 3; k++)
        q->b[k] = (float)b[k];
    q->c = at_c > 0 ? (float)at_c : 0;
}

static void make_vertices(struct clustering *c)
{
    const struct vox_mesh *mesh = c->mesh;
    memset(c->positions, 0, mesh->vertex_count * sizeof *c->positions);
    memset(c->quadrics, 0, mesh->vertex_count * sizeof *c->quadrics);
    memset(c->sizes, 0, mesh->vertex_count * sizeof *c->sizes);
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        add_vertex(c, v, mesh->positions[c->owners[v]]);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        if (c->sizes[v] == 1) {
            memcpy(c->positions[v], mesh->positions[v], sizeof *c->positions);
            c->quadrics[v] = mesh->quadrics[v];
        } else if (c->sizes[v] > 1) {
            place_vertex(c, v);
        }
    }
}

/* ---- what is left ---- */

static void keep_triangles(struct clustering *c)
{
    const struct vox_mesh *mesh = c->mesh;
    const uint32_t *owners = c->owners;
    uint32_t *first = c->first, at = 0;
    c->kept_count = 0;
    memset(first, 0, (mesh->vertex_count + 1U) * sizeof *first);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        const uint32_t i = owners[v[0]], j = owners[v[1]], k = owners[v[2]];
        c->kept[c->kept_count] = t; /* without branches, which would be hard to predict */
        c->kept_count += (i != j) & (j != k) & (k != i);
    }
    for (uint32_t n = 0; n < c->kept_count; n++)
        for (int k = 0; k < 3; k++)
            first[owners[mesh->triangles[c->kept[n]][k]]]++;
    for (uint32_t v = 0; v <= mesh->vertex_count; v++)
        first[v] = at += first[v];
    for (uint32_t n = c->kept_count; n-- > 0;) {
        const uint32_t *v = mesh->triangles[c->kept[n]];
        const uint32_t i = owners[v[0]], j = owners[v[1]], k = owners[v[2]];
        c->corners[--first[i]] = (struct corner){j, k, n};
        c->corners[--first[j]] = (struct corner){k, i, n};
        c->corners[--first[k]] = (struct corner){i, j, n};
    }
}

/* Marks the neighbours of a new vertex. Returns whether each is once after and once before it. */
static bool mark_neighbours(struct clustering *c, uint32_t v)
{
    const uint32_t mark = v + 1;
    for (uint32_t i = c->first[v]; i < c->first[v + 1]; i++) {
        struct mark *after = &c->marks[c->corners[i].after],
                    *before = &c->marks[c->corners[i].before];
        if (after->after_mark == mark || before->before_mark == mark)
            return false;
        after->after_mark = before->before_mark = mark;
        after->corner = i;
    }
    return true;
}

/* Returns whether the triangles around a new vertex are one closed fan, or open ones if it is one
 * that stays. Its neighbours are marked. */
static bool is_surface(const struct clustering *c, uint32_t v)
{
    const uint32_t begin = c->first[v], end = c->first[v + 1], mark = v + 1;
    const struct mark *marks = c->marks;
    uint32_t steps = 0, starts = 0;
    for (uint32_t i = begin; i < end; i++) {
        uint32_t a = c->corners[i].after;
        if (marks[a].before_mark == mark)
            continue;
        starts++;
        for (; marks[a].after_mark == mark; a = c->corners[marks[a].corner].before)
            steps++;
    }
    if (starts > 0)
        return steps == end - begin && (c->cells[v] & STAYS);
    uint32_t a = c->corners[begin].after;
    do {
        a = c->corners[marks[a].corner].before;
        steps++;
    } while (a != c->corners[begin].after);
    return steps == end - begin && steps >= 3;
}

/* Returns whether neighbouring triangles at a new vertex turn by more than they may. Its neighbours
 * are marked. */
static bool is_folded(const struct clustering *c, uint32_t v)
{
    for (uint32_t i = c->first[v]; i < c->first[v + 1]; i++) {
        const uint32_t w = c->corners[i].before;
        if (w < v || c->marks[w].after_mark != v + 1) /* each edge once */
            continue;
        const float *n = c->normals[c->corners[i].triangle],
                    *m = c->normals[c->corners[c->marks[w].corner].triangle];
        if (n[0] * m[0] + n[1] * m[1] + n[2] * m[2] < least_cosine)
            return true;
    }
    return false;
}

static void set_normals(struct clustering *c)
{
    for (uint32_t n = 0; n < c->kept_count; n++) {
        const uint32_t *v = c->mesh->triangles[c->kept[n]];
        const uint32_t corners[3] = {c->owners[v[0]], c->owners[v[1]], c->owners[v[2]]};
        double normal[3];
        vox_triangle_normal((const float(*)[3])c->positions, corners, normal);
        const double square = bsq_dotd(normal, normal);
        for (int k = 0; k < 3; k++)
            c->normals[n][k] = square > 0 ? (float)(normal[k] / sqrt(square)) : 0;
    }
}

static void judge_vertices(struct clustering *c)
{
    memset(c->marks, 0, c->mesh->vertex_count * sizeof *c->marks);
    for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
        const uint32_t begin = c->first[v], end = c->first[v + 1];
        if (c->owners[v] != v)
            continue;
        if (begin == end) {
            c->bad[v] = true;
            continue;
        }
        if (mark_neighbours(c, v) && is_surface(c, v) && !is_folded(c, v))
            continue;
        c->bad[v] = true;
        for (uint32_t i = begin; i < end && c->sizes[v] < 2; i++)
            c->bad[c->corners[i].after] = c->bad[c->corners[i].before] = true;
    }
}

static void compact(struct clustering *c)
{
    struct vox_mesh *mesh = c->mesh;
    uint32_t vertices = 0, *numbers = c->sizes;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        if (c->owners[v] != v || c->first[v] == c->first[v + 1])
            continue;
        memcpy(mesh->positions[vertices], c->positions[v], sizeof *mesh->positions);
        mesh->quadrics[vertices] = c->quadrics[v];
        numbers[v] = vertices++;
    }
    for (uint32_t n = 0; n < c->kept_count; n++) {
        vox_mesh_move_triangle(mesh, n, c->kept[n]);
        for (int k = 0; k < 3; k++)
            mesh->triangles[n][k] = numbers[c->owners[mesh->triangles[n][k]]];
    }
    mesh->vertex_count = vertices;
    mesh->triangle_count = c->kept_count;
}

static int allocate(struct clustering *c)
{
    static const char what[] = "clusters";
    const uint64_t vertices = c->mesh->vertex_count, triangles = c->mesh->triangle_count;
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->cells));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->owners));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->euler));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->bad));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->positions));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->quadrics));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices, &c->sizes));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, triangles, &c->kept));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, vertices + 1, &c->first));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, 3 * triangles, &c->corners));
    BSQ_PASS(BSQ_ALLOC(c->ctx, what, triangles, &c->normals));
    return BSQ_ALLOC(c->ctx, what, vertices, &c->marks);
}

int vox_cluster(struct bsq_ctx *ctx, double share, struct vox_mesh *mesh)
{
    struct clustering c = {.ctx = ctx, .mesh = mesh};
    uint32_t kept;
    bool again = true;
    int status = 0;
    if (mesh->triangle_count == 0)
        return 0;
    BSQ_TRY(allocate(&c));
    BSQ_TRY(keep_borders(&c, &kept));
    number_cells(&c, share, kept);
    find_clusters(&c);
    join_small(&c);
    judge_clusters(&c);
    make_vertices(&c);
    dissolve(&c);
    for (int i = 0; i < ROUNDS_MAX && again; i++) {
        BSQ_TRY(bsq_check(ctx));
        keep_triangles(&c);
        set_normals(&c);
        judge_vertices(&c);
        again = dissolve(&c);
    }
    if (!again)
        compact(&c);
done:
    BSQ_FREE(ctx, c.marks, c.normals, c.corners, c.first, c.kept, c.sizes, c.quadrics, c.positions,
             c.bad, c.euler, c.owners, c.cells);
    return status;
}
