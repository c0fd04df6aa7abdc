/* launch_batches.c - the size of kernel calls follows what was measured. */
#include "libbake/device/launch_batches.h"

enum { MOST_GROWTH = 4 };

static uint64_t current(const struct bake_slices *slices)
{
    return slices->samples ? slices->samples : BAKE_SLICE_FIRST;
}

uint32_t bake_slice_lines(uint32_t n)
{
    if (n <= BAKE_SLICE_THREAD / n)
        return n;
    return n < BAKE_SLICE_THREAD ? BAKE_SLICE_THREAD / n : 1;
}

uint32_t bake_slice_rows(const struct bake_slices *slices, uint64_t row_samples, uint32_t height)
{
    uint64_t rows = row_samples ? current(slices) / row_samples : height;

    if (rows > height)
        return height;
    return rows > 1 ? (uint32_t)rows : 1;
}

void bake_slices_learn(struct bake_slices *slices, uint64_t samples, double seconds)
{
    /* Half of the range is left, so that sums and products of it cannot overflow. */
    const double most = (double)(UINT64_MAX / 2);
    double limit = (double)current(slices) * MOST_GROWTH;
    double wanted = seconds > 0 ? (double)samples * (BAKE_SLICE_SECONDS / seconds) : limit;

    if (wanted > limit)
        wanted = limit;
    if (wanted > most)
        wanted = most;
    slices->samples = wanted > BAKE_SLICE_LEAST ? (uint64_t)wanted : BAKE_SLICE_LEAST;
}
