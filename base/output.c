/* output.c - a file that appears whole or not at all: which file it replaces, opening and writing.
 *
 * If the file system supports it (O_TMPFILE), the file has no name until it is complete and on the
 * disk: whatever ends the process, nothing is left. It gets a temporary name only to be renamed at
 * once, as a link cannot replace a file. On other file systems it has a temporary name from the
 * start, which the next job with this output removes; see temp.c. */
#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/xattr.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/job_files.h"
#include "base/output_internal.h"

/* Bytes written to the disk between two checks of the interruption flag. */
#define SYNC_BYTES (UINT64_C(32) << 20)

static int output_fail_memory(struct bsq_ctx *ctx, const char *path)
{
    return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
}

static void free_output(struct bsq_output *output)
{
    if (output->fd >= 0)
        close(output->fd);
    if (output->directory_fd >= 0)
        close(output->directory_fd);
    free(output->temp_path);
    free(output->directory);
    free(output->path);
    free(output->noted);
    free(output);
}

/* ---- the final name ---- */

static bool is_file_name(const char *path)
{
    size_t length = strlen(path);
    return length > 0 && path[length - 1] != '/';
}

/* Returns whether a file lies in a directory where only its owner may replace it. */
static bool belongs_to_others(const char *path, const struct stat *file)
{
    struct stat directory;
    char *name = bsq_dirname(path);
    uid_t user = geteuid();
    bool found = name && stat(name, &directory) == 0;
    free(name);
    return found && (directory.st_mode & S_ISVTX) && user != 0 && user != directory.st_uid &&
           user != file->st_uid;
}

/* Returns an errno if the file cannot be renamed over: it is a mount point, immutable or can only
 * be appended to. */
static int check_attributes(const char *path)
{
    struct statx info;
    if (statx(AT_FDCWD, path, 0, 0, &info) != 0)
        return 0;
    if (info.stx_attributes & STATX_ATTR_MOUNT_ROOT)
        return EBUSY;
    return info.stx_attributes & (STATX_ATTR_IMMUTABLE | STATX_ATTR_APPEND) ? EPERM : 0;
}

/* Checks what a commit would find out at the end of the job. `old`: the file that `path` leads to;
 * `target`: its name. */
static int check_replaceable(struct bsq_ctx *ctx, const char *path, const char *target,
                             const struct stat *old)
{
    struct stat named;
    if (S_ISDIR(old->st_mode))
        return bsq_fail_errno(ctx, BSQ_ECANTCREAT, EISDIR, "%s", path);
    if (!S_ISREG(old->st_mode))
        return bsq_fail(ctx, BSQ_ECANTCREAT, "%s: exists and is not a regular file", path);
    /* A link in /proc/self/fd leads to a file that may have another name now, or none. */
    if (stat(target, &named) != 0 || named.st_dev != old->st_dev || named.st_ino != old->st_ino)
        return bsq_fail(ctx, BSQ_ECANTCREAT, "%s: leads to a file without a name", path);
    int error = check_attributes(target);
    if (error == 0 && belongs_to_others(target, old))
        error = EPERM;
    return error ? bsq_fail_errno(ctx, BSQ_ECANTCREAT, error, "%s: cannot be replaced", path) : 0;
}

static int output_find_target(struct bsq_ctx *ctx, const char *path, char **out)
{
    struct stat old;
    bool exists = stat(path, &old) == 0;
    int status = 0, error = exists || errno == ENOENT ? 0 : errno;
    *out = NULL;
    if (!is_file_name(path))
        return bsq_fail(ctx, BSQ_ECANTCREAT, "\"%s\" is not a file name", path);
    if (strcmp(path, "-") == 0) /* standard input, where a path is an input */
        return bsq_fail(ctx, BSQ_ECANTCREAT,
                        "-: no output can be standard output; ./- is a file of this name");
    char *target = error ? NULL : bsq_follow_links(path);
    if (!target)
        return bsq_fail_errno(ctx, BSQ_ECANTCREAT, error ? error : errno, "%s: cannot be created",
                              path);
    if (!is_file_name(target))
        status = bsq_fail(ctx, BSQ_ECANTCREAT, "%s: \"%s\" is not a file name", path, target);
    else if (exists)
        status = check_replaceable(ctx, path, target, &old);
    if (status == 0)
        *out = target;
    else
        free(target);
    return status;
}

/* ---- what the new file inherits ---- */

static const char access_list[] = "system.posix_acl_access";

/* Gives the file the access list of the old one, or none if that has none. Returns whether it has
 * it now. */
static bool keep_access_list(int fd, const char *path)
{
    ssize_t size = getxattr(path, access_list, NULL, 0);
    if (size < 0) {
        bool none = errno == ENODATA || errno == EOPNOTSUPP;
        if (none)
            fremovexattr(fd, access_list);
        return none;
    }
    char *list = malloc((size_t)size + 1);
    bool kept = list && getxattr(path, access_list, list, (size_t)size) == size &&
                fsetxattr(fd, access_list, list, (size_t)size, 0) == 0;
    free(list);
    return kept;
}

/* Returns whether the file has the old one's group now. */
static bool keep_owner(int fd, const struct stat *old, const struct stat *new)
{
    if (new->st_uid == old->st_uid &&new->st_gid == old->st_gid)
        return true;
    return fchown(fd, old->st_uid, old->st_gid) == 0 || new->st_gid == old->st_gid ||
           fchown(fd, (uid_t)-1, old->st_gid) == 0;
}

/* Without the old group or list, the group's bits would apply to other users than before: they get
 * no more than all users. */
int bsq_keep_access(const struct bsq_output *output)
{
    const int fd = output->fd;
    struct stat old = {.st_mode = output->old_mode}, new;
    bool exists = stat(output->path, &old) == 0;
    if (!exists && (errno != ENOENT || !output->old_mode))
        return errno == ENOENT ? 0 : errno;
    if (fstat(fd, &new) != 0)
        return errno;
    mode_t mode = old.st_mode & 0777;
    bool has_group = exists && keep_owner(fd, &old, &new);
    bool has_list = exists && keep_access_list(fd, output->path);
    if (!has_group || !has_list)
        mode &= ~(mode_t)S_IRWXG | (mode & S_IRWXO) << 3;
    if (fchmod(fd, mode) != 0 && errno != EPERM && errno != EOPNOTSUPP)
        return errno;
    return 0; /* not every file system has modes */
}

/* ---- opening ---- */

/* Creates the file. One that replaces another is readable by nobody else in between. */
static int create_temp(struct bsq_output *output)
{
    struct stat old;
    const char *name = bsq_file_name(output->path);
    output->old_mode = stat(output->path, &old) == 0 ? old.st_mode : 0;
    mode_t mode = output->old_mode ? 0600 : 0666;
    int error = bsq_temp_sweep(output->ctx, output->directory, name);
    if (error)
        return error;
    error = bsq_temp_unnamed(output->directory, mode, true, &output->fd);
    if (bsq_temp_lacks_unnamed(error))
        error = bsq_temp_named(output->directory, name, mode, &output->temp_path, &output->fd);
    return error;
}

/* Fails with what the system says, which does not tell a missing folder from other missing names.
 */
static int output_fail_create(const struct bsq_output *output, const char *path, int error)
{
    if (error == ENOENT && access(output->directory, F_OK) < 0)
        return bsq_fail(output->ctx, BSQ_ECANTCREAT, "%s: cannot be created: there is no folder %s",
                        path, output->directory);
    return bsq_fail_errno(output->ctx, BSQ_ECANTCREAT, error, "%s: cannot be created", path);
}

int bsq_output_open(struct bsq_ctx *ctx, const char *path, struct bsq_output **out)
{
    *out = NULL;
    char *target = NULL;
    int status = bsq_note_output(ctx, path);
    if (status == 0)
        status = output_find_target(ctx, path, &target);
    if (!target)
        return status;
    struct bsq_output *output = calloc(1, sizeof *output);
    if (!output) {
        free(target);
        return output_fail_memory(ctx, path);
    }
    output->ctx = ctx;
    output->fd = output->directory_fd = -1;
    output->path = target;
    output->noted = strdup(path);
    output->directory = bsq_dirname(target);
    int error = output->noted && output->directory ? create_temp(output) : ENOMEM;
    if (error) {
        status = output_fail_create(output, path, error);
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
        return output_fail_memory(ctx, what);
    int status = bsq_file_temp(ctx, beside, what, &file);
    if (status < 0) {
        free(output);
        return status;
    }
    output->ctx = ctx;
    output->fd = file.fd;
    output->directory_fd = -1;
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

int bsq_output_fail_write(struct bsq_output *output, int error)
{
    int status = bsq_fail_errno(output->ctx, BSQ_EIO, error, "%s: writing", output->path);
    int none = 0;
    atomic_compare_exchange_strong(&output->status, &none, status);
    return status;
}

static int write_range(struct bsq_output *output, const void *buffer, uint64_t size,
                       uint64_t offset)
{
    atomic_store_explicit(&output->synced, false, memory_order_relaxed);
    int error = bsq_pwrite_all(output->fd, buffer, size, offset);
    atomic_fetch_add_explicit(&output->written, size, memory_order_relaxed);
    return error ? bsq_output_fail_write(output, error) : 0;
}

/* Whoever completes SEND_BYTES starts writing these to the disk. What another thread has not
 * written yet of them is left to the final sync. */
int bsq_output_write_at(struct bsq_output *output, const void *buffer, uint64_t size,
                        uint64_t offset)
{
    const uint64_t from = offset - offset % SEND_BYTES,
                   end = offset + size - (offset + size) % SEND_BYTES;
    int status = write_range(output, buffer, size, offset);
    if (end > offset)
        sync_file_range(output->fd, (off64_t)from, (off64_t)(end - from), SYNC_FILE_RANGE_WRITE);
    return status;
}

int bsq_output_write(struct bsq_output *output, const void *buffer, uint64_t size)
{
    int status = write_range(output, buffer, size, output->position);
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
            return prevents_writing(errno) ? bsq_output_fail_write(output, errno) : 0;
        BSQ_PASS(bsq_check(output->ctx));
    }
    return 0;
}

void bsq_output_skip(struct bsq_output *output, uint64_t size)
{
    output->position += size;
}

uint64_t bsq_output_tell(const struct bsq_output *output)
{
    return output->position;
}

/* ---- syncing and ending ---- */

/* Checks that the file may be kept: reserved space that was not written would be zeros at its end.
 */
static int check_written(struct bsq_output *output)
{
    int status = atomic_load(&output->status);
    const uint64_t written = atomic_load(&output->written);
    if (status == 0 && written < output->expected)
        status = bsq_fail(output->ctx, BSQ_EBUG,
                          "%s: %" PRIu64 " bytes were written, %" PRIu64 " were expected",
                          output->path, written, output->expected);
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
                return bsq_output_fail_write(output, errno);
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
    int error = bsq_keep_access(output);
    if (error == 0 && fstat(output->fd, &info) != 0)
        error = errno;
    if (error)
        return bsq_output_fail_write(output, error);
    status = write_back(output, (uint64_t)info.st_size);
    while (status == 0 && fsync(output->fd) != 0) {
        if (errno != EINTR)
            status = bsq_output_fail_write(output, errno);
    }
    output->synced = status == 0;
    return status;
}

int bsq_output_keep_temp(struct bsq_output *output, struct bsq_file *out)
{
    assert(!output->directory);
    int status = check_written(output);
    struct stat info;
    if (status == 0 && fstat(output->fd, &info) != 0)
        status = bsq_output_fail_write(output, errno);
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

int bsq_output_read(struct bsq_output *output, struct bsq_file *out)
{
    struct bsq_file file = {.fd = output->fd, .path = output->path};
    struct stat info;
    if (fstat(output->fd, &info) != 0) {
        *out = (struct bsq_file)BSQ_FILE_CLOSED;
        return bsq_output_fail_write(output, errno);
    }
    file.size = (uint64_t)info.st_size;
    return bsq_file_duplicate(output->ctx, &file, out);
}

void bsq_output_discard(struct bsq_output *output)
{
    if (!output)
        return;
    if (output->temp_path)
        bsq_temp_remove(output->ctx, output->temp_path);
    free_output(output);
}

int bsq_output_check(struct bsq_ctx *ctx, const char *path)
{
    struct bsq_output *output;
    int status = bsq_output_open(ctx, path, &output);
    if (status == 0)
        bsq_output_discard(output);
    return status;
}
