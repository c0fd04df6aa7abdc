/* fuzz_overwritten.c - fuzz target for grids that change after they were opened: whatever the bytes
 * become, nothing outside of the grid's arrays is read, and every loop ends. */
#include <stdlib.h>
#include <string.h>

#include "libbake/device/device.h"
#include "libbake/device/native/native_code.h"
#include "libbake/kernel/bk_grid.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/grid_use.h"

enum { SIDE = 4, TEXELS = SIDE * SIDE, SUMS = BK_SUMS + 6 };

static const uint8_t *input;
static size_t input_size;

/* Copies the arrays, each with its exact size, so that the sanitizer sees accesses beyond it. */
static void load(const struct bake_grid_arrays *grid, char *arrays[BAKE_GRID_ARRAYS])
{
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        const struct bake_grid_array *array = &grid->arrays[i];
        uint64_t at = 0;
        arrays[i] = malloc(array->bytes + !array->bytes);
        require(arrays[i] != NULL, "no memory for an array");
        for (int k = 0; k < BAKE_ARRAY_RANGES; k++) {
            if (array->ranges[k].bytes > 0)
                memcpy(arrays[i] + at, array->ranges[k].data, array->ranges[k].bytes);
            at += array->ranges[k].bytes;
        }
        require(at == array->bytes, "an array that was not filled");
    }
}

static struct bk_grid grid_of(char *const a[BAKE_GRID_ARRAYS], const struct bk_params *params)
{
    struct bk_grid grid;
    bk_grid_from_params(&grid, params);
    grid.root_tiles = (const void *)a[BAKE_ROOT_TILES];
    grid.uppers = (const void *)a[BAKE_UPPERS];
    grid.lowers = (const void *)a[BAKE_LOWERS];
    grid.leaves = (const void *)a[BAKE_LEAVES];
    grid.normals = (const void *)a[BAKE_NORMALS];
    grid.planes = (const void *)a[BAKE_PLANES];
    grid.srgb = (const void *)a[BAKE_COLORS];
    grid.colors = (const bk_uint *)(const void *)a[BAKE_COLORS] + 256;
    grid.seconds = (const void *)a[BAKE_SECONDS];
    return grid;
}

/* Traces a patch whose rays run through the whole grid, as a device with its own memory does. */
static void trace_arrays(const struct bake_scene *job)
{
    const struct bk_patch patch = {.width = SIDE, .height = SIDE};
    const uint32_t samples[TEXELS] = {0};
    float texels[TEXELS][SUMS];
    char *arrays[BAKE_GRID_ARRAYS];
    struct bake_grid_arrays list;
    bake_list_arrays(job, &list);
    load(&list, arrays);
    const struct bk_grid grid = grid_of(arrays, &list.params);
    bake_native_patch_base(&grid, &list.params, job->triangles, &patch, 0, SIDE, samples,
                           &(struct bake_native_memory){0}, texels[0]);
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++)
        free(arrays[i]);
}

/* Makes a triangle of which a patch's rays start at the grid's lowest corner. */
static void aim(const struct fmt_nvdb_grid *grid, struct bk_triangle *triangle)
{
    *triangle = (struct bk_triangle){.b1 = {1.0f / SIDE, 0, 0}, .b2 = {0, 1.0f / SIDE, 0}};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const float extent = (float)grid->index_max[k] - (float)grid->index_min[k];
            triangle->position[i][k] = (float)grid->index_min[k] + (i == k ? extent : 0);
            triangle->direction[i][k] = triangle->normal[i][k] = 1;
            triangle->tangent[i][k] = k == 0;
        }
}

static void trace_device(const struct fmt_nvdb_grid *grid)
{
    struct bk_triangle triangle;
    struct bake_scene job = {.grid = grid,
                             .triangles = &triangle,
                             .triangle_count = 1,
                             .patch_texels = TEXELS,
                             .params = {.maps = BAKE_MAP_NORMAL | BAKE_MAP_COLOR,
                                        .samples = 1,
                                        .unit = 1,
                                        .front = 1e4f,
                                        .back = 1e4f}};
    aim(grid, &triangle);
    bake_params_from_grid(grid, &job.params);
    trace_arrays(&job);
}

static int use(struct bsq_ctx *ctx)
{
    struct fmt_nvdb_grid grid;
    int status = fmt_nvdb_open(ctx, "fuzz.nvdb", &grid);
    require(status == 0, bsq_error(ctx));
    grid_patch_overwrite(input, input_size, &fuzzed_grid);
    grid_use_look_up(&grid);
    grid_use_trace(&grid);
    status = grid_use_trace_patch(ctx, &grid);
    if (status == 0)
        trace_device(&grid);
    if (status == 0 && fuzzed_grid.verify)
        status = fmt_nvdb_verify(ctx, &grid);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input = data;
    input_size = size;
    grid_patch_begin(data, size, &fuzzed_grid);
    fuzz_in_context(use);
    grid_patch_revert(&fuzzed_grid);
    return 0;
}
