/* gpu_limits.h - how far the kernel is from the limit that the bandwidth of a GPU's memory sets. */
#ifndef BENCH_GPU_LIMITS_H
#define BENCH_GPU_LIMITS_H

#include "tests/bench/rays.h"

/* Counts the bytes that the scene's rays read, on the processor. Prints the time that moving them
 * takes on the first CUDA device, and the time that the kernels took. The rays must have been
 * traced before. */
int gpu_limits_print(struct rays_scene *scene, double kernel_seconds);

#endif
