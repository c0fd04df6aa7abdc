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
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/output_internal.h"
#include "base/text.h"

enum { RANDOM_LETTERS = 6, CHECK_LETTERS = 6, NAME_BYTES = 200, ATTEMPTS = 100 };

static const char suffix[] = ".tmp";

/* ---- names ---- */

static const char letters[] = "abcdefghijklmnopqrstuvwxyz0123456789";

/* What follows the name: ".XXXXXXCCCCCC.tmp". */
struct ending {
    char text[1 + RANDOM_LETTERS + CHECK_LETTERS + sizeof suffix];
};

/* Appends the check letters and the suffix to "." and random letters. The checksum is of the name
 * and these letters. */
static void finish_ending(const char *name, size_t length, struct ending *ending)
{
    char *end = ending->text + 1 + RANDOM_LETTERS;
    uint64_t hash = bsq_text_hash(BSQ_HASH_START, name, length);
    hash = bsq_text_hash(hash, ending->text, 1 + RANDOM_LETTERS);
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
    finish_ending(name, strnlen(name, NAME_BYTES), &ending);
    if (asprintf(path, "%s/.%.*s%s", directory, NAME_BYTES, name, ending.text) < 0) {
        *path = NULL;
        return ENOMEM;
    }
    return 0;
}

/* Returns the length of the name from which new_path() can have made `entry`, and which follows the
 * first character; 0: it has not made it. */
static size_t temp_name_length(const char *entry)
{
    struct ending ending = {"."};
    const size_t others = 1 + sizeof ending.text - 1, all = strlen(entry);
    if (entry[0] != '.' || all <= others || all - others > NAME_BYTES)
        return 0;
    const size_t length = all - others;
    memcpy(ending.text + 1, entry + 1 + length + 1, RANDOM_LETTERS);
    finish_ending(entry + 1, length, &ending);
    return strcmp(entry + 1 + length, ending.text) == 0 ? length : 0;
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
    if (fstat(fd, &info) == 0 && S_ISREG(info.st_mode) && flock(fd, LOCK_EX | LOCK_NB) == 0 &&
        names_file_at(directory_fd, entry, fd))
        unlinkat(directory_fd, entry, 0);
    close(fd);
}

/* ---- leftovers ---- */

/* Temporary names that a directory had when the job first looked. There are hardly any, while the
 * directory may have very many files, and a job very many outputs there. */
struct swept {
    dev_t device;
    ino_t inode;
    struct bsq_texts names;
};

struct bsq_sweeps {
    struct swept *list;
    uint64_t count, capacity;
    struct bsq_tally tally;
};

static int list_names(struct bsq_ctx *ctx, struct bsq_tally *tally, DIR *list,
                      struct bsq_texts *names)
{
    int status = 0;
    uint64_t number;
    for (struct dirent *entry; status == 0 && (entry = readdir(list));)
        if (temp_name_length(entry->d_name) > 0)
            status = bsq_texts_add(ctx, tally, names, entry->d_name, &number);
    return status == 0 ? 0 : ENOMEM;
}

/* Sets *out to the names in a directory; NULL: it cannot be read. Returns an errno. */
static int find_swept(struct bsq_ctx *ctx, struct bsq_sweeps *sweeps, const char *directory,
                      const struct swept **out)
{
    struct stat info;
    *out = NULL;
    if (stat(directory, &info) != 0)
        return 0;
    for (uint64_t i = sweeps->count; i-- > 0 && !*out;)
        if (sweeps->list[i].inode == info.st_ino && sweeps->list[i].device == info.st_dev)
            *out = &sweeps->list[i];
    DIR *list = *out ? NULL : opendir(directory);
    if (!list)
        return 0;
    struct swept swept = {.device = info.st_dev, .inode = info.st_ino};
    int error = bsq_tally_grow(ctx, &sweeps->tally, sweeps->count + 1, sizeof *sweeps->list,
                               &sweeps->list, &sweeps->capacity) == 0
                    ? list_names(ctx, &sweeps->tally, list, &swept.names)
                    : ENOMEM;
    closedir(list);
    if (error) {
        bsq_texts_free(&swept.names);
        return error;
    }
    sweeps->list[sweeps->count] = swept;
    *out = &sweeps->list[sweeps->count++];
    return 0;
}

static void remove_leftovers(const struct swept *swept, const char *directory, const char *name)
{
    const size_t length = strnlen(name, NAME_BYTES);
    int fd = -1;
    for (uint64_t i = 0; i < swept->names.count; i++) {
        const char *entry = swept->names.list[i];
        if (strncmp(entry + 1, name, length) != 0 || temp_name_length(entry) != length)
            continue;
        if (fd < 0)
            fd = bsq_open(directory, O_RDONLY | O_DIRECTORY, 0);
        if (fd >= 0)
            remove_unowned(fd, entry);
    }
    if (fd >= 0)
        close(fd);
}

static void free_sweeps(struct bsq_ctx *ctx, void *object)
{
    struct bsq_sweeps *sweeps = object;
    for (uint64_t i = 0; i < sweeps->count; i++)
        bsq_texts_free(&sweeps->list[i].names);
    bsq_tally_release(ctx, &sweeps->tally);
    free(sweeps->list);
    free(sweeps);
}

int bsq_temp_sweep(struct bsq_ctx *ctx, const char *directory, const char *name)
{
    const struct swept *swept = NULL;
    pthread_mutex_lock(&ctx->members_lock);
    struct bsq_sweeps *sweeps = bsq_member_of(ctx, BSQ_SWEEPS, sizeof *sweeps, free_sweeps);
    int error = sweeps ? find_swept(ctx, sweeps, directory, &swept) : ENOMEM;
    if (error == 0 && swept)
        remove_leftovers(swept, directory, name);
    pthread_mutex_unlock(&ctx->members_lock);
    return error;
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

bool bsq_temp_lacks_unnamed(int error)
{
    return error == EOPNOTSUPP || error == EISDIR || error == ENOENT || error == EINVAL;
}

/* Creates a file with this name and locks it. Between the two, another process may take it for a
 * leftover and remove it; then returns EEXIST, so that the caller tries another name. */
static int create_locked(const char *path, mode_t mode, int *fd)
{
    *fd = bsq_open(path, O_RDWR | O_CREAT | O_EXCL, mode);
    if (*fd < 0)
        return errno;
    if (lock(*fd) == 0 && bsq_temp_names_file(path, *fd))
        return 0;
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

void bsq_temp_remove(struct bsq_ctx *ctx, const char *path)
{
    if (unlink(path) != 0 && errno != ENOENT && unlink(path) != 0 && errno != ENOENT)
        bsq_warn(ctx, "%s: this temporary file cannot be removed: %s", path, strerror(errno));
}
