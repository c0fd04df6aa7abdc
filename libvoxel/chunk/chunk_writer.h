/* chunk_writer.h - the public header of this folder: takes a partition, sorts its buckets, and
 * writes the chunks of the chunk file. */
#ifndef VOX_CHUNK_CHUNK_WRITER_H
#define VOX_CHUNK_CHUNK_WRITER_H

#include "formats/chunks/tris.h"
#include "libvoxel/partition/partition.h"

struct batches_report {
    uint64_t chunks;
    uint64_t triangles;  /* in the chunks */
    uint64_t degenerate; /* left out because they have no area */
};

/* Sorts all triangles, and appends their chunks to the writer. beside: output path, next to which
 * temporary files may be. */
int vox_write_chunks(const struct scan *scan, const struct partition *partition, const char *beside,
                     struct fmt_tris_writer *writer, struct batches_report *report);

#endif
