/* test_launches.c - launch batches follow measured times; unions of time spans. */
#include "libbake/device/compute/compute.h"
#include "libbake/device/job/job.h"
#include "tests/unit/test.h"

TEST(test_batches_follow)
{
    struct bake_batch_sizer sizer = {0};
    (void)state;
    assert_int_equal(bake_batch_rows(&sizer, 16, 64, 256), BAKE_BATCH_FIRST / 1024);
    assert_int_equal(bake_batch_rows(&sizer, 16, 64, 64), 64);
    assert_int_equal(bake_batch_rows(&sizer, BAKE_BATCH_FIRST, 10, 64), 1);
    /* A fast device: fourfold, not more. */
    bake_batch_sizer_learn(&sizer, 16, 1 << 17, 1e-4);
    assert_int_equal(sizer.samples, 4 * BAKE_BATCH_FIRST);
    /* A slow device, 10^6 samples a second: at once. */
    bake_batch_sizer_learn(&sizer, 16, 1000000, 1.0);
    assert_int_equal(sizer.samples, 1000000 * BAKE_BATCH_SECONDS);
    assert_int_equal(bake_batch_rows(&sizer, 10, 100, 256), 50);
    /* A clock that stands still, and one that is far off. */
    bake_batch_sizer_learn(&sizer, 16, 1000000, 0.0);
    assert_int_equal(sizer.samples, 4 * 50000);
    bake_batch_sizer_learn(&sizer, 16, 1, 1e9);
    assert_int_equal(sizer.samples, BAKE_BATCH_LEAST);
    for (int i = 0; i < 100; i++)
        bake_batch_sizer_learn(&sizer, 16, UINT64_MAX, 0.0);
    assert_int_equal(bake_batch_rows(&sizer, 1, 1, UINT32_MAX), UINT32_MAX);
}

/* A device whose threads take 0.15 s for a launch of any size up to 100,000 texels: launches grow
 * until they are whole patches. A slow one, where more texels take longer, keeps to half a second.
 */
TEST(test_batches_of_slow_threads)
{
    enum { SAMPLES = 512, WIDTH = 64, HEIGHT = 64 };
    struct bake_batch_sizer fast = {0}, slow = {0};
    uint32_t rows = 0;
    (void)state;
    assert_int_equal(bake_batch_rows(&fast, SAMPLES, WIDTH, HEIGHT), BAKE_BATCH_TEXELS / WIDTH);
    for (int i = 0; i < 4; i++) {
        rows = bake_batch_rows(&fast, SAMPLES, WIDTH, HEIGHT);
        bake_batch_sizer_learn(&fast, SAMPLES, (uint64_t)SAMPLES * WIDTH * rows, 0.15);
    }
    assert_int_equal(bake_batch_rows(&fast, SAMPLES, WIDTH, HEIGHT), HEIGHT);
    for (int i = 0; i < 4; i++) {
        rows = bake_batch_rows(&slow, SAMPLES, WIDTH, HEIGHT);
        bake_batch_sizer_learn(&slow, SAMPLES, (uint64_t)SAMPLES * WIDTH * rows, 0.1 * rows);
    }
    assert_in_range(rows, 2, 5);
}

/* A launch never traces more samples of a texel than BAKE_BATCH_THREAD, and there are as few
 * launches as that allows. */
TEST(test_batches_of_texels)
{
    for (uint32_t n = 1; n <= BAKE_MAX_SAMPLES; n++) {
        const uint32_t lines = bake_batch_lines(n);
        assert_in_range(lines, 1, n);
        assert_true(lines * n <= BAKE_BATCH_THREAD);
        assert_true(lines == n || (lines + 1) * n > BAKE_BATCH_THREAD);
    }
}

TEST(test_overlaps_count_once)
{
    static struct bake_time_spans spans;
    (void)state;
    assert_true(bake_time_spans_seconds(&spans) == 0);
    bake_time_spans_add(&spans, &(struct bake_span){4, 6});
    bake_time_spans_add(&spans, &(struct bake_span){1, 2});
    bake_time_spans_add(&spans, &(struct bake_span){5, 7});
    bake_time_spans_add(&spans, &(struct bake_span){1.25, 1.5});
    bake_time_spans_add(&spans, &(struct bake_span){9, 9});
    bake_time_spans_add(&spans, &(struct bake_span){9, 8});
    assert_true(bake_time_spans_seconds(&spans) == 4);
    bake_time_spans_add(&spans, &(struct bake_span){2, 4});
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
        bake_time_spans_add(&spans, &(struct bake_span){start, end});
        at[q] = end;
    }
    for (int i = 0; i < STEPS; i++)
        expected += raster[i];
    assert_true(expected > STEPS / 2);
    assert_true(bake_time_spans_seconds(&spans) == expected);
}

RUN_TESTS(NULL, NULL)
