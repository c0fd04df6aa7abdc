/* map.c - maps whole files read-only and survives files that shrink under the reader.
 *
 * Reading a page that a file no longer has, or that the disk cannot deliver, raises SIGBUS. A
 * handler for the whole process finds the address among the open maps, puts pages of zeros there
 * and marks the map. The reader goes on with zeros until bsq_map_check() ends the job. So code that
 * follows values in a mapped file must bound them: zeros must be safe to read.
 *
 * A handler cannot lock. It walks a list of ranges that only grows: an entry is filled in before it
 * is linked, and reused after its map is closed. mmap() is a plain system call on Linux, so a
 * handler can call it. Signals that are not about a map go to the previous handler. */
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"

struct bsq_map_range {
    atomic_uint version;         /* odd while start and end are changed */
    atomic_uintptr_t start, end; /* both 0: not in use */
    atomic_bool lost;            /* the handler has put zeros there */
    struct bsq_map_range *next;
};

static struct bsq_map_range *_Atomic ranges;

/* Guarded by the lock; `before` and `page_bytes` are not changed while the handler is installed. */
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static unsigned open_maps;
static bool installed;
static struct sigaction before;
static uintptr_t page_bytes;

/* ---- the handler ---- */

/* Returns the end of a range if `address` lies in it, else 0.
 *
 * Another thread may be reusing the entry for a new map. Then its start and end do not belong
 * together, and its version says so. Such an entry cannot hold the address: its old map is closed,
 * and nobody can read its new map yet. So the handler never waits. All accesses are sequentially
 * consistent. */
static uintptr_t end_around(const struct bsq_map_range *range, uintptr_t address)
{
    unsigned version = atomic_load(&range->version);
    uintptr_t start = atomic_load(&range->start), end = atomic_load(&range->end);
    if (version % 2 != 0 || atomic_load(&range->version) != version)
        return 0;
    return address >= start && address < end ? end : 0;
}

/* `lost` is set first: whoever reads the zeros on another thread must also see it. */
static bool put_zeros(uintptr_t address)
{
    struct bsq_map_range *range = atomic_load(&ranges);
    uintptr_t end = 0;
    while (range && (end = end_around(range, address)) == 0)
        range = range->next;
    if (!range)
        return false;
    uintptr_t page = address & ~(page_bytes - 1);
    atomic_store(&range->lost, true);
    return mmap((void *)page, end - page, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1,
                0) != MAP_FAILED;
}

/* Passes a signal on to the previous handler. By default the process must die of it: a fault comes
 * again when the handler returns; a signal that somebody sent must be sent again. */
static void pass_on(int number, siginfo_t *info, void *context)
{
    bool fault = info->si_code > 0;
    if (before.sa_flags & SA_SIGINFO) {
        before.sa_sigaction(number, info, context);
    } else if (before.sa_handler == SIG_DFL || (before.sa_handler == SIG_IGN && fault)) {
        signal(number, SIG_DFL);
        if (!fault)
            raise(number);
    } else if (before.sa_handler != SIG_IGN) {
        before.sa_handler(number);
    }
}

static void on_bus_error(int number, siginfo_t *info, void *context)
{
    int error = errno;
    if (info->si_code <= 0 || !put_zeros((uintptr_t)info->si_addr))
        pass_on(number, info, context);
    errno = error;
}

static bool is_ours(const struct sigaction *action)
{
    return (action->sa_flags & SA_SIGINFO) && action->sa_sigaction == on_bus_error;
}

/* Installs the handler, for the first map. If a later handler has kept ours, ours is still in
 * place. */
static void install(void)
{
    struct sigaction action = {.sa_sigaction = on_bus_error, .sa_flags = SA_SIGINFO | SA_ONSTACK};
    sigemptyset(&action.sa_mask);
    if (open_maps++ > 0 || installed)
        return;
    page_bytes = (uintptr_t)sysconf(_SC_PAGESIZE);
    installed = sigaction(SIGBUS, NULL, &before) == 0 && sigaction(SIGBUS, &action, NULL) == 0;
}

/* Removes the handler after the last map, but only if no later handler builds on it. */
static void uninstall(void)
{
    struct sigaction now;
    if (--open_maps > 0 || !installed)
        return;
    if (sigaction(SIGBUS, NULL, &now) == 0 && is_ours(&now))
        installed = sigaction(SIGBUS, &before, NULL) != 0;
}

/* ---- ranges ---- */

static struct bsq_map_range *find_free(void)
{
    struct bsq_map_range *range = atomic_load(&ranges);
    while (range && atomic_load(&range->end) != 0)
        range = range->next;
    return range;
}

static void map_set_range(struct bsq_map_range *range, uintptr_t start, uintptr_t end)
{
    atomic_fetch_add(&range->version, 1);
    atomic_store(&range->start, start);
    atomic_store(&range->end, end);
    atomic_fetch_add(&range->version, 1);
}

/* Returns NULL if there is no memory. */
static struct bsq_map_range *watch(const void *data, uint64_t size)
{
    pthread_mutex_lock(&lock);
    struct bsq_map_range *range = find_free(), *added = NULL;
    if (!range)
        range = added = calloc(1, sizeof *range);
    if (range) {
        uintptr_t start = (uintptr_t)data;
        install();
        atomic_store(&range->lost, false);
        map_set_range(range, start, (start + size + page_bytes - 1) & ~(page_bytes - 1));
    }
    if (added) {
        added->next = atomic_load(&ranges);
        atomic_store_explicit(&ranges, added, memory_order_release);
    }
    pthread_mutex_unlock(&lock);
    return range;
}

static void unwatch(struct bsq_map_range *range)
{
    pthread_mutex_lock(&lock);
    map_set_range(range, 0, 0);
    uninstall();
    pthread_mutex_unlock(&lock);
}

/* ---- maps ---- */

static int map_file(struct bsq_ctx *ctx, struct bsq_file *file, struct bsq_map *out)
{
    struct stat info;
    if (file->size > PTRDIFF_MAX)
        return bsq_fail_errno(ctx, BSQ_ENOINPUT, EFBIG, "%s", file->path);
    if (fstat(file->fd, &info) != 0)
        return bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", file->path);
    if (file->size > 0) {
        void *data = mmap(NULL, file->size, PROT_READ, MAP_SHARED, file->fd, 0);
        if (data == MAP_FAILED)
            return bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s: mapping %llu bytes", file->path,
                                  (unsigned long long)file->size);
        out->range = watch(data, file->size);
        if (!out->range) {
            munmap(data, file->size);
            return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", file->path);
        }
        out->data = data;
    }
    out->size = file->size;
    out->path = file->path;
    out->fd = file->fd;
    out->modified = info.st_mtim;
    *file = (struct bsq_file)BSQ_FILE_CLOSED;
    return 0;
}

int bsq_map_file(struct bsq_ctx *ctx, struct bsq_file *file, struct bsq_map *out)
{
    *out = (struct bsq_map)BSQ_MAP_CLOSED;
    int status = map_file(ctx, file, out);
    bsq_file_close(ctx, file);
    return status;
}

int bsq_map_open(struct bsq_ctx *ctx, const char *path, struct bsq_map *out)
{
    *out = (struct bsq_map)BSQ_MAP_CLOSED;
    struct bsq_file file;
    int status = bsq_file_open(ctx, path, &file);
    return status == 0 ? bsq_map_file(ctx, &file, out) : status;
}

/* Returns whether the mapped bytes are those of the file when it was opened. */
static bool is_sound(const struct bsq_map *map)
{
    struct stat info;
    return !map->range ||
           (fstat(map->fd, &info) == 0 && (uint64_t)info.st_size == map->size &&
            info.st_mtim.tv_sec == map->modified.tv_sec &&
            info.st_mtim.tv_nsec == map->modified.tv_nsec && !atomic_load(&map->range->lost));
}

int bsq_map_explain(struct bsq_ctx *ctx, const struct bsq_map *map, int status)
{
    if (status == BSQ_EINTR || is_sound(map))
        return status;
    bsq_clear_error(ctx);
    return bsq_map_check(ctx, map);
}

int bsq_map_check(struct bsq_ctx *ctx, const struct bsq_map *map)
{
    struct stat info;
    if (!map->range)
        return 0;
    if (fstat(map->fd, &info) != 0)
        return bsq_fail_errno(ctx, BSQ_EIO, errno, "%s", map->path);
    if ((uint64_t)info.st_size < map->size)
        return bsq_fail(ctx, BSQ_EIO, "%s: shrank from %llu to %llu bytes while it was read",
                        map->path, (unsigned long long)map->size, (unsigned long long)info.st_size);
    if (atomic_load(&map->range->lost))
        return bsq_fail_errno(ctx, BSQ_EIO, EIO, "%s: reading the mapped file", map->path);
    if (!is_sound(map))
        return bsq_fail(ctx, BSQ_EIO, "%s: was changed while it was read", map->path);
    return 0;
}

void bsq_map_close(struct bsq_ctx *ctx, struct bsq_map *map)
{
    struct bsq_file file = {.fd = map->path ? map->fd : -1, .path = map->path};
    if (map->range)
        unwatch(map->range);
    if (map->data)
        munmap((void *)map->data, map->size);
    bsq_file_close(ctx, &file);
    *map = (struct bsq_map)BSQ_MAP_CLOSED;
}
