/* cuda_devices.c - lists CUDA devices, and checks whether they can run the kernel. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/cuda/cuda.h"
#include "libbake/device/cuda/cuda_api.h"
#include "libbake/device/driver/driver.h"

const char bake_cuda_ptx[] =
#include "kernel_ptx.inc"
    ;

enum { LINE_BYTES = BAKE_CUDA_TEXT + 96 };
/* Returns why CUDA cannot be used, for messages. buffer: LINE_BYTES bytes. */
static const char *describe_state(const struct bake_cuda_api *api, enum bake_cuda_state state,
                                  CUresult code, char *buffer)
{
    const char *visible = getenv("CUDA_VISIBLE_DEVICES");
    char text[BAKE_CUDA_TEXT];

    if (state == BAKE_CUDA_NOT_INSTALLED)
        return "CUDA is not installed (libcuda.so.1, a part of NVIDIA's driver)";
    if (state == BAKE_CUDA_TOO_OLD)
        return "CUDA: NVIDIA's driver is too old; version 450 or later is needed";
    if (state == BAKE_CUDA_NO_GPU && !visible)
        return "CUDA has no devices";
    if (state == BAKE_CUDA_NO_GPU)
        snprintf(buffer, LINE_BYTES, "CUDA has no devices (CUDA_VISIBLE_DEVICES is \"%.80s\")",
                 visible);
    else
        snprintf(buffer, LINE_BYTES, "CUDA does not start: %s%s", bake_cuda_error(api, code, text),
                 code == CUDA_ERROR_NOT_INITIALIZED
                     ? "; a process cannot use CUDA after fork() if its parent did"
                     : "");
    return buffer;
}

/* Returns the compute capability that the PTX is for, as 10 * major + minor. */
static int kernel_capability(void)
{
    const char *target = strstr(bake_cuda_ptx, ".target sm_");
    return target ? atoi(target + strlen(".target sm_")) : 0;
}

static const char no_kernel[] =
    "this program was built without CUDA (neither clang nor nvcc was there)";

static int fail_absent(struct bsq_ctx *ctx, const struct bake_cuda_api *api, int64_t index,
                       int count)
{
    char there[400] = "";

    for (int i = 0; i < count; i++) {
        struct bake_cuda_device device;
        size_t used = strlen(there);
        if (bake_cuda_device(api, i, &device) == CUDA_SUCCESS)
            snprintf(there + used, sizeof there - used, "%s cuda:%d %s", i ? "," : "", i,
                     device.name);
    }
    return bsq_fail(ctx, BSQ_ENODEVICE, "there is no device cuda:%" PRId64 "; there is%s", index,
                    there);
}

int bake_cuda_choose(struct bsq_ctx *ctx, int64_t index, struct bake_cuda_api *api,
                     struct bake_cuda_device *out)
{
    char text[LINE_BYTES];
    enum bake_cuda_state state;
    CUresult code;
    int count;

    if (!bake_cuda_ptx[0])
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", no_kernel);
    state = bake_cuda_load(api, &count, &code);
    if (state != BAKE_CUDA_WORKS)
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", describe_state(api, state, code, text));
    if (index == BAKE_ANY_DEVICE)
        index = 0;
    if (index >= count)
        return fail_absent(ctx, api, index, count);
    code = bake_cuda_device(api, (int)index, out);
    if (code != CUDA_SUCCESS)
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s: cuDeviceGet: %s", out->name,
                        bake_cuda_error(api, code, text));
    if (out->capability < kernel_capability())
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s: compute capability %d.%d, the program needs %d.%d",
                        out->name, out->capability / 10, out->capability % 10,
                        kernel_capability() / 10, kernel_capability() % 10);
    return 0;
}

/* ---- listing ---- */

int bake_cuda_list(struct bsq_ctx *ctx, struct bake_device_list *out)
{
    struct bake_cuda_api api;
    char text[LINE_BYTES];
    CUresult code;
    int count, status = 0;
    enum bake_cuda_state state = bake_cuda_load(&api, &count, &code);

    if (state == BAKE_CUDA_NOT_INSTALLED || state == BAKE_CUDA_NO_GPU)
        return 0;
    if (state != BAKE_CUDA_WORKS)
        snprintf(out->warning, sizeof out->warning, "%s", describe_state(&api, state, code, text));
    else if (!bake_cuda_ptx[0])
        snprintf(out->warning, sizeof out->warning, "NVIDIA's driver is not used: %s", no_kernel);
    if (out->warning[0])
        return 0;
    for (int i = 0; i < count && status == 0; i++) {
        struct bake_device_info info = {.is_gpu = true};
        struct bake_cuda_device device;
        if (bake_cuda_device(&api, i, &device) != CUDA_SUCCESS)
            continue;
        info.memory_bytes = device.memory_bytes;
        snprintf(info.id, sizeof info.id, "cuda:%d", i);
        snprintf(info.name, sizeof info.name, "%s", device.name);
        status = bake_device_list_add(ctx, out, &info);
    }
    return status;
}
