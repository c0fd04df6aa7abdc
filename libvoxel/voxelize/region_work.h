/* region_work.h - voxelizes a region, or a part of it: the pipeline's unit of work. */
#ifndef VOX_VOXELIZE_REGION_WORK_H
#define VOX_VOXELIZE_REGION_WORK_H

#include "libvoxel/voxelize/clip/accumulate.h"
#include "libvoxel/voxelize/result_gate.h"

struct vox_unit;

/* What all workers share. */
struct vox_shared {
    struct bsq_ctx *ctx;
    struct vox_transform transform;
    struct vox_shading shading;
    const struct vox_box *bounds; /* voxels of each chunk's bounds */
    struct vox_chunks *chunks;
    struct vox_result_gate gate;
    /* Writes what a unit's result holds so far. Called after all units before it are written. */
    int (*write)(void *arg, const struct vox_unit *unit);
    void *write_arg;
};

/* One unit: a region, or a slab of it along x. */
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

/* Fills unit->leaves. If memory is short, writes the first parts and leaves only the rest there. */
int vox_region_work(struct vox_shared *shared, struct vox_unit *unit,
                    const struct vox_worker *worker);

#endif
