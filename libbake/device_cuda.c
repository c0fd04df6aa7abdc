/* device_cuda.c - the kernel on an NVIDIA GPU, through the driver API.
 *
 * The kernel comes as PTX that was made when the program was built; the driver turns it into code
 * for the card and keeps that. The grid, or two parts of it at a time, go up
 * through two page-locked pieces of host memory in turn, each array into memory of its own. Every
 * worker has its own stream, tile memory on the device, and page-locked memory on the host, from
 * and to which the device copies by itself; so workers overlap each other's copies and kernels and
 * never wait for a lock. */
#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/clock.h"
#include "libbake/busy_internal.h"
#include "libbake/cuda_api_internal.h"
#include "libbake/device_backend_internal.h"
#include "libbake/device_probe_internal.h"
#include "libbake/slices_internal.h"
#include "libbake/stage_internal.h"

/* "" where the program was built without a compiler for it. */
static const char kernel_ptx[] =
#include "kernel_ptx.inc"
    ;

enum {
    STAGE_BYTES = 16 << 20 /* of the grid at a time */
};

/* A warp is 8 x 4 texels: near in the map, so mostly near in the grid. The compiler likes some 185
 * registers, which leaves room for 8 warps on a multiprocessor; with 128 there are 16, which hide
 * more of the memory's latency. */
static const struct bake_cuda_tuning default_tuning = {
    .registers = 128, .block_width = 8, .block_height = 16};

/* Marks in a worker's stream. */
enum { BEFORE_SAMPLES, BEFORE_KERNELS, AFTER_KERNELS, AFTER_TEXELS, EVENTS };

struct loaded;

/* What one worker uses; made by its first tile. */
struct worker {
    CUstream stream;
    CUevent events[EVENTS];
    CUdeviceptr samples, texels;
    void *host_samples, *host_texels; /* page-locked */
    struct loaded *part;              /* that it traces */
    struct bake_slices slices;
    uint64_t launches;
};

/* A part of the grid on the device. */
struct loaded {
    CUdeviceptr arrays[BAKE_PART_ARRAYS];
    struct bk_params params;
};

/* Through page-locked memory. */
struct upload {
    struct bake_stage stage;
    CUstream stream;
    CUevent taken[2]; /* the device has what was in the piece */
    CUdeviceptr to;
    CUresult code; /* of the call that failed */
};

struct cuda {
    struct bake_backend base;
    struct bsq_ctx *ctx;
    struct bake_cuda_api api;
    struct bake_cuda_device device;
    struct bake_cuda_tuning tuning;
    CUcontext context;
    CUmodule module;
    CUfunction kernel;
    CUevent origin; /* of the clock that times are told on */
    CUdeviceptr triangles;
    struct loaded loaded[BAKE_SLOTS];
    struct upload upload;
    struct bk_params params;
    uint32_t tile_texels;
    uint64_t reserved_bytes; /* of host memory */
    unsigned worker_count;
    struct worker *workers;
    double upload_seconds;
    pthread_mutex_t lock; /* of what follows */
    struct bake_busy copies, kernels;
};

static int fail_open(const struct cuda *cuda, const char *what, CUresult code)
{
    char text[BAKE_CUDA_TEXT];
    return bsq_fail(cuda->ctx, BSQ_ENODEVICE, "%s: %s: %s", cuda->device.name, what,
                    bake_cuda_error(&cuda->api, code, text));
}

static uint64_t sample_bytes(const struct cuda *cuda)
{
    return (uint64_t)cuda->tile_texels * cuda->params.samples * cuda->params.samples *
           sizeof(uint32_t);
}

static uint64_t texel_bytes(const struct cuda *cuda)
{
    return (uint64_t)cuda->tile_texels * sizeof(struct bk_texel);
}

/* ---- choosing ---- */

enum { LINE_BYTES = BAKE_CUDA_TEXT + 96 };
/* Why there is no CUDA, for a line. buffer: LINE_BYTES bytes. */
static const char *describe_lack(const struct bake_cuda_api *api, enum bake_cuda_lack lack,
                                 CUresult code, char *buffer)
{
    char text[BAKE_CUDA_TEXT];

    switch (lack) {
    case BAKE_CUDA_NOT_INSTALLED:
        return "CUDA is not installed (libcuda.so.1, a part of NVIDIA's driver)";
    case BAKE_CUDA_TOO_OLD:
        return "CUDA: NVIDIA's driver is too old; version 450 or later is needed";
    case BAKE_CUDA_NO_GPU:
        return "CUDA has no devices";
    default:
        snprintf(buffer, LINE_BYTES, "CUDA does not start: %s", bake_cuda_error(api, code, text));
        return buffer;
    }
}

/* The device architecture that the kernel was compiled for, as 10 * major + minor. */
static int kernel_capability(void)
{
    const char *target = strstr(kernel_ptx, ".target sm_");
    return target ? atoi(target + strlen(".target sm_")) : 0;
}

static const char no_kernel[] =
    "this program was built without CUDA (neither clang nor nvcc was there)";

static int fail_absent(struct cuda *cuda, int64_t index, int count)
{
    char there[400] = "";

    for (int i = 0; i < count; i++) {
        struct bake_cuda_device device;
        size_t used = strlen(there);
        if (bake_cuda_device(&cuda->api, i, &device) == CUDA_SUCCESS)
            snprintf(there + used, sizeof there - used, "%s cuda:%d %s", i ? "," : "", i,
                     device.name);
    }
    return bsq_fail(cuda->ctx, BSQ_ENODEVICE, "there is no device cuda:%" PRId64 "; there is%s",
                    index, there);
}

/* Finds the device asked for; the error lists what is there. */
static int choose(struct cuda *cuda, int64_t index)
{
    char text[LINE_BYTES];
    enum bake_cuda_lack lack;
    CUresult code;
    int count;

    if (!kernel_ptx[0])
        return bsq_fail(cuda->ctx, BSQ_ENODEVICE, "%s", no_kernel);
    lack = bake_cuda_load(&cuda->api, &count, &code);
    if (lack != BAKE_CUDA_WORKS)
        return bsq_fail(cuda->ctx, BSQ_ENODEVICE, "%s",
                        describe_lack(&cuda->api, lack, code, text));
    if (index >= count)
        return fail_absent(cuda, index, count);
    code = bake_cuda_device(&cuda->api, (int)index, &cuda->device);
    if (code != CUDA_SUCCESS)
        return fail_open(cuda, "cuDeviceGet", code);
    if (cuda->device.capability < kernel_capability())
        return bsq_fail(cuda->ctx, BSQ_ENODEVICE,
                        "%s: compute capability %d.%d, the program needs %d.%d", cuda->device.name,
                        cuda->device.capability / 10, cuda->device.capability % 10,
                        kernel_capability() / 10, kernel_capability() % 10);
    return 0;
}

/* ---- opening ---- */

/* The compiler's messages become one line. */
static int fail_compile(struct cuda *cuda, CUresult code, char *log)
{
    char text[BAKE_CUDA_TEXT];

    for (char *p = log; *p; p++)
        if (*p == '\n')
            *p = ' ';
    return bsq_fail(cuda->ctx, BSQ_ENODEVICE, "%s: compiling the kernel: %s%s%s", cuda->device.name,
                    bake_cuda_error(&cuda->api, code, text), *log ? ": " : "", log);
}

static int load_kernel(struct cuda *cuda)
{
    char log[1024] = "";
    int options[] = {CU_JIT_ERROR_LOG_BUFFER, CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES,
                     CU_JIT_MAX_REGISTERS};
    void *values[] = {log, (void *)(uintptr_t)(sizeof log - 1),
                      (void *)(uintptr_t)cuda->tuning.registers};
    CUresult code = cuda->api.cuModuleLoadDataEx(&cuda->module, kernel_ptx,
                                                 cuda->tuning.registers ? 3 : 2, options, values);

    if (code != CUDA_SUCCESS)
        return fail_compile(cuda, code, log);
    code = cuda->api.cuModuleGetFunction(&cuda->kernel, cuda->module, "bake_tile");
    return code == CUDA_SUCCESS ? 0 : fail_open(cuda, "cuModuleGetFunction", code);
}

/* Sets aside what is there for the whole job; the rest is for the grid. */
static int share_memory(struct cuda *cuda, const struct bake_job *job)
{
    const uint64_t triangles = job->triangle_count * (uint64_t)sizeof *job->triangles;
    const uint64_t fixed =
        cuda->worker_count * (sample_bytes(cuda) + texel_bytes(cuda)) + triangles;
    size_t free_bytes = 0, all_bytes = 0;
    CUresult code = cuda->api.cuMemGetInfo(&free_bytes, &all_bytes);
    uint64_t limit = free_bytes;

    if (code != CUDA_SUCCESS)
        return fail_open(cuda, "cuMemGetInfo", code);
    if (job->device_memory && job->device_memory < limit)
        limit = job->device_memory;
    if (fixed >= limit)
        return bsq_fail(cuda->ctx, BSQ_ENODEVICE,
                        "%s: tiles and the low mesh take %" PRIu64 " bytes of the device's memory, "
                        "%" PRIu64 " are allowed: give more, or fewer --threads",
                        cuda->device.name, fixed, limit);
    cuda->base.memory_bytes = limit - fixed;
    cuda->base.other_bytes = fixed;
    cuda->base.buffer_bytes = UINT64_MAX; /* no limit but the memory's */
    return 0;
}

static void close_upload(struct cuda *cuda)
{
    struct upload *upload = &cuda->upload;

    if (upload->stream) {
        cuda->api.cuStreamSynchronize(upload->stream);
        cuda->api.cuStreamDestroy(upload->stream);
    }
    for (int i = 0; i < 2; i++) {
        if (upload->taken[i])
            cuda->api.cuEventDestroy(upload->taken[i]);
        if (upload->stage.pieces[i])
            cuda->api.cuMemFreeHost(upload->stage.pieces[i]);
    }
    *upload = (struct upload){0};
}

static int send_piece(void *device, unsigned turn, uint64_t bytes)
{
    struct cuda *cuda = device;
    struct upload *upload = &cuda->upload;

    upload->code =
        cuda->api.cuMemcpyHtoDAsync(upload->to, upload->stage.pieces[turn], bytes, upload->stream);
    if (upload->code == CUDA_SUCCESS)
        upload->code = cuda->api.cuEventRecord(upload->taken[turn], upload->stream);
    upload->to += bytes;
    /* An event that was never recorded is over. */
    if (upload->code == CUDA_SUCCESS)
        upload->code = cuda->api.cuEventSynchronize(upload->taken[turn ^ 1]);
    return upload->code == CUDA_SUCCESS ? bsq_check(cuda->ctx) : BSQ_ENODEVICE;
}

static CUresult open_upload(struct cuda *cuda)
{
    struct upload *upload = &cuda->upload;
    struct bake_stage *stage = &upload->stage;
    CUresult code = cuda->api.cuStreamCreate(&upload->stream, CU_STREAM_NON_BLOCKING);

    *stage = (struct bake_stage){.piece_bytes = STAGE_BYTES, .send = send_piece, .device = cuda};
    for (int i = 0; i < 2 && code == CUDA_SUCCESS; i++) {
        code = cuda->api.cuMemAllocHost((void **)&stage->pieces[i], STAGE_BYTES);
        if (code == CUDA_SUCCESS)
            code = cuda->api.cuEventCreate(&upload->taken[i], CU_EVENT_BLOCKING_SYNC);
    }
    return code;
}

/* Memory that what is put into the stage from now on goes to; empty arrays are never read. */
static int begin_upload(struct cuda *cuda, uint64_t bytes, CUdeviceptr *to)
{
    struct upload *upload = &cuda->upload;

    upload->code = bytes ? cuda->api.cuMemAlloc(to, bytes) : CUDA_SUCCESS;
    upload->to = *to;
    upload->stage.used = 0;
    return upload->code == CUDA_SUCCESS ? 0 : BSQ_ENODEVICE;
}

static int finish_upload(struct cuda *cuda)
{
    struct upload *upload = &cuda->upload;
    int status = bake_stage_flush(&upload->stage);

    if (status == 0) {
        upload->code = cuda->api.cuStreamSynchronize(upload->stream);
        status = upload->code == CUDA_SUCCESS ? 0 : BSQ_ENODEVICE;
    }
    return status;
}

static int upload_triangles(struct cuda *cuda, const struct bake_job *job)
{
    const uint64_t bytes = job->triangle_count * (uint64_t)sizeof *job->triangles;
    CUresult code = open_upload(cuda);

    if (code != CUDA_SUCCESS)
        return fail_open(cuda, "page-locked memory", code);
    int status = begin_upload(cuda, bytes, &cuda->triangles);
    if (status == 0)
        status = bake_stage_put(&cuda->upload.stage, job->triangles, bytes);
    if (status == 0)
        status = finish_upload(cuda);
    return status == BSQ_ENODEVICE ? fail_open(cuda, "triangles", cuda->upload.code) : status;
}

static void unload(struct cuda *cuda, struct loaded *loaded)
{
    for (int i = 0; i < BAKE_PART_ARRAYS; i++)
        if (loaded->arrays[i])
            cuda->api.cuMemFree(loaded->arrays[i]);
    *loaded = (struct loaded){0};
}

static int load_part(struct cuda *cuda, struct loaded *loaded, const struct bake_part *part,
                     const char **what)
{
    int status = 0;

    *what = "cuCtxSetCurrent";
    cuda->upload.code = cuda->api.cuCtxSetCurrent(cuda->context);
    if (cuda->upload.code != CUDA_SUCCESS)
        return BSQ_ENODEVICE;
    unload(cuda, loaded);
    loaded->params = part->params;
    for (int i = 0; i < BAKE_PART_ARRAYS && status == 0; i++) {
        *what = bake_part_array_name(i);
        status = begin_upload(cuda, part->bytes[i], &loaded->arrays[i]);
        if (status == 0)
            status = bake_part_send(part, i, bake_stage_put, &cuda->upload.stage);
        if (status == 0)
            status = bake_stage_flush(&cuda->upload.stage);
    }
    return status == 0 ? finish_upload(cuda) : status;
}

static int cuda_load(struct bake_backend *backend, unsigned slot, const struct bake_part *part,
                     char *why)
{
    struct cuda *cuda = (struct cuda *)backend;
    const double started = bsq_seconds_now();
    char text[BAKE_CUDA_TEXT];
    const char *what;
    int status = load_part(cuda, &cuda->loaded[slot], part, &what);

    if (status < 0)
        snprintf(why, BAKE_WHY_BYTES, "%s: %s", what,
                 cuda->upload.code == CUDA_SUCCESS
                     ? bsq_error(cuda->ctx)
                     : bake_cuda_error(&cuda->api, cuda->upload.code, text));
    cuda->upload_seconds += bsq_seconds_now() - started;
    return status;
}

static int open_context(struct cuda *cuda)
{
    CUresult code = cuda->api.cuDevicePrimaryCtxRetain(&cuda->context, cuda->device.device);

    if (code != CUDA_SUCCESS) {
        cuda->context = NULL;
        return fail_open(cuda, "cuDevicePrimaryCtxRetain", code);
    }
    code = cuda->api.cuCtxSetCurrent(cuda->context);
    if (code == CUDA_SUCCESS)
        code = cuda->api.cuEventCreate(&cuda->origin, 0);
    if (code == CUDA_SUCCESS)
        code = cuda->api.cuEventRecord(cuda->origin, NULL);
    return code == CUDA_SUCCESS ? 0 : fail_open(cuda, "cuEventRecord", code);
}

static int prepare(struct cuda *cuda, const struct bake_job *job)
{
    uint64_t host_bytes;
    int status;

    snprintf(cuda->base.name, sizeof cuda->base.name, "%.110s (CUDA)", cuda->device.name);
    cuda->params = job->params;
    cuda->tuning = job->cuda_tuning ? *job->cuda_tuning : default_tuning;
    cuda->tile_texels = job->tile_texels;
    cuda->worker_count = bsq_threads(cuda->ctx);
    status = bsq_calloc(cuda->ctx, "CUDA workers", cuda->worker_count, sizeof *cuda->workers,
                        &cuda->workers);
    if (status < 0)
        return status;
    host_bytes =
        cuda->worker_count * (sample_bytes(cuda) + texel_bytes(cuda)) + 2 * (uint64_t)STAGE_BYTES;
    status = bsq_reserve(cuda->ctx, "page-locked memory for tiles", host_bytes);
    if (status < 0)
        return status;
    cuda->reserved_bytes = host_bytes;
    status = open_context(cuda);
    if (status == 0)
        status = load_kernel(cuda);
    if (status < 0)
        return status;
    status = share_memory(cuda, job);
    return status < 0 ? status : upload_triangles(cuda, job);
}

/* ---- tracing ---- */

static void close_worker(struct cuda *cuda, struct worker *worker)
{
    if (worker->stream) {
        cuda->api.cuStreamSynchronize(worker->stream);
        cuda->api.cuStreamDestroy(worker->stream);
    }
    for (int i = 0; i < EVENTS; i++)
        if (worker->events[i])
            cuda->api.cuEventDestroy(worker->events[i]);
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

/* Returns the call that failed with its code. */
static const char *open_worker(struct cuda *cuda, struct worker *worker, CUresult *code)
{
    *code = cuda->api.cuStreamCreate(&worker->stream, CU_STREAM_NON_BLOCKING);
    if (*code != CUDA_SUCCESS)
        return "cuStreamCreate";
    for (int i = 0; i < EVENTS && *code == CUDA_SUCCESS; i++)
        *code = cuda->api.cuEventCreate(&worker->events[i], CU_EVENT_BLOCKING_SYNC);
    if (*code != CUDA_SUCCESS)
        return "cuEventCreate";
    *code = cuda->api.cuMemAlloc(&worker->samples, sample_bytes(cuda));
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuMemAlloc(&worker->texels, texel_bytes(cuda));
    if (*code != CUDA_SUCCESS)
        return "cuMemAlloc";
    *code = cuda->api.cuMemAllocHost(&worker->host_samples, sample_bytes(cuda));
    if (*code == CUDA_SUCCESS)
        *code = cuda->api.cuMemAllocHost(&worker->host_texels, texel_bytes(cuda));
    return "cuMemAllocHost";
}

/* Rows from first_row to end_row - 1. */
static CUresult launch(struct cuda *cuda, struct worker *worker, struct bk_tile tile,
                       uint32_t first_row, uint32_t end_row)
{
    struct loaded *part = worker->part;
    CUdeviceptr *a = part->arrays;
    void *arguments[] = {&a[BAKE_TILES],   &a[BAKE_UPPERS],  &a[BAKE_LOWERS], &a[BAKE_LEAVES],
                         &a[BAKE_NORMALS], &a[BAKE_PLANES],  &a[BAKE_COLORS], &a[BAKE_SECONDS],
                         &cuda->triangles, &part->params,    &tile,           &first_row,
                         &end_row,         &worker->samples, &worker->texels};

    const struct bake_cuda_tuning *tuning = &cuda->tuning;

    worker->launches++;
    return cuda->api.cuLaunchKernel(
        cuda->kernel, (tile.width + tuning->block_width - 1) / tuning->block_width,
        (end_row - first_row + tuning->block_height - 1) / tuning->block_height, 1,
        tuning->block_width, tuning->block_height, 1, 0, worker->stream, arguments, NULL);
}

static CUresult launch_slices(struct cuda *cuda, struct worker *worker, const struct bk_tile *tile)
{
    uint64_t row_samples = (uint64_t)tile->width * cuda->params.samples * cuda->params.samples;
    uint32_t rows = bake_slice_rows(&worker->slices, row_samples, tile->height);
    CUresult code = CUDA_SUCCESS;

    for (uint32_t row = 0; row < tile->height && code == CUDA_SUCCESS; row += rows) {
        uint32_t left = tile->height - row;
        code = launch(cuda, worker, *tile, row, row + (left < rows ? left : rows));
    }
    return code;
}

/* Puts a tile's copies and kernels into the worker's stream and waits for them. */
static const char *run_tile(struct cuda *cuda, struct worker *worker, const struct bk_tile *tile,
                            uint64_t input_bytes, uint64_t output_bytes, CUresult *code)
{
    const struct bake_cuda_api *api = &cuda->api;

    *code = api->cuEventRecord(worker->events[BEFORE_SAMPLES], worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = api->cuMemcpyHtoDAsync(worker->samples, worker->host_samples, input_bytes,
                                       worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = api->cuEventRecord(worker->events[BEFORE_KERNELS], worker->stream);
    if (*code != CUDA_SUCCESS)
        return "cuMemcpyHtoDAsync";
    *code = launch_slices(cuda, worker, tile);
    if (*code == CUDA_SUCCESS)
        *code = api->cuEventRecord(worker->events[AFTER_KERNELS], worker->stream);
    if (*code != CUDA_SUCCESS)
        return "cuLaunchKernel";
    *code =
        api->cuMemcpyDtoHAsync(worker->host_texels, worker->texels, output_bytes, worker->stream);
    if (*code == CUDA_SUCCESS)
        *code = api->cuEventRecord(worker->events[AFTER_TEXELS], worker->stream);
    if (*code != CUDA_SUCCESS)
        return "cuMemcpyDtoHAsync";
    *code = api->cuEventSynchronize(worker->events[AFTER_TEXELS]);
    return "cuEventSynchronize";
}

static CUresult note_times(struct cuda *cuda, struct worker *worker, uint64_t samples)
{
    double at[EVENTS];

    for (int i = 0; i < EVENTS; i++) {
        float milliseconds;
        CUresult code =
            cuda->api.cuEventElapsedTime(&milliseconds, cuda->origin, worker->events[i]);
        if (code != CUDA_SUCCESS)
            return code;
        at[i] = 1e-3 * (double)milliseconds;
    }
    bake_slices_learn(&worker->slices, samples, at[AFTER_KERNELS] - at[BEFORE_KERNELS]);
    pthread_mutex_lock(&cuda->lock);
    bake_busy_add(&cuda->copies, at[BEFORE_SAMPLES], at[BEFORE_KERNELS]);
    bake_busy_add(&cuda->kernels, at[BEFORE_KERNELS], at[AFTER_KERNELS]);
    bake_busy_add(&cuda->copies, at[AFTER_KERNELS], at[AFTER_TEXELS]);
    pthread_mutex_unlock(&cuda->lock);
    return CUDA_SUCCESS;
}

static const char *trace_tile(struct cuda *cuda, struct worker *worker, const struct bk_tile *tile,
                              const uint32_t *sample_triangles, struct bk_texel *texels,
                              CUresult *code)
{
    uint64_t texel_count = (uint64_t)tile->width * tile->height;
    uint64_t samples = texel_count * cuda->params.samples * cuda->params.samples;
    const char *call;

    *code = cuda->api.cuCtxSetCurrent(cuda->context);
    if (*code != CUDA_SUCCESS)
        return "cuCtxSetCurrent";
    if (!worker->stream) {
        call = open_worker(cuda, worker, code);
        if (*code != CUDA_SUCCESS) {
            close_worker(cuda, worker);
            return call;
        }
    }
    memcpy(worker->host_samples, sample_triangles, samples * sizeof *sample_triangles);
    call = run_tile(cuda, worker, tile, samples * sizeof *sample_triangles,
                    texel_count * sizeof *texels, code);
    if (*code != CUDA_SUCCESS)
        return call;
    memcpy(texels, worker->host_texels, texel_count * sizeof *texels);
    *code = note_times(cuda, worker, samples);
    return "cuEventElapsedTime";
}

static int cuda_trace(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                      const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker,
                      char *why)
{
    struct cuda *cuda = (struct cuda *)backend;
    char text[BAKE_CUDA_TEXT];
    CUresult code = CUDA_SUCCESS;
    const char *call;

    if (worker >= cuda->worker_count || (uint64_t)tile->width * tile->height > cuda->tile_texels) {
        snprintf(why, BAKE_WHY_BYTES, "worker %u, tile of %u x %u texels: out of range", worker,
                 (unsigned)tile->width, (unsigned)tile->height);
        return BSQ_EBUG;
    }
    cuda->workers[worker].part = &cuda->loaded[slot];
    call = trace_tile(cuda, &cuda->workers[worker], tile, sample_triangles, texels, &code);
    if (code == CUDA_SUCCESS)
        return 0;
    snprintf(why, BAKE_WHY_BYTES, "%s: %s", call, bake_cuda_error(&cuda->api, code, text));
    return BSQ_ENODEVICE;
}

static void cuda_times(struct bake_backend *backend, struct bake_device_times *out)
{
    struct cuda *cuda = (struct cuda *)backend;

    *out = (struct bake_device_times){.upload = cuda->upload_seconds,
                                      .copies = bake_busy_seconds(&cuda->copies),
                                      .kernels = bake_busy_seconds(&cuda->kernels)};
    for (unsigned i = 0; i < cuda->worker_count; i++)
        out->launches += cuda->workers[i].launches;
}

static void cuda_close(struct bake_backend *backend)
{
    struct cuda *cuda = (struct cuda *)backend;

    if (cuda->context) {
        cuda->api.cuCtxSetCurrent(cuda->context);
        for (unsigned i = 0; i < cuda->worker_count; i++)
            close_worker(cuda, &cuda->workers[i]);
        close_upload(cuda);
        for (int i = 0; i < BAKE_SLOTS; i++)
            unload(cuda, &cuda->loaded[i]);
        if (cuda->triangles)
            cuda->api.cuMemFree(cuda->triangles);
        if (cuda->origin)
            cuda->api.cuEventDestroy(cuda->origin);
        if (cuda->module)
            cuda->api.cuModuleUnload(cuda->module);
        cuda->api.cuCtxSetCurrent(NULL);
        cuda->api.cuDevicePrimaryCtxRelease(cuda->device.device);
    }
    bsq_release(cuda->ctx, cuda->reserved_bytes);
    bsq_free(cuda->ctx, cuda->workers);
    pthread_mutex_destroy(&cuda->lock);
    bsq_free(cuda->ctx, cuda);
}

int bake_cuda_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                   struct bake_backend **out)
{
    struct cuda *cuda;
    int status = bsq_calloc(ctx, "CUDA device", 1, sizeof *cuda, &cuda);

    *out = NULL;
    if (status < 0)
        return status;
    cuda->ctx = ctx;
    pthread_mutex_init(&cuda->lock, NULL);
    cuda->base.trace = cuda_trace;
    cuda->base.load = cuda_load;
    cuda->base.times = cuda_times;
    cuda->base.close = cuda_close;
    status = choose(cuda, index);
    if (status == 0)
        status = prepare(cuda, job);
    if (status < 0)
        cuda_close(&cuda->base);
    else
        *out = &cuda->base;
    return status;
}

/* Opens the driver for a list or "auto". A driver that cannot be used is worth a line, none is not.
 */
static bool load_quietly(struct bake_cuda_api *api, int *count, char *warning)
{
    char text[LINE_BYTES];
    CUresult code;
    enum bake_cuda_lack lack = bake_cuda_load(api, count, &code);

    warning[0] = '\0';
    if (lack == BAKE_CUDA_NOT_INSTALLED || lack == BAKE_CUDA_NO_GPU)
        return false;
    if (lack != BAKE_CUDA_WORKS)
        snprintf(warning, LINE_BYTES, "%s", describe_lack(api, lack, code, text));
    else if (!kernel_ptx[0])
        snprintf(warning, LINE_BYTES, "NVIDIA's driver is not used: %s", no_kernel);
    return !warning[0];
}

static void ask(struct bake_answers *answers)
{
    struct bake_cuda_api api;
    char warning[LINE_BYTES];
    int count;

    if (!load_quietly(&api, &count, warning)) {
        if (warning[0])
            bake_answer_warning(answers, warning);
        return;
    }
    for (int i = 0; i < count; i++) {
        struct bake_device_info info = {.is_gpu = true};
        struct bake_cuda_device device;
        if (bake_cuda_device(&api, i, &device) != CUDA_SUCCESS)
            continue;
        info.memory_bytes = device.memory_bytes;
        snprintf(info.id, sizeof info.id, "cuda:%d", i);
        snprintf(info.name, sizeof info.name, "%s", device.name);
        bake_answer_device(answers, &info);
    }
}

/* Not in this process: OpenCL's driver of the same maker, asked in a copy of it, would find CUDA
 * started already, which copies cannot use. */
int bake_cuda_list(struct bsq_ctx *ctx,
                   void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    return bake_probe(ctx, "CUDA", ask, fn, arg);
}

int64_t bake_cuda_next_gpu(struct bsq_ctx *ctx, int64_t after)
{
    struct bake_cuda_api api;
    char warning[LINE_BYTES];
    int count;

    if (load_quietly(&api, &count, warning))
        return after + 1 < count ? after + 1 : -1;
    if (warning[0])
        bsq_warn(ctx, "%s", warning);
    return -1;
}
