/* compute.c - uploads, tiles and times of devices with memory and streams of their own. */
#include "libbake/device/compute/compute.h"

#include <inttypes.h>
#include <stdio.h>

#include "base/clock.h"
#include "libbake/raster/raster.h"

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
    return compute->tile_texels * bake_raster_texel_entries(&compute->params) * sizeof(uint32_t);
}

uint64_t bake_compute_texel_bytes(const struct bake_compute *compute)
{
    return (uint64_t)compute->tile_texels * bk_texel_floats(compute->params.maps) * sizeof(float);
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

/* Arrays in a block begin at multiples of this. A load of a warp's 32 numbers needs 128. */
enum { ARRAY_ALIGNMENT = 256 };

/* Returns the bytes that blocks need besides their arrays' bytes. */
static uint64_t block_waste(const struct bake_compute *compute)
{
    return compute->calls->blocks ? BAKE_SLOTS * BAKE_SUBGRID_ARRAYS * ARRAY_ALIGNMENT : 0;
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
    const uint64_t fixed = worker_bytes(compute) + triangles + block_waste(compute);

    if (job->device_memory && job->device_memory < limit)
        limit = job->device_memory;
    if (triangles > buffer_bytes || samples > buffer_bytes)
        return bsq_fail(compute->ctx, BSQ_ENODEVICE,
                        "%s: the low-poly mesh's triangles take %" PRIu64
                        " bytes and a tile's samples "
                        "%" PRIu64 ", a buffer of this device holds %" PRIu64,
                        compute->device_name, triangles, samples, buffer_bytes);
    if (fixed >= limit)
        return bsq_fail(compute->ctx, BSQ_ENODEVICE,
                        "%s: tiles and the low-poly mesh take %" PRIu64
                        " bytes of the device's memory, "
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

/* Sends a half of the staging buffer, see struct bake_staging_buffer. */
static int send_half(void *device, unsigned half, uint64_t bytes)
{
    struct bake_compute *compute = device;

    compute->calls->send_half(compute, half, bytes, compute->upload_to, compute->upload_at,
                              &compute->upload_code);
    compute->upload_at += bytes;
    if (compute->upload_code == 0)
        compute->calls->wait_for_half(compute, half ^ 1, &compute->upload_code);
    return compute->upload_code == 0 ? bsq_check(compute->ctx) : BSQ_ENODEVICE;
}

static int allocate(struct bake_compute *compute, uint64_t bytes, bake_memory *out)
{
    compute->calls->allocate(compute, bytes, out, &compute->upload_code);
    return compute->upload_code == 0 ? 0 : BSQ_ENODEVICE;
}

/* Sends what is put into the staging buffer from now on to an array. */
static void begin_upload(struct bake_compute *compute, bake_memory to)
{
    compute->upload_to = to;
    compute->upload_at = compute->staging.used = 0;
}

static int finish_upload(struct bake_compute *compute)
{
    int status = bake_staging_flush(&compute->staging);

    if (status == 0) {
        compute->calls->finish_uploads(compute, &compute->upload_code);
        status = compute->upload_code == 0 ? 0 : BSQ_ENODEVICE;
    }
    return status;
}

int bake_compute_send_triangles(struct bake_compute *compute, const struct bake_job *job)
{
    int status = allocate(compute, triangle_bytes(job), &compute->triangles);

    begin_upload(compute, compute->triangles);
    if (status == 0)
        status = bake_staging_put(&compute->staging, job->triangles, triangle_bytes(job));
    if (status == 0)
        status = finish_upload(compute);
    return status == BSQ_ENODEVICE ? bake_compute_fail(compute, "triangles", compute->upload_code)
                                   : status;
}

/* Frees a subgrid's arrays, except a block. */
static void unload_arrays(struct bake_compute *compute, struct bake_compute_subgrid *subgrid)
{
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++) {
        if (subgrid->arrays[i] && !compute->calls->blocks)
            compute->calls->release(compute, subgrid->arrays[i]);
        subgrid->arrays[i] = 0;
    }
    bsq_release(compute->ctx, subgrid->reserved_bytes);
    subgrid->reserved_bytes = 0;
}

static void free_block(struct bake_compute *compute, struct bake_compute_subgrid *subgrid)
{
    if (subgrid->block)
        compute->calls->release(compute, subgrid->block);
    subgrid->block = subgrid->block_bytes = 0;
}

static void unload_subgrid(struct bake_compute *compute, struct bake_compute_subgrid *subgrid)
{
    unload_arrays(compute, subgrid);
    free_block(compute, subgrid);
}

static int allocate_block(struct bake_compute *compute, struct bake_compute_subgrid *to,
                          uint64_t bytes)
{
    int status = allocate(compute, bytes, &to->block);

    to->block_bytes = status == 0 ? bytes : 0;
    return status;
}

/* Provides a block of at least `bytes`. One for passes fits the subgrids of all passes, if there is
 * memory for it. */
static int get_block(struct bake_compute *compute, struct bake_compute_subgrid *to, uint64_t bytes,
                     bool whole)
{
    const uint64_t pass = (compute->base.memory_bytes + block_waste(compute)) / BAKE_SLOTS;

    if (bytes <= to->block_bytes)
        return 0;
    free_block(compute, to);
    if (!whole && pass > bytes && allocate_block(compute, to, pass) == 0)
        return 0;
    compute->upload_code = 0;
    return allocate_block(compute, to, bytes);
}

static int place_in_block(struct bake_compute *compute, struct bake_compute_subgrid *to,
                          const struct bake_subgrid *subgrid)
{
    uint64_t bytes = 0, at = 0;
    int status;

    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++)
        bytes += bsq_align_up(subgrid->bytes[i], ARRAY_ALIGNMENT);
    status = get_block(compute, to, bytes, subgrid->whole);
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS && status == 0; i++) {
        to->arrays[i] = subgrid->bytes[i] ? to->block + at : 0;
        at += bsq_align_up(subgrid->bytes[i], ARRAY_ALIGNMENT);
    }
    return status;
}

static int reserve_subgrid(struct bake_compute *compute, struct bake_compute_subgrid *to,
                           const struct bake_subgrid *subgrid)
{
    uint64_t largest;
    const uint64_t total = bake_subgrid_total(subgrid->bytes, &largest);
    int status = bsq_reserve(compute->ctx, "grid on a device that shares host memory", total);

    if (status == 0)
        to->reserved_bytes = total;
    return status;
}

static int load_subgrid(struct bake_compute *compute, struct bake_compute_subgrid *to,
                        const struct bake_subgrid *subgrid, const char **what)
{
    int status = 0;

    compute->upload_code = 0;
    if (compute->calls->attach)
        *what = compute->calls->attach(compute, &compute->upload_code);
    if (compute->upload_code != 0)
        return BSQ_ENODEVICE;
    unload_arrays(compute, to);
    *what = "memory that the device shares";
    if (compute->shares_memory)
        status = reserve_subgrid(compute, to, subgrid);
    to->params = subgrid->params;
    if (status == 0 && compute->calls->blocks) {
        *what = "memory for the grid";
        status = place_in_block(compute, to, subgrid);
    }
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS && status == 0; i++) {
        *what = bake_subgrid_array_name(i);
        if (!compute->calls->blocks)
            status = allocate(compute, subgrid->bytes[i], &to->arrays[i]);
        begin_upload(compute, to->arrays[i]);
        if (status == 0)
            status = bake_subgrid_send(subgrid, i, bake_staging_put, &compute->staging);
        if (status == 0)
            status = bake_staging_flush(&compute->staging);
    }
    return status == 0 ? finish_upload(compute) : status;
}

/* Lowers memory_bytes after the whole grid did not fit although it should have: other programs use
 * the device too. */
static void learn_memory(struct bake_compute *compute, const struct bake_subgrid *whole)
{
    struct bake_backend *base = &compute->base;
    uint64_t largest, left = bake_subgrid_total(whole->bytes, &largest) / 2;

    unload_subgrid(compute, &compute->slots[0]);
    if (compute->calls->free_bytes) {
        const uint64_t free_bytes = compute->calls->free_bytes(compute),
                       others = worker_bytes(compute) + block_waste(compute);
        const uint64_t grid_bytes = free_bytes > others ? free_bytes - others : 0;
        left = grid_bytes < left ? grid_bytes : left;
    }
    base->memory_bytes = left;
    base->lacked_memory = true;
}

static int compute_load(struct bake_backend *backend, unsigned slot,
                        const struct bake_subgrid *subgrid, char *why)
{
    struct bake_compute *compute = (struct bake_compute *)backend;
    const double started = bsq_seconds_now();
    char text[BAKE_COMPUTE_TEXT];
    const char *what;
    int status, unused_code;

    /* A whole grid goes up before any tracing; subgrids while the other threads trace. */
    compute->staging.ctx = subgrid->whole ? compute->ctx : NULL;
    status = load_subgrid(compute, &compute->slots[slot], subgrid, &what);
    if (status < 0) {
        compute->calls->finish_uploads(compute, &unused_code);
        if (subgrid->whole && compute->calls->lacks_memory(compute->upload_code))
            learn_memory(compute, subgrid);
        snprintf(why, BAKE_WHY_BYTES, "%s: %s", what,
                 compute->upload_code == 0 ? bsq_error(compute->ctx)
                                           : describe(compute, compute->upload_code, text));
    }
    compute->upload_seconds += bsq_seconds_now() - started;
    return status;
}

/* ---- tiles ---- */

static uint32_t min_u32(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

/* Returns how many lines of a texel's samples one launch traces. */
static uint32_t lines_of(const struct bake_compute *compute)
{
    const uint32_t n = compute->params.samples;
    return min_u32(n, bake_batch_lines(n * bake_sample_cost(&compute->params)));
}

static const char *launch_batches(struct bake_compute *compute, unsigned worker,
                                  const struct bake_compute_subgrid *subgrid,
                                  const struct bk_tile *tile, int *code)
{
    struct bake_compute_worker *own = &compute->workers[worker];
    const uint32_t n = compute->params.samples, lines = lines_of(compute);
    const uint32_t rows = bake_batch_rows(
        &own->sizer, (uint64_t)tile->width * n * lines * bake_sample_cost(&compute->params),
        tile->height);
    const char *call = "";

    for (uint32_t line = 0; line < n && *code == 0; line += lines)
        for (uint32_t row = 0; row < tile->height && *code == 0; row += rows) {
            const struct bake_launch_batch batch = {.first_row = row,
                                                    .end_row =
                                                        row + min_u32(rows, tile->height - row),
                                                    .first_line = line,
                                                    .end_line = line + min_u32(lines, n - line)};
            call = compute->calls->launch(compute, worker, subgrid, tile, &batch, code);
            own->launches++;
        }
    return call;
}

static void note_times(struct bake_compute *compute, const struct bake_tile_times *times)
{
    pthread_mutex_lock(&compute->lock);
    bake_time_spans_add(&compute->copies, times->samples.start, times->samples.end);
    bake_time_spans_add(&compute->kernels, times->kernels.start, times->kernels.end);
    bake_time_spans_add(&compute->copies, times->texels.start, times->texels.end);
    pthread_mutex_unlock(&compute->lock);
}

/* Enqueues a tile's copies and kernels on the worker's stream and waits for them. */
static const char *run_tile(struct bake_compute *compute, unsigned worker,
                            const struct bake_compute_subgrid *subgrid, const struct bk_tile *tile,
                            const uint32_t *sample_triangles, float *texels, int *code)
{
    const uint64_t texel_count = (uint64_t)tile->width * tile->height;
    const uint64_t samples = texel_count * texel_samples(compute);
    struct bake_compute_worker *own = &compute->workers[worker];
    const char *call = compute->calls->send_samples(
        compute, worker, subgrid, tile, sample_triangles,
        texel_count * bake_raster_texel_entries(&compute->params) * sizeof *sample_triangles, code);

    if (*code == 0)
        call = launch_batches(compute, worker, subgrid, tile, code);
    if (*code == 0)
        call = compute->calls->fetch_texels(
            compute, worker, texels,
            texel_count * bk_texel_floats(compute->params.maps) * sizeof *texels, code);
    if (*code == 0)
        call = compute->calls->times(compute, worker, &own->times, code);
    if (*code == 0) {
        bake_batch_sizer_learn(&own->sizer, samples * bake_sample_cost(&compute->params),
                               own->times.kernels.end - own->times.kernels.start);
        note_times(compute, &own->times);
    }
    return call;
}

static const char *trace_tile(struct bake_compute *compute, unsigned worker,
                              const struct bake_compute_subgrid *subgrid,
                              const struct bk_tile *tile, const uint32_t *sample_triangles,
                              float *texels, int *code)
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
    call = run_tile(compute, worker, subgrid, tile, sample_triangles, texels, code);
    compute->calls->end_tile(compute, worker, *code);
    return call;
}

static int compute_trace(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                         const uint32_t *sample_triangles, float *texels, unsigned worker,
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
        trace_tile(compute, worker, &compute->slots[slot], tile, sample_triangles, texels, &code);
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
                                      .copies = bake_time_spans_seconds(&compute->copies),
                                      .kernels = bake_time_spans_seconds(&compute->kernels)};
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
    compute->staging.send = send_half;
    compute->staging.device = compute;
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
        unload_subgrid(compute, &compute->slots[i]);
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
