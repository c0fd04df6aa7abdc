/* fixture.h - contexts and random seeds for the tests of all libraries, and the headers of the
 * system that most of them use. */
#ifndef TEST_FIXTURE_H
#define TEST_FIXTURE_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#ifdef __cplusplus
extern "C" {
#include <cmocka.h>
}
#else
#include <cmocka.h>

#include "base/context.h"

/* Creates a context with a memory budget in bytes; 0: the default. */
static inline struct bsq_ctx *test_context(unsigned threads, uint64_t memory)
{
    struct bsq_ctx_options options = {.threads = threads, .memory_bytes = memory};
    struct bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

/* Checks that all memory was freed, and destroys the context. */
static inline void test_context_end(struct bsq_ctx *ctx)
{
    assert_int_equal(bsq_memory_used(ctx), 0);
    bsq_ctx_destroy(ctx);
}
#endif

/* Returns a seed for random numbers and prints it. BSQ_TEST_SEED sets it, to repeat a failure. */
static inline uint64_t test_seed(void)
{
    const char *text = getenv("BSQ_TEST_SEED");
    uint64_t seed = text ? strtoull(text, NULL, 0) : 20080312;
    print_message("BSQ_TEST_SEED=%llu\n", (unsigned long long)seed);
    return seed;
}

/* Returns the next 64 random bits after *state (Steele et al., SplitMix64, 2014). */
static inline uint64_t test_random(uint64_t *state)
{
    uint64_t x = *state += UINT64_C(0x9e3779b97f4a7c15);
    x = (x ^ x >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    x = (x ^ x >> 27) * UINT64_C(0x94d049bb133111eb);
    return x ^ x >> 31;
}

#endif
