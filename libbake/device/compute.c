/* compute.c - uploads, tiles and times of devices with memory and queues of their own. */
#include "libbake/device/compute.h"

#include <inttypes.h>
#include <stdio.h>

#include "base/clock.h"

static const char *describe(const struct bake_compute *compute, int code, char *buffer)
{
    return compute->calls->describe(compute, code, buffer);
}

int bake_compute_fail(const struct bake_compute *compute, const char *what, int code)
{
    char text[BAKE_COMPUTE_TEXT];
    return bsq_fail(compute->ctx, BSQ_ENODEVICE, "%s: %s: %s", compute->device_name, what,
                    describe(compute, code, text));
}

/* ---- memory ---- */

static uint64_t texel_samples(const struct bake_compute *compute)
{
    return (uint64_t)compute->params.samples * compute->params.samples;
}

uint64_t bake_compute_sample_bytes(const struct bake_compute *compute)
{
    return compute->tile_texels * texel_samples(compute) * sizeof(uint32_t);
}

uint64_t bake_compute_texel_bytes(const struct bake_compute *compute)
{
    return (uint64_t)compute->tile_texels * sizeof(struct bk_texel);
}

static uint64_t worker_bytes(const struct bake_compute *compute)
{
    return compute->worker_count *
           (bake_compute_sample_bytes(compute) + bake_compute_texel_bytes(compute));
}

static uint64_t triangle_bytes(const struct bake_job *job)
{
    return job->triangle_count * (uint64_t)sizeof *job->triangles;
}

int bake_compute_reserve(struct bake_compute *compute, const char *what, uint64_t bytes)
{
    int status = bsq_reserve(compute->ctx, what, bytes);
    if (status == 0)
        compute->reserved_bytes += bytes;
    return status;
}

int bake_compute_share_memory(struct bake_compute *compute, const struct bake_job *job,
                              uint64_t limit, uint64_t buffer_bytes)
{
    const uint64_t samples = bake_compute_sample_bytes(compute), triangles = triangle_bytes(job);
    const uint64_t fixed = worker_bytes(compute) + triangles;

    if (job->device_memory && job->device_memory < limit)
        limit = job->device_memory;
    if (triangles > buffer_bytes || samples > buffer_bytes)
        return bsq_fail(compute->ctx, BSQ_ENODEVICE,
                        "%s: the low mesh's triangles take %" PRIu64 " bytes and a tile's samples "
                        "%" PRIu64 ", a buffer of this device holds %" PRIu64,
                        compute->device_name, triangles, samples, buffer_bytes);
    if (fixed >= limit)
        return bsq_fail(compute->ctx, BSQ_ENODEVICE,
                        "%s: tiles and the low mesh take %" PRIu64 " bytes of the device's memory, "
                        "%" PRIu64 " are allowed: give more, or fewer --threads",
                        compute->device_name, fixed, limit);
    compute->base.memory_bytes = limit - fixed;
    compute->base.other_bytes = fixed;
    compute->base.buffer_bytes = buffer_bytes;
    return compute->shares_memory
               ? bake_compute_reserve(compute, "tiles on a device that shares host memory", fixed)
               : 0;
}

/* ---- the grid ---- */

static int send_piece(void *device, unsigned turn, uint64_t bytes)
{
    struct bake_compute *compute = device;

    compute->calls->send(compute, turn, bytes, compute->upload_to, compute->upload_at,
                         &compute->upload_code);
    compute->upload_at += bytes;
    if (compute->upload_code == 0)
        compute->calls->wait_for_piece(compute, turn ^ 1, &compute->upload_code);
    return compute->upload_code == 0 ? bsq_check(compute->ctx) : BSQ_ENODEVICE;
}

/* Makes memory that what is put into the stage from now on goes to. */
static int begin_upload(struct bake_compute *compute, uint64_t bytes, bake_memory *out)
{
    compute->calls->allocate(compute, bytes, out, &compute->upload_code);
    compute->upload_to = *out;
    compute->upload_at = compute->stage.used = 0;
    return compute->upload_code == 0 ? 0 : BSQ_ENODEVICE;
}

static int finish_upload(struct bake_compute *compute)
{
    int status = bake_stage_flush(&compute->stage);

    if (status == 0) {
        compute->calls->drain(compute, &compute->upload_code);
        status = compute->upload_code == 0 ? 0 : BSQ_ENODEVICE;
    }
    return status;
}

int bake_compute_send_triangles(struct bake_compute *compute, const struct bake_job *job)
{
    int status = begin_upload(compute, triangle_bytes(job), &compute->triangles);

    if (status == 0)
        status = bake_stage_put(&compute->stage, job->triangles, triangle_bytes(job));
    if (status == 0)
        status = finish_upload(compute);
    return status == BSQ_ENODEVICE ? bake_compute_fail(compute, "triangles", compute->upload_code)
                                   : status;
}

static void unload_part(struct bake_compute *compute, struct bake_compute_part *part)
{
    for (int i = 0; i < BAKE_PART_ARRAYS; i++)
        if (part->arrays[i])
            compute->calls->release(compute, part->arrays[i]);
    bsq_release(compute->ctx, part->reserved_bytes);
    *part = (struct bake_compute_part){0};
}

static uint64_t part_bytes(const struct bake_part *part)
{
    uint64_t total = 0;

    for (int i = 0; i < BAKE_PART_ARRAYS; i++)
        total += part->bytes[i];
    return total;
}

static int reserve_part(struct bake_compute *compute, struct bake_compute_part *to,
                        const struct bake_part *part)
{
    const uint64_t total = part_bytes(part);
    int status = bsq_reserve(compute->ctx, "grid on a device that shares host memory", total);

    if (status == 0)
        to->reserved_bytes = total;
    return status;
}

static int load_part(struct bake_compute *compute, struct bake_compute_part *to,
                     const struct bake_part *part, const char **what)
{
    int status = 0;

    compute->upload_code = 0;
    if (compute->calls->attach)
        *what = compute->calls->attach(compute, &compute->upload_code);
    if (compute->upload_code != 0)
        return BSQ_ENODEVICE;
    unload_part(compute, to);
    *what = "memory that the device shares";
    if (compute->shares_memory)
        status = reserve_part(compute, to, part);
    to->params = part->params;
    for (int i = 0; i < BAKE_PART_ARRAYS && status == 0; i++) {
        *what = bake_part_array_name(i);
        status = begin_upload(compute, part->bytes[i], &to->arrays[i]);
        if (status == 0)
            status = bake_part_send(part, i, bake_stage_put, &compute->stage);
        if (status == 0)
            status = bake_stage_flush(&compute->stage);
    }
    return status == 0 ? finish_upload(compute) : status;
}

/* The grid was too much, though there should have been room for it: others use the device too. */
static void learn_memory(struct bake_compute *compute, const struct bake_part *whole)
{
    struct bake_backend *base = &compute->base;
    uint64_t left = part_bytes(whole) / 2;

    unload_part(compute, &compute->parts[0]);
    if (compute->calls->room) {
        const uint64_t room = compute->calls->room(compute), tiles = worker_bytes(compute);
        const uint64_t asked = room > tiles ? room - tiles : 0;
        left = asked < left ? asked : left;
    }
    base->memory_bytes = left;
    base->lacked_memory = true;
}

static int compute_load(struct bake_backend *backend, unsigned slot, const struct bake_part *part,
                        char *why)
{
    struct bake_compute *compute = (struct bake_compute *)backend;
    const double started = bsq_seconds_now();
    char text[BAKE_COMPUTE_TEXT];
    const char *what;
    int status, unused;

    /* A whole grid goes up before there is anything to trace; parts while the threads trace others.
     */
    compute->stage.ctx = part->whole ? compute->ctx : NULL;
    status = load_part(compute, &compute->parts[slot], part, &what);
    if (status < 0) {
        compute->calls->drain(compute, &unused);
        if (part->whole && compute->calls->lacks_memory(compute->upload_code))
            learn_memory(compute, part);
        snprintf(why, BAKE_WHY_BYTES, "%s: %s", what,
                 compute->upload_code == 0 ? bsq_error(compute->ctx)
                                           : describe(compute, compute->upload_code, text));
    }
    compute->upload_seconds += bsq_seconds_now() - started;
    return status;
}

/* ---- tiles ---- */

static uint32_t least(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static const char *launch_slices(struct bake_compute *compute, unsigned worker,
                                 const struct bake_compute_part *part, const struct bk_tile *tile,
                                 int *code)
{
    struct bake_compute_worker *own = &compute->workers[worker];
    const uint32_t n = compute->params.samples, lines = bake_slice_lines(n);
    const uint32_t rows =
        bake_slice_rows(&own->slices, (uint64_t)tile->width * n * lines, tile->height);
    const char *call = "";

    for (uint32_t line = 0; line < n && *code == 0; line += lines)
        for (uint32_t row = 0; row < tile->height && *code == 0; row += rows) {
            const struct bake_slice slice = {.first_row = row,
                                             .end_row = row + least(rows, tile->height - row),
                                             .first_line = line,
                                             .end_line = line + least(lines, n - line)};
            call = compute->calls->launch(compute, worker, part, tile, &slice, code);
            own->launches++;
        }
    return call;
}

static void note_times(struct bake_compute *compute, const struct bake_tile_times *times)
{
    pthread_mutex_lock(&compute->lock);
    bake_busy_add(&compute->copies, times->samples.start, times->samples.end);
    bake_busy_add(&compute->kernels, times->kernels.start, times->kernels.end);
    bake_busy_add(&compute->copies, times->texels.start, times->texels.end);
    pthread_mutex_unlock(&compute->lock);
}

/* Puts a tile's copies and kernels into the worker's queue and waits for them. */
static const char *run_tile(struct bake_compute *compute, unsigned worker,
                            const struct bake_compute_part *part, const struct bk_tile *tile,
                            const uint32_t *sample_triangles, struct bk_texel *texels, int *code)
{
    const uint64_t texel_count = (uint64_t)tile->width * tile->height;
    const uint64_t samples = texel_count * texel_samples(compute);
    struct bake_compute_worker *own = &compute->workers[worker];
    const char *call = compute->calls->write(compute, worker, part, tile, sample_triangles,
                                             samples * sizeof *sample_triangles, code);

    if (*code == 0)
        call = launch_slices(compute, worker, part, tile, code);
    if (*code == 0)
        call = compute->calls->read(compute, worker, texels, texel_count * sizeof *texels, code);
    if (*code == 0)
        call = compute->calls->times(compute, worker, &own->times, code);
    if (*code == 0) {
        bake_slices_learn(&own->slices, samples, own->times.kernels.end - own->times.kernels.start);
        note_times(compute, &own->times);
    }
    return call;
}

static const char *trace_tile(struct bake_compute *compute, unsigned worker,
                              const struct bake_compute_part *part, const struct bk_tile *tile,
                              const uint32_t *sample_triangles, struct bk_texel *texels, int *code)
{
    const char *call = "";

    if (compute->calls->attach)
        call = compute->calls->attach(compute, code);
    if (*code == 0 && !compute->workers[worker].open) {
        call = compute->calls->open_worker(compute, worker, code);
        compute->workers[worker].open = *code == 0;
        if (*code != 0)
            compute->calls->close_worker(compute, worker);
    }
    if (*code != 0)
        return call;
    call = run_tile(compute, worker, part, tile, sample_triangles, texels, code);
    compute->calls->leave(compute, worker, *code);
    return call;
}

static int compute_trace(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                         const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker,
                         char *why)
{
    struct bake_compute *compute = (struct bake_compute *)backend;
    char text[BAKE_COMPUTE_TEXT];
    const char *call;
    int code = 0;

    if (worker >= compute->worker_count ||
        (uint64_t)tile->width * tile->height > compute->tile_texels) {
        snprintf(why, BAKE_WHY_BYTES, "worker %u, tile of %u x %u texels: out of range", worker,
                 (unsigned)tile->width, (unsigned)tile->height);
        return BSQ_EBUG;
    }
    call =
        trace_tile(compute, worker, &compute->parts[slot], tile, sample_triangles, texels, &code);
    if (code == 0)
        return 0;
    snprintf(why, BAKE_WHY_BYTES, "%s: %s", call, describe(compute, code, text));
    return BSQ_ENODEVICE;
}

/* ---- from opening to closing ---- */

static void compute_times(struct bake_backend *backend, struct bake_device_times *out)
{
    struct bake_compute *compute = (struct bake_compute *)backend;

    *out = (struct bake_device_times){.upload = compute->upload_seconds,
                                      .copies = bake_busy_seconds(&compute->copies),
                                      .kernels = bake_busy_seconds(&compute->kernels)};
    for (unsigned i = 0; i < compute->worker_count; i++)
        out->launches += compute->workers[i].launches;
}

void bake_compute_init(struct bake_compute *compute, struct bsq_ctx *ctx,
                       const struct bake_compute_calls *calls,
                       void (*close)(struct bake_backend *backend))
{
    compute->base.trace = compute_trace;
    compute->base.load = compute_load;
    compute->base.times = compute_times;
    compute->base.close = close;
    compute->ctx = ctx;
    compute->calls = calls;
    compute->stage.send = send_piece;
    compute->stage.device = compute;
    pthread_mutex_init(&compute->lock, NULL);
}

int bake_compute_prepare(struct bake_compute *compute, const struct bake_job *job)
{
    compute->params = job->params;
    compute->tile_texels = job->tile_texels;
    compute->worker_count = bsq_threads(compute->ctx);
    return bsq_calloc(compute->ctx, "workers of the device", compute->worker_count,
                      sizeof *compute->workers, &compute->workers);
}

void bake_compute_unload(struct bake_compute *compute)
{
    for (unsigned i = 0; compute->workers && i < compute->worker_count; i++)
        if (compute->workers[i].open)
            compute->calls->close_worker(compute, i);
    for (int i = 0; i < BAKE_SLOTS; i++)
        unload_part(compute, &compute->parts[i]);
    if (compute->triangles)
        compute->calls->release(compute, compute->triangles);
}

void bake_compute_free(struct bake_compute *compute)
{
    bsq_release(compute->ctx, compute->reserved_bytes);
    bsq_free(compute->ctx, compute->workers);
    pthread_mutex_destroy(&compute->lock);
    bsq_free(compute->ctx, compute);
}
