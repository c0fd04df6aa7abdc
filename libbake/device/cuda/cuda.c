/* cuda.c - runs the kernel on an NVIDIA GPU, through the driver API.
 *
 * The build compiles the kernel to PTX; the driver compiles that for the card and caches the
 * result. Every worker has its own stream, tile memory on the device, and page-locked memory on the
 * host, which the device reads and writes by itself. So workers overlap each other's copies and
 * kernels and never wait for a lock. */
#include <stdio.h>
#include <string.h>

#include "libbake/device/compute/compute.h"
#include "libbake/device/cuda/cuda.h"
#include "libbake/device/cuda/cuda_api.h"

enum {
    STAGING_BYTES = 16 << 20 /* half of the staging buffer */
};

/* A warp is 8 x 4 texels: near in the map, so mostly near in the grid. The compiler would take
 * about 168 registers, which allow 12 warps on a multiprocessor; 128 registers allow 16, which hide
 * more of the memory's latency. The registers spilled are used once a ray pair, outside the loops.
 */
static const struct bake_cuda_tuning default_tuning = {
    .registers = 128, .block_width = 8, .block_height = 16};

/* Events of a tile, in the order of the stream. */
enum { BEFORE_SAMPLES, BEFORE_KERNELS, AFTER_KERNELS, AFTER_TEXELS, EVENTS };

/* A worker's part; its first tile creates it. */
struct worker {
    CUstream stream;
    CUevent events[EVENTS];
    CUevent before;     /* the end of the previous tile, or the worker's creation */
    double before_time; /* of that event, on the device's clock */
    CUdeviceptr samples, texels;
    void *host_samples, *host_texels; /* page-locked */
};

struct cuda {
    struct bake_compute compute;
    struct bake_cuda_api api;
    struct bake_cuda_device device;
    struct bake_cuda_tuning tuning;
    CUcontext context;
    CUmodule module;
    CUfunction kernel;
    CUevent origin; /* zero of the device's clock */
    CUstream upload;
    CUevent taken[2]; /* the device has copied this half of the staging buffer */
    struct worker *workers;
};

static const char *cuda_describe(const struct bake_compute *compute, int code, char *buffer)
{
    _Static_assert((int)BAKE_COMPUTE_TEXT >= (int)BAKE_CUDA_TEXT, "errors fit");
    return bake_cuda_error(&((const struct cuda *)compute)->api, code, buffer);
}

static bool cuda_lacks_memory(int code)
{
    return code == CUDA_ERROR_OUT_OF_MEMORY;
}

static const char *cuda_attach(struct bake_compute *compute, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;

    *code = cuda->api.cuCtxSetCurrent(cuda->context);
    return "cuCtxSetCurrent";
}

/* ---- memory ---- */

static void cuda_allocate(struct bake_compute *compute, uint64_t bytes, bake_memory *out, int *code)
{
    CUdeviceptr memory = 0;

    *code = ((struct cuda *)compute)->api.cuMemAlloc(&memory, bytes);
    *out = memory;
}

/* Returns the device's free memory less a sixteenth of all: at the first launch the driver takes
 * some for spilled registers, and it rounds each array up. */
static CUresult free_memory(const struct cuda *cuda, uint64_t *out)
{
    size_t free_bytes = 0, all_bytes = 0;
    CUresult code = cuda->api.cuMemGetInfo(&free_bytes, &all_bytes);

    *out = free_bytes > all_bytes / 16 ? free_bytes - all_bytes / 16 : 0;
    return code;
}

static uint64_t cuda_free_bytes(struct bake_compute *compute)
{
    uint64_t bytes;

    return free_memory((struct cuda *)compute, &bytes) == CUDA_SUCCESS ? bytes : 0;
}

static void cuda_release(struct bake_compute *compute, bake_memory memory)
{
    ((struct cuda *)compute)->api.cuMemFree(memory);
}

static void cuda_send_half(struct bake_compute *compute, unsigned half, uint64_t bytes,
                           bake_memory to, uint64_t at, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;

    *code =
        cuda->api.cuMemcpyHtoDAsync(to + at, compute->staging.halves[half], bytes, cuda->upload);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuEventRecord(cuda->taken[half], cuda->upload);
}

static void cuda_wait_for_half(struct bake_compute *compute, unsigned half, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    /* An event that was never recorded counts as over. */
    *code = cuda->api.cuEventSynchronize(cuda->taken[half]);
}

static void cuda_finish_uploads(struct bake_compute *compute, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    *code = cuda->api.cuStreamSynchronize(cuda->upload);
}

/* ---- tiles ---- */

static void cuda_close_worker(struct bake_compute *compute, unsigned number)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];

    if (worker->stream) {
        cuda->api.cuStreamSynchronize(worker->stream);
        cuda->api.cuStreamDestroy(worker->stream);
    }
    for (int i = 0; i < EVENTS; i++)
        if (worker->events[i])
            cuda->api.cuEventDestroy(worker->events[i]);
    if (worker->before)
        cuda->api.cuEventDestroy(worker->before);
    if (worker->samples)
        cuda->api.cuMemFree(worker->samples);
    if (worker->texels)
        cuda->api.cuMemFree(worker->texels);
    if (worker->host_samples)
        cuda->api.cuMemFreeHost(worker->host_samples);
    if (worker->host_texels)
        cuda->api.cuMemFreeHost(worker->host_texels);
    *worker = (struct worker){0};
}

/* Computes the seconds between two events that are over. The API has float: hours are coarse. */
static const char *elapsed(const struct cuda *cuda, CUevent from, CUevent to, double *seconds,
                           int *code)
{
    float milliseconds = 0;

    *code = cuda->api.cuEventElapsedTime(&milliseconds, from, to);
    *seconds = 1e-3 * (double)milliseconds;
    return "cuEventElapsedTime";
}

static const char *begin_clock(struct cuda *cuda, struct worker *worker, int *code)
{
    *code = cuda->api.cuEventCreate(&worker->before, CU_EVENT_BLOCKING_SYNC);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuEventRecord(worker->before, worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuEventSynchronize(worker->before);
    if (*code != CUDA_SUCCESS)
        return "cuEventRecord";
    return elapsed(cuda, cuda->origin, worker->before, &worker->before_time, code);
}

static const char *cuda_open_worker(struct bake_compute *compute, unsigned number, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];
    const uint64_t sample_bytes = bake_compute_sample_bytes(compute);
    const uint64_t texel_bytes = bake_compute_texel_bytes(compute);
    const char *call;

    *code = cuda->api.cuStreamCreate(&worker->stream, CU_STREAM_NON_BLOCKING);
    if (*code != CUDA_SUCCESS)
        return "cuStreamCreate";
    for (int i = 0; i < EVENTS && *code == CUDA_SUCCESS; i++)
        *code = cuda->api.cuEventCreate(&worker->events[i], CU_EVENT_BLOCKING_SYNC);
    if (*code != CUDA_SUCCESS)
        return "cuEventCreate";
    call = begin_clock(cuda, worker, code);
    if (*code != CUDA_SUCCESS)
        return call;
    *code = cuda->api.cuMemAlloc(&worker->samples, sample_bytes);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuMemAlloc(&worker->texels, texel_bytes);
    if (*code != CUDA_SUCCESS)
        return "cuMemAlloc";
    *code = cuda->api.cuMemAllocHost(&worker->host_samples, sample_bytes);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuMemAllocHost(&worker->host_texels, texel_bytes);
    return "cuMemAllocHost";
}

static const char *cuda_send_samples(struct bake_compute *compute, unsigned number,
                                     const struct bake_compute_subgrid *subgrid,
                                     const struct bk_tile *tile, const uint32_t *sample_triangles,
                                     uint64_t bytes, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];

    (void)subgrid;
    (void)tile;
    memcpy(worker->host_samples, sample_triangles, bytes);
    *code = cuda->api.cuEventRecord(worker->events[BEFORE_SAMPLES], worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuMemcpyHtoDAsync(worker->samples, worker->host_samples, bytes,
                                            worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuEventRecord(worker->events[BEFORE_KERNELS], worker->stream);
    return "cuMemcpyHtoDAsync";
}

/* Submits a launch by itself. Drivers of Windows, which WSL uses, collect launches and submit
 * several at once, and Windows ends work that takes seconds. */
static CUresult submit(const struct cuda *cuda, const struct worker *worker)
{
    const CUresult code = cuda->api.cuStreamQuery(worker->stream);

    return code == CUDA_ERROR_NOT_READY ? CUDA_SUCCESS : code;
}

static const char *cuda_launch(struct bake_compute *compute, unsigned number,
                               const struct bake_compute_subgrid *subgrid,
                               const struct bk_tile *tile, const struct bake_launch_batch *batch,
                               int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];
    const struct bake_cuda_tuning *tuning = &cuda->tuning;
    CUdeviceptr a[BAKE_SUBGRID_ARRAYS], triangles = compute->triangles;
    struct bk_params params = subgrid->params;
    struct bk_tile whole = *tile;
    struct bake_launch_batch rows_and_lines = *batch;
    const uint32_t rows = batch->end_row - batch->first_row;
    void *arguments[] = {&a[BAKE_TILES],
                         &a[BAKE_UPPERS],
                         &a[BAKE_LOWERS],
                         &a[BAKE_LEAVES],
                         &a[BAKE_NORMALS],
                         &a[BAKE_PLANES],
                         &a[BAKE_COLORS],
                         &a[BAKE_SECONDS],
                         &triangles,
                         &params,
                         &whole,
                         &rows_and_lines.first_row,
                         &rows_and_lines.end_row,
                         &rows_and_lines.first_line,
                         &rows_and_lines.end_line,
                         &worker->samples,
                         &worker->texels};

    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++)
        a[i] = subgrid->arrays[i];
    *code = cuda->api.cuLaunchKernel(
        cuda->kernel, (tile->width + tuning->block_width - 1) / tuning->block_width,
        (rows + tuning->block_height - 1) / tuning->block_height, 1, tuning->block_width,
        tuning->block_height, 1, 0, worker->stream, arguments, NULL);
    if (*code == CUDA_SUCCESS)
        *code = submit(cuda, worker);
    return "cuLaunchKernel";
}

static const char *cuda_fetch_texels(struct bake_compute *compute, unsigned number, float *texels,
                                     uint64_t bytes, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];

    *code = cuda->api.cuEventRecord(worker->events[AFTER_KERNELS], worker->stream);
    if (*code != CUDA_SUCCESS)
        return "cuLaunchKernel";
    *code = cuda->api.cuMemcpyDtoHAsync(worker->host_texels, worker->texels, bytes, worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuEventRecord(worker->events[AFTER_TEXELS], worker->stream);
    if (*code != CUDA_SUCCESS)
        return "cuMemcpyDtoHAsync";
    *code = cuda->api.cuEventSynchronize(worker->events[AFTER_TEXELS]);
    if (*code == CUDA_SUCCESS)
        memcpy(texels, worker->host_texels, bytes);
    return "cuEventSynchronize";
}

static const char *cuda_times(struct bake_compute *compute, unsigned number,
                              struct bake_tile_times *out, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];
    CUevent from = worker->before;
    double at[EVENTS], since = worker->before_time, seconds;

    /* Each from the previous event, so that times are as exact late in a long job. */
    for (int i = 0; i < EVENTS; i++) {
        const char *call = elapsed(cuda, from, worker->events[i], &seconds, code);
        if (*code != CUDA_SUCCESS)
            return call;
        at[i] = since += seconds;
        from = worker->events[i];
    }
    worker->events[AFTER_TEXELS] = worker->before;
    worker->before = from;
    worker->before_time = since;
    out->samples = (struct bake_span){at[BEFORE_SAMPLES], at[BEFORE_KERNELS]};
    out->kernels = (struct bake_span){at[BEFORE_KERNELS], at[AFTER_KERNELS]};
    out->texels = (struct bake_span){at[AFTER_KERNELS], at[AFTER_TEXELS]};
    return "";
}

/* Nothing to wait for: the device only uses the worker's page-locked memory. */
static void cuda_end_tile(struct bake_compute *compute, unsigned number, int code)
{
    (void)compute;
    (void)number;
    (void)code;
}

static const struct bake_compute_calls calls = {.describe = cuda_describe,
                                                .lacks_memory = cuda_lacks_memory,
                                                .attach = cuda_attach,
                                                .blocks = true,
                                                .allocate = cuda_allocate,
                                                .free_bytes = cuda_free_bytes,
                                                .release = cuda_release,
                                                .send_half = cuda_send_half,
                                                .wait_for_half = cuda_wait_for_half,
                                                .finish_uploads = cuda_finish_uploads,
                                                .open_worker = cuda_open_worker,
                                                .close_worker = cuda_close_worker,
                                                .send_samples = cuda_send_samples,
                                                .launch = cuda_launch,
                                                .fetch_texels = cuda_fetch_texels,
                                                .times = cuda_times,
                                                .end_tile = cuda_end_tile};

/* ---- opening and closing ---- */

static int load_kernel(struct cuda *cuda)
{
    char log[1024] = "", reason[BAKE_CUDA_REASON];
    int options[] = {CU_JIT_ERROR_LOG_BUFFER, CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES,
                     CU_JIT_MAX_REGISTERS};
    void *values[] = {log, (void *)(uintptr_t)(sizeof log - 1),
                      (void *)(uintptr_t)cuda->tuning.registers};
    CUresult code = cuda->api.cuModuleLoadDataEx(&cuda->module, bake_cuda_ptx,
                                                 cuda->tuning.registers ? 3 : 2, options, values);

    if (code != CUDA_SUCCESS) {
        bake_cuda_refusal(&cuda->api, code, log, reason);
        return bsq_fail(cuda->compute.ctx, BSQ_ENODEVICE, "%s: %s", cuda->device.name, reason);
    }
    code = cuda->api.cuModuleGetFunction(&cuda->kernel, cuda->module, "bake_tile");
    return code == CUDA_SUCCESS ? 0
                                : bake_compute_fail(&cuda->compute, "cuModuleGetFunction", code);
}

static int open_context(struct cuda *cuda)
{
    CUresult code = cuda->api.cuDevicePrimaryCtxRetain(&cuda->context, cuda->device.device);

    if (code != CUDA_SUCCESS) {
        cuda->context = NULL;
        return bake_compute_fail(&cuda->compute, "cuDevicePrimaryCtxRetain", code);
    }
    code = cuda->api.cuCtxSetCurrent(cuda->context);
    if (code == CUDA_SUCCESS)
        code = cuda->api.cuEventCreate(&cuda->origin, 0);
    if (code == CUDA_SUCCESS)
        code = cuda->api.cuEventRecord(cuda->origin, NULL);
    if (code == CUDA_SUCCESS) /* nothing else synchronises with the default stream */
        code = cuda->api.cuEventSynchronize(cuda->origin);
    return code == CUDA_SUCCESS ? 0 : bake_compute_fail(&cuda->compute, "cuEventRecord", code);
}

static int ask_memory(struct cuda *cuda, uint64_t *limit)
{
    CUresult code = free_memory(cuda, limit);

    return code == CUDA_SUCCESS ? 0 : bake_compute_fail(&cuda->compute, "cuMemGetInfo", code);
}

static int open_upload(struct cuda *cuda)
{
    struct bake_staging_buffer *staging = &cuda->compute.staging;
    CUresult code = cuda->api.cuStreamCreate(&cuda->upload, CU_STREAM_NON_BLOCKING);

    staging->half_bytes = STAGING_BYTES;
    for (int i = 0; i < 2 && code == CUDA_SUCCESS; i++) {
        code = cuda->api.cuMemAllocHost((void **)&staging->halves[i], STAGING_BYTES);
        if (code == CUDA_SUCCESS)
            code = cuda->api.cuEventCreate(&cuda->taken[i], CU_EVENT_BLOCKING_SYNC);
    }
    return code == CUDA_SUCCESS ? 0 : bake_compute_fail(&cuda->compute, "page-locked memory", code);
}

static void close_upload(struct cuda *cuda)
{
    if (cuda->upload) {
        cuda->api.cuStreamSynchronize(cuda->upload);
        cuda->api.cuStreamDestroy(cuda->upload);
    }
    for (int i = 0; i < 2; i++) {
        if (cuda->taken[i])
            cuda->api.cuEventDestroy(cuda->taken[i]);
        if (cuda->compute.staging.halves[i])
            cuda->api.cuMemFreeHost(cuda->compute.staging.halves[i]);
    }
}

/* Reserves page-locked memory for the workers and the staging buffer. */
static int reserve_host(struct cuda *cuda)
{
    struct bake_compute *compute = &cuda->compute;
    const uint64_t tile = bake_compute_sample_bytes(compute) + bake_compute_texel_bytes(compute);

    return bake_compute_reserve(compute, "page-locked memory for tiles",
                                compute->worker_count * tile + 2 * (uint64_t)STAGING_BYTES);
}

static int prepare(struct cuda *cuda, const struct bake_job *job)
{
    struct bake_compute *compute = &cuda->compute;
    uint64_t limit = 0;
    int status = bake_compute_prepare(compute, job);

    snprintf(compute->device_name, sizeof compute->device_name, "%s", cuda->device.name);
    snprintf(compute->base.name, sizeof compute->base.name, "%.110s (CUDA)", cuda->device.name);
    cuda->tuning = job->cuda_tuning ? *job->cuda_tuning : default_tuning;
    if (status == 0)
        status = bsq_calloc(compute->ctx, "CUDA workers", compute->worker_count,
                            sizeof *cuda->workers, &cuda->workers);
    if (status == 0)
        status = reserve_host(cuda);
    if (status == 0)
        status = open_context(cuda);
    if (status == 0)
        status = load_kernel(cuda);
    if (status == 0)
        status = ask_memory(cuda, &limit);
    if (status == 0)
        status = bake_compute_share_memory(compute, job, limit, UINT64_MAX);
    if (status == 0)
        status = open_upload(cuda);
    return status < 0 ? status : bake_compute_send_triangles(compute, job);
}

static void cuda_close(struct bake_backend *backend)
{
    struct cuda *cuda = (struct cuda *)backend;

    if (cuda->context) {
        cuda->api.cuCtxSetCurrent(cuda->context);
        close_upload(cuda);
        bake_compute_unload(&cuda->compute);
        if (cuda->origin)
            cuda->api.cuEventDestroy(cuda->origin);
        if (cuda->module)
            cuda->api.cuModuleUnload(cuda->module);
        cuda->api.cuCtxSetCurrent(NULL);
        cuda->api.cuDevicePrimaryCtxRelease(cuda->device.device);
    }
    bsq_free(cuda->compute.ctx, cuda->workers);
    bake_compute_free(&cuda->compute);
}

static int cuda_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                     struct bake_backend **out)
{
    struct cuda *cuda;
    int status = bsq_calloc(ctx, "CUDA device", 1, sizeof *cuda, &cuda);

    *out = NULL;
    if (status < 0)
        return status;
    bake_compute_init(&cuda->compute, ctx, &calls, cuda_close);
    status = bake_cuda_choose(ctx, index, &cuda->api, &cuda->device);
    if (status == 0)
        status = prepare(cuda, job);
    if (status < 0)
        cuda_close(&cuda->compute.base);
    else
        *out = &cuda->compute.base;
    return status;
}

const struct bake_device_kind bake_cuda_kind = {
    .name = "cuda", .drivers = "CUDA", .open = cuda_open, .list = bake_cuda_list};
