/* launch_batches.h - how much of a tile one kernel call traces.
 *
 * A device does nothing else during a call, and desktop drivers end calls that take seconds. The
 * rule: a call is to take BAKE_SLICE_SECONDS. What a ray costs is not known beforehand (it depends
 * on the device, the lengths of rays, the grid), so each worker begins with BAKE_SLICE_FIRST
 * samples, measures each tile, and grows at most fourfold from one to the next; a tile whose rays
 * are four times as dear as those of the one before still takes calls of no more than 0.2 s. A row
 * of a tile, and BAKE_SLICE_LEAST samples, are the least: smaller calls would measure what a call
 * costs.
 *
 * The samples of a texel, up to 65536, are traced one after another by one thread of the device,
 * which takes some 30 us each however fast the device is. So where there are more than
 * BAKE_SLICE_THREAD of them, a call takes only some lines of each texel's samples, of many texels
 * at a time, and later calls go on. */
#ifndef BAKE_DEVICE_LAUNCH_BATCHES_H
#define BAKE_DEVICE_LAUNCH_BATCHES_H

#include <stdint.h>

#define BAKE_SLICE_SECONDS 0.05

enum { BAKE_SLICE_FIRST = 1 << 17, BAKE_SLICE_LEAST = 1 << 14, BAKE_SLICE_THREAD = 1 << 8 };

/* Zero at first; one for each worker. */
struct bake_slices {
    uint64_t samples; /* in the next call; 0: BAKE_SLICE_FIRST */
};

/* What a call traces: lines first_line to end_line - 1 of the samples of each texel in rows
 * first_row to end_row - 1. */
struct bake_slice {
    uint32_t first_row, end_row, first_line, end_line;
};

/* Lines of a texel in one call, of n lines of n samples: 1 to n. */
uint32_t bake_slice_lines(uint32_t n);

/* Rows in one call, of a tile with `height` rows of row_samples samples: 1 to height. */
uint32_t bake_slice_rows(const struct bake_slices *slices, uint64_t row_samples, uint32_t height);

/* `samples` took `seconds` on the device. */
void bake_slices_learn(struct bake_slices *slices, uint64_t samples, double seconds);

#endif
