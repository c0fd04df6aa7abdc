/* region_work.h - voxelizes one part of a region: the pipeline's unit of work. */
#ifndef VOX_VOXELIZE_REGION_WORK_H
#define VOX_VOXELIZE_REGION_WORK_H

#include "libvoxel/voxelize/clip/accumulate.h"
#include "libvoxel/voxelize/result_gate.h"

struct vox_unit;

/* What all workers share. */
struct vox_scan {
    struct bsq_ctx *ctx;
    struct vox_lattice lattice;
    struct vox_shading shading;
    const struct vox_box *boxes; /* voxels of each chunk's bounds */
    struct vox_chunks *chunks;
    struct vox_result_gate gate;
    /* Writes what a unit's result holds so far; called when all units before it are written. */
    int (*write)(void *arg, const struct vox_unit *unit);
    void *write_arg;
};

/* One unit: a region, or a slab of it along x. */
struct vox_unit {
    int32_t origin[3];     /* of the region */
    struct vox_box window; /* the region's voxels that this unit is about */
    uint32_t *chunks;      /* that touch the region, ascending */
    uint64_t chunk_count, chunk_capacity;
    struct vox_leaves leaves; /* the result */
    uint64_t held_bytes;      /* what the gate has allowed for it */
    uint64_t sequence;
};

/* What each worker has for itself. */
struct vox_worker {
    struct vox_accumulator *sums;
    struct vox_block *block;
};

/* Fills in unit->leaves, or the last part of it where the rest had to be written for want of room.
 */
int vox_region_work(struct vox_scan *scan, struct vox_unit *unit, const struct vox_worker *worker);

#endif
