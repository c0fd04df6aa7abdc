/* fixture.h - contexts, files and random seeds for the tests of all libraries, and the headers of
 * the system that most of them use. */
#ifndef TEST_FIXTURE_H
#define TEST_FIXTURE_H

#include <dirent.h>
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

/* Writes a file; returns its name. */
static inline const char *test_bytes(const char *name, const void *bytes, size_t size)
{
    FILE *file = fopen(name, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    assert_int_equal(fclose(file), 0);
    return name;
}

static inline const char *test_text(const char *name, const char *text)
{
    return test_bytes(name, text, strlen(text));
}

/* Returns the bytes of a whole file, and a zero after them; free() them. */
static inline uint8_t *test_read(const char *name, size_t *size)
{
    FILE *file = fopen(name, "rb");
    assert_non_null(file);
    assert_int_equal(fseek(file, 0, SEEK_END), 0);
    *size = (size_t)ftell(file);
    rewind(file);
    uint8_t *bytes = (uint8_t *)calloc(*size + 1, 1);
    assert_non_null(bytes);
    assert_int_equal(fread(bytes, 1, *size, file), *size);
    fclose(file);
    return bytes;
}

/* Checks that a file holds this text and no more. */
static inline void test_expect_text(const char *name, const char *text)
{
    size_t size;
    uint8_t *bytes = test_read(name, &size);
    assert_int_equal(size, strlen(text));
    assert_memory_equal(bytes, text, size);
    free(bytes);
}

/* Returns the number of files in the working directory. */
static inline unsigned test_files_here(void)
{
    unsigned count = 0;
    DIR *list = opendir(".");
    assert_non_null(list);
    while (readdir(list))
        count++;
    closedir(list);
    return count - 2; /* "." and ".." */
}

/* Returns a checksum of a file (Fowler, Noll & Vo, FNV-1a), and removes the file. */
static inline uint64_t test_take_hash(const char *name)
{
    size_t size;
    uint8_t *bytes = test_read(name, &size);
    uint64_t hash = UINT64_C(1469598103934665603);
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ bytes[i]) * UINT64_C(1099511628211);
    free(bytes);
    unlink(name);
    return hash;
}

/* Skips the test because a package is missing. It fails if CI is set: there, all are installed. */
static inline void test_lacks(const char *package)
{
    if (getenv("CI") && *getenv("CI"))
        fail_msg("%s is missing", package);
    skip();
}

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
