/* gpu_trace.c - measures how long the kernel takes on an NVIDIA GPU: compared with the limit of its
 * memory, for several numbers of registers and shapes of blocks. Prints tables in Markdown. Each
 * line is the better of two runs over the whole map; checksums must be the same. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "libbake/device/cuda/cuda.h"
#include "tests/bench/gpu_limits.h"

struct measured {
    double kernels, wall, open;
    uint64_t launches, checksum;
};

/* Opens a device, traces the map twice, and keeps the faster run. */
static int measure(struct rays_scene *scene, const struct bake_cuda_tuning *tuning,
                   struct measured *out)
{
    struct bake_device *device;
    struct bake_device_times before, after;
    struct rays_cost cost;
    int status;

    scene->job.cuda_tuning = tuning;
    status = bake_device_open(scene->ctx, "cuda", &scene->job, &device);
    if (status < 0)
        return status;
    bake_device_times(device, &before);
    *out = (struct measured){.kernels = 1e30, .open = before.upload};
    for (int run = 0; run < 2 && status == 0; run++) {
        status = rays_trace(scene, device, &cost);
        bake_device_times(device, &after);
        if (after.kernels - before.kernels < out->kernels) {
            out->kernels = after.kernels - before.kernels;
            out->launches = after.launches - before.launches;
            out->wall = cost.wall;
            out->checksum = cost.checksum;
        }
        before = after;
    }
    bake_device_close(device);
    return status;
}

static int measure_default(struct rays_scene *scene)
{
    struct measured m;
    int status = measure(scene, NULL, &m);
    return status < 0 ? status : gpu_limits_print(scene, m.kernels);
}

static int measure_all(struct rays_scene *scene)
{
    static const unsigned registers[] = {0, 168, 128, 96, 80, 64};
    static const unsigned blocks[][2] = {{8, 4}, {8, 8}, {8, 16}, {16, 2}, {16, 8}, {32, 4}};
    struct measured m;
    int status = 0;

    printf("| registers | block | kernels, ms | ray pairs, 10^9/s | calls | trace, s | upload, s | "
           "checksum |\n"
           "|---|---|---|---|---|---|---|---|\n");
    for (size_t r = 0; r < sizeof registers / sizeof *registers; r++)
        for (size_t b = 0; b < sizeof blocks / sizeof *blocks && status == 0; b++) {
            const struct bake_cuda_tuning tuning = {.registers = registers[r],
                                                    .block_width = blocks[b][0],
                                                    .block_height = blocks[b][1]};
            status = measure(scene, &tuning, &m);
            if (status == 0)
                printf("| %u | %u x %u | %.1f | %.3f | %" PRIu64 " | %.3f | %.3f | %016" PRIx64
                       " |\n",
                       tuning.registers, tuning.block_width, tuning.block_height, 1e3 * m.kernels,
                       1e-9 * (double)scene->count / m.kernels, m.launches, m.wall, m.open,
                       m.checksum);
            fflush(stdout);
        }
    return status;
}

int main(int argc, char **argv)
{
    struct bsq_ctx *ctx;
    struct rays_scene scene;
    int status;

    if (argc != 5) {
        fputs("usage: bench-gpu-trace SCAN.nvdb LOW.obj SIZE SAMPLES\n", stderr);
        return 64;
    }
    if (bsq_ctx_create(NULL, &ctx) < 0)
        return 71;
    status =
        rays_open(ctx, argv[1], argv[2], (uint32_t)atoi(argv[3]), (uint32_t)atoi(argv[4]), &scene);
    if (status == 0)
        status = measure_default(&scene);
    if (status == 0)
        status = measure_all(&scene);
    if (status < 0)
        fprintf(stderr, "bench-gpu-trace: %s\n", bsq_error(ctx));
    rays_close(&scene);
    bsq_ctx_destroy(ctx);
    return -status;
}
