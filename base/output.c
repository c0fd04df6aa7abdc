/* output.c - a file that appears whole or not at all.
 *
 * The temporary file is created with open(2) and mode 0666 rather than by mkstemp(3), so that the
 * umask and the directory's access list give it the permissions that a plain new file would have.
 */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/output.h"

struct bsq_output {
    struct bsq_ctx *ctx;
    char *path;      /* final name, symbolic links followed */
    char *directory; /* of both names */
    char *temp_path; /* NULL: not created */
    int fd;
    uint64_t position;
    atomic_int status; /* first failure: such an output cannot be committed */
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

/* Only a regular file may be replaced; a link is kept and the file that it names is replaced. */
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

static int random_name(char name[7])
{
    static const char letters[] = "abcdefghijklmnopqrstuvwxyz0123456789";
    unsigned char bytes[6];
    if (getrandom(bytes, sizeof bytes, 0) != (ssize_t)sizeof bytes)
        return errno ? errno : EIO;
    for (int i = 0; i < 6; i++)
        name[i] = letters[bytes[i] % (sizeof letters - 1)];
    name[6] = '\0';
    return 0;
}

/* Creates ".NAME.XXXXXX.tmp"; NAME is shortened so that the whole stays below NAME_MAX. */
static int create_temp(struct bsq_output *output)
{
    const char *slash = strrchr(output->path, '/');
    const char *name = slash ? slash + 1 : output->path;
    int error = EEXIST;
    for (int attempt = 0; attempt < 100 && error == EEXIST; attempt++) {
        char random[7];
        error = random_name(random);
        if (error)
            break;
        free(output->temp_path);
        if (asprintf(&output->temp_path, "%s/.%.200s.%s.tmp", output->directory, name, random) <
            0) {
            output->temp_path = NULL;
            return ENOMEM;
        }
        output->fd = open(output->temp_path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        error = output->fd >= 0 ? 0 : errno == EINTR ? EEXIST : errno;
    }
    if (error) {
        free(output->temp_path);
        output->temp_path = NULL;
    }
    return error;
}

int bsq_output_open(struct bsq_ctx *ctx, const char *path, struct bsq_output **out)
{
    *out = NULL;
    char *resolved;
    int status = resolve_path(ctx, path, &resolved);
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

/* ---- writing ---- */

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
    int error = bsq_pwrite_all(output->fd, buffer, size, offset);
    return error ? fail_write(output, error) : 0;
}

int bsq_output_write(struct bsq_output *output, const void *buffer, uint64_t size)
{
    int status = bsq_output_write_at(output, buffer, size, output->position);
    if (status == 0)
        output->position += size;
    return status;
}

/* Copies inside the kernel; *copied < size where it cannot (other file systems, old kernels). */
static int copy_in_kernel(struct bsq_output *output, const struct bsq_file *from, uint64_t offset,
                          uint64_t size, uint64_t *copied)
{
    *copied = 0;
    while (*copied < size) {
        int status = bsq_check(output->ctx);
        if (status < 0)
            return status;
        uint64_t part = size - *copied;
        if (part > UINT64_C(64) << 20)
            part = UINT64_C(64) << 20;
        off64_t in = (off64_t)(offset + *copied), at = (off64_t)output->position;
        ssize_t count = copy_file_range(from->fd, &in, output->fd, &at, part, 0);
        if (count < 0 && errno == EINTR)
            continue;
        if (count < 0 && (errno == ENOSPC || errno == EDQUOT || errno == EIO))
            return fail_write(output, errno);
        if (count <= 0)
            return 0;
        *copied += (uint64_t)count;
        output->position += (uint64_t)count;
    }
    return 0;
}

static int copy_through_buffer(struct bsq_output *output, const struct bsq_file *from,
                               uint64_t offset, uint64_t size)
{
    char *buffer;
    uint64_t capacity = size < (UINT64_C(1) << 20) ? size : UINT64_C(1) << 20;
    int status = bsq_alloc(output->ctx, "copying", capacity, 1, &buffer);
    while (status == 0 && size > 0) {
        uint64_t part = size < capacity ? size : capacity;
        status = bsq_check(output->ctx);
        if (status == 0)
            status = bsq_file_read(output->ctx, from, buffer, part, offset);
        if (status == 0)
            status = bsq_output_write(output, buffer, part);
        offset += part;
        size -= part;
    }
    bsq_free(output->ctx, buffer);
    return status;
}

int bsq_output_copy(struct bsq_output *output, const struct bsq_file *from, uint64_t offset,
                    uint64_t size)
{
    uint64_t copied;
    int status = copy_in_kernel(output, from, offset, size, &copied);
    if (status == 0 && copied < size)
        status = copy_through_buffer(output, from, offset + copied, size - copied);
    return status;
}

uint64_t bsq_output_tell(const struct bsq_output *output)
{
    return output->position;
}

int bsq_output_align(struct bsq_output *output, uint64_t alignment)
{
    static const char zeros[4096];
    uint64_t rest = output->position % alignment;
    uint64_t padding = rest ? alignment - rest : 0;
    int status = 0;
    while (status == 0 && padding > 0) {
        uint64_t part = padding < sizeof zeros ? padding : sizeof zeros;
        status = bsq_output_write(output, zeros, part);
        padding -= part;
    }
    return status;
}

int bsq_output_fd(const struct bsq_output *output)
{
    return output->fd;
}

const char *bsq_output_temp_path(const struct bsq_output *output)
{
    return output->temp_path;
}

/* ---- the end ---- */

static int sync_directory(const char *directory)
{
    int fd = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0)
        return errno == EACCES ? 0 : errno; /* one may write to a directory that one cannot list */
    int error = fsync(fd) == 0 ? 0 : errno;
    close(fd);
    return error == EINVAL || error == EROFS ? 0 : error; /* not every file system can */
}

static int sync_temp(struct bsq_output *output)
{
    int fd = output->fd;
    output->fd = -1;
    int error = fsync(fd) == 0 ? 0 : errno;
    if (close(fd) != 0 && error == 0 && errno != EINTR)
        error = errno;
    return error;
}

int bsq_output_commit(struct bsq_output *output)
{
    struct bsq_ctx *ctx = output->ctx;
    int status = output->status;
    if (status == 0) {
        int error = sync_temp(output);
        if (error)
            status = fail_write(output, error);
    }
    if (status == 0 && rename(output->temp_path, output->path) != 0)
        status = bsq_fail_errno(ctx, BSQ_ECANTCREAT, errno, "%s: cannot be created", output->path);
    if (status < 0) {
        bsq_output_discard(output);
        return status;
    }
    int error = sync_directory(output->directory);
    if (error)
        status = bsq_fail_errno(ctx, BSQ_EIO, error, "%s: syncing the directory", output->path);
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
