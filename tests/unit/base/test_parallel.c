/* test_parallel.c - loops and pipelines with 1 to 8 threads, random work, failures at every stage.
 */
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "base/parallel.h"
#include "tests/unit/fixture.h"

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
    struct loop_state *state = arg;
    atomic_fetch_add(&state->calls, 1);
    if (worker >= state->threads || atomic_fetch_add(&state->inside[worker], 1) != 0)
        atomic_store(&state->trouble, 1);
    if (state->visits)
        atomic_fetch_add(&state->visits[index], 1);
    int status = index == state->fail_at ? BSQ_EDATA : 0;
    if (state->interrupt && index == 10)
        bsq_interrupt(state->interrupt);
    atomic_fetch_sub(&state->inside[worker], 1);
    return status;
}

static void test_loop_visits_each_once(void **unused)
{
    (void)unused;
    static const uint64_t counts[] = {0, 1, 2, 3, 7, 100, 12345};
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        for (size_t c = 0; c < sizeof counts / sizeof counts[0]; c++) {
            uint64_t count = counts[c];
            struct loop_state state = {.threads = threads, .fail_at = UINT64_MAX};
            state.visits = calloc(count + 1, 1);
            assert_int_equal(bsq_parallel_for(ctx, count, visit, &state), 0);
            for (uint64_t i = 0; i < count; i++)
                assert_int_equal(state.visits[i], 1);
            assert_int_equal(state.trouble, 0);
            free(state.visits);
        }
        bsq_ctx_destroy(ctx);
    }
}

static void test_loop_stops_at_failure(void **unused)
{
    (void)unused;
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        struct loop_state state = {.threads = threads, .fail_at = 1000};
        assert_int_equal(bsq_parallel_for(ctx, UINT64_C(1) << 50, visit, &state), BSQ_EDATA);
        assert_int_equal(state.trouble, 0);
        if (threads == 1)
            assert_int_equal(state.calls, 1001);
        bsq_ctx_destroy(ctx);
    }
}

static void test_loop_is_interrupted(void **unused)
{
    (void)unused;
    for (unsigned threads = 1; threads <= MAX_THREADS; threads += 3) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        struct loop_state state = {.threads = threads, .fail_at = UINT64_MAX, .interrupt = ctx};
        assert_int_equal(bsq_parallel_for(ctx, UINT64_C(1) << 50, visit, &state), BSQ_EINTR);
        assert_string_equal(bsq_error(ctx), "interrupted");
        bsq_ctx_destroy(ctx);
    }
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

static void test_loop_runs_concurrently(void **unused)
{
    (void)unused;
    struct bsq_ctx *ctx = test_context(2, 0);
    atomic_int arrived = 0;
    assert_int_equal(bsq_parallel_for(ctx, 2, meet, &arrived), 0);
    bsq_ctx_destroy(ctx);
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

static void check(struct pipe_state *state, bool condition)
{
    if (!condition)
        atomic_store(&state->trouble, 1);
}

static void idle_a_while(const struct pipe_state *state, uint64_t sequence, enum stage stage)
{
    if (state->longest_pause > 0)
        pause_microseconds(
            (unsigned)(scramble(state->seed ^ sequence * 8 ^ stage) % (state->longest_pause + 1)));
}

static int finish_stage(struct pipe_state *state, uint64_t sequence, enum stage stage)
{
    if (sequence != state->fail_at)
        return 0;
    if (state->interrupt_in == stage)
        bsq_interrupt(state->ctx);
    return state->fail_in == stage ? BSQ_EDATA - (int)stage : 0;
}

static int produce(void *arg, void *data, uint64_t sequence)
{
    struct pipe_state *state = arg;
    struct slot *slot = data;
    check(state, atomic_fetch_add(&state->producing, 1) == 0);
    check(state, sequence == atomic_load(&state->produced));
    check(state,
          sequence < atomic_load(state->has_second_stage ? &state->finished : &state->emitted) +
                         state->slot_count);
    int status = 0;
    if (sequence < state->count) {
        check(state, atomic_fetch_add(&slot->owners, 1) == 0);
        slot->sequence = sequence;
        slot->value = sequence;
        idle_a_while(state, sequence, IN_PRODUCE);
        status = finish_stage(state, sequence, IN_PRODUCE);
        atomic_fetch_sub(&slot->owners, 1);
        atomic_fetch_add(&state->produced, 1);
        status = status < 0 ? status : 1;
    }
    atomic_fetch_sub(&state->producing, 1);
    return status;
}

static int work(void *arg, void *data, uint64_t sequence, unsigned worker)
{
    struct pipe_state *state = arg;
    struct slot *slot = data;
    check(state, worker < state->threads);
    check(state, atomic_fetch_add(&state->inside[worker], 1) == 0);
    check(state, atomic_fetch_add(&slot->owners, 1) == 0);
    check(state, slot->sequence == sequence && slot->value == sequence);
    idle_a_while(state, sequence, IN_WORK);
    slot->value = scramble(sequence);
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_sub(&state->inside[worker], 1);
    return finish_stage(state, sequence, IN_WORK);
}

static int emit(void *arg, void *data, uint64_t sequence)
{
    struct pipe_state *state = arg;
    struct slot *slot = data;
    check(state, atomic_fetch_add(&state->emitting, 1) == 0);
    check(state, atomic_fetch_add(&slot->owners, 1) == 0);
    check(state, sequence == atomic_load(&state->emitted));
    check(state, slot->value == (state->has_work ? scramble(sequence) : sequence));
    idle_a_while(state, sequence, IN_EMIT);
    state->sum = state->sum * 31 + slot->value;
    slot->value = state->has_second_stage ? sequence : UINT64_MAX;
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_add(&state->emitted, 1);
    atomic_fetch_sub(&state->emitting, 1);
    return finish_stage(state, sequence, IN_EMIT);
}

static int follow(void *arg, void *data, uint64_t sequence, unsigned worker)
{
    struct pipe_state *state = arg;
    struct slot *slot = data;
    check(state, worker < state->threads);
    check(state, atomic_fetch_add(&state->inside[worker], 1) == 0);
    check(state, atomic_fetch_add(&slot->owners, 1) == 0);
    check(state, sequence < atomic_load(&state->emitted));
    check(state, slot->sequence == sequence && slot->value == sequence);
    idle_a_while(state, sequence, IN_FOLLOW);
    slot->value = scramble(sequence + 1);
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_sub(&state->inside[worker], 1);
    return finish_stage(state, sequence, IN_FOLLOW);
}

static int finish(void *arg, void *data, uint64_t sequence)
{
    struct pipe_state *state = arg;
    struct slot *slot = data;
    check(state, atomic_fetch_add(&state->finishing, 1) == 0);
    check(state, atomic_fetch_add(&slot->owners, 1) == 0);
    check(state, sequence == atomic_load(&state->finished));
    check(state, slot->value == scramble(sequence + 1));
    idle_a_while(state, sequence, IN_FINISH);
    slot->value = UINT64_MAX;
    atomic_fetch_sub(&slot->owners, 1);
    atomic_fetch_add(&state->finished, 1);
    atomic_fetch_sub(&state->finishing, 1);
    return finish_stage(state, sequence, IN_FINISH);
}

static int run(struct pipe_state *state)
{
    struct slot *slots = calloc(state->slot_count, sizeof *slots);
    struct bsq_pipeline pipeline = {
        .produce = produce,
        .work = state->has_work ? work : NULL,
        .emit = emit,
        .follow = state->has_second_stage ? follow : NULL,
        .finish = state->has_second_stage ? finish : NULL,
        .arg = state,
        .slots = slots,
        .slot_size = sizeof *slots,
        .slot_count = state->slot_count,
    };
    int status = bsq_pipeline_run(state->ctx, &pipeline);
    free(slots);
    return status;
}

static void test_pipeline_keeps_order(void **unused)
{
    (void)unused;
    static const uint64_t counts[] = {0, 1, 2, 5, 100};
    static const unsigned pauses[] = {0, 100};
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        struct bsq_ctx *ctx = test_context(threads, 0);
        for (size_t c = 0; c < 5 * 2 * 2 * 3 * 2; c++) {
            struct pipe_state state = {
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
            for (uint64_t i = 0; i < state.count; i++)
                expected = expected * 31 + (state.has_work ? scramble(i) : i);
            assert_int_equal(run(&state), 0);
            assert_int_equal(state.trouble, 0);
            assert_int_equal(state.emitted, state.count);
            assert_int_equal(state.finished, state.has_second_stage ? state.count : 0);
            assert_int_equal(state.sum, expected);
        }
        assert_int_equal(bsq_memory_used(ctx), 0);
        bsq_ctx_destroy(ctx);
    }
}

static void test_pipeline_failures(void **unused)
{
    (void)unused;
    const uint64_t seed = test_seed();
    for (unsigned threads = 1; threads <= MAX_THREADS; threads++) {
        for (enum stage stage = IN_PRODUCE; stage <= IN_FINISH; stage++) {
            for (unsigned round = 0; round < 8; round++) {
                struct bsq_ctx *ctx = test_context(threads, 0);
                struct pipe_state state = {
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
                assert_int_equal(run(&state), BSQ_EDATA - (int)stage);
                assert_int_equal(state.trouble, 0);
                /* No later slot than the one that failed is emitted or finished. */
                assert_true(stage > IN_EMIT || state.emitted <= state.fail_at + (stage == IN_EMIT));
                assert_true(state.finished <= state.fail_at + (stage == IN_FINISH));
                assert_true(state.produced <= state.fail_at + state.slot_count + 1);
                bsq_ctx_destroy(ctx);
            }
        }
    }
}

static void test_pipeline_is_interrupted(void **unused)
{
    (void)unused;
    for (unsigned threads = 1; threads <= MAX_THREADS; threads += 1) {
        for (enum stage stage = IN_PRODUCE; stage <= IN_FINISH; stage++) {
            struct bsq_ctx *ctx = test_context(threads, 0);
            struct pipe_state state = {
                .ctx = ctx,
                .threads = threads,
                .slot_count = 2 * threads,
                .count = 100000000,
                .has_work = true,
                .has_second_stage = stage > IN_EMIT,
                .interrupt_in = stage,
                .fail_at = 20,
            };
            assert_int_equal(run(&state), BSQ_EINTR);
            assert_int_equal(state.trouble, 0);
            bsq_ctx_destroy(ctx);
        }
    }
}

static void test_pipeline_needs_budget(void **unused)
{
    (void)unused;
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.threads = 2, .memory_bytes = 3};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    struct pipe_state state = {.ctx = ctx, .threads = 2, .slot_count = 4, .count = 10};
    assert_int_equal(run(&state), BSQ_ENOMEM);
    assert_int_equal(state.produced, 0);
    bsq_ctx_destroy(ctx);
}

/* Emission of one slot overlaps with work on another: each waits for the other. */
struct overlap {
    atomic_int emitting, working;
};

static bool await(atomic_int *flag)
{
    for (int i = 0; i < 20000 && !atomic_load(flag); i++)
        pause_microseconds(100);
    return atomic_load(flag);
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
    return await(&overlap->emitting) ? 0 : BSQ_EBUG;
}

static int overlap_emit(void *arg, void *slot, uint64_t sequence)
{
    (void)slot;
    struct overlap *overlap = arg;
    if (sequence == 1)
        return 0;
    atomic_store(&overlap->emitting, 1);
    return await(&overlap->working) ? 0 : BSQ_EBUG;
}

static void test_emit_overlaps_with_work(void **unused)
{
    (void)unused;
    struct bsq_ctx *ctx = test_context(2, 0);
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
    bsq_ctx_destroy(ctx);
}

/* Waiting threads sleep: one slow step with seven idle threads costs next to no processor time. */
static void test_waiting_is_not_busy(void **unused)
{
    (void)unused;
    struct bsq_ctx *ctx = test_context(MAX_THREADS, 0);
    struct pipe_state state = {
        .ctx = ctx, .threads = MAX_THREADS, .slot_count = 1, .count = 100, .longest_pause = 4000};
    clock_t before = clock();
    assert_int_equal(run(&state), 0);
    assert_true(clock() - before < CLOCKS_PER_SEC / 10);
    bsq_ctx_destroy(ctx);
}

int main(void)
{
    alarm(120); /* a deadlock is a failure, not a hang */
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_loop_visits_each_once),
        cmocka_unit_test(test_loop_stops_at_failure),
        cmocka_unit_test(test_loop_is_interrupted),
        cmocka_unit_test(test_loop_runs_concurrently),
        cmocka_unit_test(test_pipeline_keeps_order),
        cmocka_unit_test(test_pipeline_failures),
        cmocka_unit_test(test_pipeline_is_interrupted),
        cmocka_unit_test(test_pipeline_needs_budget),
        cmocka_unit_test(test_emit_overlaps_with_work),
        cmocka_unit_test(test_waiting_is_not_busy),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
