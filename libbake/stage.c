/* stage.c - fills the pieces of a stage in turn. */
#include "libbake/stage_internal.h"

#include <string.h>

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

int bake_stage_put(void *arg, const void *data, uint64_t bytes)
{
    struct bake_stage *stage = arg;
    const char *from = data;
    int status = 0;

    while (bytes > 0 && status == 0) {
        const uint64_t room = stage->piece_bytes - stage->used;
        const uint64_t piece = bytes < room ? bytes : room;
        memcpy(stage->pieces[stage->turn] + stage->used, from, piece);
        stage->used += piece;
        from += piece;
        bytes -= piece;
        if (stage->used == stage->piece_bytes)
            status = bake_stage_flush(stage);
    }
    return status;
}
