/* placement.c - places the voxels over a scan, and cuts the bounds of chunks into closer boxes.
 *
 * Every operation of the mapping is monotonic on each axis, so the voxels of a triangle lie between
 * those of its bounds, whatever the rounding.
 *
 * Triangles are in Morton order, so consecutive ones are mostly in one place. A run of triangles
 * whose box reaches across many regions is halved. A single triangle is never cut: it touches about
 * as many voxels as its bounds have regions, unless there are more than any file could hold. */
#include "libvoxel/voxelize/plan/plan.h"

#include <float.h>
#include <math.h>

/* Keeps indices clear of the ends of int32_t, so that neighbours and region origins do not
 * overflow. */
static const double index_limit = 1073741824.0; /* 2^30 */

/* An extent of a whole number of voxels may come out a little larger by rounding. The plane at its
 * end belongs to the last voxel. */
static const double whole_tolerance = 1e-9;

static int32_t clamp_index(double value, int32_t lo, int32_t hi)
{
    return value <= lo ? lo : value >= hi ? hi : (int32_t)value;
}

static int init_by_resolution(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                              const char *path, uint32_t resolution, struct vox_transform *out)
{
    double extent[3], longest = 0.0;
    for (int a = 0; a < 3; a++) {
        out->start[a] = header->origin[a] + (double)header->bounds_min[a];
        extent[a] = header->origin[a] + (double)header->bounds_max[a] - out->start[a];
        if (extent[a] > longest)
            longest = extent[a];
    }
    if (resolution > index_limit)
        return bsq_fail(ctx, BSQ_EUSAGE, "a resolution of %u is above the limit of %.0f",
                        resolution, index_limit);
    out->h = longest / resolution;
    if (!(out->h > 0.0) || !isfinite(out->h))
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: the scan's longest side is %g at (%g, %g, %g), which cannot be "
                        "divided into %u voxels",
                        path, longest, out->start[0], out->start[1], out->start[2], resolution);
    for (int a = 0; a < 3; a++) {
        double count = ceil(extent[a] / out->h - whole_tolerance);
        out->voxels.lo[a] = 0;
        out->voxels.hi[a] = extent[a] == longest
                                ? (int32_t)resolution - 1
                                : clamp_index(count - 1.0, 0, (int32_t)resolution - 1);
    }
    return 0;
}

static int init_by_size(struct bsq_ctx *ctx, const struct fmt_tris_header *header, const char *path,
                        double voxel_size, struct vox_transform *out)
{
    if (!(voxel_size > 0.0) || !isfinite(voxel_size))
        return bsq_fail(ctx, BSQ_EUSAGE, "a voxel size of %g is not a positive number", voxel_size);
    out->h = voxel_size;
    for (int a = 0; a < 3; a++) {
        out->start[a] = 0.0;
        double lo = floor(vox_transform_coordinate(out, header->bounds_min[a], a));
        double hi = floor(vox_transform_coordinate(out, header->bounds_max[a], a));
        if (!(lo >= -index_limit) || !(hi < index_limit))
            return bsq_fail(
                ctx, BSQ_EUSAGE,
                "%s: with a voxel size of %g the scan reaches from index %.12g to %.12g "
                "along %c, beyond the limit of +-%.0f",
                path, voxel_size, lo, hi, "xyz"[a], index_limit);
        out->voxels.lo[a] = (int32_t)lo;
        out->voxels.hi[a] = (int32_t)hi;
    }
    return 0;
}

int vox_transform_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header, const char *path,
                       uint32_t resolution, double voxel_size, struct vox_transform *out)
{
    for (int a = 0; a < 3; a++)
        out->origin[a] = header->origin[a];
    BSQ_PASS(resolution > 0 ? init_by_resolution(ctx, header, path, resolution, out)
                            : init_by_size(ctx, header, path, voxel_size, out));
    if (out->h < FLT_MIN || 1.0 / out->h < FLT_MIN)
        return bsq_fail(
            ctx, resolution > 0 ? BSQ_EDATA : BSQ_EUSAGE,
            "%s: voxels of %g are beyond the 32-bit numbers of a NanoVDB grid, %g to %g", path,
            out->h, (double)FLT_MIN, 1.0 / (double)FLT_MIN);
    return 0;
}

struct vox_box vox_transform_box(const struct vox_transform *transform, const float min[3],
                                 const float max[3])
{
    struct vox_box box;
    for (int a = 0; a < 3; a++) {
        int32_t lo = transform->voxels.lo[a], hi = transform->voxels.hi[a];
        box.lo[a] = clamp_index(floor(vox_transform_coordinate(transform, min[a], a)), lo, hi);
        box.hi[a] = clamp_index(floor(vox_transform_coordinate(transform, max[a], a)), lo, hi);
    }
    return box;
}

/* ---- chunk boxes ---- */

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

static int placement_add_box(struct maker *maker, uint32_t chunk, const struct vox_box *box)
{
    int status =
        BSQ_GROW(maker->ctx, "chunk boxes", maker->count + 1, &maker->boxes, &maker->capacity);
    if (status == 0)
        maker->boxes[maker->count++] = (struct vox_chunk_box){*box, chunk};
    return status;
}

/* Returns whether a box touches more than FEW_REGIONS regions. Such a box is cut in two. */
static bool is_wide(const struct vox_box *box)
{
    return vox_region_count(box) > FEW_REGIONS;
}

static int placement_add_run(struct maker *maker, uint32_t number,
                             const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end)
{
    struct vox_box box = run_box(maker->transform, chunk, begin, end);
    if (end - begin == 1 || maker->count >= maker->most || !is_wide(&box))
        return placement_add_box(maker, number, &box);
    uint32_t middle = begin + (end - begin) / 2;
    BSQ_PASS(placement_add_run(maker, number, chunk, begin, middle));
    return placement_add_run(maker, number, chunk, middle, end);
}

int vox_chunk_boxes_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                           const struct vox_transform *transform, uint64_t bytes,
                           struct vox_chunk_box **boxes, uint64_t *count)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    uint64_t chunks = fmt_tris_get_header(file)->chunk_count;
    struct maker maker = {.ctx = ctx,
                          .transform = transform,
                          .most = bytes / (sizeof *maker.boxes + vox_schedule_entry_bytes())};
    void *scratch = NULL;
    int status = 0;
    for (uint64_t i = 0; i < chunks && status == 0; i++) {
        struct fmt_tris_chunk chunk;
        const struct vox_box bounds =
            vox_transform_box(transform, infos[i].bounds_min, infos[i].bounds_max);
        bool wide = maker.count + (chunks - i) < maker.most && is_wide(&bounds);
        if (wide && !scratch)
            status = bsq_alloc(ctx, "chunk boxes", fmt_tris_load_size_max(file), 1, &scratch);
        if (wide && status == 0 && (status = bsq_check(ctx)) == 0)
            status = fmt_tris_load(file, i, scratch, &chunk);
        if (status == 0)
            status = wide ? placement_add_run(&maker, (uint32_t)i, &chunk, 0, chunk.triangle_count)
                          : placement_add_box(&maker, (uint32_t)i, &bounds);
    }
    bsq_free(ctx, scratch);
    if (status < 0)
        bsq_free(ctx, maker.boxes);
    *boxes = status < 0 ? NULL : maker.boxes;
    *count = status < 0 ? 0 : maker.count;
    return status;
}
