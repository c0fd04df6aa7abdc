/* cuda.c - the kernel on an NVIDIA GPU, through the driver API.
 *
 * The kernel comes as PTX that was made when the program was built; the driver turns it into code
 * for the card and keeps that. Each array of the grid is in memory of its own (cuda_memory.c).
 * Every worker has its own stream, tile memory on the device, and page-locked memory on the host,
 * from and to which the device copies by itself; so workers overlap each other's copies and kernels
 * and never wait for a lock. */
#include <stdio.h>
#include <string.h>

#include "libbake/device/cuda/cuda_memory.h"
#include "libbake/device/compute.h"

enum {
    STAGE_BYTES = 16 << 20 /* of the grid at a time */
};

/* A warp is 8 x 4 texels: near in the map, so mostly near in the grid. The compiler likes some 168
 * registers, which leaves room for 12 warps on a multiprocessor; with 128 there are 16, which hide
 * more of the memory's latency. What does not fit 128 is written and read once a ray pair, outside
 * of the loops that walk. */
static const struct bake_cuda_tuning default_tuning = {
    .registers = 128, .block_width = 8, .block_height = 16};

/* Marks in a worker's stream. */
enum { BEFORE_SAMPLES, BEFORE_KERNELS, AFTER_KERNELS, AFTER_TEXELS, EVENTS };

/* What one worker uses; made by its first tile. */
struct worker {
    CUstream stream;
    CUevent events[EVENTS];
    CUevent before;     /* the end of its tile before, or when it was made */
    double before_time; /* on the device's clock */
    CUdeviceptr samples, texels;
    void *host_samples, *host_texels; /* page-locked */
};

struct cuda {
    struct bake_compute compute;
    struct bake_cuda_api api;
    struct bake_cuda_device device;
    struct bake_cuda_tuning tuning;
    struct bake_cuda_memory memory;
    CUcontext context;
    CUmodule module;
    CUfunction kernel;
    CUevent origin; /* of the clock that times are told on */
    CUstream upload;
    CUevent taken[2]; /* the device has what was in the piece of the stage, which is page-locked */
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
    CUdeviceptr memory;

    *code = bake_cuda_memory_get(&((struct cuda *)compute)->memory, bytes, &memory);
    *out = memory;
}

/* What of the device's memory is free, but for a sixteenth of all: the driver takes some for what
 * does not fit a thread's registers when the first kernel is launched, however much is free, and
 * rounds each array up. */
static CUresult free_memory(const struct cuda *cuda, uint64_t *out)
{
    size_t free_bytes = 0, all_bytes = 0;
    CUresult code = cuda->api.cuMemGetInfo(&free_bytes, &all_bytes);

    *out = free_bytes > all_bytes / 16 ? free_bytes - all_bytes / 16 : 0;
    return code;
}

static uint64_t cuda_room(struct bake_compute *compute)
{
    uint64_t bytes;

    return free_memory((struct cuda *)compute, &bytes) == CUDA_SUCCESS ? bytes : 0;
}

static void cuda_release(struct bake_compute *compute, bake_memory memory)
{
    bake_cuda_memory_give(&((struct cuda *)compute)->memory, memory);
}

static void cuda_send(struct bake_compute *compute, unsigned piece, uint64_t bytes, bake_memory to,
                      uint64_t at, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;

    *code = cuda->api.cuMemcpyHtoDAsync(to + at, compute->stage.pieces[piece], bytes, cuda->upload);
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuEventRecord(cuda->taken[piece], cuda->upload);
}

static void cuda_wait_for_piece(struct bake_compute *compute, unsigned piece, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    /* An event that was never recorded is over. */
    *code = cuda->api.cuEventSynchronize(cuda->taken[piece]);
}

static void cuda_drain(struct bake_compute *compute, int *code)
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

/* Seconds from one event to another that is over, as float: from one some hours ago they are
 * coarse. */
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

static const char *cuda_write(struct bake_compute *compute, unsigned number,
                              const struct bake_compute_part *part, const struct bk_tile *tile,
                              const uint32_t *sample_triangles, uint64_t bytes, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];

    (void)part;
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

static const char *cuda_launch(struct bake_compute *compute, unsigned number,
                               const struct bake_compute_part *part, const struct bk_tile *tile,
                               const struct bake_slice *slice, int *code)
{
    struct cuda *cuda = (struct cuda *)compute;
    struct worker *worker = &cuda->workers[number];
    const struct bake_cuda_tuning *tuning = &cuda->tuning;
    CUdeviceptr a[BAKE_PART_ARRAYS], triangles = compute->triangles;
    struct bk_params params = part->params;
    struct bk_tile whole = *tile;
    struct bake_slice part_of_it = *slice;
    const uint32_t rows = slice->end_row - slice->first_row;
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
                         &part_of_it.first_row,
                         &part_of_it.end_row,
                         &part_of_it.first_line,
                         &part_of_it.end_line,
                         &worker->samples,
                         &worker->texels};

    for (int i = 0; i < BAKE_PART_ARRAYS; i++)
        a[i] = part->arrays[i];
    *code = cuda->api.cuLaunchKernel(
        cuda->kernel, (tile->width + tuning->block_width - 1) / tuning->block_width,
        (rows + tuning->block_height - 1) / tuning->block_height, 1, tuning->block_width,
        tuning->block_height, 1, 0, worker->stream, arguments, NULL);
    return "cuLaunchKernel";
}

static const char *cuda_read(struct bake_compute *compute, unsigned number, struct bk_texel *texels,
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

    /* Each from the one before, so that a long job's times are as exact as a short one's. */
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

/* What the device still does is between its memory and the worker's own. */
static void cuda_leave(struct bake_compute *compute, unsigned number, int code)
{
    (void)compute;
    (void)number;
    (void)code;
}

static const struct bake_compute_calls calls = {.describe = cuda_describe,
                                                .lacks_memory = cuda_lacks_memory,
                                                .attach = cuda_attach,
                                                .allocate = cuda_allocate,
                                                .room = cuda_room,
                                                .release = cuda_release,
                                                .send = cuda_send,
                                                .wait_for_piece = cuda_wait_for_piece,
                                                .drain = cuda_drain,
                                                .open_worker = cuda_open_worker,
                                                .close_worker = cuda_close_worker,
                                                .write = cuda_write,
                                                .launch = cuda_launch,
                                                .read = cuda_read,
                                                .times = cuda_times,
                                                .leave = cuda_leave};

/* ---- opening and closing ---- */

/* The compiler's messages become one line. */
static int fail_compile(struct cuda *cuda, CUresult code, char *log)
{
    char text[BAKE_CUDA_TEXT];

    for (char *p = log; *p; p++)
        if (*p == '\n')
            *p = ' ';
    return bsq_fail(cuda->compute.ctx, BSQ_ENODEVICE, "%s: compiling the kernel: %s%s%s",
                    cuda->device.name, bake_cuda_error(&cuda->api, code, text), *log ? ": " : "",
                    log);
}

static int load_kernel(struct cuda *cuda)
{
    char log[1024] = "";
    int options[] = {CU_JIT_ERROR_LOG_BUFFER, CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES,
                     CU_JIT_MAX_REGISTERS};
    void *values[] = {log, (void *)(uintptr_t)(sizeof log - 1),
                      (void *)(uintptr_t)cuda->tuning.registers};
    CUresult code = cuda->api.cuModuleLoadDataEx(&cuda->module, bake_cuda_ptx,
                                                 cuda->tuning.registers ? 3 : 2, options, values);

    if (code != CUDA_SUCCESS)
        return fail_compile(cuda, code, log);
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
    if (code == CUDA_SUCCESS) /* nothing else waits for the default stream */
        code = cuda->api.cuEventSynchronize(cuda->origin);
    return code == CUDA_SUCCESS ? 0 : bake_compute_fail(&cuda->compute, "cuEventRecord", code);
}

static int ask_memory(struct cuda *cuda, uint64_t *limit)
{
    CUresult code = free_memory(cuda, limit);

    if (code != CUDA_SUCCESS)
        return bake_compute_fail(&cuda->compute, "cuMemGetInfo", code);
    code = bake_cuda_memory_init(&cuda->memory, &cuda->api, cuda->device.device,
                                 cuda->tuning.piece_bytes ? cuda->tuning.piece_bytes
                                                          : BAKE_BUFFER_MOST);
    return code == CUDA_SUCCESS
               ? 0
               : bake_compute_fail(&cuda->compute, "cuMemGetAllocationGranularity", code);
}

static int open_upload(struct cuda *cuda)
{
    struct bake_stage *stage = &cuda->compute.stage;
    CUresult code = cuda->api.cuStreamCreate(&cuda->upload, CU_STREAM_NON_BLOCKING);

    stage->piece_bytes = STAGE_BYTES;
    for (int i = 0; i < 2 && code == CUDA_SUCCESS; i++) {
        code = cuda->api.cuMemAllocHost((void **)&stage->pieces[i], STAGE_BYTES);
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
        if (cuda->compute.stage.pieces[i])
            cuda->api.cuMemFreeHost(cuda->compute.stage.pieces[i]);
    }
}

/* Page-locked memory of the workers and the stage. */
static int reserve_host(struct cuda *cuda)
{
    struct bake_compute *compute = &cuda->compute;
    const uint64_t tile = bake_compute_sample_bytes(compute) + bake_compute_texel_bytes(compute);

    return bake_compute_reserve(compute, "page-locked memory for tiles",
                                compute->worker_count * tile + 2 * (uint64_t)STAGE_BYTES);
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
        status =
            bake_compute_share_memory(compute, job, limit, bake_cuda_memory_most(&cuda->memory));
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

int bake_cuda_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
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
