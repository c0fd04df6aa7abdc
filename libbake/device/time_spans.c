/* time_spans.c - a list of spans, joined whenever it is full. */
#include "libbake/device/time_spans.h"

#include <stdlib.h>
#include <string.h>

static int by_start(const void *a, const void *b)
{
    double x = ((const struct bake_span *)a)->start, y = ((const struct bake_span *)b)->start;
    return (x > y) - (x < y);
}

/* Sorts, and joins the spans that touch. */
static void join(struct bake_busy *busy)
{
    unsigned kept = 0;

    qsort(busy->spans, busy->count, sizeof *busy->spans, by_start);
    for (unsigned i = 0; i < busy->count; i++) {
        struct bake_span span = busy->spans[i];
        if (kept && span.start <= busy->spans[kept - 1].end) {
            if (span.end > busy->spans[kept - 1].end)
                busy->spans[kept - 1].end = span.end;
        } else {
            busy->spans[kept++] = span;
        }
    }
    busy->count = kept;
}

void bake_busy_add(struct bake_busy *busy, double start, double end)
{
    if (!(end > start))
        return;
    if (busy->count == BAKE_BUSY_SPANS) {
        join(busy);
        if (busy->count > BAKE_BUSY_SPANS / 2) {
            const unsigned early = busy->count - BAKE_BUSY_SPANS / 2;
            for (unsigned i = 0; i < early; i++)
                busy->closed += busy->spans[i].end - busy->spans[i].start;
            busy->count -= early;
            memmove(busy->spans, busy->spans + early, busy->count * sizeof *busy->spans);
        }
    }
    busy->spans[busy->count++] = (struct bake_span){start, end};
}

double bake_busy_seconds(struct bake_busy *busy)
{
    double sum = busy->closed;

    join(busy);
    for (unsigned i = 0; i < busy->count; i++)
        sum += busy->spans[i].end - busy->spans[i].start;
    return sum;
}
