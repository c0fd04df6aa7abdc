/* opencl_api.c - loads libOpenCL, numbers its devices, names its errors. */
#include "libbake/device/opencl/opencl_api.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

#include "libbake/device/backend.h"
#include "libbake/device/probe.h"
#include "libbake/device/opencl/opencl_drivers.h"

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
        CASE(CL_INVALID_VALUE)
        CASE(CL_INVALID_DEVICE)
        CASE(CL_INVALID_CONTEXT)
        CASE(CL_INVALID_COMMAND_QUEUE)
        CASE(CL_INVALID_MEM_OBJECT)
        CASE(CL_INVALID_PLATFORM)
        CASE(CL_INVALID_QUEUE_PROPERTIES)
        CASE(CL_INVALID_BINARY)
        CASE(CL_INVALID_PROGRAM)
        CASE(CL_INVALID_OPERATION)
        CASE(CL_INVALID_EVENT)
        CASE(CL_MAP_FAILURE)
        CASE(CL_PROFILING_INFO_NOT_AVAILABLE)
        CASE(CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST)
        CASE(CL_INVALID_BUILD_OPTIONS)
        CASE(CL_INVALID_PROGRAM_EXECUTABLE)
        CASE(CL_INVALID_KERNEL_NAME)
        CASE(CL_INVALID_KERNEL_DEFINITION)
        CASE(CL_INVALID_KERNEL)
        CASE(CL_INVALID_KERNEL_ARGS)
        CASE(CL_INVALID_ARG_SIZE)
        CASE(CL_INVALID_WORK_GROUP_SIZE)
        CASE(CL_INVALID_WORK_ITEM_SIZE)
        CASE(CL_INVALID_GLOBAL_WORK_SIZE)
        CASE(CL_INVALID_BUFFER_SIZE)
    default:
        snprintf(buffer, 32, "OpenCL error %d", (int)code);
        return buffer;
    }
#undef CASE
}

static cl_ulong device_number(const struct bake_opencl_api *api, cl_device_id id,
                              cl_device_info what, size_t size)
{
    /* Values of 4 bytes leave the upper half zero; little-endian hosts only, as the grid is. */
    cl_ulong value = 0;

    if (api->clGetDeviceInfo(id, what, size, &value, NULL) != CL_SUCCESS)
        return 0;
    return value;
}

/* Collapses the blanks that vendors pad names with. */
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

static void describe_driver(const struct bake_opencl_api *api, struct bake_opencl_device *out)
{
    char platform[80] = "", device[80] = "", driver[80] = "";

    api->clGetPlatformInfo(out->platform, CL_PLATFORM_VERSION, sizeof platform - 1, platform, NULL);
    api->clGetDeviceInfo(out->id, CL_DEVICE_VERSION, sizeof device - 1, device, NULL);
    api->clGetDeviceInfo(out->id, CL_DRIVER_VERSION, sizeof driver - 1, driver, NULL);
    snprintf(out->driver, sizeof out->driver, "%s\n%s\n%s", platform, device, driver);
}

/* Devices have three sides at least. */
static void describe_groups(const struct bake_opencl_api *api, struct bake_opencl_device *out)
{
    size_t sides[16] = {0};

    if (api->clGetDeviceInfo(out->id, CL_DEVICE_MAX_WORK_ITEM_SIZES, sizeof sides, sides, NULL) !=
        CL_SUCCESS)
        sides[0] = sides[1] = 1;
    out->group_sides[0] = sides[0];
    out->group_sides[1] = sides[1];
}

static void describe(const struct bake_opencl_api *api, cl_platform_id platform, cl_device_id id,
                     struct bake_opencl_device *out)
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
    describe_driver(api, out);
    out->is_gpu = device_number(api, id, CL_DEVICE_TYPE, 8) & CL_DEVICE_TYPE_GPU;
    out->host_memory = device_number(api, id, CL_DEVICE_HOST_UNIFIED_MEMORY, 4);
    out->rounds_correctly =
        device_number(api, id, CL_DEVICE_SINGLE_FP_CONFIG, 8) & CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT;
    out->memory_bytes = device_number(api, id, CL_DEVICE_GLOBAL_MEM_SIZE, 8);
    out->buffer_bytes = device_number(api, id, CL_DEVICE_MAX_MEM_ALLOC_SIZE, 8);
    describe_groups(api, out);
}

void bake_opencl_group(size_t most_items, const size_t most_sides[2], size_t sides[2])
{
    sides[0] = sides[1] = 8;
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
                describe(api, platforms[p], devices[d], out);
                return true;
            }
        }
    }
    return false;
}

static void pass_on(void *arg, const char *line)
{
    bake_answer_warning(arg, line);
}

static void ask(struct bake_answers *answers)
{
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    bool loaded = bake_opencl_load(&api);

    for (uint32_t i = 0; loaded && bake_opencl_device(&api, i, &device); i++) {
        struct bake_device_info info = {.memory_bytes = device.memory_bytes,
                                        .is_gpu = device.is_gpu};
        snprintf(info.id, sizeof info.id, "opencl:%u", (unsigned)i);
        snprintf(info.name, sizeof info.name, "%s", device.name);
        bake_answer_device(answers, &info);
    }
    bake_opencl_idle_drivers(loaded ? dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL) : NULL,
                             pass_on, answers);
}

int bake_opencl_list(struct bsq_ctx *ctx,
                     void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    return bake_probe(ctx, "OpenCL", ask, fn, arg);
}

static void count_device(void *arg, const struct bake_device_info *info)
{
    (void)info;
    ++*(uint32_t *)arg;
}

int bake_opencl_check(struct bsq_ctx *ctx)
{
    uint32_t count = 0;
    int status = bake_opencl_list(ctx, count_device, &count);

    if (status < 0 || count > 0)
        return status;
    if (!dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL))
        return bsq_fail(ctx, BSQ_ENODEVICE, "OpenCL is not installed (libOpenCL.so.1)");
    return bsq_fail(ctx, BSQ_ENODEVICE,
                    "OpenCL has no devices (no driver that works is installed)");
}

/* Looks for a GPU with a number above `after`. */
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

int64_t bake_opencl_next_gpu(struct bsq_ctx *ctx, int64_t after)
{
    struct gpu_search search = {.after = after, .found = -1};
    int status = bake_opencl_list(ctx, search_gpu, &search);

    return status < 0 ? status : search.found;
}
