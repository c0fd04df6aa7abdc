/* cuda.h - NVIDIA GPUs as devices, through the driver API. Takes a job; gives texels.
 */
#ifndef BAKE_DEVICE_CUDA_CUDA_H
#define BAKE_DEVICE_CUDA_CUDA_H

#include "libbake/device/backend/backend.h"

extern const struct bake_device_kind bake_cuda_kind;
/* The kind's list(), for bisque-devices. */
void bake_cuda_list(struct bsq_ctx *ctx, struct bake_device_list *out);

#endif
