/* vertex_buckets.h - the bucket of every vertex, for scans whose positions are in a file.
 *
 * A triangle belongs to the bucket of its first corner. A table with the bucket of each vertex
 * replaces the positions, so faces can be partitioned in any order. An entry has two bytes, a sixth
 * of a position. If memory is short it has one byte: buckets are then larger, and divided later. */
#ifndef VOX_PARTITION_VERTEX_BUCKETS_H
#define VOX_PARTITION_VERTEX_BUCKETS_H

#include "libvoxel/partition/morton.h"
#include "libvoxel/read/scan.h"

/* Morton levels of a bucket number that fits in two bytes, and in one byte. */
#define VERTEX_BUCKET_WIDE_LEVELS   5u
#define VERTEX_BUCKET_NARROW_LEVELS 2u

struct vertex_buckets {
    /* Bucket of each vertex. At most one of these is set. */
    uint16_t *wide;
    uint8_t *narrow;
    bool have_order; /* most vertices are in the bucket of the previous vertex */
};

static inline uint64_t vertex_bucket_bytes(uint64_t vertices, uint32_t levels)
{
    return vertices * (levels > VERTEX_BUCKET_NARROW_LEVELS ? sizeof(uint16_t) : sizeof(uint8_t));
}

/* Returns the Morton levels of a table of at most `bytes` bytes, or 0 if no table is that small. */
static inline uint32_t vertex_bucket_levels(uint64_t vertices, uint64_t bytes)
{
    if (vertex_bucket_bytes(vertices, VERTEX_BUCKET_WIDE_LEVELS) <= bytes)
        return VERTEX_BUCKET_WIDE_LEVELS;
    return vertex_bucket_bytes(vertices, VERTEX_BUCKET_NARROW_LEVELS) <= bytes
               ? VERTEX_BUCKET_NARROW_LEVELS
               : 0;
}

static inline uint32_t vertex_bucket(const struct vertex_buckets *buckets, uint64_t vertex)
{
    return buckets->wide ? buckets->wide[vertex] : buckets->narrow[vertex];
}

/* Returns the address that vertex_bucket() reads, to prefetch it. */
static inline const void *vertex_bucket_place(const struct vertex_buckets *buckets, uint64_t vertex)
{
    return buckets->wide ? (const void *)&buckets->wide[vertex]
                         : (const void *)&buckets->narrow[vertex];
}

/* Makes the table from all positions of the scan. The first 3 * levels bits of a key name a bucket.
 * Free with vox_vertex_buckets_free(), also after failure. */
int vox_vertex_buckets_make(const struct scan *scan, const struct morton_cube *cube,
                            uint32_t levels, struct vertex_buckets *out);
void vox_vertex_buckets_free(const struct scan *scan, struct vertex_buckets *buckets);

#endif
