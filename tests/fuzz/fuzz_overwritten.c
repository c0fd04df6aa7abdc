/* fuzz_overwritten.c - fuzz target for grids that change after they were opened: whatever the bytes
 * become, nothing outside of the grid's arrays is read, and every loop ends. */
#include <stdlib.h>
#include <string.h>

#include "libbake/device/device.h"
#include "libbake/device/native/native_code.h"
#include "libbake/device/subgrid/subgrid.h"
#include "libbake/kernel/bk_grid.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/grid_use.h"

enum { SIDE = 4, TEXELS = SIDE * SIDE, SUMS = BK_SUMS + 6 };

static const uint8_t *input;
static size_t input_size;

/* An array on a device, with its exact size, so that the sanitizer sees accesses beyond it. */
struct array {
    char *data;
    uint64_t used, bytes;
};

static int put(void *arg, const void *data, uint64_t bytes)
{
    struct array *array = arg;
    require(bytes <= array->bytes - array->used, "more bytes than an array has");
    memcpy(array->data + array->used, data, bytes);
    array->used += bytes;
    return 0;
}

static void load(const struct bake_subgrid *subgrid, struct array arrays[BAKE_SUBGRID_ARRAYS])
{
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++) {
        arrays[i] = (struct array){.bytes = subgrid->bytes[i]};
        arrays[i].data = malloc(arrays[i].bytes + !arrays[i].bytes);
        require(arrays[i].data != NULL, "no memory for an array");
        bake_subgrid_send(subgrid, i, put, &arrays[i]);
        require(arrays[i].used == arrays[i].bytes, "an array that was not filled");
    }
}

static struct bk_grid grid_of(const struct array a[BAKE_SUBGRID_ARRAYS],
                              const struct bk_params *params)
{
    struct bk_grid grid;
    bk_grid_from_params(&grid, params);
    grid.tiles = (const void *)a[BAKE_TILES].data;
    grid.uppers = (const void *)a[BAKE_UPPERS].data;
    grid.lowers = (const void *)a[BAKE_LOWERS].data;
    grid.leaves = (const void *)a[BAKE_LEAVES].data;
    grid.normals = (const void *)a[BAKE_NORMALS].data;
    grid.planes = (const void *)a[BAKE_PLANES].data;
    grid.srgb = (const void *)a[BAKE_COLORS].data;
    grid.colors = (const bk_uint *)(const void *)a[BAKE_COLORS].data + 256;
    grid.seconds = (const void *)a[BAKE_SECONDS].data;
    return grid;
}

/* Traces a patch whose rays run through the whole grid, as a device with its own memory does. */
static void trace_subgrid(const struct bake_job *job, const struct bake_subgrid *subgrid)
{
    const struct bk_patch patch = {.width = SIDE, .height = SIDE};
    const uint32_t samples[TEXELS] = {0};
    float texels[TEXELS][SUMS];
    struct array arrays[BAKE_SUBGRID_ARRAYS];
    load(subgrid, arrays);
    const struct bk_grid grid = grid_of(arrays, &subgrid->params);
    bake_native_patch_base(&grid, &subgrid->params, job->triangles, &patch, 0, SIDE, samples,
                           &(struct bake_native_memory){0}, texels[0]);
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++)
        free(arrays[i].data);
}

/* A set of lower nodes, as a visitor fills it. */
struct lowers {
    struct bsq_ctx *ctx;
    struct bake_lower_set set;
};

static int add_lower(void *arg, uint32_t lower, const int32_t origin[3])
{
    struct lowers *lowers = arg;
    (void)origin;
    return bake_lower_set_add(lowers->ctx, &lowers->set, lower);
}

/* Adds half of the grid to a set, and all of it, for subgrids of every shape. */
static int trace_parts(struct bsq_ctx *ctx, const struct bake_job *job)
{
    const struct fmt_nvdb_grid *grid = job->grid;
    struct lowers lowers = {.ctx = ctx};
    int status = bake_lower_set_create(ctx, grid, &lowers.set);
    for (int part = 2; part > 0 && status == 0; part--) {
        struct bake_subgrid subgrid = {0};
        int32_t high[3];
        for (int k = 0; k < 3; k++)
            high[k] = (int32_t)(grid->index_min[k] +
                                ((int64_t)grid->index_max[k] - grid->index_min[k]) / part);
        status = bake_visit_nodes(grid, grid->index_min, high, add_lower, &lowers);
        if (status == 0)
            status = bake_subgrid_create(ctx, &lowers.set, &job->params, &subgrid);
        if (status == 0)
            trace_subgrid(job, &subgrid);
        bake_subgrid_free(ctx, &subgrid);
    }
    bake_lower_set_free(ctx, &lowers.set);
    return status;
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

static int trace_devices(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct bk_triangle triangle;
    struct bake_subgrid whole;
    struct bake_job job = {.grid = grid,
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
    bake_subgrid_whole(grid, &job.params, &whole);
    trace_subgrid(&job, &whole);
    return trace_parts(ctx, &job);
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
        status = trace_devices(ctx, &grid);
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
