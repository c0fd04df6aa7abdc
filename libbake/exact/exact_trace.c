/* exact_trace.c - traces a batch of rays against a chunk file.
 *
 * Chunks go through memory in waves. A wave first prepares as many chunks as there are slots, one
 * per thread. Then all threads work on blocks of the chunks' rays, so that even a scan of a single
 * chunk keeps every thread busy. The first pass finds the nearest hits; chunks may improve the hit
 * of a ray in any order and at the same time. The second pass evaluates normals and colours of the
 * hits in each chunk.
 *
 * The tree of a chunk is built again for each batch: that takes a few milliseconds, and keeping
 * trees would take memory. */
#include "libbake/exact/exact_scene.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"

/* Entries of a bucket, and hits to clear, that a thread takes at a time. */
enum { BLOCK = 256, CLEARED = 4096 };

/* ---- smooth normals ----
 *
 * Vertex normals of a chunk have the bits that the whole scan would give. Vertices at the same
 * position are one vertex, in one chunk or in several. The one-ring of a vertex
 * (base/smooth_normals.h) is summed in the order of the file, whichever chunks its triangles are
 * in. Only normals that hits need are summed, and only chunks whose bounds contain such a vertex
 * are read: three times if some of these vertices may be creases. */

enum { PARTS = BSQ_RING_UNITS, ROWS = 2 };

enum step { STEP_SUM, STEP_FARTHEST, STEP_SIDES };

uint64_t bake_exact_smooth_bytes(uint32_t vertices)
{
    const struct exact_smooth *s = NULL;
    return (uint64_t)bsq_positions_slots(vertices) * sizeof *s->table.slots +
           (uint64_t)vertices * (sizeof *s->positions + sizeof *s->entry_of) +
           ((uint64_t)vertices + 1) *
               (2 * ROWS * sizeof *s->sums + sizeof *s->creases + sizeof *s->crease_of);
}

static void begin_smooth(struct exact_slot *slot)
{
    struct exact_smooth *s = &slot->smooth;
    const uint32_t vertices = slot->chunk.vertex_count, slots = bsq_positions_slots(vertices);
    s->sums = slot->smooth_memory;
    s->seconds = s->sums + ROWS * ((uint64_t)vertices + 1);
    s->creases = s->seconds + ROWS * ((uint64_t)vertices + 1);
    s->positions = (float(*)[3])(void *)(s->creases + vertices + 1);
    s->crease_of = (uint32_t *)(void *)(s->positions + vertices);
    s->entry_of = s->crease_of + vertices + 1;
    s->table =
        (struct bsq_positions){s->entry_of + vertices, slots - 1, (const float(*)[3])s->positions};
    s->count = 0;
    memset(s->sums[0], 0, ROWS * sizeof *s->sums);
    memset(s->table.slots, 0, slots * sizeof *s->table.slots);
    memset(s->entry_of, 0, vertices * sizeof *s->entry_of);
}

/* Makes sum_smooth() sum the normal of a vertex. */
static void need_smooth(struct exact_slot *slot, uint32_t vertex)
{
    struct exact_smooth *s = &slot->smooth;
    if (s->entry_of[vertex] != 0)
        return;
    uint32_t *entry = bsq_positions_find(&s->table, slot->chunk.positions[vertex]);
    if (*entry == 0) {
        memcpy(s->positions[s->count], slot->chunk.positions[vertex], sizeof *s->positions);
        *entry = ++s->count;
        memset(s->sums[ROWS * s->count], 0, ROWS * sizeof *s->sums);
    }
    s->entry_of[vertex] = *entry;
}

static bool inside(const struct exact_box *box, const float p[3])
{
    bool in = true;
    for (int k = 0; k < 3; k++)
        in &= (p[k] >= box->low[k]) & (p[k] <= box->high[k]);
    return in;
}

/* Does a step for the triangles of a chunk. map: the entries of its vertices. */
static void add_chunk(const struct exact_smooth *s, enum step step, enum bsq_scan_normals weights,
                      const struct fmt_tris_chunk *chunk, const uint32_t *map)
{
    const uint32_t count = chunk->triangle_count;
    if (step == STEP_SUM)
        bsq_add_one_rings(chunk->positions, chunk->triangles, 0, count, map, weights, PARTS,
                          s->sums);
    else if (step == STEP_FARTHEST)
        bsq_find_farthest(chunk->positions, chunk->triangles, 0, count, map, s->crease_of, PARTS,
                          (const double(*)[4])s->sums, s->creases);
    else
        bsq_add_sides(chunk->positions, chunk->triangles, 0, count, map, s->crease_of, PARTS,
                      (const double(*)[4])s->creases, s->sums, s->seconds);
}

/* Returns whether a step needs the vertex at position i. */
static bool is_needed(const struct exact_smooth *s, enum step step, uint32_t i)
{
    return step == STEP_SUM || s->crease_of[i + 1] != 0;
}

static struct exact_box bounds_of(const struct exact_smooth *s, enum step step)
{
    struct exact_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (uint32_t i = 0; i < s->count; i++) {
        if (!is_needed(s, step, i))
            continue;
        for (int k = 0; k < 3; k++) {
            const float p = s->positions[i][k];
            box.low[k] = p < box.low[k] ? p : box.low[k];
            box.high[k] = p > box.high[k] ? p : box.high[k];
        }
    }
    return box;
}

/* Checks whether a needed vertex lies within the bounds of a chunk. */
static bool touches_chunk(const struct exact_smooth *s, enum step step,
                          const struct fmt_tris_chunk_info *chunk)
{
    struct exact_box box;
    memcpy(box.low, chunk->bounds_min, sizeof box.low);
    memcpy(box.high, chunk->bounds_max, sizeof box.high);
    for (uint32_t i = 0; i < s->count; i++)
        if (inside(&box, s->positions[i]) && is_needed(s, step, i))
            return true;
    return false;
}

static int ascending(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

/* Sums of a slot, and what they are made of. */
struct summing {
    const struct bake_exact *exact;
    struct exact_slot *slot;
    const struct exact_slot *wave; /* slots whose chunks are in memory, if they are loaded */
    uint32_t wave_count;
    const struct exact_scratch *scratch;
};

/* Gets a chunk: that of a slot of the wave, or into the scratch. Fails as fmt_tris_load() does. */
static int get_neighbour(const struct summing *of, uint32_t number, struct fmt_tris_chunk *out)
{
    for (uint32_t i = 0; i < of->wave_count; i++)
        if (of->wave[i].number == number && of->wave[i].loaded) {
            *out = of->wave[i].chunk;
            return 0;
        }
    return fmt_tris_load(of->exact->file, number, of->scratch->neighbour, out);
}

/* Does a step for the triangles of a neighbour. Fails as fmt_tris_load() does. */
static int add_neighbour(const struct summing *of, enum step step, const struct exact_box *box,
                         uint32_t number)
{
    const struct exact_smooth *s = &of->slot->smooth;
    struct fmt_tris_chunk chunk;
    int status = bsq_check(of->exact->ctx);
    if (status == 0)
        status = get_neighbour(of, number, &chunk);
    if (status == 0 && bsq_positions_match(&s->table, box->low, box->high, chunk.positions,
                                           chunk.vertex_count, of->scratch->map))
        add_chunk(s, step, of->exact->options.normals, &chunk, of->scratch->map);
    return status;
}

/* Does a step for the triangles of all chunks near the needed vertices, in the order of the file.
 */
static int run_step(const struct summing *of, enum step step, uint32_t near)
{
    const struct bake_exact *exact = of->exact;
    const struct exact_smooth *s = &of->slot->smooth;
    const struct fmt_tris_chunk *own = &of->slot->chunk;
    const struct exact_box box = bounds_of(s, step);
    int status = 0;
    for (uint32_t i = 0; i < near && status == 0; i++) {
        const uint32_t number = of->scratch->near[i];
        if (number != of->slot->number) {
            if (touches_chunk(s, step, &exact->chunks[number]))
                status = add_neighbour(of, step, &box, number);
            continue;
        }
        /* Also matches vertices that are not needed but share the position of one that is. */
        if (step == STEP_SUM)
            bsq_positions_match(&s->table, box.low, box.high, own->positions, own->vertex_count,
                                s->entry_of);
        add_chunk(s, step, exact->options.normals, own, s->entry_of);
    }
    return status;
}

/* Numbers the one-rings that may be creases. Returns whether there are any. */
static bool begin_creases(const struct exact_smooth *s)
{
    bool any = false;
    s->crease_of[0] = 0;
    for (uint32_t i = 1; i <= s->count; i++) {
        s->crease_of[i] = bsq_may_fold(s->sums[ROWS * i + 1]) ? i : 0;
        any |= s->crease_of[i] != 0;
        memcpy(s->creases[i], (const double[4]){[3] = INFINITY}, sizeof *s->creases);
    }
    return any;
}

/* Divides one-rings. Returns whether there are any. */
static bool divide_rings(const struct exact_smooth *s)
{
    bool any = false;
    for (uint32_t i = 1; i <= s->count; i++) {
        if (s->crease_of[i] != 0 && !bsq_divide_ring(&s->sums[ROWS * i], PARTS, s->creases[i]))
            s->crease_of[i] = 0;
        any |= s->crease_of[i] != 0;
        memset(s->seconds[ROWS * i], 0, ROWS * sizeof *s->seconds);
    }
    return any;
}

/* Sums the normals of the vertices that are needed, and of both sides of creases. */
static int sum_smooth(const struct summing *of)
{
    const struct exact_smooth *s = &of->slot->smooth;
    const struct exact_box box = bounds_of(s, STEP_SUM);
    const uint32_t near = bake_exact_tree_overlapping(&of->exact->tree, &box, of->scratch->near);
    bsq_sort(of->scratch->near, near, sizeof *of->scratch->near, ascending);
    int status = run_step(of, STEP_SUM, near);
    if (status == 0 && begin_creases(s))
        status = run_step(of, STEP_FARTHEST, near);
    else
        return status;
    if (status == 0 && divide_rings(s))
        status = run_step(of, STEP_SIDES, near);
    return status;
}

/* ---- waves ---- */

struct block {
    uint32_t slot;
    uint64_t begin, end; /* entries of the buckets */
};

struct wave {
    struct bake_exact *exact;
    const struct bake_exact_batch *batch;
    struct exact_buckets *buckets;
    struct exact_limits limits;
    pthread_mutex_t *locks; /* EXACT_LOCKS, each for the hits of some bundles */
    struct exact_slots memory;
    uint32_t used;         /* slots of this wave */
    bool shading;          /* the second pass */
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

/* Calls `take` for each ray whose hit is in the slot's chunk, among entries of its bucket. */
static inline int
each_hit(const struct wave *wave, struct exact_slot *slot, uint64_t begin, uint64_t end,
         int (*take)(const struct wave *wave, struct exact_slot *slot, uint64_t ray))
{
    const struct exact_buckets *buckets = wave->buckets;
    int status = 0;
    for (uint64_t i = begin; i < end; i++)
        for (unsigned left = buckets->found[i]; left && status == 0; left &= left - 1) {
            const uint64_t ray =
                (uint64_t)buckets->bundles[i] * BAKE_EXACT_BUNDLE + (unsigned)__builtin_ctz(left);
            if (in_chunk(wave->exact, slot->number, wave->batch->hits[ray].triangle))
                status = take(wave, slot, ray);
        }
    return status;
}

/* Loads the slot's chunk for the first hit, and notes which normals a hit needs. */
static int need_hit(const struct wave *wave, struct exact_slot *slot, uint64_t ray)
{
    const struct bake_exact *exact = wave->exact;
    const bool smooth = exact_needs_smooth(exact);
    if (!slot->loaded) {
        int status = bake_exact_slot_load(exact, slot->number, slot);
        if (status < 0)
            return status;
        if (smooth)
            begin_smooth(slot);
    }
    const uint64_t first = exact->chunks[slot->number].first_triangle;
    const uint32_t *v = slot->chunk.triangles[wave->batch->hits[ray].triangle - first];
    for (int k = 0; k < 3 && smooth; k++)
        need_smooth(slot, v[k]);
    return 0;
}

/* Loads the chunk of a slot: for tracing, or if it has hits that are shaded. */
static int load_slot(void *arg, uint64_t index, unsigned worker)
{
    struct wave *wave = arg;
    struct exact_slot *slot = &wave->memory.slots[index];
    const uint64_t *starts = &wave->buckets->starts[slot->number];
    slot->loaded = false;
    return wave->shading ? each_hit(wave, slot, starts[0], starts[1], need_hit)
                         : bake_exact_slot_prepare(wave->exact, &wave->memory, index, worker);
}

/* Sums the vertex normals that the hits in a slot's chunk need. */
static int sum_slot(void *arg, uint64_t index, unsigned worker)
{
    struct wave *wave = arg;
    const struct summing of = {.exact = wave->exact,
                               .slot = &wave->memory.slots[index],
                               .wave = wave->memory.slots,
                               .wave_count = wave->used,
                               .scratch =
                                   bake_exact_scratch(wave->exact, &wave->memory, index, worker)};
    return of.slot->loaded ? sum_smooth(&of) : 0;
}

/* The rays of a bundle that have a direction, and their hits so far. */
struct bundle {
    uint32_t count;
    uint8_t numbers[BAKE_EXACT_BUNDLE]; /* in the bundle */
    struct bake_exact_ray rays[BAKE_EXACT_BUNDLE];
    struct exact_best best[BAKE_EXACT_BUNDLE];
};

static void get_bundle(const struct bake_exact_batch *batch, uint64_t first, struct bundle *out)
{
    out->count = 0;
    for (uint64_t ray = first; ray < batch->count && ray < first + BAKE_EXACT_BUNDLE; ray++) {
        const float *d = batch->rays[ray].direction;
        if (d[0] == 0.0f && d[1] == 0.0f && d[2] == 0.0f)
            continue;
        out->numbers[out->count] = (uint8_t)(ray - first);
        out->rays[out->count] = batch->rays[ray];
        out->best[out->count++] =
            (struct exact_best){.t = batch->hits[ray].t,
                                .triangle = batch->hits[ray].triangle,
                                .reach = batch->reaches ? (double)batch->reaches[ray] : 0};
    }
}

/* Takes a hit of a ray, unless another chunk has found a better one meanwhile. */
static void take_hit(struct bake_exact_hit *hit, const struct exact_best *best)
{
    if (hit->triangle != BAKE_EXACT_NONE &&
        !exact_wins(best->t, best->triangle, hit->t, hit->triangle, best->reach))
        return;
    hit->t = best->t;
    hit->triangle = best->triangle;
    hit->normal[0] = best->w1;
    hit->normal[1] = best->w2;
}

/* Traces the bundle of an entry of the buckets through the chunk of a slot. */
static void trace_bundle(struct wave *wave, const struct exact_slot *slot, uint64_t entry)
{
    const uint32_t number = wave->buckets->bundles[entry];
    const uint64_t first = (uint64_t)number * BAKE_EXACT_BUNDLE;
    pthread_mutex_t *lock = &wave->locks[number % EXACT_LOCKS];
    struct bundle bundle;
    unsigned found = 0;
    pthread_mutex_lock(lock);
    get_bundle(wave->batch, first, &bundle);
    pthread_mutex_unlock(lock);
    unsigned improved = 0;
    if (bundle.count > 0)
        improved = BSQ_SIMD_PICK(wave->exact->simd, bake_exact_slot_trace)(
            slot, wave->exact->chunks[slot->number].first_triangle, bundle.rays, bundle.count,
            &wave->limits, bundle.best);
    if (improved != 0) {
        pthread_mutex_lock(lock);
        for (; improved; improved &= improved - 1) {
            const unsigned i = (unsigned)__builtin_ctz(improved), ray = bundle.numbers[i];
            take_hit(&wave->batch->hits[first + ray], &bundle.best[i]);
            found |= 1u << ray;
        }
        pthread_mutex_unlock(lock);
    }
    wave->buckets->found[entry] = (uint16_t)found;
}

/* Spreads the progress of the batch evenly over the entries of the buckets in the first pass. */
static void add_progress(const struct wave *wave, const struct block *block)
{
    const struct bake_exact_batch *batch = wave->batch;
    const double pairs = (double)wave->buckets->starts[wave->exact->chunk_count];
    const double units =
        (double)batch->progress * (double)wave->bundle_count / (double)exact_bundles(batch->count);
    const uint64_t before = (uint64_t)(units * ((double)block->begin / pairs)),
                   after = (uint64_t)(units * ((double)block->end / pairs));
    bsq_progress_add(wave->exact->ctx, after - before);
}

static int shade_hit(const struct wave *wave, struct exact_slot *slot, uint64_t ray)
{
    return bake_exact_shade(wave->exact, slot, wave->batch, ray);
}

static int run_block(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    struct wave *wave = arg;
    const struct block *block = &wave->blocks[index];
    struct exact_slot *slot = &wave->memory.slots[block->slot];
    if (wave->shading)
        return slot->loaded ? each_hit(wave, slot, block->begin, block->end, shade_hit) : 0;
    for (uint64_t i = block->begin; i < block->end; i++)
        trace_bundle(wave, slot, i);
    add_progress(wave, block);
    return 0;
}

static int list_blocks(struct wave *wave)
{
    wave->block_count = 0;
    for (uint32_t s = 0; s < wave->used; s++) {
        const uint64_t end = wave->buckets->starts[wave->memory.slots[s].number + 1];
        for (uint64_t at = wave->buckets->starts[wave->memory.slots[s].number]; at < end;
             at += BLOCK) {
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
    int status = 0;
    BSQ_TRY(bsq_parallel_for(ctx, wave->used, load_slot, wave));
    if (wave->shading && exact_needs_smooth(wave->exact))
        BSQ_TRY(bsq_parallel_for(ctx, wave->used, sum_slot, wave));
    BSQ_TRY(list_blocks(wave));
    BSQ_TRY(bsq_parallel_for(ctx, wave->block_count, run_block, wave));
    wave->used = 0;
done:
    return status;
}

static int run_waves(struct wave *wave, bool shading)
{
    const struct exact_buckets *buckets = wave->buckets;
    int status = 0;
    wave->shading = shading;
    wave->used = 0;
    for (uint32_t c = 0; status == 0 && c < wave->exact->chunk_count; c++) {
        if (buckets->starts[c] == buckets->starts[c + 1])
            continue;
        wave->memory.slots[wave->used++].number = c;
        if (wave->used == wave->memory.count)
            status = run_wave(wave);
    }
    return status == 0 && wave->used > 0 ? run_wave(wave) : status;
}

/* ---- a batch ---- */

static int allocate(struct wave *wave, struct exact_buckets *buckets)
{
    struct bsq_ctx *ctx = wave->exact->ctx;
    const uint32_t chunks = wave->exact->chunk_count;
    int status = 0;
    buckets->capacity = exact_bucket_entries(wave->exact, wave->batch->count);
    BSQ_TRY(bsq_alloc(ctx, "rays by chunk", buckets->capacity, sizeof *buckets->bundles,
                      &buckets->bundles));
    BSQ_TRY(bsq_alloc(ctx, "rays by chunk", buckets->capacity, sizeof *buckets->found,
                      &buckets->found));
    BSQ_TRY(bsq_alloc(ctx, "rays by chunk", (uint64_t)chunks + 1, sizeof *buckets->starts,
                      &buckets->starts));
    BSQ_TRY(bsq_alloc(ctx, "locks", EXACT_LOCKS, sizeof *wave->locks, &wave->locks));
    for (int i = 0; i < EXACT_LOCKS; i++)
        pthread_mutex_init(&wave->locks[i], NULL);
    /* Last, because they make do with little memory. */
    status = bake_exact_slots_create(wave->exact, exact_wave_slots(wave->exact),
                                     bsq_memory_share(ctx, "chunks of a wave", 2), &wave->memory);
done:
    return status;
}

static int clear_hits(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct bake_exact_batch *batch = arg;
    const uint64_t begin = index * CLEARED, left = batch->count - begin;
    for (uint64_t i = begin; i < begin + (left < CLEARED ? left : CLEARED); i++)
        batch->hits[i] = (struct bake_exact_hit){.triangle = BAKE_EXACT_NONE};
    return 0;
}

/* Traces the next part of the batch: as many bundles as fit the buckets. Adds their count to *done.
 */
static int trace_part(struct wave *wave, struct exact_buckets *buckets, uint64_t *done)
{
    int status = 0;
    wave->bundle_count = exact_bundles(wave->batch->count) - *done;
    BSQ_TRY(bake_exact_sort_rays(wave->exact, wave->batch, *done, &wave->bundle_count, buckets));
    BSQ_TRY(run_waves(wave, false));
    if (!wave->batch->distances_only)
        BSQ_TRY(run_waves(wave, true));
    *done += wave->bundle_count;
done:
    return status;
}

int bake_exact_trace(struct bake_exact *exact, const struct bake_exact_batch *batch)
{
    struct bsq_ctx *ctx = exact->ctx;
    struct exact_buckets buckets = {0};
    struct wave wave = {.exact = exact,
                        .batch = batch,
                        .buckets = &buckets,
                        .limits = {.t_min = batch->t_min,
                                   .t_max = batch->t_max,
                                   .gap = batch->gap,
                                   .facing_origin = batch->facing_origin,
                                   .from_reach = batch->from_reach,
                                   .two_sided = exact->options.two_sided}};
    int status = 0;
    if (batch->count == 0)
        return 0;
    BSQ_TRY(allocate(&wave, &buckets));
    BSQ_TRY(bsq_parallel_for(ctx, (batch->count - 1) / CLEARED + 1, clear_hits,
                             (void *)(uintptr_t)batch));
    for (uint64_t done = 0; done < exact_bundles(batch->count);)
        BSQ_TRY(trace_part(&wave, &buckets, &done));
done:
    for (int i = 0; wave.locks && i < EXACT_LOCKS; i++)
        pthread_mutex_destroy(&wave.locks[i]);
    bsq_free(ctx, wave.locks);
    bsq_free(ctx, wave.blocks);
    bsq_free(ctx, buckets.bundles);
    bsq_free(ctx, buckets.found);
    bsq_free(ctx, buckets.starts);
    bake_exact_slots_free(ctx, &wave.memory);
    return status;
}
