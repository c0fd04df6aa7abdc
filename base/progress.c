/* progress.c - counts finished work and reports it now and then.
 *
 * bsq_progress_add() is one atomic addition and a look at the coarse clock. The thread that finds
 * the next report due makes it, unless another thread is doing so. */
#include <time.h>

#include "base/context_internal.h"

enum { REPORT_INTERVAL_MS = 100 };

static uint64_t coarse_clock_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC_COARSE, &now);
    return (uint64_t)now.tv_sec * 1000 + (uint64_t)now.tv_nsec / 1000000;
}

/* Reports progress; the caller holds callback_lock. */
static void report(struct bsq_ctx *ctx, bool finished)
{
    struct bsq_stage *stage = &ctx->stage;
    struct bsq_progress progress = {
        .stage = stage->name,
        .unit = stage->unit,
        .done = atomic_load(&stage->done),
        .total = stage->total,
        .finished = finished,
    };
    atomic_store(&stage->next_report_ms, coarse_clock_ms() + REPORT_INTERVAL_MS);
    ctx->options.on_progress(ctx->options.user, &progress);
}

void bsq_progress_begin(struct bsq_ctx *ctx, const char *stage, const char *unit, uint64_t total)
{
    pthread_mutex_lock(&ctx->callback_lock);
    ctx->stage.name = stage;
    ctx->stage.unit = unit;
    ctx->stage.total = total;
    atomic_store(&ctx->stage.done, 0);
    pthread_mutex_unlock(&ctx->callback_lock);
    bsq_progress_add(ctx, 0);
}

void bsq_progress_add(struct bsq_ctx *ctx, uint64_t count)
{
    struct bsq_stage *stage = &ctx->stage;
    atomic_fetch_add_explicit(&stage->done, count, memory_order_relaxed);
    if (!ctx->options.on_progress)
        return;
    if (coarse_clock_ms() < atomic_load_explicit(&stage->next_report_ms, memory_order_relaxed))
        return;
    if (pthread_mutex_trylock(&ctx->callback_lock) != 0)
        return;
    bool due = coarse_clock_ms() >= atomic_load(&stage->next_report_ms);
    if (stage->name && due)
        report(ctx, false);
    pthread_mutex_unlock(&ctx->callback_lock);
}

void bsq_progress_add_share(struct bsq_ctx *ctx, uint64_t units, double begin, double end)
{
    bsq_progress_add(ctx, (uint64_t)((double)units * end) - (uint64_t)((double)units * begin));
}

void bsq_progress_end(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->callback_lock);
    if (ctx->stage.name && ctx->options.on_progress)
        report(ctx, true);
    ctx->stage.name = NULL;
    pthread_mutex_unlock(&ctx->callback_lock);
}
