/* opencl_driver.c - loads libOpenCL, lists its devices, compiles the kernel, and names errors. */
#include "libbake/device/opencl/opencl_api.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

#include "libbake/device/opencl/opencl.h"

bool bake_opencl_load(struct bake_opencl_api *api)
{
    void *library = dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL);
    if (!library)
        return false;
#define LOAD(name)                                                                                 \
    *(void **)&api->name = dlsym(library, #name);                                                  \
    if (!api->name)                                                                                \
        return false;
    BAKE_OPENCL_FUNCTIONS(LOAD)
#undef LOAD
    return true;
}

const char *bake_opencl_error(cl_int code, char *buffer)
{
#define CASE(name)                                                                                 \
    case name:                                                                                     \
        return #name;
    switch (code) {
        CASE(CL_DEVICE_NOT_FOUND)
        CASE(CL_DEVICE_NOT_AVAILABLE)
        CASE(CL_COMPILER_NOT_AVAILABLE)
        CASE(CL_MEM_OBJECT_ALLOCATION_FAILURE)
        CASE(CL_OUT_OF_RESOURCES)
        CASE(CL_OUT_OF_HOST_MEMORY)
        CASE(CL_BUILD_PROGRAM_FAILURE)
    default:
        snprintf(buffer, 32, "OpenCL error %d", (int)code);
        return buffer;
    }
#undef CASE
}

static cl_ulong device_number(const struct bake_opencl_api *api, cl_device_id id,
                              cl_device_info what, size_t size)
{
    /* Values of 4 bytes leave the upper half zero: hosts are little-endian, as grid files are. */
    cl_ulong value = 0;
    if (api->clGetDeviceInfo(id, what, size, &value, NULL) != CL_SUCCESS)
        return 0;
    return value;
}

/* Removes the blanks that vendors pad names with. */
static void tidy(char *text)
{
    char *to = text;
    for (const char *from = text; *from; from++)
        if (*from != ' ' || (to > text && to[-1] != ' '))
            *to++ = *from;
    while (to > text && to[-1] == ' ')
        to--;
    *to = '\0';
}

/* Every device has at least three sides. */
static void describe_groups(const struct bake_opencl_api *api, struct bake_opencl_device *out)
{
    size_t sides[16] = {0};
    if (api->clGetDeviceInfo(out->id, CL_DEVICE_MAX_WORK_ITEM_SIZES, sizeof sides, sides, NULL) !=
        CL_SUCCESS)
        sides[0] = sides[1] = 1;
    out->group_sides[0] = sides[0];
    out->group_sides[1] = sides[1];
}

static void opencl_driver_describe(const struct bake_opencl_api *api, cl_platform_id platform,
                                   cl_device_id id, struct bake_opencl_device *out)
{
    char name[256] = "", vendor[256] = "";
    memset(out, 0, sizeof *out);
    out->platform = platform;
    out->id = id;
    api->clGetDeviceInfo(id, CL_DEVICE_NAME, sizeof name - 1, name, NULL);
    api->clGetPlatformInfo(platform, CL_PLATFORM_NAME, sizeof vendor - 1, vendor, NULL);
    tidy(name);
    tidy(vendor);
    snprintf(out->name, sizeof out->name, "%.80s (%.40s)", name, vendor);
    out->is_gpu = device_number(api, id, CL_DEVICE_TYPE, 8) & CL_DEVICE_TYPE_GPU;
    out->host_memory = device_number(api, id, CL_DEVICE_HOST_UNIFIED_MEMORY, 4);
    out->rounds_correctly =
        device_number(api, id, CL_DEVICE_SINGLE_FP_CONFIG, 8) & CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT;
    out->has_double = device_number(api, id, CL_DEVICE_DOUBLE_FP_CONFIG, 8) != 0;
    out->memory_bytes = device_number(api, id, CL_DEVICE_GLOBAL_MEM_SIZE, 8);
    out->buffer_bytes = device_number(api, id, CL_DEVICE_MAX_MEM_ALLOC_SIZE, 8);
    describe_groups(api, out);
}

void bake_opencl_group(size_t most_items, const size_t most_sides[2], size_t width, size_t sides[2])
{
    sides[0] = width ? width : 8;
    sides[1] = 64 / sides[0];
    for (int i = 0; i < 2; i++)
        while (sides[i] > 1 && sides[i] > most_sides[i])
            sides[i] /= 2;
    while (sides[0] * sides[1] > 1 && sides[0] * sides[1] > most_items)
        sides[sides[1] >= sides[0]] /= 2;
}

enum { PLATFORMS_MAX = 64, DEVICES_MAX = 256 }; /* more are left out */

bool bake_opencl_device(const struct bake_opencl_api *api, uint32_t index,
                        struct bake_opencl_device *out)
{
    cl_platform_id platforms[PLATFORMS_MAX];
    cl_device_id devices[DEVICES_MAX];
    cl_uint platform_count = 0, device_count;
    uint32_t next = 0;
    if (api->clGetPlatformIDs(PLATFORMS_MAX, platforms, &platform_count) != CL_SUCCESS)
        return false;
    for (cl_uint p = 0; p < platform_count && p < PLATFORMS_MAX; p++) {
        device_count = 0;
        if (api->clGetDeviceIDs(platforms[p], CL_DEVICE_TYPE_ALL, DEVICES_MAX, devices,
                                &device_count) != CL_SUCCESS)
            continue;
        for (cl_uint d = 0; d < device_count && d < DEVICES_MAX; d++) {
            if (!device_number(api, devices[d], CL_DEVICE_AVAILABLE, 4) ||
                !device_number(api, devices[d], CL_DEVICE_COMPILER_AVAILABLE, 4) ||
                !device_number(api, devices[d], CL_DEVICE_ENDIAN_LITTLE, 4))
                continue;
            if (next++ == index) {
                opencl_driver_describe(api, platforms[p], devices[d], out);
                return true;
            }
        }
    }
    return false;
}

void bake_opencl_list(struct bake_device_list *out)
{
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    const bool loaded = bake_opencl_load(&api);
    while (loaded && out->count < BAKE_DEVICES_MAX &&
           bake_opencl_device(&api, out->count, &device)) {
        struct bake_device_info *info = &out->devices[out->count];
        snprintf(info->id, sizeof info->id, "opencl:%u", (unsigned)out->count++);
        snprintf(info->name, sizeof info->name, "%s", device.name);
        info->memory_bytes = device.memory_bytes;
        info->is_gpu = device.is_gpu;
    }
    if (out->count == 0)
        snprintf(out->why, sizeof out->why, "%s",
                 loaded ? "OpenCL has no devices (no driver that works is installed)"
                        : "OpenCL is not installed (libOpenCL.so.1)");
}

/* ---- the kernel ---- */

/* The flattened kernel source. Drivers keep what they compiled from one run to the next; see
 * docs/decisions/0014-drivers-that-misbehave.md. */
static const char kernel_source[] =
#include "kernel_source.inc"
    ;

/* Records the build log from its first line with an error on, with " | " for line breaks. */
static int fail_build(struct bsq_ctx *ctx, const struct bake_opencl_api *api,
                      const struct bake_opencl_device *device, cl_program program, cl_int code)
{
    char *log = NULL, line[400] = "", number[32];
    size_t bytes = 0, used = 0;
    api->clGetProgramBuildInfo(program, device->id, CL_PROGRAM_BUILD_LOG, 0, NULL, &bytes);
    if (bytes && bsq_calloc(ctx, "build log", bytes + 1, 1, &log) == 0)
        api->clGetProgramBuildInfo(program, device->id, CL_PROGRAM_BUILD_LOG, bytes, log, NULL);
    const char *from = log ? strstr(log, "error") : NULL;
    while (from && from > log && from[-1] != '\n')
        from--;
    for (const char *c = from ? from : log; c && *c && used + 4 < sizeof line; c++) {
        const char *piece = *c == '\n' ? " | " : (char[2]){*c, '\0'};
        used += (size_t)snprintf(line + used, sizeof line - used, "%s", piece);
    }
    bsq_free(ctx, log);
    return bsq_fail(ctx, BSQ_ENODEVICE, "%s: clBuildProgram: %s%s%s", device->name,
                    bake_opencl_error(code, number), *line ? ": " : "", line);
}

int bake_opencl_build(struct bsq_ctx *ctx, const struct bake_opencl_api *api,
                      const struct bake_opencl_device *device, cl_context context, cl_program *out)
{
    const char *source = kernel_source;
    const char *options = device->rounds_correctly
                              ? "-cl-std=CL1.2 -cl-fp32-correctly-rounded-divide-sqrt"
                              : "-cl-std=CL1.2";
    char number[32];
    cl_int code;
    *out = api->clCreateProgramWithSource(context, 1, &source, NULL, &code);
    if (code != CL_SUCCESS)
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s: clCreateProgramWithSource: %s", device->name,
                        bake_opencl_error(code, number));
    code = api->clBuildProgram(*out, 1, &device->id, options, NULL, NULL);
    return code == CL_SUCCESS ? 0 : fail_build(ctx, api, device, *out, code);
}
