/* memory_files.c - see memory_files.h.
 *
 * The linker redirects calls of NAME to __wrap_NAME, and calls of __real_NAME to NAME. */
#include "tests/fuzz/memory_files.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/fuzz/fuzz_file.h"

/* FIRST_FD: above all descriptors of the system. */
enum { MAX_FILES = 16, MAX_OPEN = 64, FIRST_FD = 1 << 20 };

struct memory_file {
    const char *path; /* NULL: a temporary file, which lives until its last descriptor is closed */
    const uint8_t *data;
    size_t size;
    uint8_t *written; /* of a temporary file: memory of `capacity` bytes for its data; owned */
    size_t capacity;
    int users; /* descriptors */
    bool used;
};

static bool active;
static struct memory_file files[MAX_FILES];
static struct memory_file *opened[MAX_OPEN]; /* by descriptor */

int __real_open64(const char *path, int flags, ...);
int __real_close(int fd);
int __real_fcntl64(int fd, int command, ...);
int __real_stat64(const char *path, struct stat *out);
int __real_fstat64(int fd, struct stat *out);
ssize_t __real_pread64(int fd, void *buffer, size_t size, off_t offset);
ssize_t __real_pwrite64(int fd, const void *buffer, size_t size, off_t offset);
DIR *__real_opendir(const char *path);
int __real_pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*run)(void *),
                          void *arg);
int __wrap_open64(const char *path, int flags, ...);
int __wrap_close(int fd);
int __wrap_fcntl64(int fd, int command, ...);
int __wrap_stat64(const char *path, struct stat *out);
int __wrap_fstat64(int fd, struct stat *out);
ssize_t __wrap_pread64(int fd, void *buffer, size_t size, off_t offset);
ssize_t __wrap_pwrite64(int fd, const void *buffer, size_t size, off_t offset);
DIR *__wrap_opendir(const char *path);
int __wrap_pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*run)(void *),
                          void *arg);

/* ---- the files ---- */

static struct memory_file *add(const char *path)
{
    int i = 0;
    while (i < MAX_FILES && files[i].used)
        i++;
    require(i < MAX_FILES, "too many files");
    files[i] = (struct memory_file){.used = true, .path = path};
    return &files[i];
}

void memory_files_begin(void)
{
    active = true;
}

void memory_files_add(const char *path, const uint8_t *data, size_t size)
{
    struct memory_file *file = add(path);
    file->data = data;
    file->size = size;
}

void memory_files_end(void)
{
    for (int i = 0; i < MAX_FILES; i++) {
        require(files[i].users == 0, "a file is left open");
        files[i].used = false;
    }
    active = false;
}

static struct memory_file *find(const char *path)
{
    for (int i = 0; i < MAX_FILES; i++)
        if (files[i].used && files[i].path && strcmp(files[i].path, path) == 0)
            return &files[i];
    return NULL;
}

static int give_descriptor(struct memory_file *file)
{
    int i = 0;
    while (i < MAX_OPEN && opened[i])
        i++;
    require(i < MAX_OPEN, "too many open files");
    opened[i] = file;
    file->users++;
    return FIRST_FD + i;
}

static struct memory_file *file_of(int fd)
{
    if (fd < FIRST_FD)
        return NULL;
    require(fd < FIRST_FD + MAX_OPEN && opened[fd - FIRST_FD], "a closed file is used");
    return opened[fd - FIRST_FD];
}

static void describe(const struct memory_file *file, struct stat *out)
{
    *out = (struct stat){.st_dev = 1,
                         .st_ino = (ino_t)(file - files) + 1,
                         .st_nlink = 1,
                         .st_mode = S_IFREG | 0600,
                         .st_size = (off_t)file->size};
}

/* ---- the calls ---- */

int __wrap_open64(const char *path, int flags, ...)
{
    va_list arguments;
    va_start(arguments, flags);
    const mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(arguments, mode_t) : 0;
    va_end(arguments);
    if (!active)
        return __real_open64(path, flags, mode);
    struct memory_file *file = (flags & O_TMPFILE) == O_TMPFILE ? add(NULL) : find(path);
    if (file)
        return give_descriptor(file);
    errno = ENOENT;
    return -1;
}

int __wrap_close(int fd)
{
    struct memory_file *file = file_of(fd);
    if (!file)
        return __real_close(fd);
    opened[fd - FIRST_FD] = NULL;
    if (--file->users == 0 && !file->path) {
        free(file->written);
        file->used = false;
    }
    return 0;
}

int __wrap_fcntl64(int fd, int command, ...)
{
    va_list arguments;
    va_start(arguments, command);
    const long argument = va_arg(arguments, long);
    va_end(arguments);
    struct memory_file *file = file_of(fd);
    if (!file)
        return __real_fcntl64(fd, command, argument);
    require(command == F_DUPFD_CLOEXEC, "fcntl() is called for something else");
    return give_descriptor(file);
}

int __wrap_stat64(const char *path, struct stat *out)
{
    if (!active)
        return __real_stat64(path, out);
    const struct memory_file *file = find(path);
    if (file)
        describe(file, out);
    else
        errno = ENOENT;
    return file ? 0 : -1;
}

int __wrap_fstat64(int fd, struct stat *out)
{
    const struct memory_file *file = file_of(fd);
    if (!file)
        return __real_fstat64(fd, out);
    describe(file, out);
    return 0;
}

ssize_t __wrap_pread64(int fd, void *buffer, size_t size, off_t offset)
{
    const struct memory_file *file = file_of(fd);
    if (!file)
        return __real_pread64(fd, buffer, size, offset);
    const size_t from = (size_t)offset < file->size ? (size_t)offset : file->size;
    const size_t count = size < file->size - from ? size : file->size - from;
    if (count > 0)
        memcpy(buffer, file->data + from, count);
    return (ssize_t)count;
}

/* Temporary files have no holes: bytes are replaced, or appended. */
ssize_t __wrap_pwrite64(int fd, const void *buffer, size_t size, off_t offset)
{
    struct memory_file *file = file_of(fd);
    if (!file)
        return __real_pwrite64(fd, buffer, size, offset);
    const size_t at = (size_t)offset;
    require(!file->path && at <= file->size, "a temporary file gets a hole");
    if (at + size > file->capacity) {
        file->capacity = 2 * (at + size);
        file->data = file->written = realloc(file->written, file->capacity);
    }
    if (!file->written)
        abort(); /* no memory */
    memcpy(file->written + at, buffer, size);
    if (file->size < at + size)
        file->size = at + size;
    return (ssize_t)size;
}

DIR *__wrap_opendir(const char *path)
{
    if (!active)
        return __real_opendir(path);
    errno = ENOENT;
    return NULL;
}

int __wrap_pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*run)(void *),
                          void *arg)
{
    return active ? EAGAIN : __real_pthread_create(thread, attributes, run, arg);
}
