/* launch_batches.c - the size of a launch follows the time that earlier ones took. */
#include "libbake/device/compute/launch_batches.h"

enum { MAX_GROWTH = 4 };

static uint64_t current(const struct bake_batch_sizer *sizer)
{
    return sizer->samples ? sizer->samples : BAKE_BATCH_FIRST;
}

uint32_t bake_batch_lines(uint32_t n)
{
    if (n <= BAKE_BATCH_THREAD / n)
        return n;
    return n < BAKE_BATCH_THREAD ? BAKE_BATCH_THREAD / n : 1;
}

uint32_t bake_batch_rows(const struct bake_batch_sizer *sizer, uint64_t row_samples,
                         uint32_t height)
{
    uint64_t rows = row_samples ? current(sizer) / row_samples : height;

    if (rows > height)
        return height;
    return rows > 1 ? (uint32_t)rows : 1;
}

void bake_batch_sizer_learn(struct bake_batch_sizer *sizer, uint64_t samples, double seconds)
{
    /* Half of the range, so that sums of two cannot overflow. */
    const double most = (double)(UINT64_MAX / 2);
    double limit = (double)current(sizer) * MAX_GROWTH;
    double wanted = seconds > 0 ? (double)samples * (BAKE_BATCH_SECONDS / seconds) : limit;

    if (wanted > limit)
        wanted = limit;
    if (wanted > most)
        wanted = most;
    sizer->samples = wanted > BAKE_BATCH_LEAST ? (uint64_t)wanted : BAKE_BATCH_LEAST;
}
