/* exact_buckets.c - sorts bundles of rays into buckets, one for each chunk that a ray crosses.
 *
 * Neighbouring bundles cross the same few chunks, so candidate chunks are looked up once for a
 * group of them. This is a counting sort over segments of the batch: each segment counts its pairs
 * of bundle and chunk, and later writes them to places of its own. So the bundles of a bucket are
 * in order for any number of threads. */
#include "libbake/exact/exact_scene.h"
#include "libbake/exact/exact_line.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "base/parallel.h"

enum { SEGMENTS_A_THREAD = 4 };

/* Buffers of a thread. */
struct worker {
    uint32_t *candidates;     /* chunks */
    uint32_t *crossed;        /* candidates of a bundle */
    struct exact_box8 *boxes; /* of the candidates */
};

struct sorting {
    const struct bake_exact *exact;
    const struct bake_ray_batch *batch;
    uint64_t first, count; /* bundles of the batch */
    uint64_t segment_bundles;
    uint32_t segments;
    /* segments x chunk_count: pairs of each segment and chunk; in the second pass the place of the
     * segment's next bundle in the bucket. */
    uint32_t *counts;
    uint32_t *numbers;        /* candidates and crossed ones of all workers */
    struct exact_box8 *boxes; /* likewise */
    struct exact_buckets *buckets;
    bool writing; /* the second pass */
};

static uint32_t segments_of(const struct bake_exact *exact)
{
    return SEGMENTS_A_THREAD * bsq_threads(exact->ctx);
}

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
    uint64_t worker =
        number_count(exact) * sizeof(uint32_t) + box8_count(exact) * sizeof(struct exact_box8);
    return segments_of(exact) * (uint64_t)exact->chunk_count * sizeof(uint32_t) +
           bsq_threads(exact->ctx) * worker;
}

/* ---- groups ---- */

/* Returns a box around the parts of rays [begin, end) where hits count, with a margin for rounding
 * errors. */
static struct exact_box box_of_rays(const struct bake_ray_batch *batch, uint64_t begin,
                                    uint64_t end)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    const double longest = fmax(fabs(batch->t_min), fabs(batch->t_max));
    struct exact_box box = EXACT_EMPTY_BOX;
    struct exact_line line;
    for (const struct bake_ray *ray = batch->rays + begin; ray < batch->rays + end; ray++)
        for (int k = exact_line_set(&line, ray->origin, ray->direction) ? 0 : 3; k < 3; k++) {
            const double o = (double)ray->origin[k], d = (double)exact_component(ray->direction[k]);
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
    struct exact_box *box =
        &s->buckets->around[(begin / BAKE_RAY_BUNDLE - s->first) / EXACT_SORTED];
    if (!s->writing)
        *box = box_of_rays(s->batch, begin, end);
    const uint32_t first = s->batch->sweep ? s->batch->first_chunk : 0;
    const uint32_t stop = exact_end_chunk(s->exact, s->batch);
    const uint32_t found = bake_exact_tree_overlapping(&s->exact->tree, box, worker->candidates);
    uint32_t count = 0;
    for (uint32_t i = 0; i < found; i++)
        if (worker->candidates[i] >= first && worker->candidates[i] < stop)
            worker->candidates[count++] = worker->candidates[i];
    for (uint32_t i = 0; i < count; i++) {
        const struct fmt_tris_chunk_info *chunk = &s->exact->chunks[worker->candidates[i]];
        for (int k = 0; k < 3; k++) {
            worker->boxes[i / 8].planes[0][k][i % 8] = chunk->bounds_min[k];
            worker->boxes[i / 8].planes[1][k][i % 8] = chunk->bounds_max[k];
        }
    }
    for (uint32_t i = count; i % 8 != 0; i++)
        for (int k = 0; k < 3; k++) {
            worker->boxes[i / 8].planes[0][k][i % 8] = INFINITY;
            worker->boxes[i / 8].planes[1][k][i % 8] = -INFINITY;
        }
    return count;
}

/* Returns the number after the last ray of bundle `end` - 1. */
static uint64_t rays_end(const struct sorting *s, uint64_t end)
{
    const uint64_t rays = end * BAKE_RAY_BUNDLE;
    return rays < s->batch->count ? rays : s->batch->count;
}

/* Finds the candidates that a bundle crosses. If they are few, the first pass notes them in
 * found[], which is not used before tracing, for the second. Returns their number. */
static uint32_t find_crossed(const struct sorting *s, uint64_t bundle, uint32_t candidates,
                             const struct worker *worker)
{
    const struct bake_ray_batch *batch = s->batch;
    const uint64_t first = bundle * BAKE_RAY_BUNDLE;
    const bool noted = candidates <= 8 * sizeof *s->buckets->found;
    uint16_t *note = &s->buckets->found[bundle - s->first];
    uint32_t crossed = 0;
    if (s->writing && noted) {
        for (unsigned bits = *note; bits; bits &= bits - 1)
            worker->crossed[crossed++] = (uint32_t)__builtin_ctz(bits);
        return crossed;
    }
    crossed = BSQ_SIMD_PICK(s->exact->simd, bake_exact_crossed)(
        &batch->rays[first], (uint32_t)(rays_end(s, bundle + 1) - first), batch->t_min,
        batch->t_max, worker->boxes, candidates, worker->crossed);
    if (noted)
        *note = 0;
    for (uint32_t i = 0; i < crossed && noted; i++)
        *note |= (uint16_t)(1u << worker->crossed[i]);
    return crossed;
}

/* Counts the chunks that a bundle crosses, and in the second pass adds it to their buckets. */
static void sort_bundle(const struct sorting *s, uint64_t bundle, uint32_t candidates,
                        const struct worker *worker, uint32_t *counts)
{
    const uint32_t crossed = find_crossed(s, bundle, candidates, worker);
    for (uint32_t i = 0; i < crossed; i++) {
        const uint32_t chunk = worker->candidates[worker->crossed[i]];
        const uint32_t place = counts[chunk]++;
        if (s->writing)
            s->buckets->bundles[s->buckets->starts[chunk] + place] = (uint32_t)bundle;
    }
}

static int sort_segment(void *arg, uint64_t segment, unsigned number)
{
    const struct sorting *s = arg;
    uint32_t *numbers = s->numbers + number * number_count(s->exact);
    const struct worker worker = {numbers, numbers + s->exact->chunk_count,
                                  s->boxes + number * box8_count(s->exact)};
    uint64_t begin = segment * s->segment_bundles, end = begin + s->segment_bundles;
    end = end < s->count ? end : s->count;
    uint32_t *counts = s->counts + segment * s->exact->chunk_count;
    int status = 0;
    for (; begin < end && (status = bsq_check(s->exact->ctx)) == 0; begin += EXACT_SORTED) {
        uint64_t stop = begin + EXACT_SORTED < end ? begin + EXACT_SORTED : end;
        uint32_t candidates = buckets_find_candidates(s, (s->first + begin) * BAKE_RAY_BUNDLE,
                                                      rays_end(s, s->first + stop), &worker);
        for (uint64_t b = begin; candidates > 0 && b < stop; b++)
            sort_bundle(s, s->first + b, candidates, &worker, counts);
    }
    return status;
}

static int run_segments(struct sorting *s)
{
    uint64_t segments = (s->count + s->segment_bundles - 1) / s->segment_bundles;
    return bsq_parallel_for(s->exact->ctx, segments, sort_segment, s);
}

/* ---- counting sort ---- */

static int count_pairs(struct sorting *s)
{
    const uint64_t groups = (s->count + EXACT_SORTED - 1) / EXACT_SORTED;
    s->segment_bundles = (groups + s->segments - 1) / s->segments * EXACT_SORTED;
    s->writing = false;
    memset(s->counts, 0, (uint64_t)s->segments * s->exact->chunk_count * sizeof *s->counts);
    return run_segments(s);
}

/* Turns counts into places within the buckets, and sets the buckets' starts. Returns the number of
 * pairs. */
static uint64_t sum_counts(struct sorting *s)
{
    const uint32_t chunks = s->exact->chunk_count;
    uint64_t sum = 0;
    for (uint32_t c = 0; c < chunks; c++) {
        uint32_t in_chunk = 0;
        s->buckets->starts[c] = sum;
        for (uint32_t segment = 0; segment < s->segments; segment++) {
            uint32_t *count = &s->counts[(uint64_t)segment * chunks + c], here = *count;
            *count = in_chunk;
            in_chunk += here;
        }
        sum += in_chunk;
    }
    s->buckets->starts[chunks] = sum;
    return sum;
}

/* Sorts as many bundles as fit the buckets, which have space for one: halves their count until they
 * do. */
static int sort_rays(struct sorting *s)
{
    for (;;) {
        BSQ_PASS(count_pairs(s));
        uint64_t pairs = sum_counts(s);
        if (pairs <= s->buckets->capacity)
            break;
        assert(s->count > 1);
        s->count = s->count / 2;
    }
    s->writing = true;
    return run_segments(s);
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
                        .segments = segments_of(exact),
                        .buckets = buckets};
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "counts of rays", s.segments, exact->chunk_count * sizeof *s.counts,
                      &s.counts));
    BSQ_TRY(bsq_alloc(ctx, "chunks near rays", threads, number_count(exact) * sizeof *s.numbers,
                      &s.numbers));
    BSQ_TRY(
        bsq_alloc(ctx, "chunks near rays", threads, box8_count(exact) * sizeof *s.boxes, &s.boxes));
    BSQ_TRY(sort_rays(&s));
done:
    BSQ_FREE(ctx, s.boxes, s.numbers, s.counts);
    *count = s.count;
    return status;
}
