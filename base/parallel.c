/* parallel.c - the thread pool, parallel loops and ordered pipelines.
 *
 * The pool does one thing: it runs a function once on every worker and waits for all. Loops and
 * pipelines are built on it; the calling thread is worker 0. A call creates the threads that it has
 * work for and that earlier calls did not create; they sleep between calls. If the system refuses
 * threads, fewer threads do all the work. */
#include <assert.h>
#include <signal.h>
#include <stdlib.h>
#include <time.h>

#include "base/context_internal.h"
#include "base/parallel.h"

/* ---- the pool ---- */

typedef void pool_fn(void *arg, unsigned worker);

struct bsq_pool {
    pthread_mutex_t lock;
    pthread_cond_t wake; /* a job was posted, or quit was set */
    pthread_cond_t idle; /* the last worker of a job has returned */
    pool_fn *fn;
    void *arg;
    uint64_t round;           /* number of the job posted last */
    unsigned wanted;          /* threads that take part in it, without the caller */
    unsigned running;         /* of those, how many have not returned */
    bool quit, busy, refused; /* refused: the system creates no more threads */
    unsigned thread_count;
    struct pool_thread {
        pthread_t handle;
        struct bsq_pool *pool;
        unsigned number;
        uint64_t before; /* the last job before the thread was created */
    } threads[];
};

static void *pool_thread_main(void *arg)
{
    struct pool_thread *self = arg;
    struct bsq_pool *pool = self->pool;
    uint64_t before = self->before;
    pthread_mutex_lock(&pool->lock);
    for (;;) {
        while (!pool->quit && pool->round == before)
            pthread_cond_wait(&pool->wake, &pool->lock);
        if (pool->quit)
            break;
        before = pool->round;
        if (self->number >= pool->wanted)
            continue;
        pool_fn *fn = pool->fn;
        void *fn_arg = pool->arg;
        pthread_mutex_unlock(&pool->lock);
        fn(fn_arg, self->number + 1);
        pthread_mutex_lock(&pool->lock);
        if (--pool->running == 0)
            pthread_cond_signal(&pool->idle);
    }
    pthread_mutex_unlock(&pool->lock);
    return NULL;
}

/* Starts a thread in which signals are blocked, so that the program's own threads get them. Those
 * that its own instructions raise stay open: blocked, they would end the process whatever handles
 * them. */
static bool start_thread(pthread_t *out, void *(*fn)(void *arg), void *arg)
{
    static const int own[] = {SIGBUS, SIGSEGV, SIGFPE, SIGILL, SIGTRAP};
    sigset_t blocked, before;
    sigfillset(&blocked);
    for (size_t i = 0; i < sizeof own / sizeof *own; i++)
        sigdelset(&blocked, own[i]);
    pthread_sigmask(SIG_SETMASK, &blocked, &before);
    const bool started = pthread_create(out, NULL, fn, arg) == 0;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return started;
}

static void start_threads(struct bsq_pool *pool, unsigned count)
{
    while (pool->thread_count < count && !pool->refused) {
        struct pool_thread *thread = &pool->threads[pool->thread_count];
        *thread =
            (struct pool_thread){.pool = pool, .number = pool->thread_count, .before = pool->round};
        pool->refused = !start_thread(&thread->handle, pool_thread_main, thread);
        pool->thread_count += !pool->refused;
    }
}

static void destroy_pool(struct bsq_ctx *ctx, void *object)
{
    struct bsq_pool *pool = object;
    (void)ctx;
    pthread_mutex_lock(&pool->lock);
    assert(!pool->busy);
    pool->quit = true;
    pthread_cond_broadcast(&pool->wake);
    pthread_mutex_unlock(&pool->lock);
    for (unsigned i = 0; i < pool->thread_count; i++)
        pthread_join(pool->threads[i].handle, NULL);
    pthread_cond_destroy(&pool->idle);
    pthread_cond_destroy(&pool->wake);
    pthread_mutex_destroy(&pool->lock);
    free(pool);
}

/* Returns the context's pool; NULL if work is to run on the calling thread alone. */
static struct bsq_pool *get_pool(struct bsq_ctx *ctx)
{
    const unsigned extra = bsq_threads(ctx) - 1;
    const bool is_new = !ctx->members[BSQ_POOL].object;
    if (extra == 0)
        return NULL;
    struct bsq_pool *pool =
        bsq_member_of(ctx, BSQ_POOL, sizeof *pool + extra * sizeof pool->threads[0], destroy_pool);
    if (pool && is_new) {
        pthread_mutex_init(&pool->lock, NULL);
        pthread_cond_init(&pool->wake, NULL);
        pthread_cond_init(&pool->idle, NULL);
    }
    return pool;
}

/* Runs fn on up to `workers` threads, the calling one as worker 0, and waits for all. */
static void pool_run(struct bsq_ctx *ctx, unsigned workers, pool_fn *fn, void *arg)
{
    struct bsq_pool *pool = workers > 1 ? get_pool(ctx) : NULL;
    if (!pool) {
        fn(arg, 0);
        return;
    }
    start_threads(pool, workers - 1);
    pthread_mutex_lock(&pool->lock);
    assert(!pool->busy && "parallel calls must not be nested");
    pool->busy = true;
    pool->fn = fn;
    pool->arg = arg;
    pool->wanted = workers - 1 < pool->thread_count ? workers - 1 : pool->thread_count;
    pool->running = pool->wanted;
    pool->round++;
    pthread_cond_broadcast(&pool->wake);
    pthread_mutex_unlock(&pool->lock);

    fn(arg, 0);

    pthread_mutex_lock(&pool->lock);
    while (pool->running > 0)
        pthread_cond_wait(&pool->idle, &pool->lock);
    pool->busy = false;
    pthread_mutex_unlock(&pool->lock);
}

/* Returns, of several concurrent failures, the one whose text the context kept. */
static int first_failure(struct bsq_ctx *ctx, int status, int status_before)
{
    if (status < 0 && status_before == 0 && bsq_error_status(ctx) < 0)
        return bsq_error_status(ctx);
    return status;
}

/* ---- loops ---- */

struct loop {
    struct bsq_ctx *ctx;
    int (*fn)(void *arg, uint64_t index, unsigned worker);
    void *arg;
    uint64_t count;
    unsigned workers;
    atomic_uint_least64_t next;
    atomic_int status;
};

/* Takes a run of iterations: a small share of what is left. Cheap iterations then do not contend
 * for the counter, and the last ones are still spread evenly. */
static uint64_t take_iterations(struct loop *loop, uint64_t *first)
{
    uint64_t begin = atomic_load_explicit(&loop->next, memory_order_relaxed);
    uint64_t share;
    do {
        if (begin >= loop->count)
            return 0;
        share = (loop->count - begin) / (UINT64_C(16) * loop->workers);
        share = share < 1 ? 1 : share > 1024 ? 1024 : share;
    } while (!atomic_compare_exchange_weak(&loop->next, &begin, begin + share));
    *first = begin;
    return share;
}

static void loop_worker(void *arg, unsigned worker)
{
    struct loop *loop = arg;
    uint64_t first, share;
    while ((share = take_iterations(loop, &first)) > 0) {
        for (uint64_t i = first; i < first + share; i++) {
            if (atomic_load_explicit(&loop->status, memory_order_relaxed) < 0)
                return;
            int status = bsq_check(loop->ctx);
            if (status == 0)
                status = loop->fn(loop->arg, i, worker);
            if (status < 0) {
                int none = 0;
                atomic_compare_exchange_strong(&loop->status, &none, status);
                return;
            }
        }
    }
}

unsigned bsq_workers_within(const struct bsq_ctx *ctx, unsigned most, uint64_t bytes)
{
    const uint64_t fit = bsq_memory_left(ctx) / bytes;
    return fit < 1 ? 1 : fit < most ? (unsigned)fit : most;
}

int bsq_parallel_on(struct bsq_ctx *ctx, unsigned workers, uint64_t count,
                    int (*fn)(void *arg, uint64_t index, unsigned worker), void *arg)
{
    if (workers > count)
        workers = count > 0 ? (unsigned)count : 1;
    struct loop loop = {.ctx = ctx, .fn = fn, .arg = arg, .count = count, .workers = workers};
    int status_before = bsq_error_status(ctx);
    pool_run(ctx, workers, loop_worker, &loop);
    return first_failure(ctx, atomic_load(&loop.status), status_before);
}

int bsq_parallel_for(struct bsq_ctx *ctx, uint64_t count,
                     int (*fn)(void *arg, uint64_t index, unsigned worker), void *arg)
{
    return bsq_parallel_on(ctx, bsq_threads(ctx), count, fn, arg);
}

struct ranges {
    int (*fn)(void *arg, uint64_t begin, uint64_t end, unsigned worker);
    void *arg;
    uint64_t count, step;
};

static int run_range(void *arg, uint64_t index, unsigned worker)
{
    const struct ranges *ranges = arg;
    const uint64_t begin = index * ranges->step, left = ranges->count - begin;
    return ranges->fn(ranges->arg, begin, begin + (left < ranges->step ? left : ranges->step),
                      worker);
}

int bsq_parallel_ranges(struct bsq_ctx *ctx, uint64_t count, uint64_t step,
                        int (*fn)(void *arg, uint64_t begin, uint64_t end, unsigned worker),
                        void *arg)
{
    struct ranges ranges = {fn, arg, count, step};
    return bsq_parallel_for(ctx, count / step + (count % step > 0), run_range, &ranges);
}

/* ---- pipelines ----
 *
 * A pipeline is one or two stages; each has a concurrent step and then a serial step. Counters
 * track the sequences: finished[1] <= begun[1] <= finished[0] <= begun[0] <= produced. `begun`
 * counts sequences whose concurrent step was started, `finished` those whose serial step has
 * returned. Slot s % slot_count belongs to sequence s from its production to its last step. So a
 * slot only records for each stage whether its concurrent step is done. One lock guards all state
 * and is free while callbacks run. Before a thread runs a step, it wakes one
 * sleeper, which does the same if it finds another step to run. So no step waits while a thread
 * sleeps. */

enum step { STEP_NONE, STEP_FINISH, STEP_EMIT, STEP_FOLLOW, STEP_WORK, STEP_PRODUCE };

struct stage {
    int (*concurrent)(void *arg, void *slot, uint64_t sequence, unsigned worker); /* or NULL */
    int (*serial)(void *arg, void *slot, uint64_t sequence);
    uint64_t begun, finished;
    bool busy;  /* the serial step is running */
    bool *done; /* per slot: the concurrent step has returned */
};

struct run {
    struct bsq_ctx *ctx;
    const struct bsq_pipeline *pipeline;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct stage stages[2];
    unsigned stage_count;
    uint64_t produced;
    bool producing, ended;
    unsigned sleepers;
    int status;
};

static void *slot_of(const struct run *run, uint64_t sequence)
{
    const struct bsq_pipeline *pipeline = run->pipeline;
    return (char *)pipeline->slots + (sequence % pipeline->slot_count) * pipeline->slot_size;
}

/* Returns the number of sequences that have passed the whole pipeline. */
static uint64_t passed(const struct run *run)
{
    return run->stages[run->stage_count - 1].finished;
}

static bool can_finish(const struct run *run, const struct stage *stage)
{
    return !stage->busy && stage->finished < stage->begun &&
           stage->done[stage->finished % run->pipeline->slot_count];
}

/* Prefers the step that is furthest along, so that slots become free. */
static enum step possible_step(const struct run *run)
{
    const struct stage *first = &run->stages[0], *second = &run->stages[1];
    if (run->stage_count == 2 && can_finish(run, second))
        return STEP_FINISH;
    if (can_finish(run, first))
        return STEP_EMIT;
    if (run->stage_count == 2 && second->begun < first->finished)
        return STEP_FOLLOW;
    if (first->begun < run->produced)
        return STEP_WORK;
    if (!run->producing && !run->ended && run->produced - passed(run) < run->pipeline->slot_count)
        return STEP_PRODUCE;
    return STEP_NONE;
}

static bool is_over(const struct run *run)
{
    return run->status < 0 || (run->ended && passed(run) == run->produced);
}

/* The lock is held when a step is entered and when it returns. */

static int run_serial(struct run *run, struct stage *stage)
{
    uint64_t sequence = stage->finished;
    stage->busy = true;
    pthread_mutex_unlock(&run->lock);
    int status = stage->serial(run->pipeline->arg, slot_of(run, sequence), sequence);
    pthread_mutex_lock(&run->lock);
    stage->busy = false;
    stage->done[sequence % run->pipeline->slot_count] = false;
    stage->finished++;
    return status;
}

static int run_concurrent(struct run *run, struct stage *stage, unsigned worker)
{
    uint64_t sequence = stage->begun++;
    int status = 0;
    if (stage->concurrent) {
        pthread_mutex_unlock(&run->lock);
        status = stage->concurrent(run->pipeline->arg, slot_of(run, sequence), sequence, worker);
        pthread_mutex_lock(&run->lock);
    }
    stage->done[sequence % run->pipeline->slot_count] = true;
    return status;
}

static int produce_next(struct run *run)
{
    uint64_t sequence = run->produced;
    run->producing = true;
    pthread_mutex_unlock(&run->lock);
    int status = run->pipeline->produce(run->pipeline->arg, slot_of(run, sequence), sequence);
    pthread_mutex_lock(&run->lock);
    run->producing = false;
    if (status > 0)
        run->produced++;
    else
        run->ended = true;
    return status < 0 ? status : 0;
}

static int take_step(struct run *run, enum step step, unsigned worker)
{
    switch (step) {
    case STEP_FINISH:
        return run_serial(run, &run->stages[1]);
    case STEP_EMIT:
        return run_serial(run, &run->stages[0]);
    case STEP_FOLLOW:
        return run_concurrent(run, &run->stages[1], worker);
    case STEP_WORK:
        return run_concurrent(run, &run->stages[0], worker);
    default:
        return produce_next(run);
    }
}

static void pipeline_worker(void *arg, unsigned worker)
{
    struct run *run = arg;
    pthread_mutex_lock(&run->lock);
    while (!is_over(run)) {
        enum step step = possible_step(run);
        if (step == STEP_NONE) {
            run->sleepers++;
            pthread_cond_wait(&run->changed, &run->lock);
            run->sleepers--;
            continue;
        }
        if (run->sleepers > 0)
            pthread_cond_signal(&run->changed);
        int status = bsq_check(run->ctx);
        if (status == 0)
            status = take_step(run, step, worker);
        if (status < 0 && run->status == 0)
            run->status = status;
    }
    pthread_cond_broadcast(&run->changed);
    pthread_mutex_unlock(&run->lock);
}

int bsq_pipeline_run(struct bsq_ctx *ctx, const struct bsq_pipeline *pipeline)
{
    assert(pipeline->slot_count > 0 && !pipeline->follow == !pipeline->finish);
    struct run run = {
        .ctx = ctx,
        .pipeline = pipeline,
        .stages = {{.concurrent = pipeline->work, .serial = pipeline->emit},
                   {.concurrent = pipeline->follow, .serial = pipeline->finish}},
        .stage_count = pipeline->finish ? 2 : 1,
    };
    bool *done;
    int status =
        bsq_calloc(ctx, "pipeline", 2 * (uint64_t)pipeline->slot_count, sizeof done[0], &done);
    if (status < 0)
        return status;
    run.stages[0].done = done;
    run.stages[1].done = done + pipeline->slot_count;
    pthread_mutex_init(&run.lock, NULL);
    pthread_cond_init(&run.changed, NULL);
    int status_before = bsq_error_status(ctx);
    /* All slots may be worked on while one is produced and one each is emitted and finished. */
    const uint64_t most = (uint64_t)pipeline->slot_count + 3, threads = bsq_threads(ctx);
    pool_run(ctx, (unsigned)(threads < most ? threads : most), pipeline_worker, &run);
    pthread_cond_destroy(&run.changed);
    pthread_mutex_destroy(&run.lock);
    bsq_free(ctx, done);
    return first_failure(ctx, run.status, status_before);
}
