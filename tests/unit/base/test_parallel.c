/* test_parallel.c - loops and pipelines with 1 to 8 threads, random work, failures at every stage.
 */
#include <dirent.h>
#include <stdatomic.h>
#include <time.h>
#include <unistd.h>

#include "base/parallel.h"
#include "tests/unit/test.h"

enum { MAX_THREADS = 8 };

static void pause_microseconds(unsigned microseconds)
{
    if (microseconds > 0)
        nanosleep(&(struct timespec){.tv_nsec = (long)microseconds * 1000}, NULL);
}

/* Returns random bits that depend on x alone. */
static uint64_t scramble(uint64_t x)
{
    return test_random(&x);
}

/* ---- loops ---- */

struct loop_state {
    unsigned threads;
    atomic_uchar *visits;
    atomic_int inside[MAX_THREADS];
    atomic_int trouble;
    atomic_uint_least64_t calls;
    uint64_t fail_at;
    struct bsq_ctx *interrupt;
};

static int visit(void *arg, uint64_t index, unsigned worker)
{
    struct loop_state *shared = arg;
    atomic_fetch_add(&shared->calls, 1);
    if (worker >= shared->threads || atomic_fetch_add(&shared->inside[worker], 1) != 0)
        atomic_store(&shared->trouble, 1);
    if (shared->visits)
        atomic_fetch_add(&shared->visits[index], 1);
    int status = index == shared->fail_at ? BSQ_EDATA : 0;
    if (shared->interrupt && index == 10)
        bsq_interrupt(shared->interrupt);
    atomic_fetch_sub(&shared->inside[worker], 1);
    return status;
}

TEST(test_loop_visits_each_once)
{
    static const uint64_t counts[] = {0, 1, 2, 3, 7, 100, 12345};
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        for (size_t c = 0; c < sizeof counts / sizeof counts[0]; c++) {
            uint64_t count = counts[c];
            struct loop_state shared = {.threads = threads, .fail_at = UINT64_MAX};
            shared.visits = calloc(count + 1, 1);
            assert_int_equal(bsq_parallel_for(ctx, count, visit, &shared), 0);
            for (uint64_t i = 0; i < count; i++)
                assert_int_equal(shared.visits[i], 1);
            assert_int_equal(shared.trouble, 0);
            free(shared.visits);
        }
        bsq_ctx_destroy(ctx);
    }
}

static int visit_range(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    struct loop_state *shared = arg;
    if (end <= begin || end - begin > 7)
        atomic_store(&shared->trouble, 1);
    for (; begin < end; begin++)
        visit(arg, begin, worker);
    return 0;
}

TEST(test_ranges_visit_each_once)
{
    static const uint64_t counts[] = {0, 1, 6, 7, 8, 14, 1000};
    for (unsigned threads = 1; threads <= MAX_THREADS; threads += 3) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        for (size_t c = 0; c < sizeof counts / sizeof counts[0]; c++) {
            atomic_uchar visits[1001] = {0};
            struct loop_state shared = {
                .threads = threads, .fail_at = UINT64_MAX, .visits = visits};
            assert_int_equal(bsq_parallel_ranges(ctx, counts[c], 7, visit_range, &shared), 0);
            for (uint64_t i = 0; i <= 1000; i++)
                assert_int_equal(visits[i], i < counts[c]);
            assert_int_equal(shared.trouble, 0);
        }
        bsq_ctx_destroy(ctx);
    }
}

TEST(test_loop_stops_at_failure)
{
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        struct loop_state shared = {.threads = threads, .fail_at = 1000};
        assert_int_equal(bsq_parallel_for(ctx, UINT64_C(1) << 50, visit, &shared), BSQ_EDATA);
        assert_int_equal(shared.trouble, 0);
        if (threads == 1)
            assert_int_equal(shared.calls, 1001);
        bsq_ctx_destroy(ctx);
    }
}

TEST(test_loop_is_interrupted)
{
    for (unsigned threads = 1; threads <= MAX_THREADS; threads += 3) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        struct loop_state shared = {.threads = threads, .fail_at = UINT64_MAX, .interrupt = ctx};
        assert_int_equal(bsq_parallel_for(ctx, UINT64_C(1) << 50, visit, &shared), BSQ_EINTR);
        assert_string_equal(bsq_error(ctx), "interrupted");
        bsq_ctx_destroy(ctx);
    }
}

/* Memory has space for what three of the eight threads need; others take no part. */
CONTEXT_TEST(test_loop_keeps_to_memory, MAX_THREADS, 3500)
{
    atomic_uchar visits[100] = {0};
    struct loop_state shared = {.threads = 3, .fail_at = UINT64_MAX, .visits = visits};
    assert_int_equal(bsq_workers_within(ctx, MAX_THREADS, 1000), 3);
    assert_int_equal(bsq_workers_within(ctx, 2, 1000), 2);
    assert_int_equal(bsq_workers_within(ctx, MAX_THREADS, 3501), 1);
    assert_int_equal(bsq_parallel_on(ctx, 3, 100, visit, &shared), 0);
    for (int i = 0; i < 100; i++)
        assert_int_equal(visits[i], 1);
    assert_int_equal(shared.trouble, 0);
}

/* Waits for the other iteration, so it succeeds only if both run at the same time. */
static int meet(void *arg, uint64_t index, unsigned worker)
{
    (void)index, (void)worker;
    atomic_int *arrived = arg;
    atomic_fetch_add(arrived, 1);
    for (int i = 0; i < 20000 && atomic_load(arrived) < 2; i++)
        pause_microseconds(100);
    return atomic_load(arrived) < 2 ? BSQ_EBUG : 0;
}

CONTEXT_TEST(test_loop_runs_concurrently, 2, 0)
{
    atomic_int arrived = 0;
    assert_int_equal(bsq_parallel_for(ctx, 2, meet, &arrived), 0);
}

/* ---- pipelines ---- */

enum stage { NOWHERE, IN_PRODUCE, IN_WORK, IN_EMIT, IN_FOLLOW, IN_FINISH };

struct slot {
    uint64_t sequence, value;
    atomic_int owners; /* callbacks that use this slot now */
};

struct pipe_state {
    struct bsq_ctx *ctx;
    unsigned threads, slot_count;
    uint64_t count, seed;
    unsigned longest_pause; /* microseconds */
    bool has_work, has_second_stage;
    enum stage fail_in, interrupt_in;
    uint64_t fail_at;
    atomic_int producing, emitting, working, inside[MAX_THREADS];
    atomic_uint_least64_t emitted, produced, finished;
    atomic_int finishing;
    atomic_int trouble;
    uint64_t sum;
};

static void check(struct pipe_state *shared, bool condition)
{
    if (!condition)
        atomic_store(&shared->trouble, 1);
}

static void idle_a_while(const struct pipe_state *shared, uint64_t sequence, enum stage stage)
{
    if (shared->longest_pause > 0)
        pause_microseconds((unsigned)(scramble(shared->seed ^ sequence * 8 ^ stage) %
                                      (shared->longest_pause + 1)));
}

static int finish_stage(struct pipe_state *shared, uint64_t sequence, enum stage stage)
{
    if (sequence != shared->fail_at)
        return 0;
    if (shared->interrupt_in == stage)
        bsq_interrupt(shared->ctx);
    return shared->fail_in == stage ? BSQ_EDATA - (int)stage : 0;
}

static int produce(void *arg, void *data, uint64_t sequence)
{
    struct pipe_state *shared = arg;
    struct slot *slot = data;
    check(shared, atomic_fetch_add(&shared->producing, 1) == 0);
    check(shared, sequence == atomic_load(&shared->produced));
    check(shared,
          sequence < atomic_load(shared->has_second_stage ? &shared->finished : &shared->emitted) +
                         shared->slot_count);
    int status = 0;
    if (sequence < shared->count) {
        check(shared, atomic_fetch_add(&slot->owners, 1) == 0);
        slot->sequence = sequence;
        slot->value = sequence;
        idle_a_while(shared, sequence, IN_PRODUCE);
        status = finish_stage(shared, sequence, IN_PRODUCE);
        atomic_fetch_sub(&slot->owners, 1);
        atomic_fetch_add(&shared->produced, 1);
        status = status < 0 ? status : 1;
    }
    atomic_fetch_sub(&shared->producing, 1);
    return status;
}

static int work(void *arg, void *data, uint64_t sequence, unsigned worker)
{
    struct pipe_state *shared = arg;
    struct slot *slot = data;
    check(shared, worker < shared->threads);
    check(shared, atomic_fetch_add(&shared->inside[worker], 1) == 0);
    check(shared, atomic_fetch_add(&slot->owners, 1) == 0);
    check(shared, slot->sequence == sequence && slot->value == sequence);
    idle_a_while(shared, sequence, IN_WORK);
    slot->value = scramble(sequence);
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_sub(&shared->inside[worker], 1);
    return finish_stage(shared, sequence, IN_WORK);
}

static int emit(void *arg, void *data, uint64_t sequence)
{
    struct pipe_state *shared = arg;
    struct slot *slot = data;
    check(shared, atomic_fetch_add(&shared->emitting, 1) == 0);
    check(shared, atomic_fetch_add(&slot->owners, 1) == 0);
    check(shared, sequence == atomic_load(&shared->emitted));
    check(shared, slot->value == (shared->has_work ? scramble(sequence) : sequence));
    idle_a_while(shared, sequence, IN_EMIT);
    shared->sum = shared->sum * 31 + slot->value;
    slot->value = shared->has_second_stage ? sequence : UINT64_MAX;
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_add(&shared->emitted, 1);
    atomic_fetch_sub(&shared->emitting, 1);
    return finish_stage(shared, sequence, IN_EMIT);
}

static int follow(void *arg, void *data, uint64_t sequence, unsigned worker)
{
    struct pipe_state *shared = arg;
    struct slot *slot = data;
    check(shared, worker < shared->threads);
    check(shared, atomic_fetch_add(&shared->inside[worker], 1) == 0);
    check(shared, atomic_fetch_add(&slot->owners, 1) == 0);
    check(shared, sequence < atomic_load(&shared->emitted));
    check(shared, slot->sequence == sequence && slot->value == sequence);
    idle_a_while(shared, sequence, IN_FOLLOW);
    slot->value = scramble(sequence + 1);
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_sub(&shared->inside[worker], 1);
    return finish_stage(shared, sequence, IN_FOLLOW);
}

static int finish(void *arg, void *data, uint64_t sequence)
{
    struct pipe_state *shared = arg;
    struct slot *slot = data;
    check(shared, atomic_fetch_add(&shared->finishing, 1) == 0);
    check(shared, atomic_fetch_add(&slot->owners, 1) == 0);
    check(shared, sequence == atomic_load(&shared->finished));
    check(shared, slot->value == scramble(sequence + 1));
    idle_a_while(shared, sequence, IN_FINISH);
    slot->value = UINT64_MAX;
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_add(&shared->finished, 1);
    atomic_fetch_sub(&shared->finishing, 1);
    return finish_stage(shared, sequence, IN_FINISH);
}

static int run(struct pipe_state *shared)
{
    struct slot *slots = calloc(shared->slot_count, sizeof *slots);
    struct bsq_pipeline pipeline = {
        .produce = produce,
        .work = shared->has_work ? work : NULL,
        .emit = emit,
        .follow = shared->has_second_stage ? follow : NULL,
        .finish = shared->has_second_stage ? finish : NULL,
        .arg = shared,
        .slots = slots,
        .slot_size = sizeof *slots,
        .slot_count = shared->slot_count,
    };
    int status = bsq_pipeline_run(shared->ctx, &pipeline);
    free(slots);
    return status;
}

TEST(test_pipeline_keeps_order)
{
    static const uint64_t counts[] = {0, 1, 2, 5, 100};
    static const unsigned pauses[] = {0, 100};
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        for (size_t c = 0; c < 5 * 2 * 2 * 3 * 2; c++) {
            struct pipe_state shared = {
                .ctx = ctx,
                .threads = threads,
                .slot_count = c / 20 % 3 == 0   ? 1
                              : c / 20 % 3 == 1 ? 2 * threads
                                                : 3,
                .count = counts[c % 5],
                .seed = c,
                .longest_pause = pauses[c / 5 % 2],
                .has_work = c / 10 % 2,
                .has_second_stage = c / 60,
            };
            uint64_t expected = 0;
            for (uint64_t i = 0; i < shared.count; i++)
                expected = expected * 31 + (shared.has_work ? scramble(i) : i);
            assert_int_equal(run(&shared), 0);
            assert_int_equal(shared.trouble, 0);
            assert_int_equal(shared.emitted, shared.count);
            assert_int_equal(shared.finished, shared.has_second_stage ? shared.count : 0);
            assert_int_equal(shared.sum, expected);
        }
        test_context_end(ctx);
    }
}

TEST(test_pipeline_failures)
{
    const uint64_t seed = test_seed();
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        for (enum stage stage = IN_PRODUCE; stage <= IN_FINISH; stage++) {
            for (unsigned round = 0; round < 8; round++) {
                struct bsq_ctx *ctx = test_context(threads, 0);
                struct pipe_state shared = {
                    .ctx = ctx,
                    .threads = threads,
                    .slot_count = round % 2 ? 2 * threads : 2,
                    .count = 100000000,
                    .seed = seed + round,
                    .longest_pause = round < 4 ? 50 : 0,
                    .has_work = true,
                    .has_second_stage = stage > IN_EMIT || round % 3 == 0,
                    .fail_in = stage,
                    .fail_at = scramble(seed + round) % 60,
                };
                assert_int_equal(run(&shared), BSQ_EDATA - (int)stage);
                assert_int_equal(shared.trouble, 0);
                /* No later slot than the one that failed is emitted or finished. */
                assert_true(stage > IN_EMIT ||
                            shared.emitted <= shared.fail_at + (stage == IN_EMIT));
                assert_true(shared.finished <= shared.fail_at + (stage == IN_FINISH));
                assert_true(shared.produced <= shared.fail_at + shared.slot_count + 1);
                bsq_ctx_destroy(ctx);
            }
        }
    }
}

TEST(test_pipeline_is_interrupted)
{
    for (unsigned threads = 1; threads <= MAX_THREADS; threads += 1) {
        for (enum stage stage = IN_PRODUCE; stage <= IN_FINISH; stage++) {
            struct bsq_ctx *ctx = test_context(threads, 0);
            struct pipe_state shared = {
                .ctx = ctx,
                .threads = threads,
                .slot_count = 2 * threads,
                .count = 100000000,
                .has_work = true,
                .has_second_stage = stage > IN_EMIT,
                .interrupt_in = stage,
                .fail_at = 20,
            };
            assert_int_equal(run(&shared), BSQ_EINTR);
            assert_int_equal(shared.trouble, 0);
            bsq_ctx_destroy(ctx);
        }
    }
}

CONTEXT_TEST(test_pipeline_needs_budget, 2, 3)
{
    struct pipe_state shared = {.ctx = ctx, .threads = 2, .slot_count = 4, .count = 10};
    assert_int_equal(run(&shared), BSQ_ENOMEM);
    assert_int_equal(shared.produced, 0);
}

/* Emission of one slot overlaps with work on another: each waits for the other. */
struct overlap {
    atomic_int emitting, working;
};

static int await(atomic_int *flag)
{
    while (!atomic_load(flag))
        pause_microseconds(100);
    return 0;
}

static int overlap_produce(void *arg, void *slot, uint64_t sequence)
{
    (void)arg, (void)slot;
    return sequence < 2;
}

static int overlap_work(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    (void)slot, (void)worker;
    struct overlap *overlap = arg;
    if (sequence == 0)
        return 0;
    atomic_store(&overlap->working, 1);
    return await(&overlap->emitting);
}

static int overlap_emit(void *arg, void *slot, uint64_t sequence)
{
    (void)slot;
    struct overlap *overlap = arg;
    if (sequence == 1)
        return 0;
    atomic_store(&overlap->emitting, 1);
    return await(&overlap->working);
}

CONTEXT_TEST(test_emit_overlaps_with_work, 2, 0)
{
    struct overlap overlap = {0};
    char slots[4];
    struct bsq_pipeline pipeline = {
        .produce = overlap_produce,
        .work = overlap_work,
        .emit = overlap_emit,
        .arg = &overlap,
        .slots = slots,
        .slot_size = 1,
        .slot_count = 4,
    };
    assert_int_equal(bsq_pipeline_run(ctx, &pipeline), 0);
}

/* Returns whether all threads of this process but the calling one sleep, at least `least` of them.
 */
static bool others_sleep(unsigned least)
{
    DIR *threads = opendir("/proc/self/task");
    unsigned asleep = 0, awake = 0;
    for (struct dirent *entry; threads && (entry = readdir(threads));) {
        char path[300], stat[300] = "";
        snprintf(path, sizeof path, "/proc/self/task/%s/stat", entry->d_name);
        if (atoi(entry->d_name) <= 0 || atoi(entry->d_name) == gettid())
            continue;
        FILE *file = fopen(path, "r");
        const char *name_end = file && fgets(stat, sizeof stat, file) ? strrchr(stat, ')') : NULL;
        if (file)
            fclose(file);
        const bool sleeps = name_end && strncmp(name_end, ") S", 3) == 0;
        asleep += sleeps;
        awake += !sleeps;
    }
    if (threads)
        closedir(threads);
    return asleep >= least && awake == 0;
}

static int slow_produce(void *arg, void *slot, uint64_t sequence)
{
    (void)arg, (void)slot;
    return sequence < 1;
}

/* Ends when all other threads sleep, or when it has looked very often. */
static int slow_work(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    (void)slot, (void)sequence, (void)worker;
    bool *asleep = arg;
    for (int look = 0; look < 100000 && !*asleep; look++) {
        pause_microseconds(100);
        *asleep = others_sleep(MAX_THREADS - 1);
    }
    return 0;
}

static int slow_emit(void *arg, void *slot, uint64_t sequence)
{
    (void)arg, (void)slot, (void)sequence;
    return 0;
}

/* While one thread does a slow step, the others sleep. */
TEST(test_waiting_is_not_busy)
{
    struct bsq_ctx *ctx = test_context(MAX_THREADS, 0);
    bool asleep = false;
    char slots[MAX_THREADS];
    const struct bsq_pipeline pipeline = {
        .produce = slow_produce,
        .work = slow_work,
        .emit = slow_emit,
        .arg = &asleep,
        .slots = slots,
        .slot_size = 1,
        .slot_count = MAX_THREADS,
    };
    assert_int_equal(bsq_pipeline_run(ctx, &pipeline), 0);
    assert_true(asleep);
    bsq_ctx_destroy(ctx);
}

RUN_TESTS(NULL, NULL)
