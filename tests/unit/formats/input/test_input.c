/* test_input.c - inputs that are packed, and pipes: ranges, several openings, interruptions. */
#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <sys/stat.h>
#include <time.h>
#include <xxhash.h>
#include <zstd.h>

#include "base/file.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"
#include "tests/unit/formats/input/packing.h"
#include "tests/unit/test.h"

enum { NUMBERS = 3 << 20, BYTES = 4 * NUMBERS };

static uint32_t *numbers; /* each has its index, so that every range is known */

static int make_numbers(void **state)
{
    (void)state;
    numbers = malloc(BYTES);
    for (uint32_t i = 0; numbers && i < NUMBERS; i++)
        numbers[i] = i;
    return numbers ? 0 : -1;
}

static int free_numbers(void **state)
{
    (void)state;
    free(numbers);
    return 0;
}

static struct bsq_ctx *make_context(uint64_t memory, unsigned threads)
{
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.memory_bytes = memory, .threads = threads, .tmpdir = "."};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

static const char *write_packed(const char *name)
{
    struct packed p = {0};
    pack_zstd(&p, numbers, BYTES / 2, 0);
    pack_zstd(&p, numbers + NUMBERS / 2, BYTES / 2, 0);
    const char *path = test_bytes(name, p.data, p.size);
    free(p.data);
    return path;
}

static void expect_range(struct fmt_input *input, uint64_t offset, uint64_t size)
{
    uint8_t *buffer = malloc(size + 1);
    uint64_t got;
    assert_non_null(buffer);
    assert_int_equal(fmt_input_read_some(input, buffer, size, offset, &got), 0);
    assert_int_equal(got, offset + size <= BYTES ? size : offset < BYTES ? BYTES - offset : 0);
    assert_memory_equal(buffer, (uint8_t *)numbers + offset, got);
    free(buffer);
}

TEST(test_ranges_in_any_order)
{
    struct fmt_input *input;
    uint64_t size;
    char byte;
    struct bsq_ctx *ctx = make_context(64 << 20, 1);
    assert_int_equal(fmt_input_create(ctx, write_packed("n.bin"), NULL, false, &input), 0);
    for (int round = 0; round < 2; round++) { /* the second opening unpacks again */
        assert_true(fmt_input_size(input) == UINT64_MAX);
        assert_int_equal(fmt_input_open(input), 0);
        expect_range(input, 0, 1);
        expect_range(input, 9000001, 70000);
        expect_range(input, 5, 300000);
        assert_int_equal(fmt_input_reach(input, BYTES, &size), 0);
        assert_true(size == BYTES || size == UINT64_MAX);
        expect_range(input, BYTES - 10, 100);
        expect_range(input, BYTES + 10, 100);
        assert_int_equal(fmt_input_size(input), BYTES);
        assert_int_equal(fmt_input_read(input, &byte, 1, BYTES), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(ctx), "n.bin: truncated: 1 bytes expected at byte "));
        bsq_clear_error(ctx);
        assert_int_equal(fmt_input_close(input), 0);
    }
    fmt_input_free(input);
    test_context_end(ctx);
}

/* ---- a file that unpacks to more than is kept ---- */

enum { COPIES = 16, MIB = 1 << 20 };
#define LARGE_BYTES ((uint64_t)COPIES * BYTES)

/* Returns the number at an index of the large file. */
static uint32_t large_number(uint64_t index)
{
    return (uint32_t)(index % NUMBERS) ^ (uint32_t)(index / NUMBERS) << 24;
}

static const char *write_large(const char *name)
{
    uint32_t *copy = malloc(BYTES);
    struct packed p = {0};
    assert_non_null(copy);
    for (uint32_t k = 0; k < COPIES; k++) {
        for (uint32_t i = 0; i < NUMBERS; i++)
            copy[i] = large_number((uint64_t)k * NUMBERS + i);
        pack_zstd(&p, copy, BYTES, 0);
    }
    const char *path = test_bytes(name, p.data, p.size);
    free(p.data);
    free(copy);
    return path;
}

/* Returns whether numbers are those of the large file from a byte on, a multiple of four. */
static bool are_large(const uint32_t *found, uint64_t offset, uint64_t size)
{
    for (uint64_t i = 0; i < size / 4; i++)
        if (found[i] != large_number(offset / 4 + i))
            return false;
    return true;
}

static void expect_large(struct fmt_input *input, uint64_t offset, uint64_t size)
{
    uint32_t *buffer = malloc(size);
    assert_non_null(buffer);
    assert_int_equal(fmt_input_read(input, buffer, size, offset), 0);
    assert_true(are_large(buffer, offset, size));
    free(buffer);
}

/* Returns the bytes of the temporary file that is open. */
static uint64_t temporary_bytes(void)
{
    uint64_t bytes = 0;
    for (int fd = 3; fd < 64; fd++) {
        char link[64], path[4096];
        struct stat info;
        snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
        const ssize_t length = readlink(link, path, sizeof path - 1);
        if (length < 0)
            continue;
        path[length] = '\0';
        if (strstr(path, "(deleted)") && fstat(fd, &info) == 0)
            bytes += (uint64_t)info.st_size;
    }
    return bytes;
}

struct blocks {
    struct fmt_input *input;
    atomic_uint next, bad;
};

static void *read_blocks(void *arg)
{
    struct blocks *blocks = arg;
    uint32_t *buffer = malloc(MIB);
    for (unsigned i; buffer && (i = blocks->next++) < LARGE_BYTES / MIB;)
        if (fmt_input_read(blocks->input, buffer, MIB, (uint64_t)i * MIB) != 0 ||
            !are_large(buffer, (uint64_t)i * MIB, MIB))
            blocks->bad++;
    blocks->bad += !buffer;
    free(buffer);
    return NULL;
}

/* Threads read the file in order, and no more than 128 MiB of it are kept. Then a reader goes back,
 * wants much at once, and wants a file with all. */
TEST(test_much_is_read_in_order_and_again)
{
    struct blocks blocks = {0};
    struct bsq_file whole;
    uint64_t size;
    pthread_t threads[3];
    uint32_t last[4];
    struct bsq_ctx *ctx = make_context(64 << 20, 2);
    const char *path = write_large("large.bin");
    for (int round = 0; round < 2; round++) {
        assert_int_equal(fmt_input_create(ctx, path, NULL, false, &blocks.input), 0);
        assert_int_equal(fmt_input_open(blocks.input), 0);
        blocks.next = 0;
        for (int i = 0; i < 3; i++)
            assert_int_equal(pthread_create(&threads[i], NULL, read_blocks, &blocks), 0);
        for (int i = 0; i < 3; i++)
            pthread_join(threads[i], NULL);
        assert_int_equal(blocks.bad, 0);
        assert_in_range(temporary_bytes(), 100 * MIB, 128 * MIB);
        if (round == 0) {
            expect_large(blocks.input, 130 * MIB - 8, 3 * MIB);
            expect_large(blocks.input, 12, 5 * MIB);
            assert_int_equal(fmt_input_reach(blocks.input, LARGE_BYTES + 1, &size), 0);
            assert_true(size == LARGE_BYTES);
            assert_true(fmt_input_size(blocks.input) == LARGE_BYTES);
            expect_large(blocks.input, LARGE_BYTES - 80 * MIB, 80 * MIB);
            expect_large(blocks.input, 0, 80 * MIB);
        }
        assert_int_equal(fmt_input_whole(blocks.input, &whole), 0);
        assert_true(whole.size == LARGE_BYTES);
        assert_int_equal(bsq_file_read(ctx, &whole, last, sizeof last, LARGE_BYTES - 16), 0);
        assert_true(are_large(last, LARGE_BYTES - 16, 16));
        bsq_file_close(ctx, &whole);
        expect_large(blocks.input, 3 * MIB, MIB);
        assert_int_equal(fmt_input_close(blocks.input), 0);
        fmt_input_free(blocks.input);
    }
    bsq_ctx_destroy(ctx);
}

/* What nobody reads is not unpacked: a small file cannot fill the disk before it is refused. */
TEST(test_no_more_is_unpacked_than_is_read)
{
    struct packed p = {0};
    struct fmt_mesh_reader *reader;
    const size_t size = (size_t)256 << 20; /* one number */
    uint8_t *bomb = malloc(size);
    assert_non_null(bomb);
    memset(bomb, '1', size);
    memcpy(bomb, "v ", 2);
    pack_zstd(&p, bomb, size, 20);
    const char *path = test_bytes("bomb.obj.zst", p.data, p.size);
    assert_true(p.size < 100000);
    free(bomb);
    free(p.data);
    struct bsq_ctx *ctx = make_context(40 << 20, 1);
    assert_int_equal(fmt_mesh_open(ctx, &path, 1, &reader), 0);
    assert_int_equal(fmt_mesh_read(reader, NULL, NULL, NULL), BSQ_ENOMEM);
    assert_true(bsq_memory_high(ctx) <= 40 << 20);
    assert_true(bsq_temp_bytes(ctx) < 64 << 20);
    fmt_mesh_close(reader);
    test_context_end(ctx);
}

/* A packed file that ends too early is damaged, unless it was written to under way. */
TEST(test_a_file_that_changes_is_not_damaged)
{
    const char *path = write_packed("short.bin");
    struct stat info;
    assert_int_equal(stat(path, &info), 0);
    assert_int_equal(truncate(path, info.st_size - 9), 0);
    for (int changed = 0; changed < 2; changed++) {
        const struct timespec past[2] = {{1000, 0}, {1000, 0}};
        struct fmt_input *input;
        char *buffer = malloc(BYTES);
        uint64_t got;
        struct bsq_ctx *ctx = make_context(64 << 20, 1);
        assert_non_null(buffer);
        assert_int_equal(fmt_input_create(ctx, path, NULL, false, &input), 0);
        assert_int_equal(fmt_input_open(input), 0);
        expect_range(input, 0, 1);
        assert_int_equal(changed ? utimensat(AT_FDCWD, path, past, 0) : 0, 0);
        assert_int_equal(fmt_input_read_some(input, buffer, BYTES, 0, &got),
                         changed ? BSQ_EIO : BSQ_EDATA);
        assert_non_null(strstr(bsq_error(ctx), changed
                                                   ? "short.bin: was changed while it was read"
                                                   : "truncated: the packed data end too early"));
        bsq_clear_error(ctx);
        fmt_input_close(input);
        fmt_input_free(input);
        free(buffer);
        bsq_ctx_destroy(ctx);
    }
}

/* ---- pipes ---- */

struct writer {
    pthread_t thread;
    const char *path;
    const void *bytes;
    size_t size;
};

static void *write_pipe(void *arg)
{
    const struct writer *w = arg;
    int fd = open(w->path, O_WRONLY);
    for (size_t at = 0; fd >= 0 && at < w->size;) {
        ssize_t count = write(fd, (const char *)w->bytes + at, w->size - at);
        if (count < 0)
            break;
        at += (size_t)count;
    }
    if (fd >= 0)
        close(fd);
    return NULL;
}

static const char *make_fifo(const char *name)
{
    const char *path = name;
    assert_int_equal(mkfifo(path, 0600), 0);
    return path;
}

TEST(test_pipe_is_read_once)
{
    struct fmt_input *input;
    struct packed p = {0};
    uint64_t got;
    uint32_t first[100];
    pack_gzip(&p, numbers, BYTES, 1);
    struct writer w = {.path = make_fifo("fifo"), .bytes = p.data, .size = p.size};
    struct bsq_ctx *ctx = make_context(64 << 20, 1);
    assert_true(fmt_input_is_pipe(w.path));
    assert_int_equal(fmt_input_create(ctx, w.path, NULL, false, &input), BSQ_ENOINPUT);
    bsq_clear_error(ctx);
    assert_int_equal(fmt_input_create(ctx, w.path, NULL, true, &input), 0);
    assert_string_equal(fmt_input_beside(input), "");
    pthread_create(&w.thread, NULL, write_pipe, &w);
    assert_int_equal(fmt_input_peek(input, first, sizeof first, &got), 0);
    assert_int_equal(got, sizeof first);
    assert_memory_equal(first, numbers, sizeof first);
    for (int round = 0; round < 2; round++) {
        assert_int_equal(fmt_input_open(input), 0);
        expect_range(input, 1000, BYTES);
        assert_int_equal(fmt_input_close(input), 0);
    }
    pthread_join(w.thread, NULL);
    fmt_input_free(input);
    free(p.data);
    test_context_end(ctx);
}

static void *interrupt(void *arg)
{
    const struct timespec soon = {.tv_nsec = 100000000};
    nanosleep(&soon, NULL);
    bsq_interrupt(arg);
    return NULL;
}

/* Nobody opens the pipe for writing, or the writer writes nothing. */
TEST(test_waiting_ends_with_an_interruption)
{
    const char *path = make_fifo("silent");
    for (int round = 0; round < 2; round++) {
        struct fmt_input *input;
        pthread_t thread;
        char byte;
        uint64_t got;
        struct bsq_ctx *ctx = make_context(64 << 20, 1);
        assert_int_equal(fmt_input_create(ctx, path, NULL, true, &input), 0);
        int fd = round == 0 ? -1 : open(path, O_WRONLY | O_NONBLOCK);
        assert_true(round == 0 || fd >= 0);
        pthread_create(&thread, NULL, interrupt, ctx);
        assert_int_equal(fmt_input_peek(input, &byte, 1, &got), BSQ_EINTR);
        pthread_join(thread, NULL);
        fmt_input_free(input);
        if (fd >= 0)
            close(fd);
        bsq_ctx_destroy(ctx);
    }
}

RUN_TESTS(make_numbers, free_numbers)
