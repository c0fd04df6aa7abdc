/* attribute_stream.h - one attribute of a scan: positions, colours, texture coordinates or normals.
 *
 * A stream of equal elements in a spill. A page has a power of two of them, so a shift and a mask
 * find an element in memory. The stream grows without being copied. One thread at a time may
 * append, any thread may read.
 *
 * The system needs longer to find and clear new memory than this code needs to fill it. So other
 * threads prefault memory shortly before it is filled: vox_stream_prefault(). */
#ifndef VOX_READ_ATTRIBUTE_STREAM_H
#define VOX_READ_ATTRIBUTE_STREAM_H

#include <pthread.h>

#include "base/spill.h"

struct attribute_stream {
    struct bsq_spill spill; /* of one stream */
    uint64_t count;         /* elements so far */
    uint32_t element_bytes;
    uint32_t shift; /* log2 of elements in a page */
    pthread_mutex_t
        lock; /* for the following: memory not faulted yet, and where elements go next */
    uint8_t *unfaulted, *unfaulted_end, *head;
};

/* Makes an empty stream in memory. Free it with vox_stream_free(), also after failure. */
int vox_stream_init(struct attribute_stream *stream, struct bsq_ctx *ctx, const char *what,
                    const char *beside, uint32_t element_bytes, uint32_t shift);
void vox_stream_free(struct attribute_stream *stream);

/* Returns the bytes of memory that the stream takes. */
static inline uint64_t stream_memory(const struct attribute_stream *stream)
{
    const struct bsq_spill *spill = &stream->spill;
    const uint64_t pages =
        bsq_spill_in_file(spill) ? spill->list->buffer != NULL : spill->slab_count;
    return pages * spill->page_bytes;
}

/* Returns the bytes of memory that the next vox_stream_reserve() will allocate. */
static inline uint64_t stream_reserve_cost(const struct attribute_stream *stream)
{
    return stream->spill.list->buffer ? 0 : stream->spill.page_bytes;
}

/* Returns in *at the end of the stream, with space for *capacity elements, at least one. The caller
 * fills it and calls vox_stream_advance() with the number of new elements. */
int vox_stream_reserve(struct attribute_stream *stream, uint8_t **at, uint64_t *capacity);
int vox_stream_advance(struct attribute_stream *stream, uint64_t count);

/* Prefaults some of the memory that will be filled next. From any thread, while another appends. */
void vox_stream_prefault(struct attribute_stream *stream);

/* Moves the elements to a temporary file and frees all memory but one page. */
int vox_stream_evict(struct attribute_stream *stream);
/* Ends appending. If the stream is in a file, writes the last elements there and frees the page. */
int vox_stream_finish(struct attribute_stream *stream);

/* Copies elements [first, first + count) to `to`. */
static inline int stream_read(const struct attribute_stream *stream, uint64_t first, uint64_t count,
                              void *to)
{
    const uint64_t bytes = stream->element_bytes;
    return bsq_spill_read(&stream->spill, 0, first * bytes, count * bytes, to, NULL);
}

/* Returns an element of a stream in memory. element_bytes is a parameter so that it can be a
 * constant. */
static inline const void *stream_at(const struct attribute_stream *stream, uint64_t index,
                                    uint32_t element_bytes)
{
    return stream->spill.slabs[index >> stream->shift] +
           (index & (((uint64_t)1 << stream->shift) - 1)) * element_bytes;
}

#endif
