/* opencl.c - runs the kernel on an OpenCL device.
 *
 * Each array of the grid is a buffer. Every stream has its own in-order queue, kernel object
 * (setting arguments is not thread-safe) and mapped host memory, so workers overlap each other's
 * copies and kernels and never wait for a lock. */
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "libbake/device/gpu/gpu.h"
#include "libbake/device/opencl/opencl.h"
#include "libbake/device/opencl/opencl_api.h"

/* Events of a patch: of each step, that of the first kernel for BAKE_KERNELS, and of the last one.
 */
enum { LAST_KERNEL = BAKE_STEPS, EVENTS };

struct stream {
    cl_command_queue queue;
    cl_kernel kernels[BAKE_KERNEL_COUNT];
    uint64_t launches;              /* of the patch */
    size_t most[BAKE_KERNEL_COUNT]; /* work items of a group */
    cl_mem pinned[2];               /* the host memory, mapped */
    cl_event events[EVENTS];
};

/* Limit for an array of the grid: some devices promise larger buffers than they can give. */
#define ARRAY_MOST (UINT64_C(1) << 30)

struct opencl {
    struct bake_gpu gpu;
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    cl_context context;
    cl_program program;
};

/* Returns a failure from a function that returns one. */
#define CHECK(name, code_)                                                                         \
    do {                                                                                           \
        if ((code_) != CL_SUCCESS)                                                                 \
            return (struct bake_failure){name, code_};                                             \
    } while (0)
/* Calls a function that returns a code. */
#define CALL(name, ...) CHECK(#name, cl->api.name(__VA_ARGS__))

static cl_mem buffer_of(bake_memory memory)
{
    return (cl_mem)(uintptr_t)memory;
}

static const char *opencl_describe(const struct bake_gpu *gpu, int code, char *buffer)
{
    (void)gpu;
    return bake_opencl_error(code, buffer);
}

/* ---- memory ---- */

static struct bake_failure opencl_allocate(struct bake_gpu *gpu, uint64_t bytes, bake_memory *out)
{
    struct opencl *cl = (struct opencl *)gpu;
    cl_int code;
    /* The kernel never reads an empty array, but an argument must be a buffer. */
    cl_mem memory =
        cl->api.clCreateBuffer(cl->context, CL_MEM_READ_WRITE, bytes ? bytes : 8, NULL, &code);
    CHECK("clCreateBuffer", code);
    *out = (uintptr_t)memory;
    return BAKE_NO_FAILURE;
}

static void opencl_release(struct bake_gpu *gpu, bake_memory memory)
{
    ((struct opencl *)gpu)->api.clReleaseMemObject(buffer_of(memory));
}

/* ---- streams ---- */

/* Waits until the command of an event is over, asleep: clWaitForEvents() and clFinish() of NVIDIA's
 * driver keep a processor busy. A pause is an eighth longer than the one before, so a wait takes
 * about an eighth too long at most. event: NULL: there is none. */
static struct bake_failure sleep_until(const struct opencl *cl, cl_event event)
{
    enum { SHORTEST = 20000, LONGEST = 1000000 }; /* nanoseconds */
    struct timespec pause = {.tv_nsec = SHORTEST};
    cl_int state = CL_COMPLETE;
    for (;;) {
        if (event)
            CALL(clGetEventInfo, event, CL_EVENT_COMMAND_EXECUTION_STATUS, sizeof state, &state,
                 NULL);
        if (state <= CL_COMPLETE)
            return (struct bake_failure){"clGetEventInfo", state};
        nanosleep(&pause, NULL);
        if (pause.tv_nsec < LONGEST)
            pause.tv_nsec += pause.tv_nsec / 8;
    }
}

static struct bake_failure opencl_finish(struct bake_gpu *gpu, struct bake_stream *stream)
{
    const struct stream *own = stream->own;
    for (int i = 0; i < EVENTS; i++)
        BAKE_TRY_CALL(sleep_until((const struct opencl *)gpu, own->events[i]));
    return BAKE_NO_FAILURE;
}

static void opencl_close_stream(struct bake_gpu *gpu, struct bake_stream *stream)
{
    const struct bake_opencl_api *api = &((struct opencl *)gpu)->api;
    struct stream *own = stream->own;
    (void)opencl_finish(gpu, stream);
    if (own->queue)
        api->clFinish(own->queue);
    for (int i = 0; i < EVENTS; i++)
        if (own->events[i])
            api->clReleaseEvent(own->events[i]);
    for (unsigned i = 0; i < stream->host_count; i++) {
        if (stream->host[i])
            api->clEnqueueUnmapMemObject(own->queue, own->pinned[i], stream->host[i], 0, NULL,
                                         NULL);
        if (own->pinned[i])
            api->clReleaseMemObject(own->pinned[i]);
        stream->host[i] = NULL;
    }
    for (int i = 0; i < BAKE_KERNEL_COUNT; i++)
        if (own->kernels[i])
            api->clReleaseKernel(own->kernels[i]);
    if (own->queue) {
        api->clFinish(own->queue);
        api->clReleaseCommandQueue(own->queue);
    }
    *own = (struct stream){0};
}

/* Creates memory that the device can copy from by itself; drivers would first copy other memory. */
static struct bake_failure open_host(struct opencl *cl, struct bake_stream *stream, unsigned number)
{
    struct stream *own = stream->own;
    cl_int code;
    own->pinned[number] =
        cl->api.clCreateBuffer(cl->context, CL_MEM_ALLOC_HOST_PTR, stream->host_bytes, NULL, &code);
    CHECK("clCreateBuffer", code);
    stream->host[number] = cl->api.clEnqueueMapBuffer(own->queue, own->pinned[number], CL_TRUE,
                                                      CL_MAP_READ | CL_MAP_WRITE, 0,
                                                      stream->host_bytes, 0, NULL, NULL, &code);
    CHECK("clEnqueueMapBuffer", code);
    return BAKE_NO_FAILURE;
}

static struct bake_failure opencl_open_stream(struct bake_gpu *gpu, struct bake_stream *stream)
{
    struct opencl *cl = (struct opencl *)gpu;
    struct stream *own = stream->own;
    cl_int code;
    own->queue =
        cl->api.clCreateCommandQueue(cl->context, cl->device.id, CL_QUEUE_PROFILING_ENABLE, &code);
    CHECK("clCreateCommandQueue", code);
    for (int i = 0; i < BAKE_KERNEL_COUNT; i++) {
        if (!bake_gpu_launches(gpu, i))
            continue;
        own->kernels[i] = cl->api.clCreateKernel(cl->program, bake_kernel_names[i], &code);
        CHECK("clCreateKernel", code);
        /* A kernel with many registers may allow fewer work items than the device. */
        CALL(clGetKernelWorkGroupInfo, own->kernels[i], cl->device.id, CL_KERNEL_WORK_GROUP_SIZE,
             sizeof own->most[i], &own->most[i], NULL);
    }
    for (unsigned i = 0; i < stream->host_count; i++)
        BAKE_TRY_CALL(open_host(cl, stream, i));
    return BAKE_NO_FAILURE;
}

/* Returns the place for an event, whose last one is released. */
static cl_event *fresh_event(const struct opencl *cl, struct stream *own, int number)
{
    if (own->events[number])
        cl->api.clReleaseEvent(own->events[number]);
    own->events[number] = NULL;
    return &own->events[number];
}

static struct bake_failure opencl_send(struct bake_gpu *gpu, struct bake_stream *stream,
                                       const char *from, uint64_t bytes, bake_memory to,
                                       uint64_t at, int step)
{
    struct opencl *cl = (struct opencl *)gpu;
    struct stream *own = stream->own;
    own->launches = 0;
    CALL(clEnqueueWriteBuffer, own->queue, buffer_of(to), CL_FALSE, at, bytes, from, 0, NULL,
         fresh_event(cl, own, step));
    CALL(clFlush, own->queue);
    return BAKE_NO_FAILURE;
}

static struct bake_failure opencl_fetch(struct bake_gpu *gpu, struct bake_stream *stream,
                                        uint64_t bytes)
{
    struct opencl *cl = (struct opencl *)gpu;
    struct stream *own = stream->own;
    CALL(clEnqueueReadBuffer, own->queue, buffer_of(stream->texels), CL_FALSE, 0, bytes,
         stream->host[0], 0, NULL, fresh_event(cl, own, BAKE_TEXELS));
    CALL(clFlush, own->queue);
    return BAKE_NO_FAILURE;
}

static struct bake_failure opencl_wait(struct bake_gpu *gpu, struct bake_stream *stream, int step)
{
    return sleep_until((const struct opencl *)gpu, ((struct stream *)stream->own)->events[step]);
}

static struct bake_failure opencl_launch(struct bake_gpu *gpu, struct bake_stream *stream,
                                         const struct bake_launch *launch)
{
    const struct opencl *cl = (const struct opencl *)gpu;
    struct stream *own = stream->own;
    cl_kernel kernel = own->kernels[launch->kernel];
    const int event = own->launches++ == 0 ? BAKE_KERNELS : LAST_KERNEL;
    size_t group[2];
    bake_opencl_group(own->most[launch->kernel], cl->device.group_sides, launch->side, group);
    const size_t size[2] = {bsq_align_up(launch->width, group[0]),
                            bsq_align_up(launch->height, group[1])};
    _Static_assert(sizeof(cl_mem) == sizeof(bake_memory),
                   "a buffer's bits are those of its number");
    for (uint32_t i = 0; i < launch->count; i++)
        CALL(clSetKernelArg, kernel, i, launch->arguments[i].bytes, launch->arguments[i].value);
    CALL(clEnqueueNDRangeKernel, own->queue, kernel, 2, NULL, size, group, 0, NULL,
         fresh_event(cl, own, event));
    CALL(clFlush, own->queue);
    return BAKE_NO_FAILURE;
}

/* Computes the span from the start of the first event to the end of the last.
 *
 * A driver may have marked neither as complete yet although a later command of the queue is
 * (NVIDIA's 580 does), and then it has no times. */
static struct bake_failure span_of(const struct opencl *cl, cl_event first, cl_event last,
                                   struct bake_span *out)
{
    const cl_event both[] = {first, last};
    cl_ulong start = 0, end = 0;
    CALL(clWaitForEvents, 2, both);
    CALL(clGetEventProfilingInfo, first, CL_PROFILING_COMMAND_START, sizeof start, &start, NULL);
    CALL(clGetEventProfilingInfo, last, CL_PROFILING_COMMAND_END, sizeof end, &end, NULL);
    *out = (struct bake_span){1e-9 * (double)start, 1e-9 * (double)end};
    return BAKE_NO_FAILURE;
}

static struct bake_failure opencl_times(struct bake_gpu *gpu, struct bake_stream *stream)
{
    struct opencl *cl = (struct opencl *)gpu;
    struct stream *own = stream->own;
    for (int i = 0; i < BAKE_STEPS; i++) {
        /* A patch of one launch batch has one kernel. */
        const bool several = i == BAKE_KERNELS && own->events[LAST_KERNEL];
        BAKE_TRY_CALL(
            span_of(cl, own->events[i], own->events[several ? LAST_KERNEL : i], &stream->times[i]));
    }
    fresh_event(cl, own, LAST_KERNEL);
    return BAKE_NO_FAILURE;
}

/* ---- opening and closing ---- */

/* Returns the device memory that the job may use: not all, since drivers and the desktop need some
 * and OpenCL cannot tell how much is free. */
static uint64_t memory_limit(const struct opencl *cl)
{
    uint64_t limit = cl->device.memory_bytes / 8 * 7;
    if (cl->device.host_memory) {
        const uint64_t left = bsq_memory_left(cl->gpu.ctx) / 4 * 3;
        limit = left < limit ? left : limit;
    }
    return limit;
}

static struct bake_failure opencl_open_context(struct opencl *cl)
{
    const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM,
                                                (cl_context_properties)cl->device.platform, 0};
    cl_int code;
    cl->context = cl->api.clCreateContext(properties, 1, &cl->device.id, NULL, NULL, &code);
    return (struct bake_failure){"clCreateContext", code};
}

static int opencl_open(struct bake_gpu *gpu, uint32_t number)
{
    struct opencl *cl = (struct opencl *)gpu;
    if (!bake_opencl_load(&cl->api) || !bake_opencl_device(&cl->api, number, &cl->device))
        return bsq_fail(gpu->ctx, BSQ_ENODEVICE, "opencl:%u: the device is gone", (unsigned)number);
    snprintf(gpu->device_name, sizeof gpu->device_name, "%s", cl->device.name);
    snprintf(gpu->name, sizeof gpu->name, "%s", cl->device.name);
    gpu->shares_memory = cl->device.host_memory;
    gpu->memory_bytes = memory_limit(cl);
    gpu->lacks = !cl->device.has_double         ? "double precision"
                 : !cl->device.rounds_correctly ? "correctly rounded division"
                                                : NULL;
    gpu->buffer_bytes = cl->device.buffer_bytes;
    gpu->array_bytes = gpu->buffer_bytes < ARRAY_MOST ? gpu->buffer_bytes : ARRAY_MOST;
    BSQ_PASS(bake_gpu_fail(gpu, opencl_open_context(cl)));
    return bake_opencl_build(gpu->ctx, &cl->api, &cl->device, cl->context, &cl->program);
}

static void opencl_close(struct bake_gpu *gpu)
{
    const struct opencl *cl = (const struct opencl *)gpu;
    if (cl->program)
        cl->api.clReleaseProgram(cl->program);
    if (cl->context)
        cl->api.clReleaseContext(cl->context);
}

const struct bake_driver bake_opencl_driver = {
    .name = "opencl",
    .title = "OpenCL",
    .list = bake_opencl_list,
    .open = opencl_open,
    .close = opencl_close,
    .gpu_bytes = sizeof(struct opencl),
    .stream_bytes = sizeof(struct stream),
    .describe = opencl_describe,
    .allocate = opencl_allocate,
    .release = opencl_release,
    .open_stream = opencl_open_stream,
    .close_stream = opencl_close_stream,
    .send = opencl_send,
    .launch = opencl_launch,
    .fetch = opencl_fetch,
    .wait = opencl_wait,
    .finish = opencl_finish,
    .times = opencl_times,
};
