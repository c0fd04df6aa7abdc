/* exact_trace.c - batches of rays against a chunk file.
 *
 * Chunks go through memory in waves: as many as there are slots are prepared, one a thread, and
 * then all threads work on blocks of their rays, so that a scan of a single chunk keeps every
 * thread busy too. The first pass finds the nearest hits; chunks may improve a ray's hit in any
 * order and at the same time. The second pass looks attributes up where the chunk at hand won.
 *
 * A chunk's tree is made anew for each batch: it takes a few milliseconds and nothing is kept. */
#include "libbake/exact/exact_scene.h"

#include <math.h>

#include "base/parallel.h"

enum {
    BLOCK = 4096,       /* rays of a chunk that are traced at a time */
    SLOTS_A_THREAD = 4, /* so that waves end evenly */
    STRIPES = 1024,     /* locks over the hits */
    PAIRS_A_RAY = 4 /* room for chunks a ray crosses; where they are more, batches go in parts */
};

/* ---- memory ---- */

static bool needs_smooth(const struct bake_exact *exact)
{
    return !(exact->header->attributes & FMT_TRIS_NORMALS) &&
           exact->options.normals == BSQ_SCAN_NORMALS_SMOOTH;
}

static uint64_t align64(uint64_t bytes)
{
    return (bytes + 63) & ~UINT64_C(63);
}

/* Largest sizes over all chunks, of the parts of a slot and of a worker's scratch. */
struct sizes {
    uint64_t chunk, tree, smooth;
    uint64_t boxes, keys, neighbour, map, near;
};

static struct sizes measure(const struct bake_exact *exact)
{
    struct sizes sizes = {0};
    uint32_t triangles = 0, vertices = 0;
    for (uint32_t c = 0; c < exact->chunk_count; c++) {
        const struct fmt_tris_chunk_info *chunk = &exact->chunks[c];
        triangles = chunk->triangle_count > triangles ? chunk->triangle_count : triangles;
        vertices = chunk->vertex_count > vertices ? chunk->vertex_count : vertices;
    }
    sizes.chunk = align64(fmt_tris_load_size_max(exact->file));
    sizes.tree = align64(bake_exact_tree_bytes(triangles));
    sizes.boxes = align64(triangles * sizeof(struct exact_box));
    sizes.keys = align64(bake_exact_tree_scratch_bytes(triangles));
    if (needs_smooth(exact)) {
        sizes.smooth = align64(bake_exact_smooth_bytes(vertices));
        sizes.neighbour = sizes.chunk;
        sizes.map = align64(vertices * sizeof(uint32_t));
        sizes.near = align64(exact->chunk_count * sizeof(uint32_t));
    }
    return sizes;
}

/* A slot does not hold a tree and sums of normals at the same time. */
static uint64_t slot_bytes(const struct sizes *sizes)
{
    return sizes->chunk + (sizes->tree > sizes->smooth ? sizes->tree : sizes->smooth);
}

static uint64_t scratch_bytes(const struct sizes *sizes)
{
    uint64_t building = sizes->boxes + sizes->keys;
    uint64_t shading = sizes->neighbour + sizes->map + sizes->near;
    return building > shading ? building : shading;
}

/* Slots and threads that prepare them: less of both where memory is short. */
struct plan {
    uint32_t slots, preparers;
    uint64_t bytes;
};

static struct plan plan_slots(const struct bake_exact *exact, uint64_t memory)
{
    const struct sizes sizes = measure(exact);
    const uint64_t slot = slot_bytes(&sizes), scratch = scratch_bytes(&sizes);
    const uint32_t threads = bsq_threads(exact->ctx);
    struct plan plan = {.slots = SLOTS_A_THREAD * threads, .preparers = threads};
    while (plan.slots > 1 && plan.slots * slot + plan.preparers * scratch > memory) {
        plan.slots--;
        plan.preparers = plan.slots < threads ? plan.slots : threads;
    }
    plan.bytes = plan.slots * slot + plan.preparers * scratch;
    return plan;
}

uint64_t bake_exact_capacity(const struct bake_exact *exact)
{
    const uint64_t left = exact_left_of_budget(exact->ctx);
    const uint64_t fixed = plan_slots(exact, left / 4).bytes + bake_exact_bin_bytes(exact) +
                           (exact->chunk_count + 1) * (sizeof(uint64_t) + PAIRS_A_RAY * 4) +
                           STRIPES * sizeof(pthread_mutex_t);
    const uint64_t ray = sizeof(struct bake_exact_ray) + sizeof(struct bake_exact_hit) +
                         (exact->textures ? sizeof(uint32_t) : 0) + PAIRS_A_RAY * sizeof(uint32_t);
    /* An eighth stays for what others need meanwhile. */
    const uint64_t room = left / 8 * 7;
    const uint64_t rays = room > fixed ? (room - fixed) / ray : 0;
    return rays < 1 ? 1 : rays > UINT32_MAX / 4 ? UINT32_MAX / 4 : rays;
}

/* ---- waves ---- */

struct block {
    uint32_t slot;
    uint64_t begin, end; /* in the bins */
};

struct wave {
    struct bake_exact *exact;
    const struct bake_exact_batch *batch;
    const struct exact_bins *bins;
    struct exact_limits limits;
    pthread_mutex_t *locks;
    struct plan plan;
    struct exact_slot *slots;
    struct exact_scratch *scratches;
    void *memory;
    uint32_t used;      /* slots of this wave */
    bool shading;       /* the second pass */
    uint64_t ray_count; /* of the part of the batch */
    struct block *blocks;
    uint64_t block_capacity, block_count;
};

static bool in_chunk(const struct bake_exact *exact, uint32_t chunk, uint64_t triangle)
{
    const struct fmt_tris_chunk_info *info = &exact->chunks[chunk];
    return triangle >= info->first_triangle &&
           triangle - info->first_triangle < info->triangle_count;
}

/* Loads what the chunk's hits need, if it won any. */
static int prepare_shading(struct wave *wave, struct exact_slot *slot,
                           const struct exact_scratch *scratch)
{
    const struct bake_exact *exact = wave->exact;
    const struct exact_bins *bins = wave->bins;
    const uint64_t begin = bins->starts[slot->number], end = bins->starts[slot->number + 1];
    const bool smooth = needs_smooth(exact);
    for (uint64_t i = begin; i < end; i++) {
        const uint64_t triangle = wave->batch->hits[bins->rays[i]].triangle;
        if (!in_chunk(exact, slot->number, triangle))
            continue;
        if (!slot->loaded) {
            int status = bake_exact_slot_load(exact, slot->number, slot);
            if (status < 0 || !smooth)
                return status;
            bake_exact_smooth_begin(slot);
        }
        const uint64_t first = exact->chunks[slot->number].first_triangle;
        const uint32_t *v = slot->chunk.triangles[triangle - first];
        for (int k = 0; k < 3; k++)
            bake_exact_smooth_need(slot, v[k]);
    }
    return slot->loaded ? bake_exact_smooth_sum(exact, slot, scratch) : 0;
}

static int prepare_slot(void *arg, uint64_t index, unsigned worker)
{
    struct wave *wave = arg;
    struct exact_slot *slot = &wave->slots[index];
    /* Fewer than the threads only where there are as few slots. */
    const bool one_each = wave->plan.preparers < bsq_threads(wave->exact->ctx);
    const struct exact_scratch *scratch = &wave->scratches[one_each ? index : worker];
    slot->loaded = false;
    if (wave->shading)
        return prepare_shading(wave, slot, scratch);
    int status = bake_exact_slot_load(wave->exact, slot->number, slot);
    if (status == 0)
        bake_exact_slot_build(slot, scratch);
    return status;
}

static void trace_ray(struct wave *wave, const struct exact_slot *slot, uint32_t ray)
{
    struct bake_exact_hit *hit = &wave->batch->hits[ray];
    pthread_mutex_t *lock = &wave->locks[ray / 4 % STRIPES];
    struct exact_best best;
    pthread_mutex_lock(lock);
    best.t = hit->t;
    best.triangle = hit->triangle;
    pthread_mutex_unlock(lock);
    if (!bake_exact_slot_trace(slot, wave->exact->chunks[slot->number].first_triangle,
                               &wave->batch->rays[ray], &wave->limits, &best))
        return;
    pthread_mutex_lock(lock);
    if (hit->triangle == BAKE_EXACT_NONE ||
        exact_wins(best.t, best.triangle, hit->t, hit->triangle)) {
        hit->t = best.t;
        hit->triangle = best.triangle;
        hit->normal[0] = best.w1;
        hit->normal[1] = best.w2;
    }
    pthread_mutex_unlock(lock);
}

/* Spreads the batch's progress evenly over the pairs of the first pass. */
static void add_progress(const struct wave *wave, const struct block *block)
{
    const struct bake_exact_batch *batch = wave->batch;
    const double pairs = (double)wave->bins->starts[wave->exact->chunk_count];
    const double units = (double)batch->progress * (double)wave->ray_count / (double)batch->count;
    const uint64_t before = (uint64_t)(units * ((double)block->begin / pairs)),
                   after = (uint64_t)(units * ((double)block->end / pairs));
    bsq_progress_add(wave->exact->ctx, after - before);
}

static int run_block(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    struct wave *wave = arg;
    const struct block *block = &wave->blocks[index];
    const struct exact_slot *slot = &wave->slots[block->slot];
    const uint32_t *rays = wave->bins->rays;
    if (!wave->shading) {
        for (uint64_t i = block->begin; i < block->end; i++)
            trace_ray(wave, slot, rays[i]);
        add_progress(wave, block);
        return 0;
    }
    for (uint64_t i = block->begin; slot->loaded && i < block->end; i++) {
        if (!in_chunk(wave->exact, slot->number, wave->batch->hits[rays[i]].triangle))
            continue;
        int status = bake_exact_shade(wave->exact, slot, wave->batch, rays[i]);
        if (status < 0)
            return status;
    }
    return 0;
}

static int list_blocks(struct wave *wave)
{
    wave->block_count = 0;
    for (uint32_t s = 0; s < wave->used; s++) {
        const uint64_t end = wave->bins->starts[wave->slots[s].number + 1];
        for (uint64_t at = wave->bins->starts[wave->slots[s].number]; at < end; at += BLOCK) {
            int status = bsq_grow(wave->exact->ctx, "blocks of rays", wave->block_count + 1,
                                  sizeof *wave->blocks, &wave->blocks, &wave->block_capacity);
            if (status < 0)
                return status;
            wave->blocks[wave->block_count++] =
                (struct block){s, at, at + BLOCK < end ? at + BLOCK : end};
        }
    }
    return 0;
}

static int run_wave(struct wave *wave)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    int status = bsq_parallel_for(ctx, wave->used, prepare_slot, wave);
    if (status == 0)
        status = list_blocks(wave);
    if (status == 0)
        status = bsq_parallel_for(ctx, wave->block_count, run_block, wave);
    wave->used = 0;
    return status;
}

static int run_waves(struct wave *wave, bool shading)
{
    const struct exact_bins *bins = wave->bins;
    int status = 0;
    wave->shading = shading;
    wave->used = 0;
    for (uint32_t c = 0; status == 0 && c < wave->exact->chunk_count; c++) {
        if (bins->starts[c] == bins->starts[c + 1])
            continue;
        wave->slots[wave->used++].number = c;
        if (wave->used == wave->plan.slots)
            status = run_wave(wave);
    }
    return status == 0 && wave->used > 0 ? run_wave(wave) : status;
}

/* ---- a batch ---- */

static int allocate_slots(struct wave *wave)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    const struct sizes sizes = measure(wave->exact);
    const struct plan *plan = &wave->plan;
    int status =
        bsq_calloc(ctx, "chunks in memory", plan->slots, sizeof *wave->slots, &wave->slots);
    if (status == 0)
        status = bsq_calloc(ctx, "chunks in memory", plan->preparers, sizeof *wave->scratches,
                            &wave->scratches);
    if (status == 0)
        status = bsq_alloc(ctx, "chunks in memory", plan->bytes, 1, &wave->memory);
    if (status < 0)
        return status;
    char *at = wave->memory;
    for (uint32_t s = 0; s < plan->slots; s++, at += slot_bytes(&sizes)) {
        wave->slots[s].chunk_memory = at;
        wave->slots[s].tree_memory = wave->slots[s].smooth_memory = at + sizes.chunk;
    }
    for (uint32_t p = 0; p < plan->preparers; p++, at += scratch_bytes(&sizes)) {
        struct exact_scratch *scratch = &wave->scratches[p];
        scratch->boxes = scratch->neighbour = at;
        scratch->keys = at + sizes.boxes;
        scratch->map = (uint32_t *)(void *)(at + sizes.neighbour);
        scratch->near = (uint32_t *)(void *)(at + sizes.neighbour + sizes.map);
    }
    return 0;
}

static int allocate(struct wave *wave, struct exact_bins *bins)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    const uint32_t chunks = wave->exact->chunk_count;
    bins->capacity = PAIRS_A_RAY * wave->batch->count + chunks;
    int status = allocate_slots(wave);
    if (status == 0)
        status = bsq_alloc(ctx, "rays by chunk", bins->capacity, sizeof *bins->rays, &bins->rays);
    if (status == 0)
        status = bsq_alloc(ctx, "rays by chunk", (uint64_t)chunks + 1, sizeof *bins->starts,
                           &bins->starts);
    if (status == 0)
        status = bsq_alloc(ctx, "locks", STRIPES, sizeof *wave->locks, &wave->locks);
    if (status == 0)
        for (int i = 0; i < STRIPES; i++)
            pthread_mutex_init(&wave->locks[i], NULL);
    return status;
}

static void release(struct wave *wave, struct exact_bins *bins)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    for (int i = 0; wave->locks && i < STRIPES; i++)
        pthread_mutex_destroy(&wave->locks[i]);
    bsq_free(ctx, wave->locks);
    bsq_free(ctx, wave->blocks);
    bsq_free(ctx, bins->rays);
    bsq_free(ctx, bins->starts);
    bsq_free(ctx, wave->memory);
    bsq_free(ctx, wave->slots);
    bsq_free(ctx, wave->scratches);
}

static int clear_hits(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct bake_exact_batch *batch = arg;
    const uint64_t begin = index * BLOCK, left = batch->count - begin;
    for (uint64_t i = begin; i < begin + (left < BLOCK ? left : BLOCK); i++)
        batch->hits[i] = (struct bake_exact_hit){.triangle = BAKE_EXACT_NONE};
    return 0;
}

/* A part of the batch: as many rays as have room in the bins. */
static int trace_part(struct wave *wave, struct exact_bins *bins, uint64_t *done)
{
    wave->ray_count = wave->batch->count - *done;
    int status = bake_exact_bin(wave->exact, wave->batch, *done, &wave->ray_count, bins);
    if (status == 0)
        status = run_waves(wave, false);
    if (status == 0 && !wave->batch->distances_only)
        status = run_waves(wave, true);
    *done += wave->ray_count;
    return status;
}

int bake_exact_trace(struct bake_exact *exact, const struct bake_exact_batch *batch)
{
    struct exact_bins bins = {0};
    struct wave wave = {.exact = exact,
                        .batch = batch,
                        .bins = &bins,
                        .limits = {.t_min = batch->t_min,
                                   .t_max = batch->t_max,
                                   .against = batch->against,
                                   .two_sided = exact->options.two_sided},
                        .plan = plan_slots(exact, exact_left_of_budget(exact->ctx) / 2)};
    if (batch->count == 0)
        return 0;
    int status = allocate(&wave, &bins);
    if (status == 0)
        status = bsq_parallel_for(exact->ctx, (batch->count - 1) / BLOCK + 1, clear_hits,
                                  (void *)(uintptr_t)batch);
    for (uint64_t done = 0; status == 0 && done < batch->count;)
        status = trace_part(&wave, &bins, &done);
    release(&wave, &bins);
    return status;
}
