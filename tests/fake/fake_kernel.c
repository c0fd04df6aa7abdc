/* fake_kernel.c - the fake driver's modules and launches. They run the kernel that is compiled as
 * C. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/kernel/bk_sample.h"
#include "tests/fake/fake_cuda_internal.h"

/* Sizes of a launch's arguments. */
static const size_t argument_bytes[] = {
    8, 8, 8, 8, 8, 8, 8, 8, 8, sizeof(bk_params), sizeof(bk_patch), 4, 4, 4, 4, 8, 8};
enum { ARGUMENTS = sizeof argument_bytes / sizeof argument_bytes[0] };

/* Returns the addresses of the kernel's arguments. */
static void place_arguments(struct arguments *a, void *to[ARGUMENTS])
{
    void *const places[ARGUMENTS] = {
        &a->arrays[0], &a->arrays[1],  &a->arrays[2], &a->arrays[3], &a->arrays[4], &a->arrays[5],
        &a->arrays[6], &a->arrays[7],  &a->arrays[8], &a->params,    &a->patch,     &a->first_row,
        &a->end_row,   &a->first_line, &a->end_line,  &a->samples,   &a->texels};

    memcpy(to, places, sizeof places);
}

#define ARRAY(type, n) ((const type *)fake_device_memory(a->arrays[n], 1))

static void run_c(const struct work *work)
{
    const struct arguments *a = &work->arguments;
    const unsigned width = work->grid[0] * work->block[0];
    const unsigned height = work->grid[1] * work->block[1];
    const bk_uint *samples = fake_device_memory(a->samples, 1);
    float *texels = fake_device_memory(a->texels, 1);
    bk_grid grid;

    bk_grid_from_params(&grid, &a->params);
    grid.tiles = ARRAY(bk_ulong, 0);
    grid.uppers = ARRAY(bk_ulong, 1);
    grid.lowers = ARRAY(bk_ulong, 2);
    grid.leaves = ARRAY(bk_ulong, 3);
    grid.normals = ARRAY(bk_uint, 4);
    grid.planes = ARRAY(bk_uint, 5);
    grid.srgb = a->arrays[6] ? ARRAY(float, 6) : NULL;
    grid.transfers = a->arrays[6] ? ARRAY(bk_uint, 6) + 256 : NULL;
    grid.colors = a->arrays[6] ? grid.transfers + bk_transfers(a->params.maps) : NULL;
    grid.seconds = ARRAY(bk_uint, 7);
    for (bk_uint y = 0; y < height; y++)
        for (bk_uint x = 0; x < width; x++) {
            bk_cache cache = bk_cache_empty();
            bk_uint row = a->first_row + y;
            float *to =
                texels + ((size_t)row * a->patch.width + x) * bk_texel_floats(a->params.maps);
            if (x >= a->patch.width || row >= a->end_row)
                continue;
            if (a->first_line == 0)
                bk_clear_texel(a->params.maps, to);
            bk_sample_texel(&grid, &a->params, &cache, ARRAY(bk_triangle, 8), &a->patch, samples, x,
                            row, a->first_line, a->end_line, to);
        }
}

void fake_run_kernel(const struct work *work)
{
    const struct arguments *a = &work->arguments;

    run_c(work);
    if (fake.sample_seconds > 0) {
        uint64_t lines = (uint64_t)(a->end_row - a->first_row) * (a->end_line - a->first_line);
        pthread_mutex_lock(&fake.lock);
        fake.virtual_now +=
            fake.sample_seconds * (double)(lines * a->patch.width * a->params.samples);
        pthread_mutex_unlock(&fake.lock);
    }
}

/* Returns whether the entry's parameters have the sizes of argument_bytes. */
static int entry_fits(const char *kernel)
{
    const char *at = strstr(kernel, ".entry bake_patch(");
    const char *end = at ? strchr(at, ')') : NULL;

    for (int i = 0; i < ARGUMENTS; i++) {
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
        if (bytes != argument_bytes[i])
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
    if (!target || atoi(target + strlen(".target sm_")) > fake.capability || !entry_fits(text)) {
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
    *function = (CUfunction)module;
    return strcmp(name, "bake_patch") == 0 ? CUDA_SUCCESS : NOT_FOUND;
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
    struct arguments *a = &work.arguments;
    void *to[ARGUMENTS];

    BEGIN_IN_CONTEXT;
    if (!function || grid_x * grid_y != grid_x * grid_y * grid_z ||
        block_x * block_y * block_z > 1024 || block_x * block_y * block_z % 32 != 0 ||
        grid_y > 65535 || shared_bytes || extra)
        return INVALID_VALUE;
    place_arguments(a, to);
    for (int i = 0; i < ARGUMENTS; i++)
        memcpy(to[i], parameters[i], argument_bytes[i]);
    for (int i = 0; i < 9; i++)
        work.used[work.use_count++] = a->arrays[i];
    work.used[work.use_count++] = a->samples;
    work.used[work.use_count++] = a->texels;
    work.written = 1;
    if (!take_local_memory())
        return CUDA_ERROR_OUT_OF_MEMORY;
    return fake_append(stream, &work);
}
