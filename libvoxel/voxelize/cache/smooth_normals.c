/* smooth_normals.c - sums the one-ring of each vertex of a chunk over all chunks that touch it.
 *
 * A chunk's border vertices also belong to its neighbours. Only scans that are coarse for the grid
 * need normals, so chunk files do not store them. Instead the neighbours, found by their bounds,
 * are read again and matched by position. */
#include "libvoxel/voxelize/cache/smooth_normals.h"

#include <pthread.h>
#include <string.h>

#include "base/positions.h"

/* Memory of one call. */
struct workspace {
    uint8_t *memory; /* of all arrays */
    bool busy;
    struct bsq_positions table; /* of the chunk's vertices that need normals */
    uint32_t *own_rings; /* for each vertex of the chunk: the number of its one-ring, which is that
                            of the first vertex at its position */
    uint32_t *neighbour_rings;  /* the same for the vertices of a neighbour; 0: none */
    struct vox_one_ring *rings; /* by number; 0 is unused */
    void *scratch;              /* for a neighbour that is not lent */
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
    uint64_t slots_at, own_at, neighbour_at, scratch_at, bytes;
};

static struct layout lay_out(const struct fmt_tris_file *file)
{
    const uint64_t vertices = largest_vertex_count(file);
    const uint64_t numbers = bsq_align_up(vertices * sizeof(uint32_t), BSQ_ALIGNMENT);
    struct layout to;
    to.slots_at = bsq_align_up((vertices + 1) * sizeof(struct vox_one_ring), BSQ_ALIGNMENT);
    to.own_at =
        to.slots_at +
        bsq_align_up(bsq_positions_slots((uint32_t)vertices) * sizeof(uint32_t), BSQ_ALIGNMENT);
    to.neighbour_at = to.own_at + numbers;
    to.scratch_at = to.neighbour_at + numbers;
    to.bytes = to.scratch_at + fmt_tris_load_size_max(file);
    return to;
}

static int make_workspace(struct bsq_ctx *ctx, const struct layout *at, struct workspace *w)
{
    int status = bsq_alloc(ctx, "smooth normals", at->bytes, 1, &w->memory);
    if (status < 0)
        return status;
    w->rings = (void *)w->memory;
    w->table.slots = (void *)(w->memory + at->slots_at);
    w->own_rings = (void *)(w->memory + at->own_at);
    w->neighbour_rings = (void *)(w->memory + at->neighbour_at);
    w->scratch = w->memory + at->scratch_at;
    return 0;
}

int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      enum bsq_scan_normals weights, unsigned calls, uint64_t bytes,
                      struct vox_smooth **out)
{
    struct vox_smooth *s = NULL;
    const struct layout at = lay_out(file);
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
    memset(d->rings, 0, (count + 1) * sizeof *d->rings);
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

/* ---- sums ---- */

/* A neighbour, whose triangles are added to the one-rings of a chunk. */
struct neighbour {
    struct vox_loan loan;
    const float *min, *max; /* bounds of that chunk */
    struct vox_box box;     /* voxels of these bounds */
};

static bool touches(const struct fmt_tris_chunk_info *info, const struct neighbour *n)
{
    bool yes = true;
    for (int k = 0; k < 3; k++)
        yes = yes && info->bounds_min[k] <= n->max[k] && n->min[k] <= info->bounds_max[k];
    return yes;
}

/* Finds the neighbour's vertices among those of the chunk. Vertices at the same position lie in the
 * same voxel. */
static bool match(const struct workspace *d, const struct neighbour *n)
{
    const struct fmt_tris_chunk *chunk = n->loan.chunk;
    struct run run = {0, 0};
    bool any = false, more = next_vertices(&n->loan, &n->box, &run);
    if (more)
        memset(d->neighbour_rings, 0, chunk->vertex_count * sizeof *d->neighbour_rings);
    for (; more; more = next_vertices(&n->loan, &n->box, &run))
        any |= bsq_positions_match(&d->table, n->min, n->max, chunk->positions + run.begin,
                                   run.end - run.begin, d->neighbour_rings + run.begin);
    return any;
}

/* Adds triangles that meet a box to the one-rings. ring_of: of the chunk's vertices. */
static void add_triangles(const struct vox_smooth *s, const struct workspace *d,
                          const struct vox_loan *of, const struct vox_box *box,
                          const uint32_t *ring_of)
{
    vox_add_one_rings_fn *const add = BSQ_SIMD_PICK(bsq_simd_best(), vox_add_one_rings);
    for (struct run run = {0, 0}; next_triangles(of, box, &run);)
        add(of->chunk, run.begin, run.end, ring_of, s->weights, d->rings);
}

static int add_chunk(const struct vox_smooth *s, const struct vox_smooth_lender *lender,
                     const struct workspace *d, struct neighbour *n, uint32_t other)
{
    struct fmt_tris_chunk own = {0};
    int status = lender->lend(lender->arg, other, &n->loan);
    const bool lent = n->loan.chunk != NULL;
    if (status == 0 && !lent)
        status = fmt_tris_load(s->file, other, d->scratch, &own);
    if (status < 0)
        return status;
    if (!lent)
        n->loan = (struct vox_loan){.chunk = &own};
    if (match(d, n))
        add_triangles(s, d, &n->loan, &n->box, d->neighbour_rings);
    if (lent)
        lender->take_back(lender->arg, other);
    return 0;
}

static int sum_normals(const struct vox_smooth *s, const struct vox_smooth_lender *lender,
                       struct workspace *d, const struct vox_smooth_chunk *of,
                       const struct vox_transform *transform)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(s->file);
    uint32_t count = (uint32_t)fmt_tris_get_header(s->file)->chunk_count;
    struct neighbour neighbour = {.min = infos[of->index].bounds_min,
                                  .max = infos[of->index].bounds_max,
                                  .box = vox_transform_box(transform, infos[of->index].bounds_min,
                                                           infos[of->index].bounds_max)};
    int status = 0;
    d->table.positions = of->decoded.chunk->positions;
    enter_vertices(d, of->decoded.chunk);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        if (i == of->index)
            add_triangles(s, d, &of->decoded, NULL, d->own_rings);
        else if (touches(&infos[i], &neighbour))
            status = add_chunk(s, lender, d, &neighbour, i);
    }
    return status;
}

int vox_smooth_normals(struct vox_smooth *s, const struct vox_smooth_lender *lender,
                       const struct vox_smooth_chunk *chunk, const struct vox_transform *transform,
                       float (*normals)[4])
{
    struct workspace *workspace = take_workspace(s);
    int status = sum_normals(s, lender, workspace, chunk, transform);
    if (status == 0)
        BSQ_SIMD_PICK(bsq_simd_best(), vox_finish_one_rings)
    (workspace->rings, workspace->own_rings, chunk->decoded.chunk->vertex_count, transform->h,
     normals);
    return_workspace(s, workspace);
    return status;
}
