/* gpu_limits.h - how far the kernel is from what a GPU's memory allows. */
#ifndef BENCH_GPU_LIMITS_H
#define BENCH_GPU_LIMITS_H

#include "tests/bench/rays.h"

/* Counts the work of the scene's rays, which were traced before, on the processor and prints what
 * moving its bytes takes on the first CUDA device, beside what kernels took. */
int gpu_limits_print(struct rays_scene *scene, double kernel_seconds);

#endif
