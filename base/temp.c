/* temp.c - names of temporary files, and the locks that show whether their owner lives.
 *
 * Files are created with open(2), not by mkstemp(3). So the umask and the directory's access list
 * give an output that replaces no file the permissions of a plain new file. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <sys/xattr.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/temp_internal.h"

enum { RANDOM_LETTERS = 6, CHECK_LETTERS = 6, NAME_BYTES = 200, ATTEMPTS = 100 };

static const char suffix[] = ".tmp";

/* ---- names ---- */

static const char letters[] = "abcdefghijklmnopqrstuvwxyz0123456789";

/* What follows the name: ".XXXXXXCCCCCC.tmp". */
struct ending {
    char text[1 + RANDOM_LETTERS + CHECK_LETTERS + sizeof suffix];
};

/* Appends the check letters and the suffix to "." and random letters. The checksum is FNV-1a
 * (Fowler, Noll, Vo) of the name and these letters. */
static void finish_ending(const char *name, struct ending *ending)
{
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    char *end = ending->text + 1 + RANDOM_LETTERS;
    for (size_t i = strnlen(name, NAME_BYTES); i > 0; i--)
        hash = (hash ^ (unsigned char)*name++) * UINT64_C(0x100000001b3);
    for (const char *c = ending->text; c < end; c++)
        hash = (hash ^ (unsigned char)*c) * UINT64_C(0x100000001b3);
    for (int i = 0; i < CHECK_LETTERS; i++, hash /= sizeof letters - 1)
        *end++ = letters[hash % (sizeof letters - 1)];
    memcpy(end, suffix, sizeof suffix);
}

static int new_path(const char *directory, const char *name, char **path)
{
    unsigned char bytes[RANDOM_LETTERS];
    struct ending ending = {"."};
    if (getrandom(bytes, sizeof bytes, 0) != (ssize_t)sizeof bytes) {
        int error = errno;
        *path = NULL;
        return error ? error : EIO;
    }
    for (int i = 0; i < RANDOM_LETTERS; i++)
        ending.text[1 + i] = letters[bytes[i] % (sizeof letters - 1)];
    finish_ending(name, &ending);
    if (asprintf(path, "%s/.%.*s%s", directory, NAME_BYTES, name, ending.text) < 0) {
        *path = NULL;
        return ENOMEM;
    }
    return 0;
}

/* Returns true if new_path() can have made `entry` from `name`. */
static bool is_temp_name(const char *entry, const char *name)
{
    size_t length = strnlen(name, NAME_BYTES);
    struct ending ending = {"."};
    if (entry[0] != '.' || strlen(entry) != 1 + length + sizeof ending.text - 1 ||
        strncmp(entry + 1, name, length) != 0)
        return false;
    memcpy(ending.text + 1, entry + 1 + length + 1, RANDOM_LETTERS);
    finish_ending(name, &ending);
    return strcmp(entry + 1 + length, ending.text) == 0;
}

/* ---- marks ---- */

static const char mark[] = "user.bisque.temporary";

static void set_mark(int fd)
{
    fsetxattr(fd, mark, "", 0, 0); /* without a mark the file is removed later, or never */
}

bool bsq_temp_mark_path(const char *path)
{
    return setxattr(path, mark, "", 0, 0) == 0 || errno == EOPNOTSUPP;
}

void bsq_temp_unmark_path(const char *path)
{
    removexattr(path, mark);
}

void bsq_temp_unmark(int fd)
{
    fremovexattr(fd, mark);
}

/* Returns whether a file with a temporary name is one of ours. */
static bool is_ours(int fd, const struct stat *info)
{
    if (!S_ISREG(info->st_mode))
        return false;
    if (fgetxattr(fd, mark, NULL, 0) >= 0)
        return true;
    return errno == EOPNOTSUPP || (errno == ENODATA && info->st_size == 0);
}

/* ---- locks ---- */

/* Returns 0 if this descriptor now holds the lock, or if the file system has no locks. */
static int lock(int fd)
{
    int result;
    do
        result = flock(fd, LOCK_EX | LOCK_NB);
    while (result != 0 && errno == EINTR);
    return result != 0 && errno == EWOULDBLOCK ? EWOULDBLOCK : 0;
}

static bool names_file_at(int directory_fd, const char *path, int fd)
{
    struct stat named, opened;
    return fstatat(directory_fd, path, &named, AT_SYMLINK_NOFOLLOW) == 0 &&
           fstat(fd, &opened) == 0 && named.st_dev == opened.st_dev &&
           named.st_ino == opened.st_ino;
}

bool bsq_temp_names_file(const char *path, int fd)
{
    return names_file_at(AT_FDCWD, path, fd);
}

/* Removes one file if it can be locked and is still the file that was locked. Opens it for writing,
 * as NFS needs for an exclusive lock. */
static void remove_unowned(int directory_fd, const char *entry)
{
    const int flags = O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC;
    struct stat info;
    int fd = openat(directory_fd, entry, O_RDWR | flags);
    if (fd < 0 && errno == EACCES) /* it replaces a file that is read-only */
        fd = openat(directory_fd, entry, O_RDONLY | flags);
    fd = bsq_fd_above_standard(fd);
    if (fd < 0)
        return;
    if (fstat(fd, &info) == 0 && is_ours(fd, &info) && flock(fd, LOCK_EX | LOCK_NB) == 0 &&
        names_file_at(directory_fd, entry, fd))
        unlinkat(directory_fd, entry, 0);
    close(fd);
}

void bsq_temp_sweep(const char *directory, const char *name)
{
    DIR *list = opendir(directory);
    if (!list)
        return;
    for (struct dirent *entry; (entry = readdir(list));) {
        if (is_temp_name(entry->d_name, name))
            remove_unowned(dirfd(list), entry->d_name);
    }
    closedir(list);
}

/* ---- files ---- */

static void descriptor_path(int fd, char path[32])
{
    snprintf(path, 32, "/proc/self/fd/%d", fd);
}

int bsq_temp_unnamed(const char *directory, mode_t mode, int linkable, int *fd)
{
    char path[32];
    int error = 0;
    *fd = bsq_open(directory, O_TMPFILE | O_RDWR, mode);
    if (*fd < 0)
        return errno;
    descriptor_path(*fd, path);
    if (linkable && access(path, F_OK) != 0) { /* /proc is not mounted */
        error = EOPNOTSUPP;
        close(*fd);
        *fd = -1;
    }
    return error;
}

/* Creates a file with this name and locks it. Between the two, another process may take it for a
 * leftover and remove it; then returns EEXIST, so that the caller tries another name. */
static int create_locked(const char *path, mode_t mode, int *fd)
{
    *fd = bsq_open(path, O_RDWR | O_CREAT | O_EXCL, mode);
    if (*fd < 0)
        return errno;
    if (lock(*fd) == 0 && bsq_temp_names_file(path, *fd)) {
        set_mark(*fd);
        return 0;
    }
    close(*fd);
    *fd = -1;
    return EEXIST;
}

int bsq_temp_named(const char *directory, const char *name, mode_t mode, char **path, int *fd)
{
    int error = EEXIST;
    *path = NULL;
    *fd = -1;
    for (int attempt = 0; attempt < ATTEMPTS && error == EEXIST; attempt++) {
        free(*path);
        error = new_path(directory, name, path);
        if (error == 0)
            error = create_locked(*path, mode, fd);
    }
    if (error) {
        free(*path);
        *path = NULL;
    }
    return error;
}

int bsq_temp_link(int fd, const char *directory, const char *name, char **path)
{
    char source[32];
    int error = lock(fd) == 0 ? EEXIST : EWOULDBLOCK;
    set_mark(fd);
    descriptor_path(fd, source);
    *path = NULL;
    for (int attempt = 0; attempt < ATTEMPTS && error == EEXIST; attempt++) {
        free(*path);
        error = new_path(directory, name, path);
        if (error == 0 && linkat(AT_FDCWD, source, AT_FDCWD, *path, AT_SYMLINK_FOLLOW) != 0)
            error = errno == EINTR ? EEXIST : errno;
    }
    if (error) {
        free(*path);
        *path = NULL;
    }
    return error;
}
