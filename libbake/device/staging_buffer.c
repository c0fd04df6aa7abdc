/* staging_buffer.c - fills the pieces of a stage in turn. */
#include "libbake/device/staging_buffer.h"

#include <string.h>

#include "base/parallel.h"

enum { SHARE_BYTES = 1 << 20 /* of a piece, that one thread copies */ };

int bake_stage_flush(struct bake_stage *stage)
{
    const uint64_t bytes = stage->used;
    const unsigned turn = stage->turn;

    if (bytes == 0)
        return 0;
    stage->used = 0;
    stage->turn ^= 1;
    return stage->send(stage->device, turn, bytes);
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

static int copy_in(const struct bake_stage *stage, const char *from, uint64_t bytes)
{
    struct copy copy = {stage->pieces[stage->turn] + stage->used, from, bytes};

    if (stage->ctx && bytes > SHARE_BYTES)
        return bsq_parallel_for(stage->ctx, (bytes + SHARE_BYTES - 1) / SHARE_BYTES, copy_share,
                                &copy);
    memcpy(copy.to, from, bytes);
    return 0;
}

int bake_stage_put(void *arg, const void *data, uint64_t bytes)
{
    struct bake_stage *stage = arg;
    const char *from = data;
    int status = 0;

    while (bytes > 0 && status == 0) {
        const uint64_t room = stage->piece_bytes - stage->used;
        const uint64_t piece = bytes < room ? bytes : room;
        status = copy_in(stage, from, piece);
        stage->used += piece;
        from += piece;
        bytes -= piece;
        if (status == 0 && stage->used == stage->piece_bytes)
            status = bake_stage_flush(stage);
    }
    return status;
}
