/* rays.c - how many ray pairs a second each device traces. */
#include <stdio.h>
#include <stdlib.h>

#include "tests/bench/rays.h"

int main(int argc, char **argv)
{
    struct bsq_ctx *ctx;
    struct rays_scene scene;
    if (argc < 5) {
        fputs("usage: bench-rays SCAN.nvdb LOW.obj SIZE THREADS [DEVICE]\n", stderr);
        return 64;
    }
    if (bsq_ctx_create(&(struct bsq_ctx_options){.threads = (unsigned)atoi(argv[4])}, &ctx) < 0)
        return 71;
    int status = rays_open(ctx, argv[1], argv[2], (uint32_t)atoi(argv[3]), 2, &scene);
    struct bake_device *device = NULL;
    if (status == 0)
        status = bake_device_open(ctx, argc > 5 ? argv[5] : "cpu", &scene.job, &device);
    struct rays_cost cost;
    if (status == 0)
        status = rays_trace(&scene, device, &cost);
    if (status < 0)
        fprintf(stderr, "%s\n", bsq_error(ctx));
    else
        printf("%s: %llu pairs, %llu hits, wall %.3f cpu %.3f: %.2f M pairs/s a core, %016llx\n",
               bake_device_name(device), (unsigned long long)scene.count,
               (unsigned long long)cost.hits, cost.wall, cost.processor,
               (double)scene.count * 1e-6 / cost.processor, (unsigned long long)cost.checksum);
    bake_device_close(device);
    rays_close(&scene);
    bsq_ctx_destroy(ctx);
    return -status;
}
