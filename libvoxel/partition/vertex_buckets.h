/* vertex_buckets.h - the bucket of every vertex, for scans whose positions are in a file.
 *
 * A triangle belongs to the bucket of its first corner. A table with the bucket of each vertex
 * replaces the positions, so faces can be partitioned in any order. In most scans, many vertices in
 * a row are in one bucket; the table then has an entry for each such run. For others it has two
 * bytes for each vertex, a sixth of a position, or one byte if memory is short: buckets are then
 * larger, and divided later. */
#ifndef VOX_PARTITION_VERTEX_BUCKETS_H
#define VOX_PARTITION_VERTEX_BUCKETS_H

#include "libvoxel/partition/morton.h"
#include "libvoxel/read/scan.h"

/* Morton levels of a bucket number that fits in two bytes, and in one byte. */
#define VERTEX_BUCKET_WIDE_LEVELS   5u
#define VERTEX_BUCKET_NARROW_LEVELS 2u
/* Low bits of a run that have its bucket, and the vertices for each entry of `first_runs`. */
#define VERTEX_RUN_BITS     16u
#define VERTEX_RUN_MASK     (((uint64_t)1 << VERTEX_RUN_BITS) - 1)
#define VERTEX_RUN_VERTICES 256u

struct vertex_buckets {
    uint32_t levels; /* the first 3 * levels bits of a key name a bucket */
    uint64_t bytes;  /* of the table */
    /* One of these is set. */
    uint16_t *wide;
    uint8_t *narrow;
    uint64_t *runs; /* first vertex << VERTEX_RUN_BITS | bucket; the last entry ends the table */
    /* Beside runs: for each VERTEX_RUN_VERTICES vertices, the run of the first one. */
    uint32_t *first_runs;
    uint64_t run_count; /* without the last entry */
    bool have_order;    /* most vertices are in the bucket of the previous vertex */
    /* For each number of levels up to `levels`, the buckets that have vertices. */
    uint32_t occupied[VERTEX_BUCKET_WIDE_LEVELS + 1];
};

static inline uint32_t vertex_bucket(const struct vertex_buckets *buckets, uint64_t vertex)
{
    if (!buckets->runs)
        return buckets->wide ? buckets->wide[vertex] : buckets->narrow[vertex];
    const uint64_t *run = buckets->runs + buckets->first_runs[vertex / VERTEX_RUN_VERTICES];
    while (run[1] >> VERTEX_RUN_BITS <= vertex)
        run++;
    return (uint32_t)(*run & VERTEX_RUN_MASK);
}

/* Returns the address that vertex_bucket() reads first, to prefetch it. */
static inline const void *vertex_bucket_place(const struct vertex_buckets *buckets, uint64_t vertex)
{
    if (buckets->runs)
        return &buckets->first_runs[vertex / VERTEX_RUN_VERTICES];
    return buckets->wide ? (const void *)&buckets->wide[vertex]
                         : (const void *)&buckets->narrow[vertex];
}

/* Makes the table from all positions of the scan, with at most this many levels and bytes.
 * out->levels is 0 if no table is that small. Free with vox_vertex_buckets_free(), also after
 * failure. Errors: BSQ_ENOMEM, BSQ_EIO, BSQ_EINTR. */
int vox_vertex_buckets_make(const struct scan *scan, const struct morton_cube *cube,
                            uint32_t levels, uint64_t bytes, struct vertex_buckets *out);
/* Makes the buckets larger, so that they have this many levels. */
void vox_vertex_buckets_coarsen(const struct scan *scan, struct vertex_buckets *buckets,
                                uint32_t levels);
void vox_vertex_buckets_free(const struct scan *scan, struct vertex_buckets *buckets);

#endif
