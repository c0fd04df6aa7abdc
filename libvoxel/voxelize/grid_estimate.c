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
#include "base/parallel.h"

/* From this size a grid takes minutes and 10 GB. Then all triangles are read, and few triangles
 * cause a warning. */
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

/* A sampled chunk: measured triangles, and their areas. */
struct sample {
    double area;
    uint32_t triangles;
};

struct area_job {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    uint8_t *scratch; /* one chunk for each worker */
    uint64_t scratch_bytes;
    struct sample *samples; /* their sum does not depend on threads */
    uint64_t count;
    unsigned workers;
};

/* ---- areas ---- */

static struct sample projected_areas(const struct fmt_tris_chunk *chunk)
{
    const uint32_t step = chunk->triangle_count < MANY_TRIANGLES ? 1 : SAMPLE_STEP;
    double sum = 0.0;
    uint32_t count = 0;
    for (uint32_t t = 0; t < chunk->triangle_count; t += step, count++) {
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
    return (struct sample){sum / 2, count};
}

/* Measures every workers-th sample from `index` on. Samples are spread evenly over the file. */
static int sum_areas(void *arg, uint64_t index, unsigned worker)
{
    struct area_job *job = arg;
    uint64_t chunks = fmt_tris_get_header(job->file)->chunk_count;
    void *scratch = job->scratch + index * job->scratch_bytes;
    int status = 0;
    (void)worker;
    for (uint64_t i = index; i < job->count && status == 0; i += job->workers) {
        uint64_t number = (2 * i + 1) * chunks / (2 * job->count);
        struct fmt_tris_chunk chunk;
        if ((status = bsq_check(job->ctx)) == 0 &&
            (status = fmt_tris_load(job->file, number, scratch, &chunk)) == 0)
            job->samples[i] = projected_areas(&chunk);
    }
    return status;
}

static unsigned choose_workers(const struct area_job *job)
{
    uint64_t fitting = bsq_memory_share(job->ctx, "estimate of voxels", 2) / job->scratch_bytes;
    unsigned threads = bsq_threads(job->ctx);
    return fitting >= threads ? threads : fitting > 0 ? (unsigned)fitting : 1;
}

int vox_estimate_voxels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                        const struct vox_transform *transform, uint64_t chunks_max, double *voxels)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    struct area_job job = {.ctx = ctx,
                           .file = file,
                           .scratch_bytes = (fmt_tris_load_size_max(file) + 63) & ~UINT64_C(63)};
    job.count = header->chunk_count < chunks_max ? header->chunk_count : chunks_max;
    job.workers = choose_workers(&job);
    double area = 0.0, triangles = 0.0;
    int status;
    *voxels = 0.0;
    BSQ_TRY(bsq_calloc(ctx, "areas of chunks", job.count, sizeof *job.samples, &job.samples));
    BSQ_TRY(bsq_alloc(ctx, "areas of chunks", job.workers, job.scratch_bytes, &job.scratch));
    BSQ_TRY(bsq_parallel_for(ctx, job.workers, sum_areas, &job));
    for (uint64_t i = 0; i < job.count; i++) {
        area += job.samples[i].area;
        triangles += job.samples[i].triangles;
    }
    if (triangles > 0.0)
        *voxels = area * ((double)header->triangle_count / triangles) / transform->h / transform->h;
done:
    bsq_free(ctx, job.scratch);
    bsq_free(ctx, job.samples);
    return status;
}

/* ---- warnings and refusals ---- */

/* Estimates voxels from the bounds of chunks, as if each chunk were one surface folded as little as
 * its bounds allow. */
static double voxels_by_bounds(const struct fmt_tris_file *file,
                               const struct vox_transform *transform)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    double sum = 0.0;
    for (uint64_t i = 0; i < fmt_tris_get_header(file)->chunk_count; i++) {
        double side[3];
        for (int a = 0; a < 3; a++)
            side[a] =
                ((double)infos[i].bounds_max[a] - (double)infos[i].bounds_min[a]) / transform->h;
        sum += side[0] * side[1] + side[1] * side[2] + side[2] * side[0];
    }
    return sum;
}

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
    uint64_t chunks_max = voxels_by_bounds(file, transform) < huge_voxels ? SAMPLES : UINT64_MAX;
    double voxels;
    int status = vox_estimate_voxels(ctx, file, transform, chunks_max, &voxels);
    if (status < 0)
        return status;
    double bytes = vox_estimate_bytes(voxels, channels);
    if ((status = judge_huge(ctx, file, transform, voxels, bytes, grid_path)) < 0)
        return status;
    /* Sections of the grid are temporary files until they are joined. */
    uint64_t least = (uint64_t)fmin(certainty * bytes, 0x1p62);
    return bsq_require_space(ctx, grid_path, least, least);
}
