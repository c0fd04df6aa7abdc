/* output_target.c - which file an output replaces, and what it inherits from that file. */
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/xattr.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/output_internal.h"

/* ---- the final name ---- */

/* Sets *next to the path that a symbolic link names, NULL if `path` is no link. Returns an errno.
 */
static int follow_link(const char *path, char **next)
{
    char target[PATH_MAX];
    *next = NULL;
    ssize_t size = readlink(path, target, sizeof target - 1);
    if (size < 0)
        return errno == EINVAL || errno == ENOENT ? 0 : errno;
    target[size] = '\0';
    int directory = target[0] == '/' ? 0 : (int)(bsq_file_name(path) - path);
    return asprintf(next, "%.*s%s", directory, path, target) < 0 ? ENOMEM : 0;
}

char *bsq_follow_links(const char *path)
{
    enum { MOST_LINKS = 40 }; /* as many as Linux follows */
    char *at = strdup(path), *next = at;
    int error = at ? 0 : ENOMEM;
    for (int links = 0; error == 0 && next; links++) {
        error = links <= MOST_LINKS ? follow_link(at, &next) : ELOOP;
        if (error == 0 && next) {
            free(at);
            at = next;
        }
    }
    if (error == 0)
        return at;
    free(at);
    errno = error;
    return NULL;
}

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

int bsq_output_target(struct bsq_ctx *ctx, const char *path, char **out)
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
