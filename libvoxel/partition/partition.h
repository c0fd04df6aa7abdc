/* partition.h - the public header of this folder: a scan's triangles, partitioned into buckets by
 * place.
 *
 * Takes a mesh reader. Gives the scan's attribute streams (read/scan.h) and its triangles, coded in
 * buckets of a coarse Morton grid (tuple_runs.h). The reading is one pass if all vertices come
 * before all faces, which samples of the text can tell for most files; two passes work for any
 * file. Memory is bounded: attribute streams and buckets move to temporary files. */
#ifndef VOX_PARTITION_PARTITION_H
#define VOX_PARTITION_PARTITION_H

#include "libvoxel/partition/morton.h"
#include "libvoxel/partition/tuple_runs.h"

/* ---- the partition ---- */

struct partition {
    struct tuple_layout layout;
    struct morton_cube cube;
    uint32_t levels;          /* the first 3 * levels bits of a key name a bucket */
    struct bsq_spill buckets; /* of runs; items are triangles */
    uint64_t triangles;       /* in the buckets, including those without area */
    bool vertices_lack_order; /* neighbours in the file are not neighbours in space; only known if
                                 positions are in a file */
};

enum partition_passes {
    PARTITION_ONE_PASS, /* all elements come before all faces */
    PARTITION_TWO_PASSES
};

/* Reads the scan and partitions its faces. `out` is zero at first; free it with
 * vox_partition_free(), also after failure. The scan must be finished before the layout is known:
 * call vox_scan_finish(), vox_scan_find_materials() and vox_tuple_layout_for() next. Errors:
 * those of the reader; BSQ_RETRY if one pass is asked for and elements follow faces; BSQ_ENOMEM if
 * memory is too small for a scan of this size or its polygons. */
int vox_partition_read(struct scan *scan, struct fmt_mesh_reader *reader, const char *beside,
                       enum partition_passes passes, struct partition *out);
void vox_partition_free(struct partition *partition);

#endif
