/* file.c - input and temporary files.
 *
 * Everything goes through pread and pwrite: no shared file position, so that threads can work on
 * one descriptor, and no mapped writes, which a full disk would turn into SIGBUS. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/output_internal.h"

/* ---- descriptors ---- */

/* Counts the open files, or only the standard ones if /proc is not mounted. */
static uint64_t count_open(void)
{
    DIR *list = opendir("/proc/self/fd");
    uint64_t count = 0;
    if (!list)
        return STDERR_FILENO + 1;
    for (struct dirent *entry; (entry = readdir(list));)
        count += entry->d_name[0] != '.';
    closedir(list);
    return count > 0 ? count - 1 : 0; /* the list itself is closed now */
}

int bsq_require_descriptors(struct bsq_ctx *ctx, const char *output, uint64_t count)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0 || count <= limit.rlim_cur / 2)
        return 0;
    const uint64_t open = count_open();
    if (open <= limit.rlim_cur && count <= limit.rlim_cur - open)
        return 0;
    return bsq_fail_errno(ctx, BSQ_ECANTCREAT, EMFILE,
                          "%s: %" PRIu64 " outputs must be open together with %" PRIu64
                          " other files, the limit is %" PRIu64,
                          output, count, open, (uint64_t)limit.rlim_cur);
}

/* ---- input ---- */

static struct bsq_identity identity_of(const struct stat *info)
{
    return (struct bsq_identity){.device = info->st_dev,
                                 .inode = info->st_ino,
                                 .size = (uint64_t)info->st_size,
                                 .modified = info->st_mtim,
                                 .changed = info->st_ctim};
}

void bsq_identity_text(const struct bsq_identity *identity, char text[BSQ_IDENTITY_BYTES])
{
    snprintf(text, BSQ_IDENTITY_BYTES, "%" PRIu64 " %" PRIu64 " %jd.%09ld %jd.%09ld",
             identity->inode, identity->size, (intmax_t)identity->modified.tv_sec,
             identity->modified.tv_nsec, (intmax_t)identity->changed.tv_sec,
             identity->changed.tv_nsec);
}

/* Only an open descriptor shows for sure what kind of file it is. */
static int check_kind(struct bsq_ctx *ctx, const char *path, const struct stat *info)
{
    if (S_ISDIR(info->st_mode))
        return bsq_fail_errno(ctx, BSQ_ENOINPUT, EISDIR, "%s", path);
    if (!S_ISREG(info->st_mode))
        return bsq_fail(ctx, BSQ_ENOINPUT, "%s: not a regular file", path);
    return 0;
}

/* Reports that open() failed. A socket gives an error whose text says little. */
static int fail_open(struct bsq_ctx *ctx, const char *path, int error)
{
    if (error == ENXIO)
        return bsq_fail(ctx, BSQ_ENOINPUT, "%s: not a regular file", path);
    return bsq_fail_errno(ctx, BSQ_ENOINPUT, error, "%s", path);
}

int bsq_file_open_as(struct bsq_ctx *ctx, const char *path, enum bsq_open how, struct bsq_file *out)
{
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    struct stat info;
    /* O_NONBLOCK: opening a pipe must not wait for a writer before it can be refused. */
    int fd = bsq_open(path, O_RDONLY | O_NONBLOCK | O_NOCTTY, 0);
    if (fd < 0)
        return fail_open(ctx, path, errno);
    struct bsq_file file = {.fd = fd, .path = strdup(path)};
    int status = 0;
    if (!file.path)
        BSQ_TRY(bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path));
    if (fstat(fd, &info) != 0)
        BSQ_TRY(bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", path));
    BSQ_TRY(check_kind(ctx, path, &info));
    file.identity = identity_of(&info);
    file.size = file.identity.size;
    if (how == BSQ_OPEN_INPUT)
        BSQ_TRY(bsq_hold_input(ctx, path, &file.identity));
    *out = file;
    return 0;
done:
    bsq_file_close(ctx, &file);
    return status;
}

int bsq_file_open(struct bsq_ctx *ctx, const char *path, struct bsq_file *out)
{
    return bsq_file_open_as(ctx, path, BSQ_OPEN_INPUT, out);
}

int bsq_file_check(struct bsq_ctx *ctx, const struct bsq_file *file)
{
    struct stat info;
    if (file->identity.inode == 0) /* not an input */
        return 0;
    if (fstat(file->fd, &info) != 0)
        return bsq_fail_errno(ctx, BSQ_EIO, errno, "%s", file->path);
    struct bsq_identity now = identity_of(&info);
    return bsq_same_identity(&now, &file->identity) ? 0 : bsq_fail_changed(ctx, file->path);
}

int bsq_file_duplicate(struct bsq_ctx *ctx, const struct bsq_file *file, struct bsq_file *out)
{
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    char *path = strdup(file->path);
    if (!path)
        return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", file->path);
    int fd = fcntl(file->fd, F_DUPFD_CLOEXEC, STDERR_FILENO + 1);
    if (fd < 0) {
        free(path);
        return bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", file->path);
    }
    *out = *file;
    out->fd = fd;
    out->path = path;
    return 0;
}

void bsq_file_close(struct bsq_ctx *ctx, struct bsq_file *file)
{
    (void)ctx;
    if (file->fd >= 0)
        close(file->fd);
    free(file->path);
    *file = (struct bsq_file)BSQ_FILE_CLOSED;
}

/* ---- transfers ---- */

int bsq_file_read_some(struct bsq_ctx *ctx, const struct bsq_file *file, void *buffer,
                       uint64_t size, uint64_t offset, uint64_t *got)
{
    *got = 0;
    while (*got < size) {
        ssize_t count = pread(file->fd, (char *)buffer + *got, size - *got, (off_t)(offset + *got));
        if (count < 0 && errno == EINTR)
            continue;
        if (count < 0)
            return bsq_fail_errno(ctx, BSQ_EIO, errno, "%s: reading at byte %llu", file->path,
                                  (unsigned long long)(offset + *got));
        if (count == 0)
            break;
        *got += (uint64_t)count;
    }
    return 0;
}

/* The wait looks for an interruption now and then. */
int bsq_pipe_read(struct bsq_ctx *ctx, int fd, const char *path, void *buffer, uint64_t size,
                  uint64_t *got)
{
    enum { PATIENCE_MS = 50 };
    struct pollfd poll_fd = {.fd = fd, .events = POLLIN};
    for (;;) {
        BSQ_PASS(bsq_check(ctx));
        ssize_t count = poll(&poll_fd, 1, PATIENCE_MS);
        if (count == 0)
            continue;
        if (count > 0)
            count = read(fd, buffer, size);
        *got = count > 0 ? (uint64_t)count : 0;
        if (count >= 0)
            return 0;
        if (errno != EINTR && errno != EAGAIN)
            return bsq_fail_errno(ctx, BSQ_EIO, errno, "%s", path);
    }
}

void bsq_file_read_ahead(const struct bsq_file *file, uint64_t size, uint64_t offset)
{
    (void)posix_fadvise(file->fd, (off_t)offset, (off_t)size, POSIX_FADV_WILLNEED);
}

int bsq_file_read(struct bsq_ctx *ctx, const struct bsq_file *file, void *buffer, uint64_t size,
                  uint64_t offset)
{
    uint64_t got;
    int status = bsq_file_read_some(ctx, file, buffer, size, offset, &got);
    if (status < 0 || got == size)
        return status;
    status = bsq_file_check(ctx, file);
    if (status == 0)
        status =
            bsq_fail(ctx, BSQ_EDATA, "%s: truncated: %llu bytes expected at byte %llu, %llu there",
                     file->path, (unsigned long long)size, (unsigned long long)offset,
                     (unsigned long long)got);
    return status;
}

int bsq_file_write(struct bsq_ctx *ctx, const struct bsq_file *file, const void *buffer,
                   uint64_t size, uint64_t offset)
{
    int error = bsq_pwrite_all(file->fd, buffer, size, offset);
    if (error)
        return bsq_fail_errno(ctx, BSQ_EIO, error, "%s: writing %llu bytes at byte %llu",
                              file->path, (unsigned long long)size, (unsigned long long)offset);
    atomic_fetch_add_explicit(&ctx->temp_bytes, size, memory_order_relaxed);
    return 0;
}

int bsq_file_append(struct bsq_ctx *ctx, struct bsq_file *file, const void *buffer, uint64_t size)
{
    int status = bsq_file_write(ctx, file, buffer, size, file->size);
    if (status == 0)
        file->size += size;
    return status;
}

/* ---- temporary files ---- */

static char *temp_directory(struct bsq_ctx *ctx, const char *beside)
{
    if (bsq_tmpdir(ctx))
        return strdup(bsq_tmpdir(ctx));
    return beside ? bsq_dirname(beside) : bsq_output_directory(ctx);
}

/* Opens a file without a name, or one that loses its name at once if the file system has no unnamed
 * files. */
static int open_unnamed(struct bsq_ctx *ctx, const char *directory, int *fd)
{
    static const char name[] = "bisque";
    char *path;
    int error = bsq_temp_unnamed(directory, 0600, false, fd);
    if (!bsq_temp_lacks_unnamed(error))
        return error;
    error = bsq_temp_sweep(ctx, directory, name);
    if (error)
        return error;
    error = bsq_temp_named(directory, name, 0600, &path, fd);
    if (error == 0)
        bsq_temp_remove(ctx, path);
    free(path);
    return error;
}

int bsq_file_temp(struct bsq_ctx *ctx, const char *beside, const char *what, struct bsq_file *out)
{
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    char *directory = temp_directory(ctx, beside), *label = NULL;
    int status = 0, fd = -1;
    if (!directory || asprintf(&label, "%s: temporary file for %s", directory, what) < 0) {
        label = NULL;
        BSQ_TRY(bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "temporary file for %s", what));
    }
    const int error = open_unnamed(ctx, directory, &fd);
    if (error)
        BSQ_TRY(bsq_fail_errno(ctx, BSQ_ECANTCREAT, error, "%s", label));
    *out = (struct bsq_file){.fd = fd, .size = 0, .path = label};
    label = NULL;
done:
    free(label);
    free(directory);
    return status;
}

int bsq_temp_check(struct bsq_ctx *ctx, const char *output)
{
    struct bsq_file file;
    const int status = bsq_file_temp(ctx, output, "chunks", &file);
    bsq_file_close(ctx, &file);
    return status;
}

uint64_t bsq_temp_bytes(const struct bsq_ctx *ctx)
{
    return atomic_load(&ctx->temp_bytes);
}

static int require_free(struct bsq_ctx *ctx, const char *directory, const char *what,
                        uint64_t bytes)
{
    struct statvfs info;
    uint64_t available;
    if (statvfs(directory, &info) != 0)
        return bsq_fail_errno(ctx, BSQ_ECANTCREAT, errno, "%s", directory);
    if (__builtin_mul_overflow((uint64_t)info.f_bavail, (uint64_t)info.f_frsize, &available) ||
        available >= bytes)
        return 0;
    return bsq_fail(ctx, BSQ_EIO, "%s: %llu bytes are needed for %s, %llu are free", directory,
                    (unsigned long long)bytes, what, (unsigned long long)available);
}

int bsq_require_disk(struct bsq_ctx *ctx, const char *beside, uint64_t bytes)
{
    char *directory = temp_directory(ctx, beside);
    if (!directory)
        return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "temporary files");
    int status = require_free(ctx, directory, "temporary files", bytes);
    free(directory);
    return status;
}

static bool same_file_system(const char *a, const char *b)
{
    struct stat info_a, info_b;
    return stat(a, &info_a) == 0 && stat(b, &info_b) == 0 && info_a.st_dev == info_b.st_dev;
}

int bsq_require_space(struct bsq_ctx *ctx, const char *output, uint64_t output_bytes,
                      uint64_t temp_bytes)
{
    char *directory = bsq_dirname(output), *temp = temp_directory(ctx, output);
    int status = 0;
    if (!directory || !temp) {
        status = bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", output);
        goto done;
    }
    const bool together = temp_bytes > 0 && same_file_system(directory, temp);
    BSQ_TRY(require_free(ctx, directory, together ? "outputs and temporary files" : "outputs",
                         output_bytes + (together ? temp_bytes : 0)));
    if (temp_bytes > 0 && !together)
        status = require_free(ctx, temp, "temporary files", temp_bytes);
done:
    free(temp);
    free(directory);
    return status;
}
