/* test_staging_buffer.c - data put into a staging buffer is sent in order and complete, also if
 * several threads fill it. */
#include "base/context.h"
#include "libbake/device/compute/compute.h"
#include "tests/unit/test.h"

enum { PIECE = (5 << 20) + 3, TOTAL = 24 << 20 };

struct sink {
    struct bake_staging_buffer staging;
    char *bytes;
    uint64_t count;
    unsigned expected_turn;
    int left; /* halves that are accepted before one is refused */
};

static int take(void *device, unsigned turn, uint64_t bytes)
{
    struct sink *sink = device;

    assert_int_equal(turn, sink->expected_turn);
    sink->expected_turn ^= 1;
    if (sink->left-- == 0)
        return BSQ_ENODEVICE;
    memcpy(sink->bytes + sink->count, sink->staging.halves[turn], bytes);
    sink->count += bytes;
    /* The device has copied it; the other half is filled next. */
    memset(sink->staging.halves[turn], 0xee, bytes);
    return 0;
}

static void open_sink(struct sink *sink, struct bsq_ctx *ctx, int left)
{
    *sink = (struct sink){.bytes = malloc(TOTAL), .left = left};
    sink->staging = (struct bake_staging_buffer){.halves = {malloc(PIECE), malloc(PIECE)},
                                                 .half_bytes = PIECE,
                                                 .send = take,
                                                 .device = sink,
                                                 .ctx = ctx};
}

static void close_sink(struct sink *sink)
{
    free(sink->bytes);
    free(sink->staging.halves[0]);
    free(sink->staging.halves[1]);
}

static char *numbers(void)
{
    char *data = malloc(TOTAL);
    for (uint32_t i = 0; i < TOTAL / 4; i++)
        memcpy(data + 4 * i, &(uint32_t){i * 2654435761u}, 4);
    return data;
}

static void put_in_parts(struct bsq_ctx *ctx)
{
    static const uint64_t parts[] = {1, (1 << 20) + 1, 7, 11 << 20, 1 << 20, 4 << 20};
    char *data = numbers();
    uint64_t at = 0;
    struct sink sink;

    open_sink(&sink, ctx, 1000);
    for (size_t i = 0; i < sizeof parts / sizeof *parts; at += parts[i++])
        assert_int_equal(bake_staging_put(&sink.staging, data + at, parts[i]), 0);
    assert_int_equal(bake_staging_put(&sink.staging, data + at, TOTAL - at), 0);
    assert_int_equal(bake_staging_flush(&sink.staging), 0);
    assert_int_equal(bake_staging_flush(&sink.staging), 0); /* nothing is left */
    assert_int_equal(sink.count, TOTAL);
    assert_memory_equal(sink.bytes, data, TOTAL);
    close_sink(&sink);
    free(data);
}

TEST(test_one_thread)
{
    put_in_parts(NULL);
}

TEST(test_threads)
{
    for (unsigned threads = 1; threads <= 4; threads++) {
        struct bsq_ctx *ctx;
        assert_int_equal(bsq_ctx_create(&(struct bsq_ctx_options){.threads = threads}, &ctx), 0);
        put_in_parts(ctx);
        bsq_ctx_destroy(ctx);
    }
}

TEST(test_refusal)
{
    char *data = numbers();
    struct sink sink;

    (void)state;
    open_sink(&sink, NULL, 2);
    assert_int_equal(bake_staging_put(&sink.staging, data, TOTAL), BSQ_ENODEVICE);
    assert_int_equal(sink.count, 2 * PIECE);
    close_sink(&sink);
    free(data);
}

RUN_TESTS(NULL, NULL)
