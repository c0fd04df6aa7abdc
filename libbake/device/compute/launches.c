/* launches.c - the size of a launch follows the time that earlier ones took; a list of time spans
 * is merged whenever it is full. */
#include "libbake/device/compute/compute.h"

#include <string.h>

#include "base/sort_array.h"

enum { MAX_GROWTH = 4 };

/* What a thread takes for a sample of the cost 1: two rays from a hit, which a GPU that is not busy
 * was seen to trace in 300 us. */
#define THREAD_SECONDS 300e-6

static double launch_seconds(uint64_t texel_samples)
{
    const double wanted = 2 * THREAD_SECONDS * (double)texel_samples;
    if (texel_samples <= BAKE_BATCH_THREAD || wanted < BAKE_BATCH_SECONDS)
        return BAKE_BATCH_SECONDS;
    return wanted < BAKE_BATCH_SECONDS_MOST ? wanted : BAKE_BATCH_SECONDS_MOST;
}

uint32_t bake_batch_lines(uint32_t n)
{
    if (n <= BAKE_BATCH_THREAD / n)
        return n;
    return n < BAKE_BATCH_THREAD ? BAKE_BATCH_THREAD / n : 1;
}

uint32_t bake_batch_rows(struct bake_batch_sizer *sizer, uint64_t texel_samples, uint32_t width,
                         uint32_t height)
{
    const uint64_t row_samples = width * texel_samples, least = BAKE_BATCH_TEXELS * texel_samples;
    if (!sizer->samples)
        sizer->samples = least > BAKE_BATCH_FIRST ? least : BAKE_BATCH_FIRST;
    const uint64_t rows = row_samples ? sizer->samples / row_samples : height;
    if (rows > height)
        return height;
    return rows > 1 ? (uint32_t)rows : 1;
}

void bake_batch_sizer_learn(struct bake_batch_sizer *sizer, uint64_t texel_samples,
                            uint64_t samples, double seconds)
{
    /* Half of the range, so that sums of two cannot overflow. */
    const double most = (double)(UINT64_MAX / 2);
    double limit = (double)sizer->samples * MAX_GROWTH;
    double wanted =
        seconds > 0 ? (double)samples * (launch_seconds(texel_samples) / seconds) : limit;
    if (wanted > limit)
        wanted = limit;
    if (wanted > most)
        wanted = most;
    sizer->samples = wanted > BAKE_BATCH_LEAST ? (uint64_t)wanted : BAKE_BATCH_LEAST;
}

/* ---- times ---- */

static int by_start(const void *a, const void *b)
{
    double x = ((const struct bake_span *)a)->start, y = ((const struct bake_span *)b)->start;
    return (x > y) - (x < y);
}

/* Sorts the spans and merges those that touch. */
static void merge(struct bake_time_spans *spans)
{
    unsigned kept = 0;
    bsq_sort(spans->spans, spans->count, sizeof *spans->spans, by_start);
    for (unsigned i = 0; i < spans->count; i++) {
        struct bake_span span = spans->spans[i];
        if (kept && span.start <= spans->spans[kept - 1].end) {
            if (span.end > spans->spans[kept - 1].end)
                spans->spans[kept - 1].end = span.end;
        } else {
            spans->spans[kept++] = span;
        }
    }
    spans->count = kept;
}

void bake_time_spans_add(struct bake_time_spans *spans, const struct bake_span *span)
{
    if (!(span->end > span->start))
        return;
    if (spans->count == BAKE_TIME_SPANS_MAX) {
        merge(spans);
        if (spans->count > BAKE_TIME_SPANS_MAX / 2) {
            const unsigned early = spans->count - BAKE_TIME_SPANS_MAX / 2;
            for (unsigned i = 0; i < early; i++)
                spans->closed += spans->spans[i].end - spans->spans[i].start;
            spans->count -= early;
            memmove(spans->spans, spans->spans + early, spans->count * sizeof *spans->spans);
        }
    }
    spans->spans[spans->count++] = *span;
}

double bake_time_spans_seconds(struct bake_time_spans *spans)
{
    double sum = spans->closed;
    merge(spans);
    for (unsigned i = 0; i < spans->count; i++)
        sum += spans->spans[i].end - spans->spans[i].start;
    return sum;
}
