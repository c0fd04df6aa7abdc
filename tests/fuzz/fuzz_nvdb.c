/* fuzz_nvdb.c - fuzz target for grids: whatever opens can be looked up and traced, in bounds. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/grid_patch.h"

#include <math.h>
#include <string.h>

#include "libbake/device_internal.h"

static struct patched_grid patched;

/* Stand for those of base/map.c: the file is in memory already. */
int bsq_map_open(struct bsq_ctx *ctx, const char *path, struct bsq_map *out)
{
    (void)ctx;
    *out = (struct bsq_map){
        .data = patched.bytes, .size = patched.size, .path = (char *)(uintptr_t)path, .fd = -1};
    return 0;
}

int bsq_map_check(struct bsq_ctx *ctx, const struct bsq_map *map)
{
    (void)ctx;
    (void)map;
    return 0;
}

void bsq_map_close(struct bsq_ctx *ctx, struct bsq_map *map)
{
    (void)ctx;
    memset(map, 0, sizeof *map);
}

/* Voxels on the diagonal of the bounds and around them, with all that they refer to. */
static void look_up(const struct fmt_nvdb_grid *grid)
{
    for (int step = -2; step <= 34; step++) {
        int32_t at[3];
        for (int k = 0; k < 3; k++) {
            int64_t extent = (int64_t)grid->index_max[k] - grid->index_min[k];
            at[k] = (int32_t)(uint32_t)(grid->index_min[k] + extent * step / 32);
        }
        uint64_t value = fmt_nvdb_find(grid, at);
        require(value <= grid->voxel_count, "a value index out of range");
        if (!value)
            continue;
        fmt_nvdb_get(grid, value);
        uint64_t second = fmt_nvdb_second(grid, value);
        require(second < grid->record_count, "a second record out of range");
        if (second)
            fmt_nvdb_get(grid, second);
    }
}

static void trace_ray(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      const float origin[3], const float direction[3], float reach)
{
    struct bk_hit hit;
    bake_trace_ray(grid, params, origin, direction, -reach, reach, direction, &hit);
    if (!hit.found)
        return;
    require(isfinite(hit.t), "a hit at no distance");
    float length = 0;
    for (int k = 0; k < 3; k++) {
        length += hit.normal[k] * hit.normal[k];
        require(hit.color[k] >= 0.0f && hit.color[k] <= 1.001f, "a colour out of range");
    }
    require(fabsf(length - 1.0f) < 0.01f, "a normal that is not a unit vector");
}

/* Rays through the grid's ends and between them, along the axes and not. */
static void trace(const struct fmt_nvdb_grid *grid)
{
    static const float directions[][3] = {
        {0, 0, 1}, {0, -1, 0}, {1, 0, 0}, {0.6f, 0, -0.8f}, {0.36f, 0.48f, 0.8f}, {-0.57735f, 0.57735f, 0.57735f}};
    struct bk_params params = {.samples = 1};
    bake_params_from_grid(grid, &params);
    for (int step = 0; step <= 8; step++) {
        float at[3];
        for (int k = 0; k < 3; k++)
            at[k] = (float)(grid->index_min[k] +
                            ((double)grid->index_max[k] - grid->index_min[k]) * step / 8);
        params.flags = (params.flags & BK_HAS_COLOR) | (step & 1 ? BK_NEAREST : 0) | (step & 2 ? BK_TWO_SIDED : 0);
        for (size_t i = 0; i < sizeof directions / sizeof *directions; i++)
            trace_ray(grid, &params, at, directions[i], step % 3 ? 100.0f : 1e8f);
    }
}

static int use(struct bsq_ctx *ctx)
{
    struct fmt_nvdb_grid grid;
    int status = fmt_nvdb_open(ctx, "fuzz.nvdb", &grid);
    if (status)
        return status;
    look_up(&grid);
    status = bake_check_grid(ctx, &grid);
    if (status == 0)
        trace(&grid);
    if (status == 0 && patched.verify)
        status = fmt_nvdb_verify(ctx, &grid);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    grid_patch_apply(data, size, &patched);
    fuzz_in_context(use);
    grid_patch_revert(&patched);
    return 0;
}
