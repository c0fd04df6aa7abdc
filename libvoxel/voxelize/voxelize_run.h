/* voxelize_run.h - makes the regions of a grid from chunk files. */
#ifndef VOX_VOXELIZE_VOXELIZE_RUN_H
#define VOX_VOXELIZE_VOXELIZE_RUN_H

#include "formats/grid/nvdb.h"
#include "libvoxel/voxel.h"
#include "libvoxel/voxelize/region_work.h"

struct vox_run {
    const struct vox_voxelize_options *options;
    struct bsq_ctx *ctx;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    struct vox_shared shared;
    struct vox_smooth *smooth;   /* NULL: the scan has normals, or is to be flat */
    struct vox_box *bounds;      /* voxels of each chunk's bounds */
    struct vox_chunk_box *boxes; /* of all chunks */
    uint64_t box_count;
    struct vox_schedule *schedule;
    struct fmt_nvdb_writer *writer;
    struct vox_worker *own; /* one for each worker */
    struct vox_unit *units; /* the pipeline's slots */
    unsigned workers, unit_count;
    uint32_t slabs;                     /* units that each region is cut into */
    uint32_t next_slab;                 /* next slab of the region in production */
    struct vox_unit current;            /* the region in production: its origin and chunks */
    int32_t index_min[3], index_max[3]; /* of voxels that were written; min > max: none */
    bool gate_open;
};

/* Opens the input, places the voxels, finds the boxes of chunks in the regions that they touch, and
 * checks that the grid fits on its disk and in the format. Close the run also after a failure;
 * zeros are allowed. The options must outlive it. */
int vox_run_open(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_run *run);
void vox_run_close(struct vox_run *run);

/* Makes all regions and appends their voxels to the grid. Errors: those of reading and writing. */
int vox_run_regions(struct vox_run *run, struct fmt_nvdb_writer *writer);

#endif
