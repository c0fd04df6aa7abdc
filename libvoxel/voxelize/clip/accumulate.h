/* accumulate.h - adds the triangles of a chunk to the voxels of a region. */
#ifndef VOX_VOXELIZE_CLIP_ACCUMULATE_H
#define VOX_VOXELIZE_CLIP_ACCUMULATE_H

#include "libvoxel/voxelize/clip/shade.h"

/* Room for the pieces of triangles on their way to the sums; one a worker. */
struct vox_block;

uint64_t vox_block_bytes(void);
int vox_block_create(struct bsq_ctx *ctx, struct vox_block **out);
void vox_block_destroy(struct bsq_ctx *ctx, struct vox_block *block); /* NULL is allowed */

/* What is added, and where to. */
struct vox_accumulation {
    const struct vox_shading *shading;
    const struct vox_chunk *chunk;
    const struct vox_box *region; /* the accumulator's 128^3 voxels */
    const struct vox_box *window; /* the part of the region to fill */
    struct vox_accumulator *sums;
    struct vox_block *block;
};

/* Adds what the chunk's triangles have inside the window, in the order of the triangles. *counted:
 * adds the number of triangles that this window is the one to count, so that over all regions each
 * is counted once. Returns 0, VOX_REGION_FULL or a negative status. */
typedef int vox_accumulate_chunk_fn(const struct vox_accumulation *what, uint64_t *counted);
BSQ_SIMD_DECLARE(vox_accumulate_chunk_fn, vox_accumulate_chunk);

#endif
