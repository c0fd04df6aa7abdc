/* exact_bin.c - which chunks does each ray cross?
 *
 * Neighbouring rays cross the same few chunks, so candidates are looked up for a group of rays at a
 * time. Rays are cut into segments that count, and then place, independently of each other: lists
 * are in the order of the rays for any number of threads. */
#include "libbake/exact/exact_scene.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/parallel.h"

enum { GROUP = 64, SEGMENTS_A_THREAD = 4 };

struct worker {
    uint32_t *candidates;
    struct exact_box4 *boxes; /* of the candidates */
};

struct binning {
    const struct bake_exact *exact;
    const struct bake_exact_batch *batch;
    uint64_t first, count; /* rays */
    uint64_t segment_rays;
    uint32_t segments;
    uint32_t *counts; /* segments x chunk_count; then where the next ray goes, from starts[] */
    struct worker *workers;
    struct exact_bins *bins;
    bool placing;
};

static uint32_t segments_of(const struct bake_exact *exact)
{
    return SEGMENTS_A_THREAD * bsq_threads(exact->ctx);
}

static uint64_t box4_count(const struct bake_exact *exact)
{
    return exact->chunk_count / 4 + 1;
}

uint64_t bake_exact_bin_bytes(const struct bake_exact *exact)
{
    uint64_t worker = exact->chunk_count * sizeof(uint32_t) +
                      box4_count(exact) * sizeof(struct exact_box4) + sizeof(struct worker);
    return segments_of(exact) * (uint64_t)exact->chunk_count * sizeof(uint32_t) +
           bsq_threads(exact->ctx) * worker;
}

/* ---- groups ---- */

/* Grows the box by a ray's segment. Overlap must not be missed by a rounding error. */
static void add_segment(struct exact_box *box, const struct bake_exact_ray *ray,
                        const struct bake_exact_batch *batch)
{
    for (int k = 0; k < 3; k++) {
        const double o = (double)ray->origin[k], d = (double)exact_component(ray->direction[k]);
        const double a = d * batch->t_min, b = d * batch->t_max;
        const double low = o + (a < b ? a : b), high = o + (a > b ? a : b);
        const double slack = (fabs(o) + fabs(a) + fabs(b)) * 1e-15;
        const struct exact_span span = exact_span_of(low - slack, high + slack);
        box->low[k] = span.begin < box->low[k] ? span.begin : box->low[k];
        box->high[k] = span.end > box->high[k] ? span.end : box->high[k];
    }
}

/* Chunks that rays [begin, end) may cross, with their boxes by four. */
static uint32_t find_candidates(const struct binning *b, uint64_t begin, uint64_t end,
                                struct worker *worker)
{
    struct exact_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    struct exact_line line;
    for (uint64_t r = begin; r < end; r++)
        if (exact_line_set(&line, b->batch->rays[r].origin, b->batch->rays[r].direction))
            add_segment(&box, &b->batch->rays[r], b->batch);
    uint32_t count = bake_exact_tree_overlapping(&b->exact->tree, &box, worker->candidates);
    for (uint32_t i = 0; i < count; i++) {
        const struct fmt_tris_chunk_info *chunk = &b->exact->chunks[worker->candidates[i]];
        for (int k = 0; k < 3; k++) {
            worker->boxes[i / 4].planes[0][k][i % 4] = chunk->bounds_min[k];
            worker->boxes[i / 4].planes[1][k][i % 4] = chunk->bounds_max[k];
        }
    }
    for (uint32_t i = count; i % 4 != 0; i++)
        for (int k = 0; k < 3; k++) {
            worker->boxes[i / 4].planes[0][k][i % 4] = INFINITY;
            worker->boxes[i / 4].planes[1][k][i % 4] = -INFINITY;
        }
    return count;
}

static void bin_ray(const struct binning *b, uint64_t ray, uint32_t candidates,
                    const struct worker *worker, uint32_t *counts)
{
    const struct bake_exact_batch *batch = b->batch;
    const struct exact_span span = exact_span_of(batch->t_min, batch->t_max);
    struct exact_line line;
    float distances[4];
    if (!exact_line_set(&line, batch->rays[ray].origin, batch->rays[ray].direction))
        return;
    for (uint32_t i = 0; i < candidates; i += 4) {
        unsigned bits = exact_line_crosses4(&line, &worker->boxes[i / 4], span, distances);
        for (; bits; bits &= bits - 1) {
            const uint32_t chunk = worker->candidates[i + (uint32_t)__builtin_ctz(bits)];
            const uint32_t place = counts[chunk]++;
            if (b->placing)
                b->bins->rays[b->bins->starts[chunk] + place] = (uint32_t)ray;
        }
    }
}

static int bin_segment(void *arg, uint64_t segment, unsigned number)
{
    const struct binning *b = arg;
    struct worker *worker = &b->workers[number];
    uint64_t begin = segment * b->segment_rays, end = begin + b->segment_rays;
    end = end < b->count ? end : b->count;
    uint32_t *counts = b->counts + segment * b->exact->chunk_count;
    int status = 0;
    for (; begin < end && (status = bsq_check(b->exact->ctx)) == 0; begin += GROUP) {
        uint64_t stop = begin + GROUP < end ? begin + GROUP : end;
        uint32_t candidates = find_candidates(b, b->first + begin, b->first + stop, worker);
        for (uint64_t r = begin; candidates > 0 && r < stop; r++)
            bin_ray(b, b->first + r, candidates, worker, counts);
    }
    return status;
}

static int run_segments(struct binning *b)
{
    uint64_t segments = (b->count + b->segment_rays - 1) / b->segment_rays;
    return bsq_parallel_for(b->exact->ctx, segments, bin_segment, b);
}

/* ---- counting sort ---- */

static int count_pairs(struct binning *b)
{
    const uint64_t groups = (b->count + GROUP - 1) / GROUP;
    b->segment_rays = (groups + b->segments - 1) / b->segments * GROUP;
    b->placing = false;
    memset(b->counts, 0, (uint64_t)b->segments * b->exact->chunk_count * sizeof *b->counts);
    return run_segments(b);
}

/* Turns counts into places within each chunk's list; returns the number of pairs. */
static uint64_t sum_counts(struct binning *b)
{
    const uint32_t chunks = b->exact->chunk_count;
    uint64_t sum = 0;
    for (uint32_t c = 0; c < chunks; c++) {
        uint32_t in_chunk = 0;
        b->bins->starts[c] = sum;
        for (uint32_t s = 0; s < b->segments; s++) {
            uint32_t *count = &b->counts[(uint64_t)s * chunks + c], here = *count;
            *count = in_chunk;
            in_chunk += here;
        }
        sum += in_chunk;
    }
    b->bins->starts[chunks] = sum;
    return sum;
}

static int sort_pairs(struct binning *b)
{
    for (;;) {
        int status = count_pairs(b);
        if (status < 0)
            return status;
        uint64_t pairs = sum_counts(b);
        if (pairs <= b->bins->capacity)
            break;
        if (b->count == 1)
            return bsq_fail(b->exact->ctx, BSQ_ENOMEM,
                            "a ray crosses %" PRIu64 " chunks, the budget has room for %" PRIu64,
                            pairs, b->bins->capacity);
        b->count = b->count / 2;
    }
    b->placing = true;
    return run_segments(b);
}

static int allocate(struct binning *b)
{
    const struct bake_exact *exact = b->exact;
    unsigned threads = bsq_threads(exact->ctx);
    int status = bsq_alloc(exact->ctx, "counts of rays", b->segments,
                           exact->chunk_count * sizeof *b->counts, &b->counts);
    if (status == 0)
        status = bsq_calloc(exact->ctx, "workers", threads, sizeof *b->workers, &b->workers);
    for (unsigned w = 0; status == 0 && w < threads; w++) {
        status = bsq_alloc(exact->ctx, "chunks near rays", exact->chunk_count, sizeof(uint32_t),
                           &b->workers[w].candidates);
        if (status == 0)
            status = bsq_alloc(exact->ctx, "chunks near rays", box4_count(exact),
                               sizeof *b->workers[w].boxes, &b->workers[w].boxes);
    }
    return status;
}

static void release(struct binning *b)
{
    struct bsq_ctx *ctx = b->exact->ctx;
    for (unsigned w = 0; b->workers && w < bsq_threads(ctx); w++) {
        bsq_free(ctx, b->workers[w].candidates);
        bsq_free(ctx, b->workers[w].boxes);
    }
    bsq_free(ctx, b->workers);
    bsq_free(ctx, b->counts);
}

int bake_exact_bin(const struct bake_exact *exact, const struct bake_exact_batch *batch,
                   uint64_t first, uint64_t *count, struct exact_bins *bins)
{
    struct binning b = {.exact = exact,
                        .batch = batch,
                        .first = first,
                        .count = *count,
                        .segments = segments_of(exact),
                        .bins = bins};
    int status = allocate(&b);
    if (status == 0)
        status = sort_pairs(&b);
    release(&b);
    *count = b.count;
    return status;
}
