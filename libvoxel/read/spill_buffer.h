/* spill_buffer.h - an append-only buffer, in memory or in a temporary file.
 *
 * Bytes are kept in segments of equal size. vox_spill_spill() moves all of them to a temporary file
 * and keeps one segment as write buffer. Elements do not straddle segments if the segment size is a
 * multiple of theirs. One thread at a time may append, any thread may read.
 *
 * The system needs longer to find and clear new memory than this code needs to fill it. So other
 * threads prefault memory shortly before it is filled: vox_spill_prefault(). */
#ifndef VOX_READ_SPILL_BUFFER_H
#define VOX_READ_SPILL_BUFFER_H

#include <pthread.h>

#include "base/file.h"

struct spill_buffer {
    struct bsq_ctx *ctx;
    const char *what;   /* for messages */
    const char *beside; /* output path, next to which the temporary file may be */
    uint64_t segment_bytes;
    uint64_t bytes; /* appended so far */
    uint8_t **segments;
    uint64_t segment_count, segment_capacity;
    struct bsq_file file;
    bool spilled;
    pthread_mutex_t lock; /* for the following: memory not faulted yet, and where bytes go next */
    uint8_t *unfaulted, *unfaulted_end, *head;
};

void vox_spill_init(struct spill_buffer *spill, struct bsq_ctx *ctx, const char *what,
                    const char *beside, uint64_t segment_bytes);
void vox_spill_free(struct spill_buffer *spill);

/* Returns the bytes of memory that the next vox_spill_reserve() will allocate. */
uint64_t vox_spill_reserve_cost(const struct spill_buffer *spill);

/* Returns in *at the end of the buffer, with a contiguous *capacity of at least one byte. The
 * caller fills it and calls vox_spill_advance(). */
int vox_spill_reserve(struct spill_buffer *spill, uint8_t **at, uint64_t *capacity);
void vox_spill_advance(struct spill_buffer *spill, uint64_t bytes);

/* Prefaults some of the memory that will be filled next. From any thread, while another appends. */
void vox_spill_prefault(struct spill_buffer *spill);

/* Moves the content to a temporary file and frees all but one segment. */
int vox_spill_spill(struct spill_buffer *spill);
/* Ends appending. After a spill, writes the last bytes to the file and frees the write buffer. */
int vox_spill_finish(struct spill_buffer *spill);

/* Returns the bytes of memory that the segments take. */
uint64_t vox_spill_memory(const struct spill_buffer *spill);

/* Copies bytes [offset, offset + size). After a spill, call vox_spill_finish() first. */
int vox_spill_read(const struct spill_buffer *spill, uint64_t offset, uint64_t size, void *buffer);

/* ---- attribute streams ---- */

/* One attribute of a scan: positions, colours, texture coordinates or normals. It is a spill buffer
 * of equal elements. A segment has a power of two of them, so a shift and a mask find an element in
 * memory. The stream grows without being copied. */
struct attribute_stream {
    struct spill_buffer spill;
    uint32_t element_bytes;
    uint32_t shift; /* log2 of elements in a segment */
};

static inline void stream_init(struct attribute_stream *stream, struct bsq_ctx *ctx,
                               const char *what, const char *beside, uint32_t element_bytes,
                               uint32_t shift)
{
    stream->element_bytes = element_bytes;
    stream->shift = shift;
    vox_spill_init(&stream->spill, ctx, what, beside, (uint64_t)element_bytes << shift);
}

static inline uint64_t stream_count(const struct attribute_stream *stream)
{
    return stream->element_bytes ? stream->spill.bytes / stream->element_bytes : 0;
}

/* Returns an element of a stream in memory. element_bytes is a parameter so that it can be a
 * constant. */
static inline const void *stream_at(const struct attribute_stream *stream, uint64_t index,
                                    uint32_t element_bytes)
{
    return stream->spill.segments[index >> stream->shift] +
           (index & (((uint64_t)1 << stream->shift) - 1)) * element_bytes;
}

#endif
