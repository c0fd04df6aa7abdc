/* cuda_driver.c - loads libcuda, lists its devices and checks whether they can run the kernel, and
 * names errors. */
#include <dlfcn.h>
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

static const char no_kernel[] =
    "this program was built without CUDA (neither clang nor nvcc was there)";

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
    void *library = open_driver();
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

void bake_cuda_list(struct bsq_ctx *ctx, struct bake_device_list *out)
{
    struct bake_cuda_api api = {0};
    char text[BAKE_CUDA_TEXT];
    int count;

    (void)ctx;
    const bool works = bake_cuda_load(&api, &count, out->why, &out->faulty);
    if (!bake_cuda_ptx[0]) {
        out->faulty = works;
        snprintf(out->why, sizeof out->why, "%s", no_kernel);
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

/* ---- the kernel ---- */

/* Returns the compute capability that the PTX is for, as 10 * major + minor. */
static int kernel_capability(void)
{
    const char *target = strstr(bake_cuda_ptx, ".target sm_");
    return target ? atoi(target + strlen(".target sm_")) : 0;
}

int bake_cuda_open(struct bsq_ctx *ctx, uint32_t number, struct bake_cuda_api *api,
                   struct bake_cuda_device *out)
{
    char why[BAKE_WARNING_BYTES], text[BAKE_CUDA_TEXT];
    const int needed = kernel_capability();
    bool faulty;
    int count;

    if (!bake_cuda_ptx[0])
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", no_kernel);
    if (!bake_cuda_load(api, &count, why, &faulty))
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", why);
    const CUresult code = bake_cuda_device(api, (int)number, out);
    if (code != CUDA_SUCCESS)
        return bsq_fail(ctx, BSQ_ENODEVICE, "cuda:%" PRIu32 ": cuDeviceGet: %s", number,
                        bake_cuda_error(api, code, text));
    if (out->capability < needed)
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s: compute capability %d.%d, the program needs %d.%d",
                        out->name, out->capability / 10, out->capability % 10, needed / 10,
                        needed % 10);
    return 0;
}

/* The first CUDA of each PTX version (NVIDIA, "PTX ISA", "Release Notes"). Versions after 7.0 that
 * are not listed came with the CUDA whose major version is higher by 4. */
int bake_cuda_version_for_ptx(int ptx_version)
{
    static const struct {
        int ptx, cuda;
    } known[] = {{40, 60}, {41, 65},  {42, 70},  {43, 75},  {50, 80},  {60, 90},  {61, 91},
                 {62, 92}, {63, 100}, {64, 101}, {65, 102}, {86, 127}, {87, 128}, {88, 129}};

    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++)
        if (known[i].ptx == ptx_version)
            return known[i].cuda;
    return ptx_version + 40;
}

/* Returns the version of PTX that the kernel is in, as 10 * major + minor. */
static int kernel_version(void)
{
    const char *line = strstr(bake_cuda_ptx, ".version ");
    int major = 0, minor = 0;

    if (line)
        sscanf(line, ".version %d.%d", &major, &minor);
    return 10 * major + minor;
}

static void describe_old_driver(const struct bake_cuda_api *api, char *buffer)
{
    const int ptx = kernel_version(), needed = bake_cuda_version_for_ptx(ptx);
    int version = 0; /* 1000 * major + 10 * minor */

    if (api->cuDriverGetVersion(&version) != CUDA_SUCCESS)
        version = 0;
    snprintf(
        buffer, BAKE_CUDA_REASON,
        "NVIDIA's driver is too old: it is for CUDA %d.%d, and the program's kernel (PTX %d.%d) "
        "needs a driver for CUDA %d.%d",
        version / 1000, version % 1000 / 10, ptx / 10, ptx % 10, needed / 10, needed % 10);
}

void bake_cuda_refusal(const struct bake_cuda_api *api, CUresult code, const char *log,
                       char *buffer)
{
    const char *advice = "";
    char text[BAKE_CUDA_TEXT];

    if (code == CUDA_ERROR_UNSUPPORTED_PTX_VERSION) {
        describe_old_driver(api, buffer);
        return;
    }
    if (code == CUDA_ERROR_JIT_COMPILER_NOT_FOUND)
        advice = "; install libnvidia-ptxjitcompiler.so.1, a part of NVIDIA's driver";
    else if (code == CUDA_ERROR_JIT_COMPILATION_DISABLED)
        advice = "; CUDA_DISABLE_PTX_JIT must not be set";
    snprintf(buffer, BAKE_CUDA_REASON, "compiling the kernel: %s%s%s%s",
             bake_cuda_error(api, code, text), advice, *log ? ": " : "", log);
    for (char *p = buffer; *p; p++)
        if (*p == '\n')
            *p = ' ';
}
