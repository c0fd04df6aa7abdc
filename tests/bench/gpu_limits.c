/* gpu_limits.c - compares the time that the kernel takes with the least time that the bandwidth of
 * the GPU's memory allows. */
#define BK_COUNTERS
#include "tests/bench/gpu_limits.h"

#include <stdio.h>

#include "libbake/device/cuda/cuda_api.h"
#include "libbake/kernel/bk_sample.h"

enum { MEMORY_CLOCK_RATE = 36, GLOBAL_MEMORY_BUS_WIDTH = 37 }; /* attributes: kHz, bits */

enum { COUNTED = 4 }; /* one of this many rows of texels is counted */

static _Thread_local bk_counts counts;

bk_counts *bk_counts_of_thread(void)
{
    return &counts;
}

struct counter {
    const struct rays_scene *scene;
    bk_grid grid;
    bk_counts *workers;
};

static void add(bk_counts *to, const bk_counts *more)
{
    to->rays += more->rays;
    to->steps += more->steps;
    to->fetches += more->fetches;
    to->planes += more->planes;
    to->blends += more->blends;
}

/* Counts the work of a tile. Texels share no cache, as work items do not. */
static int count_tile(void *arg, const struct rays_tile *tile)
{
    struct counter *counter = arg;
    for (uint32_t row = 0; row < tile->tile.height; row += COUNTED)
        for (uint32_t column = 0; column < tile->tile.width; column++) {
            bk_cache cache = bk_cache_empty();
            float texel[BK_SUMS + 6];
            bk_clear_texel(counter->scene->job.params.maps, texel);
            bk_sample_texel(&counter->grid, &counter->scene->job.params, &cache,
                            counter->scene->triangles, &tile->tile, tile->sample_triangles, column,
                            row, 0, counter->scene->job.params.samples, texel);
        }
    add(&counter->workers[tile->worker], &counts);
    counts = (bk_counts){0};
    return 0;
}

static int count(struct rays_scene *scene, bk_counts *out)
{
    struct counter counter = {.scene = scene};
    int status = bsq_calloc(scene->ctx, "counts", bsq_threads(scene->ctx), sizeof *counter.workers,
                            &counter.workers);
    *out = (bk_counts){0};
    if (status < 0)
        return status;
    bake_kernel_grid(&scene->surface.scans->grid, &scene->job.params, &counter.grid);
    status = rays_for_tiles(scene, count_tile, &counter);
    for (unsigned w = 0; w < bsq_threads(scene->ctx); w++)
        add(out, &counter.workers[w]);
    bsq_free(scene->ctx, counter.workers);
    return status;
}

/* Returns the bandwidth of the first GPU's memory in bytes a second, computed from its clock and
 * bus width; 0 if they are not known. */
static double memory_bandwidth(void)
{
    struct bake_cuda_api api;
    struct bake_cuda_device device;
    char why[BAKE_WARNING_BYTES];
    bool faulty;
    int devices, khz = 0, bits = 0;
    if (!bake_cuda_load(&api, &devices, why, &faulty) ||
        bake_cuda_device(&api, 0, &device) != CUDA_SUCCESS ||
        api.cuDeviceGetAttribute(&khz, MEMORY_CLOCK_RATE, device.device) != CUDA_SUCCESS ||
        api.cuDeviceGetAttribute(&bits, GLOBAL_MEMORY_BUS_WIDTH, device.device) != CUDA_SUCCESS)
        return 0;
    return 2.0 * 1e3 * khz * bits / 8; /* two transfers a clock */
}

static double grid_bytes(const struct rays_scene *scene)
{
    struct bake_subgrid whole;
    double bytes = 0;
    bake_subgrid_whole(scene->job.grid, &scene->job.params, &whole);
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++)
        bytes += (double)whole.bytes[i];
    return bytes;
}

static void print_line(const char *what, double bytes, double bandwidth, double seconds)
{
    printf("| %s | %.3f ", what, 1e-9 * bytes);
    if (bandwidth > 0)
        printf("| %.2f | %.1f |\n", 1e3 * bytes / bandwidth, seconds * bandwidth / bytes);
    else
        printf("| - | - |\n");
}

/* Returns the bytes of the grid that rays read: two words a node, a word a step, two words of a
 * leaf and a record a plane, and four words of leaves and eight records a blend. */
static double bytes_read(const bk_counts *c, bool color)
{
    const double record = 8, word = 8;
    return (double)c->fetches * 2 * word + (double)c->steps * word +
           (double)c->planes * (2 * word + record) +
           (double)c->blends * (4 * word + 8 * (record + (color ? 4 : 0)));
}

int gpu_limits_print(struct rays_scene *scene, double kernel_seconds)
{
    const double bandwidth = memory_bandwidth(), pairs = (double)scene->count;
    const double texels = pairs / (scene->samples * scene->samples);
    const double tiles =
        pairs * sizeof(uint32_t) + texels * bk_texel_floats(scene->job.params.maps) * sizeof(float);
    bk_counts c;
    int status = count(scene, &c);
    if (status < 0)
        return status;
    const double read =
        bytes_read(&c, scene->job.params.flags & BK_HAS_COLOR) / (double)c.rays * pairs;
    printf("%.1f million ray pairs; each %.2f steps, %.2f nodes looked up, %.2f planes, %.2f "
           "blends. Kernels took %.1f ms. ",
           1e-6 * pairs, (double)c.steps / (double)c.rays, (double)c.fetches / (double)c.rays,
           (double)c.planes / (double)c.rays, (double)c.blends / (double)c.rays,
           1e3 * kernel_seconds);
    if (bandwidth > 0)
        printf("The GPU's memory moves %.0f GB/s.\n\n", 1e-9 * bandwidth);
    else
        printf("The GPU does not tell the bandwidth of its memory.\n\n");
    puts("| bytes | GB | ms at that | times that long |\n|---|---|---|---|");
    print_line("the grid, samples and texels once", grid_bytes(scene) + tiles, bandwidth,
               kernel_seconds);
    print_line("all that rays read, as if there were no caches", read + tiles, bandwidth,
               kernel_seconds);
    puts("");
    return 0;
}
