/* cuda.h - NVIDIA GPUs as devices, through the driver API. */
#ifndef BAKE_DEVICE_CUDA_CUDA_H
#define BAKE_DEVICE_CUDA_CUDA_H

#include "libbake/device/gpu/gpu.h"

extern const struct bake_driver bake_cuda_driver;
/* The driver's list(), for bisque-devices. */
void bake_cuda_list(struct bake_device_list *out);

#endif
