/* test_output.c - which file an output replaces, what it inherits, and outputs that belong
 * together. test_file.c has the rest of outputs. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/xattr.h>

#include "base/output.h"
#include "base/output_internal.h"
#include "tests/unit/test.h"

static unsigned directories_read; /* calls of opendir() */

DIR *opendir(const char *path)
{
    int fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    directories_read++;
    return fd < 0 ? NULL : fdopendir(fd);
}

static struct bsq_output *start(struct bsq_ctx *ctx, const char *path)
{
    struct bsq_output *output;
    assert_int_equal(bsq_output_open(ctx, path, &output), 0);
    assert_int_equal(bsq_output_write(output, "new", 3), 0);
    return output;
}

static void write_new(struct bsq_ctx *ctx, const char *path)
{
    assert_int_equal(bsq_output_commit(start(ctx, path)), 0);
}

static void assert_cannot_create(struct bsq_ctx *ctx, const char *path, const char *message)
{
    struct bsq_output *output;
    assert_int_equal(bsq_output_open(ctx, path, &output), BSQ_ECANTCREAT);
    assert_null(output);
    assert_string_equal(bsq_error(ctx), message);
    bsq_clear_error(ctx);
}

static bool is_link(const char *path)
{
    struct stat info;
    return lstat(path, &info) == 0 && S_ISLNK(info.st_mode);
}

/* ---- symbolic links ---- */

CONTEXT_TEST(test_dangling_links_are_followed, 1, 0)
{
    assert_int_equal(mkdir("sub", 0700), 0);
    assert_int_equal(symlink("second", "sub/first"), 0);
    assert_int_equal(symlink("../target", "sub/second"), 0);
    write_new(ctx, "sub/first");
    test_expect_text("target", "new");
    assert_true(is_link("sub/first") && is_link("sub/second"));
    unlink("target");

    char absolute[200];
    snprintf(absolute, sizeof absolute, "%s/target", test_directory);
    assert_int_equal(symlink(absolute, "link"), 0);
    write_new(ctx, "link");
    test_expect_text("target", "new");
    write_new(ctx, "link"); /* and now it is a link to a file */
    assert_true(is_link("link"));
    unlink("target");
    unlink("link");

    assert_int_equal(symlink("none/target", "link"), 0);
    assert_cannot_create(ctx, "link", "link: cannot be created: there is no folder none");
    unlink("link");
    assert_int_equal(symlink("sub/", "link"), 0);
    assert_cannot_create(ctx, "link", "link: \"sub/\" is not a file name");
    unlink("link");
    assert_int_equal(symlink("none/", "link"), 0);
    assert_cannot_create(ctx, "link", "link: \"none/\" is not a file name");
    unlink("link");
    unlink("sub/first");
    unlink("sub/second");
    rmdir("sub");
    assert_int_equal(test_files_here(), 0);
}

CONTEXT_TEST(test_links_to_files_without_a_name, 1, 0)
{
    char path[40], message[100];
    test_text("gone", "old");
    int fd = open("gone", O_RDWR | O_CLOEXEC);
    unlink("gone");
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    snprintf(message, sizeof message, "%s: leads to a file without a name", path);
    assert_cannot_create(ctx, path, message);
    close(fd);
}

/* ---- access rights ---- */

static void assert_mode(const char *path, mode_t mode)
{
    struct stat info;
    assert_int_equal(stat(path, &info), 0);
    assert_int_equal(info.st_mode & 07777, mode);
}

CONTEXT_TEST(test_mode_is_kept, 1, 0)
{
    static const mode_t modes[] = {0600, 0640, 0666, 0777, 0400, 0604};
    for (size_t i = 0; i < sizeof modes / sizeof *modes; i++) {
        test_text("out", "old");
        assert_int_equal(chmod("out", modes[i]), 0);
        write_new(ctx, "out");
        assert_mode("out", modes[i]);
        test_expect_text("out", "new");
        unlink("out");
    }
    /* The user takes rights away while the job runs. */
    test_text("out", "old");
    struct bsq_output *output = start(ctx, "out");
    assert_int_equal(bsq_output_sync(output), 0);
    assert_int_equal(chmod("out", 0600), 0);
    assert_int_equal(bsq_output_commit(output), 0);
    assert_mode("out", 0600);
    unlink("out");
}

static mode_t mode_now(struct bsq_output *output)
{
    struct bsq_ctx *ctx = output->ctx;
    struct bsq_file file;
    struct stat info;
    assert_int_equal(bsq_output_read(output, &file), 0);
    assert_int_equal(fstat(file.fd, &info), 0);
    bsq_file_close(ctx, &file);
    return info.st_mode & 07777;
}

/* Before the new file has the old one's group, its group is another one. */
CONTEXT_TEST(test_private_until_it_is_complete, 1, 0)
{
    test_text("out", "old");
    assert_int_equal(chmod("out", 0644), 0);
    struct bsq_output *output = start(ctx, "out");
    assert_int_equal(mode_now(output), 0600);
    assert_int_equal(bsq_output_commit(output), 0);
    assert_mode("out", 0644);
    /* The old file is removed meanwhile, and nobody knows its group. */
    assert_int_equal(chmod("out", 0664), 0);
    output = start(ctx, "out");
    unlink("out");
    assert_int_equal(bsq_output_commit(output), 0);
    assert_mode("out", 0644);
    unlink("out");
}

CONTEXT_TEST(test_owner_is_kept, 1, 0)
{
    struct stat info;
    if (geteuid() != 0)
        skip();
    test_text("out", "old");
    assert_int_equal(chown("out", 12345, 23456), 0);
    assert_int_equal(chmod("out", 0640), 0);
    write_new(ctx, "out");
    assert_int_equal(stat("out", &info), 0);
    assert_true(info.st_uid == 12345 && info.st_gid == 23456);
    assert_mode("out", 0640);
    unlink("out");
}

CONTEXT_TEST(test_rights_without_the_group, 1, 0)
{
    /* Not root: the file belongs to a group of which this process is no member. */
    if (geteuid() != 0)
        skip();
    test_text("out", "old");
    assert_int_equal(chown("out", 12345, 23456), 0);
    assert_int_equal(chmod("out", 0664), 0);
    assert_int_equal(chmod(".", 0777), 0);
    assert_int_equal(setegid(34567), 0);
    assert_int_equal(seteuid(12345), 0);
    write_new(ctx, "out");
    assert_int_equal(seteuid(0), 0);
    assert_int_equal(setegid(0), 0);
    assert_mode("out", 0644);
    assert_int_equal(chmod(".", 0700), 0);
    unlink("out");
}

/* An access list as the kernel stores it. */
struct access_list {
    uint32_t version;
    struct {
        uint16_t tag, rights;
        uint32_t id;
    } entries[5];
};

static const struct access_list list_for_12345 = {2,
                                                  {{0x01, 6, UINT32_MAX},
                                                   {0x02, 6, 12345},
                                                   {0x04, 0, UINT32_MAX},
                                                   {0x10, 6, UINT32_MAX},
                                                   {0x20, 0, UINT32_MAX}}};

CONTEXT_TEST(test_access_list_is_kept, 1, 0)
{
    struct access_list got = {0};
    test_text("out", "old");
    if (setxattr("out", "system.posix_acl_access", &list_for_12345, sizeof got, 0) != 0) {
        unlink("out");
        skip();
    }
    write_new(ctx, "out");
    assert_int_equal(getxattr("out", "system.posix_acl_access", &got, sizeof got), sizeof got);
    assert_memory_equal(&got, &list_for_12345, sizeof got);
    unlink("out");
}

/* A directory's default list applies to new files, but not to one that replaces a private file. */
CONTEXT_TEST(test_default_access_list, 1, 0)
{
    assert_int_equal(mkdir("sub", 0700), 0);
    if (setxattr("sub", "system.posix_acl_default", &list_for_12345, sizeof list_for_12345, 0) !=
        0) {
        rmdir("sub");
        skip();
    }
    test_text("sub/out", "old");
    assert_int_equal(removexattr("sub/out", "system.posix_acl_access"), 0);
    assert_int_equal(chmod("sub/out", 0660), 0);
    write_new(ctx, "sub/out");
    assert_int_equal(getxattr("sub/out", "system.posix_acl_access", NULL, 0), -1);
    assert_mode("sub/out", 0660);
    unlink("sub/out");
    rmdir("sub");
}

/* ---- temporary names ---- */

/* Creates a file with a temporary name of "out", and opens and discards an output of that name in
 * another job. Returns whether the file is still there. */
static bool stays(struct bsq_ctx *ctx, const char *content, bool locked)
{
    char *path;
    int fd;
    assert_int_equal(bsq_temp_named(".", "out", 0666, &path, &fd), 0);
    assert_int_equal(write(fd, content, strlen(content)), strlen(content));
    if (!locked)
        close(fd);
    bsq_forget_files(ctx);
    bsq_output_discard(start(ctx, "out"));
    bool there = unlink(path) == 0;
    free(path);
    if (locked)
        close(fd);
    return there;
}

CONTEXT_TEST(test_sweep_removes_own_files_only, 1, 0)
{
    static const char *const names[] = {".out.backup.tmp", ".out.abc123.tmp", ".out.tmp",
                                        ".out.abcdefghijkl.tmp", ".out..............tmp"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        test_text(names[i], "");
        bsq_forget_files(ctx);
        bsq_output_discard(start(ctx, "out"));
        assert_int_equal(unlink(names[i]), 0);
    }
    assert_false(stays(ctx, "a killed job's", false));
    assert_false(stays(ctx, "", false));
    assert_true(stays(ctx, "a running job's", true));
    assert_true(stays(ctx, "", true));
    assert_int_equal(test_files_here(), 0);
}

/* A job reads a directory once, however many outputs it has there, and still removes the leftovers
 * of each. */
CONTEXT_TEST(test_directories_are_read_once, 1, 0)
{
    enum { COUNT = 50 };
    char name[40], *paths[COUNT];
    assert_int_equal(mkdir("sub", 0700), 0);
    for (int i = 0; i < COUNT; i++) {
        int fd;
        snprintf(name, sizeof name, "out%d", i);
        assert_int_equal(bsq_temp_named(i % 2 ? "sub" : ".", name, 0600, &paths[i], &fd), 0);
        close(fd);
    }
    directories_read = 0;
    for (int i = 0; i < 2 * COUNT; i++) {
        snprintf(name, sizeof name, "%sout%d", i / 2 % 2 ? "sub/" : "./", i / 2);
        assert_int_equal(bsq_output_check(ctx, name), 0);
    }
    assert_int_equal(directories_read, 2);
    for (int i = 0; i < COUNT; i++) {
        assert_int_equal(access(paths[i], F_OK), -1);
        free(paths[i]);
    }
    assert_int_equal(rmdir("sub"), 0);
}

/* ---- outputs that belong together ---- */

static struct bsq_output_group start_group(struct bsq_ctx *ctx)
{
    struct bsq_output_group group = {0};
    assert_int_equal(bsq_output_group_add(&group, start(ctx, "a")), 0);
    assert_int_equal(bsq_output_group_add(&group, start(ctx, "b")), 0);
    assert_int_equal(bsq_output_group_add(&group, start(ctx, "c")), 0);
    return group;
}

CONTEXT_TEST(test_group_appears, 1, 0)
{
    test_text("b", "old");
    assert_int_equal(link("b", "other"), 0);
    struct bsq_output_group group = start_group(ctx);
    assert_int_equal(test_files_here(), 2);
    assert_int_equal(bsq_output_group_commit(&group), 0);
    for (const char *name = "abc"; *name; name++) {
        char path[] = {*name, '\0'};
        test_expect_text(path, "new");
        unlink(path);
    }
    test_expect_text("other", "old");
    unlink("other");
    assert_int_equal(test_files_here(), 0);

    group = start_group(ctx);
    bsq_output_group_discard(&group);
    assert_int_equal(test_files_here(), 0);
    assert_int_equal(bsq_output_group_commit(&group), 0); /* empty */
}

CONTEXT_TEST(test_reading_before_the_commit, 1, 0)
{
    struct bsq_output *output = start(ctx, "out");
    struct bsq_file file;
    char text[3];
    assert_int_equal(bsq_output_read(output, &file), 0);
    assert_int_equal(file.size, 3);
    assert_int_equal(bsq_file_read(ctx, &file, text, 3, 0), 0);
    assert_memory_equal(text, "new", 3);
    bsq_file_close(ctx, &file);
    bsq_output_discard(output);
    assert_int_equal(test_files_here(), 0);
}

RUN_TESTS(NULL, NULL)
