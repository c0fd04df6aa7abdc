/* test_time_spans.c - unions of time spans. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "libbake/device/compute/time_spans.h"
#include "tests/unit/test.h"

TEST(test_overlaps_count_once)
{
    static struct bake_time_spans spans;
    (void)state;
    assert_true(bake_time_spans_seconds(&spans) == 0);
    bake_time_spans_add(&spans, 4, 6);
    bake_time_spans_add(&spans, 1, 2);
    bake_time_spans_add(&spans, 5, 7);
    bake_time_spans_add(&spans, 1.25, 1.5);
    bake_time_spans_add(&spans, 9, 9);
    bake_time_spans_add(&spans, 9, 8);
    assert_true(bake_time_spans_seconds(&spans) == 4);
    bake_time_spans_add(&spans, 2, 4);
    assert_true(bake_time_spans_seconds(&spans) == 6);
}

/* Compares four streams with spans of random lengths to a raster of time. */
TEST(test_many)
{
    enum { QUEUES = 4, STEPS = 200000 };
    static struct bake_time_spans spans;
    static unsigned char raster[STEPS];
    int at[QUEUES] = {0};
    double expected = 0;
    (void)state;
    srand(1);
    for (;;) {
        int q = 0;
        for (int i = 1; i < QUEUES; i++)
            if (at[i] < at[q])
                q = i;
        int start = at[q] + rand() % 40, end = start + rand() % 20;
        if (end >= STEPS)
            break;
        for (int i = start; i < end; i++)
            raster[i] = 1;
        bake_time_spans_add(&spans, start, end);
        at[q] = end;
    }
    for (int i = 0; i < STEPS; i++)
        expected += raster[i];
    assert_true(expected > STEPS / 2);
    assert_true(bake_time_spans_seconds(&spans) == expected);
}

RUN_TESTS(NULL, NULL)
