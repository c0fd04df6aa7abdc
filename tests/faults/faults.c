/* faults.c - a library for LD_PRELOAD that makes chosen system calls of a program fail, or ends the
 * program at one of them. fault.h has the settings in the environment; further ones are:
 *
 * FAULT_UNDER   only files under this directory count (absolute path without links); required
 * FAULT_CLOCK   seconds by which the system's clock jumps, forth and back, whenever it is read
 * FAULT_SPEED   factor by which clocks that only go forward run faster
 * FAULT_THREADS at most this many threads can be started
 * FAULT_PLAIN   1: opening a file without a name (O_TMPFILE) fails with EOPNOTSUPP
 * FAULT_LOCKS   a file that gets a line for each call of flock, all of which fail with ENOLCK
 *
 * It replaces symbols. It does not see calls inside libc, for example by stdio. */
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

#include "tests/faults/fault.h"

enum { GO_ON = FAULT_GO_ON, SHORT = FAULT_SHORT, FAIL = FAULT_FAIL };

/* Counts a call if its file lies under FAULT_UNDER. */
static int fault(const char *kind, const char *call, const char *path)
{
    const char *under = fault_setting("FAULT_UNDER");
    size_t length = strlen(under);
    if (length == 0 || strncmp(path, under, length) != 0 ||
        (path[length] != '/' && path[length] != '\0'))
        return GO_ON;
    return fault_at(kind, call, path);
}

static int fault_fd(const char *kind, const char *call, int fd)
{
    char name[32], path[4096];
    struct stat info;
    int before = errno;
    if (fd <= STDERR_FILENO || fstat(fd, &info) != 0 ||
        (!S_ISREG(info.st_mode) && !S_ISDIR(info.st_mode)))
        return errno = before, GO_ON;
    snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(name, path, sizeof path - 1);
    errno = before;
    if (size < 0)
        return GO_ON;
    path[size] = '\0';
    return fault(kind, call, path);
}

static int fault_path(const char *kind, const char *call, const char *path)
{
    char absolute[8192], directory[4096];
    if (path[0] != '/' && getcwd(directory, sizeof directory)) {
        while (strncmp(path, "./", 2) == 0)
            path += 2;
        bool here = strcmp(path, ".") == 0;
        snprintf(absolute, sizeof absolute, "%s%s%s", directory, here ? "" : "/", here ? "" : path);
        path = absolute;
    }
    return fault(kind, call, path);
}

/* ---- transfers ---- */

#define TRANSFER(kind, name, number, data)                                                         \
    ssize_t name(int fd, data *buffer, size_t size, off_t offset)                                  \
    {                                                                                              \
        int what = fault_fd(kind, #name, fd);                                                      \
        if (what == FAIL)                                                                          \
            return -1;                                                                             \
        return syscall(number, fd, buffer, what == SHORT ? (size + 1) / 2 : size, offset);         \
    }

TRANSFER("write", pwrite, SYS_pwrite64, const void)
TRANSFER("write", pwrite64, SYS_pwrite64, const void)
TRANSFER("read", pread, SYS_pread64, void)
TRANSFER("read", pread64, SYS_pread64, void)

ssize_t write(int fd, const void *buffer, size_t size)
{
    int what = fault_fd("write", "write", fd);
    return what == FAIL ? -1
                        : syscall(SYS_write, fd, buffer, what == SHORT ? (size + 1) / 2 : size);
}

ssize_t read(int fd, void *buffer, size_t size)
{
    int what = fault_fd("read", "read", fd);
    return what == FAIL ? -1 : syscall(SYS_read, fd, buffer, what == SHORT ? (size + 1) / 2 : size);
}

ssize_t writev(int fd, const struct iovec *parts, int count)
{
    int what = fault_fd("write", "writev", fd);
    if (what == SHORT)
        return syscall(SYS_write, fd, parts[0].iov_base, (parts[0].iov_len + 1) / 2);
    return what == FAIL ? -1 : syscall(SYS_writev, fd, parts, count);
}

static ssize_t write_parts_at(const char *name, int fd, const struct iovec *parts, int count,
                              off_t offset)
{
    int what = fault_fd("write", name, fd);
    if (what == SHORT)
        return syscall(SYS_pwrite64, fd, parts[0].iov_base, (parts[0].iov_len + 1) / 2, offset);
    return what == FAIL ? -1 : syscall(SYS_pwritev, fd, parts, count, offset, 0);
}

ssize_t pwritev(int fd, const struct iovec *parts, int count, off_t offset)
{
    return write_parts_at("pwritev", fd, parts, count, offset);
}

ssize_t pwritev64(int fd, const struct iovec *parts, int count, off_t offset)
{
    return write_parts_at("pwritev64", fd, parts, count, offset);
}

void *mmap(void *address, size_t size, int protection, int flags, int fd, off_t offset)
{
    if (fd >= 0 && fault_fd("map", "mmap", fd) == FAIL)
        return MAP_FAILED;
    return (void *)syscall(SYS_mmap, address, size, protection, flags, fd, offset);
}

void *mmap64(void *address, size_t size, int protection, int flags, int fd, off_t offset)
{
    return mmap(address, size, protection, flags, fd, offset);
}

/* ---- the state of a file ---- */

int fsync(int fd)
{
    return fault_fd("sync", "fsync", fd) == FAIL ? -1 : (int)syscall(SYS_fsync, fd);
}

int fdatasync(int fd)
{
    return fault_fd("sync", "fdatasync", fd) == FAIL ? -1 : (int)syscall(SYS_fdatasync, fd);
}

int sync_file_range(int fd, off64_t offset, off64_t size, unsigned flags)
{
    if (fault_fd("sync", "sync_file_range", fd) == FAIL)
        return -1;
    return (int)syscall(SYS_sync_file_range, fd, offset, size, flags);
}

int fallocate(int fd, int mode, off_t offset, off_t size)
{
    if (fault_fd("size", "fallocate", fd) == FAIL)
        return -1;
    return (int)syscall(SYS_fallocate, fd, mode, offset, size);
}

int fallocate64(int fd, int mode, off64_t offset, off64_t size)
{
    return fallocate(fd, mode, offset, size);
}

int posix_fallocate(int fd, off_t offset, off_t size)
{
    return fallocate(fd, 0, offset, size) == 0 ? 0 : errno;
}

int posix_fallocate64(int fd, off64_t offset, off64_t size)
{
    return posix_fallocate(fd, offset, size);
}

int ftruncate(int fd, off_t size)
{
    return fault_fd("size", "ftruncate", fd) == FAIL ? -1 : (int)syscall(SYS_ftruncate, fd, size);
}

int ftruncate64(int fd, off64_t size)
{
    return ftruncate(fd, size);
}

/* A descriptor is closed even if close() fails. */
int close(int fd)
{
    int what = fault_fd("close", "close", fd), error = errno;
    int result = (int)syscall(SYS_close, fd);
    if (what != FAIL)
        return result;
    errno = error;
    return -1;
}

/* ---- locks ---- */

int flock(int fd, int operation)
{
    const char *log = fault_setting("FAULT_LOCKS");
    if (!*log)
        return (int)syscall(SYS_flock, fd, operation);
    int to = (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND, 0600);
    syscall(SYS_write, to, "flock\n", (size_t)6);
    syscall(SYS_close, to);
    errno = ENOLCK;
    return -1;
}

/* ---- names ---- */

static int open_at(const char *call, int directory, const char *path, int flags, mode_t mode)
{
    if ((flags & O_TMPFILE) == O_TMPFILE && *fault_setting("FAULT_PLAIN")) {
        errno = EOPNOTSUPP;
        return -1;
    }
    if (directory == AT_FDCWD && fault_path("open", call, path) == FAIL)
        return -1;
    return (int)syscall(SYS_openat, directory, path, flags, mode);
}

#define OPEN_MODE(flags, mode)                                                                     \
    mode_t mode = 0;                                                                               \
    if ((flags) & (O_CREAT | O_TMPFILE)) {                                                         \
        va_list arguments;                                                                         \
        va_start(arguments, flags);                                                                \
        mode = va_arg(arguments, mode_t);                                                          \
        va_end(arguments);                                                                         \
    }

int open(const char *path, int flags, ...)
{
    OPEN_MODE(flags, mode)
    return open_at("open", AT_FDCWD, path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
    OPEN_MODE(flags, mode)
    return open_at("open64", AT_FDCWD, path, flags, mode);
}

int openat(int directory, const char *path, int flags, ...)
{
    OPEN_MODE(flags, mode)
    return open_at("openat", directory, path, flags, mode);
}

int openat64(int directory, const char *path, int flags, ...)
{
    OPEN_MODE(flags, mode)
    return open_at("openat64", directory, path, flags, mode);
}

static FILE *open_stream(const char *call, const char *path, const char *mode)
{
    static FILE *(*real)(const char *, const char *);
    if (fault_path("open", call, path) == FAIL)
        return NULL;
    if (!real)
        *(void **)&real = dlsym(RTLD_NEXT, "fopen64");
    return real(path, mode);
}

FILE *fopen(const char *path, const char *mode)
{
    return open_stream("fopen", path, mode);
}

FILE *fopen64(const char *path, const char *mode)
{
    return open_stream("fopen64", path, mode);
}

int rename(const char *from, const char *to)
{
    if (fault_path("name", "rename", to) == FAIL)
        return -1;
    return (int)syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
}

int renameat(int from_directory, const char *from, int to_directory, const char *to)
{
    if (fault_path("name", "renameat", to) == FAIL)
        return -1;
    return (int)syscall(SYS_renameat2, from_directory, from, to_directory, to, 0);
}

int renameat2(int from_directory, const char *from, int to_directory, const char *to,
              unsigned flags)
{
    if (fault_path("name", "renameat2", to) == FAIL)
        return -1;
    return (int)syscall(SYS_renameat2, from_directory, from, to_directory, to, flags);
}

int linkat(int from_directory, const char *from, int to_directory, const char *to, int flags)
{
    if (fault_path("name", "linkat", to) == FAIL)
        return -1;
    return (int)syscall(SYS_linkat, from_directory, from, to_directory, to, flags);
}

int unlink(const char *path)
{
    return fault_path("remove", "unlink", path) == FAIL
               ? -1
               : (int)syscall(SYS_unlinkat, AT_FDCWD, path, 0);
}

/* ---- threads ---- */

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*start)(void *),
                   void *arg)
{
    static atomic_ulong started;
    static int (*next)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
    const char *most = getenv("FAULT_THREADS");
    if (most && atomic_fetch_add(&started, 1) >= strtoul(most, NULL, 10))
        return EAGAIN;
    if (!next)
        *(void **)&next = dlsym(RTLD_NEXT, "pthread_create");
    return next(thread, attributes, start, arg);
}

/* ---- clocks ---- */

int clock_gettime(clockid_t id, struct timespec *out)
{
    static atomic_long looks;
    const long jump = atol(fault_setting("FAULT_CLOCK")),
               speed = atol(fault_setting("FAULT_SPEED"));
    const int result = (int)syscall(SYS_clock_gettime, id, out);
    if (id == CLOCK_REALTIME)
        out->tv_sec += atomic_fetch_add(&looks, 1) % 2 ? jump : -jump;
    else if (speed > 0 && (id == CLOCK_MONOTONIC || id == CLOCK_MONOTONIC_COARSE))
        out->tv_sec = out->tv_sec * speed + out->tv_nsec * speed / 1000000000;
    return result;
}

time_t time(time_t *out)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out)
        *out = now.tv_sec;
    return now.tv_sec;
}
