/* native.c - traces patches on the calling thread, with the widest lanes that the processor has. */
#include "libbake/device/native/native.h"

#include <stdio.h>
#include <unistd.h>

#include "libbake/device/native/native_code.h"
#include "libbake/grid_tree/tree_rays.h"

enum { PAIRS_PER_BAND = 1 << 18 };

struct bake_native {
    struct bsq_ctx *ctx;
    struct bk_grid grid;
    struct bk_params params;
    const struct bk_triangle *triangles;
    bake_native_patch_fn *patch;
    const struct bake_tree *tree; /* for secondary rays; NULL: there are none */
    struct bake_native_workers workers;
};

static struct bake_native_memory
memory_of(const struct bake_tree *tree, const struct bake_native_workers *workers, unsigned worker)
{
    return (struct bake_native_memory){tree, &workers->streams[worker],
                                       workers->results + worker * workers->results_each};
}

/* Returns the rows of a band. A patch can have many millions of pairs of rays, so
 * bake_native_trace() checks for an interruption after each band. A band has whole squares of
 * texels, or is a single row. */
static uint32_t band_rows(uint64_t row_pairs)
{
    const uint64_t rows = PAIRS_PER_BAND / row_pairs;
    return rows >= BAKE_NATIVE_SQUARE ? (uint32_t)(rows - rows % BAKE_NATIVE_SQUARE) : 1;
}

int bake_native_trace(struct bake_native *native, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, float *texels, unsigned worker)
{
    const uint64_t texel_samples = (uint64_t)native->params.samples * native->params.samples;
    /* Counts rays in pairs of primary rays. */
    const uint32_t rows =
        band_rows(patch->width * texel_samples * (1 + bk_ray_count(&native->params) / 2));
    const struct bake_native_memory memory = native->tree
                                                 ? memory_of(native->tree, &native->workers, worker)
                                                 : (struct bake_native_memory){0};

    for (uint32_t row = 0; row < patch->height; row += rows) {
        const uint32_t end = patch->height - row < rows ? patch->height : row + rows;
        BSQ_PASS(bsq_check(native->ctx));
        native->patch(&native->grid, &native->params, native->triangles, patch, row, end,
                      sample_triangles, &memory, texels);
    }
    return 0;
}

void bake_native_close(struct bake_native *native)
{
    if (!native)
        return;
    bake_native_workers_free(native->ctx, &native->workers);
    bsq_free(native->ctx, native);
}

void bake_trace_rays(const struct fmt_nvdb_grid *grid, const struct bk_params *params, double unit,
                     const struct bake_ray_batch *batch, uint64_t begin, uint64_t end)
{
    struct bk_grid native;

    bake_kernel_grid(grid, params, &native);
    BSQ_SIMD_PICK(bsq_simd_best(), bake_native_rays)(&native, params, unit, batch, begin, end);
}

/* Returns how many results the rays of BAKE_NATIVE_HITS viewpoints have. */
static uint64_t native_results(const struct bk_params *params)
{
    return BAKE_NATIVE_HITS * ((uint64_t)bk_open_rays(params) + bk_solid_rays(params));
}

void bake_trace_viewpoints(const struct fmt_nvdb_grid *grid, const struct bake_tree *tree,
                           const struct bk_params *params, const struct bake_viewpoints *viewpoints,
                           uint64_t begin, uint64_t end, const struct bake_native_workers *workers,
                           unsigned worker, const struct bake_ray_states *states)
{
    const struct bake_native_memory memory = memory_of(tree, workers, worker);
    bk_viewpoint points[BAKE_NATIVE_HITS];
    uint64_t numbers[BAKE_NATIVE_HITS];
    struct bk_grid native;

    bake_kernel_grid(grid, params, &native);
    while (begin < end) {
        uint32_t count = 0;
        for (; begin < end && count < BAKE_NATIVE_HITS; begin++) {
            numbers[count] = begin;
            count += viewpoints->get(viewpoints->arg, begin, &points[count]);
        }
        for (uint32_t open = 0; open < 2; open++) {
            const bk_rays kind = bk_rays_of(params, open);
            BSQ_SIMD_PICK(bsq_simd_best(), bake_tree_look)
            (&native, params, tree, &kind, points, count, memory.results, kind.count,
             memory.stream);
            /* A ray into the solid that is as long as it may be tells nothing of other scans. */
            for (uint64_t i = 0; i < (uint64_t)count * kind.count; i++) {
                const float t = memory.results[i];
                if (t >= 0.0f && (open || t < kind.limit))
                    bake_note_hit(states, numbers[i / kind.count], open, (uint32_t)(i % kind.count),
                                  (float)((double)t * viewpoints->unit));
            }
        }
    }
}

int bake_native_workers_create(struct bsq_ctx *ctx, const struct bk_params *params,
                               struct bake_native_workers *out)
{
    const unsigned threads = bsq_threads(ctx);

    *out = (struct bake_native_workers){.results_each = native_results(params)};
    BSQ_PASS(BSQ_ALLOC(ctx, "results of rays", threads * out->results_each, &out->results));
    return BSQ_ALLOC(ctx, "streams of rays", threads, &out->streams);
}

void bake_native_workers_free(struct bsq_ctx *ctx, struct bake_native_workers *workers)
{
    BSQ_FREE(ctx, workers->streams, workers->results);
    *workers = (struct bake_native_workers){0};
}

struct bake_device_info bake_native_describe(const struct bsq_ctx *ctx)
{
    const long pages = sysconf(_SC_PHYS_PAGES), page_bytes = sysconf(_SC_PAGESIZE);
    const unsigned threads = bsq_threads(ctx);
    struct bake_device_info info = {.id = "cpu"};

    snprintf(info.name, sizeof info.name, "%u thread%s", threads, threads == 1 ? "" : "s");
    if (pages > 0 && page_bytes > 0)
        info.memory_bytes = (uint64_t)pages * (uint64_t)page_bytes;
    return info;
}

int bake_native_open(struct bsq_ctx *ctx, const struct bake_scene *scene, struct bake_native **out)
{
    struct bake_native *native;
    int status = BSQ_CALLOC(ctx, "native device", 1, &native);

    *out = NULL;
    if (status < 0)
        return status;
    native->ctx = ctx;
    bake_kernel_grid(scene->grid, &scene->params, &native->grid);
    native->params = scene->params;
    native->triangles = scene->triangles;
    native->patch = BSQ_SIMD_PICK(bsq_simd_best(), bake_native_patch);
    native->tree = scene->tree;
    if (scene->tree)
        status = bake_native_workers_create(ctx, &scene->params, &native->workers);
    if (status < 0)
        bake_native_close(native);
    else
        *out = native;
    return status;
}
