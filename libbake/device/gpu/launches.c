/* launches.c - the batches in which a patch is traced; a list of time spans that do not touch. */
#include "libbake/device/gpu/gpu.h"

#include <math.h>

/* ---- launch batches ---- */

uint32_t bake_batch_samples(const struct bk_params *params)
{
    const uint32_t rays = bk_ray_count(params);
    const uint32_t most = rays > 0 ? BAKE_BATCH_RAYS / rays : BAKE_BATCH_SAMPLES;
    return bk_upper(bk_lower(most, BAKE_BATCH_SAMPLES), params->samples);
}

struct bk_batch bake_first_batch(const struct bk_params *params, const struct bk_patch *patch)
{
    const uint32_t n = params->samples, most = bake_batch_samples(params);
    const uint32_t lines = bk_lower(n, bk_upper(bk_lower(BAKE_BATCH_THREAD, most) / n, 1));
    const uint32_t texels = bk_upper(most / (lines * n), 1);
    return (struct bk_batch){.end_column = bk_lower(patch->width, texels),
                             .end_row = bk_lower(patch->height, bk_upper(texels / patch->width, 1)),
                             .end_line = lines};
}

unsigned bake_patch_windows(const struct bk_params *params, uint32_t patch_texels, unsigned workers)
{
    const double rays =
        (double)patch_texels * params->samples * params->samples * (2.0 + bk_ray_count(params));
    return BAKE_WINDOWS_MAX * workers * rays <= BAKE_RAYS_STARTED ? BAKE_WINDOWS_MAX : 1;
}

bool bake_next_batch(const struct bk_params *params, const struct bk_patch *patch,
                     const struct bk_batch *first, struct bk_batch *batch)
{
    batch->first_line = batch->end_line < params->samples ? batch->end_line : 0;
    if (batch->first_line == 0)
        batch->first_column = batch->end_column < patch->width ? batch->end_column : 0;
    if (batch->first_line == 0 && batch->first_column == 0)
        batch->first_row = batch->end_row;
    batch->end_line = bk_lower(params->samples, batch->first_line + first->end_line);
    batch->end_column = bk_lower(patch->width, batch->first_column + first->end_column);
    batch->end_row = bk_lower(patch->height, batch->first_row + first->end_row);
    return batch->first_row < patch->height;
}

/* ---- times ---- */

void bake_time_spans_add(struct bake_time_spans *spans, const struct bake_span *span)
{
    struct bake_span all = *span;
    unsigned kept = 0, first = 0;
    if (!(span->end > span->start))
        return;
    for (unsigned i = 0; i < spans->count; i++) {
        const struct bake_span other = spans->spans[i];
        if (other.end < all.start || other.start > all.end)
            spans->spans[kept++] = other;
        else
            all = (struct bake_span){fmin(all.start, other.start), fmax(all.end, other.end)};
    }
    for (unsigned i = 0; i < kept && kept == BAKE_TIME_SPANS_MAX; i++)
        first = spans->spans[i].start < spans->spans[first].start ? i : first;
    if (kept == BAKE_TIME_SPANS_MAX) {
        spans->closed += spans->spans[first].end - spans->spans[first].start;
        spans->spans[first] = spans->spans[--kept];
    }
    spans->spans[kept] = all;
    spans->count = kept + 1;
}

double bake_time_spans_seconds(const struct bake_time_spans *spans)
{
    double sum = spans->closed;
    for (unsigned i = 0; i < spans->count; i++)
        sum += spans->spans[i].end - spans->spans[i].start;
    return sum;
}
