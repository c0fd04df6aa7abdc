/* compute.c - uploads, patches and times of devices with memory and streams of their own. */
#include "libbake/device/compute/compute.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "base/context.h"
#include "base/parallel.h"
#include "libbake/kernel/bk_secondary.h"
#include "libbake/raster/raster.h"

enum {
    STAGING_BYTES = 16 << 20, /* half of the staging buffer */
    SHARE_BYTES = 1 << 20     /* that one thread copies at a time */
};

const char *const bake_kernel_names[BAKE_KERNEL_COUNT] = {"bake_patch", "bake_look"};

int bake_compute_fail(const struct bake_compute *compute, struct bake_failure failure)
{
    char text[BAKE_COMPUTE_TEXT];
    if (failure.code == 0)
        return 0;
    return bsq_fail(compute->ctx, BSQ_ENODEVICE, "%s: %s: %s", compute->device_name, failure.call,
                    compute->calls->describe(compute, failure.code, text));
}

/* ---- memory ---- */

static uint64_t sample_bytes(const struct bake_compute *compute, uint64_t texels)
{
    return texels * bake_raster_texel_entries(&compute->params) * sizeof(uint32_t);
}

static uint64_t texel_bytes(const struct bake_compute *compute, uint64_t texels)
{
    return texels * bk_texel_floats(compute->params.maps) * sizeof(float);
}

static uint64_t point_bytes(const struct bake_compute *compute)
{
    return bake_ray_count(&compute->params) > 0
               ? bake_batch_samples(&compute->params) * sizeof(struct bk_viewpoint)
               : 0;
}

static uint64_t found_bytes(const struct bake_compute *compute)
{
    return bake_batch_samples(&compute->params) * bake_ray_count(&compute->params) * sizeof(float);
}

static uint64_t worker_bytes(const struct bake_compute *compute)
{
    return compute->worker_count * (sample_bytes(compute, compute->patch_texels) +
                                    texel_bytes(compute, compute->patch_texels) +
                                    point_bytes(compute) + found_bytes(compute));
}

static uint64_t triangle_bytes(const struct bake_job *job)
{
    return job->triangle_count * (uint64_t)sizeof *job->triangles;
}

/* Reserves bytes of the host's budget until the device is closed. */
static int compute_reserve(struct bake_compute *compute, const char *what, uint64_t bytes)
{
    int status = bsq_reserve(compute->ctx, what, bytes);
    if (status == 0)
        compute->reserved_bytes += bytes;
    return status;
}

static int share_memory(struct bake_compute *compute, const struct bake_job *job, uint64_t limit,
                        uint64_t buffer_bytes)
{
    const uint64_t samples = sample_bytes(compute, compute->patch_texels);
    const uint64_t triangles = triangle_bytes(job);
    const uint64_t fixed = worker_bytes(compute) + triangles;
    if (job->device_memory && job->device_memory < limit)
        limit = job->device_memory;
    if (triangles > buffer_bytes || samples > buffer_bytes)
        return bsq_fail(compute->ctx, BSQ_ENODEVICE,
                        "%s: the low-poly mesh's triangles take %" PRIu64
                        " bytes and a patch's samples "
                        "%" PRIu64 ", a buffer of this device holds %" PRIu64,
                        compute->device_name, triangles, samples, buffer_bytes);
    if (fixed >= limit)
        return bsq_fail(compute->ctx, BSQ_ENODEVICE,
                        "%s: texels and the low-poly mesh take %" PRIu64
                        " bytes of the device's memory, "
                        "%" PRIu64 " are allowed: give more, or fewer --threads",
                        compute->device_name, fixed, limit);
    compute->base.memory_bytes = limit - fixed;
    compute->base.buffer_bytes = buffer_bytes;
    return compute->shares_memory
               ? compute_reserve(compute, "patches on a device that shares host memory", fixed)
               : 0;
}

/* ---- the grid ---- */

static struct bake_stream *upload_stream(const struct bake_compute *compute)
{
    return &compute->streams[compute->worker_count];
}

/* Keeps the failure of an upload. Returns BSQ_ENODEVICE; 0 if there is none. */
static int note_failure(struct bake_compute *compute, struct bake_failure failure)
{
    compute->upload_failure = failure;
    return failure.code ? BSQ_ENODEVICE : 0;
}

/* Sends the half that is being filled. Returns when the other one may be filled. */
static int compute_flush(struct bake_compute *compute)
{
    struct bake_stream *stream = upload_stream(compute);
    const unsigned half = compute->filling;
    const uint64_t bytes = compute->used;
    int status;
    if (bytes == 0)
        return 0;
    compute->used = 0;
    compute->filling ^= 1;
    BSQ_TRY(note_failure(compute,
                         compute->calls->send(compute, stream, stream->host[half], bytes,
                                              compute->upload_to, compute->upload_at, (int)half)));
    compute->upload_at += bytes;
    BSQ_TRY(note_failure(compute, compute->calls->wait(compute, stream, (int)half ^ 1)));
    status = bsq_check(compute->ctx);
done:
    return status;
}

struct copy {
    char *to;
    const char *from;
    uint64_t bytes;
};

static int copy_share(void *arg, uint64_t index, unsigned worker)
{
    const struct copy *copy = arg;
    const uint64_t at = index * SHARE_BYTES, left = copy->bytes - at;
    (void)worker;
    memcpy(copy->to + at, copy->from + at, left < SHARE_BYTES ? left : SHARE_BYTES);
    return 0;
}

/* Copies on all threads, as one reads a mapped file several times slower than a device copies. */
static int copy_in(const struct bake_compute *compute, struct copy copy)
{
    if (copy.bytes > SHARE_BYTES)
        return bsq_parallel_for(compute->ctx, (copy.bytes + SHARE_BYTES - 1) / SHARE_BYTES,
                                copy_share, &copy);
    memcpy(copy.to, copy.from, copy.bytes);
    return 0;
}

/* Appends data to the array that goes up. */
static int compute_put(struct bake_compute *compute, const void *data, uint64_t bytes)
{
    const char *from = data;
    int status = 0;
    while (bytes > 0 && status == 0) {
        const uint64_t space = STAGING_BYTES - compute->used, piece = bytes < space ? bytes : space;
        char *to = upload_stream(compute)->host[compute->filling] + compute->used;
        status = copy_in(compute, (struct copy){to, from, piece});
        compute->used += piece;
        from += piece;
        bytes -= piece;
        if (status == 0 && compute->used == STAGING_BYTES)
            status = compute_flush(compute);
    }
    return status;
}

/* Makes compute_put() append to an array from now on. */
static void begin_upload(struct bake_compute *compute, bake_memory to)
{
    compute->upload_to = to;
    compute->upload_at = compute->used = 0;
}

static int finish_upload(struct bake_compute *compute)
{
    return note_failure(compute, compute->calls->finish(compute, upload_stream(compute)));
}

static int send_triangles(struct bake_compute *compute, const struct bake_job *job)
{
    int status;
    BSQ_TRY(note_failure(
        compute, compute->calls->allocate(compute, triangle_bytes(job), &compute->triangles)));
    begin_upload(compute, compute->triangles);
    BSQ_TRY(compute_put(compute, job->triangles, triangle_bytes(job)));
    BSQ_TRY(compute_flush(compute));
    status = finish_upload(compute);
done:
    return status == BSQ_ENODEVICE ? bake_compute_fail(compute, compute->upload_failure) : status;
}

static int compute_load_grid(struct bake_compute *compute, const struct bake_grid_arrays *grid,
                             const char **what)
{
    int status;
    *what = "memory that the device shares";
    if (compute->shares_memory)
        BSQ_TRY(compute_reserve(compute, "grid on a device that shares host memory", grid->bytes));
    compute->params = grid->params;
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        *what = grid->arrays[i].name;
        BSQ_TRY(note_failure(compute, compute->calls->allocate(compute, grid->arrays[i].bytes,
                                                               &compute->arrays[i])));
    }
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        const struct bake_grid_array *array = &grid->arrays[i];
        *what = array->name;
        begin_upload(compute, compute->arrays[i]);
        for (int k = 0; k < BAKE_ARRAY_PARTS; k++)
            BSQ_TRY(compute_put(compute, array->parts[k].data, array->parts[k].bytes));
        BSQ_TRY(compute_flush(compute));
    }
    status = finish_upload(compute);
done:
    return status;
}

/* Describes a failure in `why`, after the part of the work that it belongs to. */
static void compute_describe_failure(const struct bake_compute *compute, const char *what,
                                     struct bake_failure failure, char *why)
{
    char text[BAKE_COMPUTE_TEXT];
    snprintf(why, BAKE_WHY_BYTES, "%s: %s", what,
             failure.code ? compute->calls->describe(compute, failure.code, text)
                          : bsq_error(compute->ctx));
}

static int compute_load(struct bake_backend *backend, const struct bake_grid_arrays *grid,
                        char *why)
{
    struct bake_compute *compute = (struct bake_compute *)backend;
    const double started = bsq_seconds_now();
    const char *what;
    int status;
    compute->upload_failure = BAKE_NO_FAILURE;
    status = compute_load_grid(compute, grid, &what);
    if (status < 0) {
        (void)compute->calls->finish(compute, upload_stream(compute));
        compute_describe_failure(compute, what, compute->upload_failure, why);
    }
    compute->upload_seconds += bsq_seconds_now() - started;
    return status;
}

/* ---- patches ---- */

static void add_argument(struct bake_launch *launch, const void *value, uint64_t bytes)
{
    launch->arguments[launch->count++] = (struct bake_argument){bytes, value};
}
#define ADD(launch, value) add_argument(launch, &(value), sizeof(value))

/* Starts the list of a launch's arguments, with the arrays of the grid. */
static struct bake_launch begin_launch(const struct bake_compute *compute, int kernel)
{
    struct bake_launch launch = {.kernel = kernel};
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++)
        ADD(&launch, compute->arrays[i]);
    ADD(&launch, compute->params);
    return launch;
}

static struct bake_failure launch_patch(struct bake_compute *compute, struct bake_stream *stream,
                                        const struct bk_patch *patch, const struct bk_batch *batch,
                                        uint32_t stage)
{
    struct bake_launch launch = begin_launch(compute, BAKE_PATCH);
    launch.width = batch->end_column - batch->first_column;
    launch.height = batch->end_row - batch->first_row;
    ADD(&launch, compute->triangles);
    ADD(&launch, *patch);
    ADD(&launch, *batch);
    ADD(&launch, stage);
    ADD(&launch, stream->samples);
    ADD(&launch, stream->points);
    ADD(&launch, stream->found);
    ADD(&launch, stream->texels);
    stream->launches++;
    return compute->calls->launch(compute, stream, &launch);
}

/* Traces the rays of `count` viewpoints. */
static struct bake_failure launch_look(struct bake_compute *compute, struct bake_stream *stream,
                                       uint32_t count)
{
    struct bake_launch launch = begin_launch(compute, BAKE_LOOK);
    launch.width = bake_ray_count(&compute->params);
    launch.height = count;
    for (launch.side = 1; launch.side < launch.width && launch.side < 32;)
        launch.side *= 2;
    ADD(&launch, stream->points);
    ADD(&launch, count);
    ADD(&launch, stream->found);
    stream->launches++;
    return compute->calls->launch(compute, stream, &launch);
}

static struct bake_failure launch_batch(struct bake_compute *compute, struct bake_stream *stream,
                                        const struct bk_patch *patch, const struct bk_batch *batch)
{
    const uint32_t samples = (batch->end_row - batch->first_row) *
                             (batch->end_column - batch->first_column) *
                             (batch->end_line - batch->first_line) * compute->params.samples;
    if (bake_ray_count(&compute->params) == 0)
        return launch_patch(compute, stream, patch, batch, BK_ADD);
    BAKE_TRY_CALL(launch_patch(compute, stream, patch, batch, BK_POINTS));
    BAKE_TRY_CALL(launch_look(compute, stream, samples));
    return launch_patch(compute, stream, patch, batch, BK_ADD_FOUND);
}

static struct bake_failure launch_batches(struct bake_compute *compute, struct bake_stream *stream,
                                          const struct bk_patch *patch)
{
    const struct bk_batch size = bake_first_batch(&compute->params, patch);
    struct bk_batch batch = size;
    do {
        BAKE_TRY_CALL(launch_batch(compute, stream, patch, &batch));
    } while (bake_next_batch(&compute->params, patch, &size, &batch));
    return BAKE_NO_FAILURE;
}

static void note_times(struct bake_compute *compute, struct bake_stream *stream)
{
    const struct bake_span *times = stream->times;
    pthread_mutex_lock(&compute->lock);
    bake_time_spans_add(&compute->copies, &times[BAKE_SAMPLES]);
    bake_time_spans_add(&compute->kernels, &times[BAKE_KERNELS]);
    bake_time_spans_add(&compute->copies, &times[BAKE_TEXELS]);
    pthread_mutex_unlock(&compute->lock);
}

static void close_stream(struct bake_compute *compute, struct bake_stream *stream)
{
    compute->calls->close_stream(compute, stream);
    if (stream->samples)
        compute->calls->release(compute, stream->samples);
    if (stream->texels)
        compute->calls->release(compute, stream->texels);
    if (stream->points)
        compute->calls->release(compute, stream->points);
    if (stream->found)
        compute->calls->release(compute, stream->found);
    stream->samples = stream->texels = stream->points = stream->found = 0;
    stream->open = false;
}

static struct bake_failure open_worker(struct bake_compute *compute, struct bake_stream *stream)
{
    const struct bake_compute_calls *calls = compute->calls;
    BAKE_TRY_CALL(calls->open_stream(compute, stream));
    BAKE_TRY_CALL(
        calls->allocate(compute, sample_bytes(compute, compute->patch_texels), &stream->samples));
    BAKE_TRY_CALL(
        calls->allocate(compute, texel_bytes(compute, compute->patch_texels), &stream->texels));
    if (bake_ray_count(&compute->params) > 0) {
        BAKE_TRY_CALL(calls->allocate(compute, point_bytes(compute), &stream->points));
        BAKE_TRY_CALL(calls->allocate(compute, found_bytes(compute), &stream->found));
    }
    stream->open = true;
    return BAKE_NO_FAILURE;
}

/* Enqueues a patch's copies and kernels on the worker's stream and waits for them. */
static struct bake_failure compute_trace_patch(struct bake_compute *compute,
                                               struct bake_stream *stream,
                                               const struct bk_patch *patch,
                                               const uint32_t *sample_triangles, float *texels)
{
    const struct bake_compute_calls *calls = compute->calls;
    const uint64_t texel_count = (uint64_t)patch->width * patch->height;
    const uint64_t bytes = sample_bytes(compute, texel_count);
    if (calls->attach)
        BAKE_TRY_CALL(calls->attach(compute));
    if (!stream->open)
        BAKE_TRY_CALL(open_worker(compute, stream));
    memcpy(stream->host[0], sample_triangles, bytes);
    BAKE_TRY_CALL(
        calls->send(compute, stream, stream->host[0], bytes, stream->samples, 0, BAKE_SAMPLES));
    BAKE_TRY_CALL(launch_batches(compute, stream, patch));
    BAKE_TRY_CALL(calls->fetch(compute, stream, texel_bytes(compute, texel_count)));
    BAKE_TRY_CALL(calls->wait(compute, stream, BAKE_TEXELS));
    memcpy(texels, stream->host[0], texel_bytes(compute, texel_count));
    BAKE_TRY_CALL(calls->times(compute, stream));
    note_times(compute, stream);
    return BAKE_NO_FAILURE;
}

static int compute_trace(struct bake_backend *backend, const struct bk_patch *patch,
                         const uint32_t *sample_triangles, float *texels, unsigned worker,
                         char *why)
{
    struct bake_compute *compute = (struct bake_compute *)backend;
    if (worker >= compute->worker_count ||
        (uint64_t)patch->width * patch->height > compute->patch_texels) {
        snprintf(why, BAKE_WHY_BYTES, "worker %u, patch of %u x %u texels: out of range", worker,
                 (unsigned)patch->width, (unsigned)patch->height);
        return BSQ_EBUG;
    }
    struct bake_stream *stream = &compute->streams[worker];
    const struct bake_failure failure =
        compute_trace_patch(compute, stream, patch, sample_triangles, texels);
    if (failure.code == 0)
        return 0;
    if (!stream->open)
        close_stream(compute, stream);
    compute_describe_failure(compute, failure.call, failure, why);
    return BSQ_ENODEVICE;
}

/* ---- from opening to closing ---- */

static void compute_times(struct bake_backend *backend, struct bake_device_times *out)
{
    struct bake_compute *compute = (struct bake_compute *)backend;
    *out = (struct bake_device_times){.upload = compute->upload_seconds,
                                      .copies = bake_time_spans_seconds(&compute->copies),
                                      .kernels = bake_time_spans_seconds(&compute->kernels)};
    for (unsigned i = 0; i < compute->worker_count; i++)
        out->launches += compute->streams[i].launches;
}

void bake_compute_init(struct bake_compute *compute, struct bsq_ctx *ctx, const char *device_name,
                       const struct bake_compute_calls *calls,
                       void (*close)(struct bake_backend *backend))
{
    compute->base.trace = compute_trace;
    compute->base.load = compute_load;
    compute->base.times = compute_times;
    compute->base.close = close;
    compute->ctx = ctx;
    compute->calls = calls;
    snprintf(compute->device_name, sizeof compute->device_name, "%s", device_name);
    pthread_mutex_init(&compute->lock, NULL);
}

/* Creates the streams' structures, and reserves their host memory. */
static int create_streams(struct bake_compute *compute)
{
    const unsigned count = compute->worker_count + 1;
    const uint64_t stream_bytes = compute->calls->stream_bytes;
    const uint64_t samples = sample_bytes(compute, compute->patch_texels);
    const uint64_t texels = texel_bytes(compute, compute->patch_texels);
    const uint64_t host = samples > texels ? samples : texels;
    int status;
    BSQ_TRY(bsq_calloc(compute->ctx, "streams of the device", count, sizeof *compute->streams,
                       &compute->streams));
    BSQ_TRY(bsq_calloc(compute->ctx, "streams of the device", count, stream_bytes,
                       &compute->stream_memory));
    for (unsigned i = 0; i < count; i++)
        compute->streams[i] = (struct bake_stream){
            .own = compute->stream_memory + i * stream_bytes, .host_count = 1, .host_bytes = host};
    upload_stream(compute)->host_count = 2;
    upload_stream(compute)->host_bytes = STAGING_BYTES;
    status = compute_reserve(compute, "page-locked memory",
                             compute->worker_count * host + 2 * (uint64_t)STAGING_BYTES);
done:
    return status;
}

int bake_compute_prepare(struct bake_compute *compute, const struct bake_job *job, uint64_t limit,
                         uint64_t buffer_bytes)
{
    int status;
    compute->params = job->params;
    compute->patch_texels = job->patch_texels;
    compute->worker_count = bsq_threads(compute->ctx);
    BSQ_TRY(create_streams(compute));
    BSQ_TRY(share_memory(compute, job, limit, buffer_bytes));
    struct bake_stream *upload = upload_stream(compute);
    upload->open = true;
    BSQ_TRY(bake_compute_fail(compute, compute->calls->open_stream(compute, upload)));
    status = send_triangles(compute, job);
done:
    return status;
}

void bake_compute_unload(struct bake_compute *compute)
{
    for (unsigned i = 0; compute->streams && i <= compute->worker_count; i++)
        if (compute->streams[i].open)
            close_stream(compute, &compute->streams[i]);
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++)
        if (compute->arrays[i])
            compute->calls->release(compute, compute->arrays[i]);
    if (compute->triangles)
        compute->calls->release(compute, compute->triangles);
}

void bake_compute_free(struct bake_compute *compute)
{
    bsq_release(compute->ctx, compute->reserved_bytes);
    bsq_free(compute->ctx, compute->streams);
    bsq_free(compute->ctx, compute->stream_memory);
    pthread_mutex_destroy(&compute->lock);
    bsq_free(compute->ctx, compute);
}
