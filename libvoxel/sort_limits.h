/* sort_limits.h - how the sorter divides its memory; for the rooms of the sorter and their tests.
 *
 * The limits follow from the budget; tests set smaller ones to force every path on small scans.
 * None of them changes the result. */
#ifndef VOX_SORT_LIMITS_H
#define VOX_SORT_LIMITS_H

#include "libvoxel/voxel.h"

/* log2 of elements in a segment. Large segments of any stream are multiples of a huge page. */
#define STREAM_LARGE_SHIFT 19u
#define STREAM_SMALL_SHIFT 16u

struct sort_limits {
    uint64_t stream_bytes; /* attribute streams in memory */
    uint32_t stream_shift; /* log2 of elements in a segment of a stream */
    uint64_t page_bytes;   /* one page of a bucket, at most */
    uint64_t page_memory;  /* pages in memory, at least; includes the page that each bucket fills */
    uint64_t max_page_memory;     /* pages in memory, at most */
    uint64_t vertex_bucket_bytes; /* table of vertices' buckets, at most (triangulate.h) */
    uint64_t reserve_bytes;       /* left free when batches take the rest */
    uint64_t batch_triangles;     /* sorted at a time, at most; more than in a chunk */
    uint32_t
        bucket_levels; /* buckets are cells of a grid of 2^levels cells along each axis; 1 to 5 */
    uint32_t index_bytes; /* least width of an index in a tuple, 1 to 8 */
    uint32_t slots;       /* chunks built at once, if memory allows */
    bool two_passes;      /* even if samples say that vertices come first */
};

/* Divides `budget` bytes for this number of threads. */
void vox_sort_limits_for(uint64_t budget, unsigned threads, struct sort_limits *limits);

/* vox_sort() with the caller's limits. */
int vox_sort_with_limits(struct bsq_ctx *ctx, const struct vox_sort_options *options,
                         const struct sort_limits *limits, struct vox_sort_report *report);

#endif
