/* device_opencl.c - the kernel on an OpenCL device.
 *
 * One context a job. The grid, or two parts of it at a time, go up through two small pieces of host
 * memory in turn, each array into a buffer of its own. Every
 * worker has its own in-order queue, kernel object (setting arguments is not thread-safe) and tile
 * buffers, so workers overlap each other's transfers and never wait for a lock. A tile is enqueued
 * in slices of rows that are short enough for the watchdogs of desktop drivers. */
#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/clock.h"
#include "libbake/busy_internal.h"
#include "libbake/device_backend_internal.h"
#include "libbake/kernel_cache_internal.h"
#include "libbake/opencl_api_internal.h"
#include "libbake/slices_internal.h"
#include "libbake/stage_internal.h"

/* The flattened kernel source. */
static const char kernel_source[] =
#include "kernel_source.inc"
    ;

enum {
    STAGE_BYTES = 8 << 20, /* of the grid at a time */
    /* Side of a work group. It is the same for all tiles: some drivers compile once for each size.
     */
    GROUP = 8
};

enum {
    ARG_TRIANGLES = BAKE_PART_ARRAYS,
    ARG_PARAMS,
    ARG_TILE,
    ARG_FIRST_ROW,
    ARG_END_ROW,
    ARG_SAMPLES,
    ARG_TEXELS
};

/* What one worker uses; made by its first tile. */
struct worker {
    cl_command_queue queue;
    cl_kernel kernel;
    cl_mem samples, texels;
    struct bake_slices slices;
    uint64_t launches;
};

/* Events of a tile, in the order of the queue. */
enum { COPIED_SAMPLES, FIRST_KERNEL, LAST_KERNEL, COPIED_TEXELS, EVENTS };

/* A part of the grid on the device. */
struct loaded {
    cl_mem arrays[BAKE_PART_ARRAYS];
    struct bk_params params;
    uint64_t reserved_bytes; /* of host memory, on devices that share it */
};

struct upload {
    struct bake_stage stage;
    cl_command_queue queue;
    cl_event taken[2]; /* the device has what was in the piece */
    cl_mem to;
    uint64_t at;
    cl_int code; /* of the call that failed */
};

struct opencl {
    struct bake_backend base;
    struct bsq_ctx *ctx;
    struct bake_opencl_api api;
    struct bake_opencl_device device;
    cl_context context;
    cl_program program;
    cl_mem triangles;
    struct loaded loaded[BAKE_SLOTS];
    struct upload upload;
    struct bk_params params;
    uint32_t tile_texels;
    uint64_t reserved_bytes; /* of host memory, on devices that share it */
    unsigned worker_count;
    struct worker *workers;
    double upload_seconds;
    pthread_mutex_t lock; /* of what follows */
    struct bake_busy copies, kernels;
};

static int fail_open(const struct opencl *cl, const char *call, cl_int code)
{
    char number[32];
    return bsq_fail(cl->ctx, BSQ_ENODEVICE, "%s: %s: %s", cl->device.name, call,
                    bake_opencl_error(code, number));
}

static uint64_t sample_bytes(const struct opencl *cl)
{
    return (uint64_t)cl->tile_texels * cl->params.samples * cl->params.samples * sizeof(uint32_t);
}

static uint64_t texel_bytes(const struct opencl *cl)
{
    return (uint64_t)cl->tile_texels * sizeof(struct bk_texel);
}

/* ---- memory ---- */

/* What the job may use of the device's memory. Drivers and the desktop need some too, and there is
 * no asking how much. */
static uint64_t memory_limit(const struct opencl *cl, const struct bake_job *job)
{
    uint64_t limit = cl->device.memory_bytes / 8 * 7;

    if (cl->device.host_memory) {
        const uint64_t budget = bsq_memory_limit(cl->ctx), used = bsq_memory_used(cl->ctx);
        const uint64_t left = used < budget ? (budget - used) / 4 * 3 : 0;
        limit = left < limit ? left : limit;
    }
    return job->device_memory && job->device_memory < limit ? job->device_memory : limit;
}

/* Sets aside what is there for the whole job; the rest is for the grid. */
static int share_memory(struct opencl *cl, const struct bake_job *job)
{
    const uint64_t triangles = job->triangle_count * (uint64_t)sizeof *job->triangles;
    const uint64_t fixed = cl->worker_count * (sample_bytes(cl) + texel_bytes(cl)) + triangles;
    const uint64_t limit = memory_limit(cl, job), buffer = cl->device.buffer_bytes;
    int status = 0;

    if (triangles > buffer || sample_bytes(cl) > buffer)
        return bsq_fail(cl->ctx, BSQ_ENODEVICE,
                        "%s: the low mesh's triangles take %" PRIu64 " bytes and a tile's samples "
                        "%" PRIu64 ", a buffer of this device holds %" PRIu64,
                        cl->device.name, triangles, sample_bytes(cl), buffer);
    if (fixed >= limit)
        return bsq_fail(cl->ctx, BSQ_ENODEVICE,
                        "%s: tiles and the low mesh take %" PRIu64 " bytes of the device's memory, "
                        "%" PRIu64 " are allowed: give more, or fewer --threads",
                        cl->device.name, fixed, limit);
    cl->base.memory_bytes = limit - fixed;
    cl->base.other_bytes = fixed;
    cl->base.buffer_bytes = buffer < BAKE_BUFFER_MOST ? buffer : BAKE_BUFFER_MOST;
    if (cl->device.host_memory) {
        status = bsq_reserve(cl->ctx, "tiles on a device that shares host memory", fixed);
        cl->reserved_bytes = status == 0 ? fixed : 0;
    }
    return status;
}

static void close_upload(struct opencl *cl)
{
    struct upload *upload = &cl->upload;

    if (upload->queue)
        cl->api.clFinish(upload->queue);
    for (int i = 0; i < 2; i++) {
        if (upload->taken[i])
            cl->api.clReleaseEvent(upload->taken[i]);
        bsq_free(cl->ctx, upload->stage.pieces[i]);
    }
    if (upload->queue)
        cl->api.clReleaseCommandQueue(upload->queue);
    *upload = (struct upload){0};
}

/* Waits until a piece may be filled. */
static cl_int wait_for_piece(struct opencl *cl, cl_event *taken)
{
    cl_int code = CL_SUCCESS;

    if (*taken) {
        code = cl->api.clWaitForEvents(1, taken);
        cl->api.clReleaseEvent(*taken);
        *taken = NULL;
    }
    return code;
}

static int send_piece(void *device, unsigned turn, uint64_t bytes)
{
    struct opencl *cl = device;
    struct upload *upload = &cl->upload;

    upload->code =
        cl->api.clEnqueueWriteBuffer(upload->queue, upload->to, CL_FALSE, upload->at, bytes,
                                     upload->stage.pieces[turn], 0, NULL, &upload->taken[turn]);
    if (upload->code == CL_SUCCESS)
        upload->code = cl->api.clFlush(upload->queue);
    upload->at += bytes;
    if (upload->code == CL_SUCCESS)
        upload->code = wait_for_piece(cl, &upload->taken[turn ^ 1]);
    return upload->code == CL_SUCCESS ? bsq_check(cl->ctx) : BSQ_ENODEVICE;
}

static int open_upload(struct opencl *cl)
{
    struct upload *upload = &cl->upload;
    cl_int code;

    upload->stage =
        (struct bake_stage){.piece_bytes = STAGE_BYTES, .send = send_piece, .device = cl};
    upload->queue = cl->api.clCreateCommandQueue(cl->context, cl->device.id, 0, &code);
    if (code != CL_SUCCESS)
        return fail_open(cl, "clCreateCommandQueue", code);
    for (int i = 0; i < 2; i++) {
        int status =
            bsq_alloc(cl->ctx, "staging of the grid", STAGE_BYTES, 1, &upload->stage.pieces[i]);
        if (status < 0)
            return status;
    }
    return 0;
}

/* Makes a buffer that what is put into the stage from now on goes to. */
static int begin_upload(struct opencl *cl, uint64_t bytes, cl_mem *buffer)
{
    struct upload *upload = &cl->upload;

    /* Empty arrays are never read, but an argument has to be a buffer. */
    *buffer = cl->api.clCreateBuffer(cl->context, CL_MEM_READ_ONLY, bytes ? bytes : 8, NULL,
                                     &upload->code);
    upload->to = *buffer;
    upload->at = upload->stage.used = 0;
    return upload->code == CL_SUCCESS ? 0 : BSQ_ENODEVICE;
}

static int finish_upload(struct opencl *cl)
{
    struct upload *upload = &cl->upload;
    int status = bake_stage_flush(&upload->stage);

    if (status == 0) {
        upload->code = cl->api.clFinish(upload->queue);
        status = upload->code == CL_SUCCESS ? 0 : BSQ_ENODEVICE;
    }
    return status;
}

static int upload_triangles(struct opencl *cl, const struct bake_job *job)
{
    const uint64_t bytes = job->triangle_count * (uint64_t)sizeof *job->triangles;
    int status = open_upload(cl);

    if (status < 0)
        return status;
    status = begin_upload(cl, bytes, &cl->triangles);
    if (status == 0)
        status = bake_stage_put(&cl->upload.stage, job->triangles, bytes);
    if (status == 0)
        status = finish_upload(cl);
    return status == BSQ_ENODEVICE ? fail_open(cl, "triangles", cl->upload.code) : status;
}

static void unload(struct opencl *cl, struct loaded *loaded)
{
    for (int i = 0; i < BAKE_PART_ARRAYS; i++)
        if (loaded->arrays[i])
            cl->api.clReleaseMemObject(loaded->arrays[i]);
    bsq_release(cl->ctx, loaded->reserved_bytes);
    *loaded = (struct loaded){0};
}

static int load_part(struct opencl *cl, struct loaded *loaded, const struct bake_part *part,
                     const char **what)
{
    uint64_t total = 0;
    int status = 0;

    for (int i = 0; i < BAKE_PART_ARRAYS; i++)
        total += part->bytes[i];
    *what = "memory that the device shares";
    if (cl->device.host_memory) {
        status = bsq_reserve(cl->ctx, "grid on a device that shares host memory", total);
        if (status < 0)
            return status;
        loaded->reserved_bytes = total;
    }
    loaded->params = part->params;
    for (int i = 0; i < BAKE_PART_ARRAYS && status == 0; i++) {
        *what = bake_part_array_name(i);
        status = begin_upload(cl, part->bytes[i], &loaded->arrays[i]);
        if (status == 0)
            status = bake_part_send(part, i, bake_stage_put, &cl->upload.stage);
        if (status == 0)
            status = bake_stage_flush(&cl->upload.stage);
    }
    return status == 0 ? finish_upload(cl) : status;
}

static int opencl_load(struct bake_backend *backend, unsigned slot, const struct bake_part *part,
                       char *why)
{
    struct opencl *cl = (struct opencl *)backend;
    const double started = bsq_seconds_now();
    char number[32];
    const char *what;

    cl->upload.code = CL_SUCCESS;
    unload(cl, &cl->loaded[slot]);
    int status = load_part(cl, &cl->loaded[slot], part, &what);
    if (status < 0) {
        cl->api.clFinish(cl->upload.queue);
        snprintf(why, BAKE_WHY_BYTES, "%s: %s", what,
                 cl->upload.code == CL_SUCCESS ? bsq_error(cl->ctx)
                                               : bake_opencl_error(cl->upload.code, number));
    }
    cl->upload_seconds += bsq_seconds_now() - started;
    return status;
}

/* The end of a build log holds the last error; line breaks become " | ". */
static int fail_build(struct opencl *cl, cl_int code)
{
    char *log = NULL, line[400] = "", number[32];
    size_t bytes = 0, used = 0;

    cl->api.clGetProgramBuildInfo(cl->program, cl->device.id, CL_PROGRAM_BUILD_LOG, 0, NULL,
                                  &bytes);
    if (bytes && bsq_calloc(cl->ctx, "build log", bytes + 1, 1, &log) == 0)
        cl->api.clGetProgramBuildInfo(cl->program, cl->device.id, CL_PROGRAM_BUILD_LOG, bytes, log,
                                      NULL);
    for (const char *p = log; p && *p && used + 4 < sizeof line; p++) {
        const char *piece = *p == '\n' ? " | " : (char[2]){*p, '\0'};
        used += (size_t)snprintf(line + used, sizeof line - used, "%s", piece);
    }
    bsq_free(cl->ctx, log);
    return bsq_fail(cl->ctx, BSQ_ENODEVICE, "%s: clBuildProgram: %s: %s", cl->device.name,
                    bake_opencl_error(code, number), line);
}

/* Makes the program from what an earlier run compiled. */
static bool build_from_cache(struct opencl *cl, const char *key, const char *options)
{
    void *binary;
    uint64_t bytes;
    cl_int code, status = CL_SUCCESS;

    if (!bake_kernel_cache_get(key, &binary, &bytes))
        return false;
    cl->program =
        cl->api.clCreateProgramWithBinary(cl->context, 1, &cl->device.id, &(size_t){bytes},
                                          &(const unsigned char *){binary}, &status, &code);
    free(binary);
    if (code == CL_SUCCESS)
        code = status;
    if (code == CL_SUCCESS)
        code = cl->api.clBuildProgram(cl->program, 1, &cl->device.id, options, NULL, NULL);
    if (code == CL_SUCCESS)
        return true;
    if (cl->program)
        cl->api.clReleaseProgram(cl->program);
    cl->program = NULL;
    return false;
}

static void keep_binary(struct opencl *cl, const char *key)
{
    size_t bytes = 0;
    unsigned char *binary = NULL;

    if (cl->api.clGetProgramInfo(cl->program, CL_PROGRAM_BINARY_SIZES, sizeof bytes, &bytes,
                                 NULL) != CL_SUCCESS ||
        bytes == 0)
        return;
    binary = malloc(bytes);
    if (binary && cl->api.clGetProgramInfo(cl->program, CL_PROGRAM_BINARIES, sizeof binary, &binary,
                                           NULL) == CL_SUCCESS)
        bake_kernel_cache_put(key, binary, bytes);
    free(binary);
}

static int build(struct opencl *cl)
{
    const char *source = kernel_source;
    const char *options = cl->device.rounds_correctly
                              ? "-cl-std=CL1.2 -cl-fp32-correctly-rounded-divide-sqrt"
                              : "-cl-std=CL1.2";
    char key[1024];
    cl_int code;

    snprintf(key, sizeof key, "%016" PRIx64 "\n%s\n%s\n%s",
             bake_kernel_hash(kernel_source, sizeof kernel_source), options, cl->device.name,
             cl->device.driver);
    if (build_from_cache(cl, key, options))
        return 0;
    cl->program = cl->api.clCreateProgramWithSource(cl->context, 1, &source, NULL, &code);
    if (code != CL_SUCCESS)
        return fail_open(cl, "clCreateProgramWithSource", code);
    code = cl->api.clBuildProgram(cl->program, 1, &cl->device.id, options, NULL, NULL);
    if (code != CL_SUCCESS)
        return fail_build(cl, code);
    keep_binary(cl, key);
    return 0;
}

static void close_worker(struct opencl *cl, struct worker *worker)
{
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

/* Sets the arguments that are the same for all tiles of a part. */
static const char *set_part_arguments(const struct opencl *cl, const struct worker *worker,
                                      const struct loaded *loaded, cl_int *code)
{
    *code = CL_SUCCESS;
    for (cl_uint i = 0; i < BAKE_PART_ARRAYS && *code == CL_SUCCESS; i++)
        *code = cl->api.clSetKernelArg(worker->kernel, i, sizeof(cl_mem), &loaded->arrays[i]);
    if (*code == CL_SUCCESS)
        *code =
            cl->api.clSetKernelArg(worker->kernel, ARG_TRIANGLES, sizeof(cl_mem), &cl->triangles);
    if (*code == CL_SUCCESS)
        *code = cl->api.clSetKernelArg(worker->kernel, ARG_PARAMS, sizeof loaded->params,
                                       &loaded->params);
    if (*code == CL_SUCCESS)
        *code =
            cl->api.clSetKernelArg(worker->kernel, ARG_SAMPLES, sizeof(cl_mem), &worker->samples);
    if (*code == CL_SUCCESS)
        *code = cl->api.clSetKernelArg(worker->kernel, ARG_TEXELS, sizeof(cl_mem), &worker->texels);
    return "clSetKernelArg";
}

/* Returns the call that failed with its code. */
static const char *open_worker(struct opencl *cl, struct worker *worker, cl_int *code)
{
    worker->queue =
        cl->api.clCreateCommandQueue(cl->context, cl->device.id, CL_QUEUE_PROFILING_ENABLE, code);
    if (*code != CL_SUCCESS)
        return "clCreateCommandQueue";
    worker->kernel = cl->api.clCreateKernel(cl->program, "bake_tile", code);
    if (*code != CL_SUCCESS)
        return "clCreateKernel";
    worker->samples =
        cl->api.clCreateBuffer(cl->context, CL_MEM_READ_ONLY, sample_bytes(cl), NULL, code);
    if (*code != CL_SUCCESS)
        return "clCreateBuffer";
    worker->texels =
        cl->api.clCreateBuffer(cl->context, CL_MEM_WRITE_ONLY, texel_bytes(cl), NULL, code);
    if (*code != CL_SUCCESS)
        return "clCreateBuffer";
    return "";
}

static size_t round_up(size_t count, size_t step)
{
    return (count + step - 1) / step * step;
}

/* Enqueues a tile's rows slice by slice. */
static const char *enqueue_slices(struct opencl *cl, struct worker *worker,
                                  const struct bk_tile *tile, cl_event events[EVENTS], cl_int *code)
{
    uint64_t row_samples = (uint64_t)tile->width * cl->params.samples * cl->params.samples;
    uint32_t rows = bake_slice_rows(&worker->slices, row_samples, tile->height);

    const size_t group[2] = {GROUP, GROUP};

    *code = cl->api.clSetKernelArg(worker->kernel, ARG_TILE, sizeof *tile, tile);
    if (*code != CL_SUCCESS)
        return "clSetKernelArg";
    for (cl_uint row = 0; row < tile->height; row += rows) {
        const cl_uint end = row + (tile->height - row < rows ? tile->height - row : rows);
        const size_t size[2] = {round_up(tile->width, GROUP), round_up(end - row, GROUP)};
        *code = cl->api.clSetKernelArg(worker->kernel, ARG_FIRST_ROW, sizeof row, &row);
        if (*code == CL_SUCCESS)
            *code = cl->api.clSetKernelArg(worker->kernel, ARG_END_ROW, sizeof end, &end);
        if (*code != CL_SUCCESS)
            return "clSetKernelArg";
        *code = cl->api.clEnqueueNDRangeKernel(worker->queue, worker->kernel, 2, NULL, size, group,
                                               0, NULL,
                                               row == 0              ? &events[FIRST_KERNEL]
                                               : end == tile->height ? &events[LAST_KERNEL]
                                                                     : NULL);
        worker->launches++;
        if (*code != CL_SUCCESS)
            return "clEnqueueNDRangeKernel";
        *code = cl->api.clFlush(worker->queue);
        if (*code != CL_SUCCESS)
            return "clFlush";
    }
    return "";
}

static cl_ulong event_time(const struct opencl *cl, cl_event event, cl_profiling_info what,
                           cl_int *code)
{
    cl_ulong nanoseconds = 0;
    if (*code == CL_SUCCESS)
        *code =
            cl->api.clGetEventProfilingInfo(event, what, sizeof nanoseconds, &nanoseconds, NULL);
    return nanoseconds;
}

static const char *note_times(struct opencl *cl, struct worker *worker, uint64_t samples,
                              const cl_event events[EVENTS], cl_int *code)
{
    /* A tile of one slice has one kernel. */
    cl_event last = events[LAST_KERNEL] ? events[LAST_KERNEL] : events[FIRST_KERNEL];
    double times[6];

    times[0] =
        1e-9 * (double)event_time(cl, events[COPIED_SAMPLES], CL_PROFILING_COMMAND_START, code);
    times[1] =
        1e-9 * (double)event_time(cl, events[COPIED_SAMPLES], CL_PROFILING_COMMAND_END, code);
    times[2] =
        1e-9 * (double)event_time(cl, events[FIRST_KERNEL], CL_PROFILING_COMMAND_START, code);
    times[3] = 1e-9 * (double)event_time(cl, last, CL_PROFILING_COMMAND_END, code);
    times[4] =
        1e-9 * (double)event_time(cl, events[COPIED_TEXELS], CL_PROFILING_COMMAND_START, code);
    times[5] = 1e-9 * (double)event_time(cl, events[COPIED_TEXELS], CL_PROFILING_COMMAND_END, code);
    if (*code != CL_SUCCESS)
        return "clGetEventProfilingInfo";
    bake_slices_learn(&worker->slices, samples, times[3] - times[2]);
    pthread_mutex_lock(&cl->lock);
    bake_busy_add(&cl->copies, times[0], times[1]);
    bake_busy_add(&cl->kernels, times[2], times[3]);
    bake_busy_add(&cl->copies, times[4], times[5]);
    pthread_mutex_unlock(&cl->lock);
    return "";
}

/* Puts a tile's copies and kernels into the worker's queue and waits for them. */
static const char *run_tile(struct opencl *cl, struct worker *worker, const struct bk_tile *tile,
                            const uint32_t *sample_triangles, struct bk_texel *texels,
                            cl_event events[EVENTS], cl_int *code)
{
    uint64_t texel_count = (uint64_t)tile->width * tile->height;
    uint64_t samples = texel_count * cl->params.samples * cl->params.samples;
    const char *call;

    *code = cl->api.clEnqueueWriteBuffer(worker->queue, worker->samples, CL_FALSE, 0,
                                         samples * sizeof *sample_triangles, sample_triangles, 0,
                                         NULL, &events[COPIED_SAMPLES]);
    if (*code != CL_SUCCESS)
        return "clEnqueueWriteBuffer";
    call = enqueue_slices(cl, worker, tile, events, code);
    if (*code != CL_SUCCESS)
        return call;
    *code = cl->api.clEnqueueReadBuffer(worker->queue, worker->texels, CL_TRUE, 0,
                                        texel_count * sizeof *texels, texels, 0, NULL,
                                        &events[COPIED_TEXELS]);
    if (*code == CL_SUCCESS)
        *code = cl->api.clWaitForEvents(1, &events[COPIED_TEXELS]);
    if (*code != CL_SUCCESS)
        return "clEnqueueReadBuffer";
    return note_times(cl, worker, samples, events, code);
}

static const char *trace_tile(struct opencl *cl, struct worker *worker, const struct loaded *loaded,
                              const struct bk_tile *tile, const uint32_t *sample_triangles,
                              struct bk_texel *texels, cl_int *code)
{
    cl_event events[EVENTS] = {NULL};
    const char *call;

    if (!worker->queue) {
        call = open_worker(cl, worker, code);
        if (*code != CL_SUCCESS) {
            close_worker(cl, worker);
            return call;
        }
    }
    call = set_part_arguments(cl, worker, loaded, code);
    if (*code != CL_SUCCESS)
        return call;
    call = run_tile(cl, worker, tile, sample_triangles, texels, events, code);
    /* The caller's buffers are in use until the queue is empty. */
    if (*code != CL_SUCCESS)
        cl->api.clFinish(worker->queue);
    for (int i = 0; i < EVENTS; i++)
        if (events[i])
            cl->api.clReleaseEvent(events[i]);
    return call;
}

static int opencl_trace(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                        const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker,
                        char *why)
{
    struct opencl *cl = (struct opencl *)backend;
    char number[32];
    cl_int code = CL_SUCCESS;
    const char *call;

    if (worker >= cl->worker_count || (uint64_t)tile->width * tile->height > cl->tile_texels) {
        snprintf(why, BAKE_WHY_BYTES, "worker %u, tile of %u x %u texels: out of range", worker,
                 (unsigned)tile->width, (unsigned)tile->height);
        return BSQ_EBUG;
    }
    call = trace_tile(cl, &cl->workers[worker], &cl->loaded[slot], tile, sample_triangles, texels,
                      &code);
    if (code == CL_SUCCESS)
        return 0;
    snprintf(why, BAKE_WHY_BYTES, "%s: %s", call, bake_opencl_error(code, number));
    return BSQ_ENODEVICE;
}

static void opencl_times(struct bake_backend *backend, struct bake_device_times *out)
{
    struct opencl *cl = (struct opencl *)backend;

    *out = (struct bake_device_times){.upload = cl->upload_seconds,
                                      .copies = bake_busy_seconds(&cl->copies),
                                      .kernels = bake_busy_seconds(&cl->kernels)};
    for (unsigned i = 0; i < cl->worker_count; i++)
        out->launches += cl->workers[i].launches;
}

static void opencl_close(struct bake_backend *backend)
{
    struct opencl *cl = (struct opencl *)backend;

    for (unsigned i = 0; cl->workers && i < cl->worker_count; i++)
        close_worker(cl, &cl->workers[i]);
    close_upload(cl);
    for (int i = 0; i < BAKE_SLOTS; i++)
        unload(cl, &cl->loaded[i]);
    if (cl->triangles)
        cl->api.clReleaseMemObject(cl->triangles);
    if (cl->program)
        cl->api.clReleaseProgram(cl->program);
    if (cl->context)
        cl->api.clReleaseContext(cl->context);
    bsq_release(cl->ctx, cl->reserved_bytes);
    bsq_free(cl->ctx, cl->workers);
    pthread_mutex_destroy(&cl->lock);
    bsq_free(cl->ctx, cl);
}

/* Finds the device asked for; the error lists what is there. */
static int choose(struct opencl *cl, int64_t index)
{
    struct bake_opencl_device device;
    char there[400] = "";
    uint32_t count = 0;
    bool found = false;

    if (!bake_opencl_load(&cl->api))
        return bsq_fail(cl->ctx, BSQ_ENODEVICE, "OpenCL is not installed (libOpenCL.so.1)");
    for (; bake_opencl_device(&cl->api, count, &device); count++) {
        size_t used = strlen(there);
        bool wanted = index == BAKE_OPENCL_FIRST ? !found || (device.is_gpu && !cl->device.is_gpu)
                                                 : (int64_t)count == index;
        if (wanted) {
            cl->device = device;
            found = true;
        }
        snprintf(there + used, sizeof there - used, "%s opencl:%u %s", count ? "," : "",
                 (unsigned)count, device.name);
    }
    if (count == 0)
        return bsq_fail(cl->ctx, BSQ_ENODEVICE, "OpenCL has no devices (no driver is installed)");
    if (!found)
        return bsq_fail(cl->ctx, BSQ_ENODEVICE, "there is no device opencl:%" PRId64 "; there is%s",
                        index, there);
    return 0;
}

static int prepare(struct opencl *cl, const struct bake_job *job)
{
    cl_context_properties properties[] = {CL_CONTEXT_PLATFORM,
                                          (cl_context_properties)cl->device.platform, 0};
    cl_int code;
    int status;

    snprintf(cl->base.name, sizeof cl->base.name, "%s", cl->device.name);
    cl->params = job->params;
    cl->tile_texels = job->tile_texels;
    cl->worker_count = bsq_threads(cl->ctx);
    status =
        bsq_calloc(cl->ctx, "OpenCL workers", cl->worker_count, sizeof *cl->workers, &cl->workers);
    if (status < 0)
        return status;
    status = share_memory(cl, job);
    if (status < 0)
        return status;
    cl->context = cl->api.clCreateContext(properties, 1, &cl->device.id, NULL, NULL, &code);
    if (code != CL_SUCCESS)
        return fail_open(cl, "clCreateContext", code);
    status = build(cl);
    return status < 0 ? status : upload_triangles(cl, job);
}

int bake_opencl_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                     struct bake_backend **out)
{
    struct opencl *cl;
    int status = bsq_calloc(ctx, "OpenCL device", 1, sizeof *cl, &cl);

    *out = NULL;
    if (status < 0)
        return status;
    cl->ctx = ctx;
    pthread_mutex_init(&cl->lock, NULL);
    cl->base.trace = opencl_trace;
    cl->base.load = opencl_load;
    cl->base.times = opencl_times;
    cl->base.close = opencl_close;
    status = choose(cl, index);
    if (status == 0)
        status = prepare(cl, job);
    if (status < 0)
        opencl_close(&cl->base);
    else
        *out = &cl->base;
    return status;
}
