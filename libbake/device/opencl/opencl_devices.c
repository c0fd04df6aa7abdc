/* opencl_devices.c - lists OpenCL devices. */
#include <stdio.h>

#include "libbake/device/opencl/opencl.h"
#include "libbake/device/opencl/opencl_api.h"

int bake_opencl_list(struct bsq_ctx *ctx, struct bake_device_list *out)
{
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    bool loaded = bake_opencl_load(&api);
    int status = 0;

    for (uint32_t i = 0; loaded && status == 0 && bake_opencl_device(&api, i, &device); i++) {
        struct bake_device_info info = {.memory_bytes = device.memory_bytes,
                                        .is_gpu = device.is_gpu};
        snprintf(info.id, sizeof info.id, "opencl:%u", (unsigned)i);
        snprintf(info.name, sizeof info.name, "%s", device.name);
        status = bake_device_list_add(ctx, out, &info);
    }
    return status;
}
