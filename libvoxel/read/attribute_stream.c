/* attribute_stream.c - see attribute_stream.h. */
#include "libvoxel/read/attribute_stream.h"

#include <errno.h>
#include <sys/mman.h>
#include <unistd.h>

#define PREFAULT_BYTES ((uint64_t)2 << 20) /* a huge page */
#define PREFAULT_AHEAD (2 * PREFAULT_BYTES)

int vox_stream_init(struct attribute_stream *stream, struct bsq_ctx *ctx, const char *what,
                    const char *beside, uint32_t element_bytes, uint32_t shift)
{
    *stream = (struct attribute_stream){.element_bytes = element_bytes, .shift = shift};
    pthread_mutex_init(&stream->lock, NULL);
    return bsq_spill_init(&stream->spill, ctx, what, beside, 1, 1, (uint64_t)element_bytes << shift,
                          UINT64_MAX);
}

void vox_stream_free(struct attribute_stream *stream)
{
    if (!stream->spill.ctx)
        return;
    bsq_spill_free(&stream->spill);
    pthread_mutex_destroy(&stream->lock);
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

/* Notes that memory from `at` on will be filled. capacity: bytes up to the end of the page. */
static void note_head(struct attribute_stream *stream, uint8_t *at, uint64_t capacity)
{
    pthread_mutex_lock(&stream->lock);
    stream->head = at;
    stream->unfaulted_end = at ? at + capacity : NULL;
    if (capacity == stream->spill.page_bytes)
        stream->unfaulted = at;
    pthread_mutex_unlock(&stream->lock);
}

void vox_stream_prefault(struct attribute_stream *stream)
{
    uint8_t *at = NULL;
    uint64_t size = 0;
    pthread_mutex_lock(&stream->lock);
    while (stream->unfaulted < stream->unfaulted_end &&
           stream->unfaulted < stream->head) /* filling it has faulted it */
        stream->unfaulted += PREFAULT_BYTES;
    if (stream->unfaulted < stream->unfaulted_end &&
        stream->unfaulted < stream->head + PREFAULT_AHEAD) {
        uint64_t left = (uint64_t)(stream->unfaulted_end - stream->unfaulted);
        at = stream->unfaulted;
        size = left < PREFAULT_BYTES ? left : PREFAULT_BYTES;
        stream->unfaulted += size;
    }
    pthread_mutex_unlock(&stream->lock);
    if (at)
        prefault(at, size); /* no effect if the memory was freed meanwhile */
}

/* ---- elements ---- */

int vox_stream_reserve(struct attribute_stream *stream, uint8_t **at, uint64_t *capacity)
{
    BSQ_PASS(bsq_spill_reserve(&stream->spill, 0, at, capacity));
    if (!bsq_spill_in_file(&stream->spill))
        note_head(stream, *at, *capacity);
    *capacity /= stream->element_bytes;
    return 0;
}

int vox_stream_advance(struct attribute_stream *stream, uint64_t count)
{
    stream->count += count;
    return bsq_spill_advance(&stream->spill, 0, count * stream->element_bytes);
}

int vox_stream_evict(struct attribute_stream *stream)
{
    note_head(stream, NULL, 0);
    return bsq_spill_evict(&stream->spill, false);
}

int vox_stream_finish(struct attribute_stream *stream)
{
    return bsq_spill_in_file(&stream->spill) ? bsq_spill_evict(&stream->spill, true) : 0;
}
