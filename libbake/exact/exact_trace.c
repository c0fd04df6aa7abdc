/* exact_trace.c - traces a batch of rays against a chunk file.
 *
 * Chunks go through memory in waves. A wave first prepares as many chunks as there are slots, one
 * per thread. Then all threads work on blocks of the chunks' rays, so that even a scan of a single
 * chunk keeps every thread busy. Chunks may improve the hit of a ray in any order and at the same
 * time. Then normals and colours of the hits in these chunks are evaluated. A later wave evaluates
 * a few of them again, after it has found a better hit: that costs less than to load the chunks
 * again after the last wave.
 *
 * A device traces blocks instead of a thread, if there is one and it has the chunk
 * (exact_device.c).
 *
 * The tree of a chunk is built again for each batch that meets it: that takes a few milliseconds,
 * and keeping trees would take memory. */
#include "libbake/exact/exact_scene.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"

/* Entries of a bucket, and hits to clear, that a thread takes at a time. */
enum { BLOCK = 256, CLEARED = 4096 };

/* ---- waves ---- */

struct block {
    uint32_t slot;
    uint64_t begin, end; /* entries of the buckets */
};

struct wave {
    struct bake_exact *exact;
    const struct bake_ray_batch *batch;
    struct exact_buckets *buckets;
    bk_limits limits;
    pthread_mutex_t *locks; /* EXACT_LOCKS, each for the hits of some bundles */
    struct bake_exact_sweep *memory;
    uint32_t used;         /* slots of this wave */
    bool shading;          /* after the hits of the wave were found */
    uint64_t bundle_count; /* bundles that were sorted into the buckets */
    struct block *blocks;
    uint64_t block_capacity, block_count;
};

static bool in_chunk(const struct bake_exact *exact, uint32_t chunk, uint64_t triangle)
{
    const struct fmt_tris_chunk_info *info = &exact->chunks[chunk];
    return triangle >= info->first_triangle &&
           triangle - info->first_triangle < info->triangle_count;
}

/* Returns the corners of the triangle of a hit. */
static const uint32_t *hit_corners(const struct wave *wave, const struct exact_slot *slot,
                                   uint64_t ray)
{
    return slot->chunk.triangles[wave->batch->hits[ray].triangle -
                                 wave->exact->chunks[slot->number].first_triangle];
}

/* Lists the rays of an entry of the buckets whose hit is in the slot's chunk, and prefetches the
 * corners of their triangles. Returns their count. */
static uint32_t list_hits(const struct wave *wave, const struct exact_slot *slot, uint64_t entry,
                          uint64_t rays[BAKE_RAY_BUNDLE])
{
    uint32_t count = 0;
    for (unsigned left = wave->buckets->found[entry]; left; left &= left - 1) {
        const uint64_t ray = (uint64_t)wave->buckets->bundles[entry] * BAKE_RAY_BUNDLE +
                             (unsigned)__builtin_ctz(left);
        if (!in_chunk(wave->exact, slot->number, wave->batch->hits[ray].triangle))
            continue;
        __builtin_prefetch(hit_corners(wave, slot, ray));
        rays[count++] = ray;
    }
    return count;
}

static int prepare_slot(void *arg, uint64_t index, unsigned worker)
{
    struct wave *wave = arg;
    return bake_exact_slot_prepare(wave->exact, &wave->memory->slots, wave->batch->sampled, index,
                                   worker);
}

/* Loads the normals of a slot's chunk, in place of its tree, if there are hits in it. */
static int load_slot_normals(void *arg, uint64_t index, unsigned worker)
{
    struct wave *wave = arg;
    struct exact_slot *slot = &wave->memory->slots.slots[index];
    const uint64_t *starts = &wave->buckets->starts[slot->number];
    (void)worker;
    uint64_t rays[BAKE_RAY_BUNDLE];
    for (uint64_t i = starts[0]; i < starts[1]; i++)
        if (list_hits(wave, slot, i, rays) > 0)
            return fmt_tris_load_normals(wave->exact->file, slot->number, slot->tree_memory,
                                         &slot->normals);
    return 0;
}

/* Takes a hit of a ray, unless another chunk has found a better one meanwhile, or the ray has it
 * since an earlier batch. Returns whether it was taken. */
static bool trace_take_hit(struct bake_hit *hit, const struct exact_best *best)
{
    if (hit->triangle != BAKE_NO_HIT &&
        !bk_wins(best->t, best->triangle, hit->t, hit->triangle, best->reach))
        return false;
    hit->t = best->t;
    hit->triangle = best->triangle;
    hit->normal[0] = best->w1;
    hit->normal[1] = best->w2;
    return true;
}

/* ---- on devices ---- */

/* A block of bundles that a device traces. */
struct asked {
    const struct wave *wave;
    const struct block *block;
};

/* Writes the rays of a bundle, with their hits so far. */
static void get_first_rays(void *arg, uint32_t bundle, bk_first_ray *out)
{
    const struct asked *asked = arg;
    const struct bake_ray_batch *batch = asked->wave->batch;
    const uint32_t number = asked->wave->buckets->bundles[asked->block->begin + bundle];
    const uint64_t first = (uint64_t)number * BAKE_RAY_BUNDLE, left = batch->count - first;
    pthread_mutex_t *lock = &asked->wave->locks[number % EXACT_LOCKS];
    memset(out, 0, BAKE_RAY_BUNDLE * sizeof *out);
    pthread_mutex_lock(lock);
    for (uint64_t i = 0; i < left && i < BAKE_RAY_BUNDLE; i++) {
        const struct bake_hit *hit = &batch->hits[first + i];
        memcpy(out[i].origin, batch->rays[first + i].origin, sizeof out[i].origin);
        memcpy(out[i].direction, batch->rays[first + i].direction, sizeof out[i].direction);
        out[i].reach = batch->reaches ? batch->reaches[first + i] : 0;
        out[i].met = hit->triangle != BAKE_NO_HIT;
        out[i].t = hit->t;
    }
    pthread_mutex_unlock(lock);
}

/* Takes the hits of a bundle in the chunk of a slot. */
static void take_first_hits(const struct wave *wave, const struct exact_slot *slot, uint64_t entry,
                            const bk_first_hit *hits)
{
    const struct bake_ray_batch *batch = wave->batch;
    const uint32_t number = wave->buckets->bundles[entry];
    const uint64_t first = (uint64_t)number * BAKE_RAY_BUNDLE;
    pthread_mutex_t *lock = &wave->locks[number % EXACT_LOCKS];
    unsigned found = 0;
    pthread_mutex_lock(lock);
    for (unsigned i = 0; i < BAKE_RAY_BUNDLE; i++) {
        if (hits[i].triangle == BK_NO_TRIANGLE)
            continue;
        const struct exact_best best = {
            .t = hits[i].t,
            .triangle = wave->exact->chunks[slot->number].first_triangle + hits[i].triangle,
            .w1 = hits[i].w1,
            .w2 = hits[i].w2,
            .reach = batch->reaches ? (double)batch->reaches[first + i] : 0};
        found |= (unsigned)trace_take_hit(&batch->hits[first + i], &best) << i;
    }
    pthread_mutex_unlock(lock);
    wave->buckets->found[entry] = (uint16_t)found;
}

static int trace_block_on_device(const struct wave *wave, const struct exact_slot *slot,
                                 const struct block *block, unsigned worker)
{
    struct asked asked = {wave, block};
    const struct bake_first_rays rays = {
        .get = get_first_rays, .arg = &asked, .bundles = (uint32_t)(block->end - block->begin)};
    const bk_first_hit *hits;
    BSQ_PASS(bake_device_first(wave->exact->device, block->slot * wave->exact->place_bytes,
                               &wave->limits, &rays, &hits, worker));
    for (uint64_t i = block->begin; i < block->end; i++, hits += BAKE_RAY_BUNDLE)
        take_first_hits(wave, slot, i, hits);
    return 0;
}

/* ---- blocks ---- */

/* Traces the bundle of an entry of the buckets through the chunk of a slot. */
static void trace_trace_bundle(struct wave *wave, const struct exact_slot *slot, uint64_t entry)
{
    const struct bake_ray_batch *batch = wave->batch;
    const uint32_t number = wave->buckets->bundles[entry];
    const uint64_t first = (uint64_t)number * BAKE_RAY_BUNDLE;
    pthread_mutex_t *lock = &wave->locks[number % EXACT_LOCKS];
    const uint64_t left = batch->count - first;
    const uint32_t count = left < BAKE_RAY_BUNDLE ? (uint32_t)left : BAKE_RAY_BUNDLE;
    struct exact_best best[BAKE_RAY_BUNDLE];
    unsigned found = 0;
    pthread_mutex_lock(lock);
    for (uint64_t i = 0; i < count; i++)
        best[i] =
            (struct exact_best){.t = batch->hits[first + i].t,
                                .triangle = batch->hits[first + i].triangle,
                                .reach = batch->reaches ? (double)batch->reaches[first + i] : 0};
    pthread_mutex_unlock(lock);
    unsigned improved = BSQ_SIMD_PICK(wave->exact->simd, bake_exact_slot_trace)(
        slot, wave->exact->chunks[slot->number].first_triangle, batch->rays + first, count,
        &wave->limits, best);
    if (improved != 0) {
        pthread_mutex_lock(lock);
        for (; improved; improved &= improved - 1) {
            const unsigned i = (unsigned)__builtin_ctz(improved);
            found |= (unsigned)trace_take_hit(&batch->hits[first + i], &best[i]) << i;
        }
        pthread_mutex_unlock(lock);
    }
    wave->buckets->found[entry] = (uint16_t)found;
}

/* Spreads the progress of the batch evenly over the entries of the buckets in the first pass. */
static void trace_add_progress(const struct wave *wave, const struct block *block)
{
    const struct bake_ray_batch *batch = wave->batch;
    const double pairs = (double)wave->buckets->starts[wave->exact->chunk_count];
    const double share = (double)wave->bundle_count / (double)exact_bundles(batch->count) / pairs;
    bsq_progress_add_share(wave->exact->ctx, batch->progress, share * (double)block->begin,
                           share * (double)block->end);
}

/* Shades the hits of a block. Neighbouring rays hit triangles all over the chunk, so their data is
 * prefetched: corners a bundle ahead, then vertices. */
static int shade_block(const struct wave *wave, const struct exact_slot *slot,
                       const struct block *block)
{
    uint64_t rays[2][BAKE_RAY_BUNDLE];
    uint32_t counts[2] = {list_hits(wave, slot, block->begin, rays[0])};
    for (uint64_t i = block->begin; i < block->end; i++) {
        const uint32_t now = (i - block->begin) % 2;
        counts[1 - now] = i + 1 < block->end ? list_hits(wave, slot, i + 1, rays[1 - now]) : 0;
        for (uint32_t corner = 0; corner < 3 * counts[now]; corner++) {
            const uint32_t vertex = hit_corners(wave, slot, rays[now][corner / 3])[corner % 3];
            __builtin_prefetch(slot->chunk.positions[vertex]);
            if (wave->exact->smooth)
                __builtin_prefetch(&slot->normals.vertices[vertex]);
        }
        for (uint32_t r = 0; r < counts[now]; r++)
            BSQ_PASS(bake_exact_shade(wave->exact, slot, wave->batch, rays[now][r]));
    }
    return 0;
}

static int run_block(void *arg, uint64_t index, unsigned worker)
{
    struct wave *wave = arg;
    const struct block *block = &wave->blocks[index];
    struct exact_slot *slot = &wave->memory->slots.slots[block->slot];
    if (wave->shading)
        return shade_block(wave, slot, block);
    int status = BSQ_RETRY;
    if (wave->memory->slots.on_device && bake_device_has_areas(wave->exact->device))
        status = trace_block_on_device(wave, slot, block, worker);
    for (uint64_t i = block->begin; status == BSQ_RETRY && i < block->end; i++)
        trace_trace_bundle(wave, slot, i);
    trace_add_progress(wave, block);
    return status == BSQ_RETRY ? 0 : status;
}

static int list_blocks(struct wave *wave)
{
    const uint64_t each = wave->memory->slots.on_device ? BAKE_FIRST_BUNDLES : BLOCK;
    wave->block_count = 0;
    for (uint32_t s = 0; s < wave->used; s++) {
        const uint64_t end = wave->buckets->starts[wave->memory->slots.slots[s].number + 1];
        for (uint64_t at = wave->buckets->starts[wave->memory->slots.slots[s].number]; at < end;
             at += each) {
            BSQ_PASS(BSQ_GROW(wave->exact->ctx, "blocks of rays", wave->block_count + 1,
                              &wave->blocks, &wave->block_capacity));
            wave->blocks[wave->block_count++] =
                (struct block){s, at, at + each < end ? at + each : end};
        }
    }
    return 0;
}

/* Evaluates normals and colours of the hits in the wave's chunks. */
static int shade_wave(struct wave *wave)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    wave->shading = true;
    if (wave->exact->smooth)
        BSQ_PASS(bsq_parallel_for(ctx, wave->used, load_slot_normals, wave));
    return bsq_parallel_for(ctx, wave->block_count, run_block, wave);
}

/* Lets the system read the chunks of the next wave while this one is traced. Samples are not worth
 * it. */
static void read_ahead(const struct wave *wave)
{
    if (wave->batch->sampled && wave->exact->header->attributes & FMT_TRIS_SAMPLES)
        return;
    const uint64_t *starts = wave->buckets->starts;
    uint32_t next = wave->memory->slots.slots[wave->used - 1].number + 1;
    for (uint32_t ahead = 0; next < wave->exact->chunk_count && ahead < wave->memory->slots.count;
         next++)
        if (starts[next] < starts[next + 1]) {
            fmt_tris_read_ahead(wave->exact->file, next);
            ahead++;
        }
}

/* Returns whether a device traces the batch; it has a place for each slot then. */
static bool on_device(const struct wave *wave)
{
    const struct bake_exact *exact = wave->exact;
    return exact->device && !wave->batch->sampled && bake_device_has_areas(exact->device);
}

static int run_wave(struct wave *wave)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    struct bake_exact_sweep *memory = wave->memory;
    wave->shading = false;
    memory->slots.on_device = on_device(wave);
    for (uint32_t s = 0; s < wave->used; s++)
        memory->slots.slots[s].loaded = false;
    BSQ_PASS(bsq_parallel_for(ctx, wave->used, prepare_slot, wave));
    read_ahead(wave);
    BSQ_PASS(list_blocks(wave));
    BSQ_PASS(bsq_parallel_for(ctx, wave->block_count, run_block, wave));
    if (!wave->batch->distances_only)
        BSQ_PASS(shade_wave(wave));
    wave->used = 0;
    return 0;
}

static int run_waves(struct wave *wave)
{
    const struct exact_buckets *buckets = wave->buckets;
    int status = 0;
    wave->used = 0;
    for (uint32_t c = 0; status == 0 && c < wave->exact->chunk_count; c++) {
        if (buckets->starts[c] == buckets->starts[c + 1])
            continue;
        wave->memory->slots.slots[wave->used++].number = c;
        if (wave->used == wave->memory->slots.count)
            status = run_wave(wave);
    }
    return status == 0 && wave->used > 0 ? run_wave(wave) : status;
}

/* ---- memory ---- */

int bake_exact_sweep_create(struct bake_exact *exact, uint64_t most_rays,
                            struct bake_exact_sweep **out)
{
    const int status = BSQ_CALLOC(exact->ctx, "chunks in memory", 1, out);
    if (status == 0)
        **out = (struct bake_exact_sweep){.exact = exact, .most_rays = most_rays};
    return status;
}

void bake_exact_sweep_free(struct bake_exact_sweep *sweep)
{
    if (!sweep)
        return;
    bake_exact_slots_free(sweep->exact->ctx, &sweep->slots);
    bsq_free(sweep->exact->ctx, sweep);
}

static int allocate_chunks(const struct wave *wave)
{
    struct bake_exact_sweep *memory = wave->memory;
    const uint64_t share = bsq_memory_left(wave->exact->ctx) / 2;
    const uint32_t slots = exact_wave_slots(wave->exact), places = wave->exact->places;
    return bake_exact_slots_create(wave->exact, on_device(wave) && places < slots ? places : slots,
                                   share, &memory->slots);
}

static int trace_allocate(struct wave *wave, struct exact_buckets *buckets)
{
    /* The batches of a sweep all take as much memory: their slots stay. */
    const uint64_t rays = wave->batch->sweep ? wave->memory->most_rays : wave->batch->count;
    struct bsq_ctx *ctx = wave->exact->ctx;
    const uint32_t chunks = wave->exact->chunk_count;
    buckets->capacity = exact_bucket_entries(wave->exact, rays);
    BSQ_PASS(BSQ_ALLOC(ctx, "rays by chunk", buckets->capacity, &buckets->bundles));
    BSQ_PASS(BSQ_ALLOC(ctx, "rays by chunk", buckets->capacity, &buckets->found));
    BSQ_PASS(BSQ_ALLOC(ctx, "rays by chunk", (uint64_t)chunks + 1, &buckets->starts));
    BSQ_PASS(BSQ_ALLOC(ctx, "locks", EXACT_LOCKS, &wave->locks));
    for (int i = 0; i < EXACT_LOCKS; i++)
        pthread_mutex_init(&wave->locks[i], NULL);
    /* Last, because they make do with little memory. */
    if (wave->memory->slots.count == 0)
        return allocate_chunks(wave);
    return 0;
}

static int clear_hits(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct bake_ray_batch *batch = arg;
    for (uint64_t i = begin; i < end; i++)
        batch->hits[batch->continued + i] = (struct bake_hit){.triangle = BAKE_NO_HIT};
    return 0;
}

/* Traces the next bundles of the batch: as many bundles as fit the buckets. Adds their count to
 * *done.
 */
static int trace_bundles(struct wave *wave, struct exact_buckets *buckets, uint64_t *done)
{
    wave->bundle_count = exact_bundles(wave->batch->count) - *done;
    BSQ_PASS(bake_exact_sort_rays(wave->exact, wave->batch, *done, &wave->bundle_count, buckets));
    BSQ_PASS(run_waves(wave));
    *done += wave->bundle_count;
    return 0;
}

int bake_exact_trace(struct bake_exact *exact, const struct bake_ray_batch *batch)
{
    struct bsq_ctx *ctx = exact->ctx;
    struct exact_buckets buckets = {0};
    struct bake_exact_sweep own = {.exact = exact};
    struct wave wave = {.exact = exact,
                        .batch = batch,
                        .memory = batch->sweep ? batch->sweep : &own,
                        .buckets = &buckets,
                        .limits = {.t_min = batch->t_min,
                                   .t_max = batch->t_max,
                                   .gap = batch->gap,
                                   .sides = exact->two_sided       ? 0
                                            : batch->facing_origin ? (bk_uint)BK_AGAINST
                                                                   : (bk_uint)BK_ALONG,
                                   .from_reach = batch->from_reach}};
    int status = 0;
    if (batch->count == 0)
        return 0;
    BSQ_TRY(trace_allocate(&wave, &buckets));
    BSQ_TRY(bsq_parallel_ranges(ctx, batch->count - batch->continued, CLEARED, clear_hits,
                                (void *)(uintptr_t)batch));
    for (uint64_t done = 0; done < exact_bundles(batch->count);)
        BSQ_TRY(trace_bundles(&wave, &buckets, &done));
done:
    for (int i = 0; wave.locks && i < EXACT_LOCKS; i++)
        pthread_mutex_destroy(&wave.locks[i]);
    BSQ_FREE(ctx, wave.locks, wave.blocks, buckets.bundles, buckets.found, buckets.starts);
    bake_exact_slots_free(ctx, &own.slots);
    return status;
}
