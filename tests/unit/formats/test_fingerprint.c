/* Tests when an input is read to compare it, and when its identity is enough. */
#include "formats/fingerprint.h"
#include "tests/unit/test.h"

#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const char name[] = "input.tris";
static time_t later; /* how far the clock is ahead of the file system's */

time_t time(time_t *out)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    now.tv_sec += later;
    if (out)
        *out = now.tv_sec;
    return now.tv_sec;
}

/* Writes a file, again and again until the system gives it another time of change. */
static void write_file(const char *text, off_t at)
{
    struct stat before = {0}, now;
    int fd = open(name, O_WRONLY | O_CREAT, 0600);
    assert_true(fd >= 0 && fstat(fd, &before) == 0);
    do {
        assert_int_equal(pwrite(fd, text, strlen(text), at), (ssize_t)strlen(text));
        assert_int_equal(fstat(fd, &now), 0);
    } while (now.st_ctim.tv_sec == before.st_ctim.tv_sec &&
             now.st_ctim.tv_nsec == before.st_ctim.tv_nsec);
    close(fd);
}

/* Computes the fingerprint `seconds` after the last change. */
static struct fmt_fingerprint print_after(time_t seconds)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct fmt_fingerprint print;
    later = seconds;
    assert_int_equal(fmt_fingerprint(ctx, name, &print), 0);
    test_context_end(ctx);
    return print;
}

static bool is_same(const struct fmt_fingerprint *print)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    bool same = false;
    assert_int_equal(fmt_is_same(ctx, name, print->bytes, print->hash, print->identity, &same), 0);
    test_context_end(ctx);
    return same;
}

/* A wrong checksum shows whether the file is read. */
TEST(test_known_file_is_not_read)
{
    write_file("abcdef", 0);
    for (time_t seconds = 0; seconds < 20; seconds += 10) {
        struct fmt_fingerprint print = print_after(seconds);
        assert_true(is_same(&print));
        print.hash[0] ^= 1;
        assert_int_equal(is_same(&print), seconds > 0);
    }
}

/* Other content of the same size is noticed, also if the file has its old time of modification. */
TEST(test_changed_file)
{
    for (int restore = 0; restore < 2; restore++) {
        struct stat info;
        write_file("abcdef", 0);
        assert_int_equal(stat(name, &info), 0);
        const struct fmt_fingerprint print = print_after(10);
        write_file("abcdeg", 0);
        const struct timespec times[] = {info.st_atim, info.st_mtim};
        if (restore)
            assert_int_equal(utimensat(AT_FDCWD, name, times, 0), 0);
        assert_false(is_same(&print));
        /* The same content with another time is the same input. */
        write_file("abcdef", 0);
        assert_true(is_same(&print));
    }
}

/* Each byte of a texture or a mesh counts. Of a large chunk file, the header does. */
TEST(test_large_file)
{
    const off_t size = (off_t)65 << 20, middle = size / 2 + 77;
    for (int is_tris = 0; is_tris < 2; is_tris++) {
        write_file(is_tris ? "BSQTRIS\n" : "BSQTRIX\n", 0);
        assert_int_equal(truncate(name, size), 0);
        const struct fmt_fingerprint print = print_after(10);
        write_file("x", middle);
        assert_int_equal(is_same(&print), is_tris);
        assert_int_equal(truncate(name, middle), 0);
        assert_int_equal(truncate(name, size), 0);
        assert_true(is_same(&print));
        write_file(is_tris ? "y" : "x", 145);
        assert_false(is_same(&print));
    }
}

RUN_TESTS(NULL, NULL)
