/* fake_kernel.c - the fake driver's modules and launches. They run the kernel that is compiled as
 * C. */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/kernel/bk_meet.h"
#include "libbake/kernel/bk_sample.h"
#include "tests/fake/fake_cuda_internal.h"

enum { ARGUMENTS_MAX = 19 };

/* The kernels, and the places of their arguments in struct arguments. */
#define PLACE(member)                                                                              \
    {                                                                                              \
        offsetof(struct arguments, member), sizeof((struct arguments *)0)->member                  \
    }
#define PLACES_OF_ARRAYS                                                                           \
    PLACE(arrays[0]), PLACE(arrays[1]), PLACE(arrays[2]), PLACE(arrays[3]), PLACE(arrays[4]),      \
        PLACE(arrays[5]), PLACE(arrays[6]), PLACE(arrays[7]), PLACE(arrays[8]), PLACE(arrays[9])
static const struct kernel {
    const char *name, *entry;
    struct {
        size_t at, bytes;
    } places[ARGUMENTS_MAX];
} kernels[] = {{"bake_patch",
                ".entry bake_patch(",
                {PLACES_OF_ARRAYS, PLACE(params), PLACE(triangles), PLACE(patch), PLACE(batch),
                 PLACE(stage), PLACE(samples), PLACE(points), PLACE(found), PLACE(texels)}},
               {"bake_look",
                ".entry bake_look(",
                {PLACES_OF_ARRAYS, PLACE(params), PLACE(points), PLACE(point_count), PLACE(found)}},
               {"bake_rays",
                ".entry bake_rays(",
                {PLACES_OF_ARRAYS, PLACE(params), PLACE(rays), PLACE(samples), PLACE(texels)}},
               {"bake_meet",
                ".entry bake_meet(",
                {PLACE(area), PLACE(params), PLACE(point_count), PLACE(texels)}},
               {"bake_first",
                ".entry bake_first(",
                {PLACE(area), PLACE(place), PLACE(limits), PLACE(point_count), PLACE(texels)}}};
enum { KERNELS = sizeof kernels / sizeof *kernels };

#define ARRAY(type, address) ((address) ? (type *)fake_device_memory(address, 1) : NULL)

static void set_grid(const struct arguments *a, bk_grid *grid)
{
    bk_grid_from_params(grid, &a->params);
    grid->root_tiles = ARRAY(const bk_ulong, a->arrays[0]);
    grid->uppers = ARRAY(const bk_ulong, a->arrays[1]);
    grid->lowers = ARRAY(const bk_ulong, a->arrays[2]);
    grid->leaves = ARRAY(const bk_ulong, a->arrays[3]);
    grid->normals = ARRAY(const bk_uint, a->arrays[4]);
    grid->planes = ARRAY(const bk_uint, a->arrays[5]);
    grid->srgb = ARRAY(const float, a->arrays[6]);
    grid->transfers = a->arrays[6] ? ARRAY(const bk_uint, a->arrays[6]) + 256 : NULL;
    grid->colors = a->arrays[6] ? grid->transfers + bk_transfers(a->params.maps) : NULL;
    grid->seconds = ARRAY(const bk_uint, a->arrays[7]);
    grid->nodes = ARRAY(const bk_ulong2, a->arrays[8]);
    grid->blocks = ARRAY(const bk_ulong, a->arrays[9]);
}

/* Does what bake_patch() does for a work item. */
static void run_texel(const struct arguments *a, const bk_grid *grid, bk_uint x, bk_uint y)
{
    const bk_looks looks = {a->stage, ARRAY(bk_viewpoint, a->points), ARRAY(float, a->found)};
    const bk_uint column = a->batch.first_column + x, row = a->batch.first_row + y;
    float *texel = ARRAY(float, a->texels) +
                   ((size_t)row * a->patch.width + column) * bk_texel_floats(a->params.maps);
    bk_cache cache = bk_cache_empty();

    if (column >= a->batch.end_column || row >= a->batch.end_row)
        return;
    if (a->batch.first_line == 0 && a->stage != BK_POINTS)
        bk_clear_texel(a->params.maps, texel);
    bk_sample_texel(grid, &a->params, &cache, ARRAY(const bk_triangle, a->triangles), &a->patch,
                    &a->batch, ARRAY(const bk_uint, a->samples), column, row, &looks, texel);
}

/* Does what bake_look() does for a work item. */
static void run_ray(const struct arguments *a, const bk_grid *grid, bk_uint ray, bk_uint point)
{
    const bk_uint rays = bk_ray_count(&a->params);

    if (ray < rays && point < a->point_count)
        bk_look_from(grid, &a->params, ARRAY(const bk_viewpoint, a->points) + point, ray,
                     ARRAY(float, a->found) + (size_t)point * rays + ray);
}

/* Does what bake_rays() does for a work item. */
static void run_single(const struct arguments *a, const bk_grid *grid, bk_uint x, bk_uint y)
{
    const size_t ray = (size_t)y * a->rays.columns + x;

    if (x < a->rays.columns && ray < a->rays.count)
        bk_trace_single(grid, &a->params, &a->rays, ARRAY(float, a->samples) + ray * BK_RAY_FLOATS,
                        ARRAY(float, a->texels) + ray * BK_HIT_FLOATS);
}

/* Does what bake_meet() does for a work item. */
static void meet_ray(const struct arguments *a, bk_uint ray, bk_uint point)
{
    const size_t count = a->point_count, words = 2 * (size_t)bk_state_words(&a->params),
                 lengths = bk_state_lengths(&a->params);
    bk_uint *hidden = ARRAY(bk_uint, a->texels), *distances = hidden + count * words;

    if (ray < bk_ray_count(&a->params) && point < count)
        bk_meet_from(ARRAY(const bk_float4, a->area), &a->params,
                     (const bk_viewpoint *)(const void *)(distances + count * lengths) + point, ray,
                     hidden + point * words, (float *)(void *)distances + point * lengths);
}

/* Does what bake_first() does for a work item. */
static void meet_first(const struct arguments *a, bk_uint x, bk_uint y)
{
    const size_t count = a->point_count, ray = 32 * (size_t)y + x;
    bk_first_hit *hits = ARRAY(bk_first_hit, a->texels);

    if (x < 32 && ray < count)
        bk_meet_first(ARRAY(const bk_float4, a->area) + (size_t)a->place * BK_CHUNK_UNIT,
                      &a->limits, (const bk_first_ray *)(const void *)(hits + count) + ray,
                      hits + ray);
}

static void run_c(const struct work *work)
{
    const struct arguments *a = &work->arguments;
    const unsigned width = work->grid[0] * work->block[0];
    const unsigned height = work->grid[1] * work->block[1];
    bk_grid grid;

    set_grid(a, &grid);
    for (bk_uint y = 0; y < height; y++)
        for (bk_uint x = 0; x < width; x++)
            if (a->kernel == 0)
                run_texel(a, &grid, x, y);
            else if (a->kernel == 3)
                meet_ray(a, x, y);
            else if (a->kernel == 4)
                meet_first(a, x, y);
            else if (a->kernel == 1)
                run_ray(a, &grid, x, y);
            else
                run_single(a, &grid, x, y);
}

void fake_run_kernel(const struct work *work)
{
    const struct arguments *a = &work->arguments;

    run_c(work);
    if (fake.sample_seconds > 0) {
        const bk_batch *b = &a->batch;
        uint64_t samples = (uint64_t)(b->end_row - b->first_row) *
                           (b->end_column - b->first_column) * (b->end_line - b->first_line) *
                           a->params.samples;
        pthread_mutex_lock(&fake.lock);
        fake.virtual_now += fake.sample_seconds * (double)samples;
        pthread_mutex_unlock(&fake.lock);
    }
}

/* Returns whether a kernel's parameters have the sizes of its arguments. */
static int entry_fits(const char *text, const struct kernel *kernel)
{
    const char *at = strstr(text, kernel->entry);
    const char *end = at ? strchr(at, ')') : NULL;

    for (int i = 0; i < ARGUMENTS_MAX && kernel->places[i].bytes > 0; i++) {
        char type[8], declaration[200] = "";
        size_t bytes = 1;
        if (!at || !(at = strstr(at, ".param ")) || at > end)
            return 0;
        at += strlen(".param ");
        sscanf(at, "%199[^,)]", declaration);
        if (sscanf(declaration, ".align %*d .b8 %*[^[][%zu", &bytes) == 1)
            ;
        else if (sscanf(declaration, ".u%7[0-9]", type) == 1)
            bytes = strtoul(type, NULL, 10) / 8;
        if (bytes != kernel->places[i].bytes)
            return 0;
    }
    at = strstr(at, ".param ");
    return !at || at > end;
}

CUresult cuModuleLoadDataEx(CUmodule *module, const void *image, unsigned count,
                            CUjit_option *options, void **values)
{
    const char *text = image, *target = strstr(text, ".target sm_");
    char *log = NULL;

    BEGIN_IN_CONTEXT;
    for (unsigned i = 0; i < count; i++)
        if (options[i] == CU_JIT_ERROR_LOG_BUFFER)
            log = values[i];
    bool fits = target && atoi(target + strlen(".target sm_")) <= fake.capability;
    for (int i = 0; i < KERNELS; i++)
        fits = fits && entry_fits(text, &kernels[i]);
    if (!fits) {
        if (log)
            strcpy(log, "ptxas fatal\nnot for this GPU");
        return INVALID_PTX;
    }
    *module = (CUmodule)&fake;
    fake_count_live(1);
    return CUDA_SUCCESS;
}

CUresult cuModuleUnload(CUmodule module)
{
    NEED_CONTEXT;
    fake_count_live(-1);
    return module ? CUDA_SUCCESS : INVALID_HANDLE;
}

CUresult cuModuleGetFunction(CUfunction *function, CUmodule module, const char *name)
{
    BEGIN_IN_CONTEXT;
    for (int i = 0; module && i < KERNELS; i++)
        if (strcmp(name, kernels[i].name) == 0) {
            *function = (CUfunction)(uintptr_t)&kernels[i];
            return CUDA_SUCCESS;
        }
    return NOT_FOUND;
}

/* Takes memory for spilled registers at the first launch, and advances the clock. */
static bool take_local_memory(void)
{
    bool taken = true;

    if (fake.local_bytes == 0) {
        fake.local_bytes = fake.memory_bytes / 32;
        taken = fake_take_bytes(fake.local_bytes);
        pthread_mutex_lock(&fake.lock);
        fake.virtual_now += 3600 * fake.hours;
        pthread_mutex_unlock(&fake.lock);
    }
    return taken;
}

CUresult cuLaunchKernel(CUfunction function, unsigned grid_x, unsigned grid_y, unsigned grid_z,
                        unsigned block_x, unsigned block_y, unsigned block_z, unsigned shared_bytes,
                        CUstream stream, void **parameters, void **extra)
{
    struct work work = {.kind = LAUNCH, .grid = {grid_x, grid_y}, .block = {block_x, block_y}};
    const struct kernel *kernel = (const struct kernel *)function;
    struct arguments *a = &work.arguments;

    BEGIN_IN_CONTEXT;
    if (!function || grid_x * grid_y != grid_x * grid_y * grid_z ||
        block_x * block_y * block_z > 1024 || block_x * block_y * block_z % 32 != 0 ||
        grid_y > 65535 || shared_bytes || extra)
        return INVALID_VALUE;
    for (int i = 0; i < ARGUMENTS_MAX && kernel->places[i].bytes > 0; i++)
        memcpy((char *)a + kernel->places[i].at, parameters[i], kernel->places[i].bytes);
    a->kernel = (int)(kernel - kernels);
    for (int i = 0; i < GRID_ARRAYS; i++)
        work.used[work.use_count++] = a->arrays[i];
    work.used[work.use_count++] = a->area;
    work.used[work.use_count++] = a->triangles;
    work.used[work.use_count++] = a->samples;
    work.used[work.use_count++] = a->points;
    work.used[work.use_count++] = a->found;
    work.used[work.use_count++] = a->texels;
    work.written = 3;
    if (!take_local_memory())
        return CUDA_ERROR_OUT_OF_MEMORY;
    return fake_append(stream, &work);
}
