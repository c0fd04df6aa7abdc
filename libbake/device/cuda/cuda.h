/* cuda.h - NVIDIA GPUs as devices, through the driver API. Takes a job and subgrids; gives texels.
 */
#ifndef BAKE_DEVICE_CUDA_CUDA_H
#define BAKE_DEVICE_CUDA_CUDA_H

#include "libbake/device/backend/backend.h"

extern const struct bake_device_kind bake_cuda_kind;
/* The kind's list(), for bisque-devices. */
void bake_cuda_list(struct bsq_ctx *ctx, struct bake_device_list *out);

/* How kernels are launched. Benchmarks compare other values with the default. */
struct bake_cuda_tuning {
    unsigned registers;                 /* limit for a thread; 0: the compiler's choice */
    unsigned block_width, block_height; /* threads; a multiple of 32 together, at most 1024 */
};

#endif
