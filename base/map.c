/* map.c - whole files mapped read-only. */
#include <errno.h>
#include <sys/mman.h>

#include "base/file.h"

int bsq_map_open(struct bsq_ctx *ctx, const char *path, struct bsq_map *out)
{
    *out = (struct bsq_map){0};
    struct bsq_file file;
    int status = bsq_file_open(ctx, path, &file);
    if (status < 0)
        return status;
    if (file.size > PTRDIFF_MAX) {
        status = bsq_fail_errno(ctx, BSQ_ENOINPUT, EFBIG, "%s", path);
        goto done;
    }
    if (file.size > 0) {
        void *data = mmap(NULL, file.size, PROT_READ, MAP_SHARED, file.fd, 0);
        if (data == MAP_FAILED) {
            status = bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s: mapping %llu bytes", path,
                                    (unsigned long long)file.size);
            goto done;
        }
        out->data = data;
    }
    out->size = file.size;
    out->path = file.path;
    file.path = NULL;
done:
    bsq_file_close(ctx, &file);
    return status;
}

void bsq_map_close(struct bsq_ctx *ctx, struct bsq_map *map)
{
    struct bsq_file name_only = {.fd = -1, .path = map->path};
    if (map->data)
        munmap((void *)map->data, map->size);
    bsq_file_close(ctx, &name_only);
    *map = (struct bsq_map){0};
}
