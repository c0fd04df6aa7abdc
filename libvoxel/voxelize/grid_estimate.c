/* grid_estimate.c - how many voxels triangles touch, and what follows from that.
 *
 * A plane with unit normal n crosses |nx| + |ny| + |nz| unit cubes per unit of its area: each term
 * counts the faces across one axis that it passes through. A triangle's share is therefore the sum
 * of its areas projected along the three axes, which is what its cross product holds.
 *
 * The estimate is too high only if triangles share voxels. So a grid is refused only if its
 * estimate is more than twice what fits. */
#include "libvoxel/voxelize/voxelize_run.h"

#include <inttypes.h>
#include <math.h>

#include "base/file.h"

/* From this size a grid takes minutes and 10 GB. Then all chunks are read, and few triangles cause
 * a warning. */
static const double huge_voxels = 1e9;
/* Voxels a triangle above which smaller voxels add no detail. */
static const double fine_voxels = 16.0;

/* Chunks sampled for an ordinary grid; this takes some milliseconds. Of many triangles in a chunk
 * every fourth one is measured. */
enum { SAMPLES = 16, MANY_TRIANGLES = 8192, SAMPLE_STEP = 4 };

/* A surface passes through 8 x 8 of a leaf's 512 voxels. */
static const double voxels_of_leaf = 64.0;
/* Measured bytes a voxel: a normal and a plane, with a share of leaves and second records; and a
 * colour. */
static const double voxel_bytes = 11.0, channel_bytes = 4.0;
static const double certainty = 0.5; /* share of the estimate that the grid has at least */

/* ---- areas ---- */

/* Adds the areas of measured triangles of a chunk, and their number. */
static void add_projected_areas(const struct fmt_tris_chunk *chunk, double *area,
                                uint64_t *triangles)
{
    const uint32_t step = chunk->triangle_count < MANY_TRIANGLES ? 1 : SAMPLE_STEP;
    double sum = 0.0;
    for (uint32_t t = 0; t < chunk->triangle_count; t += step, ++*triangles) {
        const float *p = chunk->positions[chunk->triangles[t][0]];
        const float *q = chunk->positions[chunk->triangles[t][1]];
        const float *r = chunk->positions[chunk->triangles[t][2]];
        double u[3], v[3];
        for (int a = 0; a < 3; a++) {
            u[a] = (double)q[a] - (double)p[a];
            v[a] = (double)r[a] - (double)p[a];
        }
        for (int a = 0; a < 3; a++) {
            int b = (a + 1) % 3, c = (a + 2) % 3;
            sum += fabs(u[b] * v[c] - u[c] * v[b]);
        }
    }
    *area += sum / 2;
}

int vox_estimate_voxels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                        const struct vox_transform *transform, uint64_t chunks_max, double *voxels)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    const uint64_t chunks = header->chunk_count, count = chunks < chunks_max ? chunks : chunks_max;
    void *scratch;
    double area = 0.0;
    uint64_t triangles = 0;
    int status;
    *voxels = 0.0;
    BSQ_TRY(bsq_alloc(ctx, "areas of chunks", fmt_tris_load_size_max(file), 1, &scratch));
    for (uint64_t i = 0; i < count; i++) {
        struct fmt_tris_chunk chunk;
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(fmt_tris_load(file, (2 * i + 1) * chunks / (2 * count), scratch, &chunk));
        add_projected_areas(&chunk, &area, &triangles);
    }
    if (triangles > 0)
        *voxels = area * ((double)header->triangle_count / (double)triangles) / transform->h /
                  transform->h;
done:
    bsq_free(ctx, scratch);
    return status;
}

/* ---- warnings and refusals ---- */

double vox_estimate_bytes(double voxels, unsigned channels)
{
    return voxels * (voxel_bytes + channels * channel_bytes);
}

/* Says nothing of a grid with fewer voxels than triangles: it is about as large as the scan. */
static int judge_huge(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      const struct vox_transform *transform, double voxels, double bytes,
                      const char *grid_path)
{
    uint64_t triangles = fmt_tris_get_header(file)->triangle_count;
    if (voxels < huge_voxels || voxels < (double)triangles)
        return 0;
    if (certainty * voxels / voxels_of_leaf > (double)UINT32_MAX)
        return bsq_fail(
            ctx, BSQ_EUSAGE,
            "%s: about %.2g voxels of %g would be in the grid, which has no more than %" PRIu32
            " leaves of 8x8x8; choose larger voxels",
            grid_path, voxels, transform->h, UINT32_MAX);
    if (voxels > fine_voxels * (double)triangles)
        bsq_warn(
            ctx,
            "%s: the grid will have about %.2g voxels of %g and take %.3g GiB, twice that while it is written: the voxels are "
            "small for a scan of %" PRIu64 " triangles",
            grid_path, voxels, transform->h, bytes / 0x1p30, triangles);
    return 0;
}

int vox_estimate_check(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                       const struct vox_transform *transform, unsigned channels,
                       const char *grid_path)
{
    double voxels;
    BSQ_PASS(vox_estimate_voxels(ctx, file, transform, SAMPLES, &voxels));
    if (voxels > huge_voxels / 4)
        BSQ_PASS(vox_estimate_voxels(ctx, file, transform, UINT64_MAX, &voxels));
    double bytes = vox_estimate_bytes(voxels, channels);
    BSQ_PASS(judge_huge(ctx, file, transform, voxels, bytes, grid_path));
    /* Sections of the grid are in a temporary file until they are joined. */
    uint64_t least = (uint64_t)fmin(certainty * bytes, 0x1p62);
    return bsq_require_space(ctx, grid_path, least, least);
}
