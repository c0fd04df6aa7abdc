/* test.h - tests that register themselves: TEST(name) { ... }, and RUN_TESTS at the end of the
 * file. For the source of a test program, not for its helpers. */
#ifndef TEST_TEST_H
#define TEST_TEST_H

#include "tests/unit/fixture.h"

static struct CMUnitTest unit_tests[64];
static size_t unit_count;

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

/* Runs the tests in the order of the file, between set_up and tear_down, which may be NULL. */
static inline int test_run(CMFixtureFunction set_up, CMFixtureFunction tear_down)
{
    return _cmocka_run_group_tests("tests", unit_tests, unit_count, set_up, tear_down);
}
#define RUN_TESTS(set_up, tear_down)                                                               \
    int main(void)                                                                                 \
    {                                                                                              \
        return test_run(set_up, tear_down);                                                        \
    }

#endif
