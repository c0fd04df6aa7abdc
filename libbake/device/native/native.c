/* native.c - traces patches on the calling thread, with the widest lanes that the processor has. */
#include "libbake/device/native/native.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "libbake/device/native/native_code.h"
#include "libbake/device/native/tree_rays.h"

enum { PAIRS_PER_BAND = 1 << 18 };

/* The tree of leaves may take 1 / TREE_PART of the budget that is left. */
enum { TREE_PART = 4 };

struct native {
    struct bake_backend base;
    struct bsq_ctx *ctx;
    struct bk_grid grid;
    struct bk_params params;
    const struct bk_triangle *triangles;
    bake_native_patch_fn *patch;
    struct bake_tree tree;            /* for secondary rays */
    struct bake_tree_stream *streams; /* of each worker; NULL: there is no tree */
    float *results;                   /* of each worker: of the rays of BAKE_NATIVE_HITS hits */
    uint64_t worker_results;
};

/* Returns the rows of a band. A patch can have many millions of pairs of rays, so native_trace()
 * checks for an interruption after each band. A band has whole squares of texels, or is a single
 * row. */
static uint32_t band_rows(uint64_t row_pairs)
{
    const uint64_t rows = PAIRS_PER_BAND / row_pairs;
    return rows >= BAKE_NATIVE_SQUARE ? (uint32_t)(rows - rows % BAKE_NATIVE_SQUARE) : 1;
}

static int native_trace(struct bake_backend *backend, const struct bk_patch *patch,
                        const uint32_t *sample_triangles, float *texels, unsigned worker, char *why)
{
    struct native *native = (struct native *)backend;
    const uint64_t texel_samples = (uint64_t)native->params.samples * native->params.samples;
    const uint32_t rows =
        band_rows(patch->width * texel_samples * bake_sample_cost(&native->params));

    struct bake_native_memory memory = {0};

    (void)why;
    if (native->streams)
        memory = (struct bake_native_memory){&native->tree, &native->streams[worker],
                                             native->results + worker * native->worker_results};
    for (uint32_t row = 0; row < patch->height; row += rows) {
        const uint32_t end = patch->height - row < rows ? patch->height : row + rows;
        int status = bsq_check(native->ctx);
        if (status < 0)
            return status;
        native->patch(&native->grid, &native->params, native->triangles, patch, row, end,
                      sample_triangles, &memory, texels);
    }
    return 0;
}

static void native_close(struct bake_backend *backend)
{
    struct native *native = (struct native *)backend;

    bake_tree_free(native->ctx, &native->tree);
    bsq_free(native->ctx, native->streams);
    bsq_free(native->ctx, native->results);
    bsq_free(native->ctx, native);
}

/* Makes the tree of leaves, if there are secondary rays and memory for it. */
static int native_make_tree(struct native *native, const struct fmt_nvdb_grid *grid)
{
    const unsigned threads = bsq_threads(native->ctx);
    const uint64_t rays = (uint64_t)bk_open_rays(&native->params) + bk_solid_rays(&native->params);
    const uint64_t limit = bsq_memory_share(native->ctx, "tree around leaves", TREE_PART);
    uint64_t bytes;

    native->worker_results = BAKE_NATIVE_HITS * rays;
    bytes = threads * (sizeof *native->streams + native->worker_results * sizeof(float));
    if (rays == 0 || bytes > limit)
        return 0;
    int status = bake_tree_build(native->ctx, grid, limit - bytes, &native->tree);
    if (status < 0 || !native->tree.nodes)
        return status;
    status = bsq_alloc(native->ctx, "results of rays", threads * native->worker_results,
                       sizeof *native->results, &native->results);
    if (status == 0)
        status = bsq_alloc(native->ctx, "streams of rays", threads, sizeof *native->streams,
                           &native->streams);
    return status;
}

void bake_trace_rays(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                     const struct bake_ray_batch *rays, struct bk_hit *hits)
{
    struct bk_grid native;

    bake_kernel_grid(grid, params, &native);
    BSQ_SIMD_PICK(bsq_simd_best(), bake_native_rays)(&native, params, rays, hits);
}

void bake_trace_viewpoints(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                           const struct bake_viewpoints *viewpoints, uint64_t begin, uint64_t end,
                           struct bake_ray_states *states)
{
    struct bk_grid native;

    bake_kernel_grid(grid, params, &native);
    BSQ_SIMD_PICK(bsq_simd_best(), bake_native_look)
    (&native, params, viewpoints, begin, end, states);
}

static void native_list(struct bsq_ctx *ctx, struct bake_device_list *out)
{
    const long pages = sysconf(_SC_PHYS_PAGES), page_bytes = sysconf(_SC_PAGESIZE);
    const unsigned threads = bsq_threads(ctx);
    struct bake_device_info *info = &out->devices[out->count++];

    strcpy(info->id, "cpu");
    snprintf(info->name, sizeof info->name, "%u thread%s", threads, threads == 1 ? "" : "s");
    if (pages > 0 && page_bytes > 0)
        info->memory_bytes = (uint64_t)pages * (uint64_t)page_bytes;
}

static int native_open(struct bsq_ctx *ctx, uint32_t number, const struct bake_job *job,
                       struct bake_backend **out)
{
    const unsigned threads = bsq_threads(ctx);
    struct native *native;
    int status = bsq_calloc(ctx, "native device", 1, sizeof *native, &native);

    (void)number;
    if (status < 0)
        return status;
    snprintf(native->base.name, sizeof native->base.name, "cpu, %u thread%s", threads,
             threads == 1 ? "" : "s");
    native->base.trace = native_trace;
    native->base.close = native_close;
    native->ctx = ctx;
    bake_kernel_grid(job->grid, &job->params, &native->grid);
    native->params = job->params;
    native->triangles = job->triangles;
    native->patch = BSQ_SIMD_PICK(bsq_simd_best(), bake_native_patch);
    status = native_make_tree(native, job->grid);
    if (status < 0)
        native_close(&native->base);
    else
        *out = &native->base;
    return status;
}

const struct bake_device_kind bake_native_kind = {
    .name = "cpu", .open = native_open, .list = native_list};
