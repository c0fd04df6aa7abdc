/* partition.h - private to the sorter: faces become triangles, collected by cell. */
#ifndef VOX_PARTITION_PARTITION_H
#define VOX_PARTITION_PARTITION_H

#include "libvoxel/partition/triangulate.h"

struct scattered {
    struct record_layout layout;
    struct morton_cube cube;
    uint32_t levels;          /* cells are named by the first 3 * levels bits of the key */
    struct cells cells;       /* of runs, see record_runs.h; items are triangles */
    uint64_t triangles;       /* in the cells, those without area too */
    bool vertices_lack_order; /* as far as is known: neighbours in the file are not neighbours in
                                 space */
    /* Vertices that faces refer to, where records are indices: to be marked by who reads these.
     * NULL: how many there are is known. */
    used_word *used;
    uint64_t used_vertices;
};

/* Scatters the faces of the store. Free with vox_partition_free(), also after failure. */
int vox_partition_scan(struct scan *scan, const char *beside, struct scattered *out);
/* Does nothing where nothing was begun. */
void vox_partition_free(const struct scan *scan, struct scattered *scattered);

/* Makes the cells for about this many triangles. */
int vox_partition_begin(const struct scan *scan, const char *beside, uint64_t triangles,
                        uint64_t page_memory, uint32_t max_levels, struct scattered *out);
/* Makes the bits of vertices in use, all clear. */
int vox_partition_note_used(const struct scan *scan, struct scattered *out);
/* Moves what a splitter made to the cells. Serial, in the order of the file. */
int vox_partition_collect(struct scattered *out, const struct splitter *splitter);
/* Vertices of the scan that no face refers to, once `used` is complete. */
uint64_t vox_partition_unused(const struct scan *scan, const struct scattered *scattered);

#endif
