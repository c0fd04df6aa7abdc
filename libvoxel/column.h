/* column.h - private to the sorter: one attribute of all vertices, texture coordinates or normals.
 *
 * A column is a spool of equal elements, 2^16 in a segment, so that an element in memory is found
 * with a shift and a mask while the column can grow without being copied. */
#ifndef VOX_COLUMN_H
#define VOX_COLUMN_H

#include "libvoxel/spool.h"

#define COLUMN_SEGMENT_SHIFT 16
#define COLUMN_SEGMENT_MASK  (((uint64_t)1 << COLUMN_SEGMENT_SHIFT) - 1)

struct column {
    struct spool spool;
    uint32_t element_bytes;
};

static inline void column_init(struct column *column, struct bsq_ctx *ctx, const char *what,
                               const char *beside, uint32_t element_bytes)
{
    column->element_bytes = element_bytes;
    spool_init(&column->spool, ctx, what, beside, (uint64_t)element_bytes << COLUMN_SEGMENT_SHIFT);
}

static inline uint64_t column_count(const struct column *column)
{
    return column->element_bytes ? column->spool.bytes / column->element_bytes : 0;
}

/* An element of a column in memory; element_bytes is passed so that it can be a constant. */
static inline const void *column_at(const struct column *column, uint64_t index,
                                    uint32_t element_bytes)
{
    return column->spool.segments[index >> COLUMN_SEGMENT_SHIFT] +
           (index & COLUMN_SEGMENT_MASK) * element_bytes;
}

#endif
