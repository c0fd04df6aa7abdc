/* cuda.c - runs the kernel on an NVIDIA GPU, through the driver API.
 *
 * The build compiles the kernel to PTX; the driver compiles that for the card and caches the
 * result. The device reads and writes page-locked memory of each stream by itself, so workers
 * overlap each other's copies and kernels and never wait for a lock. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/gpu/gpu.h"
#include "libbake/device/cuda/cuda.h"
#include "libbake/device/cuda/cuda_api.h"

/* A warp is 8 x 4 texels: near in the map, so mostly near in the grid; or 32 rays of a viewpoint.
 */
enum { BLOCK = 128, BLOCK_WIDTH = 8 };

/* Registers of a thread. Fewer of them allow more warps, which hide the memory's latency. The
 * compiler would take about 183 for a texel, and 133 for a ray; what is spilled is not used in the
 * innermost loops. Rays were as fast with 72 to 96 registers, and slower with 64 and 128. For rays
 * from hits through triangles it would take 128; with 96 it spills half as much as with 80. */
static const unsigned registers[BAKE_KERNEL_COUNT] = {
    [BAKE_PATCH] = 128, [BAKE_LOOK] = 80, [BAKE_MEET] = 96, [BAKE_FIRST] = 128};

/* A stream, and events at the borders of its steps: step i is between events i and i + 1. */
struct stream {
    CUstream stream;
    CUevent events[BAKE_STEPS + 1];
    CUevent before;     /* the end of the previous patch, or the stream's creation */
    double before_time; /* of that event, on the device's clock */
};

struct cuda {
    struct bake_gpu gpu;
    struct bake_cuda_api api;
    struct bake_cuda_device device;
    CUcontext context;
    /* Each is compiled for its own number of registers; BAKE_RAYS is in that of BAKE_PATCH. */
    CUmodule modules[BAKE_KERNEL_COUNT];
    CUfunction kernels[BAKE_KERNEL_COUNT];
    CUevent origin; /* zero of the device's clock */
};

/* Calls a function of the driver. Returns its failure from a function that returns one. */
#define CALL(name, ...)                                                                            \
    do {                                                                                           \
        const CUresult code_ = cuda->api.name(__VA_ARGS__);                                        \
        if (code_ != CUDA_SUCCESS)                                                                 \
            return (struct bake_failure){#name, code_};                                            \
    } while (0)

static const char *cuda_describe(const struct bake_gpu *gpu, int code, char *buffer)
{
    _Static_assert((int)BAKE_GPU_TEXT >= (int)BAKE_CUDA_TEXT, "errors fit");
    return bake_cuda_error(&((const struct cuda *)gpu)->api, code, buffer);
}

static struct bake_failure cuda_attach(struct bake_gpu *gpu)
{
    struct cuda *cuda = (struct cuda *)gpu;
    CALL(cuCtxSetCurrent, cuda->context);
    return BAKE_NO_FAILURE;
}

/* ---- memory ---- */

static struct bake_failure cuda_allocate(struct bake_gpu *gpu, uint64_t bytes, bake_memory *out)
{
    struct cuda *cuda = (struct cuda *)gpu;
    CUdeviceptr memory = 0;
    if (bytes > 0)
        CALL(cuMemAlloc, &memory, bytes);
    *out = memory;
    return BAKE_NO_FAILURE;
}

static void cuda_release(struct bake_gpu *gpu, bake_memory memory)
{
    ((struct cuda *)gpu)->api.cuMemFree(memory);
}

/* Returns the device's free memory less a sixteenth of all: at the first launch the driver takes
 * some for spilled registers, and it rounds each array up. */
static struct bake_failure free_memory(const struct cuda *cuda, uint64_t *out)
{
    size_t free_bytes = 0, all_bytes = 0;
    *out = 0;
    CALL(cuMemGetInfo, &free_bytes, &all_bytes);
    if (free_bytes > all_bytes / 16)
        *out = free_bytes - all_bytes / 16;
    return BAKE_NO_FAILURE;
}

/* ---- streams ---- */

/* Waits for all work of a stream, asleep: cuStreamSynchronize() would keep a processor busy. */
static struct bake_failure cuda_finish(struct bake_gpu *gpu, struct bake_stream *stream)
{
    struct cuda *cuda = (struct cuda *)gpu;
    struct stream *own = stream->own;
    CALL(cuEventRecord, own->before, own->stream);
    CALL(cuEventSynchronize, own->before);
    return BAKE_NO_FAILURE;
}

static void cuda_close_stream(struct bake_gpu *gpu, struct bake_stream *stream)
{
    const struct bake_cuda_api *api = &((struct cuda *)gpu)->api;
    struct stream *own = stream->own;
    if (own->before)
        (void)cuda_finish(gpu, stream);
    if (own->stream)
        api->cuStreamDestroy(own->stream);
    for (int i = 0; i <= BAKE_STEPS; i++)
        if (own->events[i])
            api->cuEventDestroy(own->events[i]);
    if (own->before)
        api->cuEventDestroy(own->before);
    for (unsigned i = 0; i < stream->host_count; i++) {
        if (stream->host[i])
            api->cuMemFreeHost(stream->host[i]);
        stream->host[i] = NULL;
    }
    *own = (struct stream){0};
}

/* Computes the seconds between two events that are over. The API has float: hours are coarse. */
static struct bake_failure elapsed(const struct cuda *cuda, CUevent from, CUevent to,
                                   double *seconds)
{
    float milliseconds = 0;
    CALL(cuEventElapsedTime, &milliseconds, from, to);
    *seconds = 1e-3 * (double)milliseconds;
    return BAKE_NO_FAILURE;
}

static struct bake_failure cuda_open_stream(struct bake_gpu *gpu, struct bake_stream *stream)
{
    struct cuda *cuda = (struct cuda *)gpu;
    struct stream *own = stream->own;
    CALL(cuStreamCreate, &own->stream, CU_STREAM_NON_BLOCKING);
    for (int i = 0; i <= BAKE_STEPS; i++)
        CALL(cuEventCreate, &own->events[i], CU_EVENT_BLOCKING_SYNC);
    CALL(cuEventCreate, &own->before, CU_EVENT_BLOCKING_SYNC);
    BAKE_TRY_CALL(cuda_finish(gpu, stream));
    for (unsigned i = 0; i < stream->host_count; i++)
        CALL(cuMemAllocHost, (void **)&stream->host[i], stream->host_bytes);
    return elapsed(cuda, cuda->origin, own->before, &own->before_time);
}

static struct bake_failure cuda_send(struct bake_gpu *gpu, struct bake_stream *stream,
                                     const char *from, uint64_t bytes, bake_memory to, uint64_t at,
                                     int step)
{
    struct cuda *cuda = (struct cuda *)gpu;
    struct stream *own = stream->own;
    if (step == 0)
        CALL(cuEventRecord, own->events[step], own->stream);
    CALL(cuMemcpyHtoDAsync, to + at, from, bytes, own->stream);
    CALL(cuEventRecord, own->events[step + 1], own->stream);
    return BAKE_NO_FAILURE;
}

static struct bake_failure cuda_fetch(struct bake_gpu *gpu, struct bake_stream *stream,
                                      uint64_t bytes)
{
    struct cuda *cuda = (struct cuda *)gpu;
    struct stream *own = stream->own;
    CALL(cuEventRecord, own->events[BAKE_TEXELS], own->stream);
    CALL(cuMemcpyDtoHAsync, stream->host[0], stream->texels, bytes, own->stream);
    CALL(cuEventRecord, own->events[BAKE_TEXELS + 1], own->stream);
    return BAKE_NO_FAILURE;
}

/* An event that was never recorded counts as over. */
static struct bake_failure cuda_wait(struct bake_gpu *gpu, struct bake_stream *stream, int step)
{
    struct cuda *cuda = (struct cuda *)gpu;
    CALL(cuEventSynchronize, ((struct stream *)stream->own)->events[step + 1]);
    return BAKE_NO_FAILURE;
}

static struct bake_failure cuda_launch(struct bake_gpu *gpu, struct bake_stream *stream,
                                       const struct bake_launch *launch)
{
    const struct cuda *cuda = (const struct cuda *)gpu;
    CUstream own = ((struct stream *)stream->own)->stream;
    const unsigned width = launch->side ? launch->side : BLOCK_WIDTH, height = BLOCK / width;
    void *arguments[BAKE_ARGUMENTS_MAX];
    CUresult code;
    for (uint32_t i = 0; i < launch->count; i++)
        arguments[i] = (void *)(uintptr_t)launch->arguments[i].value;
    code = cuda->api.cuLaunchKernel(
        cuda->kernels[launch->kernel], (launch->width + width - 1) / width,
        (launch->height + height - 1) / height, 1, width, height, 1, 0, own, arguments, NULL);
    /* Submits the launch by itself. Drivers of Windows, which WSL uses, collect launches and submit
     * several at once, and Windows ends work that takes seconds. */
    if (code == CUDA_SUCCESS)
        code = cuda->api.cuStreamQuery(own);
    return (struct bake_failure){"cuLaunchKernel", code == CUDA_ERROR_NOT_READY ? 0 : code};
}

static struct bake_failure cuda_times(struct bake_gpu *gpu, struct bake_stream *stream)
{
    struct cuda *cuda = (struct cuda *)gpu;
    struct stream *own = stream->own;
    CUevent from = own->before;
    double at[BAKE_STEPS + 1], since = own->before_time, seconds;
    /* Each from the previous event, so that times are as exact late in a long job. */
    for (int i = 0; i <= BAKE_STEPS; i++) {
        BAKE_TRY_CALL(elapsed(cuda, from, own->events[i], &seconds));
        at[i] = since += seconds;
        from = own->events[i];
    }
    own->events[BAKE_STEPS] = own->before;
    own->before = from;
    own->before_time = since;
    for (int i = 0; i < BAKE_STEPS; i++)
        stream->times[i] = (struct bake_span){at[i], at[i + 1]};
    return BAKE_NO_FAILURE;
}

/* ---- the kernel ---- */

enum { REASON_BYTES = 1200 };

/* Returns the compute capability that the PTX is for, as 10 * major + minor. */
static int kernel_capability(void)
{
    const char *target = strstr(bake_cuda_ptx, ".target sm_");
    return target ? atoi(target + strlen(".target sm_")) : 0;
}

/* Loads the driver and describes a device that can run the kernel. Errors: BSQ_ENODEVICE. */
static int cuda_open_driver(struct bsq_ctx *ctx, uint32_t number, struct bake_cuda_api *api,
                            struct bake_cuda_device *out)
{
    char why[BAKE_WARNING_BYTES], text[BAKE_CUDA_TEXT];
    const int needed = kernel_capability();
    bool faulty;
    int count;
    if (!bake_cuda_ptx[0])
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", bake_cuda_no_kernel);
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
        buffer, REASON_BYTES,
        "NVIDIA's driver is too old: it is for CUDA %d.%d, and the program's kernel (PTX %d.%d) "
        "needs a driver for CUDA %d.%d",
        version / 1000, version % 1000 / 10, ptx / 10, ptx % 10, needed / 10, needed % 10);
}

/* Describes why the driver refused the kernel: the error, and what the user can do about it. log:
 * the compiler's messages. */
static void describe_refusal(const struct bake_cuda_api *api, CUresult code, const char *log,
                             char buffer[REASON_BYTES])
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
    snprintf(buffer, REASON_BYTES, "compiling the kernel: %s%s%s%s",
             bake_cuda_error(api, code, text), advice, *log ? ": " : "", log);
    for (char *p = buffer; *p; p++)
        if (*p == '\n')
            *p = ' ';
}

/* ---- opening and closing ---- */

/* Finds a kernel in a module. */
static int find_kernel(struct cuda *cuda, CUmodule module, int kernel)
{
    const CUresult code =
        cuda->api.cuModuleGetFunction(&cuda->kernels[kernel], module, bake_kernel_names[kernel]);
    return bake_gpu_fail(&cuda->gpu, (struct bake_failure){"cuModuleGetFunction", code});
}

static int load_kernel(struct cuda *cuda, int kernel)
{
    char log[1024] = "", reason[REASON_BYTES];
    CUmodule *module = &cuda->modules[kernel];
    int options[] = {CU_JIT_ERROR_LOG_BUFFER, CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES,
                     CU_JIT_MAX_REGISTERS};
    void *values[] = {log, (void *)(uintptr_t)(sizeof log - 1),
                      (void *)(uintptr_t)registers[kernel]};
    CUresult code = cuda->api.cuModuleLoadDataEx(module, bake_cuda_ptx, 3, options, values);
    if (code != CUDA_SUCCESS) {
        describe_refusal(&cuda->api, code, log, reason);
        return bsq_fail(cuda->gpu.ctx, BSQ_ENODEVICE, "%s: %s", cuda->device.name, reason);
    }
    return find_kernel(cuda, *module, kernel);
}

static struct bake_failure cuda_open_context(struct cuda *cuda)
{
    CUcontext context;
    CALL(cuDevicePrimaryCtxRetain, &context, cuda->device.device);
    cuda->context = context;
    CALL(cuCtxSetCurrent, cuda->context);
    CALL(cuEventCreate, &cuda->origin, CU_EVENT_BLOCKING_SYNC);
    CALL(cuEventRecord, cuda->origin, NULL);
    CALL(cuEventSynchronize, cuda->origin); /* nothing else uses the default stream */
    return BAKE_NO_FAILURE;
}

static int cuda_open(struct bake_gpu *gpu, uint32_t number)
{
    struct cuda *cuda = (struct cuda *)gpu;
    BSQ_PASS(cuda_open_driver(gpu->ctx, number, &cuda->api, &cuda->device));
    snprintf(gpu->device_name, sizeof gpu->device_name, "%s", cuda->device.name);
    snprintf(gpu->name, sizeof gpu->name, "%.110s (CUDA)", cuda->device.name);
    gpu->buffer_bytes = gpu->array_bytes = UINT64_MAX;
    BSQ_PASS(bake_gpu_fail(gpu, cuda_open_context(cuda)));
    for (int i = 0; i < BAKE_KERNEL_COUNT; i++)
        if (bake_gpu_launches(gpu, i))
            BSQ_PASS(i == BAKE_RAYS ? find_kernel(cuda, cuda->modules[BAKE_PATCH], i)
                                    : load_kernel(cuda, i));
    return bake_gpu_fail(gpu, free_memory(cuda, &gpu->memory_bytes));
}

static void cuda_close(struct bake_gpu *gpu)
{
    const struct cuda *cuda = (const struct cuda *)gpu;
    if (!cuda->context)
        return;
    cuda->api.cuCtxSetCurrent(cuda->context);
    if (cuda->origin)
        cuda->api.cuEventDestroy(cuda->origin);
    for (int i = 0; i < BAKE_KERNEL_COUNT; i++)
        if (cuda->modules[i])
            cuda->api.cuModuleUnload(cuda->modules[i]);
    cuda->api.cuCtxSetCurrent(NULL);
    cuda->api.cuDevicePrimaryCtxRelease(cuda->device.device);
}

const struct bake_driver bake_cuda_driver = {
    .name = "cuda",
    .title = "CUDA",
    .list = bake_cuda_list,
    .open = cuda_open,
    .close = cuda_close,
    .gpu_bytes = sizeof(struct cuda),
    .stream_bytes = sizeof(struct stream),
    .describe = cuda_describe,
    .attach = cuda_attach,
    .allocate = cuda_allocate,
    .release = cuda_release,
    .open_stream = cuda_open_stream,
    .close_stream = cuda_close_stream,
    .send = cuda_send,
    .launch = cuda_launch,
    .fetch = cuda_fetch,
    .wait = cuda_wait,
    .finish = cuda_finish,
    .times = cuda_times,
};
