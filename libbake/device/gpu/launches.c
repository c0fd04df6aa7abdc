/* launches.c - the batches in which a patch is traced; a list of time spans is merged whenever it
 * is full. */
#include "libbake/device/gpu/gpu.h"

#include <string.h>

#include "base/sort_array.h"

/* ---- launch batches ---- */

static uint32_t min_u32(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static uint32_t max_u32(uint32_t a, uint32_t b)
{
    return a > b ? a : b;
}

uint32_t bake_batch_samples(const struct bk_params *params)
{
    const uint32_t rays = bake_ray_count(params);
    const uint32_t most = rays > 0 ? BAKE_BATCH_RAYS / rays : BAKE_BATCH_SAMPLES;
    return max_u32(min_u32(most, BAKE_BATCH_SAMPLES), params->samples);
}

struct bk_batch bake_first_batch(const struct bk_params *params, const struct bk_patch *patch)
{
    const uint32_t n = params->samples, most = bake_batch_samples(params);
    const uint32_t lines = min_u32(n, max_u32(min_u32(BAKE_BATCH_THREAD, most) / n, 1));
    const uint32_t texels = max_u32(most / (lines * n), 1);
    return (struct bk_batch){.end_column = min_u32(patch->width, texels),
                             .end_row = min_u32(patch->height, max_u32(texels / patch->width, 1)),
                             .end_line = lines};
}

bool bake_next_batch(const struct bk_params *params, const struct bk_patch *patch,
                     const struct bk_batch *first, struct bk_batch *batch)
{
    batch->first_line = batch->end_line < params->samples ? batch->end_line : 0;
    if (batch->first_line == 0)
        batch->first_column = batch->end_column < patch->width ? batch->end_column : 0;
    if (batch->first_line == 0 && batch->first_column == 0)
        batch->first_row = batch->end_row;
    batch->end_line = min_u32(params->samples, batch->first_line + first->end_line);
    batch->end_column = min_u32(patch->width, batch->first_column + first->end_column);
    batch->end_row = min_u32(patch->height, batch->first_row + first->end_row);
    return batch->first_row < patch->height;
}

/* ---- times ---- */

static int by_start(const void *a, const void *b)
{
    double x = ((const struct bake_span *)a)->start, y = ((const struct bake_span *)b)->start;
    return (x > y) - (x < y);
}

/* Sorts the spans and merges those that touch. */
static void launches_merge(struct bake_time_spans *spans)
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
        launches_merge(spans);
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
    launches_merge(spans);
    for (unsigned i = 0; i < spans->count; i++)
        sum += spans->spans[i].end - spans->spans[i].start;
    return sum;
}
