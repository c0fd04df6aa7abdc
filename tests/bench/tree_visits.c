/* tree_visits.c - counts the nodes and blocks that secondary rays visit in the tree of a grid, as
 * the kernel for GPUs does it: compiled as C, and by an OpenCL device such as PoCL. All numbers
 * must agree. Prints a table in Markdown.
 *
 *   tree-visits SCAN.nvdb LOW.obj SIZE RAYS     SIZE: of the map in texels, with a sample each */
#define BK_COUNT            4096
#define BK_COUNT_DEFINITION "#define BK_COUNT 4096\n"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/context.h"
#include "libbake/device/opencl/opencl_api.h"
#include "libbake/kernel/bk_sample.h"
#include "tests/bench/rays.h"

static const char kernel_source[] = BK_COUNT_DEFINITION
#include "kernel_source.inc"
    ;

struct visits {
    struct rays_scene scene;
    struct bake_tree tree;
    struct bk_params params;
    struct bk_grid grid;
    bk_viewpoint *points;
    uint32_t count;
    float *values[2]; /* of C and of the device, RAYS a point */
};

/* Stores the viewpoints of a patch. */
static int store_points(void *arg, const struct rays_patch *patch)
{
    struct visits *v = arg;
    const bk_batch batch = {0, patch->patch.height, 0, patch->patch.width, 0, 1};
    const bk_looks looks = {BK_POINTS, v->points + v->count, NULL};
    bk_cache cache = bk_cache_empty();
    for (uint32_t y = 0; y < patch->patch.height; y++)
        for (uint32_t x = 0; x < patch->patch.width; x++)
            bk_sample_texel(&v->grid, &v->params, &cache, v->scene.triangles, &patch->patch, &batch,
                            patch->sample_triangles, x, y, &looks, patch->texels);
    v->count += patch->patch.width * patch->patch.height;
    return 0;
}

static void visit_in_c(const struct visits *v, uint32_t rays)
{
    for (uint32_t p = 0; p < v->count; p++)
        for (uint32_t r = 0; r < rays; r++)
            bk_look_from(&v->grid, &v->params, &v->points[p], r,
                         &v->values[0][(uint64_t)p * rays + r]);
}

/* ---- the device ---- */

struct device {
    struct bake_opencl_api api;
    struct bake_opencl_device info;
    cl_context context;
    cl_command_queue queue;
    cl_program program;
    cl_kernel kernel;
    cl_int code; /* of the first failure */
    cl_uint arguments;
};

static void note_code(struct device *d, cl_int code)
{
    d->code = d->code ? d->code : code;
}

static void give_value(struct device *d, size_t bytes, const void *value)
{
    note_code(d, d->api.clSetKernelArg(d->kernel, d->arguments++, bytes, value));
}

/* Makes a buffer with a copy of data the next argument. An empty one is never read. */
static cl_mem give_buffer(struct device *d, const void *data, uint64_t bytes)
{
    cl_int code;
    cl_mem memory = d->api.clCreateBuffer(d->context, CL_MEM_READ_WRITE, bytes + 8, NULL, &code);
    note_code(d, code);
    if (!d->code && bytes > 0)
        note_code(d, d->api.clEnqueueWriteBuffer(d->queue, memory, CL_TRUE, 0, bytes, data, 0, NULL,
                                                 NULL));
    give_value(d, sizeof memory, &memory);
    return memory;
}

static void open_device(struct device *d)
{
    const char *source = kernel_source;
    cl_int code;
    d->context = d->api.clCreateContext(NULL, 1, &d->info.id, NULL, NULL, &code);
    note_code(d, code);
    d->queue = d->api.clCreateCommandQueue(d->context, d->info.id, 0, &code);
    note_code(d, code);
    d->program = d->api.clCreateProgramWithSource(d->context, 1, &source, NULL, &code);
    note_code(d, code);
    note_code(d, d->api.clBuildProgram(d->program, 1, &d->info.id, "-cl-std=CL1.2", NULL, NULL));
    d->kernel = d->api.clCreateKernel(d->program, "bake_look", &code);
    note_code(d, code);
}

/* Returns the code of a call that failed, 0 if none did. All ends with the process. */
static cl_int visit_on_device(const struct visits *v, uint32_t rays, struct device *d)
{
    const uint64_t bytes = (uint64_t)v->count * rays * sizeof(float);
    const size_t size[2] = {rays, v->count};
    struct bake_grid_arrays grid;
    bake_list_arrays(&v->scene.job, &grid);
    open_device(d);
    for (int i = 0; i < BAKE_GRID_ARRAYS && !d->code; i++) /* colours are not read */
        give_buffer(d, grid.arrays[i].ranges[0].data, grid.arrays[i].ranges[0].bytes);
    give_value(d, sizeof grid.params, &grid.params);
    give_buffer(d, v->points, v->count * sizeof *v->points);
    give_value(d, sizeof v->count, &v->count);
    const cl_mem found = give_buffer(d, v->values[1], bytes);
    if (!d->code)
        note_code(d, d->api.clEnqueueNDRangeKernel(d->queue, d->kernel, 2, NULL, size, NULL, 0,
                                                   NULL, NULL));
    if (!d->code)
        note_code(d, d->api.clEnqueueReadBuffer(d->queue, found, CL_TRUE, 0, bytes, v->values[1], 0,
                                                NULL, NULL));
    return d->code;
}

/* ---- the table ---- */

/* Prints a row for the rays of a map. device: what it says of the device. */
static void print_visits(const struct visits *v, const char *map, uint32_t rays, const char *device)
{
    uint64_t traced = 0, nodes = 0, blocks = 0;
    for (uint64_t i = 0; i < (uint64_t)v->count * rays; i++) {
        const uint32_t value = (uint32_t)v->values[0][i];
        traced += v->points[i / rays].side != 0.0f;
        nodes += value % BK_COUNT;
        blocks += value / BK_COUNT;
    }
    printf("| %s | %.3f | %.2f | %.2f | %s |\n", map, 1e-6 * (double)traced,
           (double)nodes / (double)traced, (double)blocks / (double)traced, device);
}

static int measure_visits(struct visits *v, uint32_t size, uint32_t map, const char *name)
{
    struct bsq_ctx *ctx = v->scene.ctx;
    struct device d = {.code = 0};
    int status;
    v->params.maps = map;
    v->scene.job.params = v->params;
    v->count = 0;
    const uint32_t rays = bk_ray_count(&v->params);
    const uint64_t points = (uint64_t)size * size;
    BSQ_TRY(BSQ_CALLOC(ctx, "points", points, &v->points));
    for (int i = 0; i < 2; i++)
        BSQ_TRY(BSQ_CALLOC(ctx, "visits", points * rays, &v->values[i]));
    BSQ_TRY(rays_for_patches(&v->scene, store_points, v));
    visit_in_c(v, rays);
    if (!bake_opencl_load(&d.api) || !bake_opencl_device(&d.api, 0, &d.info)) {
        print_visits(v, name, rays, "there is no OpenCL device");
        goto done;
    }
    if (visit_on_device(v, rays, &d))
        status = bsq_fail(ctx, BSQ_ENODEVICE, "%s: OpenCL error %d", d.info.name, d.code);
    else if (memcmp(v->values[0], v->values[1], points * rays * sizeof(float)) != 0)
        status = bsq_fail(ctx, BSQ_EBUG, "%s visits other nodes or blocks", d.info.name);
    else
        print_visits(v, name, rays, d.info.name);
done:
    BSQ_FREE(ctx, v->points, v->values[0], v->values[1]);
    return status;
}

int main(int argc, char **argv)
{
    static struct visits v;
    const struct bsq_ctx_options options = {.threads = 1};
    struct bsq_ctx *ctx;
    int status;
    if (argc != 5 || bsq_ctx_create(&options, &ctx) < 0) {
        fputs("usage: tree-visits SCAN.nvdb LOW.obj SIZE RAYS\n", stderr);
        return 64;
    }
    const uint32_t size = (uint32_t)atoi(argv[3]);
    BSQ_TRY(rays_open(ctx, argv[1], argv[2], size, 1, &v.scene));
    BSQ_TRY(bake_tree_build(ctx, v.scene.job.grid, &v.tree));
    v.scene.job.tree = &v.tree;
    v.params = v.scene.job.params;
    v.params.open_rays = v.params.thickness_rays = (uint32_t)atoi(argv[4]);
    bake_params_from_grid(v.scene.job.grid, &v.params);
    v.params.flags &= ~(bk_uint)(BK_HAS_COLOR | BK_HAS_IDS);
    bake_kernel_grid(v.scene.job.grid, &v.params, &v.grid);
    v.grid.nodes = (const bk_ulong2 *)(const void *)v.tree.nodes;
    v.grid.blocks = &v.tree.blocks[0][0];
    puts(
        "| map | million rays | nodes a ray | blocks a ray | the same on |\n|:--|--:|--:|--:|:--|");
    BSQ_TRY(measure_visits(&v, size, 1u << BK_MAP_ao, "ao"));
    BSQ_TRY(measure_visits(&v, size, 1u << BK_MAP_thickness, "thickness"));
done:
    if (status < 0)
        fprintf(stderr, "tree-visits: %s\n", bsq_error(ctx));
    bake_tree_free(ctx, &v.tree);
    rays_close(&v.scene);
    bsq_ctx_destroy(ctx);
    return status < 0;
}
