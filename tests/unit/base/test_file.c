/* test_file.c - input, temporary and output files. */
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>

#include "base/job_files.h"
#include "base/output.h"
#include "base/parallel.h"
#include "tests/unit/test.h"

/* ---- replacements of functions of the C library ---- */

static bool refuses_links;
static int refused_links;

int linkat(int from_directory, const char *from, int to_directory, const char *to, int flags)
{
    if (refuses_links) {
        refused_links++;
        errno = EPERM;
        return -1;
    }
    return (int)syscall(SYS_linkat, from_directory, from, to_directory, to, flags);
}

static int ignore_size_signals(void **state)
{
    (void)state;
    signal(SIGXFSZ, SIG_IGN);
    return 0;
}

static struct bsq_ctx *create(const char *tmpdir)
{
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.threads = 1, .tmpdir = tmpdir};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

/* ---- input ---- */

CONTEXT_TEST(test_reading, 1, 0)
{
    test_text("in", "0123456789");
    struct bsq_file file;
    char buffer[32];
    uint64_t got;
    assert_int_equal(bsq_file_open(ctx, "in", &file), 0);
    assert_int_equal(file.size, 10);
    assert_int_equal(bsq_file_read(ctx, &file, buffer, 4, 3), 0);
    assert_memory_equal(buffer, "3456", 4);
    assert_int_equal(bsq_file_read_some(ctx, &file, buffer, 32, 6, &got), 0);
    assert_int_equal(got, 4);
    assert_memory_equal(buffer, "6789", 4);
    assert_int_equal(bsq_file_read_some(ctx, &file, buffer, 32, 100, &got), 0);
    assert_int_equal(got, 0);
    assert_int_equal(bsq_file_read(ctx, &file, buffer, 4, 7), BSQ_EDATA);
    assert_string_equal(bsq_error(ctx), "in: truncated: 4 bytes expected at byte 7, 3 there");
    bsq_file_close(ctx, &file);
    bsq_file_close(ctx, &file);
    unlink("in");
}

TEST(test_every_truncated_length)
{
    test_text("in", "0123456789");
    for (int length = 9; length >= 0; length--) {
        struct bsq_ctx *ctx = create(NULL);
        struct bsq_file file;
        char buffer[10];
        assert_int_equal(truncate("in", length), 0);
        assert_int_equal(bsq_file_open(ctx, "in", &file), 0);
        assert_int_equal(bsq_file_read(ctx, &file, buffer, 10, 0), BSQ_EDATA);
        bsq_file_close(ctx, &file);
        bsq_ctx_destroy(ctx);
    }
    unlink("in");
}

static void assert_cannot_open(const char *path, const char *message)
{
    struct bsq_ctx *ctx = create(NULL);
    struct bsq_file file;
    struct bsq_map map;
    assert_int_equal(bsq_file_open(ctx, path, &file), BSQ_ENOINPUT);
    assert_int_equal(file.fd, -1);
    assert_string_equal(bsq_error(ctx), message);
    bsq_clear_error(ctx);
    assert_int_equal(bsq_map_open(ctx, path, &map), BSQ_ENOINPUT);
    assert_string_equal(bsq_error(ctx), message);
    bsq_ctx_destroy(ctx);
}

TEST(test_what_cannot_be_opened)
{
    assert_cannot_open("none", "none: No such file or directory");
    assert_cannot_open(".", ".: Is a directory");
    assert_int_equal(mkfifo("fifo", 0600), 0);
    assert_cannot_open("fifo", "fifo: not a regular file");
    unlink("fifo");
}

CONTEXT_TEST(test_maps, 1, 0)
{
    struct bsq_map map;
    test_text("in", "0123456789");
    assert_int_equal(bsq_map_open(ctx, "in", &map), 0);
    assert_int_equal(map.size, 10);
    assert_int_equal((uintptr_t)map.data % 4096, 0);
    assert_memory_equal(map.data, "0123456789", 10);
    assert_string_equal(map.path, "in");
    bsq_map_close(ctx, &map);
    test_text("in", "");
    bsq_forget_files(ctx);
    assert_int_equal(bsq_map_open(ctx, "in", &map), 0);
    assert_null(map.data);
    assert_int_equal(map.size, 0);
    bsq_map_close(ctx, &map);
    bsq_map_close(ctx, &map);
    unlink("in");
}

/* ---- closed standard descriptors ---- */

/* A program that uses the library may have closed them; what it prints must not get into files. */
CONTEXT_TEST(test_standard_descriptors_are_not_used, 1, 0)
{
    struct bsq_file file, twin, temporary;
    struct bsq_output *output;
    struct bsq_map map;
    int saved[3], found[5], statuses[5];
    test_text("in", "0123456789");
    for (int fd = 0; fd < 3; fd++) {
        saved[fd] = fcntl(fd, F_DUPFD_CLOEXEC, 3);
        close(fd);
    }
    statuses[0] = bsq_file_open(ctx, "in", &file);
    statuses[1] = bsq_file_duplicate(ctx, &file, &twin);
    statuses[2] = bsq_file_temp(ctx, NULL, "testing", &temporary);
    statuses[3] = bsq_map_open(ctx, "in", &map);
    statuses[4] = bsq_output_open(ctx, "out", &output);
    for (int fd = 0; fd < 3; fd++)
        found[fd] = fcntl(fd, F_GETFD);
    for (int fd = 0; fd < 3; fd++)
        dup2(saved[fd], fd), close(saved[fd]);
    for (int i = 0; i < 5; i++)
        assert_int_equal(statuses[i], 0);
    for (int fd = 0; fd < 3; fd++)
        assert_int_equal(found[fd], -1);
    assert_true(file.fd > 2 && twin.fd > 2 && temporary.fd > 2 && map.fd > 2);
    bsq_output_discard(output);
    bsq_map_close(ctx, &map);
    bsq_file_close(ctx, &temporary);
    bsq_file_close(ctx, &twin);
    bsq_file_close(ctx, &file);
    unlink("in");
}

/* ---- maps of files that change ---- */

enum { PAGE = 4096, PAGES = 64 };

static void put_pages(const char *path)
{
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    for (int i = 0; i < PAGES * PAGE; i++)
        putc('x', file);
    assert_int_equal(fclose(file), 0);
}

/* Checks the first byte of a page: 'x' in page 0, which still exists, and 0 in all others. */
static int read_page(void *arg, uint64_t page, unsigned worker)
{
    (void)worker;
    const struct bsq_map *map = arg;
    char byte = ((const volatile char *)map->data)[page * PAGE];
    return byte == (page == 0 ? 'x' : '\0') ? 0 : BSQ_EBUG;
}

CONTEXT_TEST(test_map_that_shrinks, 4, 0)
{
    struct bsq_map map;
    put_pages("in");
    assert_int_equal(bsq_map_open(ctx, "in", &map), 0);
    assert_int_equal(bsq_map_check(ctx, &map), 0);
    assert_int_equal(truncate("in", 100), 0);
    /* All threads read lost pages, in any order. */
    assert_int_equal(bsq_parallel_for(ctx, PAGES, read_page, &map), 0);
    assert_int_equal(bsq_map_check(ctx, &map), BSQ_EIO);
    assert_string_equal(bsq_error(ctx), "in: shrank from 262144 to 100 bytes while it was read");
    bsq_map_close(ctx, &map);
    bsq_clear_error(ctx);
    bsq_forget_files(ctx);

    /* The file has its old size again when it is checked, but zeros were read. */
    put_pages("in");
    assert_int_equal(bsq_map_open(ctx, "in", &map), 0);
    assert_int_equal(truncate("in", PAGE), 0);
    assert_int_equal(read_page(&map, 1, 0), 0);
    assert_int_equal(truncate("in", PAGES * PAGE), 0);
    assert_int_equal(bsq_map_check(ctx, &map), BSQ_EIO);
    assert_string_equal(bsq_error(ctx), "in: reading the mapped file: Input/output error");
    bsq_map_close(ctx, &map);
    bsq_clear_error(ctx);
    bsq_forget_files(ctx);

    put_pages("in");
    assert_int_equal(bsq_map_open(ctx, "in", &map), 0);
    struct timespec times[2] = {{0, UTIME_OMIT}, {1, 0}};
    assert_int_equal(utimensat(AT_FDCWD, "in", times, 0), 0);
    assert_int_equal(bsq_map_check(ctx, &map), BSQ_EIO);
    assert_string_equal(bsq_error(ctx), "in: was changed while it was read");
    bsq_map_close(ctx, &map);
    unlink("in");
}

static sigjmp_buf after_fault;
static volatile sig_atomic_t own_faults;

static void on_own_fault(int number)
{
    (void)number;
    own_faults++;
    siglongjmp(after_fault, 1);
}

static void fault_elsewhere(const volatile char *byte)
{
    if (sigsetjmp(after_fault, 1) == 0)
        (void)*byte;
}

/* The previous handler gets signals that are not about a map, and is restored afterwards. */
CONTEXT_TEST(test_other_bus_errors, 1, 0)
{
    struct bsq_map first, second;
    struct sigaction own = {.sa_handler = on_own_fault}, original, now;
    assert_int_equal(sigaction(SIGBUS, &own, &original), 0);
    put_pages("in");
    int fd = open("in", O_RDWR);
    char *mine = mmap(NULL, PAGES * PAGE, PROT_READ, MAP_SHARED, fd, 0);
    assert_true(mine != MAP_FAILED);
    assert_int_equal(bsq_map_open(ctx, "in", &first), 0);
    assert_int_equal(bsq_map_open(ctx, "in", &second), 0);
    assert_int_equal(ftruncate(fd, 0), 0);
    fault_elsewhere(mine + PAGE);
    assert_int_equal(own_faults, 1);
    bsq_map_close(ctx, &second);
    assert_int_equal(((const volatile char *)first.data)[PAGE], 0);
    assert_int_equal(own_faults, 1);
    bsq_map_close(ctx, &first);
    assert_int_equal(sigaction(SIGBUS, &original, &now), 0);
    assert_true(now.sa_handler == on_own_fault);
    munmap(mine, PAGES * PAGE);
    close(fd);
    unlink("in");
}

/* ---- temporary files ---- */

CONTEXT_TEST(test_temporary_files, 1, 0)
{
    struct bsq_file file;
    char buffer[6];
    assert_int_equal(bsq_file_temp(ctx, "out.nvdb", "testing", &file), 0);
    assert_int_equal(test_files_here(), 0);
    assert_int_equal(bsq_file_append(ctx, &file, "abc", 3), 0);
    assert_int_equal(bsq_file_append(ctx, &file, "def", 3), 0);
    assert_int_equal(bsq_file_write(ctx, &file, "B", 1, 1), 0);
    assert_int_equal(file.size, 6);
    assert_int_equal(bsq_file_read(ctx, &file, buffer, 6, 0), 0);
    assert_memory_equal(buffer, "aBcdef", 6);
    assert_int_equal(bsq_temp_bytes(ctx), 7);
    bsq_file_close(ctx, &file);
}

TEST(test_temporary_directory)
{
    struct bsq_ctx *ctx = create("/nowhere/at/all");
    struct bsq_file file;
    assert_int_equal(bsq_file_temp(ctx, "out", "testing", &file), BSQ_ECANTCREAT);
    assert_string_equal(bsq_error(ctx), "/nowhere/at/all: temporary file for testing: "
                                        "No such file or directory");
    bsq_clear_error(ctx);
    assert_int_equal(bsq_require_disk(ctx, "out", 1), BSQ_ECANTCREAT);
    bsq_ctx_destroy(ctx);
}

/* Without a directory of its own, a temporary file lies beside the first output of the job. */
CONTEXT_TEST(test_temporary_files_beside_the_output, 1, 0)
{
    assert_int_equal(unsetenv("TMPDIR"), 0);
    struct bsq_file file;
    char output[64];
    snprintf(output, sizeof output, "%s/out.nvdb", test_directory);
    assert_int_equal(chdir("/proc"), 0); /* nobody can create files here */
    assert_int_equal(bsq_file_temp(ctx, NULL, "testing", &file), BSQ_ECANTCREAT);
    bsq_clear_error(ctx);
    assert_int_equal(bsq_note_output(ctx, output), 0);
    assert_int_equal(bsq_file_temp(ctx, NULL, "testing", &file), 0);
    bsq_file_close(ctx, &file);
    assert_int_equal(chdir(test_directory), 0);
}

CONTEXT_TEST(test_disk_space, 1, 0)
{
    assert_int_equal(bsq_require_disk(ctx, "out", 1), 0);
    assert_int_equal(bsq_require_disk(ctx, "out", UINT64_MAX), BSQ_EIO);
    assert_non_null(strstr(bsq_error(ctx), "18446744073709551615 bytes are needed"));
}

/* ---- output ---- */

CONTEXT_TEST(test_output_appears_on_commit, 1, 0)
{
    struct bsq_output *output;
    test_text("out", "old");
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    assert_int_equal(bsq_output_write(output, "0123", 4), 0);
    assert_int_equal(bsq_output_write_at(output, "AB", 2, 1), 0);
    assert_int_equal(bsq_output_tell(output), 4);
    assert_int_equal(bsq_output_write(output, "x", 1), 0);
    test_expect_text("out", "old");
    assert_int_equal(test_files_here(), 1);
    assert_int_equal(bsq_output_commit(output), 0);
    test_expect_text("out", "0AB3x");
    assert_int_equal(test_files_here(), 1);
    unlink("out");
}

CONTEXT_TEST(test_output_is_discarded, 1, 0)
{
    struct bsq_output *output;
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    assert_int_equal(bsq_output_write(output, "0123", 4), 0);
    assert_int_equal(test_files_here(), 0);
    bsq_output_discard(output);
    bsq_output_discard(NULL);
    assert_int_equal(test_files_here(), 0);
}

CONTEXT_TEST(test_output_long_name_and_link, 1, 0)
{
    struct bsq_output *output;
    char name[256];
    memset(name, 'n', 255);
    name[255] = '\0';
    test_text(name, "old");
    assert_int_equal(symlink(name, "link"), 0);
    assert_int_equal(bsq_output_open(ctx, "link", &output), 0);
    assert_int_equal(bsq_output_write(output, "new", 3), 0);
    assert_int_equal(bsq_output_commit(output), 0);
    struct stat info;
    assert_int_equal(lstat("link", &info), 0);
    assert_true(S_ISLNK(info.st_mode));
    test_expect_text(name, "new");
    unlink("link");
    unlink(name);
}

/* Returns true if the file system of this directory can preallocate. */
static bool preallocates(void)
{
    int fd = open("probe", O_RDWR | O_CREAT | O_EXCL, 0600);
    assert_true(fd >= 0);
    bool can = fallocate(fd, 0, 0, 1) == 0;
    close(fd);
    unlink("probe");
    return can;
}

CONTEXT_TEST(test_space_is_preallocated, 1, 0)
{
    struct bsq_output *output;
    struct rlimit before, small;
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    assert_int_equal(bsq_output_expect(output, 9), 0);
    assert_int_equal(bsq_output_tell(output), 0);
    assert_int_equal(bsq_output_write(output, "whole", 5), 0);
    assert_int_equal(bsq_output_write(output, "file", 4), 0);
    assert_int_equal(bsq_output_commit(output), 0);
    test_expect_text("out", "wholefile");
    unlink("out");

    assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
    small = before;
    small.rlim_cur = 100;
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
    int status = bsq_output_expect(output, 200);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
    if (preallocates()) {
        assert_int_equal(status, BSQ_EIO);
        assert_string_equal(bsq_error(ctx), "out: writing: File too large");
        assert_int_equal(bsq_output_commit(output), BSQ_EIO);
    } else {
        assert_int_equal(status, 0);
        bsq_output_discard(output);
    }
    assert_int_equal(test_files_here(), 0);
}

static void assert_too_short(struct bsq_ctx *ctx, int status)
{
    assert_int_equal(status, BSQ_EBUG);
    assert_non_null(strstr(bsq_error(ctx), ": 8 bytes were written, 9 were expected"));
    bsq_clear_error(ctx);
}

CONTEXT_TEST(test_less_than_expected, 1, 0)
{
    struct bsq_output *output;
    struct bsq_file file;
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    assert_int_equal(bsq_output_expect(output, 9), 0);
    assert_int_equal(bsq_output_write(output, "not whol", 8), 0);
    assert_too_short(ctx, bsq_output_sync(output));
    assert_too_short(ctx, bsq_output_commit(output));
    assert_int_equal(test_files_here(), 0);

    assert_int_equal(bsq_output_open_temp(ctx, "out", "testing", &output), 0);
    assert_int_equal(bsq_output_expect(output, 9), 0);
    assert_int_equal(bsq_output_write(output, "not whol", 8), 0);
    assert_too_short(ctx, bsq_output_keep_temp(output, &file));
    assert_int_equal(test_files_here(), 0);
}

/* ---- unnamed files that cannot be linked ---- */

enum { COPIED = 150000 };

/* Opens an output that expects COPIED bytes, and writes them. */
static struct bsq_output *open_to_copy(struct bsq_ctx *ctx, char *content)
{
    struct bsq_output *output;
    for (size_t i = 0; i < COPIED; i++)
        content[i] = (char)(i * 7 + i / 256);
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    assert_int_equal(bsq_output_expect(output, COPIED), 0);
    assert_int_equal(bsq_output_write(output, content, COPIED), 0);
    return output;
}

CONTEXT_TEST(test_copying_to_a_name, 1, 0)
{
    static char content[COPIED], got[COPIED + 1];
    struct bsq_output *output = open_to_copy(ctx, content);
    refuses_links = true;
    assert_int_equal(bsq_output_commit(output), 0);
    refuses_links = false;
    assert_int_equal(test_files_here(), 1);
    FILE *file = fopen("out", "r");
    assert_non_null(file);
    assert_int_equal(fread(got, 1, sizeof got, file), COPIED);
    fclose(file);
    assert_memory_equal(got, content, COPIED);
    unlink("out");

    /* An empty file. */
    assert_int_equal(bsq_output_open(ctx, "out", &output), 0);
    refuses_links = true;
    assert_int_equal(bsq_output_commit(output), 0);
    refuses_links = false;
    test_expect_text("out", "");
    unlink("out");
}

CONTEXT_TEST(test_copying_to_a_name_fails, 1, 0)
{
    static char content[COPIED];
    struct bsq_output *output = open_to_copy(ctx, content);
    struct rlimit before, small;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
    small = before;
    small.rlim_cur = COPIED - 1;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
    refuses_links = true;
    refused_links = 0;
    int status = bsq_output_commit(output);
    refuses_links = false;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
    if (refused_links > 0) {
        assert_int_equal(status, BSQ_EIO);
        assert_non_null(strstr(bsq_error(ctx), "out: writing: File too large"));
    } else { /* the file had a name from the start */
        assert_int_equal(status, 0);
        unlink("out");
    }
    assert_int_equal(test_files_here(), 0);
}

RUN_TESTS(ignore_size_signals, NULL)
