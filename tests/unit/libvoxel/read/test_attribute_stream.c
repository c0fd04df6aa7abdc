/* Tests attribute streams: appended elements are read back, from memory and from a file, while
 * another thread prefaults memory; and memory is resident before it is filled. */
#include "libvoxel/read/attribute_stream.h"
#include "tests/unit/test.h"

#include <pthread.h>
#include <stdatomic.h>
#include <sys/mman.h>

#define MIB ((uint64_t)1 << 20)

enum { ELEMENT = 16 }; /* bytes */

static struct bsq_ctx *create(void)
{
    struct bsq_ctx_options options = {.memory_bytes = 256 * MIB, .threads = 2, .tmpdir = "/tmp"};
    struct bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

static uint8_t expected_byte(uint64_t at)
{
    return (uint8_t)(at * 7 + at / 251 + 1);
}

static void append(struct attribute_stream *stream, uint64_t count)
{
    for (uint64_t done = 0; done < count;) {
        uint8_t *at;
        uint64_t capacity, begin = stream->count * ELEMENT;
        assert_int_equal(vox_stream_reserve(stream, &at, &capacity), 0);
        capacity = capacity < 416 ? capacity : 416;
        capacity = capacity < count - done ? capacity : count - done;
        for (uint64_t i = 0; i < capacity * ELEMENT; i++)
            at[i] = expected_byte(begin + i);
        assert_int_equal(vox_stream_advance(stream, capacity), 0);
        done += capacity;
    }
}

static void expect_content(struct attribute_stream *stream, uint64_t count)
{
    uint8_t *all = malloc(count * ELEMENT);
    assert_non_null(all);
    assert_int_equal(stream->count, count);
    assert_int_equal(stream_read(stream, 0, count, all), 0);
    for (uint64_t i = 0; i < count * ELEMENT; i++)
        if (all[i] != expected_byte(i))
            fail_msg("byte %llu", (unsigned long long)i);
    free(all);
}

struct prefaulter {
    struct attribute_stream *stream;
    atomic_bool stop;
};

static void *prefault(void *arg)
{
    struct prefaulter *prefaulter = arg;
    while (!atomic_load(&prefaulter->stop))
        vox_stream_prefault(prefaulter->stream);
    return NULL;
}

TEST(content_stays_while_another_thread_prefaults)
{
    static const uint32_t shifts[] = {12, 17, 19};
    for (int s = 0; s < 3; s++)
        for (int evicted = 0; evicted < 2; evicted++) {
            struct bsq_ctx *ctx = create();
            struct attribute_stream stream;
            struct prefaulter prefaulter = {.stream = &stream};
            pthread_t thread;
            assert_int_equal(vox_stream_init(&stream, ctx, "testing", "/tmp/x", ELEMENT, shifts[s]),
                             0);
            assert_int_equal(pthread_create(&thread, NULL, prefault, &prefaulter), 0);
            append(&stream, 17 * MIB / ELEMENT + 77);
            if (evicted)
                assert_int_equal(vox_stream_evict(&stream), 0);
            append(&stream, 3 * MIB / ELEMENT);
            atomic_store(&prefaulter.stop, true);
            assert_int_equal(pthread_join(thread, NULL), 0);
            assert_int_equal(bsq_spill_in_file(&stream.spill), evicted);
            assert_true(!evicted || stream_memory(&stream) == (uint64_t)ELEMENT << shifts[s]);
            assert_int_equal(vox_stream_finish(&stream), 0);
            assert_true(evicted ? stream_memory(&stream) == 0 : stream_memory(&stream) >= 20 * MIB);
            expect_content(&stream, 20 * MIB / ELEMENT + 77);
            vox_stream_free(&stream);
            test_context_end(ctx);
        }
}

/* Returns how many of the pages are resident. */
static uint64_t resident(uint8_t *at, uint64_t size)
{
    const uint64_t page = (uint64_t)sysconf(_SC_PAGE_SIZE);
    unsigned char *pages = calloc(size / page, 1);
    uint64_t count = 0;
    assert_non_null(pages);
    assert_int_equal(mincore(at, size, pages), 0);
    for (uint64_t i = 0; i < size / page; i++)
        count += pages[i] & 1;
    free(pages);
    return count * page;
}

/* Prefaults at most two huge pages ahead, because a scan does not fill its last segment. */
TEST(memory_is_there_before_it_is_filled)
{
    struct bsq_ctx *ctx = create();
    struct attribute_stream stream;
    uint8_t *at;
    uint64_t capacity;
    assert_int_equal(vox_stream_init(&stream, ctx, "testing", "/tmp/x", ELEMENT, 21), 0);
    vox_stream_prefault(&stream); /* nothing to prefault yet */
    assert_int_equal(vox_stream_reserve(&stream, &at, &capacity), 0);
    uint8_t *segment = at;
    if ((uintptr_t)segment % (2 * MIB) != 0) { /* address sanitizers align blocks in another way */
        vox_stream_free(&stream);
        bsq_ctx_destroy(ctx);
        skip();
    }
    /* Some systems do not support this, and emulators say that they did it. */
    if (madvise(segment, 1, MADV_POPULATE_WRITE) != 0 ||
        resident(segment, (uint64_t)sysconf(_SC_PAGE_SIZE)) == 0) {
        vox_stream_free(&stream);
        bsq_ctx_destroy(ctx);
        skip();
    }
    for (int i = 0; i < 10; i++)
        vox_stream_prefault(&stream);
    assert_int_equal(resident(segment, 4 * MIB), 4 * MIB);
    assert_int_equal(resident(segment + 4 * MIB, 28 * MIB), 0);
    append(&stream, 8 * MIB / ELEMENT);
    for (int i = 0; i < 10; i++)
        vox_stream_prefault(&stream);
    assert_int_equal(resident(segment, 12 * MIB), 12 * MIB);
    assert_int_equal(resident(segment + 12 * MIB, 20 * MIB), 0);
    expect_content(&stream, 8 * MIB / ELEMENT);
    vox_stream_free(&stream);
    bsq_ctx_destroy(ctx);
}

RUN_TESTS(NULL, NULL)
