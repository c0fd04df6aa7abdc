/* Tests spills: each stream gives back what was appended to it, whatever of it is in memory, being
 * filled or in the file; the limit of memory and the smallest number of bytes in the file hold. */
#include "base/spill.h"
#include "tests/unit/test.h"

#include <stdlib.h>

enum { STREAMS = 5, PAGE = 1000, STREAM_BYTES = 40000 };

static uint64_t spill_random(uint64_t *seed)
{
    *seed = *seed * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return *seed >> 33;
}

static uint8_t expected_byte(uint32_t stream, uint64_t at)
{
    return (uint8_t)(at * 7 + at / 251 + 31 * stream);
}

/* Appends blocks of up to 3000 bytes to streams in random order. bytes: of each stream so far. */
static void append_blocks(struct bsq_spill *spill, uint64_t *seed, uint64_t bytes[STREAMS])
{
    uint8_t block[3000];
    for (int i = 0; i < 100; i++) {
        const uint32_t stream = (uint32_t)(spill_random(seed) % spill->stream_count);
        const uint64_t size = spill_random(seed) % (sizeof block + 1);
        if (bytes[stream] + size > STREAM_BYTES)
            continue;
        for (uint64_t b = 0; b < size; b++)
            block[b] = expected_byte(stream, bytes[stream] + b);
        assert_int_equal(bsq_spill_add(spill, stream, block, size), 0);
        bytes[stream] += size;
    }
}

/* Reads all streams in random blocks, and the single one also backwards. */
static void expect_blocks(const struct bsq_spill *spill, uint64_t *seed,
                          const uint64_t bytes[STREAMS])
{
    uint8_t block[3000];
    for (uint32_t stream = 0; stream < spill->stream_count; stream++) {
        struct bsq_spill_cursor cursor = {0};
        assert_int_equal(spill->list[stream].bytes, bytes[stream]);
        for (uint64_t at = 0; at < bytes[stream];) {
            const uint64_t from = spill->stream_count > 1 ? at : spill_random(seed) % bytes[0];
            uint64_t size = spill_random(seed) % (sizeof block + 1);
            size = size < bytes[stream] - from ? size : bytes[stream] - from;
            assert_int_equal(bsq_spill_read(spill, stream, from, size, block,
                                            spill->stream_count > 1 ? &cursor : NULL),
                             0);
            for (uint64_t b = 0; b < size; b++)
                assert_int_equal(block[b], expected_byte(stream, from + b));
            at += size;
        }
    }
}

static void try_spill(uint64_t *seed, uint32_t streams, uint64_t memory, bool evicted, bool ended)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct bsq_spill spill;
    uint64_t bytes[STREAMS] = {0}, full = 0, all = 0;
    assert_int_equal(bsq_spill_init(&spill, ctx, "testing", ".", streams, streams, PAGE, memory),
                     0);
    append_blocks(&spill, seed, bytes);
    expect_blocks(&spill, seed, bytes);
    if (evicted)
        assert_int_equal(bsq_spill_evict(&spill, false), 0);
    append_blocks(&spill, seed, bytes);
    expect_blocks(&spill, seed, bytes);
    for (uint32_t i = 0; i < streams; i++) {
        full += bytes[i] / PAGE;
        all += bytes[i];
    }
    const uint64_t most = evicted ? 0 : memory / PAGE, kept = most > streams ? most - streams : 0;
    assert_int_equal(bsq_temp_bytes(ctx), full > kept ? (full - kept) * PAGE : 0);
    assert_int_equal(bsq_spill_in_file(&spill), evicted || full > kept);
    if (ended) {
        assert_int_equal(bsq_spill_evict(&spill, true), 0);
        assert_int_equal(bsq_temp_bytes(ctx), all);
        assert_int_equal(spill.slab_count, 0);
        expect_blocks(&spill, seed, bytes);
    }
    bsq_spill_free(&spill);
    test_context_end(ctx);
}

TEST(streams_give_back_what_was_appended)
{
    uint64_t seed = test_seed();
    for (uint64_t pages = 0; pages < 120; pages += 1 + pages / 4)
        for (uint32_t streams = 1; streams <= STREAMS; streams++)
            try_spill(&seed, streams, pages * PAGE, false, false);
    for (uint64_t pages = 0; pages < 60; pages += 7)
        for (int evicted = 0; evicted < 2; evicted++)
            for (int ended = 0; ended < 2; ended++)
                try_spill(&seed, 1, pages * PAGE, evicted, ended);
}

/* A page in memory for each stream that is used, and none for the others. */
TEST(streams_without_bytes_take_no_page)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct bsq_spill spill;
    static const uint8_t block[PAGE];
    assert_int_equal(bsq_spill_init(&spill, ctx, "testing", ".", 1000, 2, PAGE, 4 * PAGE), 0);
    for (int i = 0; i < 3; i++) {
        assert_int_equal(bsq_spill_add(&spill, 3, block, PAGE), 0);
        assert_int_equal(bsq_temp_bytes(ctx), i < 2 ? 0 : PAGE);
    }
    assert_int_equal(bsq_spill_add(&spill, 700, block, PAGE), 0);
    assert_int_equal(bsq_temp_bytes(ctx), 2 * PAGE);
    bsq_spill_free(&spill);
    test_context_end(ctx);
}

RUN_TESTS(NULL, NULL)
