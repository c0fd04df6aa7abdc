/* sort_limits.h - private to the sorter: how it divides its memory.
 *
 * The limits follow from the budget; tests set smaller ones to force every path on small scans.
 * None of them changes the result. */
#ifndef VOX_SORT_LIMITS_H
#define VOX_SORT_LIMITS_H

#include "libvoxel/voxel.h"

struct sort_limits {
    uint64_t store_bytes;  /* columns and faces in memory while reading */
    uint64_t column_bytes; /* columns in memory, a part of these */
    uint32_t column_shift; /* of elements in a segment of a column */
    uint64_t page_bytes;   /* one page of a cell's records, at most */
    uint64_t page_memory;  /* all pages in memory, write buffers included */
    uint64_t
        direct_memory; /* the same while faces are scattered as they are read; 0: they are not */
    uint64_t vertex_cells_bytes; /* cells of vertices, where positions are in a file; see
                                    vertex_buckets.h */
    uint64_t join_bytes;         /* buffers while spilled columns are joined */
    uint64_t reserve_bytes;      /* left free when batches take the rest */
    uint64_t batch_triangles;    /* sorted at a time, at most; more than a chunk's */
    uint32_t cell_levels;        /* 2^levels cells an axis at first; 1 to 5 */
    uint32_t index_bytes;        /* least width of an index in a record, 1 to 8 */
    uint32_t slots;              /* groups and chunks at a time, at most */
};

/* Divides `budget` bytes for this number of threads. */
void vox_sort_limits_for(uint64_t budget, unsigned threads, struct sort_limits *limits);

/* vox_sort() with limits of the caller's. */
int vox_sort_with_limits(struct bsq_ctx *ctx, const struct vox_sort_options *options,
                         const struct sort_limits *limits, struct vox_sort_report *report);

#endif
