/* smooth_normals.c - sums the area normals around each vertex over all chunks that touch it.
 *
 * A chunk's border vertices also belong to its neighbours. Storing their normals would cost room in
 * every chunk file, though only scans that are coarse for the grid need them; so the neighbours,
 * found by their bounds, are looked at again, and matched by position. */
#include "libvoxel/voxelize/cache/smooth_normals.h"
#include "libvoxel/voxelize/cache/one_ring.h"

#include <pthread.h>
#include <string.h>

#include "base/positions.h"

/* Room for one call. */
struct desk {
    bool busy;
    struct bsq_positions table; /* of the chunk's vertices */
    uint32_t *twins; /* of each vertex of the chunk: the first vertex at its position + 1 */
    uint32_t *mates; /* of each vertex of a neighbour: the same, 0 where there is none */
    struct vox_one_ring *rings; /* by these numbers */
    void *scratch;              /* a neighbour that nobody lends */
};

struct vox_smooth {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    pthread_mutex_t lock;
    pthread_cond_t left; /* a desk became free */
    unsigned desk_count;
    struct desk *desks;
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

static uint64_t desk_bytes(const struct fmt_tris_file *file)
{
    uint32_t vertices = largest_vertex_count(file);
    return sizeof(struct desk) + (uint64_t)bsq_positions_slots(vertices) * sizeof(uint32_t) +
           (uint64_t)vertices * 2 * sizeof(uint32_t) +
           ((uint64_t)vertices + 1) * sizeof(struct vox_one_ring) + fmt_tris_load_size_max(file);
}

static int make_desk(struct vox_smooth *s, struct desk *d)
{
    uint32_t vertices = largest_vertex_count(s->file), slots = bsq_positions_slots(vertices);
    int status;
    d->table.mask = slots - 1;
    if ((status = bsq_alloc(s->ctx, "smooth normals", slots, sizeof *d->table.slots,
                            &d->table.slots)) < 0 ||
        (status = bsq_alloc(s->ctx, "smooth normals", vertices, sizeof *d->twins, &d->twins)) < 0 ||
        (status = bsq_alloc(s->ctx, "smooth normals", vertices, sizeof *d->mates, &d->mates)) < 0 ||
        (status = bsq_alloc(s->ctx, "smooth normals", vertices + 1, sizeof *d->rings, &d->rings)) <
            0)
        return status;
    return bsq_alloc(s->ctx, "smooth normals", fmt_tris_load_size_max(s->file), 1, &d->scratch);
}

int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file, unsigned calls,
                      uint64_t bytes, struct vox_smooth **out)
{
    struct vox_smooth *s;
    uint64_t most = bytes / desk_bytes(file);
    *out = NULL;
    int status = bsq_calloc(ctx, "smooth normals", 1, sizeof *s, &s);
    if (status < 0)
        return status;
    s->ctx = ctx;
    s->file = file;
    s->desk_count = most < 1 ? 1 : most < calls ? (unsigned)most : calls;
    pthread_mutex_init(&s->lock, NULL);
    pthread_cond_init(&s->left, NULL);
    status = bsq_calloc(ctx, "smooth normals", s->desk_count, sizeof *s->desks, &s->desks);
    for (unsigned i = 0; i < s->desk_count && status == 0; i++)
        status = make_desk(s, &s->desks[i]);
    if (status < 0)
        vox_smooth_destroy(s);
    else
        *out = s;
    return status;
}

void vox_smooth_destroy(struct vox_smooth *s)
{
    if (!s)
        return;
    for (unsigned i = 0; s->desks && i < s->desk_count; i++) {
        struct desk *d = &s->desks[i];
        bsq_free(s->ctx, d->table.slots);
        bsq_free(s->ctx, d->twins);
        bsq_free(s->ctx, d->mates);
        bsq_free(s->ctx, d->rings);
        bsq_free(s->ctx, d->scratch);
    }
    bsq_free(s->ctx, s->desks);
    pthread_cond_destroy(&s->left);
    pthread_mutex_destroy(&s->lock);
    bsq_free(s->ctx, s);
}

static struct desk *sit_down(struct vox_smooth *s)
{
    struct desk *free_desk = NULL;
    pthread_mutex_lock(&s->lock);
    while (!free_desk) {
        for (unsigned i = 0; i < s->desk_count && !free_desk; i++)
            free_desk = s->desks[i].busy ? NULL : &s->desks[i];
        if (!free_desk)
            pthread_cond_wait(&s->left, &s->lock);
    }
    free_desk->busy = true;
    pthread_mutex_unlock(&s->lock);
    return free_desk;
}

static void stand_up(struct vox_smooth *s, struct desk *desk)
{
    pthread_mutex_lock(&s->lock);
    desk->busy = false;
    pthread_cond_signal(&s->left);
    pthread_mutex_unlock(&s->lock);
}

/* ---- positions ---- */

/* Which of the chunk's vertices are one. Most find their slot free, or would, if not others had it:
 * processors cannot foresee which. So those are put off (to d->mates) without a branch, and looked
 * for when all others have slots. */
static void enter_vertices(const struct desk *d, const struct fmt_tris_chunk *chunk)
{
    uint32_t *late = d->mates, late_count = 0;
    memset(d->rings, 0, ((uint64_t)chunk->vertex_count + 1) * sizeof *d->rings);
    memset(d->table.slots, 0, ((uint64_t)d->table.mask + 1) * sizeof *d->table.slots);
    for (uint32_t v = 0; v < chunk->vertex_count; v++) {
        uint32_t *slot = &d->table.slots[bsq_position_hash(chunk->positions[v]) & d->table.mask];
        uint32_t taken = *slot != 0;
        *slot = taken ? *slot : v + 1;
        d->twins[v] = v + 1;
        late[late_count] = v;
        late_count += taken;
    }
    for (uint32_t i = 0; i < late_count; i++) {
        uint32_t v = late[i], *slot = bsq_positions_find(&d->table, chunk->positions[v]);
        if (*slot == 0)
            *slot = v + 1;
        d->twins[v] = *slot;
    }
}

/* ---- sums ---- */

static bool touch(const struct fmt_tris_chunk_info *a, const struct fmt_tris_chunk_info *b)
{
    bool yes = true;
    for (int k = 0; k < 3; k++)
        yes = yes && a->bounds_min[k] <= b->bounds_max[k] && b->bounds_min[k] <= a->bounds_max[k];
    return yes;
}

/* A chunk whose triangles are added to the rings of another. */
struct neighbour {
    struct vox_loan loan;
    const struct fmt_tris_chunk_info *info; /* of the other */
    struct vox_box box;                     /* and its voxels */
};

/* Finds the neighbour's vertices among those of the chunk. What lies in the same place lies in the
 * same voxel. */
static bool match(const struct desk *d, const struct neighbour *n)
{
    const struct fmt_tris_chunk *chunk = n->loan.chunk;
    const float *min = n->info->bounds_min, *max = n->info->bounds_max;
    bool any = false;
    if (!n->loan.vertex_groups)
        return bsq_positions_match(&d->table, min, max, chunk->positions, chunk->vertex_count,
                                   d->mates);
    memset(d->mates, 0, chunk->vertex_count * sizeof *d->mates);
    for (uint32_t begin = 0, g = 0; begin < chunk->vertex_count; begin += VOX_GROUP_VERTICES, g++) {
        uint32_t end = vox_group_end(begin, chunk->vertex_count, VOX_GROUP_VERTICES);
        if (vox_boxes_meet(&n->loan.vertex_groups[g], &n->box))
            any |= bsq_positions_match(&d->table, min, max, chunk->positions + begin, end - begin,
                                       d->mates + begin);
    }
    return any;
}

static void add_neighbour(const struct desk *d, const struct neighbour *n)
{
    vox_add_one_rings_fn *const add = BSQ_SIMD_PICK(bsq_simd_best(), vox_add_one_rings);
    const struct fmt_tris_chunk *chunk = n->loan.chunk;
    if (!n->loan.triangle_groups) {
        add(chunk, 0, chunk->triangle_count, d->mates, d->rings);
        return;
    }
    for (uint32_t begin = 0, g = 0; begin < chunk->triangle_count;
         begin += VOX_GROUP_TRIANGLES, g++)
        if (vox_boxes_meet(&n->loan.triangle_groups[g], &n->box))
            add(chunk, begin, vox_group_end(begin, chunk->triangle_count, VOX_GROUP_TRIANGLES),
                d->mates, d->rings);
}

static int add_chunk(const struct vox_smooth *s, const struct vox_smooth_lender *lender,
                     const struct desk *d, struct neighbour *n, uint32_t other)
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
        add_neighbour(d, n);
    if (lent)
        lender->take_back(lender->arg, other);
    return 0;
}

static int sum_normals(const struct vox_smooth *s, const struct vox_smooth_lender *lender,
                       struct desk *d, uint32_t index, const struct fmt_tris_chunk *chunk,
                       const struct vox_lattice *lattice)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(s->file), *info = &infos[index];
    uint32_t count = (uint32_t)fmt_tris_get_header(s->file)->chunk_count;
    struct neighbour neighbour = {
        .info = info, .box = vox_lattice_box(lattice, info->bounds_min, info->bounds_max)};
    int status = 0;
    d->table.positions = chunk->positions;
    enter_vertices(d, chunk);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        if (i == index)
            BSQ_SIMD_PICK(bsq_simd_best(), vox_add_one_rings)
        (chunk, 0, chunk->triangle_count, d->twins, d->rings);
        else if (touch(&infos[i], info)) status = add_chunk(s, lender, d, &neighbour, i);
    }
    return status;
}

int vox_smooth_normals(struct vox_smooth *s, const struct vox_smooth_lender *lender, uint32_t index,
                       const struct fmt_tris_chunk *chunk, const struct vox_lattice *lattice,
                       float (*normals)[4])
{
    struct desk *desk = sit_down(s);
    int status = sum_normals(s, lender, desk, index, chunk, lattice);
    if (status == 0)
        BSQ_SIMD_PICK(bsq_simd_best(), vox_finish_one_rings)
    (desk->rings, desk->twins, chunk->vertex_count, lattice->h, normals);
    stand_up(s, desk);
    return status;
}
