/* Tests spill buffers: appended bytes are read back, from memory and from a file, while another
 * thread prefaults memory; and memory is resident before it is filled. */
#include "libvoxel/read/spill_buffer.h"
#include "tests/unit/test.h"

#include <pthread.h>
#include <stdatomic.h>
#include <sys/mman.h>

#define MIB ((uint64_t)1 << 20)

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

static void append(struct spill_buffer *spill, uint64_t size)
{
    for (uint64_t done = 0; done < size;) {
        uint8_t *at;
        uint64_t capacity, begin = spill->bytes;
        assert_int_equal(vox_spill_reserve(spill, &at, &capacity), 0);
        capacity = capacity < 5000 ? capacity : 5000;
        capacity = capacity < size - done ? capacity : size - done;
        for (uint64_t i = 0; i < capacity; i++)
            at[i] = expected_byte(begin + i);
        vox_spill_advance(spill, capacity);
        done += capacity;
    }
}

static void expect_content(struct spill_buffer *spill, uint64_t size)
{
    uint8_t *all = malloc(size);
    assert_non_null(all);
    assert_int_equal(spill->bytes, size);
    assert_int_equal(vox_spill_read(spill, 0, size, all), 0);
    for (uint64_t i = 0; i < size; i++)
        if (all[i] != expected_byte(i))
            fail_msg("byte %llu", (unsigned long long)i);
    free(all);
}

struct prefaulter {
    struct spill_buffer *spill;
    atomic_bool stop;
};

static void *prefault(void *arg)
{
    struct prefaulter *prefaulter = arg;
    while (!atomic_load(&prefaulter->stop))
        vox_spill_prefault(prefaulter->spill);
    return NULL;
}

TEST(content_stays_while_another_thread_prefaults)
{
    static const uint64_t segments[] = {100000, 5 * MIB + 4096, 6 * MIB};
    for (int s = 0; s < 3; s++)
        for (int spilled = 0; spilled < 2; spilled++) {
            struct bsq_ctx *ctx = create();
            struct spill_buffer spill;
            struct prefaulter prefaulter = {.spill = &spill};
            pthread_t thread;
            vox_spill_init(&spill, ctx, "testing", "/tmp/x", segments[s]);
            assert_int_equal(pthread_create(&thread, NULL, prefault, &prefaulter), 0);
            append(&spill, 17 * MIB);
            if (spilled)
                assert_int_equal(vox_spill_spill(&spill), 0);
            append(&spill, 3 * MIB);
            atomic_store(&prefaulter.stop, true);
            assert_int_equal(pthread_join(thread, NULL), 0);
            assert_int_equal(vox_spill_finish(&spill), 0);
            expect_content(&spill, 20 * MIB);
            vox_spill_free(&spill);
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
    struct spill_buffer spill;
    uint8_t *at;
    uint64_t capacity;
    vox_spill_init(&spill, ctx, "testing", "/tmp/x", 32 * MIB);
    vox_spill_prefault(&spill); /* nothing to prefault yet */
    assert_int_equal(vox_spill_reserve(&spill, &at, &capacity), 0);
    uint8_t *segment = at;
    if ((uintptr_t)segment % (2 * MIB) != 0) { /* address sanitizers align blocks in another way */
        vox_spill_free(&spill);
        bsq_ctx_destroy(ctx);
        skip();
    }
    /* Some systems do not support this, and emulators say that they did it. */
    if (madvise(segment, 1, MADV_POPULATE_WRITE) != 0 ||
        resident(segment, (uint64_t)sysconf(_SC_PAGE_SIZE)) == 0) {
        vox_spill_free(&spill);
        bsq_ctx_destroy(ctx);
        skip();
    }
    for (int i = 0; i < 10; i++)
        vox_spill_prefault(&spill);
    assert_int_equal(resident(segment, 4 * MIB), 4 * MIB);
    assert_int_equal(resident(segment + 4 * MIB, 28 * MIB), 0);
    append(&spill, 8 * MIB);
    for (int i = 0; i < 10; i++)
        vox_spill_prefault(&spill);
    assert_int_equal(resident(segment, 12 * MIB), 12 * MIB);
    assert_int_equal(resident(segment + 12 * MIB, 20 * MIB), 0);
    expect_content(&spill, 8 * MIB);
    vox_spill_free(&spill);
    bsq_ctx_destroy(ctx);
}

RUN_TESTS(NULL, NULL)
