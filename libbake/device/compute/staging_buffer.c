/* staging_buffer.c - fills one half after the other. */
#include "libbake/device/compute/compute.h"

#include <string.h>

#include "base/parallel.h"

enum { SHARE_BYTES = 1 << 20 /* one thread copies at a time */ };

int bake_staging_flush(struct bake_staging_buffer *staging)
{
    const uint64_t bytes = staging->used;
    const unsigned half = staging->filling;

    if (bytes == 0)
        return 0;
    staging->used = 0;
    staging->filling ^= 1;
    return staging->send(staging->device, half, bytes);
}

struct copy {
    char *to;
    const char *from;
    uint64_t bytes;
};

static int copy_share(void *arg, uint64_t index, unsigned worker)
{
    const struct copy *copy = arg;
    const uint64_t at = index * SHARE_BYTES, left = copy->bytes - at;

    (void)worker;
    memcpy(copy->to + at, copy->from + at, left < SHARE_BYTES ? left : SHARE_BYTES);
    return 0;
}

static int copy_in(const struct bake_staging_buffer *staging, const char *from, uint64_t bytes)
{
    struct copy copy = {staging->halves[staging->filling] + staging->used, from, bytes};

    if (staging->ctx && bytes > SHARE_BYTES)
        return bsq_parallel_for(staging->ctx, (bytes + SHARE_BYTES - 1) / SHARE_BYTES, copy_share,
                                &copy);
    memcpy(copy.to, from, bytes);
    return 0;
}

int bake_staging_put(void *arg, const void *data, uint64_t bytes)
{
    struct bake_staging_buffer *staging = arg;
    const char *from = data;
    int status = 0;

    while (bytes > 0 && status == 0) {
        const uint64_t space = staging->half_bytes - staging->used;
        const uint64_t piece = bytes < space ? bytes : space;
        status = copy_in(staging, from, piece);
        staging->used += piece;
        from += piece;
        bytes -= piece;
        if (status == 0 && staging->used == staging->half_bytes)
            status = bake_staging_flush(staging);
    }
    return status;
}
