/* spill_buffer.c - see spill_buffer.h. */
#include "libvoxel/read/spill_buffer.h"

#include <string.h>

#define TOUCH_BYTES ((uint64_t)2 << 20) /* a huge page at a time */
#define TOUCH_AHEAD (2 * TOUCH_BYTES)

void vox_spill_init(struct spool *spool, struct bsq_ctx *ctx, const char *what, const char *beside,
                    uint64_t segment_bytes)
{
    *spool = (struct spool){
        .ctx = ctx,
        .what = what,
        .beside = beside,
        .segment_bytes = segment_bytes,
        .file = BSQ_FILE_CLOSED,
    };
    pthread_mutex_init(&spool->lock, NULL);
}

/* ---- touching ---- */

static void set_untouched(struct spool *spool, uint8_t *from, uint8_t *to)
{
    pthread_mutex_lock(&spool->lock);
    spool->untouched = spool->head = from;
    spool->untouched_end = to;
    pthread_mutex_unlock(&spool->lock);
}

void vox_spill_touch_ahead(struct spool *spool)
{
    uint8_t *at = NULL;
    uint64_t size = 0;
    pthread_mutex_lock(&spool->lock);
    while (spool->untouched < spool->untouched_end &&
           spool->untouched < spool->head) /* by filling it */
        spool->untouched += TOUCH_BYTES;
    if (spool->untouched < spool->untouched_end && spool->untouched < spool->head + TOUCH_AHEAD) {
        uint64_t left = (uint64_t)(spool->untouched_end - spool->untouched);
        at = spool->untouched;
        size = left < TOUCH_BYTES ? left : TOUCH_BYTES;
        spool->untouched += size;
    }
    pthread_mutex_unlock(&spool->lock);
    if (at)
        bsq_prefault(at, size); /* a spill may have freed it by now, then this has no effect */
}

/* ---- segments ---- */

static void free_segments(struct spool *spool)
{
    set_untouched(spool, NULL, NULL);
    for (uint64_t i = 0; i < spool->segment_count; i++)
        bsq_free(spool->ctx, spool->segments[i]);
    spool->segment_count = 0;
}

void vox_spill_free(struct spool *spool)
{
    if (!spool->ctx)
        return;
    free_segments(spool);
    bsq_free(spool->ctx, spool->segments);
    bsq_file_close(spool->ctx, &spool->file);
    pthread_mutex_destroy(&spool->lock);
    memset(spool, 0, sizeof *spool);
}

uint64_t vox_spill_memory(const struct spool *spool)
{
    return spool->segment_count * spool->segment_bytes;
}

/* Bytes in the last segment; a spilled spool has written all before it to the file. */
static uint64_t tail_bytes(const struct spool *spool)
{
    if (spool->spilled)
        return spool->bytes - spool->file.size;
    if (spool->segment_count == 0)
        return 0;
    return spool->bytes - (spool->segment_count - 1) * spool->segment_bytes;
}

uint64_t vox_spill_room_cost(const struct spool *spool)
{
    bool full =
        spool->segment_count == 0 || (!spool->spilled && tail_bytes(spool) == spool->segment_bytes);
    return full ? spool->segment_bytes : 0;
}

static int add_segment(struct spool *spool)
{
    int status = bsq_grow(spool->ctx, spool->what, spool->segment_count + 1,
                          sizeof *spool->segments, &spool->segments, &spool->segment_capacity);
    if (status < 0)
        return status;
    status = bsq_alloc(spool->ctx, spool->what, spool->segment_bytes, 1,
                       &spool->segments[spool->segment_count]);
    if (status < 0)
        return status;
    uint8_t *segment = spool->segments[spool->segment_count++];
    if (!spool->spilled)
        set_untouched(spool, segment, segment + spool->segment_bytes);
    return 0;
}

static int flush_tail(struct spool *spool)
{
    return bsq_file_append(spool->ctx, &spool->file, spool->segments[0], tail_bytes(spool));
}

int vox_spill_room(struct spool *spool, uint8_t **at, uint64_t *room)
{
    int status = 0;
    if (vox_spill_room_cost(spool) > 0)
        status = add_segment(spool);
    else if (tail_bytes(spool) == spool->segment_bytes)
        status = flush_tail(spool);
    if (status < 0)
        return status;
    uint64_t used = tail_bytes(spool);
    *at = spool->segments[spool->segment_count - 1] + used;
    *room = spool->segment_bytes - used;
    return 0;
}

void vox_spill_advance(struct spool *spool, uint64_t bytes)
{
    pthread_mutex_lock(&spool->lock);
    spool->bytes += bytes;
    spool->head = spool->head ? spool->head + bytes : NULL;
    pthread_mutex_unlock(&spool->lock);
}

int vox_spill_spill(struct spool *spool)
{
    if (spool->spilled)
        return 0;
    int status = bsq_file_temp(spool->ctx, spool->beside, spool->what, &spool->file);
    for (uint64_t i = 0; status == 0 && i < spool->segment_count; i++) {
        bool last = i + 1 == spool->segment_count;
        status = bsq_file_append(spool->ctx, &spool->file, spool->segments[i],
                                 last ? tail_bytes(spool) : spool->segment_bytes);
    }
    if (status < 0)
        return status;
    set_untouched(spool, NULL, NULL);
    while (spool->segment_count > 1)
        bsq_free(spool->ctx, spool->segments[--spool->segment_count]);
    spool->spilled = true;
    return 0;
}

int vox_spill_finish(struct spool *spool)
{
    int status = 0;
    if (spool->spilled && spool->segment_count > 0) {
        status = flush_tail(spool);
        free_segments(spool);
    }
    return status;
}

int vox_spill_read(const struct spool *spool, uint64_t offset, uint64_t size, void *buffer)
{
    if (spool->spilled)
        return bsq_file_read(spool->ctx, &spool->file, buffer, size, offset);
    uint8_t *to = buffer;
    while (size > 0) {
        uint64_t within = offset % spool->segment_bytes;
        uint64_t part = spool->segment_bytes - within;
        if (part > size)
            part = size;
        memcpy(to, spool->segments[offset / spool->segment_bytes] + within, part);
        to += part;
        offset += part;
        size -= part;
    }
    return 0;
}
