/* launches.h - how much of a tile one kernel launch traces, and how long launches took.
 *
 * A device does nothing else during a launch, and desktop drivers abort launches that take seconds.
 * So a launch should take BAKE_BATCH_SECONDS. The cost of a ray depends on the device, the rays'
 * lengths and the grid. Each worker therefore starts with BAKE_BATCH_FIRST samples, measures each
 * tile, and grows at most fourfold from one tile to the next. A tile whose rays cost four times as
 * much as those of the tile before still has launches of at most 0.2 s. A batch has at least one
 * row of the tile and BAKE_BATCH_LEAST samples: less would measure the overhead of a launch.
 *
 * Samples whose hits send rays count as several.
 *
 * One thread of the device traces the samples of a texel one after another. Each takes about 30 us
 * on any device, and a texel has up to 4096. If a texel has more than BAKE_BATCH_THREAD samples, a
 * launch takes some lines of the samples of many texels, and later launches continue. */
#ifndef BAKE_DEVICE_COMPUTE_LAUNCHES_H
#define BAKE_DEVICE_COMPUTE_LAUNCHES_H

#include <stdint.h>

#define BAKE_BATCH_SECONDS 0.05

enum { BAKE_BATCH_FIRST = 1 << 17, BAKE_BATCH_LEAST = 1 << 14, BAKE_BATCH_THREAD = 1 << 8 };

/* A worker's estimate; zero at first. */
struct bake_batch_sizer {
    uint64_t samples; /* in the next launch; 0: BAKE_BATCH_FIRST */
};

/* What a launch traces: lines first_line to end_line - 1 of the samples of each texel in rows
 * first_row to end_row - 1. */
struct bake_launch_batch {
    uint32_t first_row, end_row, first_line, end_line;
};

/* Returns how many of a texel's n lines of n samples one launch traces: 1 to n. */
uint32_t bake_batch_lines(uint32_t n);

/* Returns how many rows one launch traces of a tile with `height` rows of row_samples samples: 1 to
 * height. */
uint32_t bake_batch_rows(const struct bake_batch_sizer *sizer, uint64_t row_samples,
                         uint32_t height);

/* Learns that `samples` took `seconds` on the device. */
void bake_batch_sizer_learn(struct bake_batch_sizer *sizer, uint64_t samples, double seconds);

/* ---- times ---- */

enum { BAKE_TIME_SPANS_MAX = 256 };

struct bake_span {
    double start, end; /* seconds on any one clock */
};

/* The union of time spans: kernels of several streams overlap, so their sum would exceed the time
 * that passed. Zero at first. Not thread-safe. */
struct bake_time_spans {
    double closed; /* length of the spans that have left the list */
    unsigned count;
    struct bake_span spans[BAKE_TIME_SPANS_MAX];
};

/* Adds a span. Spans may come in any order, as long as none comes after more than
 * BAKE_TIME_SPANS_MAX / 2 later ones that do not touch each other. */
void bake_time_spans_add(struct bake_time_spans *spans, const struct bake_span *span);

/* Returns the length of the union of all spans, in seconds. */
double bake_time_spans_seconds(struct bake_time_spans *spans);

#endif
