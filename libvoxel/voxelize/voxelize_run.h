/* voxelize_run.h - one call of vox_voxelize(), for the sources of this folder. */
#ifndef VOX_VOXELIZE_VOXELIZE_RUN_H
#define VOX_VOXELIZE_VOXELIZE_RUN_H

#include <pthread.h>

#include "formats/grid/nvdb.h"
#include "libvoxel/voxel.h"
#include "libvoxel/voxelize/clip/accumulate.h"
#include "libvoxel/voxelize/plan/plan.h"

/* How memory is divided among the steps. */
struct vox_shares {
    uint64_t texture_bytes; /* for colours, for further channels and for the normal map each */
    uint64_t cache_slots, accumulator_bytes, result_bytes;
};

/* A unit of work: a region, or a slab of it along x. */
struct vox_unit {
    int32_t origin[3];     /* of the region */
    struct vox_box window; /* the voxels of the region that this unit fills */
    uint32_t *chunks;      /* chunks that touch the region, ascending */
    uint64_t chunk_count, chunk_capacity;
    struct vox_leaves leaves; /* the result */
    uint64_t held_bytes;      /* bytes that the gate granted for it */
    uint64_t sequence;
};

/* Memory of one worker. */
struct vox_worker {
    struct vox_accumulator *sums;
    struct vox_fragment_block *block;
};

/* Bounds the memory of results that wait to be written. */
struct vox_gate {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    uint64_t held; /* bytes */
    uint64_t turn; /* sequence number of the unit that is written next */
    int status;    /* of the first unit that failed */
};

struct vox_run {
    const struct vox_voxelize_options *options;
    struct bsq_ctx *ctx;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    char *channels; /* that the grid gets, as the options have them; NULL: none; owned */
    struct vox_transform transform;
    struct vox_chunk_box *boxes; /* of all chunks */
    uint64_t box_count;

    struct vox_shares shares;
    struct vox_shading shading;
    bool smooth; /* the scan has no normals of its own, and gets those that were made */
    struct vox_schedule *schedule;
    struct vox_chunks *chunks;
    struct vox_worker *own; /* one for each worker */
    struct vox_unit *units; /* the pipeline's slots */
    unsigned workers, unit_count;

    struct fmt_nvdb_writer *writer;
    struct vox_gate gate;
    uint32_t slabs;          /* units that each region is cut into */
    uint32_t next_slab;      /* next slab of the region in production */
    struct vox_unit current; /* the region in production: its origin and chunks */
    uint64_t clamped_colors; /* of records that were written */
};

/* Makes all regions of a run that is set up, and appends their voxels to its grid. Errors: those of
 * reading and writing. */
int vox_run_regions(struct vox_run *run);

/* ---- how large a grid will be ---- */

/* Estimates the number of voxels that the triangles touch, to some percent if triangles are larger
 * than voxels. Surfaces that pass through the same voxels count more than once. Reads up to
 * chunks_max chunks, spread evenly over the file. Errors: those of reading. */
int vox_estimate_voxels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                        const struct vox_transform *transform, uint64_t chunks_max, double *voxels);

/* Returns the estimated size in bytes of a file of that many voxels. */
double vox_estimate_bytes(double voxels, unsigned channels);

/* Refuses a grid that does not fit on its disk (BSQ_EIO, with the bytes needed and free) or has
 * more leaves than a file can number (BSQ_EUSAGE). Warns if the grid will be huge and far finer
 * than the triangles. Samples a few chunks, and reads all if these tell of a huge grid.
 * Requires less space than estimated, so that no grid is refused that would have fitted. */
int vox_estimate_check(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                       const struct vox_transform *transform, unsigned channels,
                       const char *grid_path);

#endif
