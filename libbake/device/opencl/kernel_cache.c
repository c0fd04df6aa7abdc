/* kernel_cache.c - one file an entry: a header, the key, the data. */
#include "libbake/device/opencl/kernel_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { LARGEST_ENTRY = 64 << 20, DAY = 24 * 60 * 60 };

static const char entry_suffix[] = ".kernel", temporary_prefix[] = ".new-";

static const char magic[8] = "BSQKRN1";

struct header {
    char magic[8];
    uint64_t key_bytes, data_bytes;
    uint64_t hash; /* of key and data */
};

static uint64_t hash_more(uint64_t hash, const void *data, uint64_t bytes)
{
    const unsigned char *p = data;
    for (uint64_t i = 0; i < bytes; i++)
        hash = (hash ^ p[i]) * UINT64_C(0x100000001b3);
    return hash;
}

uint64_t bake_kernel_hash(const void *data, uint64_t bytes)
{
    return hash_more(UINT64_C(0xcbf29ce484222325), data, bytes);
}

static uint64_t entry_hash(const char *key, const void *data, uint64_t bytes)
{
    return hash_more(bake_kernel_hash(key, strlen(key)), data, bytes);
}

/* Directory of the cache; false where there is none. XDG asks to ignore paths that are not
 * absolute. */
static bool name_directory(char path[PATH_MAX])
{
    const char *cache = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
    int length;

    if (cache && cache[0] == '/')
        length = snprintf(path, PATH_MAX, "%s/bisque", cache);
    else if (home && home[0] == '/')
        length = snprintf(path, PATH_MAX, "%s/.cache/bisque", home);
    else
        return false;
    return length < PATH_MAX;
}

static bool name_entry(const char *key, char path[PATH_MAX])
{
    char directory[PATH_MAX];

    return name_directory(directory) &&
           snprintf(path, PATH_MAX, "%s/%016" PRIx64 "%s", directory,
                    bake_kernel_hash(key, strlen(key)), entry_suffix) < PATH_MAX;
}

static bool read_all(int fd, void *to, uint64_t bytes)
{
    char *at = to;

    while (bytes > 0) {
        ssize_t got = read(fd, at, bytes);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return false;
        at += got;
        bytes -= (uint64_t)got;
    }
    return true;
}

/* Reads and checks the part after the header; NULL where it is not what it has to be. */
static void *read_entry(int fd, const struct header *header, const char *key)
{
    uint64_t key_bytes = header->key_bytes;
    char *bytes = malloc(key_bytes + header->data_bytes + 1);

    if (bytes && read_all(fd, bytes, key_bytes + header->data_bytes) &&
        memcmp(bytes, key, key_bytes) == 0 &&
        entry_hash(key, bytes + key_bytes, header->data_bytes) == header->hash) {
        memmove(bytes, bytes + key_bytes, header->data_bytes);
        return bytes;
    }
    free(bytes);
    return NULL;
}

/* An entry's time of modification is when it was last used, within a day. */
static void note_use(int fd, const struct stat *stat)
{
    if (stat->st_mtime < time(NULL) - DAY)
        (void)futimens(fd, NULL); /* a cache that may only be read is used all the same */
}

bool bake_kernel_cache_get(const char *key, void **out, uint64_t *bytes)
{
    char path[PATH_MAX];
    struct header header;
    struct stat stat;
    int fd;

    *out = NULL;
    *bytes = 0;
    if (!name_entry(key, path) || (fd = open(path, O_RDONLY | O_CLOEXEC)) < 0)
        return false;
    if (fstat(fd, &stat) == 0 && S_ISREG(stat.st_mode) && stat.st_size <= LARGEST_ENTRY &&
        read_all(fd, &header, sizeof header) && memcmp(header.magic, magic, sizeof magic) == 0 &&
        header.key_bytes == strlen(key) && header.data_bytes <= LARGEST_ENTRY &&
        sizeof header + header.key_bytes + header.data_bytes == (uint64_t)stat.st_size)
        *out = read_entry(fd, &header, key);
    if (*out) {
        *bytes = header.data_bytes;
        note_use(fd, &stat);
    }
    close(fd);
    return *out != NULL;
}

static bool write_all(int fd, const void *from, uint64_t bytes)
{
    const char *at = from;

    while (bytes > 0) {
        ssize_t wrote = write(fd, at, bytes);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote <= 0)
            return false;
        at += wrote;
        bytes -= (uint64_t)wrote;
    }
    return true;
}

/* ---- pruning ---- */

/* A file of the cache's directory. */
struct old_file {
    char name[32];
    uint64_t bytes;
    time_t used;
    bool temporary;
};

struct old_files {
    struct old_file *files;
    size_t count, capacity;
};

static void note_file(struct old_files *all, int directory, const char *name)
{
    const size_t length = strlen(name), suffix = sizeof entry_suffix - 1;
    struct old_file file = {.temporary =
                                strncmp(name, temporary_prefix, sizeof temporary_prefix - 1) == 0};
    struct stat stat;

    if (length >= sizeof file.name ||
        !(file.temporary ||
          (length > suffix && strcmp(name + length - suffix, entry_suffix) == 0)) ||
        fstatat(directory, name, &stat, AT_SYMLINK_NOFOLLOW) != 0 || !S_ISREG(stat.st_mode))
        return;
    if (all->count == all->capacity) {
        const size_t capacity = 2 * all->capacity + 64;
        struct old_file *files = realloc(all->files, capacity * sizeof *files);
        if (!files)
            return;
        all->files = files;
        all->capacity = capacity;
    }
    memcpy(file.name, name, length + 1);
    file.bytes = (uint64_t)stat.st_size;
    file.used = stat.st_mtime;
    all->files[all->count++] = file;
}

static int last_used_first(const void *a, const void *b)
{
    const time_t x = ((const struct old_file *)a)->used, y = ((const struct old_file *)b)->used;
    return (x < y) - (x > y);
}

/* Removes entries that nobody has used for long, the longest unused beyond a total size, and what
 * processes left that ended while they wrote. */
static void prune(const char *path)
{
    struct old_files all = {0};
    const time_t now = time(NULL);
    uint64_t total = 0;
    DIR *directory = opendir(path);

    if (!directory)
        return;
    for (struct dirent *entry; (entry = readdir(directory));)
        note_file(&all, dirfd(directory), entry->d_name);
    if (all.count)
        qsort(all.files, all.count, sizeof *all.files, last_used_first);
    for (size_t i = 0; i < all.count; i++) {
        const struct old_file *file = &all.files[i];
        const time_t days = file->temporary ? 1 : BAKE_KERNEL_CACHE_DAYS;
        total += file->bytes;
        if (file->used < now - days * DAY || (!file->temporary && total > BAKE_KERNEL_CACHE_BYTES))
            unlinkat(dirfd(directory), file->name, 0);
    }
    free(all.files);
    closedir(directory);
}

/* Makes the directory, and the one around it. */
static void make_directory(char *path)
{
    char *slash = strrchr(path, '/');

    *slash = '\0';
    mkdir(path, 0700);
    *slash = '/';
    mkdir(path, 0700);
}

void bake_kernel_cache_put(const char *key, const void *data, uint64_t bytes)
{
    char path[PATH_MAX], temporary[PATH_MAX], directory[PATH_MAX];
    struct header header = {.key_bytes = strlen(key), .data_bytes = bytes};
    bool good;
    int fd;

    if (!name_directory(directory) || !name_entry(key, path) ||
        snprintf(temporary, sizeof temporary, "%s/%sXXXXXX", directory, temporary_prefix) >=
            PATH_MAX)
        return;
    make_directory(directory);
    fd = mkostemp(temporary, O_CLOEXEC);
    if (fd < 0)
        return;
    memcpy(header.magic, magic, sizeof magic);
    header.hash = entry_hash(key, data, bytes);
    good = write_all(fd, &header, sizeof header) && write_all(fd, key, header.key_bytes) &&
           write_all(fd, data, bytes);
    if (close(fd) != 0 || !good || rename(temporary, path) != 0)
        unlink(temporary);
    prune(directory);
}
