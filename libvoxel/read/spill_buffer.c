/* spill_buffer.c - see spill_buffer.h. */
#include "libvoxel/read/spill_buffer.h"

#include <errno.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#define PREFAULT_BYTES ((uint64_t)2 << 20) /* a huge page */
#define PREFAULT_AHEAD (2 * PREFAULT_BYTES)

void vox_spill_init(struct spill_buffer *spill, struct bsq_ctx *ctx, const char *what,
                    const char *beside, uint64_t segment_bytes)
{
    *spill = (struct spill_buffer){
        .ctx = ctx,
        .what = what,
        .beside = beside,
        .segment_bytes = segment_bytes,
        .file = BSQ_FILE_CLOSED,
    };
    pthread_mutex_init(&spill->lock, NULL);
}

/* ---- prefaulting ---- */

/* Prefaults the whole pages in [at, at + bytes): the system assigns them now, not at their first
 * use. The content stays. Does nothing on systems that cannot do this. */
static void prefault(void *at, uint64_t bytes)
{
#ifdef MADV_POPULATE_WRITE
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGE_SIZE),
              begin = ((uintptr_t)at + page - 1) & ~(page - 1);
    uintptr_t end = ((uintptr_t)at + bytes) & ~(page - 1);
    int error = errno;
    if (begin < end)
        madvise((char *)at + (begin - (uintptr_t)at), end - begin, MADV_POPULATE_WRITE);
    errno = error;
#else
    (void)at;
    (void)bytes;
#endif
}

static void set_unfaulted(struct spill_buffer *spill, uint8_t *from, uint8_t *to)
{
    pthread_mutex_lock(&spill->lock);
    spill->unfaulted = spill->head = from;
    spill->unfaulted_end = to;
    pthread_mutex_unlock(&spill->lock);
}

void vox_spill_prefault(struct spill_buffer *spill)
{
    uint8_t *at = NULL;
    uint64_t size = 0;
    pthread_mutex_lock(&spill->lock);
    while (spill->unfaulted < spill->unfaulted_end &&
           spill->unfaulted < spill->head) /* filling it has faulted it */
        spill->unfaulted += PREFAULT_BYTES;
    if (spill->unfaulted < spill->unfaulted_end &&
        spill->unfaulted < spill->head + PREFAULT_AHEAD) {
        uint64_t left = (uint64_t)(spill->unfaulted_end - spill->unfaulted);
        at = spill->unfaulted;
        size = left < PREFAULT_BYTES ? left : PREFAULT_BYTES;
        spill->unfaulted += size;
    }
    pthread_mutex_unlock(&spill->lock);
    if (at)
        prefault(at, size); /* no effect if a spill has freed the memory meanwhile */
}

/* ---- segments ---- */

static void free_segments(struct spill_buffer *spill)
{
    set_unfaulted(spill, NULL, NULL);
    for (uint64_t i = 0; i < spill->segment_count; i++)
        bsq_free(spill->ctx, spill->segments[i]);
    spill->segment_count = 0;
}

void vox_spill_free(struct spill_buffer *spill)
{
    if (!spill->ctx)
        return;
    free_segments(spill);
    bsq_free(spill->ctx, spill->segments);
    bsq_file_close(spill->ctx, &spill->file);
    pthread_mutex_destroy(&spill->lock);
    memset(spill, 0, sizeof *spill);
}

uint64_t vox_spill_memory(const struct spill_buffer *spill)
{
    return spill->segment_count * spill->segment_bytes;
}

/* Returns the bytes in the last segment. After a spill, all bytes before them are in the file. */
static uint64_t tail_bytes(const struct spill_buffer *spill)
{
    if (spill->spilled)
        return spill->bytes - spill->file.size;
    if (spill->segment_count == 0)
        return 0;
    return spill->bytes - (spill->segment_count - 1) * spill->segment_bytes;
}

uint64_t vox_spill_reserve_cost(const struct spill_buffer *spill)
{
    bool full =
        spill->segment_count == 0 || (!spill->spilled && tail_bytes(spill) == spill->segment_bytes);
    return full ? spill->segment_bytes : 0;
}

static int add_segment(struct spill_buffer *spill)
{
    int status = bsq_grow(spill->ctx, spill->what, spill->segment_count + 1,
                          sizeof *spill->segments, &spill->segments, &spill->segment_capacity);
    if (status < 0)
        return status;
    status = bsq_alloc(spill->ctx, spill->what, spill->segment_bytes, 1,
                       &spill->segments[spill->segment_count]);
    if (status < 0)
        return status;
    uint8_t *segment = spill->segments[spill->segment_count++];
    if (!spill->spilled)
        set_unfaulted(spill, segment, segment + spill->segment_bytes);
    return 0;
}

static int flush_tail(struct spill_buffer *spill)
{
    return bsq_file_append(spill->ctx, &spill->file, spill->segments[0], tail_bytes(spill));
}

int vox_spill_reserve(struct spill_buffer *spill, uint8_t **at, uint64_t *capacity)
{
    int status = 0;
    if (vox_spill_reserve_cost(spill) > 0)
        status = add_segment(spill);
    else if (tail_bytes(spill) == spill->segment_bytes)
        status = flush_tail(spill);
    if (status < 0)
        return status;
    uint64_t used = tail_bytes(spill);
    *at = spill->segments[spill->segment_count - 1] + used;
    *capacity = spill->segment_bytes - used;
    return 0;
}

void vox_spill_advance(struct spill_buffer *spill, uint64_t bytes)
{
    pthread_mutex_lock(&spill->lock);
    spill->bytes += bytes;
    spill->head = spill->head ? spill->head + bytes : NULL;
    pthread_mutex_unlock(&spill->lock);
}

int vox_spill_spill(struct spill_buffer *spill)
{
    if (spill->spilled)
        return 0;
    int status = bsq_file_temp(spill->ctx, spill->beside, spill->what, &spill->file);
    for (uint64_t i = 0; status == 0 && i < spill->segment_count; i++) {
        bool last = i + 1 == spill->segment_count;
        status = bsq_file_append(spill->ctx, &spill->file, spill->segments[i],
                                 last ? tail_bytes(spill) : spill->segment_bytes);
    }
    if (status < 0)
        return status;
    set_unfaulted(spill, NULL, NULL);
    while (spill->segment_count > 1)
        bsq_free(spill->ctx, spill->segments[--spill->segment_count]);
    spill->spilled = true;
    return 0;
}

int vox_spill_finish(struct spill_buffer *spill)
{
    int status = 0;
    if (spill->spilled && spill->segment_count > 0) {
        status = flush_tail(spill);
        free_segments(spill);
    }
    return status;
}

int vox_spill_read(const struct spill_buffer *spill, uint64_t offset, uint64_t size, void *buffer)
{
    if (spill->spilled)
        return bsq_file_read(spill->ctx, &spill->file, buffer, size, offset);
    uint8_t *to = buffer;
    while (size > 0) {
        uint64_t within = offset % spill->segment_bytes;
        uint64_t part = spill->segment_bytes - within;
        if (part > size)
            part = size;
        memcpy(to, spill->segments[offset / spill->segment_bytes] + within, part);
        to += part;
        offset += part;
        size -= part;
    }
    return 0;
}
