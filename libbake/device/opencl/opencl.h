/* opencl.h - OpenCL 1.2 devices. Takes a job; gives texels. */
#ifndef BAKE_DEVICE_OPENCL_OPENCL_H
#define BAKE_DEVICE_OPENCL_OPENCL_H

#include "libbake/device/backend/backend.h"

extern const struct bake_device_kind bake_opencl_kind;
/* The kind's list(), for bisque-devices. */
void bake_opencl_list(struct bsq_ctx *ctx, struct bake_device_list *out);

#endif
