/* cuda_driver.c - loads libcuda, lists its devices, and names errors. */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/cuda/cuda.h"
#include "libbake/device/cuda/cuda_api.h"
#include "libbake/device/driver/driver.h"

const char bake_cuda_ptx[] =
#include "kernel_ptx.inc"
    ;

const char bake_cuda_no_kernel[] =
    "this program was built without CUDA (neither clang nor nvcc was there)";

/* Opens the driver. If the linker does not know its directory, opens the PTX compiler beside it
 * too: the driver later asks for the compiler by name alone. */
static void *cuda_driver_open_driver(void)
{
    const char *directories[] = {NULL, NULL}, *unused;
    const int flags = RTLD_NOW | RTLD_LOCAL;
    void *library =
        bake_driver_library("libcuda.so.1", flags, bake_driver_directories, &directories[0]);
    if (directories[0])
        bake_driver_library("libnvidia-ptxjitcompiler.so.1", flags, directories, &unused);
    return library;
}

static bool load_functions(void *library, struct bake_cuda_api *api)
{
#define LOAD(name, symbol, parameters)                                                             \
    *(void **)&api->name = dlsym(library, #symbol);                                                \
    if (!api->name)                                                                                \
        return false;
    BAKE_CUDA_FUNCTIONS(LOAD)
#undef LOAD
    return true;
}

bool bake_cuda_load(struct bake_cuda_api *api, int *count, char *why, bool *faulty)
{
    const char *visible = getenv("CUDA_VISIBLE_DEVICES");
    void *library = cuda_driver_open_driver();
    char text[BAKE_CUDA_TEXT];
    *count = 0;
    *faulty = library != NULL;
    if (!library || !load_functions(library, api)) {
        snprintf(why, BAKE_WARNING_BYTES, "%s",
                 library ? "CUDA: NVIDIA's driver is too old; version 450 or later is needed"
                         : "CUDA is not installed (libcuda.so.1, a part of NVIDIA's driver)");
        return false;
    }
    CUresult code = api->cuInit(0);
    if (code == CUDA_SUCCESS)
        code = api->cuDeviceGetCount(count);
    *faulty = code != CUDA_SUCCESS && code != CUDA_ERROR_NO_DEVICE;
    if (*faulty)
        snprintf(why, BAKE_WARNING_BYTES, "CUDA does not start: %s%s",
                 bake_cuda_error(api, code, text),
                 code == CUDA_ERROR_NOT_INITIALIZED
                     ? "; a process cannot use CUDA after fork() if its parent did"
                     : "");
    else if (*count == 0 && visible)
        snprintf(why, BAKE_WARNING_BYTES, "CUDA has no devices (CUDA_VISIBLE_DEVICES is \"%.80s\")",
                 visible);
    else if (*count == 0)
        snprintf(why, BAKE_WARNING_BYTES, "CUDA has no devices");
    return code == CUDA_SUCCESS && *count > 0;
}

const char *bake_cuda_error(const struct bake_cuda_api *api, CUresult code, char *buffer)
{
    const char *name = NULL, *text = NULL;
    if (api->cuGetErrorName(code, &name) != CUDA_SUCCESS || !name)
        snprintf(buffer, BAKE_CUDA_TEXT, "CUDA error %d", code);
    else if (api->cuGetErrorString(code, &text) != CUDA_SUCCESS || !text)
        snprintf(buffer, BAKE_CUDA_TEXT, "%s", name);
    else
        snprintf(buffer, BAKE_CUDA_TEXT, "%s (%s)", name, text);
    return buffer;
}

CUresult bake_cuda_device(const struct bake_cuda_api *api, int index, struct bake_cuda_device *out)
{
    int major = 0, minor = 0;
    size_t bytes = 0;
    CUresult code;
    memset(out, 0, sizeof *out);
    code = api->cuDeviceGet(&out->device, index);
    if (code == CUDA_SUCCESS)
        code = api->cuDeviceGetName(out->name, sizeof out->name - 1, out->device);
    if (code == CUDA_SUCCESS)
        code = api->cuDeviceTotalMem(&bytes, out->device);
    if (code == CUDA_SUCCESS)
        code = api->cuDeviceGetAttribute(&major, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR,
                                         out->device);
    if (code == CUDA_SUCCESS)
        code = api->cuDeviceGetAttribute(&minor, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR,
                                         out->device);
    out->capability = 10 * major + minor;
    out->memory_bytes = bytes;
    return code;
}

void bake_cuda_list(struct bake_device_list *out)
{
    struct bake_cuda_api api = {0};
    char text[BAKE_CUDA_TEXT];
    int count;
    const bool works = bake_cuda_load(&api, &count, out->why, &out->faulty);
    if (!bake_cuda_ptx[0]) {
        out->faulty = works;
        snprintf(out->why, sizeof out->why, "%s", bake_cuda_no_kernel);
    }
    for (int i = 0; works && bake_cuda_ptx[0] && i < count && i < BAKE_DEVICES_MAX; i++) {
        struct bake_device_info *info = &out->devices[out->count];
        struct bake_cuda_device device;
        const CUresult code = bake_cuda_device(&api, i, &device);
        snprintf(info->id, sizeof info->id, "cuda:%d", i);
        snprintf(info->name, sizeof info->name, "%s", device.name);
        info->memory_bytes = device.memory_bytes;
        info->is_gpu = true;
        out->count += code == CUDA_SUCCESS;
        if (code == CUDA_SUCCESS)
            continue;
        out->faulty = true;
        snprintf(out->why, sizeof out->why, "%s: cuDeviceGet: %s", info->id,
                 bake_cuda_error(&api, code, text));
    }
}
