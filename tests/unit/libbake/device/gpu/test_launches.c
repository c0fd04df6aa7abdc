/* test_launches.c - batches have all samples of a patch; unions of time spans. */
#include "libbake/device/gpu/gpu.h"
#include "libbake/device/scene/scene.h"
#include "tests/unit/test.h"

enum { WIDTH = 40, HEIGHT = 24 };

/* Traces the batches of a patch: counts the samples of each texel, in the order of their lines.
 * Returns the number of batches. */
static uint32_t trace_batches(const struct bk_params *params, const struct bk_patch *patch)
{
    static uint32_t lines[HEIGHT][WIDTH];
    const struct bk_batch first = bake_first_batch(params, patch);
    struct bk_batch batch = first;
    uint32_t count = 0;
    memset(lines, 0, sizeof lines);
    do {
        const uint64_t samples = (uint64_t)(batch.end_row - batch.first_row) *
                                 (batch.end_column - batch.first_column) *
                                 (batch.end_line - batch.first_line) * params->samples;
        assert_in_range(samples, 1, bake_batch_samples(params));
        assert_true(params->samples > BAKE_BATCH_THREAD ||
                    (batch.end_line - batch.first_line) * params->samples <= BAKE_BATCH_THREAD);
        for (uint32_t y = batch.first_row; y < batch.end_row; y++)
            for (uint32_t x = batch.first_column; x < batch.end_column; x++) {
                assert_int_equal(lines[y][x], batch.first_line);
                lines[y][x] = batch.end_line;
            }
        count++;
    } while (bake_next_batch(params, patch, &first, &batch));
    for (uint32_t y = 0; y < patch->height; y++)
        for (uint32_t x = 0; x < patch->width; x++)
            assert_int_equal(lines[y][x], params->samples);
    return count;
}

/* The batches of a patch have all of its samples once, whatever the numbers of samples and rays;
 * the lines of a texel follow each other. */
TEST(test_batches_have_all_samples)
{
    static const uint32_t rays[] = {0, 1, 16, 100, 4096};
    const struct bk_patch patches[] = {{0, 0, WIDTH, HEIGHT}, {8, 8, 1, HEIGHT}, {0, 0, WIDTH, 1}};
    (void)state;
    for (size_t p = 0; p < sizeof patches / sizeof *patches; p++)
        for (size_t r = 0; r < sizeof rays / sizeof *rays; r++)
            for (uint32_t n = 1; n <= BAKE_MAX_SAMPLES; n++) {
                const struct bk_params params = {
                    .maps = 1u << BK_MAP_ao, .samples = n, .open_rays = rays[r]};
                trace_batches(&params, &patches[p]);
            }
}

/* A batch is limited by samples, and by rays: of a patch with 256 rays a texel, 2^14 texels. */
TEST(test_sizes_of_batches)
{
    const struct bk_patch patch = {0, 0, 256, 256};
    struct bk_params params = {.maps = 1u << BK_MAP_ao, .samples = 1, .open_rays = 256};
    struct bk_batch first = bake_first_batch(&params, &patch);
    (void)state;
    assert_int_equal(first.end_column, 256);
    assert_int_equal(first.end_row, 64);
    params.maps = 1u << BK_MAP_normal;
    first = bake_first_batch(&params, &patch);
    assert_int_equal(first.end_row, 256);
    params.samples = 64;
    first = bake_first_batch(&params, &patch);
    assert_int_equal(first.end_line, 4);
    assert_int_equal(first.end_row * first.end_column * 256, BAKE_BATCH_SAMPLES);
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

/* What all workers have started at a time is limited, or an interruption would wait for it. */
TEST(test_windows)
{
    const struct bk_params few = {.samples = 2};
    const struct bk_params many = {.samples = 2, .maps = 1u << BK_MAP_ao, .open_rays = 64};
    (void)state;
    assert_int_equal(bake_patch_windows(&few, 1 << 16, 1), 2);
    assert_int_equal(bake_patch_windows(&few, 1 << 16, 128), 2);
    assert_int_equal(bake_patch_windows(&few, 1 << 16, 129), 1);
    assert_int_equal(bake_patch_windows(&many, 1 << 16, 3), 2);
    assert_int_equal(bake_patch_windows(&many, 1 << 16, 4), 1);
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
