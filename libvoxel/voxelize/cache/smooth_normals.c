/* smooth_normals.c - sums the one-ring of each vertex of a chunk over all chunks that touch it.
 *
 * A chunk's border vertices also belong to its neighbours. Only scans that are coarse for the grid
 * need normals, so chunk files do not store them. Instead the neighbours, found by their bounds,
 * are read again and matched by position. */
#include "libvoxel/voxelize/cache/smooth_normals.h"

#include <math.h>
#include <pthread.h>
#include <string.h>

#include "base/geometry/positions.h"
#include "base/geometry/vec.h"

/* Memory of one call. */
struct workspace {
    uint8_t *memory; /* of all arrays */
    bool busy;
    struct bsq_positions table; /* of the chunk's vertices that need normals */
    uint32_t *own_rings; /* for each vertex of the chunk: the number of its one-ring, which is that
                            of the first vertex at its position */
    uint32_t *neighbour_rings; /* the same for the vertices of a neighbour; 0: none */
    double (*rings)[4];        /* one-rings by number; 0 is unused */
    int parts;                 /* of the one-rings */
    struct vox_creases creases;
    bool *candidates; /* for creases, by one-ring */
    void *scratch;    /* for a neighbour that is not lent */
};

struct vox_smooth {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    enum bsq_scan_normals weights;
    pthread_mutex_t lock;
    pthread_cond_t freed; /* a workspace became free */
    unsigned workspace_count;
    struct workspace *workspaces;
};

/* One-rings among which creases are looked for at a time. */
enum { CREASES = 4096 };

static uint32_t largest_vertex_count(const struct fmt_tris_file *file)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    uint64_t count = fmt_tris_get_header(file)->chunk_count;
    uint32_t largest = 1;
    for (uint64_t i = 0; i < count; i++)
        largest = infos[i].vertex_count > largest ? infos[i].vertex_count : largest;
    return largest;
}

/* Offsets of the arrays in a workspace's memory; the one-rings come first. */
struct layout {
    uint64_t seconds_at, creases_at, slots_at, own_at, neighbour_at, crease_of_at, candidates_at,
        scratch_at, bytes;
};

static struct layout smooth_lay_out(const struct fmt_tris_file *file)
{
    const uint64_t vertices = largest_vertex_count(file);
    const uint64_t numbers = bsq_align_up((vertices + 1) * sizeof(uint32_t), BSQ_ALIGNMENT);
    const uint64_t ring = sizeof(double[VOX_RING_ROWS][4]);
    struct layout to;
    to.seconds_at = bsq_align_up((vertices + 1) * ring, BSQ_ALIGNMENT);
    to.creases_at = to.seconds_at + (CREASES + 1) * ring;
    to.slots_at = bsq_align_up(to.creases_at + (CREASES + 1) * sizeof(double[4]), BSQ_ALIGNMENT);
    to.own_at =
        to.slots_at +
        bsq_align_up(bsq_positions_slots((uint32_t)vertices) * sizeof(uint32_t), BSQ_ALIGNMENT);
    to.neighbour_at = to.own_at + numbers;
    to.crease_of_at = to.neighbour_at + numbers;
    to.candidates_at = to.crease_of_at + numbers;
    to.scratch_at = to.candidates_at + bsq_align_up(vertices + 1, BSQ_ALIGNMENT);
    to.bytes = to.scratch_at + fmt_tris_load_size_max(file);
    return to;
}

static int make_workspace(struct bsq_ctx *ctx, const struct layout *at, struct workspace *w)
{
    int status = bsq_alloc(ctx, "smooth normals", at->bytes, 1, &w->memory);
    if (status < 0)
        return status;
    w->rings = (void *)w->memory;
    w->creases = (struct vox_creases){(void *)(w->memory + at->crease_of_at),
                                      (void *)(w->memory + at->creases_at),
                                      (void *)(w->memory + at->seconds_at)};
    w->table.slots = (void *)(w->memory + at->slots_at);
    w->own_rings = (void *)(w->memory + at->own_at);
    w->neighbour_rings = (void *)(w->memory + at->neighbour_at);
    w->candidates = (void *)(w->memory + at->candidates_at);
    w->scratch = w->memory + at->scratch_at;
    return 0;
}

int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      enum bsq_scan_normals weights, unsigned calls, uint64_t bytes,
                      struct vox_smooth **out)
{
    struct vox_smooth *s = NULL;
    const struct layout at = smooth_lay_out(file);
    const uint64_t most = bytes / (sizeof(struct workspace) + at.bytes);
    int status;
    *out = NULL;
    BSQ_TRY(bsq_calloc(ctx, "smooth normals", 1, sizeof *s, &s));
    *s = (struct vox_smooth){.ctx = ctx,
                             .file = file,
                             .weights = weights,
                             .lock = PTHREAD_MUTEX_INITIALIZER,
                             .freed = PTHREAD_COND_INITIALIZER,
                             .workspace_count = most < 1       ? 1
                                                : most < calls ? (unsigned)most
                                                               : calls};
    BSQ_TRY(bsq_calloc(ctx, "smooth normals", s->workspace_count, sizeof *s->workspaces,
                       &s->workspaces));
    for (unsigned i = 0; i < s->workspace_count; i++)
        BSQ_TRY(make_workspace(ctx, &at, &s->workspaces[i]));
    *out = s;
    return 0;
done:
    vox_smooth_destroy(s);
    return status;
}

void vox_smooth_destroy(struct vox_smooth *s)
{
    if (!s)
        return;
    for (unsigned i = 0; s->workspaces && i < s->workspace_count; i++)
        bsq_free(s->ctx, s->workspaces[i].memory);
    bsq_free(s->ctx, s->workspaces);
    bsq_free(s->ctx, s);
}

enum bsq_scan_normals vox_smooth_weights(const struct vox_smooth *smooth)
{
    return smooth->weights;
}

static struct workspace *take_workspace(struct vox_smooth *s)
{
    struct workspace *free_workspace = NULL;
    pthread_mutex_lock(&s->lock);
    while (!free_workspace) {
        for (unsigned i = 0; i < s->workspace_count && !free_workspace; i++)
            free_workspace = s->workspaces[i].busy ? NULL : &s->workspaces[i];
        if (!free_workspace)
            pthread_cond_wait(&s->freed, &s->lock);
    }
    free_workspace->busy = true;
    pthread_mutex_unlock(&s->lock);
    return free_workspace;
}

static void return_workspace(struct vox_smooth *s, struct workspace *workspace)
{
    pthread_mutex_lock(&s->lock);
    workspace->busy = false;
    pthread_cond_signal(&s->freed);
    pthread_mutex_unlock(&s->lock);
}

/* ---- runs of groups ---- */

/* Items of a chunk from begin to end. */
struct run {
    uint32_t begin, end;
};

/* Advances to the next run of groups that meet a box. Begin with a run that ends at 0. groups: of
 * `size` items; if groups or box are NULL, all items are one run. Returns false after the last one.
 */
static bool next_run(const struct vox_box *groups, const struct vox_box *box, uint32_t size,
                     uint32_t count, struct run *run)
{
    uint32_t begin = run->end, end = count;
    if (groups && box) {
        while (begin < count && !vox_boxes_meet(&groups[begin / size], box))
            begin = vox_group_end(begin, count, size);
        end = begin;
        while (end < count && vox_boxes_meet(&groups[end / size], box))
            end = vox_group_end(end, count, size);
    }
    *run = (struct run){begin, end};
    return begin < end;
}

static bool next_vertices(const struct vox_loan *of, const struct vox_box *box, struct run *run)
{
    return next_run(of->vertex_groups, box, VOX_GROUP_VERTICES, of->chunk->vertex_count, run);
}

static bool next_triangles(const struct vox_loan *of, const struct vox_box *box, struct run *run)
{
    return next_run(of->triangle_groups, box, VOX_GROUP_TRIANGLES, of->chunk->triangle_count, run);
}

/* ---- positions ---- */

/* Finds vertices at the same position. Most vertices find their slot of the table free, which
 * processors cannot predict. So the others are put off without a branch, in neighbour_rings, and
 * looked up after all first ones have slots. */
static void enter_vertices(struct workspace *d, const struct fmt_tris_chunk *chunk)
{
    uint32_t *late = d->neighbour_rings, late_count = 0;
    const uint64_t count = chunk->vertex_count;
    d->table.mask = bsq_positions_slots(count) - 1;
    memset(d->rings, 0, (count + 1) * VOX_RING_ROWS * sizeof *d->rings);
    memset(d->table.slots, 0, ((uint64_t)d->table.mask + 1) * sizeof *d->table.slots);
    for (uint32_t v = 0; v < count; v++) {
        uint32_t *slot = &d->table.slots[bsq_position_hash(chunk->positions[v]) & d->table.mask];
        uint32_t taken = *slot != 0;
        *slot = taken ? *slot : v + 1;
        d->own_rings[v] = v + 1;
        late[late_count] = v;
        late_count += taken;
    }
    for (uint32_t i = 0; i < late_count; i++) {
        uint32_t v = late[i], *slot = bsq_positions_find(&d->table, chunk->positions[v]);
        if (*slot == 0)
            *slot = v + 1;
        d->own_rings[v] = *slot;
    }
}

/* ---- sums ----
 *
 * One-rings are summed over all triangles. To find creases, all triangles near some of them are
 * gone through again, and near those that are creases once more. */

enum step { STEP_SUM, STEP_FARTHEST, STEP_SIDES };

/* A step of the sums of a chunk. */
struct sums {
    const struct vox_smooth *smooth;
    const struct vox_smooth_lender *lender;
    const struct vox_smooth_chunk *of;
    struct workspace *d;
    enum step step;
    float min[3], max[3]; /* bounds of the vertices that matter */
    struct vox_box box;   /* voxels of these bounds */
};

static bool smooth_touches(const struct fmt_tris_chunk_info *info, const struct sums *n)
{
    bool yes = true;
    for (int k = 0; k < 3; k++)
        yes = yes && info->bounds_min[k] <= n->max[k] && n->min[k] <= info->bounds_max[k];
    return yes;
}

/* Finds a neighbour's vertices among those of the chunk. Vertices at the same position lie in the
 * same voxel. */
static bool smooth_match(const struct sums *n, const struct vox_loan *loan)
{
    const struct fmt_tris_chunk *chunk = loan->chunk;
    uint32_t *rings = n->d->neighbour_rings;
    struct run run = {0, 0};
    bool any = false, more = next_vertices(loan, &n->box, &run);
    if (more)
        memset(rings, 0, chunk->vertex_count * sizeof *rings);
    for (; more; more = next_vertices(loan, &n->box, &run))
        any |= bsq_positions_match(&n->d->table, n->min, n->max, chunk->positions + run.begin,
                                   run.end - run.begin, rings + run.begin);
    return any;
}

/* Does the step for triangles that meet a box. ring_of: of the chunk's vertices. */
static void smooth_add_triangles(const struct sums *n, const struct vox_loan *of,
                                 const struct vox_box *box, const uint32_t *ring_of)
{
    vox_add_one_rings_fn *const add = BSQ_SIMD_PICK(bsq_simd_best(), vox_add_one_rings);
    vox_divide_one_rings_fn *const divide = BSQ_SIMD_PICK(bsq_simd_best(), vox_divide_one_rings);
    const struct workspace *d = n->d;
    for (struct run run = {0, 0}; next_triangles(of, box, &run);)
        if (n->step == STEP_SUM)
            add(of->chunk, run.begin, run.end, ring_of, n->smooth->weights, d->rings);
        else
            divide(of->chunk, run.begin, run.end, ring_of, n->step == STEP_SIDES, d->rings,
                   &d->creases);
}

static int smooth_add_chunk(const struct sums *n, uint32_t other)
{
    struct fmt_tris_chunk own = {0};
    struct vox_loan loan;
    int status = n->lender->lend(n->lender->arg, other, &loan);
    const bool lent = loan.chunk != NULL;
    if (status == 0 && !lent)
        status = fmt_tris_load(n->smooth->file, other, n->d->scratch, &own);
    if (status < 0)
        return status;
    if (!lent)
        loan = (struct vox_loan){.chunk = &own};
    if (loan.chunk->positions && smooth_match(n, &loan))
        smooth_add_triangles(n, &loan, &n->box, n->d->neighbour_rings);
    if (lent)
        n->lender->take_back(n->lender->arg, other);
    return 0;
}

/* Does a step for the triangles of all chunks, in the order of the file. */
static int visit_chunks(const struct sums *n)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(n->smooth->file);
    const uint32_t count = (uint32_t)fmt_tris_get_header(n->smooth->file)->chunk_count;
    int status = 0;
    for (uint32_t i = 0; i < count && status == 0; i++) {
        if (i == n->of->index)
            smooth_add_triangles(n, &n->of->decoded, n->step == STEP_SUM ? NULL : &n->box,
                                 n->d->own_rings);
        else if (smooth_touches(&infos[i], n))
            status = smooth_add_chunk(n, i);
    }
    return status;
}

/* ---- creases ---- */

/* A packed second side is an integer below 2^53, scaled: 1 and the normal's 32 bits, above them the
 * height's upper bits. */
enum { HEIGHT_BITS = 20, NORMAL_BITS = 32 };
#define PACKED_SCALE 0x1p-60

double vox_second_pack(const float second[4])
{
    uint32_t height;
    if (second[0] == 0.0f && second[1] == 0.0f && second[2] == 0.0f)
        return 0.0;
    memcpy(&height, &second[3], sizeof height);
    const uint64_t high = height >> (32 - HEIGHT_BITS);
    const uint64_t low = bsq_oct_pack((struct bsq_vec3){second[0], second[1], second[2]});
    return (double)((high << NORMAL_BITS) + low + 1) * PACKED_SCALE;
}

void vox_second_unpack(double packed, float second[4])
{
    if (packed == 0.0) {
        memset(second, 0, 4 * sizeof *second);
        return;
    }
    const uint64_t both = (uint64_t)(packed / PACKED_SCALE) - 1;
    const uint32_t height = (uint32_t)(both >> NORMAL_BITS) << (32 - HEIGHT_BITS);
    const struct bsq_vec3 normal = bsq_oct_unpack((uint32_t)both);
    memcpy(second, (const float[3]){normal.x, normal.y, normal.z}, 3 * sizeof *second);
    memcpy(&second[3], &height, sizeof height);
}

/* Finds the one-rings at corners of large triangles. */
static void smooth_find_candidates(const struct sums *n, float extent)
{
    const struct fmt_tris_chunk *chunk = n->of->decoded.chunk;
    bool *candidates = n->d->candidates;
    memset(candidates, extent < 0.0f, (chunk->vertex_count + UINT64_C(1)) * sizeof *candidates);
    for (uint32_t t = 0; t < chunk->triangle_count && extent >= 0.0f; t++) {
        const uint32_t *v = chunk->triangles[t];
        const float *a = chunk->positions[v[0]], *b = chunk->positions[v[1]],
                    *c = chunk->positions[v[2]];
        float most = 0.0f;
        for (int k = 0; k < 3; k++)
            most = fmaxf(most, fmaxf(fmaxf(a[k], b[k]), c[k]) - fminf(fminf(a[k], b[k]), c[k]));
        for (int i = 0; i < 3 && most > extent; i++)
            candidates[n->d->own_rings[v[i]]] = true;
    }
}

/* Consecutive vertices; candidates that are the first at their position have numbered one-rings. */
struct batch {
    uint32_t begin, end, creases;
};

static bool is_first(const struct workspace *d, uint32_t vertex)
{
    return d->own_rings[vertex] == vertex + 1;
}

/* Numbers the next one-rings, and finds their bounds. Returns false if there are no more. */
static bool next_batch(struct sums *n, const struct vox_transform *transform, struct batch *batch)
{
    const struct fmt_tris_chunk *chunk = n->of->decoded.chunk;
    const struct vox_creases *c = &n->d->creases;
    uint32_t v = batch->end, count = 0;
    for (int k = 0; k < 3; k++) {
        n->min[k] = INFINITY;
        n->max[k] = -INFINITY;
    }
    for (; v < chunk->vertex_count && count < CREASES; v++) {
        if (!is_first(n->d, v) || !n->d->candidates[v + 1])
            continue;
        c->crease_of[v + 1] = ++count;
        memcpy(c->creases[count], (const double[4]){[3] = INFINITY}, sizeof *c->creases);
        for (int k = 0; k < 3; k++) {
            n->min[k] = fminf(n->min[k], chunk->positions[v][k]);
            n->max[k] = fmaxf(n->max[k], chunk->positions[v][k]);
        }
    }
    *batch = (struct batch){batch->end, v, count};
    if (count > 0)
        n->box = vox_transform_box(transform, n->min, n->max);
    return count > 0;
}

/* Divides one-rings, and prepares the sums of second sides. Returns whether there are any. */
static bool smooth_divide_rings(const struct sums *n, const struct batch *batch)
{
    const struct vox_creases *c = &n->d->creases;
    bool any = false;
    for (uint64_t ring = batch->begin + UINT64_C(1); ring <= batch->end; ring++) {
        uint32_t *crease = &c->crease_of[ring];
        if (*crease != 0 && !bsq_divide_ring(&n->d->rings[ring * VOX_RING_ROWS], VOX_RING_PARTS,
                                             c->creases[*crease]))
            *crease = 0;
        any |= *crease != 0;
    }
    memset(c->seconds, 0, (batch->creases + UINT64_C(1)) * VOX_RING_ROWS * sizeof *c->seconds);
    return any;
}

/* Sets the normals of both sides of a batch's creases. */
static void finish_creases(const struct sums *n, const struct batch *batch, double h,
                           float (*normals)[4], double (*points)[4])
{
    vox_finish_one_rings_fn *const finish = BSQ_SIMD_PICK(bsq_simd_best(), vox_finish_one_rings);
    const struct vox_creases *c = &n->d->creases;
    for (uint32_t v = batch->begin; v < batch->end; v++) {
        const uint32_t ring = v + 1, crease = c->crease_of[ring];
        float second[4];
        if (crease == 0)
            continue;
        finish((const double(*)[4])n->d->rings, &ring, 1, h, &normals[v]);
        finish((const double(*)[4])c->seconds, &crease, 1, h, &second);
        points[v][3] = vox_second_pack(second);
    }
}

/* Gives both sides of each crease of the chunk a normal. */
static int find_creases(struct sums *n, const struct vox_transform *transform, float (*normals)[4],
                        double (*points)[4], bool *has_seconds)
{
    const uint64_t count = n->of->decoded.chunk->vertex_count;
    uint32_t *crease_of = n->d->creases.crease_of;
    int status = 0;
    memset(crease_of, 0, (count + 1) * sizeof *crease_of);
    smooth_find_candidates(n, n->of->crease_extent);
    for (struct batch batch = {0}; next_batch(n, transform, &batch);) {
        n->step = STEP_FARTHEST;
        BSQ_TRY(visit_chunks(n));
        if (smooth_divide_rings(n, &batch)) {
            n->step = STEP_SIDES;
            BSQ_TRY(visit_chunks(n));
            finish_creases(n, &batch, transform->h, normals, points);
            *has_seconds = true;
        }
        memset(&crease_of[batch.begin + 1], 0, (batch.end - batch.begin) * sizeof *crease_of);
    }
    for (uint32_t v = 0; v < count && *has_seconds; v++)
        if (!is_first(n->d, v)) {
            const uint32_t first = n->d->own_rings[v] - 1;
            memcpy(normals[v], normals[first], sizeof *normals);
            points[v][3] = points[first][3];
        }
done:
    return status;
}

static int make_normals(struct sums *n, const struct vox_transform *transform, float (*normals)[4],
                        double (*points)[4], bool *has_seconds)
{
    const struct fmt_tris_chunk *chunk = n->of->decoded.chunk;
    int status = 0;
    n->d->table.positions = chunk->positions;
    enter_vertices(n->d, chunk);
    BSQ_TRY(visit_chunks(n));
    BSQ_SIMD_PICK(bsq_simd_best(), vox_finish_one_rings)
    ((const double(*)[4])n->d->rings, n->d->own_rings, chunk->vertex_count, transform->h, normals);
    if (isfinite(n->of->crease_extent))
        BSQ_TRY(find_creases(n, transform, normals, points, has_seconds));
done:
    return status;
}

int vox_smooth_normals(struct vox_smooth *s, const struct vox_smooth_lender *lender,
                       const struct vox_smooth_chunk *chunk, const struct vox_transform *transform,
                       float (*normals)[4], double (*points)[4], bool *has_seconds)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(s->file)[chunk->index];
    struct sums sums = {.smooth = s,
                        .lender = lender,
                        .of = chunk,
                        .d = take_workspace(s),
                        .box = vox_transform_box(transform, info->bounds_min, info->bounds_max)};
    memcpy(sums.min, info->bounds_min, sizeof sums.min);
    memcpy(sums.max, info->bounds_max, sizeof sums.max);
    *has_seconds = false;
    int status = make_normals(&sums, transform, normals, points, has_seconds);
    return_workspace(s, sums.d);
    return status;
}
