/* exact_buckets.c - sorts bundles of rays into buckets, one for each chunk that a ray crosses.
 *
 * Neighbouring bundles cross the same few chunks, so candidate chunks are looked up once for a
 * group of them. Workers list the pairs of bundles and chunks, each in runs of its own, so that
 * neighbours stay together. Then a counting sort by chunk fills the buckets. The order of a
 * bucket's bundles changes no hit. */
#include "libbake/exact/exact_scene.h"
#include "libbake/exact/exact_line.h"

#include <assert.h>
#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "base/parallel.h"

/* Bundles for which candidate chunks are looked up together; that a worker sorts at a time; pairs
 * of a run. */
enum { NEIGHBOURS = 4, SORTED_AT_ONCE = 64 * NEIGHBOURS, RUN = 512 };

struct pair {
    uint32_t chunk, bundle;
};

struct worker {
    uint32_t *candidates;     /* chunks */
    uint32_t *crossed;        /* candidates of a bundle */
    struct exact_box8 *boxes; /* of the candidates */
    uint64_t at, end;         /* of its run: the next pair */
};

struct sorting {
    const struct bake_exact *exact;
    const struct bake_ray_batch *batch;
    uint64_t first, count; /* bundles of the batch */
    struct worker *workers;
    uint32_t *numbers;        /* candidates and crossed ones of all workers */
    struct exact_box8 *boxes; /* likewise */
    struct pair *pairs;
    uint64_t space;            /* for pairs */
    atomic_uint_fast64_t used; /* by runs; above `space`, pairs are lost */
};

static uint64_t box8_count(const struct bake_exact *exact)
{
    return exact->chunk_count / 8 + 1;
}

/* Returns the size of candidates[], which crossed[] follows. */
static uint64_t number_count(const struct bake_exact *exact)
{
    return 2 * (uint64_t)exact->chunk_count + 7;
}

uint64_t bake_exact_buckets_scratch_bytes(const struct bake_exact *exact)
{
    return bsq_threads(exact->ctx) *
           (number_count(exact) * sizeof(uint32_t) + box8_count(exact) * sizeof(struct exact_box8) +
            RUN * sizeof(struct pair));
}

/* ---- pairs ---- */

/* Returns a box around the parts of rays [begin, end) where hits count, with a margin for rounding
 * errors. */
static struct exact_box box_of_rays(const struct bake_ray_batch *batch, uint64_t begin,
                                    uint64_t end)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    const double longest = fmax(fabs(batch->t_min), fabs(batch->t_max));
    struct exact_box box = EXACT_EMPTY_BOX;
    bk_line line;
    for (const struct bake_ray *ray = batch->rays + begin; ray < batch->rays + end; ray++)
        for (int k = bk_line_set(&line, ray->origin, ray->direction) ? 0 : 3; k < 3; k++) {
            const double o = (double)ray->origin[k], d = (double)bk_component(ray->direction[k]);
            const double a = o + d * batch->t_min, b = o + d * batch->t_max;
            const double nearer = a < b ? a : b, farther = a < b ? b : a;
            low[k] = nearer < low[k] ? nearer : low[k];
            high[k] = farther > high[k] ? farther : high[k];
        }
    for (int k = 0; k < 3 && low[k] <= high[k]; k++) {
        const double slack = (fmax(fabs(low[k]), fabs(high[k])) + 2 * longest) * 1e-15;
        const struct exact_span span = exact_span_of(low[k] - slack, high[k] + slack);
        box.low[k] = span.begin;
        box.high[k] = span.end;
    }
    return box;
}

/* Finds the chunks of the batch that rays [begin, end) may cross, and gathers their boxes by
 * eights. Returns their count. */
static uint32_t buckets_find_candidates(const struct sorting *s, uint64_t begin, uint64_t end,
                                        const struct worker *worker)
{
    const struct exact_box box = box_of_rays(s->batch, begin, end);
    const uint32_t first = s->batch->sweep ? s->batch->first_chunk : 0;
    const uint32_t stop = s->batch->sweep ? s->batch->end_chunk : s->exact->chunk_count;
    const uint32_t found = bake_exact_tree_overlapping(&s->exact->tree, &box, worker->candidates);
    uint32_t count = 0;
    for (uint32_t i = 0; i < found; i++) {
        const uint32_t number = worker->candidates[i];
        const struct fmt_tris_chunk_info *chunk = &s->exact->chunks[number];
        if (number < first || number >= stop)
            continue;
        exact_box8_put(worker->boxes, count, chunk->bounds_min, chunk->bounds_max);
        worker->candidates[count++] = number;
    }
    exact_box8_end(worker->boxes, count);
    return count;
}

/* Adds the pairs of a bundle and the candidates that it crosses. */
static void sort_bundle(struct sorting *s, uint64_t bundle, uint32_t candidates,
                        struct worker *worker)
{
    const struct bake_ray_batch *batch = s->batch;
    const uint64_t first = bundle * BAKE_RAY_BUNDLE, left = batch->count - first;
    const uint32_t crossed = BSQ_SIMD_PICK(s->exact->simd, bake_exact_crossed)(
        &batch->rays[first], (uint32_t)(left < BAKE_RAY_BUNDLE ? left : BAKE_RAY_BUNDLE),
        batch->t_min, batch->t_max, worker->boxes, candidates, worker->crossed);
    for (uint32_t i = 0; i < crossed; i++, worker->at++) {
        if (worker->at == worker->end) {
            worker->at = atomic_fetch_add(&s->used, RUN);
            worker->end = worker->at + RUN;
        }
        if (worker->end <= s->space)
            s->pairs[worker->at] =
                (struct pair){worker->candidates[worker->crossed[i]], (uint32_t)bundle};
    }
}

static int sort_bundles(void *arg, uint64_t begin, uint64_t end, unsigned number)
{
    struct sorting *s = arg;
    struct worker *worker = &s->workers[number];
    for (uint64_t stop; begin < end; begin = stop) {
        stop = end - begin < NEIGHBOURS ? end : begin + NEIGHBOURS;
        const uint64_t rays_end = (s->first + stop) * BAKE_RAY_BUNDLE;
        const uint32_t candidates = buckets_find_candidates(
            s, (s->first + begin) * BAKE_RAY_BUNDLE,
            rays_end < s->batch->count ? rays_end : s->batch->count, worker);
        for (uint64_t b = begin; candidates > 0 && b < stop; b++)
            sort_bundle(s, s->first + b, candidates, worker);
    }
    return 0;
}

/* ---- counting sort ---- */

/* Lists the pairs of as many bundles as fit the buckets, which have space for one: halves their
 * count until they do. What is left of runs gets the number after the last chunk. */
static int list_pairs(struct sorting *s, uint64_t capacity)
{
    struct bsq_ctx *ctx = s->exact->ctx;
    for (;; s->count /= 2) {
        uint64_t unused = 0;
        atomic_store(&s->used, 0);
        for (unsigned w = 0; w < bsq_threads(ctx); w++)
            s->workers[w].at = s->workers[w].end = 0;
        BSQ_PASS(bsq_parallel_ranges(ctx, s->count, SORTED_AT_ONCE, sort_bundles, s));
        for (unsigned w = 0; w < bsq_threads(ctx); w++)
            unused += s->workers[w].end - s->workers[w].at;
        if (atomic_load(&s->used) <= s->space && atomic_load(&s->used) - unused <= capacity)
            break;
        assert(s->count > 1);
    }
    for (unsigned w = 0; w < bsq_threads(ctx); w++)
        for (uint64_t i = s->workers[w].at; i < s->workers[w].end; i++)
            s->pairs[i].chunk = s->exact->chunk_count;
    return 0;
}

static void fill_buckets(const struct sorting *s, struct exact_buckets *buckets)
{
    const uint32_t chunks = s->exact->chunk_count;
    memset(buckets->starts, 0, (chunks + UINT64_C(1)) * sizeof *buckets->starts);
    for (uint64_t i = 0; i < s->used; i++)
        buckets->starts[s->pairs[i].chunk]++;
    buckets->starts[chunks] = 0;
    for (uint32_t c = 1; c <= chunks; c++)
        buckets->starts[c] += buckets->starts[c - 1];
    for (uint64_t i = s->used; i-- > 0;)
        if (s->pairs[i].chunk < chunks)
            buckets->bundles[--buckets->starts[s->pairs[i].chunk]] = s->pairs[i].bundle;
}

int bake_exact_sort_rays(const struct bake_exact *exact, const struct bake_ray_batch *batch,
                         uint64_t first, uint64_t *count, struct exact_buckets *buckets)
{
    struct bsq_ctx *ctx = exact->ctx;
    const unsigned threads = bsq_threads(ctx);
    struct sorting s = {.exact = exact,
                        .batch = batch,
                        .first = first,
                        .count = *count,
                        .space = buckets->capacity + (uint64_t)threads * RUN};
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "rays by chunk", s.space, &s.pairs));
    BSQ_TRY(BSQ_CALLOC(ctx, "chunks near rays", threads, &s.workers));
    BSQ_TRY(bsq_alloc(ctx, "chunks near rays", threads, number_count(exact) * sizeof *s.numbers,
                      &s.numbers));
    BSQ_TRY(
        bsq_alloc(ctx, "chunks near rays", threads, box8_count(exact) * sizeof *s.boxes, &s.boxes));
    for (unsigned w = 0; w < threads; w++)
        s.workers[w] =
            (struct worker){.candidates = s.numbers + w * number_count(exact),
                            .crossed = s.numbers + w * number_count(exact) + exact->chunk_count,
                            .boxes = s.boxes + w * box8_count(exact)};
    BSQ_TRY(list_pairs(&s, buckets->capacity));
    fill_buckets(&s, buckets);
done:
    BSQ_FREE(ctx, s.boxes, s.numbers, s.workers, s.pairs);
    *count = s.count;
    return status;
}
