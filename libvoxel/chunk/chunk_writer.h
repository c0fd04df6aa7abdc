/* chunk_writer.h - private to the sorter: buckets become the chunks of the sorted file. */
#ifndef VOX_CHUNK_CHUNK_WRITER_H
#define VOX_CHUNK_CHUNK_WRITER_H

#include "libvoxel/partition/partition.h"

struct batches_report {
    uint64_t chunks;
    uint64_t triangles;  /* in the chunks */
    uint64_t degenerate; /* left out, as they have no area */
};

/* Sorts all triangles and appends their chunks to the writer. Completes partition->used where
 * records are indices. */
int vox_write_chunks(const struct scan *scan, const struct partition *partition, const char *beside,
                     struct fmt_tris_writer *writer, struct batches_report *report);

#endif
