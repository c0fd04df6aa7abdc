/* path.c - paths and descriptors, below everything that opens files. */
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"

/* ---- paths ---- */

const char *bsq_file_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

char *bsq_dirname(const char *path)
{
    const char *slash = strrchr(path, '/');
    if (!slash)
        return strdup(".");
    return strndup(path, slash == path ? 1 : (size_t)(slash - path));
}

/* Returns whether a link may be followed, by the rule of Linux's fs.protected_symlinks: in a
 * directory such as /tmp, where everybody may write, only links of its owner and of this user.
 * Otherwise others could choose which of the user's files an output replaces. */
static bool may_follow(const char *path)
{
    struct stat link, directory;
    char *name = bsq_dirname(path);
    const bool found = name && lstat(path, &link) == 0 && stat(name, &directory) == 0;
    const mode_t shared = S_ISVTX | S_IWOTH;
    free(name);
    return found && ((directory.st_mode & shared) != shared || link.st_uid == geteuid() ||
                     link.st_uid == directory.st_uid);
}

/* Sets *next to the path that a symbolic link names, NULL if `path` is no link. Returns an errno.
 */
static int follow_link(const char *path, char **next)
{
    char target[PATH_MAX];
    *next = NULL;
    ssize_t size = readlink(path, target, sizeof target - 1);
    if (size < 0)
        return errno == EINVAL || errno == ENOENT ? 0 : errno;
    if (!may_follow(path))
        return EACCES;
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

/* ---- descriptors ---- */

int bsq_fd_above_standard(int fd)
{
    if (fd < 0 || fd > STDERR_FILENO)
        return fd;
    int above = fcntl(fd, F_DUPFD_CLOEXEC, STDERR_FILENO + 1), error = errno;
    close(fd);
    errno = error;
    return above;
}

/* A thread may have printed into a new file before its descriptor was moved. */
int bsq_open(const char *path, int flags, mode_t mode)
{
    int first;
    do
        first = open(path, flags | O_CLOEXEC, mode);
    while (first < 0 && errno == EINTR);
    int fd = bsq_fd_above_standard(first);
    bool is_new = (flags & O_EXCL) || (flags & O_TMPFILE) == O_TMPFILE;
    if (fd == first || fd < 0 || !is_new || ftruncate(fd, 0) == 0)
        return fd;
    int error = errno;
    close(fd);
    errno = error;
    return -1;
}

int bsq_pwrite_all(int fd, const void *buffer, uint64_t size, uint64_t offset)
{
    const char *bytes = buffer;
    while (size > 0) {
        ssize_t count = pwrite(fd, bytes, size, (off_t)offset);
        if (count < 0 && errno == EINTR)
            continue;
        if (count < 0)
            return errno;
        if (count == 0)
            return EIO;
        bytes += count;
        size -= (uint64_t)count;
        offset += (uint64_t)count;
    }
    return 0;
}
