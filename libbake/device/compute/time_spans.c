/* time_spans.c - a list of spans, merged whenever it is full. */
#include "libbake/device/compute/time_spans.h"

#include <string.h>

#include "base/sort_array.h"

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

void bake_time_spans_add(struct bake_time_spans *spans, double start, double end)
{
    if (!(end > start))
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
    spans->spans[spans->count++] = (struct bake_span){start, end};
}

double bake_time_spans_seconds(struct bake_time_spans *spans)
{
    double sum = spans->closed;

    merge(spans);
    for (unsigned i = 0; i < spans->count; i++)
        sum += spans->spans[i].end - spans->spans[i].start;
    return sum;
}
