/* parallel.h - loops and ordered pipelines on a context's threads.
 *
 * Results never depend on the number of threads: a loop's iterations must be independent, and a
 * pipeline hands out work and collects results in sequence, one at a time. */
#ifndef BSQ_PARALLEL_H
#define BSQ_PARALLEL_H

#include <pthread.h>

#include "base/context.h"

/* Runs fn(arg, i, worker) for every i in [0, count), dynamically scheduled. `worker` is in [0,
 * bsq_threads()), and no two concurrent calls share it. After the first negative result no new
 * iteration starts, and that result is returned; an interrupted context gives BSQ_EINTR. Must not
 * be nested. */
int bsq_parallel_for(struct bsq_ctx *ctx, uint64_t count,
                     int (*fn)(void *arg, uint64_t index, unsigned worker), void *arg);

/* Does the same on at most `workers` threads. */
int bsq_parallel_on(struct bsq_ctx *ctx, unsigned workers, uint64_t count,
                    int (*fn)(void *arg, uint64_t index, unsigned worker), void *arg);

/* Returns how many workers or slots the memory budget allows. most: the largest result; bytes: what
 * each of them needs. The result is at least 1, even if one does not fit. */
unsigned bsq_workers_within(const struct bsq_ctx *ctx, unsigned most, uint64_t bytes);

/* Does what bsq_parallel_for() does, with fn(arg, begin, end, worker) for ranges of at most `step`
 * that are [0, count) together. */
int bsq_parallel_ranges(struct bsq_ctx *ctx, uint64_t count, uint64_t step,
                        int (*fn)(void *arg, uint64_t begin, uint64_t end, unsigned worker),
                        void *arg);

/* A pipeline over `slot_count` reused slots of `slot_size` bytes at `slots`.
 * produce: serial, in sequence; returns 1 with the slot filled, 0 at the end, < 0 on failure.
 * work:    concurrent, any order; `worker` as above.
 * emit:    serial, in sequence; may run concurrently with produce and work of other slots.
 * follow:  concurrent, any order; after emit of the same and all earlier sequences.
 * finish:  serial, in sequence; may run concurrently with all others.
 * produce, emit and finish never run concurrently with themselves; sequence starts at 0. produce of
 * sequence s runs only after the last step of s - slot_count has returned. work may be NULL, and
 * follow and finish together. */
struct bsq_pipeline {
    int (*produce)(void *arg, void *slot, uint64_t sequence);
    int (*work)(void *arg, void *slot, uint64_t sequence, unsigned worker);
    int (*emit)(void *arg, void *slot, uint64_t sequence);
    int (*follow)(void *arg, void *slot, uint64_t sequence, unsigned worker);
    int (*finish)(void *arg, void *slot, uint64_t sequence);
    void *arg;
    void *slots;
    size_t slot_size;
    unsigned slot_count; /* at least 1; 2 * threads is a good choice */
};

/* Runs the pipeline to its end. Returns 0 or the first failure (in time). Must not be nested. */
int bsq_pipeline_run(struct bsq_ctx *ctx, const struct bsq_pipeline *pipeline);

#endif
