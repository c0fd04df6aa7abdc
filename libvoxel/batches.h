/* batches.h - private to the sorter: cells become the chunks of the sorted file. */
#ifndef VOX_BATCHES_H
#define VOX_BATCHES_H

#include "libvoxel/scatter.h"

/* Sorts all triangles and appends their chunks to the writer; *chunks: how many. */
int batches_write(const struct scan *scan, const struct scattered *scattered, const char *beside,
                  struct fmt_tris_writer *writer, uint64_t *chunks);

#endif
