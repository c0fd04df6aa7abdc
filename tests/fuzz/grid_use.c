/* grid_use.c - what fuzz targets do with an open grid: lookups, rays and a patch. */
#include "tests/fuzz/grid_use.h"

#include <math.h>
#include <string.h>

#include "libbake/device/device.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/grid_lookup.h"

enum { SIDE = 6 }; /* texels of the patch that is traced */

struct patched_grid fuzzed_grid;

/* Replace the functions of base/map.c: the file is in memory already. */
int bsq_map_open(struct bsq_ctx *ctx, const char *path, struct bsq_map *out)
{
    (void)ctx;
    *out = (struct bsq_map){.data = fuzzed_grid.bytes,
                            .size = fuzzed_grid.size,
                            .path = (char *)(uintptr_t)path,
                            .fd = -1};
    return 0;
}

int bsq_map_file(struct bsq_ctx *ctx, struct bsq_file *file, struct bsq_map *out)
{
    return bsq_map_open(ctx, file->path, out);
}

int bsq_map_check(struct bsq_ctx *ctx, const struct bsq_map *map)
{
    (void)ctx;
    (void)map;
    return 0;
}

int bsq_map_explain(struct bsq_ctx *ctx, const struct bsq_map *map, int status)
{
    (void)ctx;
    (void)map;
    return status;
}

void bsq_map_close(struct bsq_ctx *ctx, struct bsq_map *map)
{
    (void)ctx;
    memset(map, 0, sizeof *map);
}

void grid_use_look_up(const struct fmt_nvdb_grid *grid)
{
    for (int step = -2; step <= 34; step++) {
        int32_t at[3];
        for (int k = 0; k < 3; k++) {
            int64_t extent = (int64_t)grid->index_max[k] - grid->index_min[k];
            at[k] = (int32_t)(uint32_t)(grid->index_min[k] + extent * step / 32);
        }
        uint64_t value = grid_find(grid, at);
        require(value <= grid->voxel_count, "a value index out of range");
        if (!value)
            continue;
        grid_get(grid, value);
        uint64_t second = fmt_nvdb_second(grid, value);
        require(second < grid->record_count, "a second record out of range");
        if (second)
            grid_get(grid, second);
    }
}

static void trace_ray(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      const float origin[3], const float direction[3], float reach)
{
    const struct bake_ray ray = {{origin[0], origin[1], origin[2]},
                                 {direction[0], direction[1], direction[2]}};
    struct bake_hit hit = {.triangle = BAKE_NO_HIT};
    const struct bake_ray_batch batch = {
        .rays = &ray, .hits = &hit, .count = 1, .t_min = -(double)reach, .t_max = (double)reach};
    bake_trace_rays(grid, params, 1, &batch, 0, 1);
    if (hit.triangle == BAKE_NO_HIT)
        return;
    require(isfinite(hit.t), "a hit at no distance");
    float length = 0;
    for (int k = 0; k < 3; k++) {
        length += hit.normal[k] * hit.normal[k];
        require(hit.color[k] >= 0.0f && hit.color[k] <= 1.001f, "a colour out of range");
    }
    require(fabsf(length - 1.0f) < 0.01f, "a normal that is not a unit vector");
}

void grid_use_trace(const struct fmt_nvdb_grid *grid)
{
    static const float directions[][3] = {
        {0, 0, 1},        {0, -1, 0},           {1, 0, 0},
        {0.6f, 0, -0.8f}, {0.36f, 0.48f, 0.8f}, {-0.57735f, 0.57735f, 0.57735f}};
    struct bk_params params = {.samples = 1};
    bake_params_from_grid(grid, &params);
    for (int step = 0; step <= 8; step++) {
        float at[3];
        for (int k = 0; k < 3; k++)
            at[k] = (float)(grid->index_min[k] +
                            ((double)grid->index_max[k] - grid->index_min[k]) * step / 8);
        params.flags = (params.flags & BK_HAS_COLOR) | (step & 1 ? BK_NEAREST : 0) |
                       (step & 2 ? BK_TWO_SIDED : 0);
        for (size_t i = 0; i < sizeof directions / sizeof *directions; i++)
            trace_ray(grid, &params, at, directions[i], step % 3 ? 100.0f : 1e8f);
    }
}

/* Makes a skew square through the middle of the grid, a little larger than it. Corner 0 of its two
 * triangles is at the lower or upper end. */
static void make_square(const struct fmt_nvdb_grid *grid, struct bk_triangle triangles[2])
{
    static const float u[3] = {0.8f, 0, 0.6f}, v[3] = {-0.36f, 0.8f, 0.48f},
                       normal[3] = {-0.48f, -0.6f, 0.64f};
    float size = 1;
    for (int k = 0; k < 3; k++)
        size = fmaxf(size, 0.6f * ((float)grid->index_max[k] - (float)grid->index_min[k]));
    for (int t = 0; t < 2; t++) {
        float sign = t ? -1.0f : 1.0f;
        struct bk_triangle *triangle = &triangles[t];
        *triangle = (struct bk_triangle){.b1 = {sign / SIDE, 0, 0}, .b2 = {0, sign / SIDE, 0}};
        triangle->x0 = triangle->y0 = t ? SIDE : 0;
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) {
                float middle = 0.5f * (float)grid->index_min[k] + 0.5f * (float)grid->index_max[k];
                float a = i == 1 ? sign : -sign, b = i == 2 ? sign : -sign;
                triangle->position[i][k] = middle + size * (a * u[k] + b * v[k]);
                triangle->direction[i][k] = triangle->normal[i][k] = normal[k];
                triangle->tangent[i][k] = u[k];
                triangle->tangent[i][3] = 1;
            }
    }
}

/* Makes the samples of a patch: both triangles, and a diagonal without any. */
static void make_samples(uint32_t samples[SIDE * SIDE])
{
    for (uint32_t i = 0; i < SIDE * SIDE; i++)
        samples[i] = i % SIDE == i / SIDE ? BK_NO_TRIANGLE : i % SIDE > i / SIDE;
}

static int trace_patch(struct bsq_ctx *ctx, const struct bake_scene *job, const uint32_t *samples,
                       float *texels)
{
    const struct bk_patch patch = {.width = SIDE, .height = SIDE};
    struct bake_device *device;
    int status = bake_device_open(ctx, "cpu", job, &device);
    if (status)
        return status;
    status = bake_device_trace(device, &patch, samples, texels, 0);
    bake_device_close(device);
    return status;
}

int grid_use_look_around(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct bk_triangle triangles[2];
    uint32_t samples[SIDE * SIDE];
    static float texels[SIDE * SIDE * (BK_SUMS + 3 + 8)];
    struct bake_scene job = {
        .grid = grid,
        .triangles = triangles,
        .triangle_count = 2,
        .patch_texels = SIDE * SIDE,
        .params = {.maps = BAKE_MAP_NORMAL | BAKE_MAP_AO | BAKE_MAP_BENT | BAKE_MAP_THICKNESS,
                   .samples = 1,
                   .unit = 1,
                   .front = 50,
                   .back = 1e7f,
                   .open_rays = 20,
                   .thickness_rays = 5,
                   .open_limit = BK_FAR,
                   .coarse = 3,
                   .thickness_limit = 1000,
                   .open_sine2 = 1}};
    const uint32_t floats = bk_texel_floats(job.params.maps);
    require(floats * SIDE * SIDE <= sizeof texels / sizeof *texels, "a texel of too many floats");
    make_square(grid, triangles);
    make_samples(samples);
    bake_params_from_grid(grid, &job.params);
    int status = trace_patch(ctx, &job, samples, texels);
    for (uint32_t i = 0; !status && i < SIDE * SIDE * floats; i++)
        require(isfinite(texels[i]), "a texel that is not finite");
    return status;
}

int grid_use_trace_patch(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct bk_triangle triangles[2];
    uint32_t samples[SIDE * SIDE];
    float texels[SIDE * SIDE * (BK_SUMS + 6 + 2 * BK_TRANSFER_VALUES)];
    const uint32_t transfers = grid->channels ? 2 : 0;
    const uint32_t floats = BK_SUMS + 6 + transfers * BK_TRANSFER_VALUES;
    /* The first value of a record, and the last one or the last three. */
    const uint32_t words[2] = {1, grid->channel_words < 3 ? (grid->channel_words - 1) << 2 | 1
                                                          : (grid->channel_words - 3) << 2 | 3};
    struct fmt_nvdb_grid used = *grid;
    struct bake_scene job = {.grid = &used,
                             .triangles = triangles,
                             .triangle_count = 2,
                             .patch_texels = SIDE * SIDE,
                             .params = {.maps = BAKE_MAP_NORMAL | BAKE_MAP_COLOR,
                                        .samples = 1,
                                        .unit = 1,
                                        .front = 50,
                                        .back = 1e7f}};
    job.params.maps |= transfers << BK_TRANSFER_SHIFT;
    used.transfers = words;
    used.transfer_count = transfers;
    make_square(grid, triangles);
    make_samples(samples);
    bake_params_from_grid(&used, &job.params);
    int status = trace_patch(ctx, &job, samples, texels);
    for (uint32_t i = 0; !status && i < SIDE * SIDE; i++) {
        const float *texel = texels + (size_t)i * floats;
        require(texel[BK_HITS] <= texel[BK_COVERED] && texel[BK_COVERED] <= 1,
                "more hits than samples");
        require(texel[BK_COVERED] == (samples[i] != BK_NO_TRIANGLE),
                "a sample that is not counted");
        for (int k = 0; k < 6; k++)
            require(fabsf(texel[BK_SUMS + k]) < 1.01f, "a texel out of range");
    }
    return status;
}
