/* accumulate.h - adds the triangles of a chunk to the voxels of a region.
 *
 * Takes a chunk from the cache, the attributes of the scan, and the voxels to fill. Gives sums of
 * the triangles' fragments, one fragment for each voxel that a triangle touches, in an accumulator.
 */
#ifndef VOX_VOXELIZE_CLIP_ACCUMULATE_H
#define VOX_VOXELIZE_CLIP_ACCUMULATE_H

#include "formats/shading/shading.h"
#include "libvoxel/voxelize/cache/chunk_cache.h"
#include "libvoxel/voxelize/records/region.h"

/* The attributes of a scan, and tables of what the fragments of a triangle share. */
struct vox_shading {
    struct fmt_shading scan;
    struct vox_color_tables tables;
    uint32_t channel_words; /* values of all further channels */
    double *channels; /* of each material, then of triangles without one, without textures; NULL:
                         none */
    bool *textured;   /* likewise: something comes from textures; NULL: nothing does */
};

/* Makes the tables, after attributes are added and textures are opened. Free also after a failure;
 * zeros are allowed. Errors: BSQ_ENOMEM. */
int vox_shading_prepare(struct vox_shading *shading);
void vox_shading_free(struct vox_shading *shading);

/* Memory for triangles and their fragments on the way to the sums. Each worker has one. Needs no
 * initialisation. */
struct vox_fragment_block;
uint64_t vox_fragment_block_bytes(void);

/* Which triangles are added, and to which voxels. */
struct vox_accumulation {
    const struct vox_shading *shading;
    const struct vox_chunk *chunk;
    const struct vox_box *region; /* the accumulator's 128^3 voxels */
    const struct vox_box *window; /* the part of the region to fill */
    struct vox_accumulator *sums;
    struct vox_fragment_block *block;
};

/* Adds the fragments inside the window, in the order of the chunk's triangles. *counted: increased
 * by the triangles that this window counts; each triangle is counted by one window of the grid.
 * Returns 0, VOX_REGION_FULL or a negative status. */
typedef int vox_accumulate_chunk_fn(const struct vox_accumulation *chunk_sums, uint64_t *counted);
BSQ_SIMD_DECLARE(vox_accumulate_chunk_fn, vox_accumulate_chunk);

#endif
