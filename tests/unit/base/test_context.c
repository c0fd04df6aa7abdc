/* test_context.c - errors, warnings, interruption, the memory budget, progress, octahedral normals.
 */
#include <errno.h>
#include <time.h>

#include "base/context_internal.h"
#include "base/geometry/vec.h"
#include "base/parallel.h"
#include "tests/unit/test.h"
#include "tests/unit/sanitized.h"

#if TEST_SANITIZED
/* The sanitizers call these. Allocations that are too large then return NULL, as without them. */
const char *__asan_default_options(void);
const char *__tsan_default_options(void);
const char *__asan_default_options(void)
{
    return "allocator_may_return_null=1";
}
const char *__tsan_default_options(void)
{
    return "allocator_may_return_null=1";
}
#endif

/* ---- creation ---- */

TEST(test_defaults)
{
    struct bsq_ctx *ctx;
    setenv("TMPDIR", "/somewhere", 1);
    assert_int_equal(bsq_ctx_create(NULL, &ctx), 0);
    unsetenv("TMPDIR");
    assert_true(bsq_threads(ctx) >= 1);
    assert_true(bsq_memory_limit(ctx) > 1 << 20);
    assert_string_equal(bsq_tmpdir(ctx), "/somewhere");
    assert_string_equal(bsq_error(ctx), "");
    bsq_ctx_destroy(ctx);
    assert_int_equal(bsq_ctx_create(NULL, &ctx), 0);
    assert_null(bsq_tmpdir(ctx));
    bsq_ctx_destroy(ctx);
    bsq_ctx_destroy(NULL);
}

TEST(test_options_are_copied)
{
    char directory[] = "/one";
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.memory_bytes = 12345, .threads = 3, .tmpdir = directory};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    memset(directory, 'x', sizeof directory - 1);
    assert_string_equal(bsq_tmpdir(ctx), "/one");
    assert_int_equal(bsq_threads(ctx), 3);
    assert_int_equal(bsq_memory_limit(ctx), 12345);
    bsq_ctx_destroy(ctx);
}

/* ---- errors ---- */

CONTEXT_TEST(test_first_failure_wins, 1, 0)
{
    assert_int_equal(bsq_fail(ctx, BSQ_EDATA, "scan.obj:%d: no such vertex", 12), BSQ_EDATA);
    assert_int_equal(bsq_fail(ctx, BSQ_EIO, "later"), BSQ_EIO);
    assert_string_equal(bsq_error(ctx), "scan.obj:12: no such vertex");
    bsq_clear_error(ctx);
    assert_string_equal(bsq_error(ctx), "");
    bsq_fail(ctx, BSQ_EIO, "another job");
    assert_string_equal(bsq_error(ctx), "another job");
}

TEST(test_errno_maps_to_status)
{
    static const struct {
        int errnum, status;
    } cases[] = {
        {ENOSPC, BSQ_EIO},    {EDQUOT, BSQ_EIO},      {EIO, BSQ_EIO},
        {ENOMEM, BSQ_ENOMEM}, {EACCES, BSQ_ENOINPUT}, {ENOENT, BSQ_ENOINPUT},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct bsq_ctx *ctx = test_context(1, 0);
        char expected[256];
        snprintf(expected, sizeof expected, "a/b: %s", strerror(cases[i].errnum));
        assert_int_equal(bsq_fail_errno(ctx, BSQ_ENOINPUT, cases[i].errnum, "%s", "a/b"),
                         cases[i].status);
        assert_string_equal(bsq_error(ctx), expected);
        bsq_ctx_destroy(ctx);
    }
}

CONTEXT_TEST(test_messages_are_one_line_of_any_length, 1, 0)
{
    char *name = malloc(100001);
    memset(name, 'n', 100000);
    name[100000] = '\0';
    name[5] = '\n';
    bsq_fail(ctx, BSQ_EDATA, "%s!", name);
    assert_int_equal(strlen(bsq_error(ctx)), 100004); /* the newline is "\\x0a" */
    assert_null(strchr(bsq_error(ctx), '\n'));
    free(name);
}

static int fail_each(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    struct bsq_ctx *ctx = arg;
    /* Two codes, so that a code that does not belong to the text is found. */
    int status = index % 2 ? BSQ_EDATA : BSQ_EIO;
    return bsq_fail(ctx, status, "%d", status);
}

TEST(test_code_and_text_agree)
{
    for (int round = 0; round < 200; round++) {
        struct bsq_ctx *ctx = test_context(4, 0);
        int status = bsq_parallel_for(ctx, 64, fail_each, ctx);
        assert_int_equal(status, atoi(bsq_error(ctx)));
        bsq_ctx_destroy(ctx);
    }
}

struct heard {
    int count;
    char last[64];
};

static void hear(void *user, const char *line)
{
    struct heard *heard = user;
    heard->count++;
    snprintf(heard->last, sizeof heard->last, "%s", line);
}

static int warn_each(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    bsq_warn(arg, "line %d", (int)index % 7);
    return 0;
}

TEST(test_warnings_come_one_at_a_time)
{
    struct heard heard = {0};
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.threads = 4, .on_warning = hear, .user = &heard};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    assert_int_equal(bsq_parallel_for(ctx, 1000, warn_each, ctx), 0);
    assert_int_equal(heard.count, 1000); /* hear() takes no lock, so a race would lose some */
    bsq_warn(ctx, "two\nlines");
    assert_string_equal(heard.last, "two\\x0alines");
    bsq_ctx_destroy(ctx);
}

CONTEXT_TEST(test_interruption, 1, 0)
{
    assert_int_equal(bsq_check(ctx), 0);
    bsq_interrupt(ctx);
    assert_int_equal(bsq_check(ctx), BSQ_EINTR);
    assert_string_equal(bsq_error(ctx), "interrupted");
    bsq_clear_error(ctx); /* a caller that can go on without what failed must still stop */
    assert_int_equal(bsq_check(ctx), BSQ_EINTR);
    bsq_clear_error(ctx);
    bsq_clear_interruption(ctx);
    assert_int_equal(bsq_check(ctx), 0);
}

/* ---- memory ---- */

/* Small blocks count their header and alignment, and what malloc() adds. */
CONTEXT_TEST(test_cost_of_blocks, 1, 0)
{
    const uint64_t huge = (uint64_t)2 << 20;
    for (uint64_t bytes = 0; bytes < huge - 4096; bytes = bytes * 3 + 1) {
        char *block;
        assert_int_equal(bsq_alloc(ctx, "block", bytes, 1, &block), 0);
        assert_in_range(bsq_memory_used(ctx), bytes + 128 + 8, bytes + 128 + 8 + 15);
        assert_int_equal(bsq_memory_used(ctx), bsq_block_cost(bytes));
        bsq_free(ctx, block);
        assert_int_equal(bsq_memory_used(ctx), 0);
    }
}

TEST(test_budget)
{
    const uint64_t cost_a = bsq_block_cost(600), cost_b = bsq_block_cost(400);
    struct bsq_ctx *ctx = test_context(1, cost_a + cost_b);
    char *a, *b, message[128];
    assert_int_equal(bsq_alloc(ctx, "first", 100, 6, &a), 0);
    assert_int_equal(bsq_memory_used(ctx), cost_a);
    assert_int_equal(bsq_alloc(ctx, "second", 416, 1, &b), BSQ_ENOMEM);
    assert_null(b);
    snprintf(message, sizeof message,
             "the memory budget is too small: second needs %llu bytes, %llu of %llu are in use",
             (unsigned long long)bsq_block_cost(416), (unsigned long long)cost_a,
             (unsigned long long)(cost_a + cost_b));
    assert_string_equal(bsq_error(ctx), message);
    assert_int_equal(bsq_memory_used(ctx), cost_a);
    assert_int_equal(bsq_alloc(ctx, "second", 400, 1, &b), 0);
    assert_int_equal(bsq_memory_high(ctx), cost_a + cost_b);
    bsq_free(ctx, a);
    assert_int_equal(bsq_memory_used(ctx), cost_b);
    assert_int_equal(bsq_reserve(ctx, "cache", cost_a + 1), BSQ_ENOMEM);
    assert_int_equal(bsq_reserve(ctx, "cache", cost_a), 0);
    bsq_release(ctx, cost_a);
    BSQ_FREE(ctx, b, NULL);
    assert_int_equal(bsq_memory_used(ctx), 0);
    assert_int_equal(bsq_memory_high(ctx), cost_a + cost_b);
    bsq_ctx_destroy(ctx);
}

CONTEXT_TEST(test_sizes_that_overflow, 1, UINT64_MAX)
{
    static const uint64_t sizes[][2] = {
        {UINT64_MAX, 2}, {UINT64_C(1) << 32, UINT64_C(1) << 32}, {UINT64_MAX, 1}, {INT64_MAX, 1}};
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        void *memory = ctx;
        uint64_t capacity = 0;
        assert_int_equal(bsq_alloc(ctx, "x", sizes[i][0], sizes[i][1], &memory), BSQ_ENOMEM);
        assert_null(memory);
        assert_int_equal(bsq_calloc(ctx, "x", sizes[i][0], sizes[i][1], &memory), BSQ_ENOMEM);
        assert_int_equal(bsq_grow(ctx, "x", sizes[i][0], sizes[i][1], &memory, &capacity),
                         BSQ_ENOMEM);
        assert_null(memory);
        assert_int_equal(capacity, 0);
    }
    /* The size does not overflow, but no system has that much memory. */
    void *memory;
    assert_int_equal(bsq_alloc(ctx, "x", INT64_MAX / 2, 1, &memory), BSQ_ENOMEM);
    assert_int_equal(bsq_memory_used(ctx), 0);
}

CONTEXT_TEST(test_blocks_are_aligned_and_zeroed, 1, 0)
{
    for (uint64_t size = 0; size < 5000000; size = size * 3 + 1) {
        unsigned char *plain, *zeroed;
        assert_int_equal(bsq_alloc(ctx, "plain", size, 1, &plain), 0);
        assert_non_null(plain);
        assert_int_equal((uintptr_t)plain % 64, 0);
        memset(plain, 0xab, size);
        bsq_free(ctx, plain);
        assert_int_equal(bsq_calloc(ctx, "zeroed", size, 1, &zeroed), 0);
        assert_int_equal((uintptr_t)zeroed % 64, 0);
        for (uint64_t i = 0; i < size; i++)
            assert_int_equal(zeroed[i], 0);
        bsq_free(ctx, zeroed);
    }
}

CONTEXT_TEST(test_growing_keeps_content, 1, 0)
{
    uint32_t *list = NULL;
    uint64_t capacity = 0, moves = 0;
    for (uint32_t i = 0; i < 1000000; i++) {
        uint64_t before = capacity;
        assert_int_equal(BSQ_GROW(ctx, "list", i + UINT64_C(1), &list, &capacity), 0);
        moves += capacity != before;
        assert_int_equal((uintptr_t)list % 64, 0);
        list[i] = i * 2654435761u;
    }
    for (uint32_t i = 0; i < 1000000; i++)
        assert_int_equal(list[i], i * 2654435761u);
    assert_true(moves < 50); /* log 1e6 / log 1.5 = 34 */
    assert_int_equal(bsq_memory_used(ctx), bsq_block_cost(capacity * sizeof *list));
    bsq_free(ctx, list);
}

/* Blocks below and above the size of a huge page, which are allocated in different ways. */
CONTEXT_TEST(test_large_blocks, 1, 64 << 20)
{
    const uint64_t huge = (uint64_t)2 << 20;
    for (uint64_t bytes = huge - 1; bytes < huge + 8192; bytes += bytes < huge + 1 ? 1 : 4095) {
        uint8_t *block;
        assert_int_equal(bsq_calloc(ctx, "testing", bytes, 1, &block), 0);
        assert_int_equal((uintptr_t)block % 64, 0);
        assert_int_equal(bsq_memory_used(ctx), bsq_block_cost(bytes));
        assert_int_equal(block[0] | block[bytes / 2] | block[bytes - 1], 0);
        memset(block, 0xa5, bytes);
        bsq_free(ctx, block);
        assert_int_equal(bsq_memory_used(ctx), 0);
    }
    uint32_t *numbers = NULL;
    uint64_t capacity = 0;
    for (uint64_t count = 1000; count < 12000000; count += count / 3) {
        uint64_t before = capacity;
        assert_int_equal(bsq_grow(ctx, "testing", count, 4, &numbers, &capacity), 0);
        for (uint64_t i = before; i < capacity; i++)
            numbers[i] = (uint32_t)i * 0x9e3779b1u;
        for (uint64_t i = 0; i < capacity; i += 97)
            assert_int_equal(numbers[i], (uint32_t)i * 0x9e3779b1u);
    }
    assert_int_equal(bsq_memory_used(ctx), bsq_block_cost(4 * capacity));
    bsq_free(ctx, numbers);
    assert_int_equal(bsq_memory_used(ctx), 0);
}

TEST(test_growing_up_to_the_budget)
{
    struct bsq_ctx *ctx = test_context(1, bsq_block_cost(1000));
    char *list = NULL;
    uint64_t capacity = 0;
    assert_int_equal(bsq_grow(ctx, "list", 800, 1, &list, &capacity), 0);
    memset(list, 'a', 800);
    assert_int_equal(bsq_grow(ctx, "list", 1000, 1, &list, &capacity), 0);
    assert_int_equal(capacity, 1000);
    assert_int_equal(bsq_grow(ctx, "list", 1017, 1, &list, &capacity), BSQ_ENOMEM);
    assert_int_equal(capacity, 1000);
    for (int i = 0; i < 800; i++)
        assert_int_equal(list[i], 'a');
    bsq_free(ctx, list);
    bsq_ctx_destroy(ctx);
}

static int alloc_some(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    struct bsq_ctx *ctx = arg;
    void *memory;
    int status = bsq_alloc(ctx, "some", index % 97 + 1, 10, &memory);
    bsq_free(ctx, memory);
    return status;
}

TEST(test_budget_with_threads)
{
    struct bsq_ctx *ctx = test_context(4, 4 * bsq_block_cost(970));
    assert_int_equal(bsq_parallel_for(ctx, 50000, alloc_some, ctx), 0);
    assert_int_equal(bsq_memory_used(ctx), 0);
    assert_in_range(bsq_memory_high(ctx), bsq_block_cost(970), 4 * bsq_block_cost(970));
    bsq_ctx_destroy(ctx);
}

/* ---- progress ---- */

struct seen {
    unsigned reports, finished, disorder;
    uint64_t last;
    const char *stage;
};

static void see(void *user, const struct bsq_progress *progress)
{
    struct seen *seen = user;
    seen->reports++;
    seen->disorder += progress->done < seen->last || progress->done > progress->total;
    seen->last = progress->done;
    seen->stage = progress->stage;
    if (progress->finished) {
        seen->finished++;
        seen->last = 0;
    }
}

static int add_slowly(void *arg, uint64_t index, unsigned worker)
{
    (void)index, (void)worker;
    nanosleep(&(struct timespec){.tv_nsec = 100000}, NULL);
    bsq_progress_add(arg, 3);
    return 0;
}

TEST(test_progress)
{
    struct seen seen = {0};
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.threads = 4, .on_progress = see, .user = &seen};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    struct timespec from, to;
    clock_gettime(CLOCK_MONOTONIC, &from);
    bsq_progress_begin(ctx, "testing", "steps", 12000);
    assert_int_equal(bsq_parallel_for(ctx, 4000, add_slowly, ctx), 0);
    bsq_progress_end(ctx);
    clock_gettime(CLOCK_MONOTONIC, &to);
    double seconds = (double)(to.tv_sec - from.tv_sec) + (double)(to.tv_nsec - from.tv_nsec) * 1e-9;
    assert_int_equal(seen.disorder, 0);
    assert_int_equal(seen.finished, 1);
    assert_string_equal(seen.stage, "testing");
    assert_in_range(seen.reports, 2, (unsigned)(seconds * 11) + 3);
    bsq_progress_add(ctx, 1); /* outside of a stage: no report */
    bsq_progress_end(ctx);
    assert_int_equal(seen.finished, 1);
    bsq_ctx_destroy(ctx);
}

static void note_done(void *user, const struct bsq_progress *progress)
{
    *(uint64_t *)user = progress->done;
}

/* Shares that follow each other add up to all units, however they are rounded. */
TEST(test_shares_of_progress_add_up)
{
    uint64_t done = 0;
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.on_progress = note_done, .user = &done};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    bsq_progress_begin(ctx, "testing", "steps", 1000);
    for (int i = 0; i < 7; i++)
        bsq_progress_add_share(ctx, 1000, i / 7.0, (i + 1) / 7.0);
    bsq_progress_end(ctx);
    assert_int_equal(done, 1000);
    bsq_ctx_destroy(ctx);
}

/* ---- octahedral normals ---- */

static double angle_degrees(struct bsq_vec3 a, struct bsq_vec3 b)
{
    double x = (double)a.y * b.z - (double)a.z * b.y, y = (double)a.z * b.x - (double)a.x * b.z,
           z = (double)a.x * b.y - (double)a.y * b.x;
    double dot = (double)a.x * b.x + (double)a.y * b.y + (double)a.z * b.z;
    return atan2(sqrt(x * x + y * y + z * z), dot) * 180 / acos(-1);
}

TEST(test_octahedral_error)
{
    /* A Fibonacci lattice covers the sphere evenly. The bounds are those of 2 x 16 bits in Cigolle
     * et al. 2014. */
    const int count = 200000;
    double sum = 0, worst = 0;
    for (int i = 0; i < count; i++) {
        double z = 1 - (2 * i + 1.0) / count, r = sqrt(1 - z * z), a = 2.399963229728653 * i;
        struct bsq_vec3 v = bsq_v3((float)(r * cos(a)), (float)(r * sin(a)), (float)z);
        struct bsq_vec3 u = bsq_oct_unpack(bsq_oct_pack(v));
        double angle = angle_degrees(u, v);
        assert_true(fabs(bsq_length3(u) - 1) < 1e-6);
        sum += angle;
        worst = angle > worst ? angle : worst;
    }
    assert_true(sum / count < 0.0014);
    assert_true(worst < 0.0038);
}

TEST(test_octahedral_corners)
{
    for (int axis = 0; axis < 6; axis++) {
        float s = axis & 1 ? -1.0f : 1.0f;
        struct bsq_vec3 v =
            bsq_v3(axis / 2 == 0 ? s : 0, axis / 2 == 1 ? s : 0, axis / 2 == 2 ? s : 0);
        assert_true(angle_degrees(bsq_oct_unpack(bsq_oct_pack(v)), v) < 1e-6);
    }
    assert_int_equal(bsq_oct_pack(bsq_v3(0, 0, 1)), 0);
    assert_int_equal(bsq_oct_pack(bsq_v3(1, 0, 0)), 0x00007fff);
    assert_int_equal(bsq_oct_pack(bsq_v3(0, -1, 0)), 0x80010000);
    assert_int_equal(bsq_oct_pack(bsq_v3(0, 0, 0)), 0);
    assert_int_equal(bsq_oct_pack(bsq_v3(NAN, 0, 1)), 0);
    uint32_t any = 1;
    for (int i = 0; i < 100000; i++, any = any * 1664525u + 1013904223u)
        assert_true(fabs(bsq_length3(bsq_oct_unpack(any)) - 1) < 1e-6);
    assert_true(fabs(bsq_length3(bsq_oct_unpack(0x80008000u)) - 1) < 1e-6);
}

RUN_TESTS(NULL, NULL)
