/* output_commit.c - gives outputs their final names: all outputs of a job, or none.
 *
 * All are synced and have a temporary name before the first is renamed, so that hardly anything is
 * left that can fail. Every rename but the last exchanges the names of the new and the old file. If
 * a later one fails, the old files get their names back. */
#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/job_files.h"
#include "base/output_internal.h"

static int commit_fail_create(struct bsq_output *output, int error)
{
    return bsq_fail_errno(output->ctx, BSQ_ECANTCREAT, error, "%s: cannot be created",
                          output->path);
}

/* ---- temporary names ---- */

static int copy_whole(struct bsq_output *output, const struct bsq_file *from, uint64_t size)
{
    char buffer[1 << 16];
    output->position = output->sent = 0;
    while (output->position < size) {
        uint64_t left = size - output->position;
        uint64_t step = left < sizeof buffer ? left : sizeof buffer;
        BSQ_PASS(bsq_check(output->ctx));
        BSQ_PASS(bsq_file_read(output->ctx, from, buffer, step, output->position));
        BSQ_PASS(bsq_output_write(output, buffer, step));
    }
    return 0;
}

/* Copies the unnamed file to one with a temporary name, on file systems that cannot name it later.
 */
static int copy_to_named(struct bsq_output *output)
{
    struct bsq_file unnamed = {.fd = output->fd, .path = output->path};
    struct stat info;
    if (fstat(unnamed.fd, &info) != 0)
        return bsq_output_fail_write(output, errno);
    mode_t mode = output->old_mode ? 0600 : info.st_mode & 0666;
    int error = bsq_temp_named(output->directory, bsq_file_name(output->path), mode,
                               &output->temp_path, &output->fd);
    if (error) {
        output->fd = unnamed.fd;
        return commit_fail_create(output, error);
    }
    atomic_store_explicit(&output->synced, false, memory_order_relaxed);
    int status = copy_whole(output, &unnamed, (uint64_t)info.st_size);
    close(unnamed.fd);
    return status == 0 ? bsq_output_sync(output) : status;
}

/* Gives a complete file a temporary name. Before that it gets the access rights that the old file
 * has now: they may have changed since it was synced. */
static int name_temp(struct bsq_output *output)
{
    int error = bsq_keep_access(output);
    if (error)
        return bsq_output_fail_write(output, error);
    if (output->temp_path)
        return 0;
    error = bsq_temp_link(output->fd, output->directory, bsq_file_name(output->path),
                          &output->temp_path);
    if (error == ENOSPC || error == EDQUOT || error == EIO || error == ENOMEM || error == EROFS)
        return commit_fail_create(output, error);
    return error ? copy_to_named(output) : 0;
}

/* ---- final names ---- */

/* Renames with renameat2(2). Returns 0 or an errno. */
static int rename_retrying(const char *from, const char *to, unsigned flags)
{
    int result;
    do
        result = flags ? renameat2(AT_FDCWD, from, AT_FDCWD, to, flags) : rename(from, to);
    while (result != 0 && errno == EINTR);
    return result == 0 ? 0 : errno;
}

static void forget_temp_name(struct bsq_output *output)
{
    free(output->temp_path);
    output->temp_path = NULL;
}

static bool is_regular(const char *path)
{
    struct stat info;
    return lstat(path, &info) == 0 && S_ISREG(info.st_mode);
}

/* Gives a file its final name so that this can be taken back. An old file has the temporary name
 * then: if the process is killed, the next job removes it. Returns EINVAL if the file system cannot
 * do it. */
static int exchange_names(struct bsq_output *output)
{
    int error = rename_retrying(output->temp_path, output->path, RENAME_NOREPLACE);
    output->created = error == 0;
    if (error != EEXIST)
        return error;
    if (!is_regular(output->path))
        return EINVAL;
    error = rename_retrying(output->temp_path, output->path, RENAME_EXCHANGE);
    output->exchanged = error == 0;
    return error;
}

/* `last`: no later rename can fail. */
static int give_name(struct bsq_output *output, bool last)
{
    int error = last ? EINVAL : exchange_names(output);
    if (error == EINVAL || error == ENOSYS || error == EOPNOTSUPP) {
        output->created = access(output->path, F_OK) != 0;
        error = rename_retrying(output->temp_path, output->path, 0);
    }
    if (error)
        return commit_fail_create(output, error);
    if (!output->exchanged)
        forget_temp_name(output);
    return 0;
}

/* Undoes give_name(), unless another job has replaced the file meanwhile. On file systems that
 * cannot exchange names, the old file is gone and the new one stays. */
static void take_back_name(struct bsq_output *output)
{
    if (!bsq_temp_names_file(output->path, output->fd))
        return;
    if (output->exchanged && rename_retrying(output->temp_path, output->path, 0) == 0)
        forget_temp_name(output);
    else if (output->created)
        unlink(output->path);
}

/* Opens the directory of an output, to sync it after the rename. */
static int open_directory(struct bsq_output *output)
{
    output->directory_fd = bsq_open(output->directory, O_RDONLY | O_DIRECTORY, 0);
    if (output->directory_fd < 0 && errno != EACCES) /* it may be writable but not readable */
        return commit_fail_create(output, errno);
    return 0;
}

static int sync_directory(struct bsq_output *output)
{
    int error;
    if (output->directory_fd < 0)
        return 0;
    do
        error = fsync(output->directory_fd) == 0 ? 0 : errno;
    while (error == EINTR);
    if (error == 0 || error == EINVAL || error == EROFS) /* not every file system can */
        return 0;
    return bsq_fail_errno(output->ctx, BSQ_EIO, error, "%s: syncing the directory", output->path);
}

/* ---- commit ---- */

/* Does all that may fail for want of space or descriptors. Opens each directory once. */
static int commit_prepare(struct bsq_output *const *outputs, unsigned count)
{
    for (unsigned i = 0; i < count; i++)
        BSQ_PASS(bsq_output_sync(outputs[i]));
    for (unsigned i = 0; i < count; i++)
        if (i == 0 || strcmp(outputs[i]->directory, outputs[i - 1]->directory) != 0)
            BSQ_PASS(open_directory(outputs[i]));
    for (unsigned i = 0; i < count; i++) {
        BSQ_PASS(bsq_check(outputs[i]->ctx));
        BSQ_PASS(name_temp(outputs[i]));
    }
    return 0;
}

static int give_names(struct bsq_output *const *outputs, unsigned count)
{
    for (unsigned i = 0; i < count; i++) {
        int status = give_name(outputs[i], i + 1 == count);
        while (status < 0 && i-- > 0)
            take_back_name(outputs[i]);
        if (status < 0)
            return status;
    }
    return 0;
}

/* Keeps the descriptors open, and with them the locks on the temporary names, until those names are
 * gone. fsync() has reported what close() could report. */
static int commit_all(struct bsq_output *const *outputs, unsigned count)
{
    int status = commit_prepare(outputs, count);
    if (status == 0)
        status = give_names(outputs, count);
    for (unsigned i = 0; status == 0 && i < count; i++) {
        bsq_note_written(outputs[i]->ctx, outputs[i]->noted);
        if (outputs[i]->exchanged) {
            /* the file that this output has replaced */
            bsq_temp_remove(outputs[i]->ctx, outputs[i]->temp_path);
            forget_temp_name(outputs[i]);
        }
    }
    for (unsigned i = 0; status == 0 && i < count; i++)
        status = sync_directory(outputs[i]);
    for (unsigned i = 0; i < count; i++)
        bsq_output_discard(outputs[i]); /* removes what still has a temporary name */
    return status;
}

int bsq_output_commit(struct bsq_output *output)
{
    return commit_all(&output, 1);
}

/* ---- groups ---- */

int bsq_output_group_add(struct bsq_output_group *group, struct bsq_output *output)
{
    /* A few pointers are not counted against the budget. */
    struct bsq_output **list = reallocarray(group->list, group->count + 1, sizeof(void *));
    if (!list) {
        int status = bsq_fail_errno(output->ctx, BSQ_ENOMEM, ENOMEM, "%s", output->path);
        bsq_output_discard(output);
        return status;
    }
    group->list = list;
    list[group->count++] = output;
    return 0;
}

int bsq_output_group_commit(struct bsq_output_group *group)
{
    int status = commit_all(group->list, group->count);
    group->count = 0;
    bsq_output_group_discard(group);
    return status;
}

void bsq_output_group_discard(struct bsq_output_group *group)
{
    while (group->count > 0)
        bsq_output_discard(group->list[--group->count]);
    free(group->list);
    *group = (struct bsq_output_group){0};
}
