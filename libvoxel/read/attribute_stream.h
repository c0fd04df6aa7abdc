/* attribute_stream.h - private to the sorter: one attribute of all vertices, texture coordinates or
 * normals.
 *
 * A column is a spool of equal elements, a power of two in a segment, so that an element in memory
 * is found with a shift and a mask while the column can grow without being copied. */
#ifndef VOX_READ_ATTRIBUTE_STREAM_H
#define VOX_READ_ATTRIBUTE_STREAM_H

#include "libvoxel/read/spill_buffer.h"

/* Of large segments: any column's is a multiple of a huge page. */
#define COLUMN_LARGE_SHIFT 19u
#define COLUMN_SMALL_SHIFT 16u

struct column {
    struct spool spool;
    uint32_t element_bytes;
    uint32_t shift; /* of elements in a segment */
};

static inline void column_init(struct column *column, struct bsq_ctx *ctx, const char *what,
                               const char *beside, uint32_t element_bytes, uint32_t shift)
{
    column->element_bytes = element_bytes;
    column->shift = shift;
    vox_spill_init(&column->spool, ctx, what, beside, (uint64_t)element_bytes << shift);
}

static inline uint64_t column_count(const struct column *column)
{
    return column->element_bytes ? column->spool.bytes / column->element_bytes : 0;
}

/* An element of a column in memory; element_bytes is passed so that it can be a constant. */
static inline const void *column_at(const struct column *column, uint64_t index,
                                    uint32_t element_bytes)
{
    return column->spool.segments[index >> column->shift] +
           (index & (((uint64_t)1 << column->shift) - 1)) * element_bytes;
}

#endif
