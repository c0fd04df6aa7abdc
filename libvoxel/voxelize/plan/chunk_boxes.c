/* chunk_boxes.c - see chunk_boxes.h.
 *
 * Triangles are in Morton order, so a run of them is mostly in one place; one that is not is
 * halved. A single triangle touches about as many voxels as its bounds have regions, unless there
 * are more than any file could hold. */
#include "libvoxel/voxelize/plan/plan.h"

#include <math.h>

/* Reading a chunk takes as long as going through some hundred regions with nothing in them. */
static const double few_regions = 128.0;

struct maker {
    struct bsq_ctx *ctx;
    const struct vox_lattice *lattice;
    struct vox_part *parts;
    uint64_t count, capacity, most;
};

static double regions_of(const struct vox_box *box)
{
    double regions = 1.0;
    for (int a = 0; a < 3; a++)
        regions *= (box->hi[a] >> VOX_REGION_LOG2) - (box->lo[a] >> VOX_REGION_LOG2) + 1;
    return regions;
}

static struct vox_box run_box(const struct vox_lattice *lattice, const struct fmt_tris_chunk *chunk,
                              uint32_t begin, uint32_t end)
{
    float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t t = begin; t < end; t++)
        for (int corner = 0; corner < 3; corner++)
            for (int a = 0; a < 3; a++) {
                float p = chunk->positions[chunk->triangles[t][corner]][a];
                min[a] = p < min[a] ? p : min[a];
                max[a] = p > max[a] ? p : max[a];
            }
    return vox_lattice_box(lattice, min, max);
}

static int add_part(struct maker *maker, uint32_t chunk, const struct vox_box *box)
{
    int status = bsq_grow(maker->ctx, "parts of chunks", maker->count + 1, sizeof *maker->parts,
                          &maker->parts, &maker->capacity);
    if (status == 0)
        maker->parts[maker->count++] = (struct vox_part){*box, chunk};
    return status;
}

static int add_run(struct maker *maker, uint32_t number, const struct fmt_tris_chunk *chunk,
                   uint32_t begin, uint32_t end)
{
    struct vox_box box = run_box(maker->lattice, chunk, begin, end);
    if (end - begin == 1 || maker->count >= maker->most || regions_of(&box) <= few_regions)
        return add_part(maker, number, &box);
    uint32_t middle = begin + (end - begin) / 2;
    int status = add_run(maker, number, chunk, begin, middle);
    return status < 0 ? status : add_run(maker, number, chunk, middle, end);
}

int vox_parts_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                     const struct vox_lattice *lattice, const struct vox_box *boxes, uint64_t bytes,
                     struct vox_part **parts, uint64_t *count)
{
    uint64_t chunks = fmt_tris_get_header(file)->chunk_count;
    struct maker maker = {.ctx = ctx,
                          .lattice = lattice,
                          .most = bytes / (sizeof *maker.parts + vox_schedule_entry_bytes())};
    void *scratch = NULL;
    int status = 0;
    for (uint64_t i = 0; i < chunks && status == 0; i++) {
        struct fmt_tris_chunk chunk;
        bool far = regions_of(&boxes[i]) > few_regions && maker.count + (chunks - i) < maker.most;
        if (far && !scratch)
            status = bsq_alloc(ctx, "parts of chunks", fmt_tris_load_size_max(file), 1, &scratch);
        if (far && status == 0 && (status = bsq_check(ctx)) == 0)
            status = fmt_tris_load(file, i, scratch, &chunk);
        if (status == 0)
            status = far ? add_run(&maker, (uint32_t)i, &chunk, 0, chunk.triangle_count)
                         : add_part(&maker, (uint32_t)i, &boxes[i]);
    }
    bsq_free(ctx, scratch);
    if (status < 0)
        bsq_free(ctx, maker.parts);
    *parts = status < 0 ? NULL : maker.parts;
    *count = status < 0 ? 0 : maker.count;
    return status;
}
