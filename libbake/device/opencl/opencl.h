/* opencl.h - OpenCL 1.2 devices. */
#ifndef BAKE_DEVICE_OPENCL_OPENCL_H
#define BAKE_DEVICE_OPENCL_OPENCL_H

#include "libbake/device/gpu/gpu.h"

extern const struct bake_driver bake_opencl_driver;
/* The driver's list(), for bisque-devices. */
void bake_opencl_list(struct bake_device_list *out);

#endif
