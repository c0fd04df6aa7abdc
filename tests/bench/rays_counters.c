/* rays_counters.c - prints the work per ray pair, as a kernel built with BK_COUNTERS counts it on
 * one thread. With RAYS, each hit sends so many rays, whose work is added to that of its pair. */
#include <stdio.h>
#include <stdlib.h>

#include "libbake/kernel/bk_grid.h"
#include "tests/bench/rays.h"

static bk_counts counts;

bk_counts *bk_counts_of_thread(void)
{
    return &counts;
}

static void print(const char *name, uint64_t count)
{
    printf("%s=%.4f\n", name, (double)count / (double)counts.rays);
}

int main(int argc, char **argv)
{
    struct bsq_ctx *ctx;
    struct rays_scene scene;
    struct bake_device *device = NULL;
    struct rays_cost cost;
    if (argc != 5 && argc != 6) {
        fputs("usage: bench-rays-counters SCAN.nvdb LOW.obj SIZE SAMPLES [RAYS]\n", stderr);
        return 64;
    }
    if (bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &ctx) < 0)
        return 71;
    int status =
        rays_open(ctx, argv[1], argv[2], (uint32_t)atoi(argv[3]), (uint32_t)atoi(argv[4]), &scene);
    if (argc == 6) {
        scene.job.params.maps = BAKE_MAP_NORMAL | BAKE_MAP_AO;
        scene.job.params.open_rays = (bk_uint)atoi(argv[5]);
        scene.job.params.open_limit = BK_FAR;
        scene.job.params.open_sine2 = 1.0f;
        scene.job.params.open_coarse = BAKE_AO_COARSE;
    }
    if (status == 0)
        status = bake_device_open(ctx, "cpu", &scene.job, &device);
    counts = (bk_counts){0};
    if (status == 0)
        status = rays_trace(&scene, device, &cost);
    if (status < 0) {
        fprintf(stderr, "bench-rays-counters: %s\n", bsq_error(ctx));
    } else {
        printf("rays=%llu\n", (unsigned long long)counts.rays);
        print("steps", counts.steps);
        print("skips", counts.skips);
        print("fetches", counts.fetches);
        print("planes", counts.planes);
        print("blends", counts.blends);
        print("packets", counts.packets);
        print("rounds", counts.rounds);
    }
    bake_device_close(device);
    rays_close(&scene);
    bsq_ctx_destroy(ctx);
    return -status;
}
