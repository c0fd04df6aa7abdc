/* areas.c - chunks of triangles in a device's memory, and rays through them.
 *
 * A scan may be larger than the device. So its chunks pass through areas in groups: one area is
 * filled while rays from viewpoints meet what is in the other. The states of rays stay with the
 * host between groups. First rays have an area of their own, for the chunks of a wave.
 *
 * All launches of a kernel have the same size, and work items without a ray end at once: PoCL 3.1
 * aborts if queues run a kernel in different sizes at the same time (its dlhandle cache). */
#include <stdio.h>
#include <string.h>

#include "base/context.h"
#include "libbake/device/gpu/gpu_internal.h"

/* A launch has at most this many viewpoints and, unless one has more, rays: 1.5 ms on a fast GPU, a
 * second on a slow one. */
enum { LOOK_VIEWPOINTS = 1 << 15, LOOK_RAYS = 1 << 19 };

/* ---- areas ---- */

void bake_gpu_release_areas(struct bake_gpu *gpu)
{
    if (gpu->area_bytes == 0)
        return;
    if (gpu->driver->attach)
        (void)gpu->driver->attach(gpu);
    for (uint32_t i = 0; i < BAKE_AREAS; i++)
        bake_gpu_release(gpu, &gpu->areas[i]);
    if (gpu->shares_memory) {
        bsq_release(gpu->ctx, gpu->area_count * gpu->area_bytes);
        gpu->reserved_bytes -= gpu->area_count * gpu->area_bytes;
    }
    gpu->area_bytes = gpu->area_count = 0;
}

/* Chooses the number and the size of areas. */
static void choose_areas(struct bake_gpu *gpu, uint64_t whole, uint64_t least)
{
    uint64_t space = gpu->memory_bytes;
    if (gpu->shares_memory) {
        uint64_t share = bsq_memory_left(gpu->ctx) / 3;
        share = share > least ? share : least;
        space = share < space ? share : space;
    }
    gpu->area_count = whole <= space && whole <= gpu->array_bytes ? 1 : space / 2 < least ? 1 : 2;
    const uint64_t each = space / gpu->area_count, fits = each < whole ? each : whole;
    gpu->area_bytes = fits < gpu->array_bytes ? fits : gpu->array_bytes;
}

/* Makes `count` areas of `bytes` bytes, from number `first` on. */
static int areas_allocate(struct bake_gpu *gpu, uint32_t first, uint32_t count, uint64_t bytes,
                          char *why)
{
    struct bake_failure failure = BAKE_NO_FAILURE;
    if (gpu->shares_memory) {
        const int status = bake_gpu_reserve(gpu, "chunks on the device", count * bytes);
        if (status < 0) {
            snprintf(why, BAKE_WHY_BYTES, "%s", bsq_error(gpu->ctx));
            return status;
        }
    }
    if (gpu->driver->attach)
        failure = gpu->driver->attach(gpu);
    for (uint32_t i = first; i < first + count && failure.code == 0; i++)
        failure = gpu->driver->allocate(gpu, bytes, &gpu->areas[i]);
    return bake_gpu_end_worker(gpu, gpu->streams, failure, why);
}

int bake_gpu_make_areas(struct bake_gpu *gpu, uint64_t whole, uint64_t least, char *why)
{
    bake_gpu_release_areas(gpu);
    choose_areas(gpu, whole, least);
    const int status = areas_allocate(gpu, 0, gpu->area_count, gpu->area_bytes, why);
    if (status < 0 && status != BSQ_ENODEVICE) /* nothing was reserved */
        gpu->area_bytes = 0;
    return status;
}

int bake_gpu_make_wave(struct bake_gpu *gpu, uint64_t least, char *why)
{
    if (gpu->shares_memory) {
        const uint64_t share = bsq_memory_left(gpu->ctx) / 8, most = share > least ? share : least;
        gpu->wave_bytes = most < gpu->wave_bytes ? most : gpu->wave_bytes;
    }
    return areas_allocate(gpu, BAKE_WAVE, 1, gpu->wave_bytes, why);
}

/* Sends what is in the host memory of a stream, and waits. */
static struct bake_failure send_piece(struct bake_gpu *gpu, struct bake_stream *stream,
                                      uint32_t area, uint64_t at, uint64_t bytes)
{
    const struct bake_driver *driver = gpu->driver;
    pthread_mutex_lock(&gpu->sending);
    struct bake_failure failure =
        driver->send(gpu, stream, stream->host[0], bytes, gpu->areas[area], at, BAKE_SAMPLES);
    if (failure.code == 0)
        failure = driver->wait(gpu, stream, BAKE_SAMPLES);
    pthread_mutex_unlock(&gpu->sending);
    return failure;
}

static struct bake_failure send_all(struct bake_gpu *gpu, uint32_t area, uint64_t at,
                                    const char *from, uint64_t bytes, unsigned worker)
{
    struct bake_stream *stream = &gpu->streams[worker];
    BAKE_TRY_CALL(bake_gpu_take_stream(gpu, stream));
    while (bytes > 0) {
        const uint64_t piece = bytes < stream->host_bytes ? bytes : stream->host_bytes;
        memcpy(stream->host[0], from, piece);
        BAKE_TRY_CALL(send_piece(gpu, stream, area, at, piece));
        from += piece;
        at += piece;
        bytes -= piece;
    }
    return BAKE_NO_FAILURE;
}

int bake_gpu_send(struct bake_gpu *gpu, uint32_t area, uint64_t at, const void *from,
                  uint64_t bytes, unsigned worker, char *why)
{
    struct bake_span span = {.start = bsq_seconds_now()};
    const struct bake_failure failure = send_all(gpu, area, at, from, bytes, worker);
    span.end = bsq_seconds_now();
    pthread_mutex_lock(&gpu->lock);
    bake_time_spans_add(&gpu->uploads, &span);
    pthread_mutex_unlock(&gpu->lock);
    return bake_gpu_end_worker(gpu, &gpu->streams[worker], failure, why);
}

/* ---- rays from viewpoints ---- */

uint32_t bake_gpu_viewpoints(const struct bk_params *params)
{
    const uint32_t rays = bk_ray_count(params), fitting = rays > 0 ? LOOK_RAYS / rays : 0;
    return fitting < 1 ? 1 : fitting < LOOK_VIEWPOINTS ? fitting : LOOK_VIEWPOINTS;
}

static uint64_t state_bytes(const struct bk_params *params)
{
    return bk_state_words(params) * sizeof(uint64_t) + bk_state_lengths(params) * sizeof(float);
}

uint64_t bake_gpu_chunk_rays_bytes(const struct bk_params *params)
{
    const uint64_t look =
                       bake_gpu_viewpoints(params) * (state_bytes(params) + sizeof(bk_viewpoint)),
                   first = BAKE_FIRST_BUNDLES * BAKE_RAY_BUNDLE *
                           (sizeof(bk_first_ray) + sizeof(bk_first_hit));
    return look > first ? look : first;
}

/* Copies the states of viewpoints from `begin` on to the host memory of a stream, or back. */
static void copy_states(const struct bake_ray_states *states, uint64_t begin, uint32_t count,
                        char *host, bool back)
{
    const uint64_t words = (uint64_t)count * states->words * sizeof *states->hidden,
                   lengths = (uint64_t)count * states->lengths * sizeof *states->distances;
    uint64_t *hidden = states->hidden + begin * states->words;
    float *distances = states->distances + begin * states->lengths;
    memcpy(back ? (char *)hidden : host, back ? host : (char *)hidden, words);
    host += words;
    memcpy(back ? (char *)distances : host, back ? host : (char *)distances, lengths);
}

/* Enqueues what a worker's viewpoints need and waits for it. bytes: of their states. */
static struct bake_failure trace_viewpoints(struct bake_gpu *gpu, struct bake_stream *stream,
                                            uint32_t area, const struct bk_params *params,
                                            uint32_t count, uint64_t bytes)
{
    const struct bake_driver *driver = gpu->driver;
    struct bake_launch launch = {
        .kernel = BAKE_MEET, .width = bk_ray_count(params), .height = bake_gpu_viewpoints(params)};
    for (launch.side = 1; launch.side < launch.width && launch.side < 32;)
        launch.side *= 2;
    BAKE_LAUNCH_ADD(&launch, gpu->areas[area]);
    BAKE_LAUNCH_ADD(&launch, *params);
    BAKE_LAUNCH_ADD(&launch, count);
    BAKE_LAUNCH_ADD(&launch, stream->texels);
    BAKE_TRY_CALL(driver->send(gpu, stream, stream->host[0], bytes + count * sizeof(bk_viewpoint),
                               stream->texels, 0, BAKE_SAMPLES));
    stream->launches++;
    BAKE_TRY_CALL(driver->launch(gpu, stream, &launch));
    BAKE_TRY_CALL(driver->fetch(gpu, stream, bytes));
    return bake_gpu_receive(gpu, stream);
}

int bake_gpu_look(struct bake_gpu *gpu, uint32_t area, const struct bk_params *params,
                  const struct bake_viewpoints *viewpoints, uint64_t begin, uint64_t end,
                  unsigned worker, const struct bake_ray_states *states, char *why)
{
    const uint32_t count = (uint32_t)(end - begin);
    const uint64_t bytes = count * state_bytes(params);
    struct bake_stream *stream = &gpu->streams[worker];
    struct bake_failure failure = bake_gpu_take_stream(gpu, stream);
    if (failure.code == 0) {
        bk_viewpoint *points = (bk_viewpoint *)(void *)(stream->host[0] + bytes);
        copy_states(states, begin, count, stream->host[0], false);
        for (uint64_t i = begin; i < end; i++, points++)
            if (!viewpoints->get(viewpoints->arg, i, points))
                points->side = 0.0f;
        failure = trace_viewpoints(gpu, stream, area, params, count, bytes);
    }
    if (failure.code == 0)
        copy_states(states, begin, count, stream->host[0], true);
    return bake_gpu_end_worker(gpu, stream, failure, why);
}

/* ---- first rays ---- */

/* Writes rays to the host memory of a stream, after the hits to come, enqueues what they need and
 * waits for it. */
static struct bake_failure trace_first_rays(struct bake_gpu *gpu, struct bake_stream *stream,
                                            uint64_t at, const bk_limits *limits,
                                            const struct bake_first_rays *rays)
{
    const struct bake_driver *driver = gpu->driver;
    const uint32_t count = rays->bundles * BAKE_RAY_BUNDLE, place = (uint32_t)(at / BSQ_ALIGNMENT);
    const uint64_t bytes = count * sizeof(bk_first_hit);
    struct bake_launch launch = {.kernel = BAKE_FIRST,
                                 .width = 32,
                                 .height = BAKE_FIRST_BUNDLES * BAKE_RAY_BUNDLE / 32,
                                 .side = 32};
    BAKE_TRY_CALL(bake_gpu_take_stream(gpu, stream));
    bk_first_ray *out = (bk_first_ray *)(void *)(stream->host[0] + bytes);
    for (uint32_t b = 0; b < rays->bundles; b++)
        rays->get(rays->arg, b, out + (uint64_t)b * BAKE_RAY_BUNDLE);
    BAKE_LAUNCH_ADD(&launch, gpu->areas[BAKE_WAVE]);
    BAKE_LAUNCH_ADD(&launch, place);
    BAKE_LAUNCH_ADD(&launch, *limits);
    BAKE_LAUNCH_ADD(&launch, count);
    BAKE_LAUNCH_ADD(&launch, stream->texels);
    BAKE_TRY_CALL(driver->send(gpu, stream, (const char *)out, count * sizeof *out, stream->texels,
                               bytes, BAKE_SAMPLES));
    stream->launches++;
    BAKE_TRY_CALL(driver->launch(gpu, stream, &launch));
    BAKE_TRY_CALL(driver->fetch(gpu, stream, bytes));
    return bake_gpu_receive(gpu, stream);
}

int bake_gpu_first(struct bake_gpu *gpu, uint64_t at, const bk_limits *limits,
                   const struct bake_first_rays *rays, const bk_first_hit **hits, unsigned worker,
                   char *why)
{
    struct bake_stream *stream = &gpu->streams[worker];
    const struct bake_failure failure = trace_first_rays(gpu, stream, at, limits, rays);
    *hits = (const bk_first_hit *)(const void *)stream->host[0];
    return bake_gpu_end_worker(gpu, stream, failure, why);
}
