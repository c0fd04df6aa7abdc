/* test_job_files.c - inputs that are changed under way, and outputs that are inputs. */
#include <fcntl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include "base/job_files.h"
#include "base/output.h"
#include "tests/unit/test.h"

static uint64_t stats; /* calls of stat() */

int stat(const char *path, struct stat *out)
{
    stats++;
    return fstatat(AT_FDCWD, path, out, 0);
}

static int create(void **state)
{
    struct bsq_ctx_options options = {.memory_bytes = 64 << 20, .threads = 1};
    struct bsq_ctx *ctx;
    int status = bsq_ctx_create(&options, &ctx);
    *state = ctx;
    return status;
}

static int destroy(void **state)
{
    bsq_ctx_destroy(*state);
    return 0;
}
#define FIXTURE_TEST(name) TEST_EACH(name, create, destroy)

static void assert_fails(struct bsq_ctx *ctx, int status, int expected, const char *message)
{
    assert_int_equal(status, expected);
    assert_string_equal(bsq_error(ctx), message);
    bsq_clear_error(ctx);
}

static int reopen(struct bsq_ctx *ctx, const char *path)
{
    struct bsq_file file;
    int status = bsq_file_open(ctx, path, &file);
    bsq_file_close(ctx, &file);
    return status;
}

/* ---- inputs that change ---- */

static const char changed[] = "in: was changed while it was read";

FIXTURE_TEST(test_replaced_between_openings)
{
    struct bsq_ctx *ctx = *state;
    test_text("in", "first");
    assert_int_equal(reopen(ctx, "in"), 0);
    assert_int_equal(reopen(ctx, "in"), 0);
    test_text("other", "other");
    assert_int_equal(rename("other", "in"), 0);
    assert_fails(ctx, reopen(ctx, "in"), BSQ_EIO, changed);
    bsq_forget_files(ctx);
    assert_int_equal(reopen(ctx, "in"), 0);
    unlink("in");
}

/* Two files of one size and time differ by their inode. */
FIXTURE_TEST(test_replaced_with_the_same_size_and_time)
{
    struct bsq_ctx *ctx = *state;
    const struct timespec times[2] = {{1000, 5}, {1000, 5}};
    test_text("in", "first");
    test_text("other", "other");
    assert_int_equal(utimensat(AT_FDCWD, "in", times, 0), 0);
    assert_int_equal(utimensat(AT_FDCWD, "other", times, 0), 0);
    assert_int_equal(reopen(ctx, "in"), 0);
    assert_int_equal(rename("other", "in"), 0);
    assert_fails(ctx, reopen(ctx, "in"), BSQ_EIO, changed);
    unlink("in");
}

FIXTURE_TEST(test_written_to_in_place)
{
    struct bsq_ctx *ctx = *state;
    struct timespec times[2] = {{1000, 5}, {1000, 5}};
    struct bsq_file file;
    test_text("in", "first");
    assert_int_equal(utimensat(AT_FDCWD, "in", times, 0), 0);
    assert_int_equal(bsq_file_open(ctx, "in", &file), 0);
    assert_int_equal(bsq_file_check(ctx, &file), 0);
    times[1].tv_nsec++;
    assert_int_equal(utimensat(AT_FDCWD, "in", times, 0), 0);
    assert_fails(ctx, bsq_file_check(ctx, &file), BSQ_EIO, changed);
    assert_fails(ctx, reopen(ctx, "in"), BSQ_EIO, changed);
    times[1].tv_nsec--;
    assert_int_equal(truncate("in", 4), 0);
    assert_int_equal(utimensat(AT_FDCWD, "in", times, 0), 0);
    assert_fails(ctx, bsq_file_check(ctx, &file), BSQ_EIO, changed);
    bsq_file_close(ctx, &file);
    unlink("in");
}

static void make_socket(const char *path)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    strcpy(address.sun_path, path);
    assert_int_equal(bind(fd, (const struct sockaddr *)&address, sizeof address), 0);
    close(fd);
}

FIXTURE_TEST(test_only_regular_files)
{
    struct bsq_ctx *ctx = *state;
    assert_int_equal(mkfifo("fifo", 0600), 0);
    make_socket("socket");
    assert_fails(ctx, reopen(ctx, "fifo"), BSQ_ENOINPUT, "fifo: not a regular file");
    assert_fails(ctx, reopen(ctx, "socket"), BSQ_ENOINPUT, "socket: not a regular file");
    assert_fails(ctx, reopen(ctx, "/dev/zero"), BSQ_ENOINPUT, "/dev/zero: not a regular file");
    assert_fails(ctx, reopen(ctx, "."), BSQ_ENOINPUT, ".: Is a directory");
    unlink("fifo");
    unlink("socket");
}

/* ---- outputs that are inputs ---- */

/* An output is an input under any name, whichever of the two is noted first. */
FIXTURE_TEST(test_links_and_spellings)
{
    struct bsq_ctx *ctx = *state;
    char message[200];
    test_text("in", "first");
    assert_int_equal(link("in", "hard"), 0);
    assert_int_equal(symlink("in", "soft"), 0);
    assert_int_equal(symlink(".", "here"), 0);
    static const char *const names[] = {"in", "hard", "soft", "./in", "here/soft"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        bsq_forget_files(ctx);
        snprintf(message, sizeof message, "%s: this output would overwrite %sthe scan", names[i],
                 i == 0 ? "" : "in, ");
        assert_int_equal(bsq_note_input(ctx, "in", "the %s", "scan"), 0);
        assert_int_equal(reopen(ctx, "in"), 0);
        assert_fails(ctx, bsq_note_output(ctx, names[i]), BSQ_EUSAGE, message);
        bsq_forget_files(ctx);
        assert_int_equal(bsq_note_output(ctx, names[i]), 0);
        assert_fails(ctx, bsq_note_input(ctx, "in", "the scan"), BSQ_EUSAGE, message);
        assert_int_equal(reopen(ctx, "in"), BSQ_EUSAGE);
        bsq_clear_error(ctx);
    }
    unlink("in");
    unlink("hard");
    unlink("soft");
    unlink("here");
}

/* A file that an input names, and that is missing, may not be created either. */
FIXTURE_TEST(test_missing_inputs)
{
    struct bsq_ctx *ctx = *state;
    struct bsq_output *output;
    assert_int_equal(mkdir("sub", 0700), 0);
    assert_int_equal(symlink("sub/missing", "link"), 0);
    assert_int_equal(symlink("../link", "sub/again"), 0);
    assert_int_equal(bsq_note_input(ctx, "./sub/missing", "the texture"), 0);
    assert_int_equal(bsq_note_input(ctx, "nowhere/missing", "the texture"), 0);
    assert_int_equal(bsq_note_output(ctx, "missing"), 0);
    assert_fails(ctx, bsq_output_open(ctx, "sub/missing", &output), BSQ_EUSAGE,
                 "sub/missing: this output would overwrite ./sub/missing, the texture");
    assert_fails(ctx, bsq_note_output(ctx, "sub/again"), BSQ_EUSAGE,
                 "sub/again: this output would overwrite ./sub/missing, the texture");
    unlink("sub/again");
    unlink("link");
    rmdir("sub");
}

static int write_output(struct bsq_ctx *ctx, const char *path)
{
    struct bsq_output *output;
    int status = bsq_output_open(ctx, path, &output);
    if (status == 0 && (status = bsq_output_write(output, "x", 1)) == 0)
        return bsq_output_commit(output);
    if (status == 0)
        bsq_output_discard(output);
    return status;
}

/* A job may read what it wrote, and write it again. */
FIXTURE_TEST(test_own_outputs)
{
    struct bsq_ctx *ctx = *state;
    for (int i = 0; i < 2; i++) {
        assert_int_equal(write_output(ctx, "between"), 0);
        assert_int_equal(reopen(ctx, "./between"), 0);
    }
    unlink("between");
}

/* Outputs of a group are noted one by one: a commit does not look at all of them for each. */
FIXTURE_TEST(test_many_outputs)
{
    enum { COUNT = 300 };
    struct bsq_ctx *ctx = *state;
    struct bsq_output_group group = {0};
    struct bsq_output *output;
    char name[40];
    for (int i = 0; i < COUNT; i++) {
        snprintf(name, sizeof name, "map %d", i);
        assert_int_equal(bsq_output_open(ctx, name, &output), 0);
        assert_int_equal(bsq_output_group_add(&group, output), 0);
    }
    stats = 0;
    assert_int_equal(bsq_output_group_commit(&group), 0);
    assert_in_range(stats, 1, 10 * COUNT);
    for (int i = 0; i < COUNT; i++) {
        snprintf(name, sizeof name, "map %d", i);
        assert_int_equal(reopen(ctx, name), 0);
        unlink(name);
    }
    assert_in_range(bsq_memory_used(ctx), 0, COUNT * 400);
    bsq_forget_files(ctx);
    assert_int_equal(bsq_memory_used(ctx), 0);
}

/* An output that was noted under two names of a file is written under one. */
FIXTURE_TEST(test_own_output_with_two_names)
{
    struct bsq_ctx *ctx = *state;
    assert_int_equal(symlink("out", "link"), 0);
    test_text("out", "old");
    assert_int_equal(bsq_output_check(ctx, "link"), 0);
    assert_int_equal(bsq_output_check(ctx, "out"), 0);
    assert_int_equal(write_output(ctx, "link"), 0);
    assert_int_equal(bsq_note_output(ctx, "./out"), 0); /* also an unwritten one of this file */
    assert_int_equal(reopen(ctx, "out"), 0);
    assert_int_equal(reopen(ctx, "link"), 0);
    unlink("link");
    unlink("out");
}

/* Many names are found again, and their memory is counted. */
FIXTURE_TEST(test_many_inputs)
{
    enum { COUNT = 5000 };
    struct bsq_ctx *ctx = *state;
    char name[40];
    for (int again = 0; again < 2; again++) {
        for (int i = 0; i < COUNT; i++) {
            snprintf(name, sizeof name, "texture %d", i);
            assert_int_equal(bsq_note_input(ctx, name, "texture %d", again), 0);
        }
        assert_in_range(bsq_memory_used(ctx), COUNT * 100, COUNT * 400);
    }
    assert_fails(ctx, bsq_note_output(ctx, "./texture 4999"), BSQ_EUSAGE,
                 "./texture 4999: this output would overwrite texture 4999, texture 0");
    bsq_forget_files(ctx);
    assert_int_equal(bsq_memory_used(ctx), 0);
}

RUN_TESTS(NULL, NULL)
