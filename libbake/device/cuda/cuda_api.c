/* cuda_api.c - loads libcuda, describes its devices, names its errors. */
#include "libbake/device/cuda/cuda_api.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

#include "libbake/device/driver/driver.h"

/* Opens the driver. If the linker does not know its directory, opens the PTX compiler beside it
 * too: the driver later asks for the compiler by name alone. */
static void *open_driver(void)
{
    const char *directories[] = {NULL, NULL}, *unused;
    const int flags = RTLD_NOW | RTLD_LOCAL;
    void *library =
        bake_driver_library("libcuda.so.1", flags, bake_driver_directories, &directories[0]);

    if (directories[0])
        bake_driver_library("libnvidia-ptxjitcompiler.so.1", flags, directories, &unused);
    return library;
}

enum bake_cuda_state bake_cuda_load(struct bake_cuda_api *api, int *count, CUresult *code)
{
    void *library = open_driver();

    *count = 0;
    *code = CUDA_SUCCESS;
    if (!library)
        return BAKE_CUDA_NOT_INSTALLED;
#define LOAD(name, symbol, parameters)                                                             \
    *(void **)&api->name = dlsym(library, #symbol);                                                \
    if (!api->name)                                                                                \
        return BAKE_CUDA_TOO_OLD;
    BAKE_CUDA_FUNCTIONS(LOAD)
#undef LOAD
    *code = api->cuInit(0);
    if (*code == CUDA_SUCCESS)
        *code = api->cuDeviceGetCount(count);
    if (*code == CUDA_ERROR_NO_DEVICE || (*code == CUDA_SUCCESS && *count == 0))
        return BAKE_CUDA_NO_GPU;
    return *code == CUDA_SUCCESS ? BAKE_CUDA_WORKS : BAKE_CUDA_BROKEN;
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
