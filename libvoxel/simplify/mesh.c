/* mesh.c - see mesh.h. */
#include "libvoxel/simplify/mesh.h"

#include <math.h>
#include <string.h>

#include "base/geometry/positions.h"
#include "base/sort_array.h"
#include "base/geometry/vec.h"

/* Adds the quadric of another vertex at the same position. */
static void add_quadric(struct vox_quadric *q, const struct vox_quadric *other)
{
    for (int i = 0; i < 6; i++)
        q->a[i] += other->a[i];
    for (int k = 0; k < 3; k++)
        q->b[k] += other->b[k];
    q->c += other->c;
}

void vox_quadric_shift(const struct vox_quadric *q, const double s[3], double a[6], double b[3],
                       double *c)
{
    double as[3];
    for (int i = 0; i < 6; i++)
        a[i] = (double)q->a[i];
    as[0] = a[0] * s[0] + a[1] * s[1] + a[2] * s[2];
    as[1] = a[1] * s[0] + a[3] * s[1] + a[4] * s[2];
    as[2] = a[2] * s[0] + a[4] * s[1] + a[5] * s[2];
    *c = (double)q->c + bsq_dotd(s, as);
    for (int k = 0; k < 3; k++) {
        *c += 2 * (double)q->b[k] * s[k];
        b[k] = (double)q->b[k] + as[k];
    }
}

bool vox_solve(const double a[6], const double b[3], double x[3])
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

/* The planes of a vertex's triangles go through it, so b and c are 0. */
void vox_mesh_set_quadrics(struct vox_mesh *mesh)
{
    static const int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
    memset(mesh->quadrics, 0, mesh->vertex_count * sizeof *mesh->quadrics);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        double n[3];
        vox_triangle_normal((const float(*)[3])mesh->positions, mesh->triangles[t], n);
        const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int i = 0; i < 6 && length > 0; i++) {
            const float a = (float)(0.5 / length * n[row[i]] * n[column[i]]);
            for (int k = 0; k < 3; k++)
                mesh->quadrics[mesh->triangles[t][k]].a[i] += a;
        }
    }
}

int vox_mesh_allocate(struct bsq_ctx *ctx, uint32_t vertices, uint32_t triangles, bool quadrics,
                      struct vox_mesh *mesh)
{
    int status = 0;
    *mesh = (struct vox_mesh){.vertex_count = vertices, .triangle_count = triangles};
    BSQ_TRY(BSQ_ALLOC(ctx, "a mesh", vertices, &mesh->positions));
    BSQ_TRY(BSQ_ALLOC(ctx, "a mesh", triangles, &mesh->triangles));
    if (quadrics)
        BSQ_TRY(BSQ_ALLOC(ctx, "a mesh", vertices, &mesh->quadrics));
done:
    if (status < 0)
        vox_mesh_free(ctx, mesh);
    return status;
}

int vox_mesh_copy(struct bsq_ctx *ctx, const struct vox_mesh *from, uint32_t more,
                  struct vox_mesh *to)
{
    BSQ_PASS(vox_mesh_allocate(ctx, from->vertex_count, from->triangle_count + more, false, to));
    memcpy(to->positions, from->positions, from->vertex_count * sizeof *to->positions);
    memcpy(to->triangles, from->triangles, from->triangle_count * sizeof *to->triangles);
    return 0;
}

void vox_mesh_free(struct bsq_ctx *ctx, struct vox_mesh *mesh)
{
    BSQ_FREE(ctx, mesh->positions, mesh->triangles, mesh->quadrics);
    *mesh = (struct vox_mesh){0};
}

void vox_mesh_move_triangle(struct vox_mesh *mesh, uint32_t to, uint32_t from)
{
    memmove(mesh->triangles[to], mesh->triangles[from], sizeof *mesh->triangles);
}

/* Numbers positions in the order of their first vertices; moves these together. */
static void join_vertices(struct vox_mesh *mesh, struct bsq_positions *table, uint32_t *numbers)
{
    uint32_t count = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        uint32_t *cell = bsq_positions_find(table, mesh->positions[v]);
        if (*cell == 0) {
            memmove(mesh->positions[count], mesh->positions[v], sizeof *mesh->positions);
            if (mesh->quadrics)
                mesh->quadrics[count] = mesh->quadrics[v];
            *cell = ++count;
        } else if (mesh->quadrics) {
            add_quadric(&mesh->quadrics[*cell - 1], &mesh->quadrics[v]);
        }
        numbers[v] = *cell - 1;
    }
    mesh->vertex_count = count;
}

/* Returns the chain of a triangle: the mean of its corners, as a vertex may be in all triangles. */
static uint32_t chain_of(const uint32_t corners[3])
{
    return (uint32_t)(((uint64_t)corners[0] + corners[1] + corners[2]) / 3);
}

/* Returns whether a triangle before `count` has the same corners, in any order. */
static bool is_repeated(const struct vox_mesh *mesh, const uint32_t *first, const uint32_t *next,
                        const uint32_t corners[3])
{
    for (uint32_t t = first[chain_of(corners)]; t != UINT32_MAX; t = next[t]) {
        unsigned same = 0;
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                same += mesh->triangles[t][i] == corners[k];
        if (same == 3)
            return true;
    }
    return false;
}

/* Leaves triangles out that have no three corners or that are there already. first: of chains, the
 * last triangle; next: the one before that. */
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
        uint32_t *chain = &first[chain_of(corners)];
        next[count] = *chain;
        *chain = count;
        vox_mesh_move_triangle(mesh, count, t);
        memcpy(mesh->triangles[count++], corners, sizeof corners);
    }
    mesh->triangle_count = count;
}

int vox_mesh_weld(struct bsq_ctx *ctx, struct vox_mesh *mesh)
{
    struct bsq_positions table = {.positions = (const float(*)[3])mesh->positions};
    uint32_t *numbers = NULL, *first = NULL, *next = NULL;
    const uint32_t cells = bsq_positions_cells(mesh->vertex_count);
    int status = 0;
    table.mask = cells - 1;
    BSQ_TRY(BSQ_CALLOC(ctx, "welding a mesh", cells, &table.cells));
    BSQ_TRY(BSQ_ALLOC(ctx, "welding a mesh", mesh->vertex_count, &numbers));
    BSQ_TRY(BSQ_ALLOC(ctx, "welding a mesh", mesh->vertex_count, &first));
    BSQ_TRY(BSQ_ALLOC(ctx, "welding a mesh", mesh->triangle_count, &next));
    join_vertices(mesh, &table, numbers);
    join_triangles(mesh, numbers, first, next);
done:
    BSQ_FREE(ctx, next, first, numbers, table.cells);
    return status;
}

/* ---- slits ---- */

/* A side of a triangle, with its ends. */
struct side {
    uint32_t from, to, triangle;
};

static int compare_sides(const void *a_, const void *b_)
{
    const struct side *a = a_, *b = b_;
    if (a->from != b->from)
        return a->from < b->from ? -1 : 1;
    return a->to < b->to ? -1 : a->to > b->to;
}

/* Returns the first side that does not come before (from, to). */
static const struct side *find_side(const struct side *sides, uint32_t count, uint32_t from,
                                    uint32_t to)
{
    const struct side wanted = {from, to, 0};
    uint32_t low = 0, high = count;
    while (low < high) {
        const uint32_t middle = low + (high - low) / 2;
        if (compare_sides(&sides[middle], &wanted) < 0)
            low = middle + 1;
        else
            high = middle;
    }
    return &sides[low];
}

static bool has_side(const struct side *sides, uint32_t count, uint32_t from, uint32_t to)
{
    const struct side *found = find_side(sides, count, from, to);
    return found < sides + count && found->from == from && found->to == to;
}

/* Sorts the sides that have no other one in their place. Returns how many there are. */
static uint32_t find_open_sides(const struct vox_mesh *mesh, const int64_t *sums,
                                struct side *sides, struct side *open)
{
    uint32_t count = 0, open_count = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            const uint32_t from = mesh->triangles[t][k], to = mesh->triangles[t][(k + 1) % 3];
            if (sums[from] != 0 && sums[to] != 0)
                sides[count++] = (struct side){from, to, t};
        }
    bsq_sort(sides, count, sizeof *sides, compare_sides);
    for (uint32_t i = 0; i < count; i++)
        if (!has_side(sides, count, sides[i].to, sides[i].from))
            open[open_count++] = sides[i];
    return open_count;
}

/* Finds triangles without area that open sides enclose. Returns how many there are. */
static uint32_t find_slits(const struct vox_mesh *mesh, const struct side *open, uint32_t count,
                           struct side *slits, uint32_t *thirds)
{
    uint32_t slit_count = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t a = open[i].from, b = open[i].to;
        const struct side *next = find_side(open, count, b, 0);
        for (; next < open + count && next->from == b; next++) {
            const uint32_t corners[3] = {a, b, next->to};
            double n[3];
            if (a > b || a > next->to || !has_side(open, count, next->to, a))
                continue; /* each once */
            vox_triangle_normal((const float(*)[3])mesh->positions, corners, n);
            if (n[0] != 0 || n[1] != 0 || n[2] != 0)
                continue;
            thirds[slit_count] = next->to;
            slits[slit_count++] = open[i];
            break;
        }
    }
    return slit_count;
}

static int add_slits(struct bsq_ctx *ctx, struct vox_mesh *mesh, const struct side *slits,
                     const uint32_t *thirds, uint32_t count)
{
    struct vox_mesh wider;
    const uint32_t before = mesh->triangle_count;
    BSQ_PASS(vox_mesh_copy(ctx, mesh, count, &wider));
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t corners[3] = {slits[i].to, slits[i].from, thirds[i]};
        memcpy(wider.triangles[before + i], corners, sizeof corners);
    }
    vox_mesh_free(ctx, mesh);
    *mesh = wider;
    return 0;
}

int vox_mesh_close_slits(struct bsq_ctx *ctx, struct vox_mesh *mesh)
{
    static const char what[] = "slits of a mesh";
    uint64_t count = 1;
    struct side *sides = NULL, *open = NULL, *slits = NULL;
    int64_t *sums = NULL; /* of vertices: their neighbours' squares, after less before */
    uint32_t *thirds = NULL;
    int status = 0;
    BSQ_TRY(BSQ_CALLOC(ctx, what, mesh->vertex_count + 1U, &sums));
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            const int64_t after = mesh->triangles[t][(k + 1) % 3],
                          before = mesh->triangles[t][(k + 2) % 3];
            sums[mesh->triangles[t][k]] += after * after - before * before;
        }
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            count += sums[mesh->triangles[t][k]] != 0 && sums[mesh->triangles[t][(k + 1) % 3]] != 0;
    BSQ_TRY(BSQ_ALLOC(ctx, what, count, &sides));
    BSQ_TRY(BSQ_ALLOC(ctx, what, count, &open));
    const uint32_t open_count = find_open_sides(mesh, sums, sides, open);
    BSQ_TRY(BSQ_ALLOC(ctx, what, open_count + 1U, &slits));
    BSQ_TRY(BSQ_ALLOC(ctx, what, open_count + 1U, &thirds));
    const uint32_t slit_count = find_slits(mesh, open, open_count, slits, thirds);
    if (slit_count > 0)
        status = add_slits(ctx, mesh, slits, thirds, slit_count);
done:
    BSQ_FREE(ctx, thirds, slits, open, sides, sums);
    return status;
}
