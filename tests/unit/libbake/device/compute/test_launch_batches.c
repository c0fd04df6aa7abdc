/* test_launch_batches.c - launch batches follow measured times. */
#include <stdint.h>

#include "libbake/device/compute/launch_batches.h"
#include "libbake/device/job/job.h"
#include "tests/unit/test.h"

TEST(test_batches_follow)
{
    struct bake_batch_sizer sizer = {0};
    (void)state;
    assert_int_equal(bake_batch_rows(&sizer, 1024, 256), BAKE_BATCH_FIRST / 1024);
    assert_int_equal(bake_batch_rows(&sizer, 1024, 64), 64);
    assert_int_equal(bake_batch_rows(&sizer, BAKE_BATCH_FIRST * 10, 64), 1);
    /* A fast device: fourfold, not more. */
    bake_batch_sizer_learn(&sizer, 1 << 17, 1e-4);
    assert_int_equal(sizer.samples, 4 * BAKE_BATCH_FIRST);
    /* A slow device, 10^6 samples a second: at once. */
    bake_batch_sizer_learn(&sizer, 1000000, 1.0);
    assert_int_equal(sizer.samples, 1000000 * BAKE_BATCH_SECONDS);
    assert_int_equal(bake_batch_rows(&sizer, 1000, 256), 50);
    /* A clock that stands still, and one that is far off. */
    bake_batch_sizer_learn(&sizer, 1000000, 0.0);
    assert_int_equal(sizer.samples, 4 * 50000);
    bake_batch_sizer_learn(&sizer, 1, 1e9);
    assert_int_equal(sizer.samples, BAKE_BATCH_LEAST);
    for (int i = 0; i < 100; i++)
        bake_batch_sizer_learn(&sizer, UINT64_MAX, 0.0);
    assert_int_equal(bake_batch_rows(&sizer, 1, UINT32_MAX), UINT32_MAX);
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

RUN_TESTS(NULL, NULL)
