/* attribute_stream.h - one attribute of a scan: positions, colours, texture coordinates or normals.
 *
 * An attribute stream is a spill buffer of equal elements. A segment has a power of two of them, so
 * a shift and a mask find an element in memory. The stream grows without being copied. */
#ifndef VOX_READ_ATTRIBUTE_STREAM_H
#define VOX_READ_ATTRIBUTE_STREAM_H

#include "libvoxel/read/spill_buffer.h"

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
