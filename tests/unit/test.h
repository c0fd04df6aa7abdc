/* test.h - tests that register themselves: TEST(name) { ... }, and RUN_TESTS at the end of the
 * file. For the source of a test program, not for its helpers. Files of tests have plain names, as
 * each program runs in a directory of its own. */
#ifndef TEST_TEST_H
#define TEST_TEST_H

#include "tests/unit/fixture.h"

static struct CMUnitTest unit_tests[64];
static size_t unit_count;
/* The directory of the test program, and the one in which it was started. */
static char test_directory[] = "/tmp/bisque-unit.XXXXXX";
static char test_start[4096] __attribute__((unused));

static inline void test_add(const char *name, CMUnitTestFunction test, CMFixtureFunction set_up,
                            CMFixtureFunction tear_down)
{
    if (unit_count == sizeof unit_tests / sizeof unit_tests[0])
        abort();
    struct CMUnitTest *entry = &unit_tests[unit_count++];
    entry->name = name;
    entry->test_func = test;
    entry->setup_func = set_up;
    entry->teardown_func = tear_down;
}

/* Defines a test around which set_up and tear_down run; they may be NULL. */
#define TEST_EACH(name, set_up, tear_down)                                                         \
    static void name(void **state);                                                                \
    __attribute__((constructor)) static void add_##name(void)                                      \
    {                                                                                              \
        test_add(#name, name, set_up, tear_down);                                                  \
    }                                                                                              \
    static void name(__attribute__((unused)) void **state)
#define TEST(name) TEST_EACH(name, NULL, NULL)

/* Defines a test with what set_up puts into *state, a struct to which `f` points. */
#define STATE_TEST(name, type, set_up, tear_down)                                                  \
    static void in_##name(type *f);                                                                \
    TEST_EACH(name, set_up, tear_down)                                                             \
    {                                                                                              \
        in_##name(*state);                                                                         \
    }                                                                                              \
    static void in_##name(type *f)

/* Defines a test in a context `ctx` with a memory budget in bytes; 0: the default. All memory must
 * be freed in the end. */
#define CONTEXT_TEST(name, threads, memory)                                                        \
    static void in_##name(struct bsq_ctx *ctx);                                                    \
    TEST(name)                                                                                     \
    {                                                                                              \
        struct bsq_ctx *ctx = test_context(threads, memory);                                       \
        in_##name(ctx);                                                                            \
        test_context_end(ctx);                                                                     \
    }                                                                                              \
    static void in_##name(struct bsq_ctx *ctx)

/* Declares a context that all tests of a file share, and what RUN_TESTS wants for it. */
#define SHARED_CONTEXT(ctx, threads)                                                               \
    static struct bsq_ctx *ctx;                                                                    \
    static int open_##ctx(__attribute__((unused)) void **state)                                    \
    {                                                                                              \
        ctx = test_context(threads, 0);                                                            \
        return 0;                                                                                  \
    }                                                                                              \
    static int close_##ctx(__attribute__((unused)) void **state)                                   \
    {                                                                                              \
        test_context_end(ctx);                                                                     \
        return 0;                                                                                  \
    }

/* Runs the tests in the order of the file, between set_up and tear_down, which may be NULL, in an
 * empty directory of their own. It is a failure if they leave a temporary file of an output there.
 */
static inline int test_run(CMFixtureFunction set_up, CMFixtureFunction tear_down)
{
    char command[160];
    if (!getcwd(test_start, sizeof test_start) || !mkdtemp(test_directory) ||
        chdir(test_directory) != 0)
        return 1;
    const int failed = _cmocka_run_group_tests("tests", unit_tests, unit_count, set_up, tear_down);
    snprintf(command, sizeof command,
             "cd / && left=$(find %s -name '*.tmp') && rm -rf %s && test -z \"$left\" || { echo "
             "\"not ok - left: $left\"; false; }",
             test_directory, test_directory);
    return system(command) != 0 || failed;
}
#define RUN_TESTS(set_up, tear_down)                                                               \
    int main(void)                                                                                 \
    {                                                                                              \
        return test_run(set_up, tear_down);                                                        \
    }

#endif
