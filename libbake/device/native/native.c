/* native.c - the kernel as C on the calling thread: the reference for all other devices. */
#include "libbake/device/backend.h"

#include <assert.h>
#include <stdio.h>
#include <unistd.h>

#include "libbake/kernel/bk_sample.h"
#include "libbake/device/native/native.h"

_Static_assert(sizeof(struct bk_triangle) == 152, "layout shared with devices");
_Static_assert(sizeof(struct bk_texel) == 32, "layout shared with devices");
_Static_assert(sizeof(struct bk_tile) == 16, "layout shared with devices");
_Static_assert(sizeof(struct bk_params) == 88, "layout shared with devices");

enum { SAMPLES_A_CHECK = 1 << 18 };

struct native {
    struct bake_backend base;
    struct bsq_ctx *ctx;
    struct bk_grid grid;
    struct bk_params params;
    const struct bk_triangle *triangles;
    bake_native_tile *tile;
};

int bake_check_grid(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    for (int k = 0; k < 3; k++)
        if (grid->index_min[k] < -BAKE_INDEX_LIMIT || grid->index_max[k] >= BAKE_INDEX_LIMIT)
            return bsq_fail(
                ctx, BSQ_EDATA,
                "%s: voxels from index %d to %d along %c: rays reach those from %d to %d",
                grid->map.path, grid->index_min[k], grid->index_max[k], "xyz"[k], -BAKE_INDEX_LIMIT,
                BAKE_INDEX_LIMIT - 1);
    return 0;
}

/* AVX-512 comes with much lower clocks in its first processors; those that have VBMI2 are later. */
bake_native_tile *bake_native_code(unsigned lanes)
{
#if defined(__x86_64__)
    if (lanes == 16)
        return __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
                       __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vbmi2")
                   ? bake_native_tile_16
                   : NULL;
    if (lanes == 8)
        return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") ? bake_native_tile_8
                                                                                : NULL;
#endif
    return lanes == 4 ? bake_native_tile_4 : NULL;
}

static bake_native_tile *widest_code(void)
{
    unsigned lanes = 16;

    while (!bake_native_code(lanes))
        lanes /= 2;
    return bake_native_code(lanes);
}

static void split(uint64_t value, bk_uint words[2])
{
    words[0] = (bk_uint)value;
    words[1] = (bk_uint)(value >> 32);
}

void bake_params_from_grid(const struct fmt_nvdb_grid *grid, struct bk_params *params)
{
    assert(grid->upper_bytes == BK_UPPER_WORDS * 8 && grid->lower_bytes == BK_LOWER_WORDS * 8);
    for (int k = 0; k < 3; k++) {
        params->index_min[k] = grid->index_min[k];
        params->index_max[k] = grid->index_max[k];
    }
    params->tile_count = grid->tile_count;
    params->upper_count = grid->upper_count;
    params->lower_count = grid->lower_count;
    params->leaf_count = grid->leaf_count;
    params->second_base_low = (bk_uint)(grid->voxel_count + 1);
    params->second_base_high = (bk_uint)((grid->voxel_count + 1) >> 32);
    split((uint64_t)(grid->uppers - grid->root), params->upper_offset);
    split((uint64_t)(grid->lowers - grid->uppers), params->lower_offset);
    split((uint64_t)(grid->leaves - grid->lowers), params->leaf_offset);
    params->flags &= ~(bk_uint)BK_HAS_COLOR;
    if (grid->colors)
        params->flags |= BK_HAS_COLOR;
}

void bake_native_grid(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      struct bk_grid *out)
{
    bk_grid_from_params(out, params);
    out->tiles = (const bk_ulong *)(const void *)grid->tiles;
    out->uppers = (const bk_ulong *)(const void *)grid->uppers;
    out->lowers = (const bk_ulong *)(const void *)grid->lowers;
    out->leaves = (const bk_ulong *)(const void *)grid->leaves;
    out->normals = grid->normals;
    out->planes = grid->planes;
    out->colors = grid->colors;
    out->seconds = &grid->seconds[0][0];
}

void bake_trace_ray(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                    const float origin[3], const float direction[3], float t_min, float t_max,
                    const float facing[3], struct bk_hit *hit)
{
    struct bk_grid native;
    struct bk_cache cache = bk_cache_empty();

    const bk_vec3w d = bk_v3w(direction[0], direction[1], direction[2]);
    const bk_lines line = {.count = 1,
                           .origin = bk_v3w(origin[0], origin[1], origin[2]),
                           .direction = d,
                           .facing = bk_v3w(facing[0], facing[1], facing[2]),
                           .t_min = t_min,
                           .t_max = t_max};
    bk_hits hits;

    bake_native_grid(grid, params, &native);
    bk_trace(&native, params, &cache, &line, &hits);
    *hit = (struct bk_hit){.found = hits.found,
                           .t = hits.t,
                           .normal = {hits.normal.x, hits.normal.y, hits.normal.z},
                           .color = {hits.color.x, hits.color.y, hits.color.z}};
}

/* A tile can have many millions of samples, so it is traced in bands of whole squares of texels, or
 * of single rows, and an interruption is noticed between them. */
static uint32_t band_rows(uint64_t row_samples)
{
    const uint64_t rows = SAMPLES_A_CHECK / row_samples;
    return rows >= BAKE_NATIVE_SQUARE ? (uint32_t)(rows - rows % BAKE_NATIVE_SQUARE) : 1;
}

static int native_trace(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                        const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker,
                        char *why)
{
    struct native *native = (struct native *)backend;
    const uint64_t texel_samples = (uint64_t)native->params.samples * native->params.samples;
    const uint32_t rows = band_rows(tile->width * texel_samples);

    (void)slot;
    (void)worker;
    (void)why;
    for (uint32_t row = 0; row < tile->height; row += rows) {
        const uint64_t texel = (uint64_t)row * tile->width;
        struct bk_tile band = *tile;
        int status = bsq_check(native->ctx);
        if (status < 0)
            return status;
        band.y += row;
        band.height = tile->height - row < rows ? tile->height - row : rows;
        native->tile(&native->grid, &native->params, native->triangles, &band,
                     sample_triangles + texel * texel_samples, texels + texel);
    }
    return 0;
}

static void native_close(struct bake_backend *backend)
{
    bsq_free(((struct native *)backend)->ctx, backend);
}

void bake_native_info(struct bsq_ctx *ctx, struct bake_device_info *info)
{
    long pages = sysconf(_SC_PHYS_PAGES), page_bytes = sysconf(_SC_PAGESIZE);
    unsigned threads = bsq_threads(ctx);

    *info = (struct bake_device_info){.id = "cpu"};
    snprintf(info->name, sizeof info->name, "%u thread%s", threads, threads == 1 ? "" : "s");
    if (pages > 0 && page_bytes > 0)
        info->memory_bytes = (uint64_t)pages * (uint64_t)page_bytes;
}

int bake_native_open(struct bsq_ctx *ctx, const struct bake_job *job, struct bake_backend **out)
{
    struct bake_device_info info;
    struct native *native;
    int status = bsq_calloc(ctx, "native device", 1, sizeof *native, &native);

    if (status < 0)
        return status;
    bake_native_info(ctx, &info);
    snprintf(native->base.name, sizeof native->base.name, "cpu, %.100s", info.name);
    native->base.trace = native_trace;
    native->base.close = native_close;
    native->ctx = ctx;
    bake_native_grid(job->grid, &job->params, &native->grid);
    native->params = job->params;
    native->triangles = job->triangles;
    native->tile = widest_code();
    *out = &native->base;
    return 0;
}
