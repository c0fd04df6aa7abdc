/* chunk_boxes.h - private: where in the grid the triangles of a chunk may be, closer than its
 * bounds say.
 *
 * A chunk has as many triangles in a stray corner of a scan as elsewhere, so one around an outlier,
 * or of a scan of few triangles, reaches across space in which there is nothing. Going through the
 * regions of such bounds would take forever. */
#ifndef VOX_VOXELIZE_PLAN_CHUNK_BOXES_H
#define VOX_VOXELIZE_PLAN_CHUNK_BOXES_H

#include "libvoxel/voxelize/plan/voxel_transform.h"

/* A run of a chunk's triangles. */
struct vox_part {
    struct vox_box box;
    uint32_t chunk;
};

/* *parts: of all chunks, whose bounds are in boxes, in ascending order; to be freed with
 * bsq_free(). Chunks that reach across many regions are read and cut into runs that do not, or that
 * are one triangle, while all takes no more than `bytes`. */
int vox_parts_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                     const struct vox_lattice *lattice, const struct vox_box *boxes, uint64_t bytes,
                     struct vox_part **parts, uint64_t *count);

#endif
