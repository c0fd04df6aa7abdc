/* gpu.c - uploads, patches and times of devices with memory and streams of their own. */
#include "libbake/device/gpu/gpu_internal.h"

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

const char *const bake_kernel_names[BAKE_KERNEL_COUNT] = {"bake_patch", "bake_look", "bake_rays",
                                                          "bake_meet", "bake_first"};

bool bake_gpu_launches(const struct bake_gpu *gpu, int kernel)
{
    if (gpu->exact || kernel >= BAKE_MEET)
        return gpu->exact &&
               (kernel == BAKE_FIRST || (kernel == BAKE_MEET && bk_ray_count(&gpu->params) > 0));
    return kernel == BAKE_RAYS   ? gpu->params.maps >> BK_MAP_curvature & 1
           : kernel == BAKE_LOOK ? bk_ray_count(&gpu->params) > 0
                                 : true;
}

int bake_gpu_fail(const struct bake_gpu *gpu, struct bake_failure failure)
{
    char text[BAKE_GPU_TEXT];
    if (failure.code == 0)
        return 0;
    return bsq_fail(gpu->ctx, BSQ_ENODEVICE, "%s: %s: %s", gpu->device_name, failure.call,
                    gpu->driver->describe(gpu, failure.code, text));
}

/* ---- memory ---- */

static uint64_t sample_bytes(const struct bake_gpu *gpu, uint64_t texels)
{
    return texels * bake_raster_texel_entries(&gpu->params) * sizeof(uint32_t);
}

static uint64_t texel_bytes(const struct bake_gpu *gpu, uint64_t texels)
{
    return texels * bk_texel_floats(gpu->params.maps) * sizeof(float);
}

/* Returns the most single rays that a worker traces at once. */
static uint64_t single_rays(const struct bake_gpu *gpu)
{
    return bake_gpu_launches(gpu, BAKE_RAYS) ? BAKE_GPU_RAYS : 0;
}

/* Return the bytes that a worker sends and fetches at once. */
static uint64_t sent_bytes(const struct bake_gpu *gpu)
{
    const uint64_t samples = sample_bytes(gpu, gpu->patch_texels);
    const uint64_t rays = single_rays(gpu) * BK_RAY_FLOATS * sizeof(float);
    return samples > rays ? samples : rays;
}

static uint64_t fetched_bytes(const struct bake_gpu *gpu)
{
    const uint64_t texels = texel_bytes(gpu, gpu->patch_texels);
    const uint64_t hits = single_rays(gpu) * BK_HIT_FLOATS * sizeof(float);
    return gpu->exact ? bake_gpu_chunk_rays_bytes(&gpu->params) : texels > hits ? texels : hits;
}

static uint64_t point_bytes(const struct bake_gpu *gpu)
{
    return bake_gpu_launches(gpu, BAKE_LOOK)
               ? bake_batch_samples(&gpu->params) * sizeof(struct bk_viewpoint)
               : 0;
}

static uint64_t found_bytes(const struct bake_gpu *gpu)
{
    return bake_gpu_launches(gpu, BAKE_LOOK)
               ? bake_batch_samples(&gpu->params) * bk_ray_count(&gpu->params) * sizeof(float)
               : 0;
}

static uint64_t worker_bytes(const struct bake_gpu *gpu)
{
    return gpu->worker_count * gpu->windows *
           (sent_bytes(gpu) + fetched_bytes(gpu) + point_bytes(gpu) + found_bytes(gpu));
}

static uint64_t triangle_bytes(const struct bake_scene *scene)
{
    return scene->triangle_count * (uint64_t)sizeof *scene->triangles;
}

int bake_gpu_reserve(struct bake_gpu *gpu, const char *what, uint64_t bytes)
{
    int status = bsq_reserve(gpu->ctx, what, bytes);
    if (status == 0)
        gpu->reserved_bytes += bytes;
    return status;
}

static int share_memory(struct bake_gpu *gpu, const struct bake_scene *scene)
{
    const uint64_t samples = sent_bytes(gpu);
    const uint64_t triangles = triangle_bytes(scene);
    const uint64_t fixed = worker_bytes(gpu) + triangles;
    uint64_t limit = gpu->memory_bytes;
    if (scene->device_memory && scene->device_memory < limit)
        limit = scene->device_memory;
    if (triangles > gpu->buffer_bytes || samples > gpu->buffer_bytes)
        return bsq_fail(gpu->ctx, BSQ_ENODEVICE,
                        "%s: the low-poly mesh's triangles take %" PRIu64
                        " bytes and a patch's samples "
                        "%" PRIu64 ", a buffer of this device holds %" PRIu64,
                        gpu->device_name, triangles, samples, gpu->buffer_bytes);
    if (fixed >= limit)
        return bsq_fail(gpu->ctx, BSQ_ENODEVICE,
                        "%s: %s take %" PRIu64 " bytes of the device's memory, %" PRIu64
                        " are allowed: give more, or fewer --threads",
                        gpu->device_name, gpu->exact ? "rays" : "texels and the low-poly mesh",
                        fixed, limit);
    gpu->memory_bytes = limit - fixed;
    return gpu->shares_memory
               ? bake_gpu_reserve(gpu, "patches on a device that shares host memory", fixed)
               : 0;
}

/* ---- the grid ---- */

static struct bake_stream *upload_stream(const struct bake_gpu *gpu)
{
    return &gpu->streams[gpu->worker_count * gpu->windows];
}

/* Keeps the failure of an upload. Returns BSQ_ENODEVICE; 0 if there is none. */
static int note_failure(struct bake_gpu *gpu, struct bake_failure failure)
{
    gpu->upload_failure = failure;
    return failure.code ? BSQ_ENODEVICE : 0;
}

/* Sends the half that is being filled. Returns when the other one may be filled. */
static int gpu_flush(struct bake_gpu *gpu)
{
    struct bake_stream *stream = upload_stream(gpu);
    const unsigned half = gpu->filling;
    const uint64_t bytes = gpu->used;
    if (bytes == 0)
        return 0;
    gpu->used = 0;
    gpu->filling ^= 1;
    BSQ_PASS(note_failure(gpu, gpu->driver->send(gpu, stream, stream->host[half], bytes,
                                                 gpu->upload_to, gpu->upload_at, (int)half)));
    gpu->upload_at += bytes;
    BSQ_PASS(note_failure(gpu, gpu->driver->wait(gpu, stream, (int)half ^ 1)));
    return bsq_check(gpu->ctx);
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
static int copy_in(const struct bake_gpu *gpu, struct copy copy)
{
    if (copy.bytes > SHARE_BYTES)
        return bsq_parallel_for(gpu->ctx, (copy.bytes + SHARE_BYTES - 1) / SHARE_BYTES, copy_share,
                                &copy);
    memcpy(copy.to, copy.from, copy.bytes);
    return 0;
}

/* Appends data to the array that goes up. */
static int gpu_put(struct bake_gpu *gpu, const void *data, uint64_t bytes)
{
    const char *from = data;
    int status = 0;
    while (bytes > 0 && status == 0) {
        const uint64_t space = STAGING_BYTES - gpu->used, piece = bytes < space ? bytes : space;
        char *to = upload_stream(gpu)->host[gpu->filling] + gpu->used;
        status = copy_in(gpu, (struct copy){to, from, piece});
        gpu->used += piece;
        from += piece;
        bytes -= piece;
        if (status == 0 && gpu->used == STAGING_BYTES)
            status = gpu_flush(gpu);
    }
    return status;
}

/* Makes gpu_put() append to an array from now on. */
static void begin_upload(struct bake_gpu *gpu, bake_memory to)
{
    gpu->upload_to = to;
    gpu->upload_at = gpu->used = 0;
}

static int finish_upload(struct bake_gpu *gpu)
{
    return note_failure(gpu, gpu->driver->finish(gpu, upload_stream(gpu)));
}

static int send_triangles(struct bake_gpu *gpu, const struct bake_scene *scene)
{
    int status;
    BSQ_TRY(note_failure(gpu, gpu->driver->allocate(gpu, triangle_bytes(scene), &gpu->triangles)));
    begin_upload(gpu, gpu->triangles);
    BSQ_TRY(gpu_put(gpu, scene->triangles, triangle_bytes(scene)));
    BSQ_TRY(gpu_flush(gpu));
    status = finish_upload(gpu);
done:
    return status == BSQ_ENODEVICE ? bake_gpu_fail(gpu, gpu->upload_failure) : status;
}

static int gpu_load_grid(struct bake_gpu *gpu, const struct bake_grid_arrays *grid,
                         const char **what)
{
    *what = "memory that the device shares";
    if (gpu->shares_memory)
        BSQ_PASS(bake_gpu_reserve(gpu, "grid on a device that shares host memory", grid->bytes));
    gpu->params = grid->params;
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        *what = grid->arrays[i].name;
        BSQ_PASS(
            note_failure(gpu, gpu->driver->allocate(gpu, grid->arrays[i].bytes, &gpu->arrays[i])));
    }
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        const struct bake_grid_array *array = &grid->arrays[i];
        *what = array->name;
        begin_upload(gpu, gpu->arrays[i]);
        for (int k = 0; k < BAKE_ARRAY_RANGES; k++)
            BSQ_PASS(gpu_put(gpu, array->ranges[k].data, array->ranges[k].bytes));
        BSQ_PASS(gpu_flush(gpu));
    }
    return finish_upload(gpu);
}

/* Describes a failure in `why`, after the part of the work that it belongs to. */
static void gpu_describe_failure(const struct bake_gpu *gpu, const char *what,
                                 struct bake_failure failure, char *why)
{
    char text[BAKE_GPU_TEXT];
    snprintf(why, BAKE_WHY_BYTES, "%s: %s", what,
             failure.code ? gpu->driver->describe(gpu, failure.code, text) : bsq_error(gpu->ctx));
}

static double mebibytes(uint64_t bytes)
{
    return (double)bytes / (1 << 20);
}

/* Fails with BSQ_RETRY if the grid does not fit the device. */
static int check_space(const struct bake_gpu *gpu, const struct bake_grid_arrays *grid)
{
    if (grid->bytes > gpu->memory_bytes)
        return bsq_fail(gpu->ctx, BSQ_RETRY,
                        "the grid needs %.1f MiB of memory, %s has %.1f MiB for it",
                        mebibytes(grid->bytes), gpu->name, mebibytes(gpu->memory_bytes));
    if (grid->largest > gpu->array_bytes)
        return bsq_fail(gpu->ctx, BSQ_RETRY,
                        "the grid needs a buffer of %.1f MiB, those of %s have at most %.1f MiB",
                        mebibytes(grid->largest), gpu->name, mebibytes(gpu->array_bytes));
    return 0;
}

/* Divides the memory between first rays and those from hits: the first get a quarter of it, if they
 * can use as much, but at least what a chunk needs. Fails with BSQ_RETRY if the device cannot trace
 * rays through chunks of triangles. */
static int divide_memory(struct bake_gpu *gpu, const struct bake_scene *scene)
{
    const uint64_t chunk = scene->chunk_bytes, place = scene->place_bytes,
                   space = bk_lower(gpu->memory_bytes, gpu->array_bytes),
                   quarter = gpu->memory_bytes / 4;
    if (gpu->lacks)
        return bsq_fail(gpu->ctx, BSQ_RETRY, "%s has no %s, which triangles need", gpu->name,
                        gpu->lacks);
    if (chunk + place > gpu->memory_bytes || chunk > space || place > space)
        return bsq_fail(gpu->ctx, BSQ_RETRY,
                        "the largest chunk of the scan needs %.1f MiB of memory, %s has %.1f MiB "
                        "for it",
                        mebibytes(chunk + place), gpu->name, mebibytes(space));
    const uint64_t share = chunk == 0        ? space
                           : place < quarter ? quarter
                                             : place,
                   most = bk_lower(share, bk_lower(space, gpu->memory_bytes - chunk));
    gpu->wave_bytes = bk_lower(scene->wave_bytes, most);
    gpu->memory_bytes -= gpu->wave_bytes;
    return 0;
}

static int gpu_load(struct bake_gpu *gpu, const struct bake_scene *scene)
{
    const double started = bsq_seconds_now();
    struct bake_grid_arrays grid;
    char why[BAKE_WHY_BYTES];
    const char *what;
    int status;
    bake_list_arrays(scene, &grid);
    BSQ_TRY(check_space(gpu, &grid));
    gpu->upload_failure = BAKE_NO_FAILURE;
    status = gpu_load_grid(gpu, &grid, &what);
    if (status < 0) {
        (void)gpu->driver->finish(gpu, upload_stream(gpu));
        gpu_describe_failure(gpu, what, gpu->upload_failure, why);
        status = bsq_fail(gpu->ctx, status, "%s: %s", gpu->name, why);
    }
    gpu->upload_seconds = bsq_seconds_now() - started;
done:
    return status;
}

/* ---- patches ---- */

void bake_launch_add(struct bake_launch *launch, const void *value, uint64_t bytes)
{
    launch->arguments[launch->count++] = (struct bake_argument){bytes, value};
}

/* Starts the list of a launch's arguments, with the arrays of the grid. */
static struct bake_launch begin_launch(const struct bake_gpu *gpu, int kernel)
{
    struct bake_launch launch = {.kernel = kernel};
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++)
        BAKE_LAUNCH_ADD(&launch, gpu->arrays[i]);
    BAKE_LAUNCH_ADD(&launch, gpu->params);
    return launch;
}

static struct bake_failure launch_patch(struct bake_gpu *gpu, struct bake_stream *stream,
                                        const struct bk_patch *patch, const struct bk_batch *batch,
                                        uint32_t stage)
{
    struct bake_launch launch = begin_launch(gpu, BAKE_PATCH);
    launch.width = batch->end_column - batch->first_column;
    launch.height = batch->end_row - batch->first_row;
    BAKE_LAUNCH_ADD(&launch, gpu->triangles);
    BAKE_LAUNCH_ADD(&launch, *patch);
    BAKE_LAUNCH_ADD(&launch, *batch);
    BAKE_LAUNCH_ADD(&launch, stage);
    BAKE_LAUNCH_ADD(&launch, stream->samples);
    BAKE_LAUNCH_ADD(&launch, stream->points);
    BAKE_LAUNCH_ADD(&launch, stream->found);
    BAKE_LAUNCH_ADD(&launch, stream->texels);
    stream->launches++;
    return gpu->driver->launch(gpu, stream, &launch);
}

/* Traces the rays of `count` viewpoints. */
static struct bake_failure launch_look(struct bake_gpu *gpu, struct bake_stream *stream,
                                       uint32_t count)
{
    struct bake_launch launch = begin_launch(gpu, BAKE_LOOK);
    launch.width = bk_ray_count(&gpu->params);
    launch.height = count;
    for (launch.side = 1; launch.side < launch.width && launch.side < 32;)
        launch.side *= 2;
    BAKE_LAUNCH_ADD(&launch, stream->points);
    BAKE_LAUNCH_ADD(&launch, count);
    BAKE_LAUNCH_ADD(&launch, stream->found);
    stream->launches++;
    return gpu->driver->launch(gpu, stream, &launch);
}

static struct bake_failure launch_batch(struct bake_gpu *gpu, struct bake_stream *stream,
                                        const struct bk_patch *patch, const struct bk_batch *batch)
{
    const uint32_t samples = (batch->end_row - batch->first_row) *
                             (batch->end_column - batch->first_column) *
                             (batch->end_line - batch->first_line) * gpu->params.samples;
    if (bk_ray_count(&gpu->params) == 0)
        return launch_patch(gpu, stream, patch, batch, BK_ADD);
    BAKE_TRY_CALL(launch_patch(gpu, stream, patch, batch, BK_POINTS));
    BAKE_TRY_CALL(launch_look(gpu, stream, samples));
    return launch_patch(gpu, stream, patch, batch, BK_ADD_FOUND);
}

static struct bake_failure launch_batches(struct bake_gpu *gpu, struct bake_stream *stream,
                                          const struct bk_patch *patch)
{
    const struct bk_batch size = bake_first_batch(&gpu->params, patch);
    struct bk_batch batch = size;
    do {
        BAKE_TRY_CALL(launch_batch(gpu, stream, patch, &batch));
    } while (bake_next_batch(&gpu->params, patch, &size, &batch));
    return BAKE_NO_FAILURE;
}

static void note_times(struct bake_gpu *gpu, struct bake_stream *stream)
{
    const struct bake_span *times = stream->times;
    pthread_mutex_lock(&gpu->lock);
    bake_time_spans_add(&gpu->copies, &times[BAKE_SAMPLES]);
    bake_time_spans_add(&gpu->kernels, &times[BAKE_KERNELS]);
    bake_time_spans_add(&gpu->copies, &times[BAKE_TEXELS]);
    pthread_mutex_unlock(&gpu->lock);
}

void bake_gpu_release(struct bake_gpu *gpu, bake_memory *memory)
{
    if (*memory)
        gpu->driver->release(gpu, *memory);
    *memory = 0;
}

static void close_stream(struct bake_gpu *gpu, struct bake_stream *stream)
{
    gpu->driver->close_stream(gpu, stream);
    bake_gpu_release(gpu, &stream->samples);
    bake_gpu_release(gpu, &stream->texels);
    bake_gpu_release(gpu, &stream->points);
    bake_gpu_release(gpu, &stream->found);
    stream->open = false;
}

static struct bake_failure open_worker(struct bake_gpu *gpu, struct bake_stream *stream)
{
    const struct bake_driver *driver = gpu->driver;
    BAKE_TRY_CALL(driver->open_stream(gpu, stream));
    BAKE_TRY_CALL(driver->allocate(gpu, fetched_bytes(gpu), &stream->texels));
    if (!gpu->exact)
        BAKE_TRY_CALL(driver->allocate(gpu, sent_bytes(gpu), &stream->samples));
    if (bake_gpu_launches(gpu, BAKE_LOOK)) {
        BAKE_TRY_CALL(driver->allocate(gpu, point_bytes(gpu), &stream->points));
        BAKE_TRY_CALL(driver->allocate(gpu, found_bytes(gpu), &stream->found));
    }
    stream->open = true;
    return BAKE_NO_FAILURE;
}

struct bake_failure bake_gpu_take_stream(struct bake_gpu *gpu, struct bake_stream *stream)
{
    if (gpu->driver->attach)
        BAKE_TRY_CALL(gpu->driver->attach(gpu));
    return stream->open ? BAKE_NO_FAILURE : open_worker(gpu, stream);
}

/* Enqueues the copy of what a worker's next launches read. */
static struct bake_failure gpu_send(struct bake_gpu *gpu, struct bake_stream *stream,
                                    const void *data, uint64_t bytes)
{
    BAKE_TRY_CALL(bake_gpu_take_stream(gpu, stream));
    memcpy(stream->host[0], data, bytes);
    return gpu->driver->send(gpu, stream, stream->host[0], bytes, stream->samples, 0, BAKE_SAMPLES);
}

struct bake_failure bake_gpu_receive(struct bake_gpu *gpu, struct bake_stream *stream)
{
    if (gpu->driver->attach)
        BAKE_TRY_CALL(gpu->driver->attach(gpu));
    BAKE_TRY_CALL(gpu->driver->wait(gpu, stream, BAKE_TEXELS));
    BAKE_TRY_CALL(gpu->driver->times(gpu, stream));
    note_times(gpu, stream);
    return BAKE_NO_FAILURE;
}

static struct bake_failure gpu_begin_patch(struct bake_gpu *gpu, struct bake_stream *stream,
                                           const struct bk_patch *patch,
                                           const uint32_t *sample_triangles)
{
    const uint64_t count = (uint64_t)patch->width * patch->height;
    BAKE_TRY_CALL(gpu_send(gpu, stream, sample_triangles, sample_bytes(gpu, count)));
    BAKE_TRY_CALL(launch_batches(gpu, stream, patch));
    return gpu->driver->fetch(gpu, stream, texel_bytes(gpu, count));
}

int bake_gpu_end_worker(struct bake_gpu *gpu, struct bake_stream *stream,
                        struct bake_failure failure, char *why)
{
    if (failure.code == 0)
        return 0;
    if (!stream->open)
        close_stream(gpu, stream);
    gpu_describe_failure(gpu, failure.call, failure, why);
    return BSQ_ENODEVICE;
}

static struct bake_stream *stream_of(const struct bake_gpu *gpu, unsigned worker, unsigned window)
{
    return &gpu->streams[window * gpu->worker_count + worker];
}

int bake_gpu_begin(struct bake_gpu *gpu, const struct bk_patch *patch,
                   const uint32_t *sample_triangles, unsigned worker, unsigned window, char *why)
{
    if (worker >= gpu->worker_count || (uint64_t)patch->width * patch->height > gpu->patch_texels) {
        snprintf(why, BAKE_WHY_BYTES, "worker %u, patch of %u x %u texels: out of range", worker,
                 (unsigned)patch->width, (unsigned)patch->height);
        return BSQ_EBUG;
    }
    struct bake_stream *stream = stream_of(gpu, worker, window);
    return bake_gpu_end_worker(gpu, stream, gpu_begin_patch(gpu, stream, patch, sample_triangles),
                               why);
}

int bake_gpu_end(struct bake_gpu *gpu, const struct bk_patch *patch, float *texels, unsigned worker,
                 unsigned window, char *why)
{
    struct bake_stream *stream = stream_of(gpu, worker, window);
    const int status = bake_gpu_end_worker(gpu, stream, bake_gpu_receive(gpu, stream), why);
    if (status == 0)
        memcpy(texels, stream->host[0], texel_bytes(gpu, (uint64_t)patch->width * patch->height));
    return status;
}

/* ---- single rays ---- */

static struct bake_failure gpu_trace_rays(struct bake_gpu *gpu, struct bake_stream *stream,
                                          const float *values, const struct bk_single_rays *rays)
{
    struct bake_launch launch = begin_launch(gpu, BAKE_RAYS);
    launch.side = launch.width = rays->columns;
    launch.height = (rays->count - 1) / rays->columns + 1;
    BAKE_LAUNCH_ADD(&launch, *rays);
    BAKE_LAUNCH_ADD(&launch, stream->samples);
    BAKE_LAUNCH_ADD(&launch, stream->texels);
    BAKE_TRY_CALL(gpu_send(gpu, stream, values, rays->count * BK_RAY_FLOATS * sizeof(float)));
    stream->launches++;
    BAKE_TRY_CALL(gpu->driver->launch(gpu, stream, &launch));
    BAKE_TRY_CALL(gpu->driver->fetch(gpu, stream, rays->count * BK_HIT_FLOATS * sizeof(float)));
    return bake_gpu_receive(gpu, stream);
}

int bake_gpu_trace_rays(struct bake_gpu *gpu, const float *rays, uint32_t count, float t_min,
                        float t_max, const float **hits, unsigned worker, char *why)
{
    const struct bk_single_rays of = {t_min, t_max, count, 32};
    struct bake_stream *stream = stream_of(gpu, worker, 0);
    const struct bake_failure failure = gpu_trace_rays(gpu, stream, rays, &of);
    *hits = (const float *)(const void *)stream->host[0];
    return bake_gpu_end_worker(gpu, stream, failure, why);
}

/* ---- from opening to closing ---- */

struct bake_device_times bake_gpu_times(struct bake_gpu *gpu)
{
    struct bake_device_times times = {.upload = gpu->upload_seconds +
                                                bake_time_spans_seconds(&gpu->uploads),
                                      .copies = bake_time_spans_seconds(&gpu->copies),
                                      .kernels = bake_time_spans_seconds(&gpu->kernels)};
    for (unsigned i = 0; i < gpu->worker_count * gpu->windows; i++)
        times.launches += gpu->streams[i].launches;
    return times;
}

/* Creates the streams' structures, and reserves their host memory. */
static int create_streams(struct bake_gpu *gpu)
{
    const unsigned count = gpu->worker_count * gpu->windows + 1;
    const uint64_t stream_bytes = gpu->driver->stream_bytes;
    const uint64_t sent = sent_bytes(gpu), fetched = fetched_bytes(gpu);
    const uint64_t host = sent > fetched ? sent : fetched;
    const uint64_t staging = gpu->exact ? 0 : 2 * (uint64_t)STAGING_BYTES;
    BSQ_PASS(BSQ_CALLOC(gpu->ctx, "streams of the device", count, &gpu->streams));
    BSQ_PASS(
        bsq_calloc(gpu->ctx, "streams of the device", count, stream_bytes, &gpu->stream_memory));
    for (unsigned i = 0; i < count; i++)
        gpu->streams[i] = (struct bake_stream){
            .own = gpu->stream_memory + i * stream_bytes, .host_count = 1, .host_bytes = host};
    upload_stream(gpu)->host_count = 2;
    upload_stream(gpu)->host_bytes = STAGING_BYTES;
    return bake_gpu_reserve(gpu, "page-locked memory", (count - 1) * host + staging);
}

/* Prepares an opened device for a job and uploads the low-poly mesh. */
static int gpu_prepare(struct bake_gpu *gpu, const struct bake_scene *scene)
{
    gpu->patch_texels = scene->patch_texels;
    gpu->worker_count = bsq_threads(gpu->ctx);
    gpu->windows =
        gpu->exact ? 1 : bake_patch_windows(&gpu->params, gpu->patch_texels, gpu->worker_count);
    BSQ_PASS(create_streams(gpu));
    BSQ_PASS(share_memory(gpu, scene));
    if (gpu->exact)
        return divide_memory(gpu, scene);
    struct bake_stream *upload = upload_stream(gpu);
    upload->open = true;
    BSQ_PASS(bake_gpu_fail(gpu, gpu->driver->open_stream(gpu, upload)));
    return send_triangles(gpu, scene);
}

int bake_gpu_open(struct bsq_ctx *ctx, const struct bake_driver *driver, uint32_t number,
                  const struct bake_scene *scene, struct bake_gpu **out)
{
    struct bake_gpu *gpu;
    int status;
    *out = NULL;
    BSQ_TRY(bsq_calloc(ctx, "device", 1, driver->gpu_bytes, &gpu));
    gpu->ctx = ctx;
    gpu->driver = driver;
    gpu->params = scene->params;
    gpu->exact = !scene->grid;
    pthread_mutex_init(&gpu->lock, NULL);
    pthread_mutex_init(&gpu->sending, NULL);
    status = driver->open(gpu, number);
    if (status == 0)
        status = gpu_prepare(gpu, scene);
    if (status == 0 && !gpu->exact)
        status = gpu_load(gpu, scene);
    if (status < 0)
        bake_gpu_close(gpu);
    else
        *out = gpu;
done:
    return status;
}

void bake_gpu_close(struct bake_gpu *gpu)
{
    struct bsq_ctx *ctx = gpu->ctx;
    if (gpu->driver->attach)
        (void)gpu->driver->attach(gpu);
    for (unsigned i = 0; gpu->streams && i <= gpu->worker_count * gpu->windows; i++)
        if (gpu->streams[i].open)
            close_stream(gpu, &gpu->streams[i]);
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++)
        bake_gpu_release(gpu, &gpu->arrays[i]);
    bake_gpu_release_areas(gpu);
    bake_gpu_release(gpu, &gpu->areas[BAKE_WAVE]);
    bake_gpu_release(gpu, &gpu->triangles);
    gpu->driver->close(gpu);
    bsq_release(ctx, gpu->reserved_bytes);
    BSQ_FREE(ctx, gpu->streams, gpu->stream_memory);
    pthread_mutex_destroy(&gpu->lock);
    pthread_mutex_destroy(&gpu->sending);
    bsq_free(ctx, gpu);
}
