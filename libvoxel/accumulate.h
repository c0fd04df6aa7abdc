/* accumulate.h - adds the triangles of a chunk to the voxels of a region. */
#ifndef VOX_ACCUMULATE_H
#define VOX_ACCUMULATE_H

#include "libvoxel/clip.h"
#include "libvoxel/shade.h"

/* Adds what the chunk's triangles have inside `window`, a part of `region` (which is the
 * accumulator's 128^3 voxels), in the order of the triangles. *counted: adds the number of
 * triangles that this window is the one to count, so that over all regions each is counted once.
 * Returns 0, VOX_REGION_FULL or a negative status. */
int vox_accumulate_chunk(const struct vox_shading *shading, const struct vox_lattice *lattice,
                         const struct vox_chunk *chunk, const struct vox_box *region,
                         const struct vox_box *window, struct vox_accumulator *accumulator,
                         uint64_t *counted);

#endif
