/* opencl_devices.c - lists OpenCL devices. Asks drivers in a child process, since some crash. */
#include <dlfcn.h>
#include <stdio.h>

#include "libbake/device/driver/driver.h"
#include "libbake/device/opencl/opencl.h"
#include "libbake/device/opencl/opencl_api.h"

static void ask(struct bake_probe_pipe *replies)
{
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    bool loaded = bake_opencl_load(&api);

    for (uint32_t i = 0; loaded && bake_opencl_device(&api, i, &device); i++) {
        struct bake_device_info info = {.memory_bytes = device.memory_bytes,
                                        .is_gpu = device.is_gpu};
        snprintf(info.id, sizeof info.id, "opencl:%u", (unsigned)i);
        snprintf(info.name, sizeof info.name, "%s", device.name);
        bake_probe_send_device(replies, &info);
    }
}

static int list(struct bsq_ctx *ctx, void (*fn)(void *arg, const struct bake_device_info *device),
                void *arg)
{
    return bake_probe(ctx, "OpenCL", ask, fn, arg);
}

static void count_device(void *arg, const struct bake_device_info *info)
{
    (void)info;
    ++*(uint32_t *)arg;
}

static int check(struct bsq_ctx *ctx)
{
    uint32_t count = 0;
    int status = list(ctx, count_device, &count);

    if (status < 0 || count > 0)
        return status;
    if (!dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL))
        return bsq_fail(ctx, BSQ_ENODEVICE, "OpenCL is not installed (libOpenCL.so.1)");
    return bsq_fail(ctx, BSQ_ENODEVICE,
                    "OpenCL has no devices (no driver that works is installed)");
}

/* A search for the first GPU with a number above `after`. */
struct gpu_search {
    int64_t next, after, found;
};

static void search_gpu(void *arg, const struct bake_device_info *info)
{
    struct gpu_search *search = arg;

    if (info->is_gpu && search->found < 0 && search->next > search->after)
        search->found = search->next;
    search->next++;
}

static int64_t next_gpu(struct bsq_ctx *ctx, int64_t after)
{
    struct gpu_search search = {.after = after, .found = -1};
    int status = list(ctx, search_gpu, &search);

    return status < 0 ? status : search.found;
}

const struct bake_device_kind bake_opencl_kind = {
    .name = "opencl", .open = bake_opencl_open, .list = list, .next_gpu = next_gpu, .check = check};
