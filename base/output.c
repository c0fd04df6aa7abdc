/* output.c - a file that appears whole or not at all.
 *
 * If the file system supports it (O_TMPFILE), the file has no name until it is complete and on the
 * disk: whatever ends the process, nothing is left. It gets a temporary name only to be renamed at
 * once, as a link cannot replace a file. On other file systems it has a temporary name from the
 * start, which the next job with this output removes; see temp_internal.h. */
#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/job_files.h"
#include "base/output.h"
#include "base/temp_internal.h"

/* Bytes written to the disk between two checks of the interruption flag. */
#define SYNC_BYTES (UINT64_C(32) << 20)

struct bsq_output {
    struct bsq_ctx *ctx;
    char *path;      /* final name, symbolic links followed; or a name for messages only */
    char *directory; /* of both names; NULL: the file gets no final name */
    char *temp_path; /* NULL: the file has no name */
    int fd;
    uint64_t position;
    uint64_t expected;  /* a file with fewer appended bytes may not be kept */
    uint64_t sent;      /* bytes whose writing to the disk was started */
    atomic_bool synced; /* all is on the disk, and nothing was written after that */
    atomic_int status;  /* first failure; an output that has one cannot be committed */
};

static int fail_memory(struct bsq_ctx *ctx, const char *path)
{
    return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
}

static void free_output(struct bsq_output *output)
{
    if (output->fd >= 0)
        close(output->fd);
    free(output->temp_path);
    free(output->directory);
    free(output->path);
    free(output);
}

/* ---- opening ---- */

/* Resolves the final name. Only a regular file may be replaced. A symbolic link is kept, and the
 * file that it names is replaced. */
static int resolve_path(struct bsq_ctx *ctx, const char *path, char **out)
{
    struct stat info;
    *out = NULL;
    size_t length = strlen(path);
    if (length == 0 || path[length - 1] == '/')
        return bsq_fail(ctx, BSQ_ECANTCREAT, "\"%s\" is not a file name", path);
    if (stat(path, &info) == 0) {
        if (S_ISDIR(info.st_mode))
            return bsq_fail_errno(ctx, BSQ_ECANTCREAT, EISDIR, "%s", path);
        if (!S_ISREG(info.st_mode))
            return bsq_fail(ctx, BSQ_ECANTCREAT, "%s: exists and is not a regular file", path);
        *out = realpath(path, NULL);
    } else {
        *out = strdup(path);
    }
    if (!*out)
        return bsq_fail_errno(ctx, BSQ_ECANTCREAT, errno, "%s", path);
    return 0;
}

static const char *file_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* Returns true for errors that mean that the file system, or a layer above it, has no unnamed
 * files. */
static bool lacks_unnamed(int error)
{
    return error == EOPNOTSUPP || error == EISDIR || error == ENOENT || error == EINVAL;
}

static int create_temp(struct bsq_output *output)
{
    const char *name = file_name(output->path);
    bsq_temp_sweep(output->directory, name);
    int error = bsq_temp_unnamed(output->directory, 0666, true, &output->fd);
    if (lacks_unnamed(error))
        error = bsq_temp_named(output->directory, name, 0666, &output->temp_path, &output->fd);
    return error;
}

int bsq_output_open(struct bsq_ctx *ctx, const char *path, struct bsq_output **out)
{
    *out = NULL;
    char *resolved = NULL;
    int status = bsq_note_output(ctx, path);
    if (status == 0)
        status = resolve_path(ctx, path, &resolved);
    if (!resolved)
        return status;
    struct bsq_output *output = calloc(1, sizeof *output);
    if (!output) {
        free(resolved);
        return fail_memory(ctx, path);
    }
    output->ctx = ctx;
    output->fd = -1;
    output->path = resolved;
    output->directory = bsq_dirname(resolved);
    int error = output->directory ? create_temp(output) : ENOMEM;
    if (error) {
        status = bsq_fail_errno(ctx, BSQ_ECANTCREAT, error, "%s: cannot be created", path);
        free_output(output);
        return status;
    }
    *out = output;
    return 0;
}

int bsq_output_open_temp(struct bsq_ctx *ctx, const char *beside, const char *what,
                         struct bsq_output **out)
{
    struct bsq_file file;
    *out = NULL;
    struct bsq_output *output = calloc(1, sizeof *output);
    if (!output)
        return fail_memory(ctx, what);
    int status = bsq_file_temp(ctx, beside, what, &file);
    if (status < 0) {
        free(output);
        return status;
    }
    output->ctx = ctx;
    output->fd = file.fd;
    output->path = file.path;
    *out = output;
    return 0;
}

/* ---- writing ---- */

/* Starts writing to the disk after this many bytes. */
#define SEND_BYTES ((uint64_t)4 << 20)

/* Starts writing the appended bytes to the disk, so that the final sync has little left to do.
 * Failures here are reported by that sync. */
static void send_to_disk(struct bsq_output *output)
{
    if (output->position - output->sent < SEND_BYTES)
        return;
    sync_file_range(output->fd, (off64_t)output->sent, (off64_t)(output->position - output->sent),
                    SYNC_FILE_RANGE_WRITE);
    output->sent = output->position;
}

static int fail_write(struct bsq_output *output, int error)
{
    int status = bsq_fail_errno(output->ctx, BSQ_EIO, error, "%s: writing", output->path);
    int none = 0;
    atomic_compare_exchange_strong(&output->status, &none, status);
    return status;
}

int bsq_output_write_at(struct bsq_output *output, const void *buffer, uint64_t size,
                        uint64_t offset)
{
    atomic_store_explicit(&output->synced, false, memory_order_relaxed);
    int error = bsq_pwrite_all(output->fd, buffer, size, offset);
    return error ? fail_write(output, error) : 0;
}

int bsq_output_write(struct bsq_output *output, const void *buffer, uint64_t size)
{
    int status = bsq_output_write_at(output, buffer, size, output->position);
    if (status == 0) {
        output->position += size;
        send_to_disk(output);
    }
    return status;
}

/* Returns true for errors that keep a file from being written at all, not only from reserving
 * space. */
static bool prevents_writing(int error)
{
    return error == ENOSPC || error == EDQUOT || error == EFBIG || error == EIO;
}

/* If a signal ends the call, tmpfs gives back all space that it has reserved so far. */
int bsq_output_expect(struct bsq_output *output, uint64_t size)
{
    atomic_store_explicit(&output->synced, false, memory_order_relaxed);
    output->expected = size;
    while (fallocate(output->fd, 0, 0, (off64_t)size) != 0) {
        if (errno != EINTR)
            return prevents_writing(errno) ? fail_write(output, errno) : 0;
        int status = bsq_check(output->ctx);
        if (status < 0)
            return status;
    }
    return 0;
}

uint64_t bsq_output_tell(const struct bsq_output *output)
{
    return output->position;
}

/* ---- syncing, committing and discarding ---- */

/* Checks that the file may be kept: reserved space that was not written would be zeros at its end.
 */
static int check_written(struct bsq_output *output)
{
    int status = atomic_load(&output->status);
    if (status == 0 && output->position < output->expected)
        status = bsq_fail(output->ctx, BSQ_EBUG,
                          "%s: %" PRIu64 " bytes were written, %" PRIu64 " were expected",
                          output->path, output->position, output->expected);
    return status;
}

/* Writes the cached bytes to the disk in parts, so that an interruption need not wait for all of
 * them, as it would in fsync(). fsync() does not report a failure again that was reported here. */
static int write_back(struct bsq_output *output, uint64_t size)
{
    const unsigned flags =
        SYNC_FILE_RANGE_WAIT_BEFORE | SYNC_FILE_RANGE_WRITE | SYNC_FILE_RANGE_WAIT_AFTER;
    for (uint64_t at = 0; at < size; at += SYNC_BYTES) {
        int status = bsq_check(output->ctx);
        if (status < 0)
            return status;
        while (sync_file_range(output->fd, (off64_t)at, (off64_t)SYNC_BYTES, flags) != 0) {
            if (errno == EIO || errno == ENOSPC || errno == EDQUOT)
                return fail_write(output, errno);
            if (errno != EINTR)
                return 0; /* not every file system can; fsync() follows */
        }
    }
    return 0;
}

int bsq_output_sync(struct bsq_output *output)
{
    struct stat info;
    int status = check_written(output);
    if (status < 0 || output->synced || !output->directory)
        return status;
    if (fstat(output->fd, &info) != 0)
        return fail_write(output, errno);
    status = write_back(output, (uint64_t)info.st_size);
    while (status == 0 && fsync(output->fd) != 0) {
        if (errno != EINTR)
            status = fail_write(output, errno);
    }
    output->synced = status == 0;
    return status;
}

static int sync_directory(const char *directory)
{
    int fd = bsq_open(directory, O_RDONLY | O_DIRECTORY, 0);
    if (fd < 0)
        return errno == EACCES ? 0 : errno; /* a directory may be writable but not readable */
    int error;
    do
        error = fsync(fd) == 0 ? 0 : errno;
    while (error == EINTR);
    close(fd);
    return error == EINVAL || error == EROFS ? 0 : error; /* not every file system can */
}

static int fail_create(struct bsq_output *output, int error)
{
    return bsq_fail_errno(output->ctx, BSQ_ECANTCREAT, error, "%s: cannot be created",
                          output->path);
}

static int copy_whole(struct bsq_output *output, const struct bsq_file *from, uint64_t size)
{
    char buffer[1 << 16];
    int status = 0;
    output->position = output->sent = 0;
    while (status == 0 && output->position < size) {
        uint64_t left = size - output->position;
        uint64_t part = left < sizeof buffer ? left : sizeof buffer;
        status = bsq_check(output->ctx);
        if (status == 0)
            status = bsq_file_read(output->ctx, from, buffer, part, output->position);
        if (status == 0)
            status = bsq_output_write(output, buffer, part);
    }
    return status;
}

/* Copies the unnamed file to one with a temporary name, on file systems that cannot name it later.
 */
static int copy_to_named(struct bsq_output *output)
{
    struct bsq_file unnamed = {.fd = output->fd, .path = output->path};
    struct stat info;
    if (fstat(unnamed.fd, &info) != 0)
        return fail_write(output, errno);
    int error = bsq_temp_named(output->directory, file_name(output->path), 0666, &output->temp_path,
                               &output->fd);
    int status;
    if (error) {
        output->fd = unnamed.fd;
        return fail_create(output, error);
    }
    atomic_store_explicit(&output->synced, false, memory_order_relaxed);
    status = copy_whole(output, &unnamed, (uint64_t)info.st_size);
    close(unnamed.fd);
    return status == 0 ? bsq_output_sync(output) : status;
}

static int name_temp(struct bsq_output *output)
{
    if (output->temp_path)
        return 0;
    int error =
        bsq_temp_link(output->fd, output->directory, file_name(output->path), &output->temp_path);
    if (error == ENOSPC || error == EDQUOT || error == EIO || error == ENOMEM || error == EROFS)
        return fail_create(output, error);
    return error ? copy_to_named(output) : 0;
}

static int rename_retrying(const char *from, const char *to)
{
    int result;
    do
        result = rename(from, to);
    while (result != 0 && errno == EINTR);
    return result;
}

/* Keeps the descriptor open, and with it the lock on the temporary name, until that name is gone.
 * fsync() has reported what close() could report. */
int bsq_output_commit(struct bsq_output *output)
{
    assert(output->directory);
    int status = bsq_output_sync(output);
    if (status == 0)
        status = name_temp(output);
    if (status == 0 && rename_retrying(output->temp_path, output->path) != 0)
        status = fail_create(output, errno);
    if (status < 0) {
        bsq_output_discard(output);
        return status;
    }
    bsq_note_written(output->ctx, output->path);
    int error = sync_directory(output->directory);
    if (error)
        status =
            bsq_fail_errno(output->ctx, BSQ_EIO, error, "%s: syncing the directory", output->path);
    free_output(output);
    return status;
}

int bsq_output_keep_temp(struct bsq_output *output, struct bsq_file *out)
{
    assert(!output->directory);
    int status = check_written(output);
    struct stat info;
    if (status == 0 && fstat(output->fd, &info) != 0)
        status = fail_write(output, errno);
    if (status == 0) {
        *out = (struct bsq_file){
            .fd = output->fd, .size = (uint64_t)info.st_size, .path = output->path};
        output->fd = -1;
        output->path = NULL;
    } else {
        *out = (struct bsq_file)BSQ_FILE_CLOSED;
    }
    free_output(output);
    return status;
}

void bsq_output_discard(struct bsq_output *output)
{
    if (!output)
        return;
    if (output->temp_path)
        unlink(output->temp_path);
    free_output(output);
}
