/* tris_weld.c - joins the vertices that parts with different origins share.
 *
 * Each part rounds a vertex to float32 relative to its own origin, so the same vertex of a mesh
 * that was cut may differ in its last bits. Who matches vertices by position would then see a seam.
 * So each vertex of a part takes the position of the nearest vertex of earlier parts, if there is
 * one within what rounding explains. Only chunks whose bounds meet chunks of earlier parts are
 * loaded, and only vertices that move are kept. */
#include "formats/chunks/tris_internal.h"

#include <float.h>
#include <math.h>

#include "base/geometry/positions.h"

/* Vertices of one chunk by cell: a grid whose cells are as large as four times the tolerance. A
 * vertex and those within the tolerance of it are in at most eight cells. */
struct cells {
    struct bsq_positions table; /* of the cells; its positions are numbers of cells */
    float (*numbers)[3];
    float (*positions)[3]; /* of vertices, each position once */
    uint32_t *next;        /* vertex in the same cell + 1; 0: none */
    uint32_t count;
};

struct welding {
    struct fmt_tris_file *all;
    const struct tris_part *part;
    uint64_t chunk; /* the chunk whose vertices move */
    double tolerance[3];
    struct fmt_tris_chunk own, other; /* loaded */
    void *own_scratch, *other_scratch;
    struct cells cells;  /* of the other chunk */
    float (*nearest)[3]; /* for each own vertex: the nearest vertex so far */
    double *distances;   /* its squared distance in tolerances; INFINITY: none */
};

/* ---- tolerances ---- */

/* Returns the distance from a number to the next one as float32. */
static double spacing(float value)
{
    const float size = fabsf(value);
    return size < FLT_MAX ? (double)nextafterf(size, FLT_MAX) - size : (double)FLT_MAX;
}

/* Returns how much rounding may have moved a part's vertices along an axis: when the part was
 * sorted, and when it gets the common origin. */
static double rounding(const struct tris_part *part, int axis)
{
    const struct fmt_tris_header *header = &part->file->header;
    const float low = header->bounds_min[axis], high = header->bounds_max[axis];
    const float own = fmaxf(fabsf(low), fabsf(high));
    const double moved = fmax(fabs(low + part->shift[axis]), fabs(high + part->shift[axis]));
    return 0.5 * spacing(own) + 0.5 * spacing((float)moved);
}

/* Sets the tolerances: twice what rounding explains, because a vertex may be compared with one that
 * has been moved. */
static void set_tolerances(struct welding *w, const struct tris_part *other)
{
    for (int axis = 0; axis < 3; axis++)
        w->tolerance[axis] =
            fmax(2.0 * (rounding(w->part, axis) + rounding(other, axis)), (double)FLT_MIN);
}

/* Returns whether vertices of a chunk may be within the tolerance of those of the own chunk. */
static bool weld_touches(const struct welding *w, const struct fmt_tris_chunk_info *other)
{
    const struct fmt_tris_chunk_info *own = &w->all->chunks[w->chunk];
    bool yes = true;
    for (int axis = 0; axis < 3; axis++)
        yes = yes && own->bounds_min[axis] - w->tolerance[axis] <= other->bounds_max[axis] &&
              other->bounds_min[axis] <= own->bounds_max[axis] + w->tolerance[axis];
    return yes;
}

/* ---- cells ---- */

/* Computes the cell of a position that is moved by `sign` tolerances on the axes of `mask`. Large
 * numbers of cells are rounded, alike for all vertices near each other. */
static void weld_cell_of(const struct welding *w, const float p[3], unsigned mask, float cell[3])
{
    for (int axis = 0; axis < 3; axis++) {
        const double sign = mask >> axis & 1 ? 1.0 : -1.0;
        cell[axis] =
            (float)floor((p[axis] + sign * w->tolerance[axis]) / (4.0 * w->tolerance[axis]));
    }
}

/* Computes the cell of a position. */
static void own_cell(const struct welding *w, const float p[3], float cell[3])
{
    for (int axis = 0; axis < 3; axis++)
        cell[axis] = (float)floor(p[axis] / (4.0 * w->tolerance[axis]));
}

static bool weld_is_same(const float a[3], const float b[3])
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

static void add_to_cells(const struct welding *w, struct cells *c, const float p[3])
{
    float cell[3];
    own_cell(w, p, cell);
    uint32_t *slot = bsq_positions_find(&c->table, cell);
    for (uint32_t v = *slot; v != 0; v = c->next[v - 1])
        if (weld_is_same(c->positions[v - 1], p))
            return;
    memcpy(c->numbers[c->count], cell, sizeof cell);
    memcpy(c->positions[c->count], p, sizeof *c->positions);
    c->next[c->count] = *slot;
    *slot = ++c->count;
}

/* Enters the vertices of the other chunk that may be near the own one. */
static void fill_cells(struct welding *w)
{
    struct cells *c = &w->cells;
    c->count = 0;
    memset(c->table.slots, 0, ((uint64_t)c->table.mask + 1) * sizeof *c->table.slots);
    for (uint32_t v = 0; v < w->other.vertex_count; v++) {
        const float *p = w->other.positions[v];
        const struct fmt_tris_chunk_info point = {.bounds_min = {p[0], p[1], p[2]},
                                                  .bounds_max = {p[0], p[1], p[2]}};
        if (weld_touches(w, &point))
            add_to_cells(w, c, p);
    }
}

/* ---- matching ---- */

/* Orders positions of equal distance, so that chunks with the same vertex choose the same one. */
static bool is_less(const float a[3], const float b[3])
{
    for (int axis = 0; axis < 3; axis++)
        if (a[axis] != b[axis])
            return a[axis] < b[axis];
    return false;
}

/* Compares an own vertex with the vertices of a cell. */
static void match_cell(const struct welding *w, uint32_t vertex, const float cell[3])
{
    const struct cells *c = &w->cells;
    const float *own = w->own.positions[vertex];
    for (uint32_t v = *bsq_positions_find(&c->table, cell); v != 0; v = c->next[v - 1]) {
        const float *other = c->positions[v - 1];
        double distance = 0.0;
        bool near = true;
        for (int axis = 0; axis < 3; axis++) {
            const double d = ((double)other[axis] - own[axis]) / w->tolerance[axis];
            near = near && fabs(d) <= 1.0;
            distance += d * d;
        }
        if (near && (distance < w->distances[vertex] ||
                     (distance <= w->distances[vertex] && is_less(other, w->nearest[vertex])))) {
            w->distances[vertex] = distance;
            memcpy(w->nearest[vertex], other, sizeof *w->nearest);
        }
    }
}

/* Compares an own vertex with those of the cells that its neighbourhood meets. */
static void match_vertex(const struct welding *w, uint32_t vertex)
{
    float before[8][3];
    for (unsigned mask = 0; mask < 8; mask++) {
        bool again = false;
        weld_cell_of(w, w->own.positions[vertex], mask, before[mask]);
        for (unsigned k = 0; k < mask; k++)
            again |= weld_is_same(before[k], before[mask]);
        if (!again)
            match_cell(w, vertex, before[mask]);
    }
}

static int load_own(struct welding *w)
{
    int status = fmt_tris_load_part(w->all, w->chunk, w->own_scratch, &w->own, NULL);
    for (uint32_t v = 0; status == 0 && v < w->own.vertex_count; v++)
        w->distances[v] = INFINITY;
    return status;
}

/* Compares the chunk with all chunks of a part. */
static int match_part(struct welding *w, const struct tris_part *other)
{
    int status = 0;
    set_tolerances(w, other);
    for (uint64_t i = 0; i < other->file->header.chunk_count; i++) {
        const uint64_t number = other->first_chunk + i;
        if (!weld_touches(w, &w->all->chunks[number]))
            continue;
        BSQ_TRY(w->own.vertex_count == 0 ? load_own(w) : 0);
        BSQ_TRY(fmt_tris_load_part(w->all, number, w->other_scratch, &w->other, NULL));
        fill_cells(w);
        for (uint32_t v = 0; v < w->own.vertex_count; v++) {
            match_vertex(w, v);
            BSQ_TRY(v % 4096 == 0 ? bsq_check(w->all->ctx) : 0);
        }
    }
done:
    return status;
}

/* ---- results ---- */

static void widen(float min[3], float max[3], const float p[3])
{
    for (int axis = 0; axis < 3; axis++) {
        min[axis] = fminf(min[axis], p[axis]);
        max[axis] = fmaxf(max[axis], p[axis]);
    }
}

/* Keeps the vertices that move. */
static int weld_keep(const struct welding *w)
{
    struct fmt_tris_file *all = w->all;
    struct fmt_tris_chunk_info *info = &all->chunks[w->chunk];
    for (uint32_t v = 0; v < w->own.vertex_count; v++) {
        if (isinf(w->distances[v]) || w->distances[v] <= 0.0)
            continue;
        int status = bsq_grow(all->ctx, "vertices of several parts", all->weld_count + 1,
                              sizeof *all->welds, &all->welds, &all->weld_capacity);
        if (status < 0)
            return status;
        struct tris_weld *weld = &all->welds[all->weld_count++];
        *weld = (struct tris_weld){.chunk = w->chunk, .vertex = v};
        memcpy(weld->position, w->nearest[v], sizeof weld->position);
        widen(info->bounds_min, info->bounds_max, weld->position);
        widen(all->header.bounds_min, all->header.bounds_max, weld->position);
    }
    return 0;
}

static int weld_part(struct welding *w, uint32_t number)
{
    int status = 0;
    w->part = &w->all->parts[number];
    for (uint64_t i = 0; i < w->part->file->header.chunk_count; i++) {
        w->chunk = w->part->first_chunk + i;
        w->own.vertex_count = 0;
        for (uint32_t k = 0; k < number; k++)
            BSQ_TRY(match_part(w, &w->all->parts[k]));
        BSQ_TRY(weld_keep(w));
    }
done:
    return status;
}

static bool origins_differ(const struct fmt_tris_file *all)
{
    bool differ = false;
    for (uint32_t i = 0; i < all->part_count; i++)
        for (int axis = 0; axis < 3; axis++)
            differ |= all->parts[i].shift[axis] != 0.0;
    return differ;
}

static int weld_allocate(struct welding *w)
{
    struct bsq_ctx *ctx = w->all->ctx;
    struct cells *c = &w->cells;
    const char *what = "vertices of several parts";
    uint32_t most = 1;
    for (uint64_t i = 0; i < w->all->header.chunk_count; i++)
        most = w->all->chunks[i].vertex_count > most ? w->all->chunks[i].vertex_count : most;
    const uint32_t slots = bsq_positions_slots(most);
    int status;
    c->table.mask = slots - 1;
    BSQ_TRY(bsq_alloc(ctx, what, w->all->load_size_max + 1, 1, &w->own_scratch));
    BSQ_TRY(bsq_alloc(ctx, what, w->all->load_size_max + 1, 1, &w->other_scratch));
    BSQ_TRY(bsq_alloc(ctx, what, slots, sizeof *c->table.slots, &c->table.slots));
    BSQ_TRY(bsq_alloc(ctx, what, most, sizeof *c->numbers, &c->numbers));
    BSQ_TRY(bsq_alloc(ctx, what, most, sizeof *c->positions, &c->positions));
    BSQ_TRY(bsq_alloc(ctx, what, most, sizeof *c->next, &c->next));
    BSQ_TRY(bsq_alloc(ctx, what, most, sizeof *w->nearest, &w->nearest));
    BSQ_TRY(bsq_alloc(ctx, what, most, sizeof *w->distances, &w->distances));
    c->table.positions = (const float(*)[3])c->numbers;
done:
    return status;
}

int fmt_tris_weld_parts(struct fmt_tris_file *all)
{
    struct welding w = {.all = all};
    int status;
    if (!origins_differ(all))
        return 0;
    BSQ_TRY(weld_allocate(&w));
    for (uint32_t i = 1; i < all->part_count; i++)
        BSQ_TRY(weld_part(&w, i));
done:
    bsq_free(all->ctx, w.own_scratch);
    bsq_free(all->ctx, w.other_scratch);
    bsq_free(all->ctx, w.cells.table.slots);
    bsq_free(all->ctx, w.cells.numbers);
    bsq_free(all->ctx, w.cells.positions);
    bsq_free(all->ctx, w.cells.next);
    bsq_free(all->ctx, w.nearest);
    bsq_free(all->ctx, w.distances);
    return status;
}

/* ---- loading ---- */

void fmt_tris_apply_welds(const struct fmt_tris_file *all, uint64_t chunk, float (*positions)[3])
{
    uint64_t low = 0, high = all->weld_count;
    while (low < high) {
        const uint64_t middle = low + (high - low) / 2;
        if (all->welds[middle].chunk < chunk)
            low = middle + 1;
        else
            high = middle;
    }
    for (; low < all->weld_count && all->welds[low].chunk == chunk; low++)
        memcpy(positions[all->welds[low].vertex], all->welds[low].position, sizeof *positions);
}
