/* chunk_boxes.c - cuts the bounds of chunks into closer boxes.
 *
 * Triangles are in Morton order, so consecutive ones are mostly in one place. A run of triangles
 * whose box reaches across many regions is halved. A single triangle is never cut: it touches about
 * as many voxels as its bounds have regions, unless there are more than any file could hold. */
#include "libvoxel/voxelize/plan/plan.h"

#include <math.h>

/* Reading a chunk takes as long as visiting about this many empty regions. */
enum { FEW_REGIONS = 128 };

struct maker {
    struct bsq_ctx *ctx;
    const struct vox_transform *transform;
    struct vox_chunk_box *boxes;
    uint64_t count, capacity, most;
};

static struct vox_box run_box(const struct vox_transform *transform,
                              const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end)
{
    float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t t = begin; t < end; t++)
        for (int corner = 0; corner < 3; corner++)
            for (int a = 0; a < 3; a++) {
                float p = chunk->positions[chunk->triangles[t][corner]][a];
                min[a] = p < min[a] ? p : min[a];
                max[a] = p > max[a] ? p : max[a];
            }
    return vox_transform_box(transform, min, max);
}

static int add_box(struct maker *maker, uint32_t chunk, const struct vox_box *box)
{
    int status = bsq_grow(maker->ctx, "chunk boxes", maker->count + 1, sizeof *maker->boxes,
                          &maker->boxes, &maker->capacity);
    if (status == 0)
        maker->boxes[maker->count++] = (struct vox_chunk_box){*box, chunk};
    return status;
}

/* Returns whether a box touches more than FEW_REGIONS regions. Such a box is cut in two. */
static bool is_wide(const struct vox_box *box)
{
    return vox_region_count(box) > FEW_REGIONS;
}

static int add_run(struct maker *maker, uint32_t number, const struct fmt_tris_chunk *chunk,
                   uint32_t begin, uint32_t end)
{
    struct vox_box box = run_box(maker->transform, chunk, begin, end);
    if (end - begin == 1 || maker->count >= maker->most || !is_wide(&box))
        return add_box(maker, number, &box);
    uint32_t middle = begin + (end - begin) / 2;
    int status = add_run(maker, number, chunk, begin, middle);
    return status < 0 ? status : add_run(maker, number, chunk, middle, end);
}

int vox_chunk_boxes_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                           const struct vox_transform *transform, const struct vox_box *bounds,
                           uint64_t bytes, struct vox_chunk_box **boxes, uint64_t *count)
{
    uint64_t chunks = fmt_tris_get_header(file)->chunk_count;
    struct maker maker = {.ctx = ctx,
                          .transform = transform,
                          .most = bytes / (sizeof *maker.boxes + vox_schedule_entry_bytes())};
    void *scratch = NULL;
    int status = 0;
    for (uint64_t i = 0; i < chunks && status == 0; i++) {
        struct fmt_tris_chunk chunk;
        bool wide = maker.count + (chunks - i) < maker.most && is_wide(&bounds[i]);
        if (wide && !scratch)
            status = bsq_alloc(ctx, "chunk boxes", fmt_tris_load_size_max(file), 1, &scratch);
        if (wide && status == 0 && (status = bsq_check(ctx)) == 0)
            status = fmt_tris_load(file, i, scratch, &chunk);
        if (status == 0)
            status = wide ? add_run(&maker, (uint32_t)i, &chunk, 0, chunk.triangle_count)
                          : add_box(&maker, (uint32_t)i, &bounds[i]);
    }
    bsq_free(ctx, scratch);
    if (status < 0)
        bsq_free(ctx, maker.boxes);
    *boxes = status < 0 ? NULL : maker.boxes;
    *count = status < 0 ? 0 : maker.count;
    return status;
}
