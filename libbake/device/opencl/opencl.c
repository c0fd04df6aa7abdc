/* opencl.c - runs the kernel on an OpenCL device.
 *
 * Each array of the grid is a buffer. Every worker has its own in-order queue, kernel object
 * (setting arguments is not thread-safe) and tile buffers, so workers overlap each other's copies
 * and kernels and never wait for a lock. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "libbake/device/compute/compute.h"
#include "libbake/device/opencl/opencl.h"
#include "libbake/device/opencl/opencl_api.h"

enum {
    STAGING_BYTES = 8 << 20 /* half of the staging buffer */
};

enum {
    ARG_TRIANGLES = BAKE_SUBGRID_ARRAYS,
    ARG_PARAMS,
    ARG_TILE,
    ARG_FIRST_ROW,
    ARG_END_ROW,
    ARG_FIRST_LINE,
    ARG_END_LINE,
    ARG_SAMPLES,
    ARG_TEXELS
};

/* Events of a tile, in the order of the queue. */
enum { COPIED_SAMPLES, FIRST_KERNEL, LAST_KERNEL, COPIED_TEXELS, EVENTS };

/* A worker's part; its first tile creates it. */
struct worker {
    cl_command_queue queue;
    cl_kernel kernel;
    size_t
        group[2]; /* sides of a work group; one for all tiles, as some drivers compile for each */
    cl_mem samples, texels;
    cl_event events[EVENTS];
};

struct opencl {
    struct bake_compute compute;
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    cl_context context;
    cl_program program;
    cl_command_queue upload;
    cl_mem pinned[2];  /* the halves of the staging buffer, mapped */
    cl_event taken[2]; /* the device has copied this half */
    struct worker *workers;
};

static cl_mem buffer_of(bake_memory memory)
{
    return (cl_mem)(uintptr_t)memory;
}

static const char *opencl_describe(const struct bake_compute *compute, int code, char *buffer)
{
    (void)compute;
    return bake_opencl_error(code, buffer);
}

/* Drivers often notice that memory is exhausted only when something is copied there, and do not
 * agree on the code. */
static bool opencl_lacks_memory(int code)
{
    return code == CL_MEM_OBJECT_ALLOCATION_FAILURE || code == CL_OUT_OF_RESOURCES ||
           code == CL_OUT_OF_HOST_MEMORY || code == CL_INVALID_BUFFER_SIZE;
}

/* ---- memory ---- */

static void opencl_allocate(struct bake_compute *compute, uint64_t bytes, bake_memory *out,
                            int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    /* The kernel never reads an empty array, but an argument must be a buffer. */
    *out = (uintptr_t)cl->api.clCreateBuffer(cl->context, CL_MEM_READ_ONLY, bytes ? bytes : 8, NULL,
                                             code);
}

static void opencl_release(struct bake_compute *compute, bake_memory memory)
{
    ((struct opencl *)compute)->api.clReleaseMemObject(buffer_of(memory));
}

static void opencl_send_half(struct bake_compute *compute, unsigned half, uint64_t bytes,
                             bake_memory to, uint64_t at, int *code)
{
    struct opencl *cl = (struct opencl *)compute;

    *code = cl->api.clEnqueueWriteBuffer(cl->upload, buffer_of(to), CL_FALSE, at, bytes,
                                         compute->staging.halves[half], 0, NULL, &cl->taken[half]);
    if (*code == CL_SUCCESS)
        *code = cl->api.clFlush(cl->upload);
}

static void opencl_wait_for_half(struct bake_compute *compute, unsigned half, int *code)
{
    struct opencl *cl = (struct opencl *)compute;

    *code = CL_SUCCESS;
    if (cl->taken[half]) {
        *code = cl->api.clWaitForEvents(1, &cl->taken[half]);
        cl->api.clReleaseEvent(cl->taken[half]);
        cl->taken[half] = NULL;
    }
}

static void opencl_finish_uploads(struct bake_compute *compute, int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    *code = cl->api.clFinish(cl->upload);
}

/* ---- tiles ---- */

static void opencl_close_worker(struct bake_compute *compute, unsigned number)
{
    struct opencl *cl = (struct opencl *)compute;
    struct worker *worker = &cl->workers[number];

    if (worker->texels)
        cl->api.clReleaseMemObject(worker->texels);
    if (worker->samples)
        cl->api.clReleaseMemObject(worker->samples);
    if (worker->kernel)
        cl->api.clReleaseKernel(worker->kernel);
    if (worker->queue)
        cl->api.clReleaseCommandQueue(worker->queue);
    *worker = (struct worker){0};
}

/* Chooses the work group; a kernel with many registers may allow fewer work items than the device.
 */
static int choose_group(const struct opencl *cl, struct worker *worker)
{
    size_t most = 0;
    const int code = cl->api.clGetKernelWorkGroupInfo(
        worker->kernel, cl->device.id, CL_KERNEL_WORK_GROUP_SIZE, sizeof most, &most, NULL);

    bake_opencl_group(most, cl->device.group_sides, worker->group);
    return code;
}

static const char *opencl_open_worker(struct bake_compute *compute, unsigned number, int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    struct worker *worker = &cl->workers[number];

    worker->queue =
        cl->api.clCreateCommandQueue(cl->context, cl->device.id, CL_QUEUE_PROFILING_ENABLE, code);
    if (*code != CL_SUCCESS)
        return "clCreateCommandQueue";
    worker->kernel = cl->api.clCreateKernel(cl->program, "bake_tile", code);
    if (*code != CL_SUCCESS)
        return "clCreateKernel";
    *code = choose_group(cl, worker);
    if (*code != CL_SUCCESS)
        return "clGetKernelWorkGroupInfo";
    worker->samples = cl->api.clCreateBuffer(cl->context, CL_MEM_READ_ONLY,
                                             bake_compute_sample_bytes(compute), NULL, code);
    if (*code != CL_SUCCESS)
        return "clCreateBuffer";
    worker->texels = cl->api.clCreateBuffer(cl->context, CL_MEM_READ_WRITE,
                                            bake_compute_texel_bytes(compute), NULL, code);
    if (*code != CL_SUCCESS)
        return "clCreateBuffer";
    return "";
}

/* Sets the arguments that are the same for all rows of a tile. */
static int set_arguments(const struct opencl *cl, const struct worker *worker,
                         const struct bake_compute_subgrid *subgrid, const struct bk_tile *tile)
{
    const cl_mem triangles = buffer_of(cl->compute.triangles);
    cl_int code = CL_SUCCESS;

    for (cl_uint i = 0; i < BAKE_SUBGRID_ARRAYS && code == CL_SUCCESS; i++) {
        const cl_mem array = buffer_of(subgrid->arrays[i]);
        code = cl->api.clSetKernelArg(worker->kernel, i, sizeof(cl_mem), &array);
    }
    if (code == CL_SUCCESS)
        code = cl->api.clSetKernelArg(worker->kernel, ARG_TRIANGLES, sizeof(cl_mem), &triangles);
    if (code == CL_SUCCESS)
        code = cl->api.clSetKernelArg(worker->kernel, ARG_PARAMS, sizeof subgrid->params,
                                      &subgrid->params);
    if (code == CL_SUCCESS)
        code =
            cl->api.clSetKernelArg(worker->kernel, ARG_SAMPLES, sizeof(cl_mem), &worker->samples);
    if (code == CL_SUCCESS)
        code = cl->api.clSetKernelArg(worker->kernel, ARG_TEXELS, sizeof(cl_mem), &worker->texels);
    if (code == CL_SUCCESS)
        code = cl->api.clSetKernelArg(worker->kernel, ARG_TILE, sizeof *tile, tile);
    return code;
}

static const char *opencl_send_samples(struct bake_compute *compute, unsigned number,
                                       const struct bake_compute_subgrid *subgrid,
                                       const struct bk_tile *tile, const uint32_t *sample_triangles,
                                       uint64_t bytes, int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    struct worker *worker = &cl->workers[number];

    *code = set_arguments(cl, worker, subgrid, tile);
    if (*code != CL_SUCCESS)
        return "clSetKernelArg";
    *code =
        cl->api.clEnqueueWriteBuffer(worker->queue, worker->samples, CL_FALSE, 0, bytes,
                                     sample_triangles, 0, NULL, &worker->events[COPIED_SAMPLES]);
    return "clEnqueueWriteBuffer";
}

static const char *opencl_launch(struct bake_compute *compute, unsigned number,
                                 const struct bake_compute_subgrid *subgrid,
                                 const struct bk_tile *tile, const struct bake_launch_batch *batch,
                                 int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    struct worker *worker = &cl->workers[number];
    const size_t size[2] = {bsq_align_up(tile->width, worker->group[0]),
                            bsq_align_up(batch->end_row - batch->first_row, worker->group[1])};
    const uint32_t bounds[] = {batch->first_row, batch->end_row, batch->first_line,
                               batch->end_line};
    const bool first = batch->first_row == 0 && batch->first_line == 0;
    const bool last = batch->end_row == tile->height && batch->end_line == subgrid->params.samples;
    cl_event *event = first  ? &worker->events[FIRST_KERNEL]
                      : last ? &worker->events[LAST_KERNEL]
                             : NULL;

    *code = CL_SUCCESS;
    for (cl_uint i = 0; i < 4 && *code == CL_SUCCESS; i++)
        *code =
            cl->api.clSetKernelArg(worker->kernel, ARG_FIRST_ROW + i, sizeof bounds[i], &bounds[i]);
    if (*code != CL_SUCCESS)
        return "clSetKernelArg";
    *code = cl->api.clEnqueueNDRangeKernel(worker->queue, worker->kernel, 2, NULL, size,
                                           worker->group, 0, NULL, event);
    if (*code != CL_SUCCESS)
        return "clEnqueueNDRangeKernel";
    *code = cl->api.clFlush(worker->queue);
    return "clFlush";
}

static const char *opencl_fetch_texels(struct bake_compute *compute, unsigned number, float *texels,
                                       uint64_t bytes, int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    struct worker *worker = &cl->workers[number];

    *code = cl->api.clEnqueueReadBuffer(worker->queue, worker->texels, CL_TRUE, 0, bytes, texels, 0,
                                        NULL, &worker->events[COPIED_TEXELS]);
    if (*code == CL_SUCCESS)
        *code = cl->api.clWaitForEvents(1, &worker->events[COPIED_TEXELS]);
    return "clEnqueueReadBuffer";
}

/* Returns the span from the start of the first event to the end of the last. */
static struct bake_span span_of(const struct opencl *cl, cl_event first, cl_event last, int *code)
{
    cl_ulong start = 0, end = 0;

    if (*code == CL_SUCCESS)
        *code = cl->api.clGetEventProfilingInfo(first, CL_PROFILING_COMMAND_START, sizeof start,
                                                &start, NULL);
    if (*code == CL_SUCCESS)
        *code =
            cl->api.clGetEventProfilingInfo(last, CL_PROFILING_COMMAND_END, sizeof end, &end, NULL);
    return (struct bake_span){1e-9 * (double)start, 1e-9 * (double)end};
}

static const char *opencl_times(struct bake_compute *compute, unsigned number,
                                struct bake_tile_times *out, int *code)
{
    struct opencl *cl = (struct opencl *)compute;
    const cl_event *events = cl->workers[number].events;
    /* A tile of one launch batch has one kernel. */
    const cl_event last = events[LAST_KERNEL] ? events[LAST_KERNEL] : events[FIRST_KERNEL];

    out->samples = span_of(cl, events[COPIED_SAMPLES], events[COPIED_SAMPLES], code);
    out->kernels = span_of(cl, events[FIRST_KERNEL], last, code);
    out->texels = span_of(cl, events[COPIED_TEXELS], events[COPIED_TEXELS], code);
    return "clGetEventProfilingInfo";
}

/* Waits after a failure: the device may use the caller's memory until the queue is empty. */
static void opencl_end_tile(struct bake_compute *compute, unsigned number, int code)
{
    struct opencl *cl = (struct opencl *)compute;
    struct worker *worker = &cl->workers[number];

    if (code != CL_SUCCESS)
        cl->api.clFinish(worker->queue);
    for (int i = 0; i < EVENTS; i++) {
        if (worker->events[i])
            cl->api.clReleaseEvent(worker->events[i]);
        worker->events[i] = NULL;
    }
}

static const struct bake_compute_calls calls = {.describe = opencl_describe,
                                                .lacks_memory = opencl_lacks_memory,
                                                .allocate = opencl_allocate,
                                                .release = opencl_release,
                                                .send_half = opencl_send_half,
                                                .wait_for_half = opencl_wait_for_half,
                                                .finish_uploads = opencl_finish_uploads,
                                                .open_worker = opencl_open_worker,
                                                .close_worker = opencl_close_worker,
                                                .send_samples = opencl_send_samples,
                                                .launch = opencl_launch,
                                                .fetch_texels = opencl_fetch_texels,
                                                .times = opencl_times,
                                                .end_tile = opencl_end_tile};

/* ---- opening and closing ---- */

/* Finds the device asked for. The error lists the devices that exist. */
static int choose(struct opencl *cl, int64_t index)
{
    struct bake_opencl_device device;
    char there[400] = "";
    uint32_t count = 0;
    bool found = false;

    if (!bake_opencl_load(&cl->api))
        return bsq_fail(cl->compute.ctx, BSQ_ENODEVICE, "OpenCL is not installed (libOpenCL.so.1)");
    for (; bake_opencl_device(&cl->api, count, &device); count++) {
        size_t used = strlen(there);
        bool wanted = index == BAKE_ANY_DEVICE ? !found || (device.is_gpu && !cl->device.is_gpu)
                                               : (int64_t)count == index;
        if (wanted) {
            cl->device = device;
            found = true;
        }
        snprintf(there + used, sizeof there - used, "%s opencl:%u %s", count ? "," : "",
                 (unsigned)count, device.name);
    }
    if (count == 0)
        return bsq_fail(cl->compute.ctx, BSQ_ENODEVICE,
                        "OpenCL has no devices (no driver that works is installed)");
    if (!found)
        return bsq_fail(cl->compute.ctx, BSQ_ENODEVICE,
                        "there is no device opencl:%" PRId64 "; there is%s", index, there);
    return 0;
}

/* Returns the device memory that the job may use: not all, since drivers and the desktop need some
 * and OpenCL cannot tell how much is free. */
static uint64_t memory_limit(const struct opencl *cl)
{
    uint64_t limit = cl->device.memory_bytes / 8 * 7;

    if (cl->device.host_memory) {
        const uint64_t left = bsq_memory_left(cl->compute.ctx) / 4 * 3;
        limit = left < limit ? left : limit;
    }
    return limit;
}

/* Creates a half that the device can copy from by itself; drivers would first copy other memory. */
static int open_half(struct opencl *cl, int half)
{
    cl_int code;

    cl->pinned[half] =
        cl->api.clCreateBuffer(cl->context, CL_MEM_ALLOC_HOST_PTR, STAGING_BYTES, NULL, &code);
    if (code != CL_SUCCESS)
        return bake_compute_fail(&cl->compute, "clCreateBuffer", code);
    cl->compute.staging.halves[half] =
        cl->api.clEnqueueMapBuffer(cl->upload, cl->pinned[half], CL_TRUE, CL_MAP_WRITE, 0,
                                   STAGING_BYTES, 0, NULL, NULL, &code);
    return code == CL_SUCCESS ? 0 : bake_compute_fail(&cl->compute, "clEnqueueMapBuffer", code);
}

static int open_upload(struct opencl *cl)
{
    cl_int code;
    int status = bake_compute_reserve(&cl->compute, "staging of the grid", 2 * STAGING_BYTES);

    cl->compute.staging.half_bytes = STAGING_BYTES;
    if (status < 0)
        return status;
    cl->upload = cl->api.clCreateCommandQueue(cl->context, cl->device.id, 0, &code);
    if (code != CL_SUCCESS)
        return bake_compute_fail(&cl->compute, "clCreateCommandQueue", code);
    for (int i = 0; i < 2 && status == 0; i++)
        status = open_half(cl, i);
    return status;
}

static void close_upload(struct opencl *cl)
{
    if (cl->upload)
        cl->api.clFinish(cl->upload);
    for (int i = 0; i < 2; i++) {
        if (cl->taken[i])
            cl->api.clReleaseEvent(cl->taken[i]);
        if (cl->compute.staging.halves[i])
            cl->api.clEnqueueUnmapMemObject(cl->upload, cl->pinned[i],
                                            cl->compute.staging.halves[i], 0, NULL, NULL);
        if (cl->pinned[i])
            cl->api.clReleaseMemObject(cl->pinned[i]);
    }
    if (cl->upload) {
        cl->api.clFinish(cl->upload);
        cl->api.clReleaseCommandQueue(cl->upload);
    }
}

static int open_context(struct opencl *cl)
{
    const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM,
                                                (cl_context_properties)cl->device.platform, 0};
    cl_int code;

    cl->context = cl->api.clCreateContext(properties, 1, &cl->device.id, NULL, NULL, &code);
    return code == CL_SUCCESS ? 0 : bake_compute_fail(&cl->compute, "clCreateContext", code);
}

static int prepare(struct opencl *cl, const struct bake_job *job)
{
    struct bake_compute *compute = &cl->compute;
    int status = bake_compute_prepare(compute, job);

    snprintf(compute->device_name, sizeof compute->device_name, "%s", cl->device.name);
    snprintf(compute->base.name, sizeof compute->base.name, "%s", cl->device.name);
    compute->shares_memory = cl->device.host_memory;
    if (status == 0)
        status = bsq_calloc(compute->ctx, "OpenCL workers", compute->worker_count,
                            sizeof *cl->workers, &cl->workers);
    if (status == 0)
        status = bake_compute_share_memory(compute, job, memory_limit(cl), cl->device.buffer_bytes);
    if (compute->base.buffer_bytes > BAKE_MAX_BUFFER_BYTES)
        compute->base.buffer_bytes = BAKE_MAX_BUFFER_BYTES;
    if (status == 0)
        status = open_context(cl);
    if (status == 0)
        status = bake_opencl_build(compute->ctx, &cl->api, &cl->device, cl->context, &cl->program);
    if (status == 0)
        status = open_upload(cl);
    return status < 0 ? status : bake_compute_send_triangles(compute, job);
}

static void opencl_close(struct bake_backend *backend)
{
    struct opencl *cl = (struct opencl *)backend;

    close_upload(cl);
    bake_compute_unload(&cl->compute);
    if (cl->program)
        cl->api.clReleaseProgram(cl->program);
    if (cl->context)
        cl->api.clReleaseContext(cl->context);
    bsq_free(cl->compute.ctx, cl->workers);
    bake_compute_free(&cl->compute);
}

static int opencl_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                       struct bake_backend **out)
{
    struct opencl *cl;
    int status = bsq_calloc(ctx, "OpenCL device", 1, sizeof *cl, &cl);

    *out = NULL;
    if (status < 0)
        return status;
    bake_compute_init(&cl->compute, ctx, &calls, opencl_close);
    status = choose(cl, index);
    if (status == 0)
        status = prepare(cl, job);
    if (status < 0)
        opencl_close(&cl->compute.base);
    else
        *out = &cl->compute.base;
    return status;
}

const struct bake_device_kind bake_opencl_kind = {
    .name = "opencl", .drivers = "OpenCL", .open = opencl_open, .list = bake_opencl_list};
